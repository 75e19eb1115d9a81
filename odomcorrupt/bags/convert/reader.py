"""Conversion of a bag between the generations of ROS while it is read, and topics left out of it."""

from __future__ import annotations

import re
import struct
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

from odomcorrupt.bags.block import Channel, Definition
from odomcorrupt.bags.convert.rewritten import RewrittenReader, Rule
from odomcorrupt.bags.messages import TRANSFORMS, locate, read_template
from odomcorrupt.errors import BagError, TopicError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from odomcorrupt.bags.block import BagReader
    from odomcorrupt.bags.convert.message_types import Generation, MessageType


def split_edge(asked: str, channels: Iterable[Channel] | None) -> tuple[str, frozenset[tuple[str, str]]]:
    """Return the topic of "TOPIC" or "TOPIC:PARENT.CHILD", and the edges that the rest may mean (none for a topic).

    Frames may contain dots, so that there may be several. Without leading slashes.

    channels : those of the bag; None for a pipe, where they are not known yet

    Raises
    ------
    TopicError
        If the bag has no such topic, or an edge of another type than TF is meant.
    """
    known = {channel.topic: channel.msgtype for channel in channels or ()}
    names = {topic.lstrip("/"): topic for topic in known}
    if asked.lstrip("/") in names or (channels is None and ":" not in asked):
        return asked.lstrip("/"), frozenset()
    topic, colon, edge = asked.lstrip("/").rpartition(":")
    pairs = frozenset((edge[:i].lstrip("/"), edge[i + 1 :].lstrip("/")) for i, c in enumerate(edge) if c == ".")
    if not (colon and pairs and (channels is None or (topic in names and known[names[topic]] in TRANSFORMS))):
        raise TopicError(
            f"--exclude-topic {asked}: the input has no such topic (it has {', '.join(sorted(known))}); name one of "
            "these, or an edge of TF as in /tf:map.odom"
        )
    return topic, pairs


def without_edges(data: bytes, channel: Channel, edges: frozenset[tuple[str, str]]) -> bytes | None:
    """Return a serialised TFMessage without some edges; None if nothing is left of it.

    edges : (parent, child) frames without leading slashes
    """
    template = read_template(data, channel.topic, channel.msgtype, channel.encoding)
    kept = [one for one in template.items if (one.frame_id.lstrip("/"), one.child_frame_id.lstrip("/")) not in edges]
    if len(kept) == len(template.items):
        return data
    ros1, order = channel.encoding == "ros1", template.order
    # XCDR2 aligns numbers of eight bytes to four
    short, long = (1, 1) if ros1 else (4, 8 if data[1] <= 1 else 4)
    body = bytearray(struct.pack(order + "I", len(kept)))
    for item in kept:
        body += b"\0" * (-len(body) % short) + data[item.stamp - 4 * ros1 : item.stamp + 8]
        at = item.stamp + 8
        for _ in range(2):
            at += -at % short
            (length,) = struct.unpack_from(order + "I", data, at)
            body += b"\0" * (-len(body) % short) + data[at : at + 4 + length]
            at += 4 + length
        start, _ = item.fields["position"]
        body += b"\0" * (-len(body) % long) + data[start : start + 56]
    return data[: 0 if ros1 else 4] + bytes(body) if kept else None


_GENERATIONS: Mapping[str, Generation] = {"ros1": 1, "cdr": 2}
_NAMED = 4
"""Topics named in an error."""
_FORBIDDEN = re.compile(r"[^A-Za-z0-9_/]+")
_ROS2_NAME = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
"""Names of topics in ROS 2, as rmw_validate_full_topic_name(3) has them."""


def ros2_name(topic: str) -> str:
    """Return a name that ROS 2 allows: other characters become _, which also precedes a digit; empty parts go."""
    parts = [part for part in _FORBIDDEN.sub("_", topic).split("/") if part]
    named = "/".join(f"_{part}" if part[0].isdigit() else part for part in parts)
    return ("/" if topic.startswith("/") else "") + (named or "_")


