"""The TF tree, and the path through it from one frame to another."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from odomcorrupt.bags.messages import locate
from odomcorrupt.errors import RecordingError, TopicError
from odomcorrupt.study.io.address import plain
from odomcorrupt.study.io.topic_selection import near

if TYPE_CHECKING:
    from collections.abc import Iterable

    from odomcorrupt.bags.block import BagReader, Channel
    from odomcorrupt.study.io.address import Address

__all__ = ["Edge", "Tree", "read_tree"]

_MAX_EDGES = 100_000


class Edge(NamedTuple):
    """A transform from parent to child, without leading slashes."""

    parent: str
    child: str


@dataclass(frozen=True, slots=True)
class Tree:
    """Edges of a bag's TF topics, moving and static."""

    moving: frozenset[Edge]
    static: frozenset[Edge]

    @property
    def edges(self) -> frozenset[Edge]:
        """All edges."""
        return self.moving | self.static

    def way(self, address: Address, place: str) -> list[tuple[Edge, bool]]:
        """Return the edges from parent to child, each with a flag for traversal from child to parent.

        Raises
        ------
        TopicError
            If a frame does not exist, or the two frames are not connected.

        """
        frames = {frame for edge in self.edges for frame in edge}
        if not frames:
            raise TopicError(f"{place}: {address.topic} holds no transform; name another topic")
        text = plain(address.frames)
        cuts = [i for i, letter in enumerate(text) if letter == "."]
        pairs = [(plain(text[:i]), plain(text[i + 1 :])) for i in cuts]
        parent, child = next(((p, c) for p, c in pairs if p in frames and c in frames), pairs[0])
        for frame in (parent, child):
            if frame not in frames:
                raise TopicError(f"{place}: no frame {frame} on {address.topic} ({near(frame, frames)})")
        if parent == child:
            raise TopicError(f"{place}: {address} names {parent} twice; name two frames")
        found = self._walk(parent, child)
        if found is None:
            raise TopicError(f"{place}: nothing on {address.topic} leads from {parent} to {child}: two separate trees")
        return found

    def _walk(self, parent: str, child: str) -> list[tuple[Edge, bool]] | None:
        neighbours: dict[str, list[tuple[str, Edge, bool]]] = {}
        for edge in sorted(self.edges):
            neighbours.setdefault(edge.parent, []).append((edge.child, edge, False))
            neighbours.setdefault(edge.child, []).append((edge.parent, edge, True))
        came: dict[str, tuple[str, Edge, bool]] = {}
        waiting = deque([parent])
        while waiting and child not in came:
            here = waiting.popleft()
            for there, edge, back in neighbours.get(here, []):
                if there not in came and there != parent:
                    came[there] = (here, edge, back)
                    waiting.append(there)
        if child not in came:
            return None
        way = []
        at = child
        while at != parent:
            at, edge, back = came[at]
            way.append((edge, back))
        return way[::-1]


def read_tree(reader: BagReader, moving: Iterable[Channel], static: Iterable[Channel]) -> Tree:
    """Return the edges on channels of a bag, consuming the reader."""
    found: dict[bool, set[Edge]] = {False: set(), True: set()}
    channels = [(c, False) for c in moving] + [(c, True) for c in static]
    for block in reader.blocks():
        for channel, still in channels:
            for layout in locate(block, channel):
                found[still] |= {Edge(plain(i.frame_id), plain(i.child_frame_id)) for i in layout.items}
                if len(found[still]) > _MAX_EDGES:
                    raise RecordingError(f"{channel.topic}: more than {_MAX_EDGES} edges; this is no robot's TF")
    return Tree(frozenset(found[False]), frozenset(found[True] - found[False]))
