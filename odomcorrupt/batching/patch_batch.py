"""Portions of a bag: the messages of several blocks that may change, gathered in one small buffer.

NumPy then processes hundreds of messages at a time, and a run patches a copy of that buffer, not of the whole bag.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.block import TABLE, Block
from odomcorrupt.bags.chunk import windows
from odomcorrupt.corruption.transform import Run

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, BagWriter
    from odomcorrupt.corruption.patch import Target
    from odomcorrupt.corruption.reorder import Arrivals
    from odomcorrupt.corruption.transform import Options, Transform
    from odomcorrupt.model.motion_model import MotionModel

PORTION_BYTES = 8 << 20
"""Blocks that wait for all runs to be patched hold about this much together."""

PORTION_MESSAGES = 2000
"""Messages that are patched at once: more would save no more time."""


class LateTopic(Exception):  # noqa: N818 - a signal, not an error: the pass is repeated
    """A topic changes whose earlier messages were skipped; `channel` is its id."""

    def __init__(self, channel: int) -> None:
        super().__init__(channel)
        self.channel = channel


@dataclass(frozen=True, slots=True)
class Place:
    """Offsets of a block's messages that may change, in the block and in the portion.

    rows : (n,) indices into the block's table
    begins, ends : (n,) offsets of their records in the block's data, bytes, headers included
    moves : for each record length: the length, offsets (m,) in the block and (m,) in the portion, bytes
    """

    rows: NDArray[np.int64]
    begins: NDArray[np.int64]
    ends: NDArray[np.int64]
    moves: list[tuple[int, NDArray[np.int64], NDArray[np.int64]]]


@dataclass(slots=True)
class Portion:
    """Consecutive blocks, and their messages that may change.

    blocks, places : the blocks, if the output needs them, and the offsets of their messages
    own_targets : targets of each kept block
    growth : odometry sorted meanwhile; None at a restart of time
    table, data : messages that may change; data holds their records with headers, at the table's offsets
    targets : messages to move, in `data`; first_ns : first stamp, the origin of clock effects
    """

    blocks: list[Block] = field(default_factory=list)
    places: list[Place | None] = field(default_factory=list)
    own_targets: list[list[Target]] = field(default_factory=list)
    growth: list[Arrivals | None] = field(default_factory=list)
    table: NDArray[np.void] = field(default_factory=lambda: np.empty(0, dtype=TABLE))
    data: NDArray[np.uint8] = field(default_factory=lambda: np.empty(0, dtype=np.uint8))
    targets: list[Target] = field(default_factory=list)
    first_ns: int = 0

    def patched_block(self, number: int, patched: NDArray[np.uint8]) -> Block:
        """Return a block with the messages of a run's patched portion."""
        place = self.places[number]
        if place is not None:
            for length, theirs, mine in place.moves:
                windows(self.blocks[number].data, length)[theirs] = windows(patched, length)[mine]
        return self.blocks[number]


class SharedRun(Run):
    """What all runs have in common, in place of a run: when odometry becomes known, and what is to be changed.

    growth : sorted odometry since it was last taken; None marks a restart of time
    targets : those of the last block; first_ns : the first stamp
    """

    def __init__(self, identity_model: MotionModel, options: Options) -> None:
        super().__init__(identity_model, 0, 0, options)
        self.growth: list[Arrivals | None] = []
        self.targets: list[Target] = []
        self.first_ns = 0

    def restart(self) -> None:
        """Record a restart of time."""
        self.growth.append(None)
        self.known_until_ns = None

    def extend(self, ordered: Arrivals) -> None:
        """Record odometry; no path is drawn."""
        self.growth.append(ordered)
        self.known_until_ns = int(ordered.stamps_ns[-1])

    def apply(self, _block: Block, targets: list[Target], first_ns: int) -> None:
        """Record the targets; nothing is changed."""
        self.targets, self.first_ns = targets, first_ns

    def publish(self, block: Block, driving: list[Target], odom: str) -> None:
        """Do nothing: each run has an edge of its own."""


def portions(
    transform: Transform, shared: SharedRun, reader: BagReader, *, keep: bool, whole: set[int] | None, writer: BagWriter
    | None = None,
) -> Iterator[Portion]:  # fmt: skip
    """Yield a bag in portions; the last one may be empty.

    transform, shared : the transform whose run is the shared one
    writer : receives the channels added to all runs
    keep : whether blocks are kept until every run has written them
    whole : ids of changing channels, all of whose messages are gathered; grows. None: the targets' channels only

    Raises
    ------
    LateTopic
        If a channel turns out to change after some of its messages were skipped.
    """
    gatherer = _Gatherer(reader, transform, keep=keep, whole=whole)
    for block in transform.blocks(reader, reader.name, writer):
        gatherer.take(block, shared.targets)
        if gatherer.full:
            yield gatherer.done(shared)
    yield gatherer.done(shared)


