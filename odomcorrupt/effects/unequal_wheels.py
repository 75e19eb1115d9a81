"""Unequal wheel radii: straight lines bend."""

from __future__ import annotations

from dataclasses import dataclass

from odomcorrupt.drive_types import PIVOTING
from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, parameter, stacked


@dataclass(frozen=True, slots=True)
class UnequalWheels(Effect):
    """f = (curvature b^2 omega / 4, 0, curvature v); the first term only if the track b is known.

    With radii r_right / r_left = 1 + e, curvature = e / b. Borenstein & Feng 1996, IEEE T-RA 12(6), E_d.
    """

    name = "unequal_wheels"
    summary = "one wheel is larger than the other, so that straight lines bend"
    drives = PIVOTING
    about = About(
        equation="f_yaw = curvature v; with the track b also f_along = curvature b^2 omega / 4",
        typical="wheels that differ by 0.05 to 1 %: 0.001 to 0.03 rad/m on a track of 0.4 m",
        source="Borenstein & Feng 1996, IEEE T-RA 12(6), E_d",
        confused_with=("gyro_bias", "turn_asymmetry"),
        drive="long straights, forwards and in reverse, at two speeds, with a stop of a minute",
    )

    curvature: float = parameter(
        "rad/m", "true curvature of a path that odometry reports as straight", low=-1.0, high=1.0, typical=0.005
    )

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: the yaw error is proportional to the distance, and changes sign in reverse."""
        track = motion.track_m or 0.0
        return TwistError(
            stacked(self.curvature * track**2 / 4.0 * motion.omega, 0.0, self.curvature * motion.v, motion.v),
            state,
        )
