"""Estimate the mounting of the truth's tracked point: like the clocks, a property of the set-up, not of the robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scipy.stats import chi2

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.study.estimate.clocks import Clocks, nuisance_of
from odomcorrupt.study.estimate.drift_error import ten_second_error
from odomcorrupt.study.estimate.drive_type import MOUNTING
from odomcorrupt.study.estimate.gauss_newton import Fit, fit

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.estimate.config import Approach
    from odomcorrupt.study.io.recording import Recording

_LEVEL = 1e-4


def mounting_of(recordings: Sequence[Recording], beside: Sequence[Effect] = ()) -> tuple[Effect, ...]:
    """Return lever arm and mounting yaw as effects to free in every fit, if the truth comes from a sensor on the robot.

    The scans determine a laser's mounting better than it is ever measured. Effects in `beside` are left out.
    """
    kinds = registry()
    aboard = any(r.positioned and (r.matched or r.truth.relative) for r in recordings)
    there = {name for effect in beside for name in (effect.name, effect.aliased_with)}
    there |= {name for name, kind in kinds.items() if kind.aliased_with in there}
    return tuple(kinds[name]() for name in MOUNTING if aboard and name not in there)


def find_setup(
    recordings: Sequence[Recording], effects: Sequence[Effect], clocks: Clocks, approach: Approach
) -> tuple[Effect, ...]:
    """Return the significant ones of lever arm and mounting yaw, shared by all recordings.

    They are estimated with the usual systematic effects free, which are then discarded. One that is not significant,
    that increases the drift, or that is aliased with a requested effect is left out.

    effects : requested effects
    clocks : clocks of the recordings
    approach : intervals, side of the regressors and noise law
    """
    kinds = registry()
    asked = {name for effect in effects for name in (effect.name, effect.aliased_with)}
    asked |= {name for name, kind in kinds.items() if kind.aliased_with in asked}
    near = {effect.name: effect for effect in clocks.beside}

    def usual(names: Iterable[str]) -> list[Effect]:
        return [near.get(name, kinds[name]()) for name in names if name not in asked]

    names = nuisance_of(recordings)
    free, beside = (usual(name for name in names if (name in MOUNTING) is ours) for ours in (True, False))
    if not free:
        return ()

    def fitted(*together: Effect) -> Fit:
        return fit(
            recordings, together, clocks=clocks.clocks, free_clocks=clocks.free, approach=approach, start=clocks.noise
        )

    best = fitted(*free, *beside, *effects)
    there = [e for e in best.effects[: len(free)] if chi2.sf(best.wald[e.name], len(amplitudes(e))) < _LEVEL]
    if not there:
        return ()
    alone = fitted(*there, *effects)
    found = alone.effects[: len(there)]
    better = ten_second_error(alone) <= ten_second_error(fitted(*effects))
    # one near its bound compensates for another cause
    plausible = all(2.0 * abs(getattr(e, p.name)) < p.high for e in found for p in amplitudes(e))
    return found if better and plausible else ()
