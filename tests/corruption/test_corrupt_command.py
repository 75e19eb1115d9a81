"""What the default command takes and says: tracks, units of coefficients, robots that no law fits, truth tellers."""

from __future__ import annotations

import pytest
from test_run import FIXTURES

from odomcorrupt.cli import run

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
    ("args", "sentence"),
    [
        (("--track", "0"), "0; write metres between the wheels, more than 0"),
        (
            ("--alpha", "5deg", "10deg/m", "5deg", "0.1"),
            "trans_trans: 5deg is an angle, but this coefficient is in metres",
        ),
        (("--alpha", "5deg/m", "0", "0", "0"), "rot_rot: 5deg/m; this coefficient is per rad, not per m"),
        (("--alpha", "0", "5deg/rad", "0", "0"), "rot_trans: 5deg/rad; this coefficient is per m, not per rad"),
        (("--alpha", "0.1/m", "0", "0", "0"), "rot_rot: 0.1/m; this coefficient is per rad"),
        (("--alpha", "5deg", "0", "0", "0", "--law", "quadratic"), "alphas of the law quadratic scale variances"),
        (("--alpha", "0", "0", "0", "1deg", "--law", "omni"), "alphas of the law omni scale variances"),
    ],
)
def test_a_unit_that_a_coefficient_cannot_have_is_refused(corrupt, args, sentence):
    code, said, target = corrupt(*args)
    assert (code, target.exists()) == (2, False)
    assert sentence in said


@pytest.mark.parametrize(
    ("words", "numbers"),
    [
        ("5deg 10deg/m 0.05 0.01", "rot_rot 0.08727 rot_trans 0.1745 trans_trans 0.05 trans_rot 0.01"),
        ("5deg/rad 10deg 0.05/m 0.01/rad", "rot_rot 0.08727 rot_trans 0.1745 trans_trans 0.05 trans_rot 0.01"),
        ("0.1rad 0.2rad/m 0 0", "rot_rot 0.1 rot_trans 0.2 trans_trans 0 trans_rot 0"),
    ],
)
def test_degrees_and_what_they_are_caused_by_may_be_written(corrupt, words, numbers):
    code, said, _ = corrupt("--alpha", *words.split())
    assert code == 0
    assert numbers in said


def test_the_clean_odometry_beside_the_noisy_is_counted_in_words(corrupt):
    code, said, _ = corrupt("--keep-truth", "/odom_true")
    assert code == 0
    assert "3000 messages of clean odometry on /odom_true added" in said


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
