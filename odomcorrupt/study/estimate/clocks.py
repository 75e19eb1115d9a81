"""Set-up of recordings, the first step of a fit: clock offset and rate, and mounting of the truth's tracked point."""

from __future__ import annotations

from dataclasses import dataclass, replace
from statistics import median_low
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.errors import FitError, RecordingError
from odomcorrupt.study.estimate.drive_type import MOUNTING, mountings
from odomcorrupt.study.estimate.gauss_newton import Fit, fit, fit_problem, prior_deviations
from odomcorrupt.study.estimate.problem import pose_problem
from odomcorrupt.study.estimate.windows import ten_second_error
from odomcorrupt.study.io.clock import Clock, clock_leaders, coarse_clock

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import TruthNoise
    from odomcorrupt.study.estimate.config import Approach
    from odomcorrupt.study.io.recording import Recording

SETUP_LEVEL = 1e-4
"""Significance level of a part of the set-up: of a clock, a lever arm, or a mounting yaw."""
_CLOCK_LIMIT = float(np.sqrt(chi2.isf(SETUP_LEVEL, 1)))
_PLAIN_LEVEL, _MOST_LEVEL = 3.0, 30.0
"""Ratio of two truths' noise that is more than an estimation error, and the largest ratio used."""
_LEAST_M, _LEAST_RAD = 1e-3, 1e-3
"""Lower limits of a truth's noise, m and rad, in such a ratio: less is hardly separable from that of the odometry."""
_NUISANCE = ("wheel_scale", "wheelbase", "unequal_wheels", *MOUNTING)
"""Effects that are free while the clocks are estimated, and are then discarded."""
RIVALS = ("accel_slip", "backlash", "channel_lag")
"""Effects that resemble a clock offset at starts and stops."""
_FEWEST_ALIKE = 3
"""Fewest clocks whose mean, if significant beside their scatter, is that of a recording that cannot tell its own."""
_SCAN_CLOCK_S = 0.1
"""Expected offset between the stamps of scans and of odometry, seconds: 0.09 to 0.17 s on four real robots."""


@dataclass(frozen=True, slots=True)
class Clocks:
    """Clocks of R recordings, whether their offset and rate are significant, and their standard errors (R, 2).

    The error of an offset includes the rounding of stamps. An offset that is not significant is zero.

    noise, beside : noise and nuisance effects of the last fit: starting values for later fits, not results
    margins_nats : log-likelihood gain of a clock over each effect beside which it is not significant
    truths : noise of each recording's truth, from the fit of its clock
    left_nats : log-likelihood gain of dependences on accelerations beside the clocks
    """

    clocks: tuple[Clock, ...]
    free: tuple[tuple[bool, bool], ...]
    errors: tuple[tuple[float, float], ...]
    noise: Array | None = None
    beside: tuple[Effect, ...] = ()
    margins_nats: tuple[float, ...] = ()
    truths: tuple[TruthNoise, ...] = ()
    left_nats: float = 0.0


@dataclass(frozen=True, slots=True)
class _Found:
    """Clock of some runs, whether its offset and rate are significant, their errors, and the fit they come from."""

    clock: Clock
    free: tuple[bool, bool]
    errors: tuple[float, float]
    fit: Fit


