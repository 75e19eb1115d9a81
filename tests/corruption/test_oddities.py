"""Odd drives: what a corruption and a correction say of stamps and poses that no robot has."""

from dataclasses import replace

import numpy as np
import pytest
from bagged import ODOM, TF, odometry, rows_of, transforms, write_mcap
from drives import office

from odomcorrupt.cli import run

SECOND_NS = 10**9
NOISE = ("--alpha", "0.05", "0.02", "0.05", "0.01", "--seed", "7")
SAID = {
    "corrupt": (
        "/tf_static holds odom -> base_link: published once for all time, it cannot follow the drift.",
        "1 odometry stamps are zero: log times were used instead.",
        "1 odometry messages were out of order: they were sorted.",
        "Time jumped back 1 times: each time the drift began again at zero.",
        "The pose jumped 1 times: the correction was held across.",
        "1 odometry stamps lie far ahead of their neighbours': no noise of their own.",
        "2 odometry poses are not numbers: left unchanged.",
    ),
    "correct": (
        "/tf_static holds odom -> base_link: published once for all time, it cannot follow the correction.",
        "Time jumped back 1 times: each stretch was corrected by itself.",
        "The pose jumped 1 times: the correction was held across.",
        "1 odometry stamps lie far ahead of their neighbours': not used to correct.",
        "2 odometry poses are not numbers: left unchanged.",
    ),
}


@pytest.fixture(scope="module")
def odd(tmp_path_factory):
    """Write a drive that jumps, swaps two messages, has a stamp of zero, one of the future, and begins anew."""
    t, poses = office(20.0, 20.0)
    poses = poses.copy()
    poses[200:, 0] += 40.0
    poses[50:52, 1] = np.nan, np.inf
    stamps = t.copy()
    stamps[120] += 3600 * SECOND_NS
    stamps[90] = 0
    drive = [(ODOM, log, odometry(s, p)) for log, s, p in zip(t, stamps, poses, strict=True)]
    drive[20], drive[21] = drive[21], drive[20]
    again = [
        (ODOM, log + 30 * SECOND_NS, odometry(s, p))
        for (_, log, _), s, p in zip(drive, *office(20.0, 20.0), strict=True)
    ]
    static = replace(TF, topic="/tf_static")
    edge = (static, t[0], transforms((t[0], "odom", "base_link", np.zeros(3))))
    return write_mcap(tmp_path_factory.mktemp("odd") / "in.mcap", [edge, *drive, *again])


@pytest.mark.parametrize("command", SAID)
def test_oddities_are_counted_and_told(command, odd, tmp_path, capsys):
    out = tmp_path / "out.mcap"
    words = (
        [str(odd), str(out), *NOISE]
        if command == "corrupt"
        else ["correct", str(odd), str(out), "--effect", "unequal_wheels:curvature=0.01"]
    )
    assert run([*words, "-v"]) == 0
    said = capsys.readouterr().err
    for sentence in SAID[command]:
        assert sentence in said, said
    before, after = (rows_of(path).position for path in (odd, out))
    assert before.shape == after.shape
    # all of a pose is left alone, not only the coordinate that is no number
    left = ~np.isfinite(before).all(axis=1)
    assert np.array_equal(~np.isfinite(after).all(axis=1), left)
    assert np.count_nonzero(left) == 2
    assert np.abs(after[~left] - before[~left]).max() < 20.0
    assert np.array_equal(after[left], before[left], equal_nan=True)


def test_a_batch_makes_the_same_bytes_of_them(odd, tmp_path, capsys):
    assert run([str(odd), str(tmp_path / "one.mcap"), *NOISE, "--run", "1"]) == 0
    assert run(["batch", str(odd), str(tmp_path / "runs"), "--runs", "2", *NOISE]) == 0
    assert (tmp_path / "runs" / "run_000001.mcap").read_bytes() == (tmp_path / "one.mcap").read_bytes()


@pytest.mark.parametrize(
    ("topic", "kept", "warned"),
    [("/sim/ground_truth/odom", (), True),
    ("/odom", (), False),
    ("/sim/ground_truth/odom", ("--keep-truth", "/clean"), False)],
)  # fmt: skip
def test_odometry_named_like_a_truth_is_reported_unless_a_clean_copy_is_kept(tmp_path, capsys, topic, kept, warned):
    channel = replace(ODOM, topic=topic)
    write_mcap(
        tmp_path / "in.mcap", [(channel, log, odometry(log, p)) for log, p in zip(*office(20.0, 20.0), strict=True)]
    )
    assert run([str(tmp_path / "in.mcap"), str(tmp_path / "out.mcap"), *NOISE, *kept]) == 0
    assert (f"{topic} is named like a ground truth" in " ".join(capsys.readouterr().err.split())) == warned
