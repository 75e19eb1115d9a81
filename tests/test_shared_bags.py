"""Bags as other people recorded them: each goes through or is refused with the line that helps.

They lie beside the repository, in ../shared/data/bags; without that folder these tests are skipped and say so. What is
in a bag, before and after, is told by the rosbags library, and then by ROS 1's own rosbag and by @mcap/core.
"""

import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.typesys import Stores, get_typestore

from odomcorrupt.cli import run
from recordings import RECORDINGS

sys.path.append(str(Path(__file__).parent / "hostile"))

from foreign import READERS, Output, asked, expected, missing

BAGS = RECORDINGS / "bags"

TYPES = get_typestore(Stores.LATEST)


@dataclass(frozen=True)
class Through:
    """A bag that goes through: the topics that may change, and how the summary begins."""

    path: str
    moved: frozenset[str]
    said: str
    args: tuple[str, ...] = ()


@dataclass(frozen=True)
class Refused:
    """A bag that is refused, and what the one line says."""

    path: str
    said: str
    args: tuple[str, ...] = ()


EXAMPLE = ("--odom-frame", "odom", "--base-frame", "base_footprint")
THROUGH = (
    *(
        Through(
            f"robot_localization/{bag}.bag",
            frozenset({f"/{robot}_velocity_controller/odom"}),
            f"odometry  /{robot}_velocity_controller/odom {count}, no transform from odom",
        )
        for bag, robot, count in (("test1", "husky", 3952), ("test2", "jackal", 3060))
    ),
    Through(
        "evo/nav2_turtlebot.mcap",
        frozenset({"/odom", "/tf"}),
        "odometry  /odom 2639, TF odom -> base_link 2639, computed from the poses of /odom",
    ),
    *(
        Through(
            f"evo/tf_example{file}",
            frozenset({"/tf"}),
            "odometry  TF odom -> base_footprint 517, computed from the poses of TF odom -> base_footprint",
            EXAMPLE,
        )
        for file in (".bag", "", "/tf_example.db3")
    ),
    *(
        Through(
            f"foxglove_turtlesim/example{codec}.bag",
            frozenset({"/tf"}),
            "odometry  TF world -> turtle1 1344, TF world -> turtle2 1344",
            ("--odom-frame", "world", "--base-frame", "turtle1"),
        )
        for codec in ("", "-lz4", "-bz2")
    ),
    *(
        Through(
            f"olin_tb4/macfirst_floor_take_2{file}",
            frozenset({"/odom", "/tf"}),
            "odometry  /odom 920, TF odom -> base_footprint 953, TF odom -> base_link 953",
        )
        for file in ("", "/macfirst_floor_take_2_0.db3")
    ),
)

REFUSED = (
    Refused("evo/tf_example.bag", "no nav_msgs/Odometry topic (found /tf, /tf_static); to corrupt TF alone, name its"),
    Refused("evo/tf_example", "no nav_msgs/Odometry topic (found /tf, /tf_static); to corrupt TF alone, name its"),
    Refused("foxglove_turtlesim/example.bag", "to corrupt TF alone, name its edge with --odom-frame and --base-frame"),
    Refused(
        "foxglove_turtlesim/example.bag", "(TF has turtle1 -> ", ("--odom-frame", "odom", "--base-frame", "base_link")
    ),
    Refused("polimi/bag1.bag", "no nav_msgs/Odometry topic (found /robot/pose, /wheel_states); there is nothing to"),
    Refused("malformed/unindexed.bag", "is not indexed, its recording was never closed; --recover reads it"),
    Refused("olin_tb4", "is a directory without a bag in it"),
    Refused("maps/depot.yaml", "which is not an MCAP, a ROS 1 bag or a ROS 2 bag"),
)


def messages(path):
    """Return (topic, log time, bytes) of every message, as the rosbags library reads them."""
    # AnyReader refuses a bag for one incomplete definition
    one = Ros1Reader(path) if path.suffix == ".bag" else AnyReader([path], default_typestore=TYPES)
    with one as reader:
        return sorted((c.topic, time_ns, bytes(data)) for c, time_ns, data in reader.messages())


@pytest.fixture
def corrupt(tmp_path, capsys):
    """Corrupt a bag of that folder; return exit code, what was said, and the output."""

    def call(path, *args):
        target = tmp_path / Path(path).name
        code = run([str(BAGS / path), str(target), "-v", "--seed", "7", *args])
        return code, capsys.readouterr().err, target

    return call


@pytest.mark.recordings
def test_every_bag_of_the_folder_is_tried():
    found = {path.relative_to(BAGS).as_posix() for kind in ("bag", "mcap", "db3") for path in BAGS.rglob(f"*.{kind}")}
    assert found == {case.path for case in (*THROUGH, *REFUSED)} & found


@pytest.mark.recordings
@pytest.mark.parametrize("case", THROUGH, ids=lambda case: case.path)
def test_it_goes_through_and_what_is_not_moved_is_bit_identical(corrupt, case):
    code, said, target = corrupt(case.path, *case.args)
    assert code == 0
    assert case.said in said
    before, after = messages(BAGS / case.path), messages(target)
    assert Counter((topic, time_ns, len(data)) for topic, time_ns, data in before) == Counter(
        (topic, time_ns, len(data)) for topic, time_ns, data in after
    )
    assert [m for m in before if m[0] not in case.moved] == [m for m in after if m[0] not in case.moved]
    changed = {topic for topic, _, _ in set(after) - set(before)}
    assert changed == case.moved


@pytest.mark.recordings
@pytest.mark.parametrize("case", REFUSED, ids=lambda case: case.path)
def test_it_is_refused_in_one_line_and_leaves_nothing(corrupt, case, tmp_path):
    code, said, _ = corrupt(case.path, *case.args)
    assert code == 1
    assert said.startswith(f"odomcorrupt: {BAGS / case.path.split('/')[0]}")
    assert case.said in said
    assert said.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.recordings
def test_the_bag_that_was_never_closed_is_read_on_request(corrupt):
    code, said, target = corrupt("malformed/unindexed.bag", "--recover")
    assert code == 0, "nothing is lost: all its chunks are whole"
    assert "odometry  odom_est 608" in said
    assert len([topic for topic, _, _ in messages(target) if topic == "odom_est"]) == 608


def sources(*suffixes):
    """Return the bags of that kind and their options; `tests/hostile/foreign.py` has our own in every compression."""
    return [pytest.param(BAGS / c.path, c.args, id=c.path) for c in THROUGH if c.path.endswith(suffixes)]


def require_counted(reader, kind, source, target, args):
    """Require that a program of other people counts the messages of a source in what we make of it."""
    (one,) = (each for each in READERS if each.name == reader)
    if said := missing(one):
        pytest.skip(f"{reader}: {said}")
    assert run([str(source), str(target), "--seed", "7", *args]) == 0
    assert expected(Output("", target, kind))["counts"] == Counter(topic for topic, _, _ in messages(source))
    assert asked(one, Output("", target, kind)) == ""


@pytest.mark.recordings
@pytest.mark.parametrize(("source", "args"), sources(".bag"))
def test_ros_1_itself_counts_the_same_messages(tmp_path, source, args):
    require_counted("Debian rosbag", "ros1", source, tmp_path / "out.bag", args)


@pytest.mark.recordings
@pytest.mark.parametrize(("source", "args"), sources(".mcap", ".bag"))
def test_mcaps_own_reader_counts_the_same_messages(tmp_path, source, args):
    require_counted("@mcap/core", "mcap", source, tmp_path / "out.mcap", args)
