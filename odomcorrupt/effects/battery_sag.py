"""Motors that slow down as the battery empties, under odometry computed from commands."""

from __future__ import annotations

from dataclasses import dataclass

from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, parameter, stacked
from odomcorrupt.effects.wheels import heading_choice, turning


@dataclass(frozen=True, slots=True)
class BatterySag(Effect):
    """f = rate t (v, vy, omega), rate < 0, t since the first odometry stamp: motor speed is proportional to voltage."""

    name = "battery_sag"
    summary = "commanded speeds are reached less and less, as the battery's voltage falls"
    aliased_with = "scale_drift"
    about = About(
        equation="f = rate t (v, vy, omega), rate < 0, of the velocities that were commanded",
        typical="10 to 25 % from a full battery to an empty one: 5e-5 to 4e-4 per second (an estimate)",
        source="Hughes & Drury 2019, Electric Motors and Drives (a DC motor's speed is in proportion to its voltage)",
        confused_with=("scale_drift", "wheel_scale", "dead_band"),
        drive="repeat one loop for ten minutes and more; a full battery put in at half time separates it from a tyre",
    )

    rate: float = parameter(
        "1/s", "change of the reached fraction of the commanded speed, per second", low=-1e-3, high=0.0, typical=-1e-4,
        step=1e-7,
    )  # fmt: skip
    heading: str = heading_choice()

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: a scale error that grows with time."""
        scale = self.rate * motion.t_s
        yaw = turning(self.heading, scale * motion.omega)
        return TwistError(stacked(scale * motion.v, scale * motion.vy, yaw, motion.v), state)
