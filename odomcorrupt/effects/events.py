"""Single events and clocks: what happens once at a given time, and stamps that are early or late."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from odomcorrupt.effects.effect import (
    About,
    Effect,
    Motion,
    Recorded,
    State,
    TwistError,
    choice,
    gain,
    parameter,
    stacked,
)
from odomcorrupt.effects.wheels import Rims, body_of, heading_choice, needed_track_m, rims_of, scaled
from odomcorrupt.geometry.se2 import Increments, accumulate, increments

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array


_BEGINS: dict[str, Any] = {
    "unit": "s", "meaning": "when it begins, after the first odometry stamp", "low": 0.0, "high": 1e6, "typical": 5.0,
    "identity": 5.0, "amplitude": False,
}  # fmt: skip
_LASTS: dict[str, Any] = {"unit": "s", "meaning": "how long it lasts", "low": 0.01, "high": 1e4, "amplitude": False}


def part_inside(motion: Motion, begin_s: float, end_s: float) -> Array:
    """Return the fraction (n,) of each interval that lies between two times; 0 for an interval of no length.

    begin_s, end_s : seconds after the first odometry stamp
    """
    inside = np.minimum(motion.t_s, end_s) - np.maximum(motion.t_s - motion.dt_s, begin_s)
    return np.divide(np.maximum(inside, 0.0), motion.dt_s, out=np.zeros_like(motion.dt_s), where=motion.dt_s > 0.0)


class Event(Effect):
    """What happens once, at a time stated in the model."""

    kind = "event"
    time: float
    duration: float

    __slots__ = ()

    @property
    def window_s(self) -> tuple[float, float]:
        """Begin and end of the event, seconds after the first odometry stamp."""
        return self.time, self.time + self.duration


@dataclass(frozen=True, slots=True)
class Push(Event):
    """f = (along, across, yaw) / duration between time and time + duration, 0 otherwise.

    The robot moves without its wheels registering it: a bump, a person's shove, a lift over a sill. The odometry of a
    corrupted bag lacks that motion.
    """

    name = "push"
    summary = "once, the robot is pushed, which the odometry does not show"
    about = About(
        equation="f = (along, across, yaw) / duration where time <= t < time + duration, 0 otherwise",
        typical="5 to 30 cm and up to 20 degrees in half a second (an estimate)",
        source="engineering judgement; kidnapping of a robot as in Probabilistic Robotics, ch. 8",
        confused_with=("slip_event", "slip_burst"),
        drive="none: it happens once; a jump of the truth against the odometry at one time shows it",
    )

    along: float = parameter("m", "how far it is pushed forwards", low=-10.0, high=10.0, typical=0.2)
    across: float = parameter("m", "how far it is pushed to the left", low=-10.0, high=10.0, typical=0.1)
    yaw: float = parameter("rad", "how far it is turned", low=-3.1, high=3.1, typical=0.1)
    time: float = parameter(**_BEGINS)
    duration: float = parameter(**_LASTS, typical=0.5, identity=0.5)

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: the push at constant speed."""
        rate: Array = part_inside(motion, *self.window_s) / self.duration
        return TwistError(stacked(self.along * rate, self.across * rate, self.yaw * rate, rate), state)


