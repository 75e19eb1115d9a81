"""The robots: sizes, ticks, rates and speeds from manufacturers' data. Sources: protocol.md, section Platforms."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["PLATFORMS", "Platform"]


@dataclass(frozen=True, slots=True)
class Platform:
    """A kind of robot.

    drive : "differential", or "car" (steered front axle, base frame on the rear axle)
    track_m : nominal track width used by the driver; for cars, the wheelbase
    radius_m, ticks : wheel radius, and encoder counts per turn; 0 if the controller reports a smooth speed
    odometry_hz : rate of the odometry
    noise_m : standard deviation of a wheel's travel after one metre, m per sqrt(m)
    top_speed, top_yaw_rate, accel, yaw_accel : limits of the motion, SI units
    turning_radius_m : smallest turning radius of cars, else 0
    """

    drive: str
    track_m: float
    radius_m: float
    ticks: float
    odometry_hz: float
    noise_m: float
    top_speed: float
    top_yaw_rate: float
    accel: float
    yaw_accel: float
    turning_radius_m: float = 0.0


PLATFORMS = {
    "burger": Platform("differential", 0.160, 0.033, 4096, 25.0, 0.0012, 0.22, 1.8, 0.5, 3.0),
    "create3": Platform("differential", 0.235, 0.03575, 508.8, 20.0, 0.0015, 0.306, 1.6, 0.6, 3.0),
    "cart": Platform("differential", 0.450, 0.080, 4096, 50.0, 0.0010, 0.80, 1.2, 0.7, 2.0),
    "skid": Platform("differential", 0.376, 0.098, 78000, 50.0, 0.0040, 1.20, 1.4, 1.2, 3.0),
    "hobby": Platform("differential", 0.140, 0.0325, 1320, 20.0, 0.0025, 0.40, 2.0, 1.0, 4.0),
    "racer": Platform("car", 0.250, 0.050, 0, 50.0, 0.0020, 1.80, 2.0, 1.5, 4.0, 0.75),
    "tricycle": Platform("car", 1.200, 0.125, 4096, 50.0, 0.0015, 1.30, 0.8, 0.6, 1.5, 1.8),
    "car": Platform("car", 2.700, 0.310, 96, 50.0, 0.0030, 5.00, 0.6, 1.2, 0.8, 6.0),
}
