"""Lack of fit of a model, localised: in which motion, at which time or place, after which path length.

All patterns (strata: kinds of motion, stretches of time, discs in the truth's plane) compete. The most significant one
is taken and its error projected out before the next search, so that one cause is reported once. Errors are odometry
minus truth: a positive rate along means that the odometry ends too far ahead, across too far to the left, and yaw that
it turns too far to the left.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from operator import itemgetter
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from scipy.stats import chi2, norm

from odomcorrupt.study.terms.basis import STILL

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.problem import Problem
    from odomcorrupt.study.estimate.whitener import Whitener
    from odomcorrupt.study.validate.calibration import Horizon

CHANNELS = ("along", "across", "yaw")


class IntervalMotion(NamedTuple):
    """Motion over each of K intervals, (K,) each.

    t_s : time of its end since the recording's origin, seconds
    metres, seconds : distance travelled and duration
    v, omega, a : mean forward speed m/s, yaw rate rad/s, forward acceleration m/s^2
    x, y, heading : truth at its start, m and rad
    distance : travelled from the start of the run to its end, m
    """

    t_s: Array
    metres: Array
    seconds: Array
    v: Array
    omega: Array
    a: Array
    x: Array
    y: Array
    heading: Array
    distance: Array


def interval_motion(problem: Problem) -> IntervalMotion:
    """Return the motion over every interval, from the smoothed motion of the regressors."""
    intervals, motions = problem.intervals, problem.motions
    dt = np.concatenate([m.dt_s for m in motions])
    rates = [np.concatenate([getattr(m, name) for m in motions]) for name in ("speed", "v", "omega", "a")]
    columns = [dt, *(rate * dt for rate in rates)]
    weighted = np.stack(columns, axis=1)[intervals.source] * intervals.share[:, None]
    seconds, metres, v, omega, a = np.add.reduceat(weighted, intervals.first, axis=0).T
    per = 1.0 / np.maximum(seconds, 1e-9)
    distance = np.concatenate([np.cumsum(metres[problem.run == r]) for r in np.unique(problem.run)])
    x, y, heading = intervals.truth_xyt.T
    return IntervalMotion(intervals.end_s, metres, seconds, v * per, omega * per, a * per, x, y, heading, distance)


def unit_columns(problem: Problem, *, per_second: bool = False) -> Array:
    """Return the residuals (K, 3, 3) caused by an error rate of one per metre (or second) in each channel.

    Multiplied by a mask over the intervals, a column is that rate in a part of the drive.
    """
    parts = [m.dt_s if per_second else m.travel for m in problem.motions]
    weight = np.concatenate(parts)
    return np.stack([problem.intervals.column(weight[:, None] * unit) for unit in np.eye(3)], axis=2)


@dataclass(frozen=True, slots=True)
class Rates:
    """Jointly estimated rates of one channel in B parts of a drive.

    estimate : (B,) m/m or rad/m, odometry minus truth; NaN if a part has no intervals
    allowed : (B,) standard deviation of the estimate from the model's noise alone
    """

    estimate: Array
    allowed: Array


def joint_rates(whitener: Whitener, innovations: Array, unit: Array, part: NDArray[np.int64], count: int) -> Rates:
    """Return error rates of one channel in disjoint parts of a drive.

    whitener, innovations : of the residuals; innovations (3 K,)
    unit : (K, 3) column of the channel, from `unit_columns`
    part : (K,) index of each interval's part, of `count` parts, -1 for none
    """
    masks = part[:, None] == np.arange(count)
    held = np.sum(masks, axis=0) > 0
    estimate, allowed = np.full(count, np.nan), np.full(count, np.nan)
    white = whitener.whiten(unit[:, :, None] * masks[:, None, held])
    covariance = np.linalg.pinv(white.T @ white, hermitian=True)
    estimate[held] = covariance @ (white.T @ innovations)
    allowed[held] = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return Rates(estimate, allowed)


_SHARES = (4, 8, 16)
"""Divisors of a run's duration for stretches of time, and of the width of the place for radii of discs."""
_MIN_SHARE, _MAX_SHARE = 0.02, 0.6
"""Least fraction of the drive in a pattern, and largest fraction in a stretch of time or disc."""
_TURN_PER_M = 0.1  # least curvature of a turn, rad/m
_MIN_ACCELERATION = 0.1  # least acceleration, m/s^2


@dataclass(frozen=True, slots=True)
class Pattern:
    """A part of a drive.

    mask : (K,) 1 for intervals in this part
    per : "m" for rates per metre, "s" per second
    amount : metres or seconds in this part
    """

    kind: Literal["motion", "time", "place"]
    where: str
    mask: Array
    per: str
    amount: float
    span_s: tuple[float, float] | None = None
    place: tuple[float, float, float] | None = None


def all_patterns(motion: IntervalMotion) -> list[Pattern]:
    """Return the parts of a drive that contain enough of it."""
    total = {"m": float(motion.metres.sum()), "s": float(motion.seconds.sum())}
    every = (*_kinds_of_motion(motion), *_stretches(motion), *_discs(motion))
    most = {"motion": np.inf, "time": _MAX_SHARE, "place": _MAX_SHARE}
    return [p for p in every if _MIN_SHARE <= p.amount / total[p.per] <= most[p.kind]]


