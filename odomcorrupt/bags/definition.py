"""Channels of an output, definitions of message types that a bag lacks, and md5sums of types."""

from __future__ import annotations

import re
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

from odomcorrupt.bags.block import Channel, Definition
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from odomcorrupt.bags.block import BagReader


class RosType(NamedTuple):
    """Definition of a type that is not in the bag.

    text : definition with those of nested types, as stored in bags
    digest : the md5sum of ROS 1, the RIHS01 type hash of ROS 2
    """

    name: str
    text: str
    digest: str


@cache  # every output of a batch asks
def ros_type(msgtype: str, encoding: str) -> RosType:
    """Return the definition of a common type, for messages of the encoding "ros1" or "cdr"."""
    # rosbags is slow to import, and only needed for a type that is not in the bag.
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: PLC0415

    store = get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_HUMBLE)
    if msgtype not in store.types and msgtype in ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"):
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", msgtype))
    if encoding not in ("ros1", "cdr") or msgtype not in store.types:
        raise BagError(f"{msgtype}: no definition is known for encoding {encoding!r}; choose a type the bag has")
    if encoding == "ros1":
        text, digest = store.generate_msgdef(msgtype, ros_version=1)
        return RosType(msgtype.replace("/msg/", "/"), text, digest)
    text, _ = store.generate_msgdef(msgtype, ros_version=2)
    return RosType(msgtype, text, store.hash_rihs01(msgtype))


def plain_text(definition: Definition) -> str:
    """Return the text of a definition as all parsers read it: with plain line ends, and constants that have a value.

    A string constant without one is the empty string; a number without one is no number, and is left out.
    """
    text = definition.text.decode(errors="replace").replace("\r\n", "\n").replace("\r", "\n")
    text = _EMPTY_STRING.sub(r"\1''", text)
    return _NO_NUMBER.sub("", text)


_EMPTY_STRING = re.compile(r"^([ \t]*w?string[ \t]+\w+[ \t]*=)[ \t]*$", re.MULTILINE)
_NO_NUMBER = re.compile(r"^[ \t]*\w+[ \t]+\w+[ \t]*=[ \t]*(#.*)?$", re.MULTILINE)


def with_common_text(definition: Definition, msgtype: str, encoding: str) -> Definition:
    """Return a definition with the text of a common type if the bag lacks it; empty for other types."""
    try:
        kind = ros_type(msgtype, encoding)
    except BagError:
        return definition
    return definition._replace(encoding="ros1msg" if encoding == "ros1" else "ros2msg", text=kind.text.encode())


def md5sum_of(msgtype: str, definition: Definition) -> str:
    """Return the ROS 1 md5sum of a type, from its definition."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: PLC0415
    from rosbags.typesys.base import TypesysError  # noqa: PLC0415

    store = get_typestore(Stores.EMPTY)
    try:
        store.register(get_types_from_msg(plain_text(definition), msgtype))
        _, digest = store.generate_msgdef(msgtype, ros_version=1)
    except (TypesysError, KeyError) as error:
        raise BagError(f"{msgtype}: has no md5sum, and its definition is incomplete: {error}") from error
    return str(digest)


_TYPED = ("md5sum", "topic_type_hash", "type")
"""Metadata that belong to the type, not to the topic."""


def retyped(reader: BagReader, msgtype: str, like: Channel) -> Definition:
    """Return the definition of a type (the bag's own, or the common one) with the QoS and callerid of a channel."""
    publisher, encoding = reader.definition(like), like.encoding
    if msgtype == like.msgtype:
        return publisher
    for other in reader.channels.values():
        if (other.msgtype, other.encoding) == (msgtype, encoding):
            found = reader.definition(other)
            typed = {key: found.metadata[key] for key in _TYPED if key in found.metadata}
            untyped = {key: value for key, value in publisher.metadata.items() if key not in _TYPED}
            return found._replace(metadata={**untyped, **typed})
    kind = ros_type(msgtype, encoding)
    values = {"md5sum": kind.digest, "topic_type_hash": kind.digest, "type": kind.name}
    metadata = {**publisher.metadata, **{key: value for key, value in values.items() if key in publisher.metadata}}
    return Definition(kind.name, "ros1msg" if encoding == "ros1" else "ros2msg", kind.text.encode(), metadata)


LAST_ID = 0xFFFF
"""Of a channel of an MCAP; a ROS 1 bag could have more."""


class OutputChannels:
    """Channels of an output: those of its reader, and added ones.

    Ids of added ones count down from the last, since on a pipe channels yet to come count up from the first.
    """

    def __init__(self, reader: BagReader, last: int = LAST_ID) -> None:
        self.reader = reader
        self.added: dict[int, tuple[Channel, Definition]] = {}
        self._last = last

    def add(self, topic: str, msgtype: str, encoding: str, definition: Definition) -> Channel:
        """Add a channel; return it with a new id."""
        number = self._last
        while number in self.added or number in self.reader.channels:
            number -= 1
        channel = Channel(number, topic, msgtype, encoding)
        self.added[number] = channel, definition
        return channel

    def described(self, number: int) -> tuple[Channel, Definition]:
        """Return a channel with the definition of its type."""
        if number in self.added:
            return self.added[number]
        if number not in self.reader.channels:
            raise BagError(f"channel {number}: is neither in the bag nor added to it")
        channel = self.reader.channels[number]
        return channel, self.reader.definition(channel)
