"""Intervals between truth samples (nodes) about half a second apart, with the odometry between them.

Between two neighbouring nodes the odometry measures the motion U, the truth D, and the residual is e = log(D^-1 U).
An error at a single odometry step (systematic, or a draw of noise) is propagated exactly to the end of its interval:
an error of heading rotates the rest of the path. The truth is never interpolated, because that would change its
noise. The odometry is interpolated; it is smooth between its samples.

Nodes are the same samples for all models and clocks.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import between, rotate, wrap
from odomcorrupt.geometry.trajectory import UNKNOWN_M2
from odomcorrupt.model.noise_laws import variances

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array, Increments
    from odomcorrupt.geometry.trajectory import Trajectory
    from odomcorrupt.model.noise_laws import Coefficients, Law, Variances
    from odomcorrupt.study.io.recording import Recording


TURN_M = 0.3
"""Travel, metres, that changes a localisation's view as much as a turn by 1 rad does."""
_MOST_MEMORY = 0.97
"""Upper limit of the correlation of the truth's errors at two nodes; it would be 1 at the same place."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Intervals:
    """K intervals between neighbouring nodes, and the n steps of odometry inside them.

    start_s, end_s : (K,) times of an interval's ends since the recording's origin, seconds
    truth_xyt : (K, 3) truth pose at the start
    truth_step : (K, 3) D, the truth's motion over the interval in the frame of its start
    odometry_step : (K, 3) U, the odometry's motion over the interval in the frame of its start
    residual : (K, 3) e = log(D^-1 U): along, across (m), yaw (rad), in the frame of the interval's end
    linked : (K,) whether the interval starts at the end node of the previous one, and so shares its truth error
    first : (K,) index of each interval's first step
    source, share : (n,) index of the odometry increment that contains a step, and the step's fraction of it
    seconds : (n,) duration of each step
    axis : (n, 2) forward axis of the step's middle, in the frame of the interval's end
    lever, lever0, lever1 : (n, 2) from the step's middle, start and end to the interval's end, in the end's frame, m
    start_shape, end_shape : (K, 3, 3) covariance of the truth at both ends, in the pose's axes, relative to that of a
        usual pose: about the identity for position, about 1 for heading
    way_m : (K,) path over each interval for a localisation: travel plus turns times `TURN_M`
    memory : (K,) correlation of the truth's errors at both ends of an interval, 0 if they are independent
    localised : (K,) whether the truth is a localisation
    random_walk_level : (K,) factor on the deviation of the truth's random_walk
    start_unseen, end_unseen : (K, 3, 3) covariance added at both ends along axes that the truth does not measure, m^2
    """

    start_s: Array
    end_s: Array
    truth_xyt: Array
    truth_step: Array
    odometry_step: Array
    residual: Array
    linked: NDArray[np.bool_]
    first: NDArray[np.int64]
    source: NDArray[np.int64]
    share: Array
    seconds: Array
    axis: Array
    lever: Array
    lever0: Array
    lever1: Array
    start_shape: Array
    end_shape: Array
    way_m: Array
    memory: Array
    localised: NDArray[np.bool_]
    random_walk_level: Array
    start_unseen: Array
    end_unseen: Array

    def __len__(self) -> int:
        return len(self.start_s)

    @property
    def distance_m(self) -> Array:
        """Travel over each interval (K,), metres, according to the odometry."""
        return np.hypot(self.odometry_step[:, 0], self.odometry_step[:, 1])

    def column(self, error: Array) -> Array:
        """Return the residual's change (K, 3) due to errors (n0, 3) of the odometry's increments at mid heading."""
        column = np.empty((len(self), 3))
        for i, row in enumerate(self._carried(error)):
            column[:, i] = 0.0 if row is None else np.add.reduceat(row, self.first)
        return column

    def carried(self, error: Array) -> Array:
        """Return the residual's change (3, n) due to errors (n0, 3) of the odometry's increments, for each step."""
        nothing = np.zeros(len(self.source))
        return np.stack([nothing if row is None else row for row in self._carried(error)])

    def _carried(self, error: Array) -> tuple[Array | None, Array | None, Array | None]:
        """Return the rows (n,) of `carried`, None for rows that are zero."""
        along, across, yaw = (np.take(part, self.source) * self.share if part.any() else None for part in error.T)
        (c, s), (ahead, left) = self.axis.T, self.lever.T
        x, y = (None, None) if along is None else (c * along, s * along)
        if across is not None:
            x, y = _added(x, -s * across), _added(y, c * across)
        if yaw is not None:
            x, y = _added(x, -yaw * left), _added(y, yaw * ahead)
        return x, y, yaw

    def covariance(self, law: Law, k: Coefficients, steps: Increments) -> Array:
        """Return the residuals' covariance (K, 3, 3), m and rad, due to a noise law on the odometry's increments.

        steps : increments of the odometry, in the order of the samples
        """
        total = self.spread(law, variances(law, k, steps), steps)
        return total + k.rot_time**2 * self.over_time(law) if k.rot_time else total

    def over_time(self, law: Law) -> Array:
        """Return the residuals' covariance (K, 3, 3) due to an angle random walk of 1 rad/sqrt(s)."""
        total = np.zeros((3, 3, len(self)))
        for lever in (self.lever if law.arc else self.lever0, self.lever1):
            self._add_outer(total, self.seconds / 2.0, -lever[:, 1], lever[:, 0], turns=True)
        return np.ascontiguousarray(np.moveaxis(total, 2, 0))

    def spread(self, law: Law, v: Variances, steps: Increments) -> Array:
        """Return the residuals' covariance (K, 3, 3) due to given variances of the increments' rot1, trans and rot2."""
        total = np.zeros((3, 3, len(self)))
        # a turn spread over the step moves its end as much as a turn at the step's middle
        for variance, lever in ((v.rot1, self.lever if law.arc else self.lever0), (v.rot2, self.lever1)):
            if variance.any():
                self._add_outer(total, variance[self.source] * self.share, -lever[:, 1], lever[:, 0], turns=True)
        axis = self.axis
        if law.along_travel:
            axis = rotate(axis, np.arctan2(steps.dl_m, steps.ds_m)[self.source])
        ahead, left = axis.T
        for variance, x, y in ((v.trans, ahead, left), (v.across, -left, ahead)):
            if variance.any():
                self._add_outer(total, variance[self.source] * self.share, x, y)
        return np.ascontiguousarray(np.moveaxis(total, 2, 0))

    def _add_outer(self, total: Array, w: Array, x: Array, y: Array, *, turns: bool = False) -> None:
        """Add to `total` (3, 3, K) the covariance of noise of variance (n,) on each step along (x, y, turns)."""
        wx, wy = w * x, w * y
        products = {(0, 0): wx * x, (0, 1): wx * y, (1, 1): wy * y}
        if turns:
            products |= {(0, 2): wx, (1, 2): wy, (2, 2): w}
        for (i, j), product in products.items():
            summed = np.add.reduceat(product, self.first)
            total[i, j] += summed
            if i != j:
                total[j, i] += summed


