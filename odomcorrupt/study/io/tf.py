"""Reading of a TF edge from a bag: map.base_link is composed of the edges that connect the two frames.

The bag is read twice: first for the tree, then for the edges on the path only, so that other joints cost nothing. The
moving edge with the most samples gives the stamps; the others are interpolated, and static edges hold at all times.

A localisation (AMCL, SLAM) corrects the odometry intermittently and repeats each correction until the next one. Between
two corrections such a truth equals the odometry and would always agree with it, so only the poses at its corrections
are used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from odomcorrupt.bags.messages import gather, gather_stamps_ns, located
from odomcorrupt.bags.open import open_reader
from odomcorrupt.corruption.odometry_source import plain
from odomcorrupt.corruption.pose_faults import W_FIRST, ComponentOrder
from odomcorrupt.errors import RecordingError, TopicError
from odomcorrupt.study.io.localisation import CORRECTIONS, MOVES, REPEATED, SPARSE_HZ, ahead_s
from odomcorrupt.study.io.raw_trajectory import FAR_M, Samples, order_of
from odomcorrupt.study.io.se3 import Transforms, composed, headings, interpolated, inverted, unit
from odomcorrupt.study.io.topic_selection import EDGES, near

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import Block, Channel
    from odomcorrupt.bags.messages import Layout
    from odomcorrupt.study.io.topic_selection import Address

_MAX_EDGES = 100_000


class Edge(NamedTuple):
    """A transform from parent to child, without leading slashes."""

    parent: str
    child: str


_Way = list[tuple[Edge, bool]]
"""Edges from one frame to another, each with a flag for traversal from child to parent."""


def _frames(edges: set[Edge], address: Address, place: str) -> Edge:
    """Return the two frames of an address; the frames of the bag decide where names contain dots."""
    frames = {frame for edge in edges for frame in edge}
    if not frames:
        raise TopicError(f"{place}: {address.topic} holds no transform; name another topic")
    text = plain(address.frames)
    pairs = [Edge(plain(text[:i]), plain(text[i + 1 :])) for i, letter in enumerate(text) if letter == "."]
    found = next((pair for pair in pairs if frames.issuperset(pair)), pairs[0])
    for frame in found:
        if frame not in frames:
            raise TopicError(f"{place}: no frame {frame} on {address.topic} ({near(frame, frames)})")
    if found.parent == found.child:
        raise TopicError(f"{place}: {address} names {found.parent} twice; name two frames")
    return found


def _way(edges: set[Edge], address: Address, place: str) -> _Way:
    """Return the edges between the two frames of an address."""
    parent, child = _frames(edges, address, place)
    neighbours: dict[str, _Way] = {}
    for edge in sorted(edges):
        neighbours.setdefault(edge.parent, []).append((edge, False))
        neighbours.setdefault(edge.child, []).append((edge, True))
    came: dict[str, tuple[Edge, bool]] = {}
    waiting = [parent]
    for here in waiting:
        for edge, back in neighbours[here]:
            there = edge.parent if back else edge.child
            if there not in came and there != parent:
                came[there] = (edge, back)
                waiting.append(there)
    if child not in came:
        raise TopicError(f"{place}: nothing on {address.topic} leads from {parent} to {child}: two separate trees")
    way: _Way = []
    while child != parent:
        edge, back = came[child]
        way.append((edge, back))
        child = edge.child if back else edge.parent
    return way[::-1]


_SLOWER = 5.0
"""A localisation that sends only its corrections is slower than the odometry by at least this factor."""
_AHEAD_S = (0.02, 5.0)
"""Range of the time by which a localisation's stamps may be ahead of the log times, seconds."""


