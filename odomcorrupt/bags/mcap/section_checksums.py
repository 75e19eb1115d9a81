"""Checksums of an MCAP's data section, in its DataEnd record, and of its summary section, in its footer.

Zero stands for none in both. They cover what no chunk's checksum does: message indexes, attachments, metadata, and
messages outside chunks.
"""

from __future__ import annotations

import struct

from odomcorrupt.bags.checksum import combined, crc32
from odomcorrupt.bags.mcap.records import FOOTER, HEADER, MAGIC, record
from odomcorrupt.errors import BagError

FOOTER_BYTES = 20
_ADVICE = "outside of its chunks the bag is damaged; --recover saves the intact part"


def stated_data_crc(content: bytes, what: str) -> int:
    """Return the checksum in a DataEnd record's content."""
    if len(content) < 4:
        raise BagError(f"{what}: a DataEnd record of {len(content)} bytes is shorter than its checksum; damaged bag")
    return int.from_bytes(content[:4], "little")


def require_data_crc(stated: int, crc: int, length: int, header: bytes, what: str) -> None:
    """Raise BagError where the data section's checksum is not that of its bytes.

    Writers sum from the first byte of the file; two other readings of the specification, in which the magic or the
    header is no part of the data section, are accepted, too.

    stated : what the file says
    crc, length : CRC-32 of the bytes between the header and the DataEnd record, and their number
    header : content of the header record
    what : name in the error
    """
    begin = record(HEADER, header)
    before = (crc32(MAGIC + begin), crc32(begin))
    if stated not in (0, crc, *(combined(one, crc, length) for one in before)):
        raise BagError(f"{what}: the checksum of all its data does not match its bytes: {_ADVICE}")


def _crc_of_summary(footer: bytes, crc: int) -> int:
    """Return the checksum that a footer's content should state, of CRC-32 `crc` of the section before it."""
    return crc32(struct.pack("<BQ", FOOTER, len(footer)) + footer[:16], crc)


def require_summary_crc(footer: bytes, crc: int, what: str) -> None:
    """Raise BagError where a footer's content states a checksum that is not that of the section before it.

    footer : content of the footer record
    crc : CRC-32 of the bytes from the section's beginning to the footer
    what : name in the error
    """
    stated = int.from_bytes(footer[16:FOOTER_BYTES], "little")
    if stated not in (0, _crc_of_summary(footer, crc)):
        raise BagError(f"{what}: the checksum of its summary does not match its bytes: {_ADVICE}")
