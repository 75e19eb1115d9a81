"""Detection of odometry that a filter corrects with external poses: its errors decay instead of accumulating.

The change of the error in a second then depends on the present error; with wheels and gyros alone it does not. So each
step's error is regressed on the earlier error (Dickey & Fuller 1979), taken some time before, so that the truth's noise
is not in both, with the robot's systematic errors as free terms. What imitates a decay:

- errors of a localisation, which are corrected themselves: a filter with position input moves its odometry sideways,
  wheels never do, unless the robot drives sideways;
- a single slip: the decay has to occur all along the drive, by standard errors of clustered data (Liang & Zeger 1986);
- play of gears and castors after reversals: a decay of the heading has to occur away from these, too.

An occasional pose moves the odometry within one message, which wheels never do. If such steps lead towards the truth
they are removed; the rest is free odometry, from which everything can be learned.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.correction.undo import pose_corrections
from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import parameters
from odomcorrupt.effects.gears import AT_REST, crossed
from odomcorrupt.effects.wheels import TRACKS_M, rims_of
from odomcorrupt.geometry.se2 import between, rotate, wrap

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.raw_trajectory import Samples

_STEP_S, _EARLIER = 1.0, (2, 5)
"""Length of a step, s, and numbers of steps by which the earlier error precedes it."""
_FEW = 60
_PLAIN, _THROUGHOUT, _TIMES, _SLOWEST = 4.5, 3.0, 8.0, 0.02
"""Minimum significance of a decay in standard errors by least squares and by clusters; minimum number of decay times in
a drive; minimum decay rate per second. A random walk about its mean seems to decay four or five times, with three or
four standard errors."""
_CLUSTERS = 20
"""Number of stretches of a drive that are the clusters."""
_OWN, _SURELY = 0.5, 2.0
"""Minimum fraction of the decay rate that the odometry's sideways steps must show, and the number of standard errors
allowed below it."""
_DRIVES_SIDEWAYS = 0.1
"""Ratio of sideways to forward travel above which a robot drives sideways; corrections and lever arms cause less."""


class Pull(NamedTuple):
    """Decay rates of position and heading errors, per second; 0 if they do not decay."""

    position: float
    heading: float


class Feedback(NamedTuple):
    """Corrections of odometry by external poses.

    free : the odometry without steps towards the poses; unchanged if there are no such steps
    corrections : number of steps removed
    per_s, left_per_s : decay rates of the errors, per second, before and after the removal
    of_headings : whether only heading errors decay, as with a compass
    """

    free: Samples
    corrections: int
    per_s: float
    left_per_s: float
    of_headings: bool = False


class _Aligned(NamedTuple):
    """Odometry and truth at the same m times, about a second apart.

    t_s : (m,) seconds since the odometry's first stamp
    real_xyt, own_xyt : (m, 3) poses of the truth and of the odometry
    off : (m, 3) error of the odometry after alignment of the whole path, in the axes of the truth's pose
    rows : indices of the steps between two of these times that are no gaps of the truth
    """

    t_s: Array
    real_xyt: Array
    own_xyt: Array
    off: Array
    rows: NDArray[np.int64]

    @property
    def span_s(self) -> float:
        """Time from the first pose to the last, seconds."""
        return float(self.t_s[-1] - self.t_s[0])

    def off_before(self, rows: NDArray[np.int64], earlier: int) -> Array:
        """Return the errors (k, 3) a number of steps before these rows, in the robot's axes at the rows."""
        before = self.off[rows - earlier]
        turned = self.real_xyt[rows - earlier, 2] - self.real_xyt[rows, 2]
        return np.column_stack((rotate(before[:, :2], turned), before[:, 2]))


def feedback_of(odometry: Samples, calm: Samples, truth: Samples) -> Feedback:
    """Return the corrections of odometry by external poses; `calm` is the odometry without outliers, see `pull_of`."""
    xyt = np.column_stack((odometry.xyz[:, :2], odometry.yaw_rad))
    found = pose_corrections(odometry.t_s, xyt)
    if found.steps:
        moved = found.error_xyt * [1.0, 1.0, 0.0]
        free = replace(odometry, xyz=odometry.xyz + moved, yaw_rad=odometry.yaw_rad + found.error_xyt[:, 2])
        per_s = max(_pull_of_steps(odometry, free, truth))
        if per_s:
            return Feedback(free, found.steps, per_s, max(pull_of(free, truth)))
    pull = pull_of(calm, truth)
    return Feedback(odometry, 0, max(pull), max(pull), pull.position == 0.0 < pull.heading)


