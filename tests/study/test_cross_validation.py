"""Models are validated on halves of their recordings, with any resets and stops."""

from dataclasses import replace

import numpy as np
import pytest
from hidden import as_recording

from odomcorrupt.cli import run as command
from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import between
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.report.comparison import comparison_text
from odomcorrupt.simulation import Segment, simulate, write_mcap
from odomcorrupt.study.estimate.calibrate import fit_robot
from odomcorrupt.study.estimate.intervals import intervals_of
from odomcorrupt.study.estimate.windows import distance_windows
from odomcorrupt.study.io import Source, read_runs
from odomcorrupt.study.validate.compare import compare
from odomcorrupt.study.validate.cross_validation import split_of

SECOND_NS = 1_000_000_000
LEG = (Segment(0.6, 0.0, 3.0), Segment(0.5, 0.6, 2.5), Segment(0.3, -0.5, 4.0), Segment(0.0, 0.8, 2.0))


def with_resets(run, *times_s):
    """The run as the driver says it that begins anew from zero at some times."""
    xyt = run.odom_xyt.copy()
    for at in np.searchsorted(run.odom_stamps_ns, run.odom_stamps_ns[0] + np.array(times_s) * SECOND_NS):
        xyt[at:] = between(xyt[at], xyt[at:])
    return replace(run, odom_xyt=xyt)


def read(folder, run):
    write_mcap(run, folder / "run.mcap")
    return read_runs(Source(folder / "run.mcap", track_m=run.track_m))


def judged(recordings):
    """The robot's model and its comparison on the very recordings, which are halved."""
    return compare(recordings, {"own": fit_robot(recordings, (), law_name="diffusion").model})


def names(comparison):
    return [piece.recording.name for piece in comparison.evaluations[0].pieces]


@pytest.fixture(scope="module")
def office():
    return simulate(21, None, duration_s=160.0)


@pytest.fixture(scope="module")
def whole(office, tmp_path_factory):
    return judged(read(tmp_path_factory.mktemp("whole"), office))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("resets_s", "pieces"),
    [
        ((30,), ["part 1, first half", "part 2, first half", "part 2, second half"]),
        ((80,), ["part 1, first half", "part 2, second half"]),
        ((60, 130), ["part 1, first half", "part 2, first half", "part 2, second half", "part 3, second half"]),
    ],
)
def test_a_run_with_resets_is_halved_as_one(tmp_path, office, whole, resets_s, pieces):
    recordings = read(tmp_path, with_resets(office, *resets_s))
    assert len(recordings) == len(resets_s) + 1
    for recording in recordings:
        # with the truth of its own time, and a little more for a clock that is off
        assert 0 <= recording.odometry.stamps_ns[0] - recording.truth.stamps_ns[0] < 3.1 * SECOND_NS
        assert 0 <= recording.truth.stamps_ns[-1] - recording.odometry.stamps_ns[-1] < 3.1 * SECOND_NS
    found = judged(recordings)
    told = [name.removeprefix("run.mcap ") for name in names(found)]
    assert told == pieces
    assert found.evaluations[0].judged_on == "folds"
    # windows of 10 s begin elsewhere, and there are a dozen
    assert found.evaluations[0].ten_second_error_m < 1.6 * whole.evaluations[0].ten_second_error_m
    assert found.evaluations[0].nats.per_m == pytest.approx(whole.evaluations[0].nats.per_m, rel=0.1)


@pytest.mark.slow
def test_learn_and_compare_read_a_drive_with_resets(tmp_path, office, capsys):
    bag, model = tmp_path / "run.mcap", tmp_path / "robot.toml"
    write_mcap(with_resets(office, 40, 110), bag)
    assert command(["learn", "-v", str(bag), "-o", str(model)]) == 0
    said = capsys.readouterr()
    assert "2 resets" in said.err
    assert "3 independent stretches used" in said.err
    assert command(["compare", str(bag), str(model)]) == 0
    assert command(["diagnose", str(bag)]) == 0


def test_a_truth_that_lasts_longer_than_the_odometry_is_halved_where_there_is_odometry(office):
    recording = as_recording(office)
    third = len(recording.odometry) // 3
    early = replace(
        recording, odometry=Trajectory(recording.odometry.stamps_ns[:third], recording.odometry.xyt[:third])
    )
    first, second = (fold.test[0] for fold in split_of([early], [True], 0.5).folds([early]))
    middle_s = (second.truth.stamps_ns[0] - early.odometry.stamps_ns[0]) * 1e-9
    assert middle_s == pytest.approx(160.0 / 6.0, abs=1.0)
    assert first.truth.stamps_ns[-1] < second.truth.stamps_ns[0]