class ConvertedReader(RewrittenReader):
    """A bag read as one of another generation of ROS.

    ros : generation of the messages; None leaves all as they are
    strict : whether messages that belong to no generation are refused
    exclude : topics left out, or edges of TF, "TOPIC:PARENT.CHILD"
    rename : "OLD=NEW" for topics that get another name; those of ROS 1 that ROS 2 forbids get one by `ros2_name`
    """

    def __init__(
        self, reader: BagReader, ros: Generation | None, *, strict: bool = False, exclude: Sequence[str] = (), rename:
        Sequence[str] = (), recover: bool = False, scan_every: int = 1,
    ) -> None:  # fmt: skip
        # a pipe states its profile before its channels
        stated = "ros1" if reader.kind == "ros1" or getattr(reader, "header", b"")[4:8] == b"ros1" else ""
        encodings = {one.encoding for one in reader.channels.values()} or {stated}
        ros1 = ros == 1 or (ros is None and encodings == {"ros1"})
        super().__init__(reader, "ros1" if ros1 else "sqlite3", recover=recover, scan_every=scan_every)
        self._ros = ros
        self._strict = strict
        known = reader.channels.values() if reader.complete else None
        self._exclude: dict[str, frozenset[tuple[str, str]]] = {}
        for one in exclude:
            topic, edges = split_edge(one, known)
            before = self._exclude.get(topic, edges)
            self._exclude[topic] = before | edges if before and edges else frozenset()
        self._edges_left_out = 0
        self._rename: dict[str, str] = {}
        topics = sorted({channel.topic for channel in known or ()})
        for words in rename:
            old, _, new = words.rpartition("=")
            if not old or not new or (ros != 1 and not ros1 and not _ROS2_NAME.fullmatch(new)):
                raise BagError(
                    f"--rename {words}: write OLD=NEW, a topic and its new name, which has letters, digits, _ and / in "
                    "ROS 2, and no digit first"
                )
            if reader.complete and old.lstrip("/") not in {topic.lstrip("/") for topic in topics}:
                raise TopicError(
                    f"--rename {words}: {self.name} has no such topic (it has {', '.join(topics)}); name one of these"
                )
            self._rename[old.lstrip("/")] = new
        self._topics: dict[str, str] = {}
        self._first: dict[tuple[str, str], int] = {}
        self._types: dict[tuple[str, str, bytes], MessageType] = {}
        if reader.complete:
            self._require_edges({one: split for one in exclude if (split := split_edge(one, known))[1]})
            self._require_convertible()
            self._require_distinct()

    @property
    def remarks(self) -> list[str]:
        """What the output's types cannot hold, one sentence for each type, and names that it cannot have."""
        fewer = [one for one in self._types.values() if one.lost]
        lost = {f"{one.msgtype} loses {', '.join(one.lost)}: ROS {self._ros} has no such field" for one in fewer}
        names = self._topics.items()
        forbidden = [f"{old} is now {new}" for old, new in names if old != new and old.lstrip("/") not in self._rename]
        said = [*getattr(self.reader, "remarks", ()), *sorted(lost)]
        if forbidden:
            said.append(f"ROS 2 forbids names of topics: {', '.join(forbidden)}; --rename OLD=NEW chooses others")
        edges = ", ".join(sorted(topic for topic, edges in self._exclude.items() if edges))
        if edges and not self._edges_left_out:
            said.append(f"/{edges}: no transform of the edge to leave out was found")
        return said

    def renamed(self, topic: str) -> str:
        """Return the name that a topic of the input has here."""
        return self._rename.get(topic.lstrip("/")) or self._topics.get(topic, topic)

    def _topic(self, channel: Channel) -> str:
        """Return the name of a channel's topic here, which no other topic has."""
        topic = channel.topic
        if topic not in self._topics:
            new = self._rename.get(topic.lstrip("/"), topic)
            if new == topic and self._ros == 2 and channel.encoding == "ros1" and not _ROS2_NAME.fullmatch(topic):
                new = ros2_name(topic)
                taken = {*self._topics.values(), *(one.topic for one in self.reader.channels.values())}
                while new in taken:
                    new += "_"
            self._topics[topic] = new
        return self._topics[topic]

    def rule(self, channel: Channel) -> Rule | None:
        """Return what becomes of a channel."""
        edges = self._exclude.get(channel.topic.lstrip("/"))
        if edges is None:
            return self._converted(channel)
        return self._without_edges(channel, self._converted(channel), edges) if edges else None

    def _without_edges(self, channel: Channel, rule: Rule, edges: frozenset[tuple[str, str]]) -> Rule:
        def rewrite(data: memoryview) -> bytes | memoryview | None:
            left = without_edges(bytes(data), channel, edges)
            self._edges_left_out += left is None or len(left) != len(data)
            return left if left is None or rule.rewrite is None else rule.rewrite(memoryview(left))

        return rule._replace(rewrite=rewrite)

    def _converted(self, channel: Channel) -> Rule:
        """Return what becomes of a channel that is not left out."""
        definition = self.reader.definition(channel)
        topic = self._topic(channel)
        generation = _GENERATIONS.get(channel.encoding)
        if self._strict and generation is None:
            raise self._refused(channel, f"its messages are {channel.encoding or 'of no stated encoding'}")
        if self._ros is None or generation in (None, self._ros):
            return Rule(replace(channel, topic=topic), definition, None)
        try:
            new = self._type(channel.msgtype, definition)
        except BagError as error:
            raise self._refused(channel, str(error)) from error
        identifier = channel.id
        if self._ros == 2:
            # in ROS 2 a topic is recorded once, however many publishers it has
            identifier = self._first.setdefault((topic, new.msgtype), channel.id)
        converted = Channel(identifier, topic, new.msgtype, "ros1" if self._ros == 1 else "cdr", channel.raw)

        def rewrite(data: memoryview) -> bytes | memoryview | None:
            try:
                return new.convert(data)
            except BagError as error:
                raise self._refused(channel, str(error)) from error

        return Rule(converted, self._described(channel, new, definition), rewrite)

    def _type(self, msgtype: str, definition: Definition) -> MessageType:
        # the library takes a fifth of a second to import
        from odomcorrupt.bags.convert.message_types import convert_type  # noqa: PLC0415

        key = msgtype, definition.encoding, definition.text
        if key not in self._types:
            assert self._ros is not None  # noqa: S101 - nothing is converted otherwise
            self._types[key] = convert_type(msgtype, definition, self._ros)
        return self._types[key]

    def _described(self, channel: Channel, new: MessageType, definition: Definition) -> Definition:
        """Return the definition of a converted channel."""
        from odomcorrupt.bags.convert.message_types import latched_qos, stays_for_late_subscribers  # noqa: PLC0415 - YAML is slow

        if self._ros == 1:
            latched = stays_for_late_subscribers(definition.metadata.get("offered_qos_profiles", ""))
            metadata = {"md5sum": new.digest, "latching": "1" if latched else "0"}
            return Definition(new.msgtype.replace("/msg/", "/"), "ros1msg", new.text.encode(), metadata)
        # a ROS 1 topic has as many definitions as publishers
        same = [c for c in self.reader.channels.values() if (c.topic, c.msgtype) == (channel.topic, channel.msgtype)]
        latches = any(self.reader.definition(one).metadata.get("latching") == "1" for one in same)
        metadata = {"offered_qos_profiles": latched_qos() if latches else "", "topic_type_hash": new.digest}
        return Definition(new.msgtype, "ros2msg", new.text.encode(), metadata)

    def _refused(self, channel: Channel, why: str) -> BagError:
        what = f"cannot become messages of ROS {self._ros}" if self._ros else "cannot be written"
        return BagError(
            f"{self.name}: {channel.topic} {what} ({why}); leave the topic out with --exclude-topic {channel.topic}"
        )

    def _require_edges(self, asked: Mapping[str, tuple[str, frozenset[tuple[str, str]]]]) -> None:
        """Raise TopicError if TF has none of the edges that a word may mean; TF is read until each word has one."""
        met: dict[str, set[tuple[str, str]]] = {topic: set() for topic, _ in asked.values()}
        tf = [channel for channel in self.reader.channels.values() if channel.topic.lstrip("/") in met]
        missing = list(asked)
        for block in self.reader.blocks({channel.id for channel in tf}) if asked else ():
            for channel in tf:
                pairs = ((i.frame_id, i.child_frame_id) for layout in locate(block, channel) for i in layout.items)
                met[channel.topic.lstrip("/")] |= {(a.lstrip("/"), b.lstrip("/")) for a, b in pairs}
            missing = [one for one, (topic, edges) in asked.items() if edges.isdisjoint(met[topic])]
            if not missing:
                return
        for one in missing:
            has = ", ".join(f"/{asked[one][0]}:{parent}.{child}" for parent, child in sorted(met[asked[one][0]]))
            raise TopicError(f"--exclude-topic {one}: the input has no such edge (it has {has}); name one of these")

    def _require_convertible(self) -> None:
        """Raise BagError for topics that cannot be converted, before anything is written."""
        failed: dict[str, BagError] = {}
        for number, channel in self.reader.channels.items():
            try:
                self.rule_of(number)
            except BagError as error:
                failed.setdefault(channel.topic, error)
        if len(failed) > 1:
            named = ", ".join(list(failed)[:_NAMED]) + (", ..." if len(failed) > _NAMED else "")
            first = str(next(iter(failed.values()))).partition(" (")[2].partition("); leave the topic")[0]
            flags = " ".join(f"--exclude-topic {topic}" for topic in list(failed)[:_NAMED])
            raise BagError(
                f"{self.name}: {len(failed)} topics cannot become messages of ROS {self._ros}: {named} (the first: "
                f"{first}); leave them out with {flags}"
            )
        if failed:
            raise next(iter(failed.values()))

    def _require_distinct(self) -> None:
        """Raise BagError for two topics of one name."""
        topics = self._topics.keys() & {one.topic for one in self.reader.channels.values()}
        names = sorted((self._topics[topic], topic) for topic in topics)
        for (new, first), (same, second) in pairwise(names):
            if new == same:
                raise BagError(f"--rename: {first} and {second} would both be {new}; choose another name for one")
