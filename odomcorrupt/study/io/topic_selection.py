"""Selection of a bag's channels for odometry and truth: by name (a topic, or a TF edge), or the only ones that fit."""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from odomcorrupt.bags.messages import SCAN
from odomcorrupt.corruption.odometry_source import ODOMETRY, plain, says_truth
from odomcorrupt.errors import TopicError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from odomcorrupt.bags.block import Channel


@dataclass(frozen=True, slots=True)
class Address:
    """Address of a source of poses in a bag.

    topic : topic name
    frames : "parent.child" of a TF edge, "" for a topic of poses; if frame names contain dots, the bag's frames decide
    static : topic of the static transforms, "" for /tf_static or the tf_static beside `topic`
    """

    topic: str
    frames: str = ""
    static: str = ""

    def __str__(self) -> str:
        tail = f":{self.static}" if self.static else ""
        return f"{self.topic}:{self.frames}{tail}" if self.frames else self.topic


def parse_address(text: str) -> Address:
    """Return the address that a text denotes.

    Raises
    ------
    TopicError
        If an edge lacks one of its two frames.
    """
    topic, colon, rest = text.partition(":")
    frames, _, static = rest.partition(":")
    if colon and not (frames.strip(".") and "." in frames.strip(".")):
        raise TopicError(f"{text}: names no two frames; write an edge of TF as /tf:map.base_link")
    return Address(topic, frames, static)


Role = Literal["odometry", "truth", "estimate"]

TRANSFORM = "geometry_msgs/msg/TransformStamped"
POSES = (ODOMETRY, "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped", TRANSFORM)
POSITIONS = ("geometry_msgs/msg/PointStamped", "sensor_msgs/msg/NavSatFix")
"""Message types with positions but no headings."""
EDGES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage", TRANSFORM)
"""Message types that contain TF edges."""
FLAGS: dict[Role, str] = {"odometry": "--odom", "truth": "--truth", "estimate": "--estimate"}


def near(asked: str, there: Iterable[str]) -> str:
    """Return a list of available names for an error message, closest matches first."""
    names = sorted(set(there))
    folded = {plain(name).lower(): name for name in names}
    close = [folded[n] for n in difflib.get_close_matches(plain(asked).lower(), folded, n=2)]
    found = ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "") or "nothing"
    return f"did you mean {' or '.join(close)}? found {found}" if close else f"found {found}"


def named(channels: Iterable[Channel], address: Address, place: str, role: Role) -> list[Channel]:
    """Return the channels of a named topic, one for each publisher.

    Raises
    ------
    TopicError
        If there is no such topic, or its type does not fit the role.
    """
    all_channels = list(channels)
    same = [c for c in all_channels if plain(c.topic) == plain(address.topic)]
    if not same:
        there = near(address.topic, (c.topic for c in all_channels if c.msgtype in (*POSES, *POSITIONS, *EDGES)))
        instead = ", a file with --truth-bag" if role == "truth" else ""
        raise TopicError(f"{place}: no topic {address.topic} ({there}). Name another with {FLAGS[role]}{instead}.")
    types = EDGES if address.frames else _types(role)
    good = [c for c in same if c.msgtype in types]
    if not good:
        kind = same[0].msgtype
        if kind in EDGES:
            raise TopicError(
                f"{place}: {address.topic} is TF; name one of its edges, as in {FLAGS[role]} "
                f"{address.topic}:{'odom' if role == 'odometry' else 'map'}.base_link"
            )
        way_out = ", ".join(t.replace("/msg/", "/") for t in types)
        raise TopicError(f"{place}: {address.topic} is a {kind}; {role} can be {way_out}, or an edge of TF")
    return good


def has_truth(channels: Iterable[Channel]) -> bool:
    """Return whether any topic besides one odometry could be a truth."""
    topics = {c.topic: c.msgtype for c in channels if c.msgtype in (*POSES, *POSITIONS)}
    return len(topics) > (ODOMETRY in topics.values())


def choose(channels: Iterable[Channel], place: str, role: Role, not_these: Iterable[str]) -> list[Channel]:
    """Return the channels of the only topic that fits the role.

    Raises
    ------
    TopicError
        If no topic fits, or several do; the message lists them.
    """
    taken = set(not_these)
    free = [c for c in channels if c.topic not in taken]
    types = (ODOMETRY,) if role == "odometry" else _types(role)
    fitting = {c.topic for c in free if c.msgtype in types}
    if len(fitting) > 1:
        # Of several candidates, those whose names mark them as truth are for the truth, the others for the odometry.
        said = {topic for topic in fitting if says_truth(topic) is (role == "truth")}
        fitting = said or fitting
    if len(fitting) == 1:
        topic = fitting.pop()
        return [c for c in free if c.topic == topic and c.msgtype in types]
    flag = FLAGS[role]
    if fitting:
        raise TopicError(
            f"{place}: several topics could be {role}: {', '.join(sorted(fitting))}. Name one with {flag}."
        )
    there = ", ".join(sorted({f"{c.topic} ({c.msgtype.replace('/msg/', '/')})" for c in free})) or "nothing else"
    way_out = f"Name one with {flag}"
    if any(c.msgtype in EDGES for c in free):
        way_out += f", an edge of TF as {flag} /tf:{'odom' if role == 'odometry' else 'map'}.base_link"
    if role == "truth":
        way_out += ", or the file it was recorded in with --truth-bag"
        lasers = " or ".join(sorted({f"--scan {c.topic}" for c in free if c.msgtype == SCAN}))
        way_out += f", or learn from a laser with {lasers}" if lasers else ""
        way_out += ". Drives that end where they began need no truth: fit --returns" if not lasers else ""
    raise TopicError(f"{place}: no topic that could be {role} (found {there}). {way_out}.")


def _types(role: Role) -> tuple[str, ...]:
    return (*POSES, *POSITIONS) if role == "truth" else POSES
