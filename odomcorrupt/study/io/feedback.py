"""Odometry that a filter pulls towards poses from outside: its errors fade, those of odometry alone pile up.

A filter (robot_localization, a fused SLAM) that is given poses takes out a part of its error at every update. What the
odometry gains on the truth in a second then depends on how far off it already is; errors of wheels and gyros do not.
The regression is of each step's error on the error before it (Dickey & Fuller 1979, with the terms of a robot's own
systematic errors free beside it). The error is taken some time earlier, so that the truth's own noise is on one side.

Errors of a localisation are alike for longer than that, and come back, too: odometry minus truth then fades because the
*truth* is corrected. Whose steps do it shows across: a filter that is given positions moves its odometry sideways
towards them, wheels never do, unless the robot drives sideways: then nothing shows it beside a localisation. And one
slip is no filter: what fades has to fade all along the drive, so that standard errors are those of clustered data
(Liang & Zeger 1986), a stretch of the drive being a cluster.

A pose that comes once in a while moves the odometry at one message, which wheels never do. Where such steps lead
towards the truth they are taken out: what is left is free odometry, and everything can be learned of it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.correction.pose_corrections import pose_corrections
from odomcorrupt.geometry.se2 import between, rotate, wrap

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.raw_trajectory import Samples

__all__ = ["Feedback", "Pull", "feedback_of", "pull_of"]

_STEP_S, _EARLIER = 1.0, (2, 5)
"""Steps are so long, and errors are taken so many of them earlier."""
_FEW = 60
_PLAIN, _THROUGHOUT, _TIMES, _SLOWEST = 4.5, 3.0, 8.0, 0.02
"""Standard errors of a pull by least squares and by clusters of the drive, times that an error fades in a drive, and
the slowest fading per second, at least: a random walk about its own mean seems to fade four or five times, with three
or four standard errors."""
_CLUSTERS = 20
"""Stretches of a drive in which errors have to fade alike."""
_OWN, _SURELY = 0.5, 2.0
"""Part of the fading across that the odometry's own sideways steps have to show, and standard errors below it from
which on they plainly do not."""
_DRIVES_SIDEWAYS = 0.1
"""Way sideways, of that along, from which on a robot drives sideways: corrections and tracked points make less."""


class Pull(NamedTuple):
    """How fast errors of position and of heading fade, per second; 0 where they do not."""

    position: float
    heading: float


class Feedback(NamedTuple):
    """What poses from outside do to odometry.

    free : the odometry without steps towards them, the same where they do not show as steps
    corrections : how many were taken out
    per_s, left_per_s : how fast errors fade, and those that are left, per second
    """

    free: Samples
    corrections: int
    per_s: float
    left_per_s: float


def feedback_of(odometry: Samples, calm: Samples, truth: Samples) -> Feedback:
    """Return what poses from outside do to odometry: `calm` is the same without outliers, see `pull_of`."""
    xyt = np.column_stack((odometry.xyz[:, :2], odometry.yaw_rad))
    found = pose_corrections(odometry.seconds_since(int(odometry.stamps_ns[0])), xyt)
    if found.steps:
        moved = found.error_xyt * [1.0, 1.0, 0.0]
        free = replace(odometry, xyz=odometry.xyz + moved, yaw_rad=odometry.yaw_rad + found.error_xyt[:, 2])
        per_s = max(pull_of(odometry, truth, free))
        if per_s:
            return Feedback(free, found.steps, per_s, max(pull_of(free, truth)))
    per_s = max(pull_of(calm, truth))
    return Feedback(odometry, 0, per_s, per_s)


def pull_of(odometry: Samples, truth: Samples, free: Samples | None = None) -> Pull:
    """Return how odometry is pulled towards a truth with headings; both by growing stamps, on nearly one clock.

    Where sudden steps were found, it is they that have to lead towards the truth: no gain or bias, no noise of the
    truth is in them, and wheels make none. `free` is the odometry without them.

    Headings have no such witness as steps sideways: where the truth is a localisation, which is corrected itself, they
    count only beside positions that are pulled.
    """
    nothing = Pull(0.0, 0.0)
    if not (truth.headed and odometry.headed):
        return nothing
    real, path = truth.trajectory(), odometry.trajectory()
    origin = int(odometry.stamps_ns[0])
    real_s, own_s = real.seconds_since(origin), path.seconds_since(origin)
    inside = np.flatnonzero((real_s >= own_s[0]) & (real_s <= own_s[-1]))
    if len(inside) < _FEW:
        return nothing
    grid = np.arange(real_s[inside[0]], real_s[inside[-1]], _STEP_S)
    picked = np.unique(inside[np.minimum(np.searchsorted(real_s[inside], grid), len(inside) - 1)])
    t_s, real_xyt, own_xyt = real_s[picked], real.xyt[picked], path.at(real_s[picked], origin)
    if len(picked) < _FEW:
        return nothing
    step, own = between(real_xyt[:-1], real_xyt[1:]), between(own_xyt[:-1], own_xyt[1:])
    rest = step
    if free is not None:
        without = free.trajectory().at(real_s[picked], origin)
        rest = between(without[:-1], without[1:])
    error = own - rest
    error[:, 2] = wrap(error[:, 2])
    off = _off(own_xyt, real_xyt)
    off[:, :2] = rotate(off[:, :2], -real_xyt[:, 2])
    dt_s = np.diff(t_s)
    # gaps of the truth are no steps
    usual = dt_s < 3.0 * _STEP_S
    sideways, truly = (
        np.diff(np.interp(t_s, at_s, _sideways(poses.xyt))) for at_s, poses in ((own_s, path), (real_s, real))
    )
    omni = min(np.abs(sideways).sum(), np.abs(truly).sum()) > _DRIVES_SIDEWAYS * np.abs(own[:, 0]).sum()
    # what gains, biases, clocks and lags of a channel do to a step
    sides = own[:, 1:2] if omni else own[:, :0]
    moves = np.column_stack((own[:, [0, 2]], sides))
    changes = np.diff(moves, axis=0, prepend=moves[:1])
    later = np.vstack((changes[1:], np.zeros_like(changes[:1])))
    swing = np.column_stack((own[:, :1], sides)) * own[:, 2:]
    aside = np.column_stack((moves, np.abs(moves[:, 1:]), dt_s, swing, changes, later))
    position, heading = 0.0, 0.0
    if free is not None:
        aside = aside[:, :0]
    for earlier in _EARLIER if free is None else (0,):
        rows = np.flatnonzero(usual)[earlier:]
        before = off[rows - earlier]
        # an error of some steps ago, as the robot has it before it now
        turned = real_xyt[rows - earlier, 2] - real_xyt[rows, 2]
        before = np.column_stack((rotate(before[:, :2], turned), before[:, 2]))
        span_s = float(t_s[-1] - t_s[0])
        both = _fading(error[rows, :2], before[:, :2], aside[rows], dt_s[rows])
        across = _fading(sideways[rows, None], before[:, 1:2], aside[rows], dt_s[rows])
        alone = _fading(error[rows, 2:], before[:, 2:], aside[rows], dt_s[rows])
        itself = across.rate + _SURELY * max(across.usual, across.clustered) > _OWN * both.rate
        if both.plain(span_s) and (free is not None or (not truth.localised if omni else itself)):
            position = max(position, both.rate)
        if alone.plain(span_s):
            heading = max(heading, alone.rate)
    return Pull(position, heading if position or not truth.localised else 0.0)


def _sideways(xyt: Array) -> Array:
    """Return how far (n,) a path has moved to its own left up to each of its poses (n, 3); arcs do not."""
    step = between(xyt[:-1], xyt[1:])
    moved = rotate(step[:, :2], -0.5 * wrap(step[:, 2]))[:, 1]
    return np.concatenate(([0.0], np.cumsum(moved)))


def _off(own_xyt: Array, real_xyt: Array) -> Array:
    """Return how far odometry (n, 3) lies off the truth, laid onto it as a whole, in the truth's axes."""
    turn = float(np.angle(np.mean(np.exp(1j * (real_xyt[:, 2] - own_xyt[:, 2])))))
    laid = rotate(own_xyt[:, :2], np.full(len(own_xyt), turn))
    xy = laid - real_xyt[:, :2]
    yaw = wrap(own_xyt[:, 2] + turn - real_xyt[:, 2])
    return np.column_stack((xy - xy.mean(axis=0), np.unwrap(yaw) - np.mean(np.unwrap(yaw))))


