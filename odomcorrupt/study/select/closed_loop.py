"""Closed-loop bias: corrections of the heading by a controller look as if the odometry turned too much.

If a controller or driver with access to the true pose keeps a robot on its line, noise in the heading is corrected
within a second, and the odometry shows only the correction. On K intervals such corrections explain at most a
chi-square of K^2 / X, where X is the information of the turns about a yaw gain. This is negligible if turns are much
larger than the noise, and everything on a straight line. Source: Ljung 1999, System Identification, section 13.4.

The yaw acceleration follows the noise as well. If a controller corrects a fraction c of a heading error within an
interval of h seconds, what the odometry turned too much in the interval by noise, n of variance Q, changes the yaw rate
so that E[n alpha] = c Q / h^2. For a column g(alpha) and normal noise, E[n g(alpha)] = E[g'(alpha)] E[n alpha] (Stein
1981, Annals of Statistics 9): a score that is known but for c, whatever the controller and the drive are.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.compensation import error_of
from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.study.estimate.selected_inverse import inverse_band
from odomcorrupt.study.select.score import project_out
from odomcorrupt.study.terms.channels import MOVES

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.motion import Motion
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.score import Score

_ACTIVE = 1e-3  # fraction of the largest information per interval above which an interval counts in K
_MOSTLY = 0.95  # least absolute cosine between a column and the turns for a gain of turns
_LEAST_DELAY_S, _PULL_MARGIN = 0.05, 2.0
"""Least delay assumed for filtered odometry, seconds, and the factor by which pose updates may exceed the estimate."""
_LARGEST_DELAY_S = 0.15
"""Delay above which the clock and not a filter is the cause, seconds (filters at 30 Hz lag by 40 to 120 ms)."""
_NOISE = 3.0
"""Standard deviations of the noise of one interval that a threshold of the yaw rate exceeds: the mean of normal errors
cut off there is that of all within 3 %; of those cut off at one deviation it is 71 % smaller."""
_LEAST_TURNS = 4.0
"""Least chi-square of turns per interval: their root mean square is then two standard deviations of the noise."""


def may_be_steering(fit: Fit, columns: Array, estimate: Array) -> bool:
    """Return whether a yaw gain with one coefficient may be caused by a controller's corrections of the heading.

    This is so if by its sign the truth turned less than the odometry, and its size is within the bound K^2 / X.

    Parameters
    ----------
    fit : the fitted model
    columns : (K, 3, p)
        Change of the residuals per unit of each coefficient.
    estimate : (p,)
    """
    if columns.shape[2] != 1:
        return False
    if float(columns[:, 2, 0] @ _turn_columns(fit)[:, 2]) * estimate[0] <= 0.0:
        return False
    white = fit.noise.whitener.whiten(columns).reshape(-1, 3)
    size = np.sum(white**2, axis=1)
    active = int(np.sum(size > _ACTIVE * size.max(initial=0.0)))
    return bool(abs(estimate[0]) * size.sum() <= active * _unit(columns, _turn_columns(fit)))


def _unit(columns: Array, turned: Array) -> float:
    """Return the relative change of turns per unit coefficient, as the 90 % quantile over large turns; 1 for a gain."""
    size = np.abs(turned[:, 2])
    plain = size > np.quantile(size, 0.5)
    return float(np.quantile(np.abs(columns[plain, 2, 0]) / size[plain], 0.9)) if plain.any() else 0.0


def is_gain_of_turns(fit: Fit, columns: Array) -> bool:
    """Return whether columns (K, 3, p) are a single one, nearly proportional to the turns."""
    turned = _turn_columns(fit)[:, 2]
    length = float(np.linalg.norm(turned) * np.linalg.norm(columns[:, 2, 0]))
    return columns.shape[2] == 1 and bool(abs(turned @ columns[:, 2, 0]) > _MOSTLY * length)


def hardly_turns(fit: Fit) -> bool:
    """Return whether the turns of a whole drive are too small to estimate a yaw error per turn."""
    white = fit.noise.whitener.whiten(_turn_columns(fit)[:, :, None])
    return float(np.sum(white**2)) < _LEAST_TURNS * len(fit.problem.intervals)


def acts_in_curves_only(fit: Fit, effect: Effect) -> bool:
    """Return whether an effect has no influence on straight driving, and none on turns on the spot.

    A heading disturbance that is corrected within an interval moves the robot sideways, as such an effect does.
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


def may_be_of_filter(fit: Fit, score: Score) -> bool:
    """Return whether a term is no larger than the artefact of a filter with a delay or with pose updates."""
    return of_pulls(fit, score.estimated) or may_be_of_lags(fit, score)


def may_be_of_lags(fit: Fit, score: Score) -> bool:
    """Return whether an imperfect model of a lag may explain a term, within two standard errors.

    A clock offset of t, a delay of one channel and a first-order filter differ by t^2 / 2 times the second derivative
    of the speed. This is negatively correlated with the speed, <v v''> = -<v'^2>, and resembles a gain of a few parts
    in 10,000.
    """
    problem = fit.problem
    lags = [effect for effect in problem.effects if effect.name == "channel_lag"]
    if not (lags or any(recording.pose_corrections for recording in problem.recordings)):
        return False
    clock_s = max((abs(c.offset_s) for c in problem.clocks if abs(c.offset_s) < _LARGEST_DELAY_S), default=0.0)
    rest, made = project_out(fit), np.zeros(len(score.estimate))
    own = rest.of(fit.noise.whitener.whiten(score.term.columns(problem)))
    for channel, column in (("along", 0), ("yaw", 2)):
        late_s = clock_s + sum(
            getattr(lag, "tau", 0.0) for lag in lags if getattr(lag, "channel", "") in (channel, "all")
        )
        # per interval: the second derivative of the speed times the interval's length
        bends = np.concatenate([np.gradient(m.acceleration[:, column]) for m in problem.motions])
        form = problem.intervals.column(bends[:, None] * np.eye(3)[column])[:, :, None]
        other = rest.of(fit.noise.whitener.whiten(form))
        made += 0.5 * late_s**2 * np.abs(np.linalg.lstsq(own, other, rcond=None)[0][:, 0])
    return bool(np.all(np.abs(score.estimate) < made + 2.0 * score.standard_error))