@pytest.mark.slow
@pytest.mark.parametrize("first", [True, False])
def test_a_recording_that_mostly_stands_is_cut_at_half_of_its_way(first):
    stand = (Segment(0.0, 0.0, 170.0),)
    route = (*stand, *LEG * 4) if first else (*LEG * 4, *stand)
    found = judged([as_recording(simulate(22, None, duration_s=230.0, route=route))])
    (note,) = (note for note in found.evaluations[0].notes if "hardly moves" in note)
    assert f"hardly moves in the {'first' if first else 'second'} half of its time: cut at half of its way" in note
    metres = [piece.interval_metres.sum() for piece in found.evaluations[0].pieces]
    assert metres[0] == pytest.approx(metres[1], rel=0.1)
    assert found.evaluations[0].horizons


def test_a_usual_drive_is_cut_in_the_middle_of_its_time(office):
    recording = as_recording(office)
    cutting = split_of([recording], [True], 0.5)
    first, second = (fold.test[0] for fold in cutting.folds([recording]))
    assert abs(len(first.truth) - len(second.truth)) <= 1
    assert not cutting.notes


def test_folds_are_whole_recordings_and_a_refit_has_all_others(office):
    whole = as_recording(office)
    count = len(whole.truth)
    drives = [replace(whole, name=str(i), truth=whole.truth.only(slice(count - 500 * i))) for i in range(7)]
    fitted = [i != 3 for i in range(7)]
    folds = split_of(drives, fitted, 0.5).folds(drives)
    assert sorted(r.name for fold in folds for r in fold.test) == [r.name for r in drives]
    for fold in folds:
        own = {r.name for r in fold.test}
        assert {r.name for r in fold.train} == (set() if own == {"3"} else set("012456") - own)
        assert fold.inflation == 1.0 if own == {"3"} else 1.0 < fold.inflation < 1.5
    order = [4, 2, 6, 0, 3, 1, 5]
    shuffled = split_of([drives[i] for i in order], [fitted[i] for i in order], 0.5).folds([drives[i] for i in order])
    parts = [{frozenset(r.name for r in fold.test) for fold in some} for some in (folds, shuffled)]
    assert parts[0] == parts[1]


def test_a_run_too_short_for_a_fit_of_its_own_is_a_part_of_the_longest(office):
    whole = as_recording(office)
    short = replace(whole, name="short", truth=whole.truth.only(slice(500)))
    folds = split_of([whole, short], [True, True], 0.5).folds([whole, short])
    assert [len(fold.train) > 0 for fold in folds] == [True, True]
    assert all(
        {r.name for r in fold.train} == {f"{whole.name}, {half} half"}
        for fold, half in zip(folds, ("second", "first"), strict=True)
    )


def test_what_is_too_short_to_be_halved_is_evaluated_as_a_whole_and_said_so(office):
    long = as_recording(office, "short")
    short = replace(long, truth=Trajectory(long.truth.stamps_ns[:1500], long.truth.xyt[:1500]))
    cutting = split_of([short], [True], 0.5)
    assert "short: too short to be fitted on one half" in cutting.notes[0]
    assert "record longer" in cutting.notes[0]
    assert [(fold.test, fold.train) for fold in cutting.folds([short])] == [((short,), ())]


def test_a_model_of_a_drive_too_short_for_halves_is_judged_on_the_fitted_data_and_says_so(office):
    whole = as_recording(office, "short")
    short = replace(whole, truth=Trajectory(whole.truth.stamps_ns[:1500], whole.truth.xyt[:1500]))
    found = judged([short])
    assert found.judged_on == "fitted data"
    assert "on the fitted data" in comparison_text(found)
    assert any("too short to be fitted on one half" in note for note in found.evaluations[0].notes)


def test_a_recording_without_any_time_in_common_is_named(office):
    recording = as_recording(office, "late")
    late = Trajectory(recording.truth.stamps_ns + 1000 * SECOND_NS, recording.truth.xyt)
    with pytest.raises(RecordingError, match="late: odometry and truth overlap in 0 truth samples"):
        intervals_of(replace(recording, truth=late), 0.5)


def test_a_robot_that_stands_has_no_windows_of_distance():
    still = as_recording(simulate(23, None, duration_s=30.0, route=(Segment(0.0, 0.0, 30.0),)))
    frozen = replace(still, odometry=Trajectory(still.odometry.stamps_ns, np.zeros_like(still.odometry.xyt)))
    for phase in (0.0, 0.5):
        assert len(distance_windows(frozen, 1.0, phase)) == 0
