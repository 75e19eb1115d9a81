"""Blocks of messages, the common representation of all bag formats.

A block is one chunk of a bag (or several, or a batch of rows), decompressed into a writable buffer, with a table of
the offsets of its serialised messages. Numbers in messages are patched in place; nothing else is parsed, so all
other bytes are unchanged.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol, Self

import numpy as np

from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Iterator, Mapping
    from pathlib import Path
    from types import TracebackType

    from numpy.typing import NDArray


Kind = Literal["ros1", "mcap", "sqlite3"]
"""What a bag is stored as."""

TABLE = np.dtype([("channel", "<u4"), ("log_ns", "<i8"), ("offset", "<i8"), ("length", "<i8")])
"""One row a message, in the order in which the messages lie in the block's data."""

_SMALL = (1 << 16) - 1
"""Ids up to here are counted fastest by np.bincount; those of an MCAP are never larger."""


class Definition(NamedTuple):
    """Message definition and metadata of a topic, in the terms of MCAP, into which all formats are converted.

    name : type name in the format's notation ("nav_msgs/Odometry" in ROS 1)
    encoding : encoding of the text: "ros1msg", "ros2msg", ..., "" for none
    text : the message definition
    metadata : QoS, type hash, latching, callerid
    """

    name: str
    encoding: str
    text: bytes
    metadata: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic of one publisher.

    id : key in the tables of blocks; unique within a bag
    msgtype : in ROS 2 notation, "nav_msgs/msg/Odometry", for ROS 1 bags too
    encoding : serialisation of messages: "ros1", "cdr", or others of MCAP ("json", "protobuf")
    raw : format-specific data (definition, md5sum, callerid, latching, QoS, type hash); opaque elsewhere
    """

    id: int
    topic: str
    msgtype: str
    encoding: str
    raw: Any = field(default=None, compare=False, repr=False)


class Message(NamedTuple):
    """A message added to a bag, written after the messages of its block."""

    channel: int
    log_ns: int
    data: bytes


@dataclass(slots=True, eq=False, repr=False)
class Block:
    """Consecutive messages of a bag in one buffer.

    data : (size,) uint8, writable; the decompressed chunk
    table : (n,) of dtype TABLE, one row per message
    raw : format-specific data for writing (compression, record framing, non-message records)
    added : messages to append, in order
    ends : end offsets of the chunks that were joined; empty for a single chunk
    sparse : position in the input file and CRC-32 of each chunk, if the data have only messages that were asked for
    changed : (n,) rows of the table; all other messages are as they were read. None if this is not known
    """

    data: NDArray[np.uint8]
    table: NDArray[np.void]
    raw: Any = None
    added: list[Message] = field(default_factory=list)
    ends: tuple[int, ...] = ()
    changed: NDArray[np.int64] | None = None
    sparse: tuple[tuple[int, int], ...] = ()

    def present(self) -> set[int]:
        """Return the ids of the channels of its messages."""
        channels = self.table["channel"]
        if channels.max(initial=0) > _SMALL:
            return set(channels.tolist())
        return set(np.flatnonzero(np.bincount(channels)).tolist())


class Framing:
    """Format-specific framing of a block in its file; consecutive chunks may be joined into one block."""

    __slots__ = ()

    def begins(self, table: NDArray[np.void]) -> NDArray[np.int64]:
        """Return the offsets (n,) of the records of a block's messages, bytes, headers included."""
        return table["offset"]

    def kept(self, begins: NDArray[np.int64]) -> Framing:  # noqa: ARG002 - overridden where they are part of it
        """Return the framing of some of the messages, whose records begin at these offsets (n,)."""
        return self

    def goes_on_with(self, other: object) -> bool:  # noqa: ARG002 - overridden where blocks can be joined
        """Return whether this and another block are chunks with the same framing, so that they can be joined."""
        return False

    def joined(self, behind: list[Any], begins: list[int]) -> Framing:  # noqa: ARG002 - as above
        """Return the framing of this block joined with those after it, which begin at these offsets of the data."""
        return self


def own_framing(block: Block) -> Framing:
    """Return the framing of a block in its file, of one of several files, too."""
    framing = block.raw.own.raw if isinstance(block.raw, PartFraming) else block.raw
    return framing if isinstance(framing, Framing) else Framing()


def without(block: Block, left_out: NDArray[np.bool_]) -> Block:
    """Return a block of records without some of its messages (n,); other records are kept, empty chunks are not."""
    if not left_out.any():
        return block
    own = block.raw.own if isinstance(block.raw, PartFraming) else block
    every = own_framing(block).begins(block.table)
    order = np.argsort(every[left_out], kind="stable")
    ends = np.maximum.accumulate((block.table["offset"] + block.table["length"])[left_out][order])
    befores = np.concatenate(([0], ends))
    begins = np.maximum(every[left_out][order], befores[:-1])  # records of a damaged bag may overlap
    gaps = zip(befores.tolist(), [*begins.tolist(), block.data.size], strict=True)
    data = np.concatenate([block.data[begin:end] for begin, end in gaps])
    sizes = np.concatenate(([0], np.cumsum(ends - begins)))

    def moved(offsets: NDArray[np.int64]) -> NDArray[np.int64]:
        passed = np.searchsorted(begins, offsets)
        return offsets - sizes[passed] + np.maximum(befores[passed] - offsets, 0)

    framing = own.raw.kept(moved(every[~left_out])) if isinstance(own.raw, Framing) else own.raw
    chunk_ends = sorted(set(moved(np.array(own.ends, dtype=np.int64)).tolist()))
    left = Block(data, own.table[~left_out], framing, ends=tuple(end for end in chunk_ends if end > 0))
    left.table["offset"] = moved(left.table["offset"])
    if own is block:
        return left
    table = block.table[~left_out]
    table["offset"] = left.table["offset"]
    return Block(data, table, PartFraming(block.raw.part, left))