@dataclass(frozen=True, slots=True)
class SlipEvent(Event):
    """f_wheel = -slip u for each wheel's rim speed u between time and time + duration, 0 otherwise.

    See `region_slip` for slip at a place and `slip_burst` for slip at random times.
    """

    name = "slip_event"
    summary = "once, at a given time, wheels slip for a while"
    about = About(
        equation="f_wheel = -slip u for each wheel's rim speed u where time <= t < time + duration, 0 otherwise",
        typical="30 % and more for 0.1 to 2 s (an estimate)",
        source="engineering judgement; no published figures known to us",
        confused_with=("slip_burst", "region_slip", "push"),
        drive="none: it happens once; odometry that runs ahead of the truth at one time shows it",
    )

    slip: float = parameter("", "part of the wheels' travel that is lost", low=0.0, high=0.8, typical=0.4)
    time: float = parameter(**_BEGINS)
    duration: float = parameter(**_LASTS, typical=2.0, identity=2.0)
    heading: str = heading_choice()
    side: str = choice("which wheels slip; a single one turns the robot and needs the track", "both", "left", "right")

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: the slip over the fraction of each interval that lies in the event."""
        lost = -self.slip * part_inside(motion, *self.window_s)
        if self.side == "both":
            return TwistError(stacked(*scaled(motion, lost, self.heading), motion.v), state)
        track_m = needed_track_m(self, motion.track_m)
        u = rims_of(motion.v, motion.omega, track_m)
        none = np.zeros_like(lost)
        rims = Rims(lost * u.right, none) if self.side == "right" else Rims(none, lost * u.left)
        return TwistError(body_of(rims, track_m, self.heading), state)


@dataclass(frozen=True, slots=True)
class OdometryStop(Event):
    """Increments that end between time and time + duration are reported as zero.

    Their travel is then lost, as when a motor controller restarts, or added to the next increment, as when its bus was
    blocked while its encoders went on counting.
    """

    name = "odometry_stop"
    layer = "record"
    initial = np.zeros(3)  # motion withheld so far
    summary = "once, the odometry stands still for a while although the robot drives on"
    about = About(
        equation="reported increment = 0 where time < t <= time + duration; then lost, or added to the next one",
        typical="0.5 to 5 s while a motor controller or a bus recovers (an estimate)",
        source="engineering judgement; no published figures known to us",
        confused_with=("lost_increments", "slip_event"),
        drive="none: it happens once; a pose that repeats while the truth moves shows it",
    )

    duration: float = parameter("s", "how long it stands still", low=0.0, high=1e4, typical=2.0)
    time: float = parameter(**_BEGINS)
    then: str = choice("what becomes of the travel that was not reported", "lost", "caught_up")

    @property
    def lost_m(self) -> float:
        """Unbounded: travel that was never reported cannot be recovered."""
        return float("inf") if self.acts else 0.0

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002
        """Return the increments with those during the stop withheld."""
        begin, end = self.window_s
        inside = (t_s > begin) & (t_s <= end)
        after = np.flatnonzero(t_s > end)
        withheld = accumulate(state, Increments.of_rows(steps[inside]))[-1]
        out = np.where(inside[:, None], 0.0, steps)
        if self.then == "caught_up" and len(after) and withheld.any():
            first = after[0]
            reached = accumulate(withheld, Increments.of_rows(steps[first : first + 1]))[-1]
            out[first] = increments(np.stack((np.zeros(3), reached))).rows[0]
            withheld = np.zeros(3)
        return Recorded(out, withheld)


_BURST = 1e-3
"""Duration of the burst as a fraction of the delay; above zero, so that stamps still ascend."""


@dataclass(frozen=True, slots=True)
class Latency(Event):
    """In a bag, stamps between time and time + delay move to the end of that window, close behind each other.

    The poses are correct but stamped late: a localisation pairs them with later laser scans. f is the first-order
    equivalent for a regression.
    """

    name = "latency"
    summary = "once, odometry messages are delayed, and stamped when they arrive in a burst"
    clock = True
    about = About(
        equation="stamp = t + 0.999 (time + delay - t) where time <= t < time + delay; f = shift (a, ay, alpha) "
        "- 0.999 (v, vy, omega) there",
        typical="0.05 to 1 s over WiFi or a loaded computer (an estimate)",
        source="engineering judgement; no published figures known to us",
        confused_with=("time_offset", "odometry_stop"),
        drive="none: it happens once; a pause in the stamps and then a burst show it",
    )

    delay: float = parameter("s", "how long messages are delayed", low=0.0, high=60.0, typical=0.5)
    time: float = parameter(**_BEGINS)

    @property
    def window_s(self) -> tuple[float, float]:
        """Begin and end of the event, seconds after the first odometry stamp."""
        return self.time, self.time + self.delay

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f to first order: a time offset that shrinks."""
        shift = self.stamp_shift_s(motion.t_s)
        rate = np.where(shift > 0.0, _BURST - 1.0, 0.0)
        return TwistError(shift[:, None] * motion.acceleration + rate[:, None] * motion.twist, state)

    def stamp_shift_s(self, t_s: Array) -> Array:
        """Return the delay of each stamp (n,), seconds."""
        begin, end = self.window_s
        return np.where((t_s >= begin) & (t_s < end), (1.0 - _BURST) * (end - t_s), 0.0)


# f of the two clocks is a first-order equivalent for the regression only; their stamp shift in a bag is exact
TimeOffset = gain(
    "time_offset",
    "the odometry's clock is ahead of the truth's by a constant",
    lambda it, m: it.offset * m.acceleration.T,
    About(
        equation="f = offset (a, ay, alpha)",
        typical="5 to 150 ms by USB, WiFi or motion capture",
        source="engineering judgement; no published figures known to us",
        confused_with=("accel_slip", "clock_skew", "backlash"),
        drive="start, stop and turn briskly",
    ),
    kind="setup",
    odd=True,
    clock=True,
    stamp_shift_s=lambda it, t_s: np.full_like(t_s, it.offset),
    offset=parameter("s", "odometry stamp minus true time", low=-5.0, high=5.0, typical=0.03),
)

ClockSkew = gain(
    "clock_skew",
    "the odometry's clock runs fast or slow against the truth's",
    lambda it, m: it.rate * (m.t_s * m.acceleration.T + m.twist.T),
    About(
        equation="f = rate (t (a, ay, alpha) + (v, vy, omega))",
        typical="1e-6 to 1e-4 between unsynchronised computers",
        source="engineering judgement; no published figures known to us",
        confused_with=("time_offset", "wheel_scale"),
        drive="more than five minutes with starts and stops throughout",
    ),
    kind="setup",
    odd=True,
    clock=True,
    stamp_shift_s=lambda it, t_s: it.rate * t_s,
    rate=parameter("", "odometry clock rate over true rate, minus one", low=-0.1, high=0.1, typical=1e-4),
)
