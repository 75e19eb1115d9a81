"""Passes over a file or pipe of records: what readers of MCAP and of ROS 1 share, and what recovery lost."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from dataclasses import replace
from itertools import chain
from typing import TYPE_CHECKING, Self

import numpy as np

from odomcorrupt.bags.block import TABLE, Block, without
from odomcorrupt.bags.checksum import crc32
from odomcorrupt.bags.chunk import Chunk
from odomcorrupt.bags.messages import READABLE, undecodable
from odomcorrupt.bags.output import Original, crc_of_spans, state_of
from odomcorrupt.bags.source import BufferPool, Source, extended, lies_behind
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Iterator, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import Channel


_ADVICE = re.compile(r"[;,]? *(?:try )?--recover\b.*\Z", re.DOTALL)


def loss_of(error: BagError) -> str:
    """Return an error's message without its advice to use --recover."""
    return _ADVICE.sub("", error.message)


def with_readable(only: Container[int] | None, channels: Mapping[int, Channel]) -> Container[int] | None:
    """Return the ids of required channels, with those whose messages can be decoded here."""
    if only is None:
        return None
    return {number for number, channel in channels.items() if number in only or channel.msgtype in READABLE}


class Undecodable:
    """Messages of a pass that are whole records and cannot be decoded, counted by topic.

    Whatever reads their topic would end at them, so that they are left out.
    """

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}
        self._reasons: dict[str, str] = {}

    def find(self, block: Block, channels: Mapping[int, Channel]) -> NDArray[np.bool_]:
        """Return and count the messages (n,) of a block that cannot be decoded."""
        found = np.zeros(len(block.table), dtype=bool)
        for channel in (channels[number] for number in sorted(block.present())):
            failed = undecodable(block, channel)
            if failed:
                found[list(failed)] = True
                self._counts[channel.topic] = self._counts.get(channel.topic, 0) + len(failed)
                self._reasons.setdefault(
                    channel.topic, loss_of(next(iter(failed.values()))).removeprefix(f"{channel.topic}: ")
                )
        return found

    def losses(self, name: str) -> list[str]:
        """Return one sentence for each topic of the bag of this name."""
        return [
            f"{name}: {count} of the messages of {topic} cannot be decoded: left out (the first: {first})"
            for (topic, count), first in zip(self._counts.items(), self._reasons.values(), strict=True)
        ]


WINDOW_BYTES = 1 << 20
"""What of a damaged bag is searched for records at once."""

_CLOSE_BYTES = 1 << 13
"""Changed messages at most this many bytes apart are written at once, which takes no longer than two writes."""


_ENOUGH_MESSAGES = 14_000
"""More at once would save no more time."""


