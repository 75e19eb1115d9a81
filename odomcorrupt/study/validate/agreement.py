"""Agreement of a comparison's measures on whether one model is better than another.

A single measure can mislead: on one drive the position error after 10 s fell to 95 % while the log likelihood fell by
24 nats per metre and the trajectory error doubled.
"""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Literal, NamedTuple

if TYPE_CHECKING:
    from odomcorrupt.study.validate.compare import Comparison, Judgement

__all__ = ["Agreement", "Measure", "agreement_of"]

Change = Literal["better", "worse", "same"]

_ERROR_SHARE = 0.02
"""Smaller relative changes of the position error after 10 s count as none (many windows, small scatter)."""
_TRAJECTORY_SHARE = 0.1
"""The same for the absolute trajectory error, which is one number per drive and scatters more."""
_SIGMAS = 2.0
"""Standard errors by which a log likelihood must change to count as different."""


class Measure(NamedTuple):
    """One measure of two models: its values, metres or nats per metre, and whether the change is an improvement."""

    name: str
    before: float
    after: float
    change: Change


class Agreement(NamedTuple):
    """All measures of two models, and their joint verdict.

    verdict : better or worse if some measures agree on it and none contradicts; otherwise same or mixed
    """

    measures: tuple[Measure, ...]
    verdict: Literal["better", "worse", "same", "mixed"]


def agreement_of(comparison: Comparison) -> Agreement:
    """Return the change from the first to the last model of a comparison, by every measure available.

    Returns
    -------
    Agreement
        Position error after 10 s (m), log likelihood (nats per metre) and absolute trajectory error (m).

    """
    first, last = comparison.judgements[0], comparison.judgements[-1]
    found = [
        Measure(
            "10 s error",
            first.ten_second_error_m,
            last.ten_second_error_m,
            _of_errors(first.ten_second_error_m, last.ten_second_error_m, _ERROR_SHARE),
        ),
        Measure("log likelihood", first.nats.per_m, last.nats.per_m, _of_likelihood(last)),
        Measure(
            "ATE",
            first.trajectory.ate_m,
            last.trajectory.ate_m,
            _of_errors(first.trajectory.ate_m, last.trajectory.ate_m, _TRAJECTORY_SHARE),
        ),
    ]
    measures = tuple(one for one in found if isfinite(one.before) and isfinite(one.after))
    changes = {one.change for one in measures} - {"same"}
    if changes == {"better", "worse"}:
        return Agreement(measures, "mixed")
    if not changes:
        return Agreement(measures, "same")
    return Agreement(measures, "better" if "better" in changes else "worse")


def _of_errors(before: float, after: float, share: float) -> Change:
    if after < (1.0 - share) * before:
        return "better"
    return "worse" if after > (1.0 + share) * before else "same"


def _of_likelihood(last: Judgement) -> Change:
    gain, error = last.nats.gain_per_m, last.nats.gain_error
    if not isfinite(gain) or abs(gain) <= _SIGMAS * (error if isfinite(error) else 0.0):
        return "same"
    return "better" if gain > 0.0 else "worse"
