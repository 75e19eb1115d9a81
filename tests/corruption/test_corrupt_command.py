"""What the default command takes and says: tracks, units of coefficients, robots that no law fits, truth tellers."""

from operator import itemgetter

import numpy as np
import pytest
from bagged import ODOM, TF, odometry, robot, transforms, write_mcap
from drives import office
from test_run import FIXTURES

from odomcorrupt.bags.block import Channel
from odomcorrupt.bags.messages import gather_stamps_ns, locate
from odomcorrupt.bags.open import open_reader
from odomcorrupt.cli import run
from odomcorrupt.geometry.se2 import compose

OFFICE = str(FIXTURES / "office.mcap")


@pytest.fixture
def corrupt(tmp_path, capsys):
    def call(*args):
        target = tmp_path / "out.mcap"
        code = run([OFFICE, str(target), "-v", "--seed", "1", "--overwrite", *args])
        return code, capsys.readouterr().err, target

    return call


def test_effects_of_single_wheels_take_the_track_from_the_command_line_or_the_file(corrupt, tmp_path):
    code, said, target = corrupt("--effect", "quantization:step=0.01")
    assert (code, target.exists()) == (1, False)
    assert "give it in metres with --track" in said
    code, said, target = corrupt("--effect", "quantization:step=0.01", "--track", "0.4")
    assert code == 0
    assert "quantization (step 0.01 m)" in said
    by_option = target.read_bytes()
    file = tmp_path / "robot.toml"
    words = "rot_rot = 0\nrot_trans = 0\ntrans_trans = 0\ntrans_rot = 0"
    effect = '[[effect]]\nname = "quantization"\nstep = 0.01'
    file.write_text(f"schema = 1\n[noise]\n{words}\n{effect}\n[robot]\ntrack = 0.9\n")
    assert corrupt("--model", str(file), "--track", "0.4")[2].read_bytes() == by_option
    assert corrupt("--model", str(file))[2].read_bytes() != by_option


@pytest.mark.parametrize(
    ("args", "sentence"), [(("--track", "0"), "0; write metres between the wheels, more than 0"),
    (("--alpha", "5deg", "10deg/m", "5deg", "0.1"), "trans_trans: 5deg is an angle, but this coefficient is in metres"),
    (("--alpha", "5deg/m", "0", "0", "0"), "rot_rot: 5deg/m; this coefficient is per rad, not per m"),
    (("--alpha", "0", "5deg/rad", "0", "0"), "rot_trans: 5deg/rad; this coefficient is per m, not per rad"),
    (("--alpha", "0.1/m", "0", "0", "0"), "rot_rot: 0.1/m; this coefficient is per rad"),
    (("--alpha", "5deg", "0", "0", "0", "--law", "quadratic"), "alphas of the law quadratic scale variances"),
    (("--alpha", "0", "0", "0", "1deg", "--law", "omni"), "alphas of the law omni scale variances")]
)  # fmt: skip
def test_a_unit_that_a_coefficient_cannot_have_is_refused(corrupt, args, sentence):
    code, said, target = corrupt(*args)
    assert (code, target.exists()) == (2, False)
    assert sentence in said


@pytest.mark.parametrize(
    ("words", "said"),
    [("--alpha 5deg 10deg/m 0.05 0.01", "rot_rot 0.08727 rot_trans 0.1745 trans_trans 0.05 trans_rot 0.01"),
    ("--alpha 5deg/rad 10deg 0.05/m 0.01/rad", "rot_rot 0.08727 rot_trans 0.1745 trans_trans 0.05 trans_rot 0.01"),
    ("--alpha 0.1rad 0.2rad/m 0 0", "rot_rot 0.1 rot_trans 0.2 trans_trans 0 trans_rot 0"),
    ("--keep-truth /odom_true", "3000 messages of clean odometry on /odom_true added")]
)  # fmt: skip
def test_degrees_what_they_are_caused_by_and_messages_that_were_added_are_said(corrupt, words, said):
    code, summary, _ = corrupt(*words.split())
    assert code == 0
    assert said in summary


def test_a_drive_faster_than_a_learned_model_covers_is_corrupted_and_reported(corrupt, tmp_path):
    model = tmp_path / "model.toml"
    text = (
        'schema = 1\n[noise]\nlaw = "diffusion"\nrot_rot = 0\nrot_trans = 0\ntrans_trans = 0\ntrans_rot = 0\n'
        '[[effect]]\nname = "spins"\nexpression = "along += v * (k * max(abs(v) - 0.6, 0))"\nk = -2.0\n'
    )
    model.write_text(text)
    assert corrupt("--model", str(model))[0] == 1
    model.write_text(text + '[source]\nrecordings = ["a.mcap"]\n')
    code, said, _ = corrupt("--model", str(model))
    assert code == 0
    assert "% faster than the model's highest valid speed: the relative error is kept constant." in said


def edges_of(path):
    with open_reader(path) as reader:
        channel = next(c for c in reader.channels.values() if c.topic == "/tf")
        return [
            (item.frame_id, item.child_frame_id, int(stamp))
            for block in reader.blocks()
            for layout in locate(block, channel)
            for item in layout.items
            for stamp in gather_stamps_ns(block, layout, item)
        ]


