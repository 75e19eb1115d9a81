"""Design of the advice arm, fixed before any run: first drives and hidden causes."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["FIRST_SEED", "OPEN", "PILOT", "UNSEEN", "AdviceCase", "advice_cases"]

WHEELS, GYRO = "encoders", "gyro"
OPEN = (
    ("line", "wheel_scale", "speed_scale", WHEELS),
    ("line", "speed_scale", "wheel_scale", WHEELS),
    ("line", "wheel_scale", "speed_scale", GYRO),
    ("line", "speed_scale", "wheel_scale", GYRO),
    ("line", "unequal_wheels", "gyro_bias", WHEELS),
    ("line", "gyro_bias", "unequal_wheels", GYRO),
    ("line", "slope", "mount_yaw", WHEELS),
    ("line", "mount_yaw", "slope", GYRO),
    ("line", "scale_drift", "wheel_scale", WHEELS),
    ("circle", "icr_shift", "mount_yaw", WHEELS),
    ("circle", "lever_arm", "wheel_scale", GYRO),
    ("circle", "wheel_scale", "lever_arm", GYRO),
    ("circle", "mount_yaw", "lever_arm", WHEELS),
    ("circle", "side_slip", "mount_yaw", WHEELS),
    ("circle", "turn_asymmetry", "wheelbase", WHEELS),
    ("circle", "wheelbase", "turn_asymmetry", WHEELS),
    ("circle", "unequal_wheels", "turn_asymmetry", WHEELS),
    ("circle", "gyro_bias", "gyro_scale", GYRO),
    ("circle", "gyro_scale", "gyro_bias", GYRO),
    ("slalom", "side_slip", "lever_arm", WHEELS),
    ("slalom", "icr_shift", "side_slip", GYRO),
    ("slalom", "unequal_wheels", "gyro_bias", WHEELS),
    ("slalom", "gyro_bias", "unequal_wheels", GYRO),
    ("slalom", "wheel_scale", "speed_scale", GYRO),
    ("slalom", "speed_scale", "wheel_scale", WHEELS),
    ("one-way square", "turn_asymmetry", "wheelbase", WHEELS),
    ("one-way square", "wheelbase", "turn_asymmetry", WHEELS),
    ("a minute", "scale_drift", "wheel_scale", WHEELS),
    ("a minute", "wheel_scale", "scale_drift", GYRO),
    ("a minute", "time_offset", "clock_skew", WHEELS),
    ("one pass", "region_slip", "scale_drift", WHEELS),
    ("one pass", "scale_drift", "region_slip", WHEELS),
    ("stop and go", "accel_slip", "time_offset", WHEELS),
    ("stop and go", "time_offset", "accel_slip", GYRO),
    ("there and back", "backlash", "time_offset", WHEELS),
    ("there and back", "time_offset", "backlash", WHEELS),
)
"""First drive, hidden cause, effect aliased with it there (effects' table of degeneracies), heading source."""
UNSEEN = (
    ("line", "backlash", WHEELS),
    ("line", "wheelbase", WHEELS),
    ("line", "side_slip", WHEELS),
    ("line", "lever_arm", WHEELS),
    ("line", "icr_shift", GYRO),
    ("line", "turn_asymmetry", WHEELS),
    ("line", "accel_slip", WHEELS),
    ("line", "gyro_scale", GYRO),
    ("line", "time_offset", WHEELS),
    ("spins", "mount_yaw", GYRO),
    ("spins", "wheel_scale", GYRO),
    ("spins", "speed_scale", GYRO),
    ("spins", "unequal_wheels", WHEELS),
    ("spins", "side_slip", WHEELS),
    ("spins", "slope", GYRO),
    ("circle", "backlash", WHEELS),
    ("stop and go", "backlash", WHEELS),
    ("stop and go", "side_slip", GYRO),
    ("a minute", "clock_skew", WHEELS),
    ("a minute", "scale_drift", GYRO),
)
"""First drive, hidden cause that it does not excite, heading source."""
ROBOTS = (("strong", "differential"), ("medium", "differential"), ("strong", "skid"), ("medium", "skid"))
"""Sizes and robots, alternating: each row has three of the four (two if nothing is excited)."""
TIMES = {"open": 3, "unseen": 2}
FIRST_SEED = 80_000
"""First seed, not used by any test, fixture, pilot or earlier run; each following drive adds 400 000."""
PILOT = -8_000
"""Offset of a pilot's seeds, so that they are never fresh ones."""


@dataclass(frozen=True, slots=True)
class AdviceCase:
    """One robot with a hidden cause, and its first drive.

    kind : "open" if two effects are aliased on that drive, "unseen" if the cause is not excited
    rival : effect aliased with the cause; "" for "unseen"
    """

    kind: str
    number: int
    seed: int
    first: str
    cause: str
    rival: str
    size: str
    yaw_from: str
    drive_type: str

    @property
    def key(self) -> str:
        """Name of the case in the results file."""
        return f"{self.kind}/{self.number}"


def advice_cases(*, pilot: bool = False) -> list[AdviceCase]:
    """Return all cases in the order of the run: each row once, open ones first, then each row again."""
    shift = PILOT if pilot else 0
    rows = {"open": OPEN, "unseen": tuple((first, cause, "", yaw) for first, cause, yaw in UNSEEN)}
    found = []
    for again in range(max(TIMES.values())):
        for offset, (kind, table) in zip((0, 1_000), rows.items(), strict=True):
            for row, (first, cause, rival, yaw) in enumerate(table if again < TIMES[kind] else ()):
                size, drive_type = ROBOTS[(row + again) % len(ROBOTS)]
                i = again * len(table) + row
                seed = FIRST_SEED + shift + offset + i
                found.append(AdviceCase(kind, i, seed, first, cause, rival, size, yaw, drive_type))
    return found
