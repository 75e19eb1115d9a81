"""Design of the study, fixed before any run: situations, causes, robots, truths and seeds."""

from __future__ import annotations

from dataclasses import dataclass

from ordinary.machine import Rig
from ordinary.routes import Route

__all__ = ["LENGTHS", "SITUATIONS", "Case", "Setting", "cases"]


@dataclass(frozen=True, slots=True)
class Setting:
    """One typical set-up of a recording.

    present : effects, and regressors of unknown dependences, that every such robot has without a planted cause; naming
        them is not a false alarm
    """

    platform: str
    truth: str
    route: Route
    rig: Rig
    causes: tuple[str, ...]
    track: bool = True
    learned_s: float = 420.0
    present: tuple[str, ...] = ()


ROOMS = Route("rooms", 9.0, 7.0)
SMALL = Route("rooms", 3.5, 3.0)
FIELD = Route("rooms", 30.0, 25.0, stops=0.3, reverse=0.05)
HALL = Route("rooms", 25.0, 18.0, stops=0.3, reverse=0.2)
LOT = Route("rooms", 90.0, 60.0, stops=0.4, reverse=0.1)
TRACK = Route("rooms", 10.0, 8.0, stops=0.3, reverse=0.15)
CORRIDOR = Route("corridor", 15.0, 0.0, stops=0.3, reverse=0.0)
LEFT = Route("left", 6.0, 4.0, stops=0.1, reverse=0.0)
LAGS = ("time_offset", "*delay*", "*lag*", "*acceleration")

WHEELED = ("wheel_scale", "unequal_wheels", "wheelbase", "scale_drift", "turn_asymmetry")
WITH_GYRO = ("gyro_bias", "wheel_scale", "gyro_scale", "gyro_bias_walk")

