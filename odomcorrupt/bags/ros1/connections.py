"""Connection records of a ROS 1 bag being written, from a ROS 1 bag, another format, or added."""

from __future__ import annotations

from typing import TYPE_CHECKING

from odomcorrupt.bags.block import Channel
from odomcorrupt.bags.definition import Definition, md5sum_of
from odomcorrupt.bags.derive_definition import retyped
from odomcorrupt.bags.ros1.reader import Ros1Reader
from odomcorrupt.bags.ros1.records import Connection
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from odomcorrupt.bags.block import BagReader

__all__ = ["Connections"]

_LAST_ID = 0xFFFF


class Connections:
    """Ids and records of the connections of an output, and which of them are written.

    Ids of the bag's own connections are kept. New ones count down, since on a pipe those yet to come count up.
    """

    def __init__(self, reader: BagReader) -> None:
        self._reader = reader
        self._native = isinstance(reader, Ros1Reader)
        self._made: dict[int, Connection] = {}
        self._waiting: set[int] = set()
        if not self._native and reader.complete:
            for channel in reader.channels.values():
                self._make(channel, reader.definition(channel))

    def add(self, topic: str, msgtype: str, like: Channel) -> Channel:
        """Add a channel with the settings of another one; return it."""
        identifier = _LAST_ID
        while identifier in self._made or identifier in self._reader.channels:
            identifier -= 1
        channel = Channel(identifier, topic, msgtype, "ros1")
        definition = self._reader.definition(like)
        if msgtype != like.msgtype:
            definition = retyped(self._reader, msgtype, "ros1", definition)
        self._make(channel, definition)
        return channel

    def take_records(self, channels: Iterable[int]) -> bytes:
        """Return the connection records that must precede messages of these channels."""
        needed: set[int] = set()
        for channel in set(channels):
            if self._native and channel in self._made and channel in self._reader.channels:
                raise BagError(f"connection {channel}: appeared after its id was given to a new topic; use a file")
            if channel not in self._made and channel not in self._reader.channels:
                raise BagError(f"channel {channel}: is neither in the bag nor added to it")
            if not self._native and channel not in self._made:
                self._make(self._reader.channels[channel], self._reader.definition(self._reader.channels[channel]))
            if channel in self._waiting:
                needed.add(channel)
        self._waiting -= needed
        return b"".join(self._made[one].pack() for one in sorted(needed))

    def packed(self) -> list[bytes]:
        """Return all connection records, for the index."""
        own = [channel.raw for channel in self._reader.channels.values()] if self._native else []
        return [one.pack() for one in [*own, *self._made.values()]]

    def _make(self, channel: Channel, definition: Definition) -> None:
        if channel.encoding != "ros1":
            raise BagError(
                f"{channel.topic}: messages are {channel.encoding}, a ROS 1 bag holds ros1 ones; write an MCAP instead"
            )
        metadata = definition.metadata
        fields = {
            "topic": channel.topic.encode(),
            "type": definition.name.encode(),
            "md5sum": (metadata.get("md5sum") or md5sum_of(channel.msgtype, definition)).encode(),
            "message_definition": definition.text,
        }
        fields |= {key: value.encode() for key, value in _publisher(definition).items()}
        self._made[channel.id] = Connection.build(channel.id, channel.topic, fields)
        self._waiting.add(channel.id)


def _publisher(definition: Definition) -> dict[str, str]:
    """Return the fields of a definition that belong to the publisher (callerid, latching), not to the type."""
    return {key: definition.metadata[key] for key in ("callerid", "latching") if key in definition.metadata}
