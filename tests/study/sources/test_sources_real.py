"""Public recordings are read without false alarms, and their peculiarities are reported."""

from dataclasses import replace

import numpy as np
import pytest

from odomcorrupt.errors import OdomCorruptError
from odomcorrupt.study.io import Source, read_runs, reader
from recordings import RECORDINGS

HALL = RECORDINGS / "real" / "tuc_lecture_hall.mcap"  # its truth jumps every half minute
REAL = sorted(set((RECORDINGS / "real").glob("*.mcap")) - {HALL})

pytestmark = pytest.mark.recordings


@pytest.mark.parametrize("path", REAL, ids=lambda path: path.stem)
def test_every_real_recording_is_one_run_with_nothing_cut_and_says_so_when_its_truth_is_mirrored(path, monkeypatch):
    odometry, truth = reader._read(Source(path))

    def runs(seen):
        monkeypatch.setattr(reader, "_read", lambda _: (odometry, seen))
        return read_runs(Source(path))

    (recording,) = runs(truth)
    assert not recording.mistakes
    assert np.isnan(recording.truth.xyt[:, 2]).all() == path.stem.startswith("plaza")
    said = " ".join(recording.notes)
    assert not any(word in said for word in ("outlier", "reset", "jump", "filter", "set back", "headings turn exactly"))
    assert ("a simulation without noise" in said) == path.stem.startswith("rob521")
    (mirrored, *_) = runs(replace(truth, frame="", xyz=truth.xyz * [1.0, -1.0, 1.0], yaw_rad=-truth.yaw_rad))
    assert [one.name for one in mirrored.mistakes] == ["left and right exchanged"]


def test_a_truth_that_jumps_is_cut_into_stretches_and_every_jump_is_said():
    recordings = read_runs(Source(HALL))
    said = " ".join(recordings[0].notes)
    assert "50 jumps that last" in said
    assert f"{len(recordings)} independent stretches used" in said
    starts, ends = zip(*((r.truth.stamps_ns[0], r.truth.stamps_ns[-1]) for r in recordings), strict=True)
    assert all(start > end for start, end in zip(starts[1:], ends[:-1], strict=True))


@pytest.mark.parametrize(
    ("name", "asked", "said"),
    [
        ("evo/nav2_turtlebot.mcap", {"truth": "/tf:map.base_link"}, "the truth is taken at its 133 corrections alone"),
        ("evo/nav2_turtlebot.mcap", {}, "/amcl_pose: it is a localisation by its name"),
        ("evo/nav2_turtlebot.mcap", {}, "/odom: a gap of 1.8 s"),
        ("robot_localization/test1.bag", {}, "/fix: metres east and north of its first fix"),
    ],
)
def test_bags_as_found_say_what_is_odd_about_them(name, asked, said):
    (recording,) = read_runs(Source(RECORDINGS / "bags" / name, **asked))
    assert any(said in note for note in recording.notes)


@pytest.mark.parametrize(
    ("name", "asked", "words"),
    [
        ("olin_tb4/macfirst_floor_take_2", {"truth": "/tf:odom.base_footprint"}, "it is the same odometry"),
        ("evo/tf_example.bag", {"odom": "/tf:odom.base_link", "truth": "/tf:odom.base_footprint"}, "the same odometry"),
        ("evo/tf_example", {"odom": "/tf:odom.base_link", "truth": "/tf:odom.base_footprint"}, "the same odometry"),
        ("polimi/bag1.bag", {}, r"no topic that could be odometry \(found /robot/pose"),
        ("malformed/unindexed.bag", {}, "not indexed"),
    ],
)
def test_bags_that_hold_no_run_say_why(name, asked, words):
    with pytest.raises(OdomCorruptError, match=words):
        read_runs(Source(RECORDINGS / "bags" / name, **asked))


def test_a_bag_of_three_compressions_gives_one_trajectory():
    """Foxglove's turtles: the old tf/tfMessage type; one turtle's way as seen from the other."""
    ways = []
    for name in ("example", "example-lz4", "example-bz2"):
        from odomcorrupt.study.io.bag import read_bag

        path = RECORDINGS / "bags" / "foxglove_turtlesim" / f"{name}.bag"
        ways.append(read_bag(path, name, {"truth": "/tf:turtle1.turtle2"})["truth"])
    assert len(ways[0]) > 500
    for way in ways[1:]:
        assert np.array_equal(way.stamps_ns, ways[0].stamps_ns)
        assert np.array_equal(way.xyz, ways[0].xyz)
