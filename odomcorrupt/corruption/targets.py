"""Selection of the messages that the correction moves: topics, frames, TF edges."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from odomcorrupt.errors import TopicError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from odomcorrupt.bags.block import Channel
    from odomcorrupt.bags.messages import Item

__all__ = [
    "ODOMETRY",
    "TRANSFORMS",
    "Frames",
    "Side",
    "find_odometry",
    "localisation_side_of",
    "plain",
    "resolve_frames",
    "says_truth",
    "side_of",
]

ODOMETRY = "nav_msgs/msg/Odometry"
TRANSFORMS = frozenset({"tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"})
ENCODINGS = frozenset({"cdr", "ros1"})

GLOBAL_FRAMES = frozenset({"map", "world", "earth", "utm"})
"""Frames above odom, whatever namespace they carry: an edge between odom and one of them is localisation."""

Side = Literal["left", "right"]


@dataclass(frozen=True, slots=True)
class Frames:
    """The odom and base frames, without leading slashes; base is None where it is unknown."""

    odom: str
    base: str | None


def plain(name: str) -> str:
    """Return a frame or topic name without leading slashes, for comparisons."""
    return name.lstrip("/")


_TRUTH = re.compile(r"truth|(^|[/_])gt([/_]|$)|mocap|vicon|optitrack|motion_capture|qualisys")


def says_truth(topic: str) -> bool:
    """Return whether a topic's name marks it as ground truth, which the correction must not move."""
    return bool(_TRUTH.search(topic.lower()))


def find_odometry(channels: Iterable[Channel], asked: str | None, bag: str) -> str:
    """Return the topic of the odometry source.

    Raises
    ------
    TopicError
        If there is none, or several and none was chosen.

    """
    channels = tuple(channels)
    topics = sorted({c.topic for c in channels if c.msgtype == ODOMETRY and c.encoding in ENCODINGS})
    found = ", ".join(sorted({c.topic for c in channels})) or "no topic at all"
    if asked is not None:
        same = [topic for topic in topics if plain(topic) == plain(asked)]
        if same:
            return same[0]
        kinds = sorted({f"{c.msgtype} in {c.encoding}" for c in channels if plain(c.topic) == plain(asked)})
        if kinds:
            raise TopicError(f"{bag}: {asked} is {', '.join(kinds)}; --odom-topic must name a nav_msgs/Odometry")
        offer = f"nav_msgs/Odometry is on {', '.join(topics)}" if topics else f"found {found}"
        raise TopicError(f"{bag}: no topic {asked} ({offer}); name another one with --odom-topic")
    if not topics:
        way_out = "there is nothing to corrupt"
        if any(c.msgtype in TRANSFORMS for c in channels):
            way_out = "to corrupt TF alone, name its edge with --odom-frame and --base-frame"
        raise TopicError(f"{bag}: no nav_msgs/Odometry topic (found {found}); {way_out}")
    if len(topics) > 1:
        raise TopicError(
            f"{bag}: {len(topics)} nav_msgs/Odometry topics ({', '.join(topics)}); name the one that drives the "
            "model with --odom-topic"
        )
    return topics[0]


def resolve_frames(item: Item, topic: str, *, odom_frame: str | None, base_frame: str | None) -> Frames:
    """Return the frames of the odometry source, or those requested.

    Raises
    ------
    TopicError
        If the odometry's frame is a global one, and no odom frame was requested.

    """
    stated = plain(item.frame_id)
    if odom_frame is None and (not stated or _last(stated) in GLOBAL_FRAMES):
        raise TopicError(
            f"{topic}: its messages are in frame {item.frame_id!r}, which is not an odometry frame; name the frame "
            "that is to drift with --odom-frame"
        )
    base = plain(base_frame if base_frame is not None else item.child_frame_id)
    return Frames(stated if odom_frame is None else plain(odom_frame), base or None)


def side_of(parent: str, child: str, frames: Frames) -> Side | None:
    """Return the side from which the correction acts on the transform parent -> child; None where it does not.

    Edges between odom and its ancestors are localisation and are not moved. Of the edges that end in odom, only that
    from base is odometry (inverted).
    """
    parent, child = plain(parent), plain(child)
    if parent == frames.odom and _last(child) not in GLOBAL_FRAMES:
        return "left"
    if child == frames.odom and frames.base is not None and parent == frames.base:
        return "right"
    return None


def localisation_side_of(parent: str, child: str, frames: Frames) -> Side | None:
    """Return the side from which the correction acts on localisation edges, so that map -> base stays true."""
    if side_of(parent, child, frames) is not None:
        return None
    if plain(child) == frames.odom:
        return "right"
    return "left" if plain(parent) == frames.odom else None


def _last(frame: str) -> str:
    return frame.rsplit("/", 1)[-1]