def pull_of(odometry: Samples, truth: Samples) -> Pull:
    """Return the decay rates of odometry errors against a truth with headings; both sorted, on nearly the same clock.

    For headings there is no test like that of sideways steps. If the truth is a localisation or the matches of a laser
    with its map, which are corrected themselves, a decay of the heading counts only together with one of the position.
    """
    if (at := _aligned(odometry, truth)) is None:
        return Pull(0.0, 0.0)
    own = between(at.own_xyt[:-1], at.own_xyt[1:])
    error = own - between(at.real_xyt[:-1], at.real_xyt[1:])
    error[:, 2] = wrap(error[:, 2])
    dt_s, origin = np.diff(at.t_s), int(odometry.stamps_ns[0])
    sideways, truly = (
        np.diff(np.interp(at.t_s, path.seconds_since(origin), _sideways(path.xyt)))
        for path in (odometry.trajectory(), truth.trajectory())
    )
    omni = min(np.abs(sideways).sum(), np.abs(truly).sum()) > _DRIVES_SIDEWAYS * np.abs(own[:, 0]).sum()
    # regressors: errors of a step due to gains, biases, clocks and channel lags
    sides = own[:, 1:2] if omni else own[:, :0]
    moves = np.column_stack((own[:, [0, 2]], sides))
    changes = np.diff(moves, axis=0, prepend=moves[:1])
    later = np.vstack((changes[1:], np.zeros_like(changes[:1])))
    swing = np.column_stack((own[:, :1], sides)) * own[:, 2:]
    aside = np.column_stack((moves, np.abs(moves[:, 1:]), dt_s, swing, changes, later))
    position, heading = 0.0, 0.0
    for earlier in _EARLIER:
        rows = at.rows[earlier:]
        before = at.off_before(rows, earlier)
        both = _fading(error[rows, :2], before[:, :2], aside[rows], dt_s[rows])
        across = _fading(sideways[rows, None], before[:, 1:2], aside[rows], dt_s[rows])
        alone = _fading(error[rows, 2:], before[:, 2:], aside[rows], dt_s[rows])
        itself = across.rate + _SURELY * max(across.usual, across.clustered) > _OWN * both.rate
        if both.plain(at.span_s) and (not truth.localised if omni else itself):
            position = max(position, both.rate)
        if alone.plain(at.span_s):
            away = rows[~_after_reversals(odometry, at)[rows]]
            alone = _fading(error[away, 2:], at.off_before(away, earlier)[:, 2:], aside[away], dt_s[away])
            if len(away) >= _FEW and alone.plain(at.span_s):
                heading = max(heading, alone.rate)
    return Pull(position, heading if position or not (truth.localised or truth.covariance is not None) else 0.0)


def _pull_of_steps(odometry: Samples, free: Samples, truth: Samples) -> Pull:
    """Return the decay rates by the sudden steps of odometry alone; `free` is the odometry without them.

    The steps contain no gain, bias or noise of the truth, and wheels cannot cause them, so that no other regressors and
    no earlier errors are needed.
    """
    if (at := _aligned(odometry, truth)) is None:
        return Pull(0.0, 0.0)
    without = free.trajectory().at(at.t_s, int(odometry.stamps_ns[0]))
    step = between(at.own_xyt[:-1], at.own_xyt[1:]) - between(without[:-1], without[1:])
    step[:, 2] = wrap(step[:, 2])
    rows, dt_s = at.rows, np.diff(at.t_s)
    before, none = at.off_before(rows, 0), np.zeros((len(rows), 0))
    both = _fading(step[rows, :2], before[:, :2], none, dt_s[rows])
    alone = _fading(step[rows, 2:], before[:, 2:], none, dt_s[rows])
    position, heading = (found.rate if found.plain(at.span_s) else 0.0 for found in (both, alone))
    return Pull(position, heading if position or not truth.localised else 0.0)