SITUATIONS: dict[str, tuple[Setting, ...]] = {
    "amcl": (
        Setting("cart", "amcl_tf", ROOMS, Rig(), WHEELED),
        Setting("burger", "amcl_pose", SMALL, Rig(), WHEELED[:3]),
        Setting("create3", "amcl_tf", SMALL, Rig("gyro"), WITH_GYRO),
        Setting("cart", "amcl_pose", ROOMS, Rig("gyro"), (*WITH_GYRO, "region_slip"), track=False),
    ),
    "slam": (
        Setting("cart", "slam_tf", ROOMS, Rig(), WHEELED),
        Setting("cart", "slam_pose", ROOMS, Rig("gyro"), WITH_GYRO),
        Setting("burger", "slam_pose", SMALL, Rig(), ("wheel_scale", "unequal_wheels", "wheelbase"), track=False),
    ),
    "ekf": (
        Setting("cart", "mocap", ROOMS, Rig("gyro", filter_s=(0.10, 0.04)), ("wheel_scale", "gyro_bias", "gyro_scale"),
                present=LAGS),
        Setting("burger", "cameras", SMALL, Rig("gyro", filter_s=(0.05, 0.12)), ("wheel_scale", "gyro_bias"),
                present=LAGS),
        Setting("cart", "mocap", ROOMS, Rig("wheels", filter_s=(0.07, 0.07), pull=0.2), ("wheel_scale", "wheelbase"),
                present=LAGS),
    ),
    "car": (
        Setting("racer", "mocap", TRACK, Rig("steering"), ("steering_ratio", "steering_offset", "steering_lag",
                "wheel_scale", "speed_cutoff"), track=False),
        Setting("tricycle", "amcl_pose", HALL, Rig("steering"), ("steering_offset", "steering_ratio", "wheel_scale",
                "rear_axle_shift"), track=False),
        Setting("tricycle", "mocap", HALL, Rig("steering"), ("rear_axle_shift", "steering_lag", "side_slip",
                "backlash"), track=False),
        Setting("car", "rtk", LOT, Rig("steering"), ("steering_offset", "steering_ratio", "wheel_scale", "side_slip"),
                track=False, present=("quantization",)),
    ),
    "hobby": (
        Setting("hobby", "cameras", SMALL, Rig("wheels", command=True), ("dead_band", "battery_sag",
                "truncated_velocity"), track=False),
        Setting("hobby", "cameras", SMALL, Rig(), ("counts_lost", "flat_spot", "backlash", "unequal_wheels",
                "speed_cutoff", "lost_increments")),
        Setting("create3", "cameras", SMALL, Rig(), ("truncated_velocity", "flat_spot", "wheelbase"),
                present=("quantization",)),
    ),
    "rtk": (
        Setting("skid", "rtk", FIELD, Rig("gyro"), ("gyro_bias", "wheel_scale", "region_slip", "lever_arm", "slope")),
        Setting("skid", "rtk", FIELD, Rig(), ("unequal_wheels", "wide_contact", "wheel_scale", "slope")),
        Setting("skid", "rtk", FIELD, Rig("gyro", filter_s=(0.05, 0.05)), ("gyro_scale", "side_slip", "lever_arm"),
                track=False, present=LAGS),
    ),
    "clock": (
        Setting("cart", "mocap", ROOMS, Rig(stamp_step_s=0.001), ("time_offset", "accel_slip", "backlash",
                "clock_skew"), present=("time_offset",)),
        Setting("cart", "mocap", ROOMS, Rig("gyro"), ("channel_delay", "channel_lag", "time_offset", "accel_slip"),
                track=False),
        Setting("burger", "cameras", SMALL, Rig(stamp_jitter_s=0.004), ("time_offset", "backlash"),
                present=("time_offset",)),
        Setting("cart", "mocap", ROOMS, Rig(stamp_step_s=0.01), ("time_offset", "channel_delay"),
                present=("time_offset",)),
    ),
    "event": (
        Setting("cart", "mocap", ROOMS, Rig(), ("push", "bump")),
        Setting("burger", "cameras", SMALL, Rig(), ("lift", "push")),
        Setting("create3", "amcl_tf", SMALL, Rig("gyro"), ("lift", "push")),
    ),
    "dull": (
        Setting("cart", "mocap", CORRIDOR, Rig(), ("unequal_wheels", "wheel_scale"), learned_s=240.0),
        Setting("cart", "mocap", LEFT, Rig(), ("wheelbase", "lever_arm"), learned_s=240.0),
        Setting("burger", "cameras", LEFT, Rig("gyro"), ("gyro_bias", "wheel_scale"), learned_s=120.0),
        Setting("cart", "amcl_tf", CORRIDOR, Rig("gyro"), ("gyro_bias", "wheel_scale"), track=False),
    ),
    "ground": (
        Setting("skid", "mocap", TRACK, Rig(), ("icr_shift", "wide_contact", "slip_burst", "side_slip")),
        Setting("cart", "mocap", ROOMS, Rig(), ("brake_skid", "castor_kick", "accel_slip", "region_slip",
                "speed_scale")),
        Setting("burger", "mocap", SMALL, Rig("gyro"), ("mount_yaw", "castor_kick", "region_slip", "gauss_markov")),
    ),
}  # fmt: skip
LENGTHS = {
    "amcl": 45, "slam": 36, "ekf": 32, "car": 40, "hobby": 40, "rtk": 40, "clock": 40, "event": 24, "dull": 30,
    "ground": 33,
}  # fmt: skip
"""Number of planned drives of each situation, 360 in all."""
FIRST_SEED, PILOT_SEED = 960_000, 20_000


@dataclass(frozen=True, slots=True)
class Case:
    """A robot with a drive to learn from and a judging one; a control has the cause ""."""

    situation: str
    number: int
    seed: int
    setting: int
    cause: str

    @property
    def key(self) -> str:
        """Name of the case in the results file."""
        return f"{self.situation}/{self.number}"

    @property
    def how(self) -> Setting:
        """Setting in which the case is recorded."""
        return SITUATIONS[self.situation][self.setting]


def cases(*, pilot: bool = False) -> list[Case]:
    """Return all cases in the order of the run: situations in turn, two controls in five drives."""
    made = []
    for place, (situation, settings) in enumerate(SITUATIONS.items()):
        begun = [0] * len(settings)
        for i in range(LENGTHS[situation]):
            which = i % len(settings)
            control = (i + i // 5) % 5 in (0, 2)
            cause = ""
            if not control:
                cause = settings[which].causes[begun[which] % len(settings[which].causes)]
                begun[which] += 1
            seed = (PILOT_SEED if pilot else FIRST_SEED) + 1000 * place + i
            made.append(Case(situation, i, seed, which, cause))
    return sorted(made, key=lambda case: (case.number, list(SITUATIONS).index(case.situation)))
