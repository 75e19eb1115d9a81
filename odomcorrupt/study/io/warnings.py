"""What looks odd about odometry and truth, but may be meant: it is said, not refused."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import between, wrap

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.feedback import Feedback
    from odomcorrupt.study.io.raw_trajectory import Samples

__all__ = ["check_identity", "filter_signs", "heading_signs", "without_constant_heading", "without_course"]

_FUSED = re.compile(r"filter|fused|ekf|ukf|amcl|slam|locali[sz]ation|global")
_WORLD = frozenset({"map", "world", "earth", "utm"})
_SAME = 1e-6
_SAME_M = 2e-3
_MOVES = 1e-4
_FEW = 10
_SHRINKS = 0.7
_CORRECTIONS = 5
_STRIDE_S, _BACKS_M, _BACKINGS = 0.5, 0.05, 6
"""Backing up shows in steps so long in time and way, and so many of them have to."""
_MOSTLY, _NEARLY_ALL = 0.6, 0.9
"""Parts of the steps back, and of those ahead, that go where such headings point; of another drive, half do."""


def check_identity(odometry: Samples, truth: Samples) -> list[str]:
    """Refuse a truth that says what the odometry says, and notice one that mostly does.

    Raises
    ------
    RecordingError
        Where all steps of the truth are steps of the odometry.

    """
    if not truth.headed:
        return []
    step, own = _steps(odometry, truth)
    moving = np.abs(own).max(axis=1) > _MOVES
    if moving.sum() < _FEW:
        return []
    same = np.abs(step - own).max(axis=1)[moving] < _SAME
    share = float(same.mean())
    if share > 0.99 or (share > 0.5 and _apart(odometry, truth) < _SAME_M):
        raise RecordingError(
            f"{truth.place}: says what {odometry.name} says ({np.sum(same)} of {len(same)} steps are equal): it is the "
            "same odometry; name a truth that does not come from it"
        )
    if share > 0.5:
        what = "localisation on top of it, or a simulation without noise"
        return [f"{truth.name}: {share:.0%} of its steps are those of the odometry: {what}"]
    if _FUSED.search(truth.name.lower()):
        return [f"{truth.name}: its name says localisation, which may have used this odometry and repeat its errors"]
    return []


def heading_signs(odometry: Samples, truth: Samples) -> list[str]:
    """Notice headings of a truth that were made from the odometry: positions may be true, headings repeat it."""
    if not truth.headed:
        return []
    step, own = _steps(odometry, truth)
    turning = np.abs(own[:, 2]) > _MOVES
    if turning.sum() < _FEW:
        return []
    same = np.abs(step[:, 2] - own[:, 2])[turning] < _SAME
    if same.mean() > 0.5 and np.abs(step[:, :2] - own[:, :2]).max(axis=1)[turning].mean() > _SAME:
        what = "they were made from it, so that errors of heading cannot be seen"
        return [f"{truth.name}: {same.mean():.0%} of its headings turn exactly as the odometry does: {what}"]
    return []


def without_constant_heading(odometry: Samples, truth: Samples) -> Samples:
    """Return the truth as positions alone where its headings never change although the odometry turns."""
    if not truth.headed or np.ptp(truth.yaw_rad) > _SAME or np.ptp(np.unwrap(odometry.yaw_rad)) < 0.5:
        return truth
    return truth.without_headings().noted(
        "its headings never change while the odometry turns: taken as positions alone"
    )


def without_course(odometry: Samples, truth: Samples) -> Samples:
    """Return the truth as positions alone where its headings are the direction in which its positions move.

    A receiver with one antenna gives the course over ground for a heading: backing up, it points to where the robot
    goes, and at rest anywhere.
    """
    if not truth.headed or truth.relative or truth.span_s < _FEW * _STRIDE_S:
        return truth
    t_s = truth.seconds_since(int(truth.stamps_ns[0]))
    rows = np.unique(np.searchsorted(t_s, np.arange(0.0, t_s[-1], _STRIDE_S)))
    step, own = _steps(odometry, truth.only(rows))
    straight = np.abs(own[:, 0]) > np.maximum(_BACKS_M, 2.0 * np.abs(own[:, 1]))
    ahead, back = straight & (own[:, 0] > 0.0), straight & (own[:, 0] < 0.0)
    forwards = step[:, 0] > 0.5 * np.abs(own[:, 0])
    if min(back.sum(), ahead.sum()) < _BACKINGS or not (
        np.mean(forwards[back]) > _MOSTLY and np.mean(forwards[ahead]) > _NEARLY_ALL
    ):
        return truth
    return truth.without_headings().noted(
        "its headings point to where it moves, also when the robot backs up: taken as positions alone"
    )


def filter_signs(odometry: Samples, truth: Samples, feedback: Feedback) -> list[str]:
    """Notice odometry that corrects itself by other sensors: its errors are then not those of a motion model."""
    signs = []
    last = odometry.frame.rsplit("/", 1)[-1]
    if last in _WORLD:
        signs.append(f"its frame is {odometry.frame}")
    if _FUSED.search(odometry.name.lower()):
        signs.append("its name says so")
    shrinks = _shrinks(odometry.variance_m2)
    if shrinks:
        signs.append(f"its covariance shrinks {shrinks} times")
    jumps = _jumps_to_truth(odometry, truth)
    if jumps:
        signs.append(f"it jumps towards the truth {jumps} times")
    if feedback.per_s:
        signs.append(f"its errors fade by {1.0 - np.exp(-feedback.per_s):.0%} a second, as if it were given poses")
    if not signs:
        return []
    what = "a motion model describes what no other sensor has corrected"
    if feedback.corrections:
        what = (
            f"{feedback.corrections} sudden steps towards such poses were taken out, as `correct` does with the model; "
            "what is learned is of the odometry between them, its filter's lags included"
        )
    elif jumps or feedback.per_s:
        what += (
            ": of scales, biases and noise only what outlives a correction can be seen, clocks and lags as ever; "
            "record the wheels' own odometry for the rest"
        )
    return [f"{odometry.name}: looks like a filter's output, not like wheel odometry ({', '.join(signs)}); {what}"]


def _shrinks(variance: Array) -> int:
    """Count the times at which a growing variance falls back for good by a good part."""
    if len(variance) < _FEW:
        return 0
    falls = variance[1:] < _SHRINKS * variance[:-1]
    return int(falls.sum())


def _jumps_to_truth(odometry: Samples, truth: Samples) -> int:
    """Count the sudden steps of the odometry that bring it closer to the truth, where nearly all of them do."""
    t_s = odometry.seconds_since(int(odometry.stamps_ns[0]))
    own = truth.seconds_since(int(odometry.stamps_ns[0]))
    inside = (t_s >= own[0]) & (t_s <= own[-1])
    t_s, xy = t_s[inside], odometry.xyz[inside, :2]
    if len(t_s) < _FEW:
        return 0
    real = np.stack([np.interp(t_s, own, truth.xyz[:, i]) for i in (0, 1)], axis=1)
    # the turn and shift that lay the odometry onto the truth best
    p, q = (x[:, 0] + 1j * x[:, 1] for x in (xy, real))
    p, q = p - p.mean(), q - q.mean()
    turn = np.exp(1j * np.angle(np.vdot(p, q)))
    error = np.abs(p * turn - q)
    velocity = np.diff(p) / np.diff(t_s)
    sudden = np.abs(velocity[1:-1] - (velocity[:-2] + velocity[2:]) / 2.0) * np.diff(t_s)[1:-1]
    size = max(0.02, 20.0 * float(np.median(sudden)))
    # a jump shows in the steps beside it too, half as large
    beside = np.maximum(np.concatenate(([0.0], sudden[:-1])), np.concatenate((sudden[1:], [0.0])))
    at = np.flatnonzero((sudden > size) & (sudden > beside)) + 1
    if len(at) < _CORRECTIONS:
        return 0
    closer = error[at + 1] < error[at]
    return len(at) if closer.mean() > 0.8 else 0


def _apart(odometry: Samples, truth: Samples) -> float:
    """Return how far (m or rad) the two are ever apart, laid on each other at their first common time."""
    real, path = _common(odometry, truth)
    difference = between(real[:1], real) - between(path[:1], path)
    difference[:, 2] = wrap(difference[:, 2])
    return float(np.abs(difference).max())


def _steps(odometry: Samples, truth: Samples) -> tuple[Array, Array]:
    """Return the steps (k, 3) of the truth between its samples, and those of the odometry between the same times."""
    real, path = _common(odometry, truth)
    step, own = between(real[:-1], real[1:]), between(path[:-1], path[1:])
    step[:, 2], own[:, 2] = wrap(step[:, 2]), wrap(own[:, 2])
    return step, own


def _common(odometry: Samples, truth: Samples) -> tuple[Array, Array]:
    """Return the poses (k, 3) of both at the truth's stamps."""
    path, real = odometry.trajectory(), truth.trajectory()
    inside = (real.stamps_ns >= path.stamps_ns[0]) & (real.stamps_ns <= path.stamps_ns[-1])
    origin = int(odometry.stamps_ns[0])
    return real.xyt[inside], path.at(real.seconds_since(origin)[inside], origin)