def _aligned(odometry: Samples, truth: Samples) -> _Aligned | None:
    """Return odometry and truth at common times; None without headings, or if they share less than a minute."""
    if not (truth.headed and odometry.headed):
        return None
    real, path = truth.trajectory(), odometry.trajectory()
    origin = int(odometry.stamps_ns[0])
    real_s = real.seconds_since(origin)
    inside = np.flatnonzero(truth.within(odometry))
    if len(inside) < _FEW:
        return None
    grid = np.arange(real_s[inside[0]], real_s[inside[-1]], _STEP_S)
    picked = np.unique(inside[np.minimum(np.searchsorted(real_s[inside], grid), len(inside) - 1)])
    if len(picked) < _FEW:
        return None
    t_s, real_xyt, own_xyt = real_s[picked], real.xyt[picked], path.at(real_s[picked], origin)
    # after alignment of the whole path
    turn = float(np.angle(np.mean(np.exp(1j * (real_xyt[:, 2] - own_xyt[:, 2])))))
    xy = rotate(own_xyt[:, :2], np.full(len(own_xyt), turn)) - real_xyt[:, :2]
    yaw = np.unwrap(wrap(own_xyt[:, 2] + turn - real_xyt[:, 2]))
    off = np.column_stack((rotate(xy - xy.mean(axis=0), -real_xyt[:, 2]), yaw - np.mean(yaw)))
    return _Aligned(t_s, real_xyt, own_xyt, off, np.flatnonzero(np.diff(t_s) < 3.0 * _STEP_S))


def _sideways(xyt: Array) -> Array:
    """Return the cumulative sideways motion (n,) of a path (n, 3), positive to the left; arcs have none."""
    step = between(xyt[:-1], xyt[1:])
    moved = rotate(step[:, :2], -0.5 * wrap(step[:, 2]))[:, 1]
    return np.concatenate(([0.0], np.cumsum(moved)))


def _after_reversals(odometry: Samples, at: _Aligned) -> NDArray[np.bool_]:
    """Return whether a wheel's play or a castor may turn the odometry within each step (m - 1,) between the times.

    Both end within a travel after a reversal, of which the largest possible is taken, on each trial track of the robot.
    """
    path = odometry.trajectory()
    steps = between(path.xyt[:-1], path.xyt[1:])
    travel, turn = steps[:, 0], wrap(steps[:, 2])
    ways_m = {p.name: p.high for name in ("backlash", "castor_kick") for p in parameters(registry()[name])}
    moved = [(travel, ways_m["way"])]
    moved += [(rim, ways_m["travel"]) for track_m in TRACKS_M for rim in rims_of(travel, turn, track_m)]
    inside = np.any([crossed(one, AT_REST, way_m)[0] != 0.0 for one, way_m in moved], axis=0)
    so_far = np.concatenate(([0.0], np.cumsum(inside)))
    return np.diff(np.interp(at.t_s, path.seconds_since(int(odometry.stamps_ns[0])), so_far)) > 0.0


class _Fading(NamedTuple):
    """Decay rate per second, with its standard errors by least squares and by clusters of the drive."""

    rate: float
    usual: float
    clustered: float

    def plain(self, span_s: float) -> bool:
        """Return whether the decay is significant in a drive of this duration."""
        least = max(_SLOWEST, _TIMES / span_s, _PLAIN * self.usual, _THROUGHOUT * self.clustered)
        return self.rate > least


def _fading(error: Array, before: Array, aside: Array, dt_s: Array) -> _Fading:
    """Return the decay rate of errors `before` (n, c) by step errors (n, c), with regressors `aside` (n, p) free.

    Each cluster is predicted from the others (CR3: Bell & McCaffrey 2002), so that none determines the rate alone.
    """
    nuisance = np.linalg.qr(np.column_stack((aside, np.ones(len(aside)))))[0]
    y, x = (part - nuisance @ (nuisance.T @ part) for part in (error, -before * dt_s[:, None]))
    square = float(np.sum(x * x))
    if square <= 0.0:
        return _Fading(0.0, 0.0, 0.0)
    rate = float(np.sum(x * y)) / square
    left = y - rate * x
    usual = float(np.sqrt(np.sum(left**2) / max(y.size - 2 * nuisance.shape[1], 1) / square))
    parts = [np.array_split(np.sum(x * other, axis=1), _CLUSTERS) for other in (left, x)]
    scores, own = np.array([[part.sum() for part in one] for one in parts])
    scores = scores / np.maximum(1.0 - own / square, 1e-6)
    return _Fading(rate, usual, float(np.linalg.norm(scores)) / square)
