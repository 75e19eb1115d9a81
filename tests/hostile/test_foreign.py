"""Other people's readers see in our outputs what was written; `foreign.py` prints the whole table."""

import sys
from pathlib import Path

import foreign
import numpy as np
import pytest
from foreign import heard, ours
from test_one_motion import Kind, drive, write

from odomcorrupt import read_estimate


@pytest.mark.slow
def test_every_reader_that_is_installed_opens_every_output_it_has_a_format_for():
    assert foreign.main() == 0


@pytest.mark.slow
def test_tf2_hears_the_odometry_of_each_robot_when_their_bag_is_played(tmp_path):
    kind, names = Kind(1, "ros1", "two robots", "level", "none", "child"), ("robot1", "robot2")
    write(kind, tmp_path / "in.bag")
    ours(str(tmp_path / "in.bag"), str(tmp_path / "out.bag"), "--odom", "/robot1/odom", "--also", "/robot2/odom",
         "--seed", "1", "--alpha", "0.1", "0.1", "0.1", "0.1")  # fmt: skip
    said = heard(tmp_path / "out.bag", *(["--tf2", f"__ns:=/{name}", f"/tf:=/{name}/tf"] for name in names))
    if said is None:
        pytest.skip("no rosbag, rosmaster and tf2 of Debian")
    assert [one["count"] for one in said] == [150, 150]
    assert max(one["off"] for one in said) < 1e-9
    errors = [one["end"] - drive(kind, start).position[-1, :2] for one, start in zip(said, (0.4, 2.0), strict=True)]
    assert np.hypot(*np.transpose(errors)).min() > 0.01
    assert np.abs(errors[0] - errors[1]).max() > 0.01


@pytest.mark.slow
def test_the_node_of_the_example_publishes_the_drift_of_a_corrupted_bag_under_a_real_roscore(tmp_path):
    # of Debian's packages those of ROS alone: their place comes last
    code = "import runpy, sys; sys.path.append(sys.argv[1]); runpy.run_path(sys.argv[2], run_name='__main__')"
    given = ["/usr/lib/python3/dist-packages", str(Path(__file__).parents[2] / "examples" / "drift_ros1.py")]
    node = [sys.executable, "-c", code, *given, "_model:=typical", "_seed:=7", "_tf:=true", "/tf:=/tf_drifted"]
    write(Kind(1, "ros1", "root", "level", "none", "child"), tmp_path / "in.bag")
    said = heard(tmp_path / "in.bag", ["--tf2", "odom:=/odom_drifted", "/tf:=/tf_drifted"], beside=node)
    if said is None:
        pytest.skip("no rosbag, rosmaster and tf2 of Debian")
    ours(str(tmp_path / "in.bag"), str(tmp_path / "out.bag"), "--seed", "7", "--preset", "typical")
    xyt = read_estimate(tmp_path / "out.bag", "/odom").trajectory.xyt
    assert (said[0]["count"], said[0]["off"]) == (len(xyt), pytest.approx(0.0, abs=1e-9))
    assert said[0]["end"] == pytest.approx(xyt[-1, :2], abs=1e-9)
