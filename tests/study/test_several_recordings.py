"""Several recordings are one study with effects and noise in common; their halves are held out."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hidden import as_recording
from wandering import drive, late, noisy_path, recording, scaled, wander

from odomcorrupt.api.recordings import recording_paths
from odomcorrupt.effects import effect_from_values
from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import Increments, between, compose
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.motion_model import MotionModel, Noise, Setup, TruthNoise
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.report.comparison import comparison_text
from odomcorrupt.report.findings import _disagreement_line
from odomcorrupt.simulation import Segment, simulate, write_mcap
from odomcorrupt.study.estimate.calibrate import fit_robot
from odomcorrupt.study.estimate.clocks import find_clocks
from odomcorrupt.study.estimate.config import Approach, choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.intervals import intervals_of
from odomcorrupt.study.io import Source, read_runs
from odomcorrupt.study.io.reader import one_study, read_study
from odomcorrupt.study.io.recording import shared_frame, was_fitted
from odomcorrupt.study.select.heterogeneity import disagreements
from odomcorrupt.study.select.selection import learn
from odomcorrupt.study.validate.compare import compare
from odomcorrupt.study.validate.cross_validation import split_of

SCALE, WIDE = 1.03, 1.05


def of_kind(seed, kind):
    """Return a drive whose odometry goes and turns too far: straight ahead only, on the spot only, or both."""
    travel, turn = {"straight": (1.0, 0.0), "spot": (0.0, 1.0), "both": (1.0, 1.0)}[kind]
    said = scaled(SCALE * travel, WIDE * turn)
    run = drive(seed, 40.0, said=said, driven=scaled(travel, turn), truth_mm=2.0)
    return replace(run, name=f"{kind} {seed}")


@pytest.fixture(scope="module")
def drives():
    return [of_kind(*one) for one in ((1, "straight"), (2, "spot"), (3, "straight"), (4, "spot"), (5, "both"))]


@pytest.fixture(scope="module")
def model(drives):
    effects = [effect_from_values(name, {}) for name in ("wheel_scale", "wheelbase")]
    return fit_robot(drives, effects, law_name="diffusion").model


def error_m(comparison):
    return comparison.evaluations[-1].ten_second_error_m


@pytest.mark.slow
def test_drives_that_each_show_one_effect_cross_validate_the_model_of_all_of_them(drives, model):
    kept = replace(model, source={})
    found = compare(drives, {"without effects": replace(model, effects=()), "kept": kept, "refitted": model})
    assert [one.judged_on for one in found.evaluations] == ["folds", "recordings", "folds"]
    without, kept_m, refitted_m = (one.ten_second_error_m for one in found.evaluations)
    assert refitted_m < 1.05 * kept_m < 0.7 * without


@pytest.mark.slow
def test_neither_names_nor_order_of_recordings_decide_about_a_model(drives, model):
    drives = drives[2:]
    found = compare(drives, {"learned": model})
    renamed = compare([replace(r, name=f"copy {i}") for i, r in enumerate(drives)], {"learned": model})
    shuffled = compare([drives[i] for i in (2, 0, 1)], {"learned": model})
    for other in (renamed, shuffled):
        assert other.judged_on == found.judged_on == "folds"
        assert error_m(other) == pytest.approx(error_m(found), rel=1e-6)
        assert other.evaluations[0].nats.per_m == pytest.approx(found.evaluations[0].nats.per_m, rel=1e-6)
        assert other.evaluations[0].verdict.fails == found.evaluations[0].verdict.fails


def test_a_part_of_a_fitted_recording_is_known_as_fitted_and_another_drive_is_not(drives, model):
    odometry = drives[4].odometry
    for rows in (slice(len(odometry) // 2), slice(len(odometry) // 2, None)):
        assert was_fitted(model, replace(drives[4], name="part", odometry=odometry.only(rows)))
    assert not was_fitted(model, replace(of_kind(6, "both"), name=drives[4].name))


@pytest.mark.slow
def test_a_recording_cut_in_two_has_one_clock_and_the_same_errors(drives, model):
    whole = drives[4]
    rows = len(whole.odometry) // 2
    parts = []
    for i, own in enumerate((slice(rows), slice(rows, None))):
        odometry, truth = whole.odometry.only(own), whole.truth.only(own)
        parts.append(replace(whole, name=str(i), odometry=odometry, truth=truth, origin_ns=int(odometry.stamps_ns[0])))
    study = one_study([parts[1], *drives[:4], parts[0]])
    clocks = {r.name: (r.clock, r.origin_ns) for r in study}
    assert clocks["0"] == clocks["1"]
    assert all(not clocks[r.name][0] for r in drives[:4])
    found, cut = compare(drives, {"learned": model}), compare(study, {"learned": model})
    assert cut.judged_on == "folds"
    # windows of 10 s begin elsewhere
    assert error_m(cut) == pytest.approx(error_m(found), rel=0.15)


def test_a_recording_that_does_not_determine_its_clock_has_that_of_the_others(drives):
    moved = [late(r, 0.08) for r in drives]
    short = replace(moved[4], name="short", truth=moved[4].truth.only(slice(0, 300)))
    clocks = find_clocks([*moved, short], Approach())
    assert clocks.clocks[-1].offset_s == pytest.approx(0.08, abs=0.02)
    assert clocks.free[-1] == (False, False)


def test_an_unusable_recording_of_several_is_left_out_by_its_name_and_alone_it_is_refused(tmp_path):
    for name, seconds in (("good.mcap", 60.0), ("brief.mcap", 4.0)):
        write_mcap(simulate(3, None, duration_s=seconds), tmp_path / name)
    brief, good = (Source(path) for path in recording_paths(tmp_path))
    found = read_study([brief, good])
    assert [r.name for r in found] == ["good.mcap"]
    assert any("left out" in alert and "brief.mcap" in alert for alert in found[0].alerts)
    with pytest.raises(RecordingError, match=r"brief\.mcap"):
        read_study([brief])


def test_a_folder_a_pattern_and_a_list_name_the_same_recordings(tmp_path):
    names = ["a.mcap", "b.mcap"]
    for name in (*names, "notes.txt"):
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "both.list").write_text("# runs\nb.mcap\n\na.mcap\n")
    wanted = [tmp_path / name for name in names]
    assert recording_paths(tmp_path) == wanted
    assert recording_paths(str(tmp_path / "*.mcap")) == wanted
    assert recording_paths(tmp_path / "both.list") == wanted[::-1]
    assert recording_paths([tmp_path / "a.mcap"]) == wanted[:1]
    with pytest.raises(RecordingError, match="names no recording"):
        recording_paths(tmp_path / "*.bag")


def test_runs_that_each_begin_at_zero_share_no_place(drives):
    zeroed = [replace(r, truth=Trajectory(r.truth.stamps_ns, r.truth.xyt - r.truth.xyt[0])) for r in drives]
    assert shared_frame(one_study(zeroed)) is None
    assert shared_frame(one_study(drives)) == ""
    assert shared_frame(one_study(zeroed[:1])) == ""


LOUD = Coefficients(0.01, 0.006, 0.008, 0.0)
WIDER, LONGER = 1.04, 1.02


def run_of(seed, *, truth_m, truth_rad, offset_s=0.0, frame=(0.0, 0.0, 0.0), seconds=240.0):
    """Return a drive of the robot whose odometry goes and turns too far, with a truth and a clock of its own."""
    said = scaled(LONGER, WIDER)
    run = drive(seed, seconds, LOUD, said=said, truth_mm=1e3 * truth_m, truth_rad=truth_rad)
    return late(replace(run, truth=replace(run.truth, xyt=compose(np.array(frame), run.truth.xyt))), offset_s)


@pytest.mark.slow
def test_a_coarse_truth_beside_a_good_one_neither_adds_noise_to_the_robot_nor_takes_its_information():
    good = run_of(1, truth_m=0.002, truth_rad=0.002, offset_s=0.04)
    coarse = run_of(2, truth_m=0.04, truth_rad=0.03, offset_s=-0.6, frame=(30.0, -12.0, 2.0))
    effects = [effect_from_values(name, {}) for name in ("wheel_scale", "wheelbase")]
    alone, both = (fit_robot(runs, effects, law_name="diffusion") for runs in ([good], [good, coarse]))
    assert both.clocks.clocks[0].offset_s == pytest.approx(0.04, abs=0.005)
    assert both.clocks.clocks[1].offset_s == pytest.approx(-0.6, abs=0.05)
    found = {effect.name: effect for effect in both.model.effects}
    errors = both.model.standard_errors
    assert found["wheel_scale"].e == pytest.approx(1.0 / LONGER - 1.0, abs=4.0 * errors["wheel_scale.e"])
    for name in ("wheel_scale.e", "wheelbase.e"):
        assert errors[name] < 1.05 * alone.model.standard_errors[name]
    for name in ("rot_rot", "rot_trans", "trans_trans"):
        value, error = getattr(both.model.noise.coefficients, name), errors[name]
        assert value == pytest.approx(getattr(LOUD, name), abs=4.0 * error)
        # nodes lie as far apart as the coarse truth wants them
        assert error < 1.4 * alone.model.standard_errors[name]
    assert both.model.setup.truth.xy_m == pytest.approx(0.002, rel=0.2)


@pytest.mark.slow
def test_a_held_out_recording_is_judged_with_its_own_truth_and_a_clock_found_with_the_model_applied():
    runs = {}
    for name, offset_s in (("on time", 0.0), ("late", -1.377)):
        run = drive(8, 200.0, LOUD, said=scaled(turn=3.0), truth_mm=10.0, truth_rad=0.01)
        runs[name] = late(replace(run, name=name), offset_s)
    effect = effect_from_values("wheelbase", {"e": 2.0})
    model = MotionModel(Noise("diffusion", LOUD), (effect,), setup=Setup(truth=TruthNoise(0.001, 0.001, 0.0)))
    errors = {name: compare([run], {"model": model}) for name, run in runs.items()}
    assert errors["late"].clocks.clocks[0].offset_s == pytest.approx(-1.377, abs=0.03)
    on_time_m, late_m = (errors[name].evaluations[0].ten_second_error_m for name in ("on time", "late"))
    assert late_m < 1.1 * on_time_m
    for compared in errors.values():
        assert compared.evaluations[0].pieces[0].truth.xy_m == pytest.approx(0.01, rel=0.2)
        assert any("was weighted accordingly" in note for note in compared.evaluations[0].notes)


SECOND_NS = 1_000_000_000
LEG = (Segment(0.6, 0.0, 3.0), Segment(0.5, 0.6, 2.5), Segment(0.3, -0.5, 4.0), Segment(0.0, 0.8, 2.0))


def with_resets(run, *times_s):
    """The run as a driver reports it that restarts from zero at some times."""
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
        ((60, 130), ["part 1, first half", "part 2, first half", "part 2, second half", "part 3, second half"]),
    ],
)
def test_a_run_with_resets_is_halved_as_one(tmp_path, office, whole, resets_s, pieces):
    recordings = read(tmp_path, with_resets(office, *resets_s))
    assert len(recordings) == len(resets_s) + 1
    for part in recordings:
        # with the truth of its own time, and a little more for a clock that is off
        assert 0 <= part.odometry.stamps_ns[0] - part.truth.stamps_ns[0] < 3.1 * SECOND_NS
        assert 0 <= part.truth.stamps_ns[-1] - part.odometry.stamps_ns[-1] < 3.1 * SECOND_NS
    found = judged(recordings)
    parts = [name.removeprefix("run.mcap ") for name in names(found)]
    assert parts == pieces
    assert found.evaluations[0].judged_on == "folds"
    # windows of 10 s begin elsewhere, and there are a dozen
    assert found.evaluations[0].ten_second_error_m < 1.6 * whole.evaluations[0].ten_second_error_m
    assert found.evaluations[0].nats.per_m == pytest.approx(whole.evaluations[0].nats.per_m, rel=0.1)


def test_a_truth_that_lasts_longer_than_the_odometry_is_halved_where_there_is_odometry(office):
    recording = as_recording(office)
    early = replace(recording, odometry=recording.odometry.only(slice(len(recording.odometry) // 3)))
    first, second = (fold.test[0] for fold in split_of([early], [True], 0.5).folds([early]))
    ways_m = [
        np.hypot(*np.diff(half.truth.xyt[half.within_odometry, :2][::20], axis=0).T).sum() for half in (first, second)
    ]
    assert ways_m[0] == pytest.approx(ways_m[1], rel=0.1)
    assert first.truth.stamps_ns[-1] < second.truth.stamps_ns[0]


@pytest.mark.slow
def test_a_recording_that_mostly_stands_is_cut_at_half_of_its_way():
    route = (Segment(0.0, 0.0, 170.0), *LEG * 4)
    found = judged([as_recording(simulate(22, None, duration_s=230.0, route=route))])
    metres = [piece.interval_metres.sum() for piece in found.evaluations[0].pieces]
    assert metres[0] == pytest.approx(metres[1], rel=0.1)
    assert found.evaluations[0].horizons


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


def test_a_model_of_a_drive_too_short_for_halves_is_judged_on_the_fitted_data_and_says_so(office):
    whole = as_recording(office, "short")
    short = replace(whole, truth=whole.truth.only(slice(1500)))
    found = judged([short])
    assert found.judged_on == "fitted data"
    assert "on the fitted data" in comparison_text(found)
    assert any("too short to be fitted on one half" in note for note in found.evaluations[0].notes)


def test_a_recording_without_any_time_in_common_is_named(office):
    recording = as_recording(office, "late")
    early = late(recording, -1000.0)
    with pytest.raises(RecordingError, match="late: odometry and truth overlap in 0 truth samples"):
        intervals_of(early, 0.5)


NOISE = Coefficients(0.01, 0.01, 0.01, 0.005)


def loaded(seed, *, scale=0.0, bias=0.0):
    """Return the same drive with other noise: true wheels larger than said, and an odometry that turns too fast."""
    reported = wander(801, 200.0)
    driven = Increments(
        reported.ds_m * (1.0 + scale),
        reported.dl_m,
        reported.dtheta_rad * (1.0 + scale) - bias / 50.0 * np.ones(len(reported)),
    )
    return replace(recording(driven, noisy_path(reported, NOISE, seed), truth_mm=1.0, seed=seed), track_m=0.4)


def test_recordings_of_two_groups_are_named_with_what_their_driving_has_in_common():
    drives = [loaded(801 + i, scale=-0.012 * (i % 2)) for i in range(4)]
    # the loaded robot is driven at half the speed
    slow = [replace(r, odometry=slower(r.odometry), truth=slower(r.truth)) for r in drives[1::2]]
    approach = choose_approach(drives, "diffusion")
    (one,) = (
        d for d in disagreements(fit([*drives[::2], *slow], approach=approach), 1e-3) if d.effect == "wheel_scale"
    )
    difference, smaller, larger = one.groups
    assert difference == pytest.approx(0.012, abs=0.003)
    assert (smaller, larger) == (["drive 802", "drive 804"], ["drive 801", "drive 803"])
    said = _disagreement_line(one, SimpleNamespace(noise=()))
    assert "% larger in drive 801, drive 803 than in drive 802, drive 804). The" in said
    assert replace(one, values=(0.0, 0.004, 0.008, 0.012)).groups is None


def slower(path):
    return Trajectory(path.stamps_ns[0] + 2 * (path.stamps_ns - path.stamps_ns[0]), path.xyt)


@pytest.mark.slow
def test_recordings_of_one_robot_agree():
    assert learn([loaded(seed, scale=0.01) for seed in (805, 806)]).disagreements == ()


@pytest.mark.slow
def test_what_is_learned_depends_neither_on_names_nor_on_order_of_recordings(drives):
    found = learn(drives)
    assert {effect.name for effect in found.fit.effects} >= {"wheel_scale", "wheelbase"}
    other = learn([replace(drives[i], name=f"copy {i}") for i in (3, 0, 4, 2, 1)])
    both = [one.fit.effects for one in (found, other)]
    sizes = [{(e.name, p.name): getattr(e, p.name) for e in effects for p in amplitudes(e)} for effects in both]
    assert sizes[1] == pytest.approx(sizes[0], rel=1e-4)
    assert other.held_out == {name: pytest.approx(gain, rel=1e-3) for name, gain in found.held_out.items()}
