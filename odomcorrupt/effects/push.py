"""A push from outside that moves the robot once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, parameter, stacked
from odomcorrupt.effects.event_window import duration_parameter, part_inside, time_parameter

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array


@dataclass(frozen=True, slots=True)
class Push(Effect):
    """f = (along, across, yaw) / duration between time and time + duration, 0 otherwise.

    The robot moves without its wheels registering it: a bump, a person's shove, a lift over a sill. The odometry of a
    corrupted bag lacks that motion.
    """

    name = "push"
    kind = "event"
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
    time: float = time_parameter()
    duration: float = duration_parameter(0.5)

    @property
    def window_s(self) -> tuple[float, float]:
        """Begin and end of the event, seconds after the first odometry stamp."""
        return self.time, self.time + self.duration

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: the push at constant speed."""
        rate: Array = part_inside(motion, *self.window_s) / self.duration
        return TwistError(stacked(self.along * rate, self.across * rate, self.yaw * rate, rate), state)