def _added(row: Array | None, more: Array) -> Array:
    """Return the sum of both arrays, computed in place in the first."""
    return more if row is None else np.add(row, more, out=row)


def intervals_between(
    recording: Recording, picked: NDArray[np.int64], kept: NDArray[np.int64] | None = None
) -> Intervals:
    """Return the intervals between picked truth samples; `kept` has the indices of those to return (default all)."""
    truth, origin_ns, odo_s = recording.truth, recording.origin_ns, recording.odometry_s
    node_s, node_xyt = truth.seconds_since(origin_ns)[picked], truth.xyt[picked]
    if kept is None:
        kept = np.arange(len(picked) - 1)
    cut = cut_at(recording.odometry, odo_s, node_s, origin_ns)
    interval = np.repeat(np.arange(len(node_s) - 1), np.diff(cut.at_node))  # index of the interval of each step
    position = np.full(len(node_s), -1)
    position[kept] = np.arange(len(kept))
    used = np.flatnonzero(position[interval] >= 0)
    k = position[interval[used]]
    first = np.searchsorted(k, np.arange(len(kept)))
    source = np.clip(cut.source[used], 0, len(odo_s) - 2)
    seconds = cut.t_s[used + 1] - cut.t_s[used]
    start, end, ends_at = cut.xyt[used], cut.xyt[used + 1], cut.xyt[cut.at_node[kept + 1]]
    c, s = np.cos(ends_at[:, 2])[k], np.sin(ends_at[:, 2])[k]

    def lever(p_xyt: Array) -> Array:
        x, y = (ends_at[k, :2] - p_xyt[:, :2]).T
        return np.stack((c * x + s * y, c * y - s * x), axis=1)

    lever0, lever1 = lever(start), lever(end)
    middle = (start[:, 2] + end[:, 2]) / 2.0 - ends_at[k, 2]
    truth_step = between(node_xyt[kept], node_xyt[kept + 1])
    odometry_step = between(cut.xyt[cut.at_node[kept]], ends_at)
    gone = end - start
    way_m = np.add.reduceat(np.hypot(gone[:, 0], gone[:, 1]) + TURN_M * np.abs(gone[:, 2]), first)
    shape, unseen = (part[picked] for part in _noise_shape(truth.covariance, len(truth)))
    in_position, in_heading = recording.truth_level
    level = np.array([in_position, in_position, in_heading])
    shape = shape * np.outer(level, level)
    # errors of relative motions add up over an interval
    motions = np.diff(picked)[kept][:, None, None] if truth.relative else 1.0
    return Intervals(
        start_s=node_s[kept],
        end_s=node_s[kept + 1],
        truth_xyt=node_xyt[kept],
        truth_step=truth_step,
        odometry_step=odometry_step,
        residual=_log(between(truth_step, odometry_step)),
        first=first,
        source=source,
        share=seconds / (odo_s[source + 1] - odo_s[source]),
        seconds=seconds,
        axis=np.stack((np.cos(middle), np.sin(middle)), axis=1),
        lever=(lever0 + lever1) / 2.0,
        lever0=lever0,
        lever1=lever1,
        way_m=way_m,
        memory=memory_over(way_m, recording.truth_correlation_m or 0.0),
        linked=np.concatenate(([False], (np.diff(kept) == 1) & (not truth.relative))),
        start_shape=shape[kept] * motions,
        end_shape=shape[kept + 1] * motions,
        start_unseen=unseen[kept],
        end_unseen=unseen[kept + 1],
        localised=np.full(len(kept), recording.localised),
        random_walk_level=np.full(len(kept), in_position),
    )