def test_the_localisation_of_the_true_odometry_is_said_and_can_be_left_out(tmp_path, capsys):
    messages = robot(*office(10.0, 10.0))
    amcl = Channel(9, "/amcl_pose", "geometry_msgs/msg/PoseWithCovarianceStamped", "cdr")
    source = write_mcap(tmp_path / "in.mcap", [(amcl, messages[0][1], b"\0\1\0\0"), *messages])
    target, batched = tmp_path / "out.mcap", ["--seed", "1", "--runs", "2"]
    for words in (
        [str(source), str(target), "--seed", "1", "-v"],
        ["batch", str(source), str(tmp_path / "b"), *batched, "-v"],
    ):
        assert run(words) == 0
        said = " ".join("".join(capsys.readouterr()).split())
        assert "recorded localisation stays, and is of the true odometry: leave it out with " in said
        assert words[0] != "batch" or " RMS at the end of " in said
        assert "--exclude-topic /tf:map.odom --exclude-topic /amcl_pose and localise again, or move TF with " in said
    assert run([str(source), str(target), "--seed", "1", "--overwrite"]) == 0
    brief = capsys.readouterr().err
    assert "seed      1, run 0" in brief
    assert "--exclude-topic /tf:map.odom --exclude-topic /amcl_pose\n" in brief
    assert run(["info", str(source)]) == 0
    assert "--exclude-topic /tf:map.odom --exclude-topic /amcl_pose" in capsys.readouterr().out
    left_out = ["--exclude-topic", "/amcl_pose", "--exclude-topic", "/tf:map.odom"]
    assert run(["batch", str(source), str(tmp_path / "c"), *batched, *left_out]) == 0
    assert "stays" not in capsys.readouterr().out
    moved = [edge for edge in edges_of(target) if edge[:2] == ("odom", "base_link")]
    for words in (["/tf:map.odom"], ["tf:map.odom", "/tf:base_link.laser"]):
        exclude = [word for one in words for word in ("--exclude-topic", one)]
        assert run([str(source), str(target), "--seed", "1", "-v", "--overwrite", *exclude]) == 0
        assert "--exclude-topic /tf:" not in capsys.readouterr().err
        kept = {("odom", "base_link"), *([("base_link", "laser")] if len(words) == 1 else [])}
        assert {edge[:2] for edge in edges_of(target)} == kept
        assert [edge for edge in edges_of(target) if edge[:2] == ("odom", "base_link")] == moved
    for words in ([str(source), str(tmp_path / "d.mcap")], ["batch", str(source), str(tmp_path / "d"), *batched]):
        assert run([*words, "--exclude-topic", "/tf:map.odom", "--exclude-topic", "/tf:odom.map"]) == 1
        assert "/tf:odom.map: the input has no such edge (it has /tf:base_link.laser, /tf:" in capsys.readouterr().err
        assert not [*tmp_path.glob("d/run*"), *tmp_path.glob("d.mcap")]
    assert run([str(source), str(target), "--overwrite", "--exclude-topic", "/odom:map.odom"]) == 1
    assert "an edge of TF as in /tf:map.odom" in " ".join(capsys.readouterr().err.split())


def test_a_correction_is_published_once_for_each_stamp(tmp_path):
    t, poses = office(5.0, 10.0)
    twice = [(ODOM, int(s) + late, odometry(s, p)) for s, p in zip(t, poses, strict=True) for late in (0, 1000)]
    source, target = write_mcap(tmp_path / "in.mcap", twice), tmp_path / "out.mcap"
    assert run([str(source), str(target), "--seed", "1", "--tf", "correction", "--new-odom-frame", "odom1"]) == 0
    assert edges_of(target) == [("odom1", "odom", int(s)) for s in t]


def test_two_publishers_are_refused_with_the_way_out(tmp_path, capsys):
    t, poses = office(10.0, 10.0)
    beside = compose(np.array([0.3, 0.1, 0.09]), poses)
    both = [(ODOM, int(s), odometry(s, p)) for s, p in zip(t, poses, strict=True)]
    both += [(ODOM, int(s) + 21_000_000, odometry(s + 21_000_000, p)) for s, p in zip(t, beside, strict=True)]
    source, target = write_mcap(tmp_path / "in.mcap", sorted(both, key=itemgetter(1))), tmp_path / "out.mcap"
    assert run([str(source), str(target), "--seed", "1"]) == 1
    assert "two publishers alternate" in (said := capsys.readouterr().err)
    assert "sideways" not in said
    assert not target.exists()
    both[len(t) :] = [
        (Channel(late, "/tf", TF.msgtype, "cdr"), int(s) + late, transforms((int(s) + late, "odom", "base_link", p)))
        for path, late in ((poses, 10), (beside, 21_000_000))  # in channels of their own, as of two nodes in ROS 1
        for s, p in zip(t, path, strict=True)
    ]
    write_mcap(source, sorted(both, key=itemgetter(1)))
    for words in ([str(source), str(target), "--seed", "1"], ["info", "-v", str(source)]):
        assert run(words) == 0
        assert "TF odom -> base_link: two publishers alternate" in " ".join("".join(capsys.readouterr()).split())
