"""Systematic errors from drives that end at a known pose, usually the start, without any other truth.

This is a square test (UMBmark: Borenstein & Feng 1996, IEEE T-RA 12(6)), fitted by the same regression as any other
truth. The end of each drive, relative to its start, is one interval. Its residual is linear in small changes of the
parameters; effects are undone exactly before the next step. Any path that turns both ways serves as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import t as student

from odomcorrupt.effects import effect_from_values
from odomcorrupt.effects.effect import amplitudes, on_bound
from odomcorrupt.errors import FitError
from odomcorrupt.geometry.se2 import compose, wrap
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.estimate.config import Approach
from odomcorrupt.study.estimate.gauss_newton import moved
from odomcorrupt.study.estimate.intervals import intervals_between, join
from odomcorrupt.study.estimate.problem import Problem, undo
from odomcorrupt.study.estimate.regressors import MotionSmoother
from odomcorrupt.study.io.clock import Clock
from odomcorrupt.study.io.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array

USUAL = ("unequal_wheels", "wheelbase")
"""Effects that a square test measures: wheels of unequal size (E_d) and the track (E_b)."""
_PLACED = np.array([5e-3, 5e-3, 0.01])
"""Standard deviations of placing a robot back at its start by hand: m, m and rad."""
_NOISE = Coefficients(rot_rot=0.02, rot_trans=0.01, trans_trans=0.02, trans_rot=0.0)
_ROUNDS, _STEP = 20, 1e-7
_ALIASED = 0.99
_ONE_WAY = 0.2
"""Minimum share of the total turning that is to the rarer side."""
_PULSE_S = 1.0
_TURNED_RAD = np.radians(30.0)
"""Error of the final heading that no usual track causes in a few turns: the drive ended in another heading."""
_SCATTERED = 5.0
"""Ratio of the ends' scatter to placing errors and usual noise that is too large for a robot put back by hand."""
_EXPLAINED = 0.5
"""Share of the error at scattered ends that the effects must remove; otherwise the given end poses are wrong."""


@dataclass(frozen=True, slots=True)
class ReturnsFit:
    """Effects fitted to the ends of drives.

    effects, standard_errors : effects, and errors (p,) of their amplitudes in order, widened by Student's t
    before, after : (d, 3) odometry's end minus the real one, along, across (m) and yaw (rad) in the frame of the end,
        as recorded and with the effects removed
    spread : ratio of the ends' scatter to that of placing errors and usual noise
    """

    recordings: tuple[Recording, ...]
    effects: tuple[Effect, ...]
    standard_errors: Array
    before: Array
    after: Array
    spread: float


def closed_drive(name: str, odometry: Trajectory, end_xyt: Array, track_m: float | None) -> Recording:
    """Return a drive as a recording whose truth consists of its two end poses.

    name, odometry, track_m : of the recording; the track is None if it is not known
    end_xyt : (3,) real end pose relative to the start pose; zeros if the robot returned to it
    """
    start = odometry.xyt[0]
    real = compose(start, np.asarray(end_xyt, dtype=np.float64))
    truth = Trajectory(odometry.stamps_ns[[0, -1]], np.stack((start, real)))
    return Recording(name, odometry, truth, int(odometry.stamps_ns[0]), track_m)


