"""Addresses of pose sources: a topic, or a TF edge written as /tf:map.base_link (evo's notation)."""

from __future__ import annotations

from dataclasses import dataclass

from odomcorrupt.errors import TopicError

__all__ = ["Address", "parse_address", "plain"]


def plain(name: str) -> str:
    """Return a frame or topic name without leading slashes, because ROS names are the same with and without them."""
    return name.lstrip("/")


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
