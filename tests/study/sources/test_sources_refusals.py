"""Bad input on the command line: exit code 1 and one line with the cause, the value found, and the way out."""

import io
from pathlib import Path

import click
import numpy as np
import pytest
from sourcebags import both, edges, topic, write
from sourcedrive import START_NS, odometry, truth

from odomcorrupt.cli import run
from odomcorrupt.commands._progress import Stages
from odomcorrupt.commands._recordings import recording_options
from odomcorrupt.commands._standard import Console
from odomcorrupt.study.io import Source, read_runs


@pytest.fixture
def refused(tmp_path, capsys):
    """Write odometry and truth, run a command on them, return the line it ends with."""

    def call(moved=None, real=None, *args, kind="PoseStamped", command="fit"):
        bag = both(tmp_path / "run.mcap", moved, real, kind=kind)
        return ending([command, str(bag), *args], capsys)

    return call


def ending(words, capsys):
    assert run(words) == 1
    said = capsys.readouterr()
    assert not said.out
    *_, line = said.err.splitlines()
    assert line.startswith("odomcorrupt: ")
    return line


def csv_file(path, rows, header="t,x,y,yaw", scale=1.0, yaw_scale=1.0, every=1):
    lines = [header]
    for stamp, xyz, yaw in list(zip(rows.stamps_ns.tolist(), rows.xyz, rows.yaw, strict=True))[::every]:
        lines.append(f"{stamp // 10**9}.{stamp % 10**9:09d},{xyz[0] * scale},{xyz[1] * scale},{yaw * yaw_scale}")
    path.write_text("\n".join(lines))
    return path


def still(rows):
    noise = 1e-3 * np.random.default_rng(1).standard_normal(rows.xyz.shape)
    return rows.having(xyz=noise, yaw=noise[:, 0])


def shrunk(rows):
    return rows.having(xyz=rows.xyz * 1e-3, yaw=rows.yaw * 1e-3)


@pytest.mark.parametrize(
    ("moved", "real", "said"),
    [
        (odometry(6.0), truth(6.0), "/odom: lasts 6.0 s; a study takes 10 s, better minutes"),
        (
            odometry(),
            truth().only(slice(None, None, 66)),
            "/truth: only 15 of its 15 poses are in the common time of odometry and truth; 20 and more",
        ),
        (still(odometry()), still(truth()), "/odom: no motion: 1 mm and 0.4 deg in 30 s; record a drive"),
        (odometry(), shrunk(truth()), "/truth: stands still while the odometry moves over"),
        (shrunk(odometry()), truth(), "/odom: stands still while the truth moves over"),
        (odometry(), truth().having(xyz=np.full((990, 3), np.nan)), "/truth: none of its 990 positions is a number"),
    ],
    ids=["short", "few poses in common", "no motion", "the truth stands still", "the odometry does", "no number"],
)
def test_what_is_no_drive(refused, moved, real, said):
    assert said in refused(moved, real)


def test_no_overlap_says_both_spans_and_the_shift_that_makes_them_match(refused, tmp_path):
    real = truth()
    early = real.having(stamps_ns=real.stamps_ns - START_NS + 7_000_000_000)
    line = refused(real=early)
    assert "have no time in common: odometry is from 2023-11-14 22:13:20 to 2023-11-14 22:13:50 UTC" in line
    assert "truth from 7.0 s to 37.0 s, their starts 53.9 years apart" in line
    shift = float(line.split("the motions match with --truth-shift ")[1])
    (recording,) = read_runs(Source(tmp_path / "run.mcap", truth_shift_s=shift))
    assert abs(recording.truth.stamps_ns[0] - real.stamps_ns[0]) < 300_000_000


def test_a_clock_that_is_many_seconds_off_within_the_overlap(refused, tmp_path):
    real = truth(60.0)
    line = refused(odometry(60.0), real.having(stamps_ns=real.stamps_ns + 14_000_000_000))
    assert "/truth: its clock is 14.0 s ahead of the odometry's" in line
    shift = float(line.split("give --truth-shift ")[1])
    assert shift == pytest.approx(-14.0, abs=0.3)
    assert len(read_runs(Source(tmp_path / "run.mcap", truth_shift_s=shift))) == 1


@pytest.mark.parametrize("rate_hz", [30.0, 50.0])
def test_the_exact_poses_of_a_simulator_are_a_truth(read, rate_hz):
    (run,) = read(*(odometry(60.0, rate_hz=hz, scale=1.0, drift=0.0) for hz in (rate_hz, 100.0)))
    assert any("/truth: equals /odom to within 2 mm over the whole drive" in note for note in run.notes)


def test_a_copy_of_the_odometry_throttled_or_in_another_frame_is_no_truth(refused):
    moved = odometry()
    assert "it is the same odometry" in refused(moved, moved.only(np.arange(0, len(moved), 3)))
    turned = moved.having(xyz=moved.xyz @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) + 4.0)
    for yaw in (moved.yaw + np.pi / 2, np.full(len(moved.yaw), np.nan)):
        assert "it is the same odometry" in refused(moved, turned.having(yaw=yaw))


