"""The one shape in which every bag format is read and written: blocks of messages.

A block is one chunk of a bag (or several, or a batch of rows), decompressed into a writable buffer, with a table that
says where each message's serialised bytes lie. Numbers in messages are patched in the buffer, in place; nothing else
of a block is ever parsed, so what is not patched comes through bit-identical.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, Protocol, Self

import numpy as np

from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Container, Iterator, Mapping
    from pathlib import Path
    from types import TracebackType

    from numpy.typing import NDArray

    from odomcorrupt.bags.definition import Definition

__all__ = [
    "TABLE",
    "BagReader",
    "BagWriter",
    "Block",
    "Channel",
    "Framing",
    "Kind",
    "Message",
    "PartContents",
    "PartFraming",
    "require_all",
]

Kind = Literal["ros1", "mcap", "sqlite3"]
"""What a bag is stored as."""

TABLE = np.dtype([("channel", "<u4"), ("log_ns", "<i8"), ("offset", "<i8"), ("length", "<i8")])
"""One row a message, in the order in which the messages lie in the block's data."""

_SMALL = (1 << 16) - 1
"""Ids up to here are told apart quickest by counting; those of an MCAP are never larger."""


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic of one publisher.

    id : key in the tables of blocks; unique within a bag
    msgtype : as ROS 2 writes it, "nav_msgs/msg/Odometry", for ROS 1 bags too
    encoding : how messages are serialised: "ros1", "cdr", or whatever else an MCAP says ("json", "protobuf")
    raw : what the format keeps about it (definition, md5sum, callerid, latching, QoS, type hash); opaque elsewhere
    """

    id: int
    topic: str
    msgtype: str
    encoding: str
    raw: Any = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, slots=True)
class Message:
    """A message that was not in the bag before; it is written behind the messages of the block that carries it."""

    channel: int
    log_ns: int
    data: bytes


@dataclass(slots=True)
class Block:
    """Messages that lie together.

    data : (size,) uint8, writable; the decompressed chunk
    table : (n,) of dtype TABLE
    raw : what the format needs to write the block back as it was (compression, record framing, non-message records)
    added : messages to append, in order
    ends : where the chunks end that the block was joined from; none of a block that is one chunk
    """

    data: NDArray[np.uint8]
    table: NDArray[np.void]
    raw: Any = None
    added: list[Message] = field(default_factory=list)
    ends: tuple[int, ...] = ()

    def present(self) -> set[int]:
        """Return the channels that its messages are of."""
        channels = self.table["channel"]
        if channels.max(initial=0) > _SMALL:
            return set(channels.tolist())
        return set(np.flatnonzero(np.bincount(channels)).tolist())


class Framing:
    """How a block stood in its file; chunks that follow each other may stand as one block."""

    __slots__ = ()

    def goes_on_with(self, other: object) -> bool:  # noqa: ARG002 - what can be joined says so
        """Tell whether this and another block are chunks that are written back in the same way."""
        return False

    def joined(self, behind: list[Any], begins: list[int]) -> Framing:  # noqa: ARG002 - as above
        """Return how this block and those behind it stand as one, in whose data they begin there."""
        return self


@dataclass(frozen=True, slots=True)
class PartFraming:
    """What is raw of a block of a bag of several files.

    part : index of the file the block came from
    own : the block as that file has it, with that file's channels
    """

    part: int
    own: Block


@dataclass(frozen=True, slots=True)
class PartContents:
    """What a written file of a bag holds.

    counts : messages by topic
    start_ns, end_ns : first and last log time, 0 and 0 where there is no message
    """

    name: str
    counts: Mapping[str, int]
    start_ns: int
    end_ns: int


class BagReader(Protocol):
    """An open bag.

    name : what errors call it
    paths : the files it lies in, none for a pipe
    `channels` is complete at once where `complete` is true (the input can seek); on a pipe it fills while blocks are
    read, each channel before the first block that uses it. Closing is by context manager. Whatever is wrong with the
    bag is raised as BagError.
    """

    kind: Kind
    name: str
    paths: list[Path]
    complete: bool
    channels: Mapping[int, Channel]

    @property
    def count(self) -> int:
        """Return how many messages the last pass has given."""

    @property
    def losses(self) -> list[str]:
        """Return what could not be read in the last pass, one sentence each, where recovery was asked for."""

    def blocks(self, only: Container[int] | None = None) -> Iterator[Block]:
        """Yield the blocks in file order, each with a buffer of its own: several are held at once.

        only : ids of channels that are wanted; the bytes of others' messages may be left out where that is cheaper,
            and their length is 0 then
        """

    def definition(self, channel: Channel) -> Definition:
        """Return what the bag says of a channel's type."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def require_all(name: str, reader: BagReader, written: int, added: int) -> None:
    """Refuse an output that has not as many messages as the input gave and were added.

    name : of the output
    """
    if written != reader.count + added:
        raise BagError(
            f"{name}: {reader.count} messages were read and {added} added, but {written} written; nothing is kept: "
            "this is a fault of odomcorrupt, please report it"
        )


class BagWriter(Protocol):
    """A bag being written beside its final name: it appears when the context ends without an error, or never.

    keeps_rest : whether messages that are never passed to `write` are in the bag all the same: a sqlite3 file is
        copied, so only what may change needs to be read (`blocks(only=...)`)
    """

    keeps_rest: bool

    def add_channel(self, topic: str, msgtype: str, like: Channel) -> Channel:
        """Add a channel that is published like another one (encoding, QoS, latching); its id is fresh."""

    def provenance(self, name: str, items: Mapping[str, str]) -> None:
        """Say how the bag came about, where its format has a place for that; ROS 1 has none."""

    def write(self, block: Block) -> None:
        """Write a block, its added messages behind its own; it must stay as it is where threads compress."""

    def settle(self) -> None:
        """Wait until what was passed to `write` is written: its blocks may then change."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...