def is_pulled(fit: Fit) -> bool:
    """Return whether a filter pulls the odometry of any recording towards external poses, so that its noise decays."""
    return any(recording.pulled_per_s > 0.0 for recording in fit.problem.recordings)


def of_pulls(fit: Fit, effect: Effect) -> bool:
    """Return whether an effect is no larger than the artefact of external pose updates in delayed odometry.

    A filter with pose updates reduces the error of its odometry by a fraction per second. The error of delayed odometry
    is the motion during the delay, so the updates imitate a gain of travel and of turns. An effect less
    than half of whose mean square is a gain is no such artefact, for example a heading wave from iron near a compass.
    """
    problem = fit.problem
    filtered = sum(getattr(e, "tau", 0.0) for e in problem.effects if e.name == "channel_lag")
    late_s = max(_LEAST_DELAY_S, filtered, *(abs(clock.offset_s) for clock in problem.clocks))
    most = _PULL_MARGIN * late_s * max(recording.pulled_per_s for recording in problem.recordings)
    if not most > 0.0:
        return False
    moved = np.concatenate([np.stack((m.v, m.omega), axis=1) for m in problem.motions])
    error = np.concatenate([error_of(effect, m)[:, [0, 2]] for m in problem.motions])
    size, usual = (np.sqrt(np.mean(part**2, axis=0)) for part in (error, moved))
    as_gains = np.mean(error * moved, axis=0) / np.maximum(usual, np.finfo(float).tiny)
    return bool(np.all(size <= most * usual) and np.sum(as_gains**2) >= 0.5 * np.sum(size**2))


def least_thresholds(fit: Fit) -> dict[str, float]:
    """Return the least thresholds of the yaw rate, lateral acceleration and sideways speed (SI units) to be tested.

    A controller that holds the true heading turns the robot by the noise, with the opposite sign. The odometry's yaw
    rate on a straight is then the error itself, and a threshold below `_NOISE` standard deviations of it selects the
    intervals with a large error, whatever its cause. If an effect always turns the odometry, as unequal wheels do, the
    controller turns the robot against it: the noise is then about the yaw rate of this effect, which is added. A
    sideways speed is noise, too, if the true line is held. Regressors from the truth contain hardly any of this noise.
    """
    problem = fit.problem
    if problem.approach.side == "truth":
        return {}
    intervals = problem.intervals
    covariance = intervals.covariance(problem.approach.law, fit.noise.coefficients, problem.steps)
    moving = np.hypot(*intervals.odometry_step[:, :2].T) > 0.0
    if not moving.any():
        return {}
    dt_s = (intervals.end_s - intervals.start_s)[moving]
    across, noise = (_NOISE * np.sqrt(covariance[moving, i, i]) / dt_s for i in (1, 2))
    speed = np.hypot(*intervals.odometry_step[moving, :2].T) / dt_s
    fast = float(np.quantile(speed, 0.9))
    turned_too_much = (_turn_columns(fit) - intervals.truth_step)[moving, 2] / dt_s
    steady = abs(float(np.median(turned_too_much))) * fast / float(np.median(speed))
    return {
        "yaw_rate": float(np.median(noise)) + steady,
        "lateral_acceleration": float(np.median(noise * speed)) + steady * fast,
        "sideways_speed": float(np.median(across)),
    }


def score_of_corrections(fit: Fit, columns_of: Callable[[Sequence[Motion]], Array]) -> Array | None:
    """Return the expected score (p,) of columns if a controller corrects each heading error within its interval.

    Only the response of the yaw acceleration is included, see above; None if regressors come from the truth.

    Parameters
    ----------
    fit : the fitted model
    columns_of : function from the motions of each run to columns (K, 3, p)
    """
    problem = fit.problem
    if problem.approach.side == "truth":
        return None
    intervals = problem.intervals
    noise = intervals.covariance(problem.approach.law, fit.noise.coefficients, problem.steps)[:, :, 2]
    dt_s = intervals.end_s - intervals.start_s
    band = inverse_band(fit.noise.whitener.factor)
    inverse = np.array([[band[abs(i - j), min(i, j) :: 3] for j in range(3)] for i in range(3)])
    pulled = np.einsum("ijk,kj->ki", inverse, noise) / dt_s[:, None] ** 2
    # the change of alpha by the noise, not a smaller one, because a column may have steps
    change = float(np.median(np.sqrt(noise[:, 2]) / dt_s**2))
    if not change > 0.0:
        return None
    step = np.array([0.0, 0.0, change])
    higher, lower = (
        columns_of([replace(m, acceleration=m.acceleration + sign * step) for m in problem.motions])
        for sign in (1.0, -1.0)
    )
    return np.einsum("ki,kip->p", pulled, higher - lower) / (2.0 * change)


def _turn_columns(fit: Fit) -> Array:
    """Return the change (K, 3) of the residuals by a gain of one on all turns."""
    problem = fit.problem
    turned = np.zeros((sum(len(m) for m in problem.motions), 3))
    turned[:, 2] = np.concatenate([MOVES["omega"](m) * m.dt_s for m in problem.motions])
    return problem.intervals.column(turned)
