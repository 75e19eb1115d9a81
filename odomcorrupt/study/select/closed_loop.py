"""Closed-loop bias: turns by which a controller answers to the noise look as if the odometry turned too much.

Where a robot is kept on its line by somebody who sees the truth, noise that turned it is taken back within the second,
and the odometry shows the turn back alone. Of K intervals such answers can explain K^2 / X chi-square at most, X being
the information that the turns carry about a gain of the yaw: nothing where turns are plainly larger than the noise,
all of it on a straight line. Endogeneity of closed loops: Ljung 1999, System Identification, section 13.4.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.geometry.motion import error_of
from odomcorrupt.study.select.score import project_out
from odomcorrupt.study.terms.channels import MOVES

if TYPE_CHECKING:
    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.score import Score

__all__ = [
    "acts_in_curves_only",
    "hardly_turns",
    "is_gain_of_turns",
    "is_pulled",
    "may_be_of_lags",
    "may_be_steering",
    "of_pulls",
]

_ACTIVE = 1e-3
_MOSTLY = 0.95
_LATE_S, _PULLED = 0.05, 2.0
"""Odometry of a filter is late by so much even where its clock is right; and how much more than that pulls may do."""
_LATEST_S = 0.15
"""What is later than this is late by its clock, not by a filter of odometry (30 Hz, lags of 40 to 120 ms)."""
_PLAIN_TURNS = 4.0
"""Information of a drive's turns per interval: on the root of their mean square, two standard errors of the noise."""


def may_be_steering(fit: Fit, columns: Array, estimate: Array) -> bool:
    """Tell whether what a gain of turns explains, one number, may be a controller's answers to the noise.

    It may where it says that the truth turned less, and is not more than answers can be.

    Parameters
    ----------
    fit : the fitted model
    columns : (K, 3, p)
        What a unit of each number does to the residuals.
    estimate : (p,)

    """
    if columns.shape[2] != 1:
        return False
    if float(columns[:, 2, 0] @ _turned(fit)[:, 2]) * estimate[0] <= 0.0:
        return False
    white = fit.noise.whitener.whiten(columns).reshape(-1, 3)
    size = np.sum(white**2, axis=1)
    active = int(np.sum(size > _ACTIVE * size.max(initial=0.0)))
    return bool(abs(estimate[0]) * size.sum() <= active * _unit(columns, _turned(fit)))


def _unit(columns: Array, turned: Array) -> float:
    """Return by how much a number of one changes a turn where it acts most: 1 for a gain."""
    size = np.abs(turned[:, 2])
    plain = size > np.quantile(size, 0.5)
    return float(np.quantile(np.abs(columns[plain, 2, 0]) / size[plain], 0.9)) if plain.any() else 0.0


def is_gain_of_turns(fit: Fit, columns: Array) -> bool:
    """Tell whether columns (K, 3, p) are one, and in proportion to the turns."""
    turned = _turned(fit)[:, 2]
    length = float(np.linalg.norm(turned) * np.linalg.norm(columns[:, 2, 0]))
    return columns.shape[2] == 1 and bool(abs(turned @ columns[:, 2, 0]) > _MOSTLY * length)


def hardly_turns(fit: Fit) -> bool:
    """Tell whether a whole drive has no turns to speak of, so that nothing can be said of the yaw error per turn."""
    white = fit.noise.whitener.whiten(_turned(fit)[:, :, None])
    return float(np.sum(white**2)) < _PLAIN_TURNS * len(fit.problem.nodes)


def acts_in_curves_only(fit: Fit, effect: Effect) -> bool:
    """Tell whether an effect does nothing to a robot that goes straight, nor to one that turns on the spot.

    A heading knocked off and taken back within an interval has moved the robot sideways, as such an effect does.
    """
    changed = {p.name: p.identity + p.step for p in amplitudes(effect)}
    acting = replace(effect, **changed)  # type: ignore[type-var]  # effects are dataclasses
    for m in fit.problem.motions:
        none = np.zeros(len(m))
        straight = replace(m, omega=none, acceleration=m.acceleration * [1.0, 1.0, 0.0])
        spot = replace(m, v=none, vy=none, acceleration=m.acceleration * [0.0, 0.0, 1.0])
        if error_of(acting, straight).any() or error_of(acting, spot).any():
            return False
    return True


def may_be_of_lags(fit: Fit, score: Score) -> bool:
    """Tell whether a term is no larger than what the form of lags makes of it, within two standard errors.

    A clock that is late by t, a delay of a channel and a first-order filter differ by t^2 / 2 times the second
    derivative of the speed. That goes against the speed itself, <v v''> = -<v'^2>, and passes for a gain of a few parts
    in 10,000.
    """
    problem = fit.problem
    lags = [effect for effect in problem.effects if effect.name == "channel_lag"]
    if not (lags or any(recording.pose_corrections for recording in problem.recordings)):
        return False
    clock_s = max((abs(c.offset_s) for c in problem.clocks if abs(c.offset_s) < _LATEST_S), default=0.0)
    rest, made = project_out(fit), np.zeros(len(score.estimate))
    own = rest.of(fit.noise.whitener.whiten(score.term.columns(problem)))
    for channel, column in (("along", 0), ("yaw", 2)):
        late_s = clock_s + sum(getattr(lag, "tau", 0.0) for lag in lags if getattr(lag, "channel", "") == channel)
        bends = np.concatenate([np.gradient(m.acceleration[:, column]) for m in problem.motions])
        form = problem.nodes.column(bends[:, None] * np.eye(3)[column])[:, :, None]
        other = rest.of(fit.noise.whitener.whiten(form))
        made += 0.5 * late_s**2 * np.abs(np.linalg.lstsq(own, other, rcond=None)[0][:, 0])
    return bool(np.all(np.abs(score.estimate) < made + 2.0 * score.standard_error))


def is_pulled(fit: Fit) -> bool:
    """Tell whether a filter pulls the odometry of any recording towards poses, so that its noise fades."""
    return any(recording.pulled_per_s > 0.0 for recording in fit.problem.recordings)


def of_pulls(fit: Fit, effect: Effect) -> bool:
    """Tell whether an effect is as small as what poses from outside make of odometry that comes late.

    A filter that is given poses pulls odometry by a part of how far off it is every second, and odometry that is late
    is off by what the robot moved meanwhile: together that is a gain of travel and of turns.
    """
    problem = fit.problem
    filtered = sum(getattr(e, "tau", 0.0) for e in problem.effects if e.name == "channel_lag")
    late_s = max(_LATE_S, filtered, *(abs(clock.offset_s) for clock in problem.clocks))
    most = _PULLED * late_s * max(recording.pulled_per_s for recording in problem.recordings)
    if not most > 0.0:
        return False
    moved = np.concatenate([np.stack((m.v, m.omega), axis=1) for m in problem.motions])
    error = np.concatenate([error_of(effect, m)[:, [0, 2]] for m in problem.motions])
    size, usual = (np.sqrt(np.mean(part**2, axis=0)) for part in (error, moved))
    return bool(np.all(size <= most * usual))


def _turned(fit: Fit) -> Array:
    """Return (K, 3) what a gain of one on all turns would do to the residuals."""
    problem = fit.problem
    turned = np.zeros((sum(len(m) for m in problem.motions), 3))
    turned[:, 2] = np.concatenate([MOVES["omega"](m) * m.dt_s for m in problem.motions])
    column: Array = problem.nodes.column(turned)
    return column
