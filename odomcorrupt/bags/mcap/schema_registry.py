"""Registry of the schemas and channels read so far from an MCAP, and its chunks as blocks."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.block import Block, Channel, Definition, without
from odomcorrupt.bags.chunk import Chunk
from odomcorrupt.bags.mcap.chunk import Loose, McapFraming
from odomcorrupt.bags.mcap.chunk_messages import read_contents
from odomcorrupt.bags.mcap.records import CHANNEL, SCHEMA, ChannelRecord, SchemaRecord
from odomcorrupt.bags.mcap.resync import whole_records
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.bags.mcap.chunk_messages import Record


class SchemaRegistry:
    """Schemas and channels of a file or pipe, by id.

    name : name of the file in error messages
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.schemas: dict[int, SchemaRecord] = {}
        self.channels: dict[int, Channel] = {}

    def register(self, opcode: int, content: bytes) -> None:
        """Register a schema or channel; a repetition must be identical."""
        if opcode == SCHEMA:
            schema = SchemaRecord.parse(content, self.name)
            if self.schemas.setdefault(schema.id, schema) != schema:
                raise BagError(f"{self.name}: schema {schema.id} is defined twice, differently; damaged bag")
            return
        channel = ChannelRecord.parse(content, self.name)
        if channel.id in self.channels and self.channels[channel.id].raw != channel:
            topics = f"{self.channels[channel.id].topic} and {channel.topic}"
            raise BagError(f"{self.name}: channel {channel.id} is defined twice, differently ({topics}); damaged bag")
        if channel.schema and channel.schema not in self.schemas:
            raise BagError(
                f"{self.name}: {channel.topic} has schema {channel.schema}, which is not defined; damaged bag"
            )
        name = self.schemas[channel.schema].name if channel.schema else ""
        package, _, leaf = name.partition("/")
        msgtype = f"{package}/msg/{leaf}" if leaf and "/" not in leaf else name
        self.channels.setdefault(channel.id, Channel(channel.id, channel.topic, msgtype, channel.encoding, raw=channel))

    def defines(self, content: bytes) -> bool:
        """Return whether the schema of a channel record is known."""
        schema = ChannelRecord.parse(content, self.name).schema
        return schema == 0 or schema in self.schemas

    def definition(self, channel: Channel) -> Definition:
        """Return the file's definition of a channel's type."""
        raw: ChannelRecord = channel.raw
        schema = self.schemas.get(raw.schema, SchemaRecord(0, "", "", b""))
        return Definition(schema.name, schema.encoding, schema.data, raw.metadata)

    def block(self, part: Chunk | Loose) -> Block:
        """Return a chunk, or messages outside chunks, as a block; BagError for a message of an unknown channel."""
        if isinstance(part, Chunk):
            contents = read_contents(part.data, part.indexes, part.what)
            for other in contents.others:
                self._learn_within(part.data, other)
            places = () if part.place is None else (part.place,)
            block = Block(part.data, contents.table, McapFraming("chunk", part.codec), places=places)
            what = part.what
        else:
            for opcode, content in part.others:
                self.register(opcode, content)
            block, what = part.block(), f"{self.name}: messages outside chunks"
        unknown = block.present() - self.channels.keys()
        if unknown:
            raise BagError(f"{what}: messages of channel {min(unknown)}, which the bag does not define; damaged bag")
        return block

    def salvaged(self, part: Chunk | Loose) -> Block:
        """Return the intact messages of a chunk, or of messages outside chunks."""
        data = part.data if isinstance(part, Chunk) else np.frombuffer(part.data, dtype=np.uint8)
        data = whole_records(data)
        contents = read_contents(data, [], "")
        for other in contents.others:
            # An unreadable one matters only if messages use it.
            with suppress(BagError):
                self._learn_within(data, other)
        framing = McapFraming("chunk", part.codec) if isinstance(part, Chunk) else McapFraming("loose")
        unknown = np.array([number not in self.channels for number in contents.table["channel"].tolist()], dtype=bool)
        return without(Block(data, contents.table, framing), unknown)

    def _learn_within(self, data: NDArray[np.uint8], other: Record) -> None:
        """Register a record in a chunk's data if it is a schema or channel."""
        if other.opcode in (SCHEMA, CHANNEL):
            self.register(other.opcode, data[other.start : other.end].tobytes())
