"""What a file is by its first bytes, known before the reader of its format is imported."""

from __future__ import annotations

from typing import Final

from odomcorrupt.errors import BagError

MCAP: Final = b"\x89MCAP0\r\n"
ROS1: Final = b"#ROSBAG V2.0\n"
SQLITE: Final = b"SQLite format 3\0"
ZSTD: Final = b"\x28\xb5\x2f\xfd"

SNIFFED: Final = 64
"""Number of first bytes that tell."""

_OTHERS = {
    b"#ROSBAG V1": "is a ROS 1 bag of version 1; `rosbag migrate` makes it a 2.0 one",
    ZSTD: "is a zstd-compressed file; decompress it first (`zstd -d`)",
    b"\x1f\x8b": "is a gzip-compressed file; decompress it first (`gunzip`)",
    b"BZh": "is a bzip2-compressed file; decompress it first (`bunzip2`)",
    b"\xfd7zXZ\0": "is a xz-compressed file; decompress it first (`unxz`)",
    b"\x04\x22\x4d\x18": "is a lz4-compressed file; decompress it first (`lz4 -d`)",
    b"PK\x03\x04": "is a zip archive; unpack it first (`unzip`)",
    b"version https://git-lfs": "is a Git LFS pointer, not the file it points to; `git lfs pull` fetches that",
    b"rosbag2_bagfile_information": "is the metadata.yaml of a ROS 2 bag; name its directory",
    b"<!doctype": "is an HTML page, not a bag; download the file that the page offers",
    b"<html": "is an HTML page, not a bag; download the file that the page offers",
}
"""Other files that are taken for bags, and the way out; text may begin with white space and be in capitals."""


def unknown(name: str, begin: bytes) -> BagError:
    """Return the error that says what a file is that is no bag, from its first bytes."""
    if not begin:
        return BagError(f"{name}: is empty; nothing was recorded, or nothing came through the pipe")
    if begin.startswith(SQLITE):
        return BagError(f"{name}: a sqlite3 bag cannot come through a pipe; name the file or directory")
    text = begin.lstrip().lower()
    for first, said in _OTHERS.items():
        if begin.startswith(first) or text.startswith(first.lower()):
            return BagError(f"{name}: {said}")
    if not any(begin):
        return BagError(f"{name}: begins with zeros: space that was reserved and never written; nothing is in it")
    return BagError(f"{name}: begins with {begin[:8]!r}, which is not an MCAP, a ROS 1 bag or a ROS 2 bag")