def fit_returns(drives: Sequence[Recording], names: Sequence[str] = USUAL) -> ReturnsFit:
    """Return the effects fitted to the ends of drives by generalised least squares, iterated to convergence.

    Each iteration removes the effects of the one before exactly.

    Raises
    ------
    FitError
        If the drives do not separate the effects (all driven the same way round, for instance), or if an effect
        reaches its bound, or if the ends scatter and the effects do not remove half of their error.
    """
    if set(USUAL) <= set(names):
        _check_both_ways(drives)
    effects: tuple[Effect, ...] = tuple(effect_from_values(name, {}) for name in names)
    count = sum(len(amplitudes(e)) for e in effects)
    covariance, problem = np.eye(count), _problem(drives, effects)
    first = problem.intervals.residual
    for _ in range(_ROUNDS):
        intervals = problem.intervals
        weight = np.linalg.inv(_covariance(problem))
        columns = np.concatenate([problem.columns(e) for e in effects], axis=2)
        normal = np.einsum("kip,kij,kjq->pq", columns, weight, columns)
        _check(normal, effects, 3 * len(intervals))
        covariance = np.linalg.inv(normal)
        theta = covariance @ np.einsum("kip,kij,kj->p", columns, weight, intervals.residual)
        effects = moved(effects, theta)
        problem = _problem(drives, effects)
        if np.abs(theta).max() < _STEP:
            break
    left, weight = problem.intervals, np.linalg.inv(_covariance(problem))
    degrees = 3 * len(left) - count
    misfit = float(np.einsum("ki,kij,kj->", left.residual, weight, left.residual))
    spread = float(np.sqrt(misfit / degrees)) if degrees > 0 else 1.0
    before, after = (float(np.sqrt(np.mean(np.sum(r[:, :2] ** 2, axis=1)))) for r in (first, left.residual))
    beyond = "".join(f" ({effect.name} beyond what is possible)" for effect in effects if on_bound(effect))
    if beyond or (spread > _SCATTERED and after > _EXPLAINED * before):
        turned = float(np.median(np.abs(wrap(first[:, 2]))))
        if turned > _TURNED_RAD:
            given = "given" if any(np.ptp(drive.truth.xyt[:, 2]) for drive in drives) else "first"
            raise FitError(
                f"the odometry ends {before:.2f} m and {np.degrees(turned):.0f} deg from the {given} pose: end the "
                "drive there, in that heading, or give the measured end with --end X,Y,YAW or --scan TOPIC"
            )
        raise FitError(
            f"the ends lie {before:.2f} m off, and {after:.2f} m with the effects taken out{beyond}: these drives did "
            "not end as given, headings included; measure the ends with --end X,Y,YAW or --scan TOPIC"
        )
    wider = float(student.isf(0.025, degrees) / 1.96) if degrees > 0 else 1.0
    errors = np.sqrt(np.diag(covariance)) * max(spread * wider, 1.0 if degrees < 3 else 0.0)
    return ReturnsFit(tuple(drives), effects, errors, first, left.residual, spread)


def _problem(drives: Sequence[Recording], effects: tuple[Effect, ...]) -> Problem:
    """Return the ends as a regression problem, with the effects removed from the odometry."""
    smoothers = [MotionSmoother([drive], "odometry") for drive in drives]
    left = [undo(drive, effects, smoother=smoother) for drive, smoother in zip(drives, smoothers, strict=True)]
    intervals = [intervals_between(drive, np.array([0, 1])) for drive in left]
    first = np.cumsum([0, *(len(drive.odometry) - 1 for drive in left[:-1])]).tolist()
    return Problem(
        recordings=tuple(drives),
        effects=effects,
        clocks=(Clock(),) * len(drives),
        approach=Approach(),
        smoothers=tuple(smoothers),
        left=tuple(left),
        intervals=join(intervals, first),
        run=np.arange(float(len(intervals))),
        motions=tuple(smoother.recorded for smoother in smoothers),
    )


def _covariance(problem: Problem) -> Array:
    """Return the covariance (d, 3, 3) of each end from placing by hand and usual noise, used up to a common factor."""
    noise = problem.intervals.covariance(problem.approach.law, _NOISE, problem.steps)
    return noise + np.diag(_PLACED**2)


def _check_both_ways(drives: Sequence[Recording]) -> None:
    """Refuse drives that turn almost only to one side: they do not separate the effects."""
    turned = []
    for drive in drives:
        own = drive.odometry.seconds_since(int(drive.odometry.stamps_ns[0]))
        yaw = np.interp(np.append(np.arange(0.0, own[-1], _PULSE_S), own[-1]), own, drive.odometry.xyt[:, 2])
        turned.append(np.diff(yaw))
    every = np.concatenate(turned)
    left, right = float(every[every > 0.0].sum()), float(-every[every < 0.0].sum())
    if min(left, right) < _ONE_WAY * (left + right):
        raise FitError(
            f"{np.degrees(left):.0f} deg of turning to the left, {np.degrees(right):.0f} deg to the right: that does "
            f"not separate {' and '.join(USUAL)}; drive it the other way round, too, or fit one of them with --add"
        )


def _check(normal: Array, effects: Sequence[Effect], equations: int) -> None:
    """Refuse drives whose ends do not show, or do not separate, the effects."""
    names = [f"{e.name}.{p.name}" for e in effects for p in amplitudes(e)]
    scale = np.sqrt(np.diag(normal))
    unseen = [name for name, one in zip(names, scale, strict=True) if not one > 0.0]
    if unseen or equations < len(names):
        raise FitError(
            f"the ends of these drives do not show {', '.join(unseen or names)}; fit fewer with --add, or drive a path "
            "that turns both ways"
        )
    alike = np.abs(normal / np.outer(scale, scale) - np.eye(len(names)))
    i, j = np.unravel_index(int(np.argmax(alike)), alike.shape)
    if alike[i, j] > _ALIASED:
        raise FitError(
            f"{names[i]} and {names[j]} have the same effect on the end poses of these drives: drive the path the "
            "other way round, too"
        )
