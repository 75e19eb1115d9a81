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
    from collections.abc import Callable, Container, Iterator, Mapping
    from pathlib import Path
    from types import TracebackType

    from numpy.typing import NDArray

    from odomcorrupt.bags.output import Original


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


@dataclass(frozen=True, slots=True, repr=False)
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


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Framing:
    """How a block's messages lie in its file: here bare, with nothing between them.

    codec : compression of the chunk that they come from
    """

    codec: str = "zstd"

    def begins(self, table: NDArray[np.void]) -> NDArray[np.int64]:
        """Return the offsets (n,) of the records of a block's messages, bytes, headers included."""
        return table["offset"]

    def kept(self, begins: NDArray[np.int64]) -> Framing:  # noqa: ARG002 - overridden where they are part of it
        """Return the framing of some of the messages, whose records begin at these offsets (n,)."""
        return self

    def joined(self, behind: list[Any], begins: list[int]) -> Framing:  # noqa: ARG002 - as above
        """Return the framing of this block joined with those after it, which begin at these offsets of the data."""
        return self


BARE = Framing()


@dataclass(slots=True, eq=False, repr=False)
class Block:
    """Consecutive messages of a bag in one buffer.

    data : (size,) uint8, writable; the decompressed chunk
    table : (n,) of dtype TABLE, one row per message
    raw : format-specific data for writing (compression, record framing, non-message records)
    added : messages to append, in order
    ends : end offsets of the chunks that were joined; empty for a single chunk
    part : index of the file that it is from, of a bag of several
    sparse : each chunk in the input file, if the data have only messages that were asked for
    """

    data: NDArray[np.uint8]
    table: NDArray[np.void]
    raw: Framing = BARE
    added: list[Message] = field(default_factory=list)
    ends: tuple[int, ...] = ()
    part: int = 0
    sparse: tuple[Original, ...] = ()

    def present(self) -> set[int]:
        """Return the ids of the channels of its messages."""
        channels = self.table["channel"]
        if channels.max(initial=0) > _SMALL:
            return set(channels.tolist())
        return set(np.flatnonzero(np.bincount(channels)).tolist())

    def message(self, row: int) -> bytes:
        """Return the serialised message in a row of the table."""
        _, _, offset, length = self.table[row].tolist()
        return self.data[offset : offset + length].tobytes()


def with_ids(table: NDArray[np.void], number_of: Callable[[int], int]) -> NDArray[np.void]:
    """Return a copy of a table with other ids of channels."""
    known, places = np.unique(table["channel"], return_inverse=True)
    out = table.copy()
    out["channel"] = np.array([number_of(one) for one in known.tolist()], dtype=np.uint32)[places]
    return out


def without(block: Block, left_out: NDArray[np.bool_]) -> Block:
    """Return a block of records without some of its messages (n,); other records are kept, empty chunks are not."""
    if not left_out.any():
        return block
    every = block.raw.begins(block.table)
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

    table = block.table[~left_out]
    table["offset"] = moved(table["offset"])
    chunk_ends = sorted(set(moved(np.array(block.ends, dtype=np.int64)).tolist()) - {0})
    return Block(data, table, block.raw.kept(moved(every[~left_out])), ends=tuple(chunk_ends), part=block.part)


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

    @property
    def channels(self) -> Mapping[int, Channel]:
        """Return the channels by id."""

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


class ReaderView:
    """A reader with blocks of its own; otherwise equal to the given one."""

    def __init__(self, reader: BagReader, blocks: Callable[[Container[int] | None], Iterator[Block]]) -> None:
        self._reader, self._blocks = reader, blocks

    def blocks(self, only: Container[int] | None = None) -> Iterator[Block]:
        """Yield its own blocks."""
        return self._blocks(only)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._reader, name)


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
