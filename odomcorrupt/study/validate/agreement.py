"""Whether the measures of a comparison agree that one model is better than another.

One measure alone misleads: on a drive the position error after 10 s fell to 95 % while the log likelihood fell by 24
nats per metre and the trajectory error doubled.
"""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Literal, NamedTuple

if TYPE_CHECKING:
    from odomcorrupt.study.validate.compare import Comparison, Judgement

__all__ = ["Agreement", "Measure", "agreement_of"]

Change = Literal["better", "worse", "same"]

_ERROR_SHARE = 0.02
"""A position error after 10 s that changes by less is the same: windows overlap few, but they are many."""
_TRAJECTORY_SHARE = 0.1
"""The same of the absolute trajectory error, which is one number of a whole drive and scatters more."""
_SIGMAS = 2.0
"""Standard errors by which a log likelihood must change."""


class Measure(NamedTuple):
    """One measure of two models: its values, metres or nats per metre, and what the change means."""

    name: str
    before: float
    after: float
    change: Change


class Agreement(NamedTuple):
    """All measures of two models, and what they say together.

    verdict : better or worse where some say so and none contradicts; same; or mixed
    """

    measures: tuple[Measure, ...]
    verdict: Literal["better", "worse", "same", "mixed"]


def agreement_of(comparison: Comparison) -> Agreement:
    """Return how the last model of a comparison does beside the first one, by every measure there is.

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
