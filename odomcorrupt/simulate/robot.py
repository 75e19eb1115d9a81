"""The machine: what its maker believes (nominal) and what it is (true)."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Robot:
    """A differential drive. The driver knows the nominal fields only.

    New physics is a new field whose default does nothing, read by the layer it belongs to.
    """

    nominal_radius_m: float
    nominal_track_m: float
    motor_lag_s: float
    travel_noise_m_per_sqrt_m: float
    radius_right_m: float
    radius_left_m: float
    track_m: float
    lateral_creep_s: float = 0.0
    """Mass over lateral creep coefficient of the tyres (N per m/s of sideways speed); 0 is a tyre that never gives."""
    gyro_bias_radps: float = 0.0
    marker_xyt: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Tracked frame as seen from the base; m, m, rad."""
    odom_clock_offset_s: float = 0.0
    odom_clock_rate: float = 0.0
    """Odometry clock's seconds per true second, minus 1."""


def build_robot(rng: np.random.Generator) -> Robot:
    """Draw a flawless robot: its true wheels and track are the nominal ones."""
    radius_m = round(rng.uniform(0.07, 0.12), 3)
    track_m = round(rng.uniform(0.32, 0.5), 3)
    return Robot(
        nominal_radius_m=radius_m,
        nominal_track_m=track_m,
        motor_lag_s=rng.uniform(0.06, 0.15),
        travel_noise_m_per_sqrt_m=rng.uniform(0.001, 0.003),
        radius_right_m=radius_m,
        radius_left_m=radius_m,
        track_m=track_m,
    )