def _kinds_of_motion(m: IntervalMotion) -> Iterator[Pattern]:
    speed = np.abs(m.v)
    moving = speed > STILL
    curvature = np.where(moving, m.omega / np.where(moving, m.v, 1.0), 0.0)
    turning = moving & (np.abs(curvature) > _TURN_PER_M)
    fast = float(np.median(speed[moving])) if moving.any() else 0.0
    speeding = m.a * np.sign(m.v)
    spot = ~moving & (np.abs(m.omega) > 0.1)
    driving = {
        "in all motion": moving,
        "in left turns": turning & (m.omega > 0.0),
        "in right turns": turning & (m.omega < 0.0),
        "on straights": moving & ~turning,
        "in reverse": m.v < -STILL,
        "at the faster speeds": moving & (speed > fast),
        "at the slower speeds": moving & (speed <= fast),
        "while speeding up": moving & (speeding > _MIN_ACCELERATION),
        "while braking": moving & (speeding < -_MIN_ACCELERATION),
    }
    standing = {
        "turning on the spot to the left": spot & (m.omega > 0.0),
        "turning on the spot to the right": spot & (m.omega < 0.0),
        "at rest": ~moving & ~spot,
    }
    for per, amount, kinds in (("m", m.metres, driving), ("s", m.seconds, standing)):
        for where, mask in kinds.items():
            yield Pattern("motion", where, mask.astype(np.float64), per, float(amount[mask].sum()))


def _stretches(m: IntervalMotion) -> Iterator[Pattern]:
    start, end = float(m.t_s[0] - m.seconds[0]), float(m.t_s[-1])
    for share in _SHARES:
        length = (end - start) / share
        # overlap by half, so that every event is well inside one of them
        for first in (start + length / 2.0 * np.arange(2 * share - 1)).tolist():
            mask, span = (m.t_s > first) & (m.t_s <= first + length), (first, first + length)
            where = f"from {span[0]:.0f} s to {span[1]:.0f} s"
            yield Pattern("time", where, mask.astype(np.float64), "m", float(m.metres[mask].sum()), span_s=span)


def _discs(m: IntervalMotion) -> Iterator[Pattern]:
    width = float(max(np.ptp(m.x), np.ptp(m.y)))
    for radius in (width / share for share in _SHARES if width > 0.0):
        centres = (np.arange(axis.min(), axis.max() + radius, radius).tolist() for axis in (m.x, m.y))
        for x, y in product(*centres):
            mask = np.hypot(m.x - x, m.y - y) < radius
            where, place = f"within {radius:.2g} m of ({x:.1f}, {y:.1f})", (x, y, radius)
            yield Pattern("place", where, mask.astype(np.float64), "m", float(m.metres[mask].sum()), place=place)


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

    innovations : (3 K,) standardised
    """
    motion = interval_motion(problem)
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
        found.append(
            Failure(
                kind=pattern.kind,
                channel=CHANNELS[c],
                where=pattern.where,
                per=pattern.per,
                measured=float(columns[:, best] @ r / length[best] ** 2),
                expected=2.0 / float(length[best]),
                amount=pattern.amount,
                log_p=float(log_p[best]),
                recording=name,
                span_s=pattern.span_s,
                place=pattern.place,
                besides=any(f.channel == CHANNELS[c] for f in found),
            )
        )
        unit = columns[:, best] / length[best]
        r = r - unit * (unit @ r)
        columns = columns - np.outer(unit, unit @ columns)
    return found


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
    intervals = problem.intervals
    found = []
    for k in np.argsort(square)[::-1][:_MAX_SUDDEN]:
        if log_p[k] > np.log(LEVEL):
            break
        ratio = (np.abs(intervals.residual[k]) / deviation[k])[:count]
        c = int(np.argmax(ratio))
        start, end = float(intervals.start_s[k]), float(intervals.end_s[k])
        x, y, _ = map(float, intervals.truth_xyt[k])
        found.append(
            Failure(
                kind="moment",
                channel=CHANNELS[c],
                where=f"within {end - start:.2g} s at {start:.1f} s",
                per="",
                measured=float(intervals.residual[k, c]),
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
    found = list[tuple[float, Failure]]()
    tests = 3 * len(horizons)
    for c, channel in enumerate(CHANNELS):
        for h in reversed(horizons):
            off = abs(np.log(max(h.measured[c] / h.expected[c], 1e-12)))  # a simulation may have no error
            if h.excess_p[c] * tests < LEVEL and off > _MIN_LOG_RATIO:
                failure = Failure(
                    kind="drift",
                    channel=channel,
                    where=f"over {h.distance_m:g} m of path",
                    per="",
                    measured=float(h.measured[c]),
                    expected=float(h.expected[c]),
                    amount=float(h.windows),
                    log_p=float(np.log(max(h.excess_p[c] * tests, 1e-300))),
                )
                found.append((off, failure))
                break
    return [failure for _, failure in sorted(found, key=itemgetter(0), reverse=True)]
