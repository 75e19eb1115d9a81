"""Different gains of left and right turns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, parameter, stacked


@dataclass(frozen=True, slots=True)
class TurnAsymmetry(Effect):
    """f = (0, 0, k abs(omega)): the true turn is 1 + k of the odometry's to the left and 1 - k to the right."""

    name = "turn_asymmetry"
    odd = True
    summary = "left turns come out larger than right turns, or the other way round"
    about = About(
        equation="f_yaw = k abs(omega)",
        typical="0.3 to 3 % (an estimate: an off-centre load, a tyre that scrubs on one side)",
        source="engineering judgement; no published figures known to us",
        confused_with=("unequal_wheels", "gyro_bias", "wheelbase"),
        drive="turn on the spot, as often to the left as to the right, with straights between",
    )

    k: float = parameter("", "half the difference of the gains, left minus right", low=-0.2, high=0.2, typical=0.01)

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: an extra turn to the left in every turn."""
        return TwistError(stacked(0.0, 0.0, self.k * np.abs(motion.omega), motion.v), state)
