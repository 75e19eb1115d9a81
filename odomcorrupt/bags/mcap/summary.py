"""Footer and summary section of a seekable MCAP file."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from odomcorrupt.bags.checksum import crc32
from odomcorrupt.bags.mcap.records import (
    ATTACHMENT,
    CHANNEL,
    DATA_END,
    FOOTER,
    MAGIC,
    RECORD_HEADER_BYTES,
    SCHEMA,
    STATISTICS,
    Fields,
)
from odomcorrupt.bags.mcap.section_checksums import FOOTER_BYTES, require_summary_crc
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from odomcorrupt.bags.source import Source

PRIVATE = 0x80
"""Opcodes from here on belong to applications."""
_END_OF_DATA = struct.pack("<BQI", DATA_END, 4, 0)
"""Of a data section without a checksum."""


@dataclass(slots=True, eq=False, repr=False)
class Summary:
    """Content of a summary section.

    schemas, channels : contents of the records repeated there
    channel_count, message_count : from the statistics, or None without them
    private : whole records of applications
    has_data_crc : whether the data section may have a checksum: False if it is known to have none
    """

    schemas: list[bytes] = field(default_factory=list)
    channels: list[bytes] = field(default_factory=list)
    channel_count: int | None = None
    message_count: int | None = None
    private: list[bytes] = field(default_factory=list)
    has_data_crc: bool = True

    def keep(self, opcode: int, content: bytes, what: str, private: list[bytes] | None = None) -> None:
        """Add a record of the summary section if it is needed; private ones to a separate list."""
        if opcode == SCHEMA:
            self.schemas.append(content)
        elif opcode == CHANNEL:
            self.channels.append(content)
        elif opcode == STATISTICS:
            fields = Fields(content, what)
            self.message_count = fields.number("Q")
            fields.number("H")
            self.channel_count = fields.number("I")
        elif opcode >= PRIVATE:
            (self.private if private is None else private).append(struct.pack("<BQ", opcode, len(content)) + content)


def require_named(opcode: int, head: bytes, what: str) -> int:
    """Return the length of an attachment without its checksum, bytes; 0 for metadata, which have none.

    head : its content, or the beginning of it

    Raises
    ------
    BagError
        If it does not start with the fields that its index requires.
    """
    fields = Fields(head, what)
    if opcode != ATTACHMENT:
        fields.string()
        return 0
    times, names = (fields.number("Q"), fields.number("Q")), (fields.blob(), fields.blob())
    return 8 * len(times) + sum(4 + len(name) for name in names) + 8 + fields.number("Q")


def read_summary(source: Source, size: int) -> Summary:
    """Return the summary of a file of this size in bytes; empty if absent or senseless, since it is rebuilt anyway.

    Raises
    ------
    BagError
        If the file has no footer (it was truncated, or never closed), or the summary's checksum is wrong.
    """
    tail_bytes = RECORD_HEADER_BYTES + FOOTER_BYTES + len(MAGIC)
    if size >= tail_bytes + len(MAGIC):
        source.seek(size - tail_bytes)
        tail = source.read(tail_bytes, "footer")
        opcode, length = struct.unpack_from("<BQ", tail)
        if tail.endswith(MAGIC) and (opcode, length) == (FOOTER, FOOTER_BYTES):
            return _read_section(source, tail[RECORD_HEADER_BYTES : -len(MAGIC)], size - tail_bytes)
    raise BagError(
        f"{source.name}: the file of {size} bytes has no MCAP footer at its end: it is truncated or was never closed; "
        "--recover saves the intact part"
    )


def _read_section(source: Source, footer: bytes, end: int) -> Summary:
    """Return the summary that a footer's content tells of, which ends at byte `end`."""
    summary = Summary()
    start = int.from_bytes(footer[:8], "little") or end
    if not len(MAGIC) < start <= end:
        return summary
    before = max(start - len(_END_OF_DATA), len(MAGIC))
    source.seek(before)
    summary.has_data_crc = source.read(start - before, "end of the data") != _END_OF_DATA
    if start == end:
        return summary
    section = source.read(end - start, "summary")
    require_summary_crc(footer, crc32(section), source.name)
    at = 0
    while at < len(section):
        content = at + RECORD_HEADER_BYTES
        after = content + int.from_bytes(section[at + 1 : content], "little")
        if after > len(section):
            return Summary()
        summary.keep(section[at], section[content:after], source.name)
        at = after
    return summary
