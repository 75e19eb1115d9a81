"""A single slip of the wheels: a wet patch, a cable, a threshold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, choice, parameter, stacked
from odomcorrupt.effects.event_window import duration_parameter, part_inside, time_parameter
from odomcorrupt.effects.wheels import Rims, body_of, heading_choice, needed_track_m, rims_of, turning


@dataclass(frozen=True, slots=True)
class SlipEvent(Effect):
    """f_wheel = -slip u for each wheel's rim speed u between time and time + duration, 0 otherwise.

    See `region_slip` for slip at a place and `slip_burst` for slip at random times.
    """

    name = "slip_event"
    kind = "event"
    summary = "once, at a given time, wheels slip for a while"
    about = About(
        equation="f_wheel = -slip u for each wheel's rim speed u where time <= t < time + duration, 0 otherwise",
        typical="30 % and more for 0.1 to 2 s (an estimate)",
        source="engineering judgement; no published figures known to us",
        confused_with=("slip_burst", "region_slip", "push"),
        drive="none: it happens once; odometry that runs ahead of the truth at one time shows it",
    )

    slip: float = parameter("", "part of the wheels' travel that is lost", low=0.0, high=0.8, typical=0.4)
    time: float = time_parameter()
    duration: float = duration_parameter(2.0)
    heading: str = heading_choice()
    side: str = choice("which wheels slip; a single one turns the robot and needs the track", "both", "left", "right")

    @property
    def window_s(self) -> tuple[float, float]:
        """Begin and end of the event, seconds after the first odometry stamp."""
        return self.time, self.time + self.duration

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: the slip over the fraction of each interval that lies in the event."""
        lost = -self.slip * part_inside(motion, *self.window_s)
        if self.side == "both":
            yaw = turning(self.heading, lost * motion.omega)
            return TwistError(stacked(lost * motion.v, lost * motion.vy, yaw, motion.v), state)
        track_m = needed_track_m(self.name, motion.track_m)
        u = rims_of(motion.v, motion.omega, track_m)
        none = np.zeros_like(lost)
        rims = Rims(lost * u.right, none) if self.side == "right" else Rims(none, lost * u.left)
        return TwistError(body_of(rims, track_m, self.heading), state)
