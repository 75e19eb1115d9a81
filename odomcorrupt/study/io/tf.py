"""Reading of a TF edge from a bag: map.base_link is composed of the edges that connect the two frames.

The bag is read twice: first for the tree, then for the edges on the path only, so that other joints cost nothing. The
moving edge with the most samples gives the stamps; the others are interpolated, and static edges hold at all times.

A localisation (AMCL, SLAM) corrects the odometry intermittently and repeats each correction until the next one. Between
two corrections such a truth equals the odometry and would always agree with it, so only the poses at its corrections
are used.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.bags.messages import gather, gather_stamps_ns, locate
from odomcorrupt.errors import RecordingError, TopicError
from odomcorrupt.study.io.localisation import CORRECTIONS, REPEATED, SPARSE_HZ, ahead_s
from odomcorrupt.study.io.raw_trajectory import FAR_M, Samples, order_of
from odomcorrupt.study.io.se3 import Transforms, check_order, composed, headings, interpolated, inverted, unit
from odomcorrupt.study.io.topic_selection import near, plain

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, Block, Channel
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.topic_selection import Address

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
                    raise RecordingError(f"{channel.topic}: more than {_MAX_EDGES} edges; this is not a robot's TF")
    return Tree(frozenset(found[False]), frozenset(found[True] - found[False]))


_MOVES = np.array([1e-4, 1e-4])
"""Metres, radians: if the other edges move by more, a repeated correction means that there was no new one."""
_SLOWER = 5.0
"""A localisation that sends only its corrections is slower than the odometry by at least this factor."""
_AHEAD_S = (0.02, 5.0)
"""Range of the time by which a localisation's stamps may be ahead of the log times, seconds."""


class _Ordered(NamedTuple):
    stamps_ns: NDArray[np.int64]
    logs_ns: NDArray[np.int64]
    poses: Transforms
    notes: tuple[str, ...]

    def between(self, stamps_ns: NDArray[np.int64]) -> Transforms:
        """Return the transforms at other stamps (n,), constant beyond the ends."""
        origin = self.stamps_ns[0]
        own_s, at_s = ((s - origin).astype(np.float64) * 1e-9 for s in (self.stamps_ns, stamps_ns))
        return interpolated(own_s, self.poses, np.clip(at_s, own_s[0], own_s[-1]))