class _Gatherer:
    def __init__(self, reader: BagReader, transform: Transform, *, keep: bool, whole: set[int] | None) -> None:
        self._reader, self._transform = reader, transform
        self._keep = keep
        self._whole = whole
        self._passed: set[int] = set()
        self._begin()

    def _begin(self) -> None:
        self._portion = Portion()
        self._tables: list[NDArray[np.void]] = []
        self._pieces: list[NDArray[np.uint8]] = []
        self._held_bytes = self._bytes = self._rows = 0

    @property
    def full(self) -> bool:
        kept_enough = self._held_bytes >= PORTION_BYTES or self._rows >= PORTION_MESSAGES
        return kept_enough if self._keep else self._rows >= PORTION_MESSAGES or self._bytes >= PORTION_BYTES // 8

    def take(self, block: Block, targets: list[Target]) -> None:
        """Add a block."""
        place = None
        channels = {target.channel.id for target in targets}
        if self._whole is not None:
            self._notice(block, channels, self._whole)
            channels = self._whole
        rows = np.flatnonzero(np.isin(block.table["channel"], list(channels)))
        if len(rows):
            place = self._gather(block, rows)
            self._move_targets(block, rows, targets)
            self._rows += len(rows)
        if self._keep:
            self._held_bytes += block.data.size
            self._portion.blocks.append(block)
            self._portion.places.append(place)
            self._portion.own_targets.append(targets)

    def _notice(self, block: Block, changing: set[int], whole: set[int]) -> None:
        # a topic may have several publishers: all of its channels are gathered
        topics = {(self._reader.channels[one].topic, self._reader.channels[one].msgtype) for one in changing - whole}
        if topics:
            changing |= {one.id for one in self._reader.channels.values() if (one.topic, one.msgtype) in topics}
        late = changing & self._passed
        if late:
            raise LateTopic(min(late))
        whole |= changing
        for number in block.present() - whole:
            if self._transform.may_move(self._reader.channels[number]):
                self._passed.add(number)

    def _gather(self, block: Block, rows: NDArray[np.int64]) -> Place:
        """Append the records of some rows to the portion."""
        offsets = block.table["offset"][rows]
        begins, ends = block.raw.begins(block.table)[rows], offsets + block.table["length"][rows]
        lengths = ends - begins
        after = np.cumsum(lengths)
        table = block.table[rows].copy()
        table["offset"] = self._bytes + after - table["length"]
        data = np.empty(int(after[-1]), dtype=np.uint8)
        moves = []
        for length in sorted(set(lengths.tolist())):
            own = np.flatnonzero(lengths == length)
            mine = after[own] - length
            windows(data, length)[mine] = windows(block.data, length)[begins[own]]
            moves.append((length, begins[own], self._bytes + mine))
        self._tables.append(table)
        self._pieces.append(data)
        self._bytes += data.size
        return Place(rows, begins, ends, moves)

    def _move_targets(self, block: Block, rows: NDArray[np.int64], targets: list[Target]) -> None:
        """Add targets with their offsets in the portion, merged with equal ones of earlier blocks."""
        starts = self._tables[-1]["offset"]
        for target in targets:
            layout = target.layout
            places = np.searchsorted(rows, layout.rows)
            inside = layout.starts - block.table["offset"][layout.rows]
            here = target._replace(layout=layout._replace(rows=self._rows + places, starts=starts[places] + inside))
            known = self._portion.targets
            number = next((i for i, one in enumerate(known) if _alike(one, here)), None)
            if number is None:
                known.append(here)
            else:
                known[number] = _joined(known[number], here)

    def done(self, shared: SharedRun) -> Portion:
        """Return the portion, and start the next one."""
        portion = self._portion
        portion.growth, shared.growth = shared.growth, []
        portion.first_ns = shared.first_ns
        if self._tables:
            portion.table, portion.data = np.concatenate(self._tables), np.concatenate(self._pieces)
        self._begin()
        return portion


def _alike(one: Target, other: Target) -> bool:
    a, b = one.layout, other.layout
    return (
        one.channel.id == other.channel.id
        and one.side == other.side
        and (a.order, a.unsigned_seconds) == (b.order, b.unsigned_seconds)
        and one.item == other.item
    )


def _joined(one: Target, other: Target) -> Target:
    a, b = one.layout, other.layout
    layout = a._replace(rows=np.concatenate((a.rows, b.rows)), starts=np.concatenate((a.starts, b.starts)))
    stamps_ns, time_ns = (np.concatenate(pair) for pair in zip(one[4:6], other[4:6], strict=True))
    return one._replace(layout=layout, stamps_ns=stamps_ns, time_ns=time_ns)
