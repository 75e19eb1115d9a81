"""Basis functions of time: exponential settling; of one drive also steps, and spells between two moments."""

from __future__ import annotations

from itertools import pairwise, product
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.study.terms.basis.basis_function import REFINING, BasisFunction
from odomcorrupt.study.terms.basis.motion import thresholds

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from odomcorrupt.effects.effect import Motion

_SETTLE_S = (30.0, 80.0, 200.0)  # settling times on the grid, s
_QUICKEST_S, _SLOWEST_S = 10.0, 1e4
"""Least and largest settling time that is tried, s; faster settling leaves nothing to observe."""
_SPELLS, _SPELL_PARTS = 10, (0.08, 0.16)
"""Number of centres of a spell that are tried, and half its length as fractions of the whole time."""
_ANYWHERE = ("body", "one", "both", "twist")  # targets of functions of time


def functions_of_time(motions: Sequence[Motion]) -> Iterator[BasisFunction]:
    """Yield every function of time to be tried on these motions.

    Exponential decays and rises are those of tyres, motors and sensors that warm up; errors from or between two
    moments, of a load that was carried for a while, have no time in common in several drives.
    """
    for tau_s, rising in product(_SETTLE_S, (False, True)):
        yield _settling((float(np.log(tau_s)),), rising=rising)
    ends_s = sorted((float(m.t_s[0]), float(m.t_s[-1])) for m in motions)
    if any(after[0] < before[1] for before, after in pairwise(ends_s)):
        return
    yield from thresholds("time", motions)
    longest_s = max(float(np.ptp(m.t_s)) for m in motions)
    for part, i in product(_SPELL_PARTS, range(_SPELLS)):
        yield _spell((ends_s[0][0] + (i + 0.5) / _SPELLS * longest_s, part * longest_s), 0.25 * longest_s / _SPELLS)


def _settling(shape: tuple[float, ...], *, rising: bool) -> BasisFunction:
    tau_s = float(np.clip(np.exp(min(shape[0], 50.0)), _QUICKEST_S, _SLOWEST_S))
    return BasisFunction(
        "time",
        f"k * (1 - exp(-t / {tau_s:.4g}))" if rising else f"k * exp(-t / {tau_s:.4g})",
        (lambda m: float(rising) + (-1.0 if rising else 1.0) * np.exp(-m.t_s / tau_s),),
        2 * len(_SETTLE_S) * REFINING,
        reaches=(*_ANYWHERE, "bias"),
        shape=shape,
        steps=(0.5,),
        with_shape=lambda moved: _settling(moved, rising=rising),
    )


def _spell(shape: tuple[float, ...], step_s: float) -> BasisFunction:
    middle_s, half_s = shape[0], max(shape[1], 1.0)
    return BasisFunction(
        "time",
        f"k * where(abs(t - {middle_s:.6g}) < {half_s:.6g}, 1, 0)",
        (lambda m: (np.abs(m.t_s - middle_s) < half_s).astype(np.float64),),
        len(_SPELL_PARTS) * _SPELLS * REFINING**2,
        reaches=(*_ANYWHERE, "bias"),
        shape=(middle_s, half_s),
        steps=(2.0 * step_s, step_s),
        with_shape=lambda moved: _spell(moved, step_s),
    )
