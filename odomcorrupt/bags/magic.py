"""Magic bytes of bag formats, to detect a format before its reader is imported."""

from __future__ import annotations

from typing import Final

MCAP: Final = b"\x89MCAP0\r\n"
ROS1: Final = b"#ROSBAG V2.0\n"
SQLITE: Final = b"SQLite format 3\0"
ZSTD: Final = b"\x28\xb5\x2f\xfd"