def memory_over(way_m: Array, correlation_m: float) -> Array:
    """Return the correlation (K,) of a truth's errors over path lengths (K,): exponential, at most `_MOST_MEMORY`."""
    return np.zeros(len(way_m)) if correlation_m <= 0.0 else np.minimum(np.exp(-way_m / correlation_m), _MOST_MEMORY)


def join(parts: Sequence[Intervals], before: Sequence[int]) -> Intervals:
    """Return the intervals of several recordings as one chain with breaks between them.

    before : offset of each recording's increments in the joint array; stretches of one run have the same offset
    """
    n1 = np.concatenate(([0], np.cumsum([len(p.source) for p in parts])))
    joined = {f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Intervals)}
    joined["source"] = np.concatenate([p.source + n for p, n in zip(parts, before, strict=True)])
    joined["first"] = np.concatenate([p.first + n for p, n in zip(parts, n1, strict=False)])
    return Intervals(**joined)


class Cut(NamedTuple):
    """The odometry between the first and the last node, with a pose inserted at each node.

    t_s, xyt : (n,) seconds and (n, 3) poses, including the nodes
    at_node : indices of the nodes in them
    source : (n,) index of the original odometry increment that contains the step starting at each pose
    """

    t_s: Array
    xyt: Array
    at_node: NDArray[np.int64]
    source: NDArray[np.int64]


def cut_at(odometry: Trajectory, odo_s: Array, node_s: Array, origin_ns: int) -> Cut:
    """Return the odometry cut at the nodes; both have to be in order of time.

    odo_s, node_s : times of the odometry's poses and of the nodes, s
    origin_ns : time from which both are counted
    """
    source = np.searchsorted(odo_s, node_s, side="right") - 1
    first, last = source[0] + 1, np.searchsorted(odo_s, node_s[-1], side="left")
    between_them = np.arange(first, last)
    # a node at the time of a sample replaces it
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