class PartFraming(NamedTuple):
    """Framing of a block of a bag of several files.

    part : index of the block's file
    own : the block with the channel ids of that file
    """

    part: int
    own: Block


@dataclass(frozen=True, slots=True)
class Unframed(Framing):
    """Framing of a block of bare messages, which were rewritten while they were read.

    codec : compression of the chunk that they came from
    """

    codec: str = "zstd"


class PartContents(NamedTuple):
    """Message counts and time span of a written file.

    counts : number of messages by topic
    start_ns, end_ns : first and last log time; 0 and 0 without messages
    """

    name: str
    counts: Mapping[str, int]
    start_ns: int
    end_ns: int


class BagReader(Protocol):
    """An open bag.

    name : name in error messages
    paths : files of the bag, none for a pipe
    `channels` is complete after opening if `complete` is true (the input can seek); on a pipe it is filled while blocks
    are read, each channel before the first block that uses it. Closed by the context manager. Any fault of the bag
    raises BagError.
    """

    kind: Kind
    name: str
    paths: list[Path]
    complete: bool
    channels: Mapping[int, Channel]

    @property
    def count(self) -> int:
        """Return the number of messages of the last pass."""

    @property
    def losses(self) -> list[str]:
        """Return what the last pass could not read, one sentence each, with recovery."""

    def blocks(self, only: Container[int] | None = None) -> Iterator[Block]:
        """Yield the blocks in file order, each with its own buffer, as several are held at once.

        only : ids of required channels; messages of others may be omitted where that is faster, with length 0
        """

    def definition(self, channel: Channel) -> Definition:
        """Return the bag's definition of a channel's type."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *_error: object) -> None: ...


def require_all(name: str, reader: BagReader, written: int, added: int) -> None:
    """Raise BagError where an output has not as many messages as were read and added.

    name : name of the output in the error
    """
    if written != reader.count + added:
        raise BagError(
            f"{name}: {reader.count} messages were read and {added} added, but {written} written; the output "
            "is discarded: this is a bug in odomcorrupt, please report it"
        )


class BagWriter(Protocol):
    """A bag being written under a temporary name, renamed when the context ends without an error, else removed.

    keeps_rest : whether messages not passed to `write` are in the bag, too: a sqlite3 file is copied, so that only
    channels that may change need to be read (`blocks(only=...)`)
    """

    keeps_rest: bool

    def add_channel(self, topic: str, msgtype: str, like: Channel) -> Channel:
        """Add a channel with the encoding, QoS and latching of another one; return it with a new id."""

    def provenance(self, name: str, items: Mapping[str, str]) -> None:
        """Write provenance metadata, where the format has any; ROS 1 has none."""

    def write(self, block: Block) -> None:
        """Write a block, its added messages last; with compression threads, the block must not change afterwards."""

    def settle(self) -> None:
        """Wait until all blocks passed to `write` are written and may change."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


_ENOUGH_MESSAGES = 20_000
"""More at once would save no more time."""


def joined(blocks: Iterable[Block]) -> Iterator[Block]:
    """Yield blocks, with adjacent small chunks of the same framing joined."""
    run = _Run()
    for block in blocks:
        if run.blocks and not run.goes_on_with(block):
            yield run.block()
            run = _Run()
        run.add(block)
    if run.blocks:
        yield run.block()


@dataclass(slots=True, eq=False, repr=False)
class _Run:
    blocks: list[Block] = field(default_factory=list)
    messages: int = 0
    end: int = 0

    def add(self, block: Block) -> None:
        self.blocks.append(block)
        self.messages += len(block.table)
        self.end = _address(block) + block.data.size

    def goes_on_with(self, block: Block) -> bool:
        last = self.blocks[-1]
        return (
            not (last.ends or block.ends)
            and self.messages + len(block.table) <= _ENOUGH_MESSAGES
            and _address(block) == self.end
            and block.data.base is last.data.base
            and isinstance(block.data.base, np.ndarray)
            and isinstance(last.raw, Framing)
            and last.raw.goes_on_with(block.raw)
        )

    def block(self) -> Block:
        first = self.blocks[0]
        whole = first.data.base
        if len(self.blocks) == 1 or not isinstance(whole, np.ndarray):
            return first
        ends = np.cumsum([block.data.size for block in self.blocks]).tolist()
        begins = [0, *ends[:-1]]
        at = _address(first) - _address_of(whole)
        # as plain bytes: NumPy is slow at concatenating structured arrays
        table = np.concatenate([block.table.view(np.uint8) for block in self.blocks]).view(TABLE)
        table["offset"] += np.repeat(begins, [len(block.table) for block in self.blocks])
        raw = first.raw.joined([block.raw for block in self.blocks[1:]], begins[1:])
        sparse = tuple(one for block in self.blocks for one in block.sparse)  # of all: they lie in the same buffer
        return Block(whole[at : at + ends[-1]], table, raw, ends=tuple(ends), sparse=sparse)


def _address(block: Block) -> int:
    return _address_of(block.data)


def _address_of(data: np.ndarray[tuple[int], np.dtype[np.uint8]]) -> int:
    return int(data.__array_interface__["data"][0])
