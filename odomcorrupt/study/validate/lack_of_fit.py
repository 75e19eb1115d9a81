"""Lack of fit of a model, localised: in which motion, at which time or place, after which path length.

All patterns (kinds of motion, stretches of time, discs in the truth's plane) compete. The most significant one is taken
and its error projected out before the next search, so that one cause is reported once. Signs: odometry minus truth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy.stats import chi2, norm

from odomcorrupt.study.validate.error_rates import CHANNELS, node_motion, unit_columns
from odomcorrupt.study.validate.strata import Pattern, all_patterns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.problem import Problem
    from odomcorrupt.study.estimate.whitener import Whitener
    from odomcorrupt.study.validate.calibration import Horizon

__all__ = ["Failure", "drift_failures", "failures", "sudden_failures"]

LEVEL = 0.01  # significance level after correction for multiple tests
_MAX_FAILURES = 6
_MAX_SUDDEN = 3
_MIN_LOG_RATIO = float(np.log(1.2))
"""Smaller factors between measured and expected errors are not reported, however significant."""
_MIN_NORM = 0.3
"""A pattern that keeps a smaller part of its norm after projection is redundant with those already found."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
    """A part of a drive in which the odometry error exceeds the model's prediction; values are odometry minus truth.

    kind : "motion", "time", "place" (an error rate), "moment" (a sudden error) or "drift" (error after a path length)
    channel : "along", "across" or "yaw"
    where : description of the part of the drive: "in left turns"
    per : unit of a rate: "m" driven, "s" at rest; "" for a size
    measured : the rate (m or rad per `per`), or the size (m or rad)
    expected : upper limit by the model: two standard deviations of a rate or moment; RMS of a drift
    amount : metres (seconds at rest) in this part; windows of a drift; 1 for a moment
    log_p : natural logarithm of the p-value, corrected for multiple tests
    besides : whether a rate adds to rates of the same channel found before
    recording : name of the recording
    span_s, place : (start, end) in seconds since the recording began; (x, y, radius) in the truth's frame, m
    """

    kind: Literal["motion", "time", "place", "moment", "drift"]
    channel: str
    where: str
    per: str
    measured: float
    expected: float
    amount: float
    log_p: float
    besides: bool = False
    recording: str = ""
    span_s: tuple[float, float] | None = None
    place: tuple[float, float, float] | None = None


def failures(
    problem: Problem, whitener: Whitener, innovations: Array, *, headed: bool = True, name: str = ""
) -> list[Failure]:
    """Return the parts of a drive with unexpected error rates, the most significant first.

    Parameters
    ----------
    problem, whitener : of a single recording under a model
    innovations : (3 K,) standardised
    name : name of the recording

    """
    motion = node_motion(problem)
    patterns = all_patterns(motion)
    units = {"m": unit_columns(problem), "s": unit_columns(problem, per_second=True)}
    tries = [(pattern, c) for pattern in patterns for c in range(3 if headed else 2)]
    raw = np.stack([units[p.per][:, :, c] * p.mask[:, None] for p, c in tries], axis=2)
    columns = whitener.whiten(raw)
    r = innovations.copy()
    own = np.linalg.norm(columns, axis=0)
    # Inflate if errors are larger everywhere: this is a misfit of the noise, not of a pattern.
    inflation = np.sqrt(max(1.0, float(r @ r) / len(r)))
    family = {kind: 3 * sum(p.kind == kind for p in patterns) for kind in ("motion", "time", "place")}
    cost = np.array([np.log(3.0 * family[p.kind]) for p, _ in tries])
    found: list[Failure] = []
    while len(found) < _MAX_FAILURES:
        length = np.linalg.norm(columns, axis=0)
        usable = length > np.maximum(_MIN_NORM * own, 1e-12)
        z = np.where(usable, columns.T @ r / np.where(usable, length, 1.0), 0.0) / inflation
        log_p = norm.logsf(np.abs(z)) + np.log(2.0) + cost
        best = int(np.argmin(log_p))
        if log_p[best] > np.log(LEVEL):
            break
        pattern, c = tries[best]
        rate = float(columns[:, best] @ r / length[best] ** 2)
        failure = _rate_failure(pattern, CHANNELS[c], rate, 2.0 / float(length[best]), float(log_p[best]), name)
        found.append(replace(failure, besides=any(f.channel == failure.channel for f in found)))
        unit = columns[:, best] / length[best]
        r = r - unit * (unit @ r)
        columns = columns - np.outer(unit, unit @ columns)
    return found


def _rate_failure(pattern: Pattern, channel: str, rate: float, expected: float, log_p: float, name: str) -> Failure:
    return Failure(
        kind=pattern.kind,
        channel=channel,
        where=pattern.where,
        per=pattern.per,
        measured=rate,
        expected=expected,
        amount=pattern.amount,
        log_p=log_p,
        recording=name,
        span_s=pattern.span_s,
        place=pattern.place,
    )


def sudden_failures(
    problem: Problem, covariance: Array, innovations: Array, *, headed: bool = True, name: str = ""
) -> list[Failure]:
    """Return the moments (intervals) with an error too large for chance, the largest first.

    covariance : (K, 3, 3) predicted marginal covariance of each residual
    """
    count = 3 if headed else 2
    square = np.sum(innovations.reshape(-1, 3)[:, :count] ** 2, axis=1)
    log_p = chi2.logsf(square, count) + np.log(len(square))
    deviation = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    nodes = problem.nodes
    found = []
    for k in np.argsort(square)[::-1][:_MAX_SUDDEN]:
        if log_p[k] > np.log(LEVEL):
            break
        ratio = (np.abs(nodes.residual[k]) / deviation[k])[:count]
        c = int(np.argmax(ratio))
        start, end = float(nodes.start_s[k]), float(nodes.end_s[k])
        x, y, _ = map(float, nodes.truth_xyt[k])
        found.append(
            Failure(
                kind="moment",
                channel=CHANNELS[c],
                where=f"within {end - start:.2g} s at {start:.1f} s",
                per="",
                measured=float(nodes.residual[k, c]),
                expected=2.0 * float(deviation[k, c]),
                amount=1.0,
                log_p=float(log_p[k]),
                recording=name,
                span_s=(start, end),
                place=(x, y, 0.0),
            )
        )
    return found


def drift_failures(horizons: Sequence[Horizon]) -> list[Failure]:
    """Return, per channel, the longest path after which errors differ from the model's prediction."""
    found = []
    tests = 3 * len(horizons)
    for c, channel in enumerate(CHANNELS):
        for h in reversed(horizons):
            ratio = h.measured[c] / h.expected[c]
            if h.excess_p[c] * tests < LEVEL and abs(np.log(ratio)) > _MIN_LOG_RATIO:
                log_p = float(np.log(max(h.excess_p[c] * tests, 1e-300)))
                found.append(
                    Failure(
                        kind="drift",
                        channel=channel,
                        where=f"over {h.distance_m:g} m of path",
                        per="",
                        measured=float(h.measured[c]),
                        expected=float(h.expected[c]),
                        amount=float(h.windows),
                        log_p=log_p,
                    )
                )
                break
    # Sort channels by the factor between measured and expected errors.
    return sorted(found, key=lambda f: abs(np.log(f.measured / f.expected)), reverse=True)
