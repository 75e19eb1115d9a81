"""TUM and CSV files: headers are understood, stamps are exact, and other text is refused."""

import numpy as np
import pytest
from sourcebags import topic, write
from sourcedrive import START_NS, odometry, truth

from odomcorrupt.errors import RecordingError
from odomcorrupt.study.io import Source, read_runs
from odomcorrupt.study.io.text import is_text, read_text


def seconds(stamp_ns):
    return f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d}"


def tum(path, rows):
    lines = ["# timestamp tx ty tz qx qy qz qw"]
    for stamp, xyz, quat in zip(rows.stamps_ns.tolist(), rows.xyz.tolist(), rows.quat.tolist(), strict=True):
        lines.append(" ".join([seconds(stamp), *map(repr, xyz), *map(repr, quat)]))
    path.write_text("\n".join(lines) + "\n")
    return path


def table(path, rows, header, line):
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