class _Fading(NamedTuple):
    """A rate per second, and its standard errors by least squares and by clusters of the drive."""

    rate: float
    usual: float
    clustered: float

    def plain(self, span_s: float) -> bool:
        """Tell whether errors fade plainly in a drive so long."""
        least = max(_SLOWEST, _TIMES / span_s, _PLAIN * self.usual, _THROUGHOUT * self.clustered)
        return self.rate > least


def _fading(error: Array, before: Array, aside: Array, dt_s: Array) -> _Fading:
    """Return how fast errors (n, c) before fade by errors made (n, c), beside what regressors (n, p) make of them.

    Each cluster is predicted from the others (CR3: Bell & McCaffrey 2002), so that none makes its own line.
    """
    nuisance = np.linalg.qr(np.column_stack((aside, np.ones(len(aside)))))[0]
    y, x = (part - nuisance @ (nuisance.T @ part) for part in (error, -before * dt_s[:, None]))
    square = float(np.sum(x * x))
    if square <= 0.0:
        return _Fading(0.0, 0.0, 0.0)
    rate = float(np.sum(x * y)) / square
    left = y - rate * x
    usual = float(np.sqrt(np.sum(left**2) / max(y.size - 2 * nuisance.shape[1], 1) / square))
    scores, own = (
        np.array([part.sum() for part in np.array_split(np.sum(x * other, axis=1), _CLUSTERS)]) for other in (left, x)
    )
    scores = scores / np.maximum(1.0 - own / square, 1e-6)
    return _Fading(rate, usual, float(np.linalg.norm(scores)) / square)