def _noise_shape(covariance: Array | None, count: int) -> tuple[Array, Array]:
    """Return two (n, 3, 3): covariances relative to the median pose's (position, heading), and those of unseen axes.

    The level of the former is estimated later. The covariance added along an axis that the truth does not measure is
    not: it is an assumption, not data.
    """
    unseen = np.zeros((count, 3, 3))
    if covariance is None:
        return np.broadcast_to(np.eye(3), (count, 3, 3)), unseen
    values, vectors = np.linalg.eigh(covariance[:, :2, :2])
    blind = values > UNKNOWN_M2
    unseen[:, :2, :2] = (vectors * (blind * values)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    values[blind[:, 1], 1] = values[blind[:, 1], 0]
    neither = blind[:, 0]
    usual = max(float(np.median(values[~neither, 0])), 1e-12) if not neither.all() else 1.0
    values[neither] = usual
    shape = np.zeros((count, 3, 3))
    shape[:, :2, :2] = (vectors * values[:, None, :]) @ np.swapaxes(vectors, 1, 2) / usual
    shape[:, 2, 2] = covariance[:, 2, 2] / max(float(np.median(covariance[:, 2, 2])), 1e-12)
    return shape, unseen


def _log(xyt: Array) -> Array:
    """Return the twist (n, 3) whose exponential is a pose (n, 3)."""
    turn = wrap(xyt[:, 2])
    half = turn / 2.0
    # V^-1 = half cot(half) I - half J, also for half = 0
    cot = np.cos(half) / np.sinc(half / np.pi)
    turned = np.stack((-xyt[:, 1], xyt[:, 0]), axis=1)  # J times the position
    xy = cot[:, None] * xyt[:, :2] - half[:, None] * turned
    return np.concatenate((xy, turn[:, None]), axis=1)


GAP_S = 3.0
"""Multiple of the node spacing above which an interval is a gap in the truth and is not used."""
LEAST_INTERVALS = 20
"""Minimum number of intervals for a fit, of all its recordings."""


def pick_interval_ends(
    truth_s: Array,
    first_s: float,
    last_s: float,
    spacing_s: float,
    among: NDArray[np.bool_] | None = None,
    anchor_s: float | None = None,
) -> NDArray[np.int64]:
    """Return indices of truth samples in [first, last], each at least about `spacing_s` after the previous one.

    Fewer than two samples there are returned as they are.

    truth_s : (n,) times of the truth samples, s, increasing
    first_s, last_s : limits of the times, s
    among : (n,) mask of the samples that may be picked; all by default
    anchor_s : time of one grid point of the nodes; by default that of the first usable sample
    """
    usable = (truth_s >= first_s) & (truth_s <= last_s)
    inside = np.flatnonzero(usable if among is None else usable & among)
    if len(inside) < 2:
        return inside
    begin_s = truth_s[inside[0]]
    if anchor_s is not None:
        begin_s += (anchor_s - begin_s) % spacing_s
    grid = np.arange(begin_s, last_s + spacing_s, spacing_s) - 1e-9
    return np.unique(inside[np.minimum(np.searchsorted(truth_s[inside], grid), len(inside) - 1)])


def intervals_of(recording: Recording, spacing_s: float) -> Intervals:
    """Return the intervals between truth samples `spacing_s` apart, with the odometry between them.

    Raises
    ------
    RecordingError
        If odometry and truth overlap too little.
    """
    truth_s = recording.truth_s
    picked = _ends_of(recording, spacing_s)
    if len(picked) < 2:
        raise RecordingError(
            f"{recording.name}: odometry and truth overlap in {len(picked)} truth samples; check that their stamps "
            "come from one clock"
        )
    start, end = truth_s[picked[:-1]], truth_s[picked[1:]]
    kept = np.flatnonzero(end - start < GAP_S * spacing_s)
    if not len(kept):
        raise RecordingError(f"{recording.name}: no stretch of {spacing_s:g} s has both odometry and truth")
    return intervals_between(recording, picked, kept)


def _ends_of(recording: Recording, spacing_s: float) -> NDArray[np.int64]:
    """Return indices of the nodes, `spacing_s` apart; for a localisation, the path usually driven in that time apart.

    Errors of a localisation depend on its view and stay the same while the robot stands or creeps. The path length is
    that of the truth, and the grid of nodes starts at the recorded start of the odometry. So nodes are the same samples
    of the truth for all models and clocks: noise of other samples would change the likelihood more than most effects.
    """
    truth_s, ends = recording.truth_s, recording.odometry_s[[0, -1]]
    first = int(np.searchsorted(truth_s[:-1], 0.0))
    if not recording.localised:
        return pick_interval_ends(truth_s, float(ends[0]), float(ends[1]), spacing_s, anchor_s=float(truth_s[first]))
    steps = np.diff(np.nan_to_num(recording.truth.xyt), axis=0)
    gone = np.concatenate(([0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]) + TURN_M * np.abs(steps[:, 2]))))
    pace = gone * (float(truth_s[-1] - truth_s[0]) / max(float(gone[-1]), 1e-9))
    return pick_interval_ends(pace, 0.0, float(pace[-1]), spacing_s, recording.within_odometry, float(pace[first]))


def count_intervals(recording: Recording, spacing_s: float) -> int:
    """Return the number of intervals that `intervals_of` would find."""
    if np.count_nonzero(recording.within_odometry) < 2:
        return 0
    between_them = np.diff(recording.truth_s[_ends_of(recording, spacing_s)])
    return int(np.count_nonzero(between_them < GAP_S * spacing_s))