def test_a_wrong_topic_names_the_near_miss(refused):
    line = refused(None, None, "--truth", "/ground_trth")
    assert "no topic /ground_trth (" in line
    assert "did you mean /odom" not in line
    line = refused(None, None, "--truth", "/trut")
    assert "/trut (did you mean /truth? found /odom, /truth). Name another with --truth, a file with" in line


def straight(rows):
    x = np.linspace(0.0, 20.0, len(rows))
    return rows.having(xyz=np.stack((x, 0.01 * np.sin(x), 0.0 * x), axis=1), yaw=0.01 * np.cos(x))


def sideways(rows):
    """Return the drive of a mecanum platform whose heading has nothing to do with its course."""
    t = (rows.stamps_ns - START_NS) * 1e-9
    return rows.having(yaw=0.8 * np.sin(0.7 * t + 1.0) - 0.02 * t)


def uphill(rows):
    return rows.having(xyz=rows.xyz + np.outer(rows.xyz[:, 0], [0.0, 0.0, 0.2]))


@pytest.mark.parametrize("drive", [straight, sideways, uphill])
def test_unusual_drives_are_not_taken_for_mistakes(read, drive):
    assert len(read(drive(odometry()), drive(truth()))) == 1


@pytest.mark.parametrize("command", ["fit", "diagnose", "learn"])
def test_every_command_of_the_study_refuses_alike(refused, command):
    said = refused(odometry(), odometry(), command=command)
    assert "/truth: repeats /odom (599 of 599 steps are equal): it is the same odometry" in said


def test_a_text_file_alone_asks_for_the_truth(tmp_path, capsys):
    table = csv_file(tmp_path / "odom.csv", odometry())
    line = ending(["fit", str(table)], capsys)
    assert "a text file holds one trajectory; name the truth's with --truth-bag" in line
    line = ending(["fit", str(table), "--truth-bag", str(table), "--truth", "/gt"], capsys)
    assert "is a text file, which has no topics; leave --truth /gt out" in line


def test_a_missing_file_and_a_bag_without_either(tmp_path, capsys):
    assert "none.mcap: cannot be read: No such file" in ending(["fit", str(tmp_path / "none.mcap")], capsys)
    bag = write(tmp_path / "tf.mcap", edges(truth(), "map", "base_link"))
    line = ending(["fit", str(bag)], capsys)
    assert "no topic that could be odometry (found /tf (tf2_msgs/TFMessage))" in line
    assert "an edge of TF as --odom /tf:odom.base_link" in line


@click.command()
@recording_options()
def reading_command(reading):
    return reading


def test_truth_files_are_one_for_all_or_one_for_each(tmp_path, capsys):
    table = str(csv_file(tmp_path / "a.csv", odometry()))
    assert run(["fit", table, table, table, "--truth-bag", table, "--truth-bag", table]) == 2
    assert "2 --truth-bag for 3 recordings; name one for all, or one for each" in capsys.readouterr().err


def test_each_recording_and_each_held_out_one_has_the_truth_file_of_its_place(tmp_path):
    moved = csv_file(tmp_path / "odom.csv", odometry())
    truths = [csv_file(tmp_path / f"{name}.csv", truth()) for name in "abc"]
    words = [word for path in truths for word in ("--truth-bag", str(path))]
    reading = reading_command.main(words, standalone_mode=False)
    runs, held_out = reading.read([moved, moved], Console(quiet=True), Stages(quiet=True), held_out=[moved])
    assert [source.truth_path for source in runs.sources] == truths[:2]
    assert [source.truth_path for source in held_out.sources] == truths[2:]


def test_the_next_command_reads_the_same_recordings_again():
    words = "--track 0.3 --odom /odom --truth-bag a.csv --truth-bag b.csv --truth-shift 2.5 --gyro-scale-accuracy 0.02"
    words = [*words.split(), "--joints", "left", "right", "--drive-type", "skid"]
    assert reading_command.main(words, standalone_mode=False).words == tuple(words)
    assert reading_command.main([], standalone_mode=False).words == ()


def test_a_model_is_fitted_to_two_text_files(tmp_path, capsys):
    moved = csv_file(tmp_path / "odom.csv", odometry())
    model = tmp_path / "robot.toml"
    words = ["-v", "--truth-file", str(csv_file(tmp_path / "gt.csv", truth())), "-o", str(model)]
    assert run(["fit", str(moved), *words]) == 0
    assert "odometry odom.csv, truth gt.csv" in capsys.readouterr().err
    assert "trans_trans" in model.read_text()


def test_a_recording_may_come_through_a_pipe(tmp_path, capsys, monkeypatch):
    moved = odometry()
    bag = write(tmp_path / "run.mcap", topic("/odom", "Odometry", moved), edges(moved, "map", "base_link"))

    class Pipe:
        buffer = io.BytesIO(Path(bag).read_bytes())

    monkeypatch.setattr("sys.stdin", Pipe)
    line = ending(["fit", "-", "--truth", "/tf:map.base_link"], capsys)
    assert line.startswith("odomcorrupt: stdin: /tf:map.base_link: repeats /odom")
