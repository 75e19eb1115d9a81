"""Odometry cut at given times, so that every step of it lies between two of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.recording import Trajectory

__all__ = ["Cut", "cut_at"]


class Cut(NamedTuple):
    """The odometry between the first and the last of some nodes, cut at each of them.

    t_s, xyt : (n,) seconds and (n, 3) poses, nodes among them
    at_node : where the nodes stand in it
    source : (n,) index of the increment that begins there, of the odometry as it was
    """

    t_s: Array
    xyt: Array
    at_node: NDArray[np.int64]
    source: NDArray[np.int64]


def cut_at(odometry: Trajectory, odo_s: Array, node_s: Array, origin_ns: int) -> Cut:
    """Cut the odometry at nodes: both lie in order of time already, so nothing need be sorted."""
    source = np.searchsorted(odo_s, node_s, side="right") - 1
    first, last = source[0] + 1, np.searchsorted(odo_s, node_s[-1], side="left")
    between_them = np.arange(first, last)
    # a node that falls on a sample takes its place
    twice = source[(odo_s[source] == node_s) & (source >= first) & (source < last)]
    between_them = np.delete(between_them, twice - first)
    at_node = np.searchsorted(between_them, source, side="right") + np.arange(len(node_s))
    total = len(between_them) + len(node_s)
    is_node = np.zeros(total, dtype=bool)
    is_node[at_node] = True
    t_s, xyt, sources = np.empty(total), np.empty((total, 3)), np.empty(total, dtype=np.int64)
    t_s[is_node], t_s[~is_node] = node_s, odo_s[between_them]
    xyt[is_node], xyt[~is_node] = odometry.at(node_s, origin_ns), odometry.xyt[between_them]
    sources[is_node], sources[~is_node] = source, between_them
    return Cut(t_s, xyt, at_node, sources)
