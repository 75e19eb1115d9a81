"""Roller slip of omnidirectional wheels: sideways travel is wrong by a factor."""

from __future__ import annotations

from dataclasses import dataclass

from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, parameter, stacked


@dataclass(frozen=True, slots=True)
class SidewaysScale(Effect):
    """f = (0, e vy, 0): only sideways travel is affected."""

    name = "sideways_scale"
    summary = "sideways the robot goes farther or less far than its wheels show"
    needs_sideways = True
    about = About(
        equation="f = (0, e vy, 0)",
        typical="-1 to -10 %: rollers of mecanum wheels slip and have play when the robot goes sideways (an estimate)",
        source="Tlale & de Villiers 2008, Kinematics and dynamics modelling of a mecanum wheeled mobile platform",
        confused_with=("wheel_scale", "mount_yaw", "side_slip"),
        drive="sideways to and fro, at two headings, and straights as long",
    )

    e: float = parameter("", "true over nominal sideways travel, minus one", low=-0.8, high=4.0, typical=0.03)

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f, proportional to the sideways speed."""
        return TwistError(stacked(0.0, self.e * motion.vy, 0.0, motion.v), state)
