"""Units, orders of components and copies of travel that would give a sure and wrong result are refused."""

from dataclasses import dataclass

import numpy as np
import pytest
from sourcebags import topic, write
from sourcedrive import START_NS, Rows, odometry, truth

from odomcorrupt.errors import RecordingError
from odomcorrupt.study.io import Source, read_runs


@dataclass(frozen=True)
class WFirst(Rows):
    """Rows whose quaternions are written in the order w, x, y, z."""

    @property
    def quat(self):
        return np.roll(super().quat, 1, axis=1)


@dataclass(frozen=True)
class UpsideDown(Rows):
    """Rows of a sensor that is mounted upside down."""

    @property
    def quat(self):
        c, s = np.cos(self.yaw / 2), np.sin(self.yaw / 2)
        return np.stack((c, s, 0 * c, 0 * c), axis=1)


def read(tmp_path, moved, real):
    return read_runs(
        Source(write(tmp_path / "run.mcap", topic("/odom", "Odometry", moved), topic("/truth", "PoseStamped", real)))
    )


def wheels_and_filter(rate_hz=25.0, lag_ns=4_000_000):
    """Odometry with ticks, and a filter of its speed and of a gyro's heading."""
    fine = odometry(60.0, rate_hz=25.0)
    steps = np.linalg.norm(np.diff(fine.xyz[:, :2], axis=0), axis=1)
    gone = np.round(np.concatenate(([0.0], np.cumsum(steps))) / 1.2e-4) * 1.2e-4
    moved = along(fine, gone, fine.yaw)
    t = np.arange(0.0, 59.9, 1.0 / rate_hz)
    own = (fine.stamps_ns - START_NS) * 1e-9
    stamps_ns = START_NS + (t * 1e9).astype(np.int64) + lag_ns
    shape = Rows(stamps_ns, np.zeros((len(t), 3)), 0.96 * np.interp(t, own, fine.yaw))
    return moved, along(shape, np.interp(t, own, gone), shape.yaw)


def along(rows, gone, yaw):
    middle = (yaw[1:] + yaw[:-1]) / 2.0
    step = np.diff(gone)
    xy = np.cumsum(np.stack((step * np.cos(middle), step * np.sin(middle)), axis=1), axis=0)
    return Rows(rows.stamps_ns, np.column_stack((np.vstack((np.zeros((1, 2)), xy)), 0 * yaw)), yaw)


@pytest.mark.parametrize("rate_hz", [25.0, 30.0])
def test_a_filter_of_the_wheels_speed_is_no_truth(tmp_path, rate_hz):
    with pytest.raises(RecordingError, match="repeats the travel of /odom"):
        read(tmp_path, *wheels_and_filter(rate_hz))


def test_a_truth_that_differs_by_a_millimetre_is_one(tmp_path):
    moved, real = wheels_and_filter()
    noise = 1e-3 * np.random.default_rng(1).standard_normal(real.xyz.shape)
    (run,) = read(tmp_path, moved, real.having(xyz=real.xyz + noise))
    assert not run.alerts


@pytest.mark.parametrize("topic_", ["/odom", "/truth"])
def test_quaternions_in_the_order_w_x_y_z(tmp_path, topic_):
    moved, real = odometry(), truth()
    first = [WFirst(r.stamps_ns, r.xyz, r.yaw) for r in (moved, real)]
    with pytest.raises(RecordingError, match=f"{topic_}: its quaternions roll while they never turn"):
        read(tmp_path, *((first[0], real) if topic_ == "/odom" else (moved, first[1])))


def test_a_sensor_upside_down_is_read(tmp_path):
    real = truth()
    assert read(tmp_path, odometry(), UpsideDown(real.stamps_ns, real.xyz, real.yaw))
