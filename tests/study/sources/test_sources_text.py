"""TUM and CSV files are read exactly; bad input ends in one line with the cause, the value found, and the way out."""

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
from odomcorrupt.errors import RecordingError
from odomcorrupt.study.io import Source, read_runs
from odomcorrupt.study.io.text import guess_tick, is_text, read_text


def seconds(stamp_ns):
    return f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d}"


def tum(path, rows):
    lines = ["# timestamp tx ty tz qx qy qz qw"]
    for stamp, xyz, quat in zip(rows.stamps_ns.tolist(), rows.xyz.tolist(), rows.quat.tolist(), strict=True):
        lines.append(" ".join([seconds(stamp), *map(repr, xyz), *map(repr, quat)]))
    path.write_text("\n".join(lines) + "\n")
    return path


def table(path, rows, header="t,x,y,yaw", line="{s},{x},{y},{yaw}"):
    """Write a table; `line` names the columns of a row: s, ns, x, mm and so on."""
    lines = [header]
    for stamp, (x, y, z), yaw, quat in zip(
        rows.stamps_ns.tolist(), rows.xyz.tolist(), rows.yaw.tolist(), rows.quat.tolist(), strict=True
    ):
        values = {"ns": stamp, "s": seconds(stamp), "us": stamp // 10**3, "ms": stamp / 10**6}
        values |= {"sec": stamp // 10**9, "nsec": stamp % 10**9, "x": x, "y": y, "z": z, "mmx": x * 1e3, "mmy": y * 1e3}
        values |= {"yaw": yaw, "deg": np.degrees(yaw)} | dict(zip(("qx", "qy", "qz", "qw"), quat, strict=True))
        lines.append(line.format(**values))
    path.write_text("\r\n".join(lines))
    return path


def test_tum_files_keep_their_stamps_to_the_nanosecond(tmp_path):
    moved, real = odometry(), truth()
    (recording,) = read_runs(Source(tum(tmp_path / "odom.tum", moved), truth_path=tum(tmp_path / "gt.txt", real)))
    for trajectory, rows in ((recording.odometry, moved), (recording.truth, real)):
        assert np.array_equal(trajectory.stamps_ns, rows.stamps_ns)
        np.testing.assert_allclose(trajectory.xyt, rows.xyt, atol=1e-12)


ROSTOPIC = (
    *("%time", "field.header.seq", "field.header.stamp", "field.header.frame_id"),
    *(f"field.pose.pose.position.{axis}" for axis in "xyz"),
    *(f"field.pose.pose.orientation.{axis}" for axis in "xyzw"),
    *("field.twist.twist.linear.x", "field.twist.twist.angular.z"),
)
EUROC = ("#timestamp [ns]", *(f"p_RS_R_{axis} [m]" for axis in "xyz"), *(f"q_RS_{axis} []" for axis in "wxyz"))


@pytest.mark.parametrize(
    ("header", "line"),
    [
        ("t,x,y,theta", "{s},{x},{y},{yaw}"),
        ("timestamp;x;y;yaw", "{ns};{x};{y};{yaw}"),
        ("stamp,x,y,yaw", "{us},{x},{y},{yaw}"),
        ("time_ms\tpos_x\tpos_y\tz\tyaw_deg", "{ms}\t{x}\t{y}\t9\t{deg}"),
        ("index,stamp [ns],x_mm,y_mm,heading", "1,{ns},{mmx},{mmy},{yaw}"),
        (", ".join(EUROC), "{ns},{x},{y},{z},{qw},{qx},{qy},{qz}"),
        (",".join(ROSTOPIC), "9{ns},0,{ns},odom,{x},{y},{z},{qx},{qy},{qz},{qw},5,6"),
        (
            "header.stamp.sec,header.stamp.nanosec,position.x,position.y,orientation.z,orientation.w,qx,qy",
            "{sec},{nsec},{x},{y},{qz},{qw},{qx},{qy}",
        ),
        ('"secs","nsecs","px","py","th"', "{sec},{nsec},{x},{y},{yaw}"),
    ],
)
def test_headers_are_read_by_their_words(tmp_path, header, line):
    real = truth()
    samples = read_text(table(tmp_path / "truth.csv", real, header, line), "truth.csv")
    lost_ns = 1000 if "{us}" in line or "{ms}" in line else 1
    assert np.abs(samples.stamps_ns - real.stamps_ns).max() < lost_ns
    np.testing.assert_allclose(samples.xyz[:, :2], real.xyz[:, :2], atol=1e-9)
    np.testing.assert_allclose(np.unwrap(samples.yaw_rad), real.yaw, atol=1e-9)


@pytest.mark.parametrize("up", ["Y", "Z"])
@pytest.mark.parametrize("unit", ["Meters", "Millimeters"])
def test_an_export_of_motive_is_read_with_its_axis_up(tmp_path, up, unit):
    real = truth()
    (x, y, _), (_, _, qz, qw) = real.xyz.T * (1e3 if unit == "Millimeters" else 1.0), real.quat.T
    flat, still = np.zeros(len(x)), np.full(len(x), 0.2) + 0.001 * np.sin(np.arange(len(x)))
    body = (flat, qz, flat, qw, x, still, -y) if up == "Y" else (flat, flat, qz, qw, x, y, still)
    values = np.column_stack((np.arange(len(x)), (real.stamps_ns - START_NS) / 1e9, *body, still, x, y, still))
    heads = [
        f"Format Version,1.23,Take Name,Take 1,Rotation Type,Quaternion,Length Units,{unit},Coordinate Space,Global"
    ]
    for label, own, marker in (("Type", "Rigid Body", "Rigid Body Marker"), ("Name", "robot", "robot:Marker1")):
        heads.append(",".join(["", label, *[own] * 8, *[marker] * 3]))
    heads += [
        ",ID" + ",1" * 11,
        ",," + ",".join(["Rotation"] * 4 + ["Position"] * 3 + ["Mean Marker Error"] + ["Position"] * 3),
    ]
    heads += ["Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,,X,Y,Z", *(",".join(map(repr, row)) for row in values.tolist())]
    (tmp_path / "take.csv").write_text("\n".join([heads[0], "", *heads[1:]]))
    samples = read_text(tmp_path / "take.csv", "take.csv")
    assert np.abs(samples.stamps_ns - (real.stamps_ns - START_NS)).max() < 1000
    np.testing.assert_allclose(samples.xyz[:, :2], real.xyz[:, :2], atol=1e-9)
    np.testing.assert_allclose(np.unwrap(samples.yaw_rad), real.yaw, atol=1e-9)
    heads[2] = heads[2].replace("robot:Marker1", "wand").replace("Marker", "Body")
    heads[1] = heads[1].replace("Rigid Body Marker", "Rigid Body")
    (tmp_path / "take.csv").write_text("\n".join([heads[0], "", *heads[1:]]))
    with pytest.raises(RecordingError, match="rigid bodies robot and wand"):
        read_text(tmp_path / "take.csv", "take.csv")


@pytest.mark.parametrize(("unit", "word"), [("ns", "nanoseconds"), ("us", "microseconds"), ("ms", "milliseconds")])
def test_stamps_that_count_from_the_start_are_read_by_their_steps_and_it_is_said(tmp_path, unit, word):
    real = truth()
    relative = real.having(stamps_ns=real.stamps_ns - START_NS)
    samples = read_text(table(tmp_path / "t.csv", relative, "t,x,y,yaw", f"{{{unit}}},{{x}},{{y}},{{yaw}}"), "t.csv")
    assert np.abs(samples.stamps_ns - relative.stamps_ns).max() < 1000
    assert samples.notes == (f"t.csv: stamps read as {word}",)
    assert guess_tick(np.arange(0.0, 300.0, 2.0)) == 10**9  # not 0.3 s of milliseconds


def test_without_headings_a_table_holds_positions(tmp_path):
    real = truth()
    bag = write(tmp_path / "run.mcap", topic("/odom", "Odometry", odometry()))
    (recording,) = read_runs(Source(bag, truth_path=table(tmp_path / "gt.csv", real, "t,x,y", "{s},{x},{y}")))
    assert np.isnan(recording.truth.xyt[:, 2]).all()
    np.testing.assert_allclose(recording.truth.xyt[:, :2], real.xyz[:, :2])


def test_a_last_line_that_was_cut_is_left_out_and_a_short_one_elsewhere_is_not(tmp_path):
    lines = ["t,x,y,yaw", "0,0,0,0", "0.1,1,0,0", "0.2,2"]
    path = tmp_path / "t.csv"
    path.write_text("\n".join(lines))
    samples = read_text(path, "t.csv")
    assert len(samples) == 2
    assert samples.notes == ("t.csv: its last line is cut and left out",)
    path.write_text("\n".join([*lines, "0.3,3,0,0"]))
    with pytest.raises(RecordingError, match="line 4 has 2 columns instead of 4"):
        read_text(path, "t.csv")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("hello\nworld\n", "neither a bag nor a TUM or CSV file"),
        ("0,0,0,0\n1,1,1,1\n", "its first line has no names"), ("t,x,yaw\n", r"no column for y \("),
        ("tiem,x,y\n", r"no column for time \(did you mean tiem\?"), ("t,x,y,x\n", "'x' and 'x' could both be x"),
        ("Format Version,1.2\n,,Rigid Body\n", r"no column for time and x and y \("),
        ("t,x,y\n", "holds no line of numbers"), ("t,x,y\n0,1,one\n", "'one' in line 2 is not a number"),
        ("t,x,y\n1e30,1,1\n", "'1e30' in line 2 is not a stamp"), ("t,x,y\n1e999999999,1,1\n", "is not a stamp"),
        ("t,x,y\n1e300,1,1\n2,1,1\n3,1,1\n", "'1e300' in line 2 is not a stamp"),
        ("t,x,y\n1,1,1\n-1e300,1,1\n1e308,1,1\n", "'-1e300' in line 3 is not a stamp"),
        ("1e300 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n", "'1e300' in line 1 is not a stamp"),
        ("t,x,y\n,1,1\n", "is not a stamp"),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n", "12 numbers in line 1; KITTI poses have no stamps"),
        ("x" * 70_000, "more than 65536 characters"),
    ],
)  # fmt: skip
def test_text_that_is_no_trajectory_says_why(tmp_path, text, words):
    path = tmp_path / "t.csv"
    path.write_text(text)
    with pytest.raises(RecordingError, match=words):
        read_text(path, "t.csv")


