"""Schema and channel records of an MCAP being written, from an MCAP, another format, or added."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt import __version__
from odomcorrupt.bags.block import Channel
from odomcorrupt.bags.definition import retyped, with_common_text
from odomcorrupt.bags.mcap.reader import McapReader
from odomcorrupt.bags.mcap.records import ChannelRecord, SchemaRecord, string
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, Definition

_LAST_ID = 0xFFFF
_LAST_FOREIGN_ID = 0xFFFFFFFF


class ChannelTable:
    """Ids and records of the channels and schemas of an output, and which of them are written.

    Ids of an MCAP's own channels are kept. New ones count down from the last, since on a pipe channels yet to come
    count up from the first.
    """

    def __init__(self, reader: BagReader) -> None:
        self._reader = reader
        self._native = reader if isinstance(reader, McapReader) else None
        self._schemas: dict[int, SchemaRecord] = {}
        self._channels: dict[int, ChannelRecord] = {}
        self._ids: dict[int, int] = {}
        self._waiting: set[int] = set()

    def header(self) -> bytes:
        """Return the content of the header record: the input's, or a new one with its profile."""
        if self._native:
            return self._native.header
        return string("ros1" if self._reader.kind == "ros1" else "ros2") + string(f"odomcorrupt {__version__}")

    def add(self, topic: str, msgtype: str, like: Channel) -> Channel:
        """Add a channel with the settings of another one; return it."""
        return self.add_defined(topic, msgtype, like.encoding, retyped(self._reader, msgtype, like))

    def add_defined(self, topic: str, msgtype: str, encoding: str, definition: Definition) -> Channel:
        """Add a channel with a given definition; return it."""
        identifier = _LAST_ID if self._native else _LAST_FOREIGN_ID
        while identifier in self._ids or identifier in self._reader.channels:
            identifier -= 1
        channel = Channel(identifier, topic, msgtype, encoding)
        self._register(channel, definition)
        return channel

    def written_id(self, channel: int) -> int:
        """Return the id under which a channel of the reader, or an added one, is written."""
        if channel in self._ids:
            if self._native and channel in self._native.channels:
                raise BagError(f"{self._native.name}: channel {channel} appeared after its id was given to a new topic")
            return self._ids[channel]
        if channel not in self._reader.channels:
            raise BagError(f"channel {channel}: is neither in the bag nor added to it")
        if self._native:
            return channel
        return self._register(self._reader.channels[channel], self._reader.definition(self._reader.channels[channel]))

    def translate(self, channels: NDArray[np.uint32]) -> NDArray[np.uint32]:
        """Return the ids (n,) under which channels (n,) are written."""
        known, places = np.unique(channels, return_inverse=True)
        return np.array([self.written_id(one) for one in known.tolist()], dtype=np.uint32)[places]

    def take_records(self, written: NDArray[np.uint32]) -> bytes:
        """Return the schema and channel records that must precede messages of these written ids."""
        needed = self._waiting.intersection(written.tolist()) if self._waiting else set()
        self._waiting -= needed
        return b"".join(self._pack_schema_of(one) + self._channels[one].pack() for one in sorted(needed))

    def packed(self) -> tuple[list[bytes], list[bytes]]:
        """Return all schema records and all channel records, for the summary."""
        schemas, channels = dict(self._schemas), dict(self._channels)
        if self._native:
            schemas = {**self._native.schemas, **schemas}
            channels = {one.id: one.raw for one in self._native.channels.values()} | channels
        return [one.pack() for one in schemas.values()], [one.pack() for one in channels.values()]

    def topic(self, written: int) -> str:
        """Return the topic that is written under an id."""
        if self._native and written in self._native.channels:
            return self._native.channels[written].topic
        return self._channels[written].topic

    def _register(self, channel: Channel, definition: Definition) -> int:
        identifier = channel.id if self._native else len(self._ids)
        if identifier > _LAST_ID:
            raise BagError(f"{channel.topic}: is topic number {identifier}; an MCAP holds {_LAST_ID + 1}")
        self._ids[channel.id] = identifier
        if not definition.text and channel.encoding in ("ros1", "cdr"):
            # Old ROS 2 bags keep no definitions, but without one nothing reads an MCAP's messages.
            definition = with_common_text(definition, channel.msgtype, channel.encoding)
        schema = self._schema_id(definition)
        self._channels[identifier] = ChannelRecord(
            identifier, schema, channel.topic, channel.encoding, definition.metadata
        )
        self._waiting.add(identifier)
        return identifier

    def _schema_id(self, definition: Definition) -> int:
        if not definition.name:
            return 0
        wanted = (definition.name, definition.encoding, definition.text)
        known = {**(self._native.schemas if self._native else {}), **self._schemas}
        for schema in known.values():
            if schema[1:] == wanted:
                return schema.id
        identifier = _LAST_ID if self._native else len(known) + 1
        while identifier in known:
            identifier -= 1
        self._schemas[identifier] = SchemaRecord(identifier, *wanted)
        return identifier

    def _pack_schema_of(self, channel: int) -> bytes:
        schema = self._schemas.get(self._channels[channel].schema)
        return schema.pack() if schema else b""
