"""Where one run of a robot lies, and what is known of it before it is read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from odomcorrupt.drive_types import AUTO
from odomcorrupt.study.io.gyro import SCALE_ACCURACY as GYRO_SCALE_ACCURACY
from odomcorrupt.study.io.laser_truth import SCALE_ACCURACY

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["Source"]


@dataclass(frozen=True, slots=True)
class Source:
    """Where one run lies.

    path : a bag, or a TUM or CSV file with the odometry
    odom, truth : topics, or edges of TF as /tf:map.base_link; None takes the only topic that can be meant
    truth_path : the bag, TUM or CSV file with the truth, where it is another one
    truth_shift_s : what is added to the stamps of the truth, seconds
    track_m : nominal distance between the wheels, where it is known
    name : what to call the run, where not by its path
    drive_type : how the robot's wheels steer it, see `drive_types`; one that is steered has no track
    scan : topic of a laser that is to be the truth; None takes the only one of a bag that holds no truth,
        "none" none at all
    truth_scale_error : standard deviation of the laser's own scale error
    imu : topic of a gyro; None takes the only Imu topic, where it turns with the odometry
    gyro_scale_error : standard deviation of the gyro's own scale error
    relative : file of relative motions that are to be the truth, see `relative_motions`
    joints : left and right wheel in JointState, whose angles are to be the odometry; None takes what their names say
        for the nominal track alone
    """

    path: Path
    odom: str | None = None
    truth: str | None = None
    truth_path: Path | None = None
    truth_shift_s: float = 0.0
    track_m: float | None = None
    name: str = ""
    scan: str | None = None
    truth_scale_error: float = SCALE_ACCURACY
    drive_type: str = AUTO
    imu: str | None = None
    gyro_scale_error: float = GYRO_SCALE_ACCURACY
    joints: tuple[str, str] | None = None
    relative: Path | None = None