def nuisance_of(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Return the names of effects that are free beside clocks: usual systematic ones and possible mountings."""
    possible = mountings(recordings)
    return tuple(name for name in _NUISANCE if name in possible or name not in MOUNTING)


def clock_rivals(recordings: Sequence[Recording]) -> list[Effect]:
    """Return the effects that resemble a clock offset at starts and stops; those of wheels if the track is known."""
    track = all(r.track_m is not None for r in recordings)
    return [kind() for kind in (registry()[name] for name in RIVALS) if track or not kind.needs_track]


def find_clocks(recordings: Sequence[Recording], approach: Approach, beside: Sequence[Effect] = ()) -> Clocks:
    """Return each recording's clock, estimated by exact resampling with the usual systematic effects free.

    An offset or rate that is not significant is left at zero: correcting an aligned clock only adds noise.

    beside : other effects that are free, too
    """
    recordings = [recording.multiplied(*recording.gains) for recording in recordings]
    leaders = clock_leaders(recordings)
    found: dict[int, _Found] = {}
    refused: list[FitError | RecordingError] = []
    for leader in set(leaders):
        runs = [r for r, own in zip(recordings, leaders, strict=True) if own == leader]
        try:
            found[leader] = _find_clock(runs, approach, beside)
        except (FitError, RecordingError) as why:  # on straight lines at one speed the likelihood has no maximum
            refused.append(why)
    if not found:
        raise refused[0]
    longest = max(found.values(), key=lambda own: len(own.fit.problem.intervals))
    offsets_s = np.array([own.clock.offset_s for own in found.values() if own.free[0]])
    clock = Clock()
    if len(offsets_s) >= _FEWEST_ALIKE:
        mean_s, error_s = float(offsets_s.mean()), float(offsets_s.std(ddof=1) / np.sqrt(len(offsets_s)))
        clock = Clock(mean_s) if abs(mean_s) > _CLOCK_LIMIT * error_s else clock
    common = replace(longest, clock=clock, free=(False, False), errors=(0.0, 0.0))
    each = [found.get(leader, common) for leader in leaders]
    return Clocks(
        tuple(f.clock for f in each),
        tuple(f.free for f in each),
        with_rounding([f.errors for f in each], [f.free for f in each], recordings),
        longest.fit.noise.free,
        tuple(e for e in longest.fit.next_effects if e.name in _NUISANCE),
        truths=tuple(f.fit.noise.truth for f in each),
    )


def with_rounding(
    errors: Sequence[Sequence[float]], free: Sequence[tuple[bool, bool]], recordings: Sequence[Recording]
) -> tuple[tuple[float, float], ...]:
    """Return the standard errors (R, 2) of clocks, with the rounding of stamps added to those of free offsets."""
    return tuple(
        (float(np.hypot(own[0], r.stamp_error_s)) if moves[0] else float(own[0]), float(own[1]))
        for own, moves, r in zip(errors, free, recordings, strict=True)
    )


def levelled(recordings: Sequence[Recording], clocks: Clocks) -> list[Recording]:
    """Return the recordings with the noise of their truths relative to the median one, if clearly different.

    Runs of one robot share its effects and noise, but one may have motion capture and another a localisation as truth.
    """
    if len(clocks.truths) != len(recordings) or len(recordings) < 2:
        return list(recordings)
    xy_m = [max(truth.xy_m, _LEAST_M) for truth in clocks.truths]
    yaw_rad = [max(t.yaw_rad, _LEAST_RAD) for t, r in zip(clocks.truths, recordings, strict=True) if r.headed]
    usual_m, usual_rad = (median_low(values) if values else 1.0 for values in (xy_m, yaw_rad))
    found = []
    for recording, truth, own_m in zip(recordings, clocks.truths, xy_m, strict=True):
        ratio = own_m / usual_m, max(truth.yaw_rad, _LEAST_RAD) / usual_rad if recording.headed else 1.0
        alike = [1.0 / _PLAIN_LEVEL < r < _PLAIN_LEVEL for r in ratio]
        level = np.where(alike, 1.0, np.clip(ratio, 1.0 / _MOST_LEVEL, _MOST_LEVEL)).tolist()
        found.append(replace(recording, truth_level=(level[0], level[1])))
    return found


def _find_clock(runs: Sequence[Recording], approach: Approach, beside: Sequence[Effect]) -> _Found:
    """Return the common clock of runs: offset and rate if significant, else the offset alone, else no clock."""
    nuisance: Sequence[Effect] = [*(registry()[name]() for name in nuisance_of(runs)), *beside]
    clock = coarse_clock(max(runs, key=lambda run: len(run.odometry)))
    noise = None
    for free in ((True, True), (True, False)):
        problem = pose_problem(
            runs, nuisance, [Clock(clock.offset_s, clock.rate if free[1] else 0.0)] * len(runs), approach=approach
        )
        held = prior_deviations(problem.effects)
        best = fit_problem(problem, [free] * len(runs), start=noise, nearly=True, held=held)
        noise, clock, nuisance = best.noise.free, best.next_clocks[0], best.next_effects
        errors = (float(best.clock_errors[0, 0]), float(best.clock_errors[0, 1]))
        last, error = (clock.rate, errors[1]) if free[1] else (clock.offset_s, errors[0])
        clear = abs(last) > _CLOCK_LIMIT * error > 0.0
        expected = not free[1] and _of_stamps(runs, clock, errors[0])
        if clear or expected:
            return _Found(clock, free, errors, best)
    return _Found(Clock(), (False, False), (errors[0], 0.0), best)


def _of_stamps(runs: Sequence[Recording], clock: Clock, error_s: float) -> bool:
    """Return whether stamps can hide an offset, and it is known better than their error.

    Rounding shifts stamps by up to one step, varying arrivals are late, and a scanner has a clock or delay of its own.
    Such an offset is expected before the data are seen, so it needs no evidence.
    """
    hidden_s = max(float(np.hypot(r.stamp_error_s, r.stamp_jitter_s)) for r in runs)
    if any(r.matched for r in runs):
        hidden_s = max(hidden_s, _SCAN_CLOCK_S)
    return 0.0 < error_s < hidden_s and abs(clock.offset_s) < np.sqrt(12.0) * hidden_s


def mounting_of(recordings: Sequence[Recording], beside: Sequence[Effect] = ()) -> tuple[Effect, ...]:
    """Return lever arm and mounting yaw as effects to free in every fit, if the truth comes from a sensor on the robot.

    The scans determine a laser's mounting better than it is ever measured. Effects in `beside` are left out.
    """
    aboard = any(r.positioned and (r.matched or r.truth.relative) for r in recordings)
    there = _with_aliases(beside)
    return tuple(registry()[name]() for name in MOUNTING if aboard and name not in there)


def _with_aliases(effects: Sequence[Effect]) -> set[str | None]:
    """Return the names of effects and of those with the same error."""
    names = {name for effect in effects for name in (effect.name, effect.aliased_with)}
    return names | {name for name, kind in registry().items() if kind.aliased_with in names}


def find_setup(
    recordings: Sequence[Recording], effects: Sequence[Effect], clocks: Clocks, approach: Approach
) -> tuple[Effect, ...]:
    """Return the significant ones of lever arm and mounting yaw, shared by all recordings.

    They are estimated with the usual systematic effects free, which are then discarded. One that is not significant,
    that increases the drift, or that is aliased with a requested effect is left out.
    """
    kinds, asked = registry(), _with_aliases(effects)
    near = {effect.name: effect for effect in clocks.beside}
    usual = [near.get(name, kinds[name]()) for name in nuisance_of(recordings) if name not in asked]
    free, beside = ([effect for effect in usual if (effect.name in MOUNTING) is ours] for ours in (True, False))
    if not free:
        return ()

    def fitted(*together: Effect) -> Fit:
        return fit(
            recordings, together, clocks=clocks.clocks, free_clocks=clocks.free, approach=approach, start=clocks.noise
        )

    best = fitted(*free, *beside, *effects)
    there = [
        e
        for e in best.effects[: len(free)]
        if len(amplitudes(e)) * chi2.sf(best.size_errors[e.name] ** 2, 1) < SETUP_LEVEL
    ]
    if not there:
        return ()
    alone = fitted(*there, *effects)
    found = alone.effects[: len(there)]
    better = ten_second_error(alone) <= ten_second_error(fitted(*effects))
    # one near its bound compensates for another cause
    plausible = all(2.0 * abs(getattr(e, p.name)) < p.high for e in found for p in amplitudes(e))
    return found if better and plausible else ()
