"""Motion, the argument of an effect's function f."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array

__all__ = ["Motion"]


@dataclass(frozen=True, slots=True)
class Motion:
    """Motion over n intervals as reported by the odometry, (n,) each.

    t_s : since the first odometry stamp, seconds, at the end of the interval
    dt_s : length of the interval, seconds; if it is 0 the rates are 0
    v, vy : forward and leftward speed, m/s (signed)
    omega : yaw rate, rad/s
    acceleration : (n, 3) forward and leftward, m/s^2, and yaw acceleration, rad/s^2, see `motion.accelerations`
    x, y, theta : pose at the beginning of the interval, metres and radians
    distance : distance travelled so far, metres
    track_m : the robot's nominal track, metres, or None if unknown
    trail : (n, 3) mean true speeds whose rate is `acceleration`; None if speeds are smooth already
    before : (n, 2, 3) acceleration and trail of the previous interval; None if speeds are smooth already

    Speeds are the odometry's. Acceleration, pose and distance are the true ones: of the clean motion in corruption, of
    the corrected one in correction, of the smoothest estimate in the study. Forces accelerate the body, and a floor's
    effect depends on the body's position; only so can an effect of accelerations be applied and inverted stably.
    """

    t_s: Array
    dt_s: Array
    v: Array
    vy: Array
    omega: Array
    acceleration: Array
    x: Array
    y: Array
    theta: Array
    distance: Array
    track_m: float | None = None
    trail: Array | None = None
    before: Array | None = None

    @property
    def in_step(self) -> Motion:
        """The motion with all speeds in step with their accelerations: integrals of their products do not drift."""
        if self.trail is None:
            return self
        return replace(self, v=self.trail[:, 0], vy=self.trail[:, 1], omega=self.trail[:, 2])

    @property
    def just_before(self) -> Motion:
        """The motion in step, with speeds and accelerations of the previous interval."""
        if self.before is None:
            return self.in_step
        return replace(self, acceleration=self.before[:, 0], trail=self.before[:, 1]).in_step

    @property
    def steady_v(self) -> Array:
        """Forward speed (n,), m/s, in step with `a`: the product of both is the rate of half its square."""
        return self.v if self.trail is None else self.trail[:, 0]

    @property
    def a(self) -> Array:
        """Forward acceleration (n,), m/s^2."""
        return self.acceleration[:, 0]

    @property
    def alpha(self) -> Array:
        """Yaw acceleration (n,), rad/s^2."""
        return self.acceleration[:, 2]

    def __len__(self) -> int:
        return len(self.t_s)
