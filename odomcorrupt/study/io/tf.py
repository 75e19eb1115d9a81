"""Read an edge of TF without ROS: map.base_link is composed of whatever edges lead from the one to the other.

The bag is read twice: once for the tree, once for the edges on the way, so that a hundred joints cost nothing. The
moving edge with the most samples gives the times; the others are interpolated there, and edges of a static topic hold
for all times.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.bags.messages import gather, gather_stamps_ns, locate
from odomcorrupt.errors import RecordingError
from odomcorrupt.study.io.address import plain
from odomcorrupt.study.io.raw_trajectory import Samples
from odomcorrupt.study.io.se3 import Transforms, composed, headings, interpolated, inverted, unit
from odomcorrupt.study.io.tf_tree import Edge
from odomcorrupt.study.io.time_order import order_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.bags.block import Block, Channel
    from odomcorrupt.study.io.address import Address
    from odomcorrupt.study.io.tf_tree import Tree

__all__ = ["EdgeReader"]

_FAR_M = 1e9


class _Ordered(NamedTuple):
    stamps_ns: NDArray[np.int64]
    poses: Transforms
    notes: tuple[str, ...]


@dataclass(slots=True)
class _Collected:
    stamps: list[NDArray[np.int64]] = field(default_factory=list)
    logs: list[NDArray[np.int64]] = field(default_factory=list)
    values: list[NDArray[np.float64]] = field(default_factory=list)


class EdgeReader:
    """Collects the edges on the way of one address, block by block."""

    def __init__(self, place: str, address: Address, channels: list[Channel], tree: Tree) -> None:
        self.place = f"{place}: {address}"
        self.address = address
        self.channels = channels
        self.tree = tree
        self.way = tree.way(address, place)
        self.collected = {edge: _Collected() for edge, _ in self.way}

    def take(self, block: Block) -> None:
        """Collect what a block holds of the edges."""
        for channel in self.channels:
            for layout in locate(block, channel):
                for item in layout.items:
                    here = self.collected.get(Edge(plain(item.frame_id), plain(item.child_frame_id)))
                    if here is None:
                        continue
                    here.stamps.append(gather_stamps_ns(block, layout, item))
                    here.logs.append(block.table["log_ns"][layout.rows])
                    pose = (gather(block, layout, item, "position"), gather(block, layout, item, "orientation"))
                    here.values.append(np.concatenate(pose, axis=1))

    def samples(self) -> Samples:
        """Return the composed poses.

        Raises
        ------
        RecordingError
            Where no edge on the way moves, or the moving ones share no time.

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
        at_s = (stamps - stamps[0]).astype(np.float64) * 1e-9
        total = Transforms(np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]]))
        for edge, back in self.way:
            part = edges[edge].poses
            if edge in moving:
                own_s = (edges[edge].stamps_ns - stamps[0]).astype(np.float64) * 1e-9
                part = interpolated(own_s, part, at_s)
            else:
                part = Transforms(part.xyz[:1], part.quat_xyzw[:1])
            total = composed(total, inverted(part) if back else part)
        notes = [f"{self.address}: {note}" for e in edges.values() for note in e.notes]
        if len(self.way) > 1:
            notes.append(f"{self.address}: composed of {names}")
        none = np.zeros(0)
        return Samples(
            self.place,
            str(self.address),
            self.way[0][0].child if self.way[0][1] else self.way[0][0].parent,
            stamps,
            total.xyz,
            headings(total.quat_xyzw),
            none.astype(np.int64),
            none,
            tuple(notes),
        )

    def _edge(self, edge: Edge) -> _Ordered:
        here = self.collected[edge]
        values = np.concatenate(here.values)
        values = np.concatenate((values[:, :3], unit(values[:, 3:])), axis=1)
        # a comparison with what is no number is false
        good = np.asarray((np.abs(values) < _FAR_M).all(axis=1))
        if not good.any():
            raise RecordingError(f"{self.place}: none of {len(good)} transforms {edge.parent}.{edge.child} is a number")
        stamps, logs = np.concatenate(here.stamps)[good], np.concatenate(here.logs)[good]
        # static edges are repeated and stamped with anything
        order = order_of(stamps, logs if edge in self.tree.moving else logs[:0])
        kept = values[good][order.rows]
        notes = order.notes if edge in self.tree.moving else ()
        return _Ordered(order.stamps_ns, Transforms(kept[:, :3], kept[:, 3:]), notes)
