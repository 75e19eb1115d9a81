"""What a model will do to a drive, before it is done."""

import json

import numpy as np
import pytest
from bagged import IMU, ODOM, TF, MemoryBag, blocks_of, odometry, robot
from drives import model, office, silent
from test_run import FIXTURES

from odomcorrupt.api.model import Model
from odomcorrupt.api.preview import Preview
from odomcorrupt.cli import run
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.corruption.transform import Options
from odomcorrupt.effects import effect_from_values
from odomcorrupt.errors import TopicError
from odomcorrupt.forecasting import CleanDrive, forecast, read_clean_drive

T, POSES = office(10.0, 40.0)
DRIVE = CleanDrive("/odom", T, POSES)


def outlook_of(chosen, seed=1, runs=2, drive=DRIVE, first=0):
    paths = (NoisyPath(chosen, seed, run) for run in range(first, first + runs))
    return forecast(drive, chosen, paths, first_run=first)


def preview_of(chosen, **options):
    return Preview(outlook_of(chosen, **options), Model.of(chosen), 1)


def bag(messages):
    return MemoryBag(blocks_of(messages), {c.id: c for c in (ODOM, TF, IMU)})


def test_the_clean_drive_is_the_longest_stretch():
    t, poses = office(20.0, 8.0)
    short = [(ODOM, int(s), odometry(s, p)) for s, p in zip(t[:40], poses[:40], strict=True)]
    later = [(c, log + 10**10, data) for c, log, data in robot(t, poses)]
    drive = read_clean_drive(bag(short + later), model(), Options())
    assert drive.name == "/odom"
    assert np.array_equal(drive.stamps_ns, t)
    assert drive.xyt == pytest.approx(poses)


def test_without_odometry_there_is_no_forecast():
    with pytest.raises(TopicError):
        read_clean_drive(MemoryBag([], {IMU.id: IMU}, name="x"), model(), Options())


def test_rows_are_the_moments_of_its_runs():
    outlook = outlook_of(model(), 1, 50)
    errors = np.array([NoisyPath(model(), 1, k).feed(T, POSES).error_xyt[-1] for k in range(50)])
    end = outlook.rows[-1]
    assert outlook.noisy_xy[1][-1] - outlook.clean_xy[-1] == pytest.approx(errors[1, :2])
    assert end.after_m == pytest.approx(outlook.distance_m)
    assert end.position_rms_m == pytest.approx(np.sqrt(np.mean(errors[:, :2] ** 2) * 2))
    assert end.heading_rms_rad == pytest.approx(np.sqrt(np.mean(errors[:, 2] ** 2)))
    assert np.mean(np.hypot(errors[:, 0], errors[:, 1]) <= end.position_90_m) == pytest.approx(0.9, abs=0.021)
    assert [row.after_m for row in outlook.rows[:-1]] == [1.0, 2.0, 5.0, 10.0]


@pytest.mark.parametrize(
    ("chosen", "depends"),
    [(model(), False), (model("linear"), True), (model("linear", step="0.25m,0.2rad"), False), (model("omni"), True)],
)
def test_it_says_whether_the_message_rate_matters(chosen, depends):
    shown = preview_of(chosen)
    assert shown.to_dict()["depends_on_rate"] == depends
    assert ("noise depends on the message rate" in shown.details()) == depends


def test_half_the_rate_makes_a_linear_law_drift_by_the_square_root_of_two():
    assert outlook_of(model("linear")).half_rate_heading == pytest.approx(np.sqrt(2), rel=0.05)


def test_jitter_of_the_recording_is_not_blamed_on_the_law():
    rng = np.random.default_rng(3)
    shaken = CleanDrive("/odom", T, POSES + np.array([0.0, 0.0, 0.01]) * rng.standard_normal(POSES.shape))
    shown = preview_of(model(), drive=shaken)
    text = shown.details()
    assert "The noise does not depend on the message rate. This recording does: jitter between messages" in text
    assert f"heading {shown.result.half_rate_heading:.3g} times as uncertain" in text
    assert not shown.to_dict()["depends_on_rate"]


def test_a_robot_that_strafes_is_warned_of_a_law_that_does_not_know_it():
    aside = CleanDrive("/odom", T, np.column_stack((0.0 * T, np.linspace(0.0, 5.0, len(T)), 0.0 * T)))
    shown = preview_of(model("linear"), drive=aside)
    assert "The robot moves sideways (5 m of 5 m), which the law linear does not model" in shown.details()
    assert shown.to_dict()["warnings"]
    assert not preview_of(model("omni"), drive=aside).to_dict()["warnings"]


def test_effects_are_reported_as_the_constant_part():
    chosen = silent([effect_from_values("wheel_scale", {"e": 0.01})])
    shown = preview_of(chosen)
    assert shown.result.rows[-1].position_mean_m == pytest.approx(shown.result.rows[-1].position_rms_m)
    assert "of it constant" in shown.details()
    assert "of it constant" not in preview_of(model()).details()


def test_the_command_prints_a_table_or_values_and_draws(capsys, tmp_path):
    office_bag, picture = str(FIXTURES / "office.mcap"), tmp_path / "fan.svg"
    assert run(["preview", "-v", office_bag, "--runs", "3", "--alpha", "0.1", "0", "0", "0", "-o", str(picture)]) == 0
    captured = capsys.readouterr()
    assert "over /odom: 25.05 m in 59.98 s at 50 Hz\nmodel    Law diffusion, rot_rot 0.1 " in captured.out
    assert picture.read_bytes().startswith(b"<?xml")
    corruption = "--seed 4 --run 3 --keep-truth /x --twist keep --compression lz4 --keep-localisation"
    assert run(["preview", "-v", office_bag, "--runs", "3", *corruption.split()]) == 0
    assert "runs 3 to 5 of seed 4" in capsys.readouterr().out
    assert run(["preview", office_bag, "--runs", "3", "--run", "3", "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert (values["runs"], values["first_run"]) == (3, 3)
    assert b"message rate" not in picture.read_bytes()
    rated = tmp_path / "rated.svg"
    assert run(["preview", "-v", office_bag, "--runs", "3", "--preset", "article", "-o", str(rated)]) == 0
    assert b"at 50 Hz; the noise depends on the message rate" in rated.read_bytes()
    assert run(["preview", office_bag, "-o", str(tmp_path / "fan.gif")]) == 2
    assert run(["preview", office_bag, "-o", str(picture)]) == 1
    assert "exists already" in capsys.readouterr().err
    assert run(["preview", office_bag, "-o", str(tmp_path / "nowhere" / "fan.png")]) == 1
    captured = capsys.readouterr()
    assert (captured.out, "nowhere does not exist; create it first" in captured.err) == ("", True)


@pytest.mark.parametrize("command", ["info", "preview"])
def test_damaged_bags_are_read_on_request_and_what_is_lost_is_said(capsys, tmp_path, command):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes((FIXTURES / "office.mcap").read_bytes()[:200_000])
    assert run([command, str(cut)]) == 1
    assert "--recover saves the intact part" in capsys.readouterr().err
    assert run([command, str(cut), "--recover"]) == 3
    captured = capsys.readouterr()
    assert "Lost: " in captured.err
    assert "/odom" in captured.out