class _Ordered(NamedTuple):
    """Transforms of an edge in the order of their stamps."""

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

    def __init__(self, path: Path, place: str, address: Address, moving: list[Channel], others: list[Channel]) -> None:
        wanted = plain(address.static)
        beside = plain(address.topic).rpartition("/")[0]
        names = {wanted} if wanted else {f"{beside}/tf_static" if beside else "tf_static", "tf_static"}
        static = [c for c in others if c.msgtype in EDGES and plain(c.topic) in names and c not in moving]
        if wanted and not static:
            raise TopicError(f"{place}: no topic {address.static} with transforms; leave it out of {address}")
        self.place = f"{place}: {address}"
        self.address = address
        self.channels = [*moving, *static]
        self.moving: set[Edge] = set()
        still: set[Edge] = set()
        with open_reader(path) as reader:
            for _, channel, layout in located(reader, self.channels):
                found = still if channel in static else self.moving
                found |= {Edge(plain(i.frame_id), plain(i.child_frame_id)) for i in layout.items}
                if len(found) > _MAX_EDGES:
                    raise RecordingError(f"{channel.topic}: more than {_MAX_EDGES} edges; this is not a robot's TF")
        self.way = _way(self.moving | still, address, place)
        self.collected: dict[Edge, list[tuple[NDArray[Any], ...]]] = {edge: [] for edge, _ in self.way}

    def take(self, block: Block, layout: Layout) -> None:
        """Append the transforms of these edges in messages of a block."""
        for item in layout.items:
            here = self.collected.get(Edge(plain(item.frame_id), plain(item.child_frame_id)))
            if here is not None:
                pose = (gather(block, layout, item, "position"), gather(block, layout, item, "orientation"))
                here.append((gather_stamps_ns(block, layout, item), block.table["log_ns"][layout.rows], *pose))

    def samples(self) -> Samples:
        """Return the composed poses.

        Raises
        ------
        RecordingError
            If no edge on the path moves, or the moving edges have no time in common.
        """
        edges = {edge: self._edge(edge) for edge, _ in self.way}
        moving = {edge: e for edge, e in edges.items() if edge in self.moving and len(e.stamps_ns) > 1}
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
        total = Transforms(np.zeros((1, 3)), Rotation.identity(1))
        for edge, back in self.way:
            part = edges[edge].between(stamps) if edge in moving else edges[edge].poses.only(slice(1))
            total = composed(total, inverted(part) if back else part)
        if len(self.way) > 1:
            notes.append(f"{self.address}: composed of {names}")
        return Samples(
            self.place,
            str(self.address),
            self.way[0][0].child if self.way[0][1] else self.way[0][0].parent,
            stamps,
            total.xyz,
            headings(total.rotation.as_quat()),
            notes=tuple(notes),
            child=self.way[-1][0].parent if self.way[-1][1] else self.way[-1][0].child,
            localised=found is not None,
        )

    def _edge(self, edge: Edge) -> _Ordered:
        stamps, logs, xyz, quat_xyzw = (np.concatenate(part) for part in zip(*self.collected[edge], strict=True))
        values = np.concatenate((xyz, unit(quat_xyzw)), axis=1)
        # comparisons with NaN are false
        good = np.asarray((np.abs(values) < FAR_M).all(axis=1))
        name = f"{edge.parent}.{edge.child}"
        if not good.any():
            raise RecordingError(f"{self.place}: none of {len(good)} transforms {name} is a number")
        stamps, logs, values = stamps[good], logs[good], values[good]
        components = ComponentOrder()
        components.take(values[:, :3], values[:, 3:])
        if components.w_first:
            raise RecordingError(f"{self.place}: {name}: {W_FIRST}")
        # Static edges are repeated with arbitrary stamps.
        order = order_of(stamps, logs if edge in self.moving else logs[:0])
        poses = Transforms(values[:, :3], Rotation.from_quat(values[:, 3:])).only(order.rows)
        return _Ordered(order.stamps_ns, logs[order.rows], poses, order.notes if edge in self.moving else ())


def _localisation(moving: Mapping[Edge, _Ordered]) -> tuple[Edge, _Ordered] | None:
    """Return the edge of a localisation with each correction once, at its time of sending; None if there is none.

    This edge repeats itself while the others move, or is rarer than they are. It must not be interpolated.
    """
    for edge, own in moving.items():
        others = [other for e, other in moving.items() if e != edge]
        values = np.column_stack((own.poses.xyz, own.poses.rotation.as_quat()))
        new = np.any(np.diff(values, axis=0) != 0.0, axis=1)
        if not others or new.sum() < CORRECTIONS:
            continue
        fastest = max(others, key=lambda other: len(other.stamps_ns))
        span_s = float(own.stamps_ns[-1] - own.stamps_ns[0]) * 1e-9
        seldom = len(new) < min(SPARSE_HZ * span_s, len(fastest.stamps_ns) / _SLOWER)
        went = np.zeros((len(new), 2))
        for other in others:
            there = other.between(own.stamps_ns)
            went[:, 0] += np.linalg.norm(np.diff(there.xyz, axis=0), axis=1)
            went[:, 1] += (there.rotation[:-1].inv() * there.rotation[1:]).magnitude()
        # if the other edges move, a repeated correction means that there was no new one
        moves = (went > MOVES).any(axis=1)
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
        return edge, _Ordered(stamps, stamps, own.poses.only(rows), (note,))
    return None
