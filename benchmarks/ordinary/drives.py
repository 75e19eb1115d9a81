"""Simulation of a case: a robot, its two drives with and without the fault, and their expected results."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ordinary.causes import CAUSES, sizes_of
from ordinary.machine import Body, Odometry, body_motion, odometry_of, stream
from ordinary.platforms import PLATFORMS
from ordinary.routes import driven
from ordinary.truths import Truth, composed, inverse, make_truth, tracked

if TYPE_CHECKING:
    from ordinary.cases import Case

__all__ = ["Drive", "Expected", "drive", "error_10s", "expected", "flaw_of"]

JUDGED_S = 300.0
JUDGED_SEED = 3_000_000
WINDOW_S, PHASES = 10.0, 14
"""Length of a window, s, and phases at which windows begin: 0.71 s apart, no multiple of any period of odometry."""
EXCITED_GAIN, EXCITED_NATS = 1.15, 15.0
"""A cause is excited if removing it divides the held-out 10 s error by at least 1.15 and it is worth 15 nats."""

Flaw = tuple[str, dict[str, float]] | None
Mark = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Drive:
    """A drive: true motion, start pose, tracked point, odometry, recorded truth, and frame of the truth."""

    body: Body
    start: np.ndarray
    mark: Mark
    odometry: Odometry
    truth: Truth
    frame: np.ndarray

    def exact(self, time_s: np.ndarray) -> np.ndarray:
        """Return exact poses of the tracked point, in the truth's frame, shape (k, 3)."""
        return tracked(self.body, self.mark, time_s, self.frame)


@dataclass(frozen=True, slots=True)
class Expected:
    """Expected held-out 10 s errors (m) of a case, value of the fault in nats, and whether it is excited.

    attainable_m : root sum of squares of the floor and of the fault's part that remains after estimating one parameter
    """

    before_m: float
    floor_m: float
    attainable_m: float
    nats: float
    excited: bool


def flaw_of(case: Case) -> Flaw:
    """Return the name and the sizes of the fault of a case's robot, None for a control."""
    return (case.cause, sizes_of(case.cause, stream(case.seed, "sizes"))) if case.cause else None


def drive(case: Case, *, judged: bool = False, flawed: bool = True) -> Drive:
    """Return a drive of a case: the one learned from or the judging one, with or without the fault."""
    how, seed = case.how, case.seed + (JUDGED_SEED if judged else 0)
    platform = PLATFORMS[how.platform]
    flaw = flaw_of(case) if flawed else None
    if judged and flaw is not None and CAUSES[flaw[0]].event:
        flaw = None
    seconds = JUDGED_S if judged else how.learned_s
    box = (how.route.width_m, how.route.height_m)
    start = np.zeros(3)
    if judged and how.route.kind == "rooms":  # another start; the odometry also begins at zero there
        start = stream(seed, "start").uniform([0.2 * box[0], 0.2 * box[1], -3.0], [0.8 * box[0], 0.8 * box[1], 3.0])
    motion = driven(how.route, platform, seconds + 2.0, stream(seed, "driver"), start)
    body = body_motion(motion, flaw, platform, how.rig, seed, start)
    mark = (0.0, 0.0, 0.0)
    if flaw is not None and flaw[0] == "lever_arm":
        mark = (flaw[1]["x"], flaw[1]["y"], 0.0)
    if flaw is not None and flaw[0] == "mount_yaw":
        mark = (0.0, 0.0, flaw[1]["yaw"])
    patch = None
    if flaw is not None and flaw[0] == "region_slip":
        place = stream(case.seed, "patch").uniform(0.25, 0.75, 2)
        patch = (place[0] * box[0], place[1] * box[1], flaw[1]["part"] * min(box))
    odometry = odometry_of(body, flaw, platform, how.rig, seed, patch)
    # the same truth frame for both drives of a robot
    turned = stream(case.seed, "frame")
    frame = np.array([turned.uniform(-5, 5), turned.uniform(-5, 5), turned.uniform(-3, 3)])
    truth = make_truth(how.truth, body, mark, odometry, seed, frame)
    return Drive(body, start, mark, odometry, truth, frame)


def _increments(stamps: np.ndarray, xyt: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Return increments between knots, each in the frame of its first pose, shape (k - 1, 3)."""
    at = np.column_stack([np.interp(knots, stamps, column) for column in xyt.T])
    return composed(inverse(at[:-1]), at[1:])


def error_10s(made: Drive, stamps: np.ndarray, xyt: np.ndarray) -> float:
    """Return the RMS position error (m) of odometry at the end of 10 s windows that begin at the exact truth."""
    square: list[np.ndarray] = []
    for phase_s in np.linspace(0.0, WINDOW_S, PHASES, endpoint=False):
        knots = np.arange(1.0 + phase_s, made.body.time_s[-1] - 2.0, WINDOW_S)
        exact = made.exact(knots)
        off = _increments(stamps, xyt, knots) - composed(inverse(exact[:-1]), exact[1:])
        square.append(np.sum(off[:, :2] ** 2, axis=1))
    return float(np.sqrt(np.mean(np.concatenate(square))))


def _nats(flawed: Drive, clean: Drive) -> float:
    """Return the value of the fault in nats with the best of three window lengths, given the truth's noise."""
    best = 0.0
    for length in (2.0, 10.0, 30.0):
        knots = np.arange(1.0, flawed.body.time_s[-1] - 2.0, length)
        errors = []
        for made in (flawed, clean):
            exact = made.exact(knots)
            said = _increments(made.odometry.stamp_s, made.odometry.xyt, knots)
            errors.append(said - composed(inverse(exact[:-1]), exact[1:]))
        shift = errors[0] - errors[1]
        own = np.median(np.abs(errors[1]), axis=0) * 1.48
        truth = flawed.truth
        yaw = np.inf if truth.sigma_rad is None else 2.0 * truth.sigma_rad**2
        variance = own**2 + np.array([2.0 * truth.sigma_m**2, 2.0 * truth.sigma_m**2, yaw])
        best = max(best, 0.5 * float(np.sum(shift**2 / variance)))
    return best


def expected(case: Case) -> Expected:
    """Return the expected results of a case, computed from its design alone."""
    judged, floor = drive(case, judged=True), drive(case, judged=True, flawed=False)
    before = error_10s(judged, judged.odometry.stamp_s, judged.odometry.xyt)
    least = error_10s(floor, floor.odometry.stamp_s, floor.odometry.xyt)
    if not case.cause:
        return Expected(before, least, least, 0.0, excited=False)
    nats = _nats(drive(case), drive(case, flawed=False))
    gains = CAUSES[case.cause].event or before >= EXCITED_GAIN * least
    flaw_m2 = max(before**2 - least**2, 0.0)
    attainable = float(np.sqrt(least**2 + flaw_m2 / max(2.0 * nats, 1.0)))
    return Expected(before, least, attainable, nats, excited=bool(gains and nats >= EXCITED_NATS))
