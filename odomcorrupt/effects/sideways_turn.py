"""Turning while driving sideways: the wheels of an omnidirectional robot are not alike."""

from __future__ import annotations

from dataclasses import dataclass

from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, parameter, stacked


@dataclass(frozen=True, slots=True)
class SidewaysTurn(Effect):
    """f = (0, 0, k vy): a wheel of another radius turns the robot in proportion to its sideways travel.

    By the kinematics of omnidirectional wheels (Siegwart, Nourbakhsh & Scaramuzza, Introduction to Autonomous Mobile
    Robots, section 3.2.5); the part that turns it in proportion to its forward travel is `unequal_wheels`.
    """

    name = "sideways_turn"
    summary = "the robot turns as it drives sideways, because its wheels differ in radius or grip"
    needs_sideways = True
    about = About(
        equation="f_yaw = k vy",
        typical="0.01 to 0.1 rad/m: a wheel 1 % larger, 0.2 m from the centre (by the kinematics)",
        source="Siegwart, Nourbakhsh & Scaramuzza, Introduction to Autonomous Mobile Robots, section 3.2.5",
        confused_with=("unequal_wheels", "gyro_bias"),
        drive="sideways to and fro, and straights as long",
    )

    k: float = parameter("rad/m", "true minus nominal turn per metre to the left", low=-1.0, high=1.0, typical=0.03)

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f, a turn in proportion to the sideways speed."""
        return TwistError(stacked(0.0, 0.0, self.k * motion.vy, motion.v), state)
