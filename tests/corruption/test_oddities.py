"""Odd drives: what a corruption and a correction say of stamps and poses that no robot has."""

from __future__ import annotations

import numpy as np
import pytest
from bagged import ODOM, TF, odometry, transforms
from drives import office
from mcap.writer import Writer

from odomcorrupt.bags.messages import gather, locate
from odomcorrupt.bags.open import open_reader
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
        "1 odometry poses are not numbers: left unchanged.",
    ),
    "correct": (
        "/tf_static holds odom -> base_link: published once for all time, it cannot follow the correction.",
        "Time jumped back 1 times: each stretch was corrected by itself.",
        "The pose jumped 1 times: the correction was held across.",
        "1 odometry stamps lie far ahead of their neighbours': not used to correct.",
        "1 odometry poses are not numbers: left unchanged.",
    ),
}


@pytest.fixture(scope="module")
def odd(tmp_path_factory):
    """Write a drive that jumps, swaps two messages, has a stamp of zero, one of the future, and begins anew."""
    t, poses = office(20.0, 20.0)
    poses = poses.copy()
    poses[200:, 0] += 40.0
    poses[50, 1] = np.nan
    stamps = t.copy()
    stamps[120] += 3600 * SECOND_NS
    stamps[90] = 0
    drive = [(int(log), odometry(s, p)) for log, s, p in zip(t, stamps, poses, strict=True)]
    drive[20], drive[21] = drive[21], drive[20]
    again = [
        (log + 30 * SECOND_NS, odometry(s, p)) for (log, _), s, p in zip(drive, t, office(20.0, 20.0)[1], strict=True)
    ]
    path = tmp_path_factory.mktemp("odd") / "in.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        channels = {}
        for topic, kind in (("/odom", ODOM.msgtype), ("/tf_static", TF.msgtype)):
            schema = writer.register_schema(kind, "ros2msg", b"")
            channels[topic] = writer.register_channel(topic, "cdr", schema)
        writer.add_message(channels["/tf_static"], int(t[0]), transforms((t[0], "odom", "base_link", np.zeros(3))), 0)
        for log_ns, data in drive + again:
            writer.add_message(channels["/odom"], log_ns, data, log_ns)
        writer.finish()
    return path


def poses_of(path):
    found = []
    with open_reader(path) as reader:
        for block in reader.blocks():
            for channel in reader.channels.values():
                if channel.topic == "/odom":
                    found += [gather(block, layout, layout.items[0], "position") for layout in locate(block, channel)]
    return np.concatenate(found)


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
    before, after = poses_of(odd), poses_of(out)
    assert before.shape == after.shape
    assert np.isnan(after).any(axis=1).sum() == np.isnan(before).any(axis=1).sum() == 1
    assert np.nanmax(np.abs(after - before)) < 20.0
    # all of it is left alone, not only the coordinate that is no number
    left = np.isnan(before).any(axis=1)
    assert np.array_equal(after[left], before[left], equal_nan=True)


def test_a_batch_makes_the_same_bytes_of_them(odd, tmp_path, capsys):
    assert run([str(odd), str(tmp_path / "one.mcap"), *NOISE, "--run", "1"]) == 0
    assert run(["batch", str(odd), str(tmp_path / "runs"), "--runs", "2", *NOISE]) == 0
    assert (tmp_path / "runs" / "run_000001.mcap").read_bytes() == (tmp_path / "one.mcap").read_bytes()


@pytest.mark.parametrize(
    ("topic", "kept", "warned"),
    [
        ("/sim/ground_truth/odom", (), True),
        ("/odom", (), False),
        ("/sim/ground_truth/odom", ("--keep-truth", "/clean"), False),
    ],
)
def test_odometry_named_like_a_truth_is_reported_unless_a_clean_copy_is_kept(tmp_path, capsys, topic, kept, warned):
    t, poses = office(20.0, 20.0)
    with (tmp_path / "in.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        channel = writer.register_channel(topic, "cdr", writer.register_schema(ODOM.msgtype, "ros2msg", b""))
        for log_ns, pose in zip(t, poses, strict=True):
            writer.add_message(channel, int(log_ns), odometry(log_ns, pose), int(log_ns))
        writer.finish()
    assert run([str(tmp_path / "in.mcap"), str(tmp_path / "out.mcap"), *NOISE, *kept]) == 0
    assert (f"{topic} is named like a ground truth" in " ".join(capsys.readouterr().err.split())) == warned
