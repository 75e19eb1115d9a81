"""Addresses: a topic, or an edge of TF written as /tf:map.base_link (evo's form)."""

from __future__ import annotations

from dataclasses import dataclass

from odomcorrupt.errors import TopicError

__all__ = ["Address", "parse_address", "plain"]


def plain(name: str) -> str:
    """Return a frame or topic without leading slashes: with or without, it is the same one."""
    return name.lstrip("/")


@dataclass(frozen=True, slots=True)
class Address:
    """What to read.

    topic : its name
    frames : "parent.child" of an edge, "" for a topic of poses; where frames have dots, the bag decides where to cut
    static : the topic with the edges that never move, "" for the one beside `topic` and /tf_static
    """

    topic: str
    frames: str = ""
    static: str = ""

    def __str__(self) -> str:
        tail = f":{self.static}" if self.static else ""
        return f"{self.topic}:{self.frames}{tail}" if self.frames else self.topic


def parse_address(text: str) -> Address:
    """Read an address.

    Raises
    ------
    TopicError
        Where an edge lacks one of its frames.

    """
    topic, colon, rest = text.partition(":")
    frames, _, static = rest.partition(":")
    if colon and not (frames.strip(".") and "." in frames.strip(".")):
        raise TopicError(f"{text}: names no two frames; write an edge of TF as /tf:map.base_link")
    return Address(topic, frames, static)
