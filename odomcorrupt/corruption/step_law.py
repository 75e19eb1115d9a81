"""`--step`: a noise law applied once per step of distance or angle, not once per message."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.model.noise_laws import Variances, variances

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.increments import Increments
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import Noise, Step

__all__ = ["StepGrowth", "noise_variances"]


@dataclass(frozen=True, slots=True)
class StepGrowth:
    """Progress of a path within its step: metres and radians since its start, now and at the start of the step."""

    gone_m: float = 0.0
    gone_rad: float = 0.0
    began_m: float = 0.0
    began_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class GrownVariances:
    """Variances of n increments, and the progress after them."""

    variances: Variances
    growth: StepGrowth


def noise_variances(noise: Noise, steps: Increments, dt_s: Array, growth: StepGrowth) -> GrownVariances:
    """Return the noise variances of n increments of lengths dt_s (n,) seconds.

    With a step, an increment's variance is the growth of the law's variance since the step's start. The law is
    evaluated at the metres and radians since then, the turn halved between rot1 and rot2, so growth is never
    negative; a step ends exactly at its distance or angle, if need be inside an increment. The same increments give
    the same bits for any division into calls.
    """
    grown = GrownVariances(variances(noise.law, noise.coefficients, steps), growth)
    if noise.step is not None and len(steps):
        grown = _within_steps(noise, noise.step, steps, growth)
    k = noise.coefficients
    if k.white_v or k.white_omega:
        v, turn = grown.variances, (k.white_omega * dt_s) ** 2 / 2.0
        v = Variances(v.rot1 + turn, v.trans + (k.white_v * dt_s) ** 2, v.across, v.rot2 + turn)
        grown = GrownVariances(v, grown.growth)
    return grown


def _within_steps(noise: Noise, step: Step, steps: Increments, growth: StepGrowth) -> GrownVariances:
    gone_m = np.cumsum(np.concatenate(([growth.gone_m], np.hypot(steps.ds_m, steps.dl_m))))
    gone_rad = np.cumsum(np.concatenate(([growth.gone_rad], np.abs(steps.dtheta_rad))))
    ends = _ends(step, growth, gone_m, gone_rad)

    # every increment is divided at the ends of steps inside it
    n = len(steps)
    owner = np.concatenate((ends.increment, np.arange(n)))
    order = np.lexsort((np.concatenate((np.zeros(len(ends.increment)), np.ones(n))), owner))
    upto_m = np.concatenate((ends.at_m, gone_m[1:]))[order]
    upto_rad = np.concatenate((ends.at_rad, gone_rad[1:]))[order]
    is_end = order < len(ends.increment)
    step_of: NDArray[np.int64] = np.cumsum(is_end) - is_end
    began_m = np.concatenate(([growth.began_m], ends.at_m))[step_of]
    began_rad = np.concatenate(([growth.began_rad], ends.at_rad))[step_of]
    from_m = np.concatenate(([growth.gone_m], upto_m[:-1]))
    from_rad = np.concatenate(([growth.gone_rad], upto_rad[:-1]))
    after = _law_at(noise, upto_m - began_m, upto_rad - began_rad)
    before = _law_at(noise, from_m - began_m, from_rad - began_rad)

    first_piece = np.flatnonzero(np.diff(owner[order], prepend=-1))

    def grown(late: Array, early: Array) -> Array:
        summed: Array = np.add.reduceat(np.maximum(late - early, 0.0), first_piece)
        return summed

    total = Variances(
        grown(after.rot1, before.rot1),
        grown(after.trans, before.trans),
        grown(after.across, before.across),
        grown(after.rot2, before.rot2),
    )
    last_m = float(ends.at_m[-1]) if len(ends.at_m) else growth.began_m
    last_rad = float(ends.at_rad[-1]) if len(ends.at_rad) else growth.began_rad
    return GrownVariances(total, StepGrowth(float(gone_m[-1]), float(gone_rad[-1]), last_m, last_rad))


def _law_at(noise: Noise, gone_m: Array, gone_rad: Array) -> Variances:
    half = np.maximum(gone_rad, 0.0) / 2.0
    return noise.law.rule(noise.coefficients, half, np.maximum(gone_m, 0.0), half)


@dataclass(frozen=True, slots=True)
class _Ends:
    """Ends of steps: index of the increment of each, and metres and radians since the path's start."""

    increment: NDArray[np.int64]
    at_m: Array
    at_rad: Array


def _ends(step: Step, growth: StepGrowth, gone_m: Array, gone_rad: Array) -> _Ends:
    found: list[tuple[int, float, float]] = []
    began_m, began_rad = growth.began_m, growth.began_rad
    while began_m + step.distance_m <= gone_m[-1] or began_rad + step.angle_rad <= gone_rad[-1]:
        far, turned = began_m + step.distance_m, began_rad + step.angle_rad
        i = min(int(np.searchsorted(gone_m, far)), int(np.searchsorted(gone_rad, turned))) - 1
        at_m, at_rad = _meet(far, turned, gone_m[i : i + 2], gone_rad[i : i + 2])
        found.append((i, at_m, at_rad))
        began_m, began_rad = at_m, at_rad
    columns = np.array(found, dtype=float).reshape(-1, 3)
    return _Ends(columns[:, 0].astype(np.int64), columns[:, 1], columns[:, 2])


def _meet(far: float, turned: float, span_m: Array, span_rad: Array) -> tuple[float, float]:
    """Return metres and radians at which an increment first reaches the step's distance or angle."""
    length, turn = float(span_m[1] - span_m[0]), float(span_rad[1] - span_rad[0])
    by_m = (far - float(span_m[0])) / length if far <= span_m[1] else np.inf
    by_rad = (turned - float(span_rad[0])) / turn if turned <= span_rad[1] else np.inf
    if by_m <= by_rad:
        return far, float(span_rad[0]) + by_m * turn
    return float(span_m[0]) + by_rad * length, turned