class EdgeReader:
    """Collector of the edges that connect the two frames of an address, block by block."""

    def __init__(self, place: str, address: Address, channels: list[Channel], tree: Tree) -> None:
        self.place = f"{place}: {address}"
        self.address = address
        self.channels = channels
        self.tree = tree
        self.way = tree.way(address, place)
        self.collected: dict[Edge, list[tuple[NDArray[np.int64], NDArray[np.int64], Array]]] = {
            edge: [] for edge, _ in self.way
        }

    def take(self, block: Block) -> None:
        """Append the transforms of these edges in a block."""
        for channel in self.channels:
            for layout in locate(block, channel):
                for item in layout.items:
                    here = self.collected.get(Edge(plain(item.frame_id), plain(item.child_frame_id)))
                    if here is None:
                        continue
                    pose = (gather(block, layout, item, "position"), gather(block, layout, item, "orientation"))
                    logs_ns = block.table["log_ns"][layout.rows]
                    here.append((gather_stamps_ns(block, layout, item), logs_ns, np.concatenate(pose, axis=1)))

    def samples(self) -> Samples:
        """Return the composed poses.

        Raises
        ------
        RecordingError
            If no edge on the path moves, or the moving edges have no time in common.
        """
        edges = {edge: self._edge(edge) for edge, _ in self.way}
        moving = {edge: e for edge, e in edges.items() if edge in self.tree.moving and len(e.stamps_ns) > 1}
        names = ", ".join(f"{e.parent}.{e.child}" for e, _ in self.way)
        if not moving:
            raise RecordingError(f"{self.place}: no edge on the way ({names}) moves; name two frames that do")
        first, last = max(e.stamps_ns[0] for e in moving.values()), min(e.stamps_ns[-1] for e in moving.values())
        stamps = max(moving.values(), key=lambda e: len(e.stamps_ns)).stamps_ns
        stamps = stamps[(stamps >= first) & (stamps <= last)]
        if len(stamps) < 2:
            raise RecordingError(f"{self.place}: its edges ({names}) share no time; name frames with fewer between")
        notes = [f"{self.address}: {note}" for e in edges.values() for note in e.notes]
        found = _localisation(moving)
        if found is not None:
            edge, corrections = found
            edges[edge] = moving[edge] = corrections
            stamps = corrections.stamps_ns[(corrections.stamps_ns >= first) & (corrections.stamps_ns <= last)]
            notes.append(f"{self.address}: {edge.parent}.{edge.child}: {'; '.join(corrections.notes)}")
        total = Transforms(np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]]))
        for edge, back in self.way:
            part = edges[edge].poses
            part = edges[edge].between(stamps) if edge in moving else Transforms(part.xyz[:1], part.quat_xyzw[:1])
            total = composed(total, inverted(part) if back else part)
        if len(self.way) > 1:
            notes.append(f"{self.address}: composed of {names}")
        return Samples(
            self.place,
            str(self.address),
            self.way[0][0].child if self.way[0][1] else self.way[0][0].parent,
            stamps,
            total.xyz,
            headings(total.quat_xyzw),
            notes=tuple(notes),
            child=self.way[-1][0].parent if self.way[-1][1] else self.way[-1][0].child,
            localised=found is not None,
        )

    def _edge(self, edge: Edge) -> _Ordered:
        stamps, logs, values = (np.concatenate(part) for part in zip(*self.collected[edge], strict=True))
        values = np.concatenate((values[:, :3], unit(values[:, 3:])), axis=1)
        # comparisons with NaN are false
        good = np.asarray((np.abs(values) < FAR_M).all(axis=1))
        if not good.any():
            raise RecordingError(f"{self.place}: none of {len(good)} transforms {edge.parent}.{edge.child} is a number")
        check_order(f"{self.place}: {edge.parent}.{edge.child}", values[good][:, :3], values[good][:, 3:])
        stamps, logs = stamps[good], logs[good]
        # Static edges are repeated with arbitrary stamps.
        order = order_of(stamps, logs if edge in self.tree.moving else logs[:0])
        kept = values[good][order.rows]
        notes = order.notes if edge in self.tree.moving else ()
        return _Ordered(order.stamps_ns, logs[order.rows], Transforms(kept[:, :3], kept[:, 3:]), notes)


def _localisation(moving: Mapping[Edge, _Ordered]) -> tuple[Edge, _Ordered] | None:
    """Return the edge of a localisation with each correction once, at its time of sending; None if there is none.

    This edge repeats itself while the others move, or is rarer than they are. It must not be interpolated.
    """
    for edge, own in moving.items():
        others = [other for e, other in moving.items() if e != edge]
        new = np.any(np.diff(np.concatenate(own.poses, axis=1), axis=0) != 0.0, axis=1)
        if not others or new.sum() < CORRECTIONS:
            continue
        fastest = max(others, key=lambda other: len(other.stamps_ns))
        span_s = float(own.stamps_ns[-1] - own.stamps_ns[0]) * 1e-9
        seldom = len(new) < min(SPARSE_HZ * span_s, len(fastest.stamps_ns) / _SLOWER)
        went = np.zeros((len(new), 2))
        for other in others:
            there = other.between(own.stamps_ns)
            turned = np.abs(np.sum(there.quat_xyzw[:-1] * there.quat_xyzw[1:], axis=1))
            went[:, 0] += np.linalg.norm(np.diff(there.xyz, axis=0), axis=1)
            went[:, 1] += 2.0 * np.arccos(np.minimum(turned, 1.0))
        moves = (went > _MOVES).any(axis=1)
        if not seldom and (np.mean(~new[moves]) < REPEATED if moves.any() else True):
            continue
        rows = np.flatnonzero(np.concatenate(([True], new)))
        stamps, said = own.stamps_ns[rows], ""
        ahead = ahead_s(own.stamps_ns, own.logs_ns, (fastest.stamps_ns, fastest.logs_ns))
        if _AHEAD_S[0] < ahead < _AHEAD_S[1]:
            stamps = stamps - round(ahead * 1e9)
            said = f"; its stamps are {ahead:.2g} s later than the times of sending, which is subtracted"
        note = (
            f"a localisation on top of the odometry; the truth is taken at its {len(rows)} corrections alone: between "
            f"them it repeats the odometry{said}"
        )
        return edge, _Ordered(stamps, stamps, Transforms(own.poses.xyz[rows], own.poses.quat_xyzw[rows]), (note,))
    return None
