"""What damage left alone: how many messages lie in chunks, or by themselves, of which no byte was touched."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, NamedTuple

from mutations import mcap_records, ros1_records

from odomcorrupt.bags.open import open_reader

if TYPE_CHECKING:
    from pathlib import Path


class ChunkCount(NamedTuple):
    """A chunk's place in the file, and how many messages it holds."""

    begin: int
    end: int
    count: int


@cache
def chunk_counts(path: Path) -> list[ChunkCount]:
    """Return the chunks of an undamaged file; of an MCAP without them its messages; none of other files."""
    data = path.read_bytes()
    if data.startswith(b"\x89MCAP"):
        records = mcap_records(data)
        places = [(begin, end) for opcode, begin, end in records if opcode == 6]
        if not places:
            return [ChunkCount(begin, end, 1) for opcode, begin, end in records if opcode == 5]
    elif data.startswith(b"#ROSBAG"):
        places = [(begin, end) for begin, middle, end in ros1_records(data) if b"op=\x05" in data[begin:middle]]
    else:
        return []
    with open_reader(path) as reader:
        counts = [len(block.table) for block in reader.blocks() if getattr(block.raw, "kind", "chunk") == "chunk"]
    if len(counts) != len(places):
        return []
    return [ChunkCount(begin, end, count) for (begin, end), count in zip(places, counts, strict=True)]


def untouched(chunks: list[ChunkCount], before: bytes, after: bytes) -> int:
    """Return how many messages lie in whole chunks, of which it is certain that a reader can know their topics."""
    if not chunks:
        return 0
    prefix = _common(before, after)
    suffix = min(_common(before[::-1], after[::-1]), min(len(before), len(after)) - prefix)
    if prefix < len(b"#ROSBAG V2.0\n"):
        return 0
    first = chunks[0].end <= prefix
    summary = len(before) == len(after) and len(before) - suffix <= chunks[-1].end
    total = 0
    for chunk in chunks:
        behind = chunk.begin >= len(before) - suffix and (first or summary)
        total += chunk.count if (chunk.end <= prefix and first) or behind else 0
    return total


def _common(one: bytes, other: bytes) -> int:
    low, high = 0, min(len(one), len(other))
    while low < high:
        middle = (low + high + 1) // 2
        if one[:middle] == other[:middle]:
            low = middle
        else:
            high = middle - 1
    return low
