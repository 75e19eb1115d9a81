"""Edges of TF that are left out of a converted bag."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from odomcorrupt.bags.layouts import read_template
from odomcorrupt.errors import TopicError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from odomcorrupt.bags.block import Channel

TRANSFORMS = frozenset({"tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"})


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
    ros1, order = channel.encoding == "ros1", ">" if template.big_endian else "<"
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
