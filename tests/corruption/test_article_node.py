"""The article's node, literally: its listing's deviations, and noisy minus clean as the transform of a frame."""

from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

from odomcorrupt.cli import run
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.model.motion_model import MotionModel, Noise
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.trajectories import read_drive

OFFICE = Path(__file__).parents[2] / "fixtures" / "office.mcap"


def edges(path, frame):
    """Return stamps in ns and x, y, yaw of every transform from a frame."""
    rows, types = [], get_typestore(Stores.ROS2_HUMBLE)
    with path.open("rb") as file:
        for _, _, message in make_reader(file).iter_messages(["/tf"]):
            for one in types.deserialize_cdr(message.data, "tf2_msgs/msg/TFMessage").transforms:
                if one.header.frame_id == frame:
                    t, q = one.transform.translation, one.transform.rotation
                    stamp = one.header.stamp.sec * 10**9 + one.header.stamp.nanosec
                    rows.append((stamp, t.x, t.y, 2.0 * np.arctan2(q.z, q.w)))
    return np.array([row[0] for row in rows]), np.array([row[1:] for row in rows])


def test_subtraction_publishes_noisy_minus_clean_and_correction_the_rigid_motion(tmp_path):
    words = ["--odom-topic", "/odom", "--law", "article-code", "--alpha", "9", "9", "9", "9", "--seed", "4"]
    found = {}
    for how in ("subtraction", "correction"):
        out = tmp_path / f"{how}.mcap"
        assert run([str(OFFICE), str(out), *words, "--tf", how, "--new-odom-frame", "noisy"]) == 0
        found[how] = edges(out, "noisy")
    drive = read_drive(OFFICE, "/odom")
    np.testing.assert_array_equal(found["subtraction"][0], drive.stamps_ns)
    model = MotionModel(Noise("article-code", Coefficients(9.0, 9.0, 9.0, 9.0)))
    samples = NoisyPath(model, 4).feed(drive.stamps_ns, drive.xyt)
    np.testing.assert_allclose(found["subtraction"][1][:, :2], samples.error_xyt[:, :2], atol=1e-9)
    np.testing.assert_allclose(found["correction"][1][:, :2], samples.correction_xyt[:, :2], atol=1e-9)
    assert np.abs(found["subtraction"][1] - found["correction"][1]).max() > 1e-3


def test_subtraction_needs_a_frame(tmp_path, capsys):
    assert run([str(OFFICE), str(tmp_path / "o.mcap"), "--preset", "typical", "--tf", "subtraction"]) == 2
    assert "go together" in capsys.readouterr().err
