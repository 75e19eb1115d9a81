"""Files, topics and prior knowledge that define one run of a robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from odomcorrupt.drive_types import AUTO
from odomcorrupt.study.io.gyro import SCALE_ACCURACY as GYRO_SCALE_ACCURACY
from odomcorrupt.study.io.laser_truth import SCALE_ACCURACY

if TYPE_CHECKING:
    from pathlib import Path


@dataclass(frozen=True, slots=True)
class Source:
    """Files, topics and prior knowledge of one run.

    path : a bag, or a TUM or CSV file with the odometry
    odom, truth : topics, or TF edges as /tf:map.base_link; None selects the only topic that fits
    truth_path : the bag, TUM or CSV file with the truth, if not in `path`
    truth_shift_s : added to the stamps of the truth, seconds
    track_m : nominal distance between the wheels, if known
    name : name of the run, by default its path
    drive_type : steering of the robot's wheels, see `drive_types`; a steered robot has no track
    scan : topic of the laser used as truth; None selects the only one of a bag without a truth, "none" disables it
        altogether
    truth_scale_error : standard deviation of the laser's scale error
    imu : topic of a gyro; None selects the only Imu topic, if it turns with the odometry
    gyro_scale_error : standard deviation of the gyro's scale error
    relative : file of relative motions used as truth, see `relative_motions`
    joints : left and right wheel in JointState, whose angles replace the odometry; None finds wheels by name and uses
        them for the nominal track only
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

    @property
    def place(self) -> str:
        """Name of the run in error messages."""
        return self.name or str(self.path)

    @property
    def title(self) -> str:
        """Name of the run in reports."""
        return self.name or self.path.name

    @property
    def names_truth(self) -> bool:
        """Whether a topic or a file is named as the truth."""
        return self.truth is not None or self.truth_path is not None