class RecordReader(ABC):
    """Base class of readers of a file or pipe of records; see `BagReader`.

    losses : parts that could not be read, one sentence each, with recovery
    count : number of messages of the last pass; stated : that which the bag states, None if it does not
    sparse : whether blocks of uncompressed chunks need not have the bytes of messages that are not asked for
    """

    channels: Mapping[int, Channel]
    _stated_by = ""
    """The part of the bag that states the number of its messages, as the subject and verb of a sentence."""

    def __init__(self, path: Path | None, source: Source, *, recover: bool) -> None:
        self.name = source.name
        self.paths = [] if path is None else [path]
        self.complete = path is not None and source.size is not None
        self.losses: list[str] = []
        self.count = 0
        self.stated: int | None = None
        self._recover = recover
        self._source = self._reading = source
        self._undecodable = Undecodable()
        self._state: list[int] = []
        self._begun = False
        self._first_losses = 0  # those of the header
        self._data_start = 0
        self.sparse = False
        self._only: NDArray[np.bool_] | None = None
        self._unmet: set[int] = set()
        self._sparse_pool = BufferPool(sparse=True)

    @property
    def part_read(self) -> float | None:
        """Part of the file's bytes read in this pass, 0 to 1; None where its size is unknown."""
        return self._reading.position / self._reading.size if self._reading.size else None

    def blocks(self, only: Container[int] | None = None) -> Iterator[Block]:
        """Yield the blocks in file order; repeatable for a file, once for a pipe.

        only : ids of channels; if `sparse`, most bytes of other messages may be missing
        """
        del self.losses[self._first_losses :]
        self._undecodable = Undecodable()
        self.count = 0
        if self.complete:
            with Source.of_file(self.paths[0], self.name) as source:
                self._reading = source
                self._state, self._only, self._unmet = state_of(source.descriptor), None, set(self.channels)
                same = self._state == state_of(self._source.descriptor)
                if only is not None and self.sparse and same and not self._recover:
                    self._only = np.ones(1 << 16, dtype=bool)  # with channels of which the bag does not tell at its end
                    self._only[[number for number in self.channels if number not in only and number < 0xFFFF]] = False
                source.seek(self._data_start)
                blocks = self._pass(source)
                yield from blocks if self._only is None else _with_joined(blocks)
        else:
            if self._begun:
                raise BagError(f"{self.name}: a pipe can be read once only; write it to a file first")
            self._begun = True
            yield from self._pass(self._source)
            if not self._recover:
                self._read_end(self._source)
        self.losses += self._undecodable.losses(self.name)
        if self.stated is not None and self.count < self.stated and not self.losses:
            self._lose(
                BagError(
                    f"{self.name}: its {self._stated_by} {self.stated} messages, but it holds {self.count}: the bag is "
                    "damaged; --recover saves those"
                )
            )

    def _pass(self, source: Source) -> Iterator[Block]:
        """Yield the blocks of a source, and register channels on the way."""
        run: list[Chunk] = []  # whose messages are found at once
        indexed = 0  # bytes of their indexes, 12 or 16 a message
        for part in self._parts(source):
            if run and not (isinstance(part, Chunk) and run[-1].goes_on_with(part)):
                yield from self._finished(run)
                run.clear()  # the memory is free for others
            if not isinstance(part, Chunk):
                yield part
                continue
            indexed = (indexed if run else 0) + sum(len(index) for _, index in part.indexes)
            run.append(part)
            if indexed > 12 * _ENOUGH_MESSAGES or source.pool.left < part.data.size:
                source.pool.left = 0  # the next chunk lies elsewhere, with more behind it
            # before the next one takes memory; the first may be all that is asked for
            if not source.pool.left or self._recover or not self.count:
                yield from self._finished(run)
                run.clear()
        if run:
            yield from self._finished(run)

    def _finished(self, run: list[Chunk]) -> Iterator[Block]:
        """Yield the messages of chunks in one buffer; with recovery those of one that are intact."""
        part = Chunk.joined(run)
        try:
            block = self._block(part.records, part)
            unknown = block.present() - self.channels.keys()
            if unknown:
                raise BagError(  # noqa: TRY301
                    f"{part.what}: messages of channel {min(unknown)}, which the bag does not define; damaged bag"
                )
        except BagError as error:
            if part.ends:
                yield from chain.from_iterable(self._finished([one]) for one in run)
                return
            self._lose(error)
            block = self._block(self._whole_records(part.records), replace(part, indexes=[]), salvage=True)
            known = np.isin(block.table["channel"], list(self.channels))
            block = without(block, ~known)
        if self._recover:
            block = without(block, self._undecodable.find(block, self.channels))
        self.count += len(block.table)
        yield block if self._only is None or not part.places else self._thinned(block, part.places, self._only)

    def _thinned(self, block: Block, places: tuple[tuple[int, int], ...], only: NDArray[np.bool_]) -> Block:
        """Return chunks with only the messages of some channels, and each channel's first one.

        places : position of each chunk's data in the file, and the stated CRC-32, 0 if there is none
        only : (n,) whether channel i is one of them; the last is true, and stands for those beyond
        """
        wanted = only.take(block.table["channel"], mode="clip")
        for number in self._unmet & block.present() if self._unmet else ():
            self._unmet.remove(number)
            wanted[np.argmax(block.table["channel"] == number)] = True
        rows = block.table[wanted]
        if 2 * rows["length"].sum() > block.data.size:
            return block
        data = self._sparse_pool.place(block.data.size)
        sparse, start = [], 0
        ends = block.ends or (block.data.size,)
        for (place, crc), end, spans in zip(places, ends, _spans(rows, ends), strict=True):
            to, source = data.data[start:end], block.data.data[start:end]
            for begin, stop in spans:
                to[begin:stop] = source[begin:stop]
            known = place, crc or crc32(source), spans, crc_of_spans(source, spans)
            sparse.append(Original(self.paths[0], self._source.descriptor, self._state, *known))
            start = end
        return replace(block, data=data, sparse=tuple(sparse))

    def _lose(self, error: BagError) -> None:
        """Record a loss with recovery, else raise the error."""
        if not self._recover:
            raise error
        self.losses.append(loss_of(error))

    @abstractmethod
    def _parts(self, source: Source) -> Iterator[Chunk | Block]:
        """Yield chunks, and blocks of what is between them."""

    @abstractmethod
    def _block(self, data: NDArray[np.uint8], part: Chunk, *, salvage: bool = False) -> Block:
        """Return the records of chunks as a block, and register the channels in it; BagError where one is damaged.

        data : (size,) the records
        salvage : whether definitions that cannot be read are left out
        """

    @staticmethod
    @abstractmethod
    def _whole_records(data: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the bytes (size,) of the intact records before the first damaged one."""

    @abstractmethod
    def _read_end(self, source: Source) -> None:
        """Read what follows the blocks on a pipe."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._source.close()


def _with_joined(blocks: Iterable[Block]) -> Iterator[Block]:
    """Yield blocks, with those that lie side by side in a sparse buffer joined."""
    run: list[Block] = []
    messages = 0
    for block in blocks:
        messages += len(block.table)
        few = messages <= _ENOUGH_MESSAGES
        if run and not (few and block.sparse and lies_behind(block.data, run[-1].data)):
            yield _joined(run)
            run, messages = [], len(block.table)
        if block.sparse:
            run.append(block)
        else:
            yield block
    if run:
        yield _joined(run)


def _joined(run: list[Block]) -> Block:
    """Return blocks that lie side by side as one."""
    if len(run) == 1:
        return run[0]
    begins = np.cumsum([0, *(block.data.size for block in run)]).tolist()
    size = begins.pop()
    ends = [begin + end for begin, one in zip(begins, run, strict=True) for end in one.ends or (one.data.size,)]
    # as plain bytes: NumPy is slow at concatenating structured arrays
    table = np.concatenate([block.table.view(np.uint8) for block in run]).view(TABLE)
    table["offset"] += np.repeat(begins, [len(block.table) for block in run])
    raw = run[0].raw.joined([block.raw for block in run[1:]], begins[1:])
    sparse = tuple(one for block in run for one in block.sparse)
    return Block(extended(run[0].data, size), table, raw, ends=tuple(ends), sparse=sparse)


def _spans(rows: NDArray[np.void], ends: tuple[int, ...]) -> list[list[tuple[int, int]]]:
    """Return the spans (begin, end) of messages in each chunk, bytes; close ones are merged.

    rows : (n,) of dtype TABLE
    ends : end offsets of the chunks
    """
    chunk_ends = np.array(ends)
    spans: list[list[tuple[int, int]]] = [[] for _ in chunk_ends]
    if not rows.size:
        return spans
    begins, stops = rows["offset"], np.maximum.accumulate(rows["offset"] + rows["length"])
    chunks = np.searchsorted(chunk_ends, begins, side="right")
    apart = np.flatnonzero((begins[1:] > stops[:-1] + _CLOSE_BYTES) | (chunks[1:] != chunks[:-1])) + 1
    first, last = np.concatenate(([0], apart)), np.concatenate((apart - 1, [-1]))
    chunk_begins = np.concatenate(([0], chunk_ends))[chunks[first]]
    found = (chunks[first], begins[first] - chunk_begins, stops[last] - chunk_begins)
    for chunk, begin, end in zip(*map(np.ndarray.tolist, found), strict=True):
        spans[chunk].append((begin, end))
    return spans