def test_bags_are_no_text_whatever_their_name(tmp_path):
    write(tmp_path / "run.bag", topic("/odom", "Odometry", odometry(1.0)))
    disguised = (tmp_path / "run.bag").rename(tmp_path / "run.csv")
    assert not is_text(disguised)
    with pytest.raises(RecordingError, match=r"none\.csv: cannot be read: No such file"):
        is_text(tmp_path / "none.csv")


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


def test_a_copy_of_the_odometry_throttled_or_in_another_frame_is_no_truth_of_any_command(refused):
    moved = odometry()
    for command in ("fit", "diagnose", "learn"):
        said = refused(moved, moved, command=command)
        assert "/truth: repeats /odom (599 of 599 steps are equal): it is the same odometry" in said
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


def test_a_text_file_alone_asks_for_the_truth(tmp_path, capsys):
    moved = str(table(tmp_path / "odom.csv", odometry()))
    line = ending(["fit", moved], capsys)
    assert "a text file holds one trajectory; name the truth's with --truth-bag" in line
    line = ending(["fit", moved, "--truth-bag", moved, "--truth", "/gt"], capsys)
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
    one = str(table(tmp_path / "a.csv", odometry()))
    assert run(["fit", one, one, one, "--truth-bag", one, "--truth-bag", one]) == 2
    assert "2 --truth-bag for 3 recordings; name one for all, or one for each" in capsys.readouterr().err


def test_each_recording_and_each_held_out_one_has_the_truth_file_of_its_place(tmp_path):
    moved = table(tmp_path / "odom.csv", odometry())
    truths = [table(tmp_path / f"{name}.csv", truth()) for name in "abc"]
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
    moved = table(tmp_path / "odom.csv", odometry())
    model = tmp_path / "robot.toml"
    words = ["-v", "--truth-file", str(table(tmp_path / "gt.csv", truth())), "-o", str(model)]
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
