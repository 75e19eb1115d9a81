"""Several recordings are one study: neither names nor order decide, and an unusable one is left out by its name."""

from dataclasses import replace

import numpy as np
import pytest
from wandering import noisy_path, recording, wander

from odomcorrupt.api.recordings import recording_paths
from odomcorrupt.effects import effect_from_values
from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.simulation import simulate, write_mcap
from odomcorrupt.study.estimate.calibrate import fit_robot
from odomcorrupt.study.estimate.clocks import find_clocks
from odomcorrupt.study.estimate.config import Approach
from odomcorrupt.study.io import Source
from odomcorrupt.study.io.reader import one_study, read_study
from odomcorrupt.study.io.recording import shared_frame, was_fitted
from odomcorrupt.study.validate.compare import compare

QUIET = Coefficients(0.004, 0.004, 0.002, 0.001)
SCALE, WIDE = 1.03, 1.05


def drive(seed, kind, seconds=40.0):
    """Return a drive whose odometry goes and turns too far: straight ahead only, on the spot only, or both."""
    steps = wander(seed, seconds)
    steps = {
        "straight": Increments(steps.ds_m, steps.dl_m, 0.0 * steps.dtheta_rad),
        "spot": Increments(0.0 * steps.ds_m, steps.dl_m, steps.dtheta_rad),
        "both": steps,
    }[kind]
    said = Increments(SCALE * steps.ds_m, steps.dl_m, WIDE * steps.dtheta_rad)
    run = recording(said, noisy_path(said, QUIET, seed), seed=seed)
    noise = np.random.default_rng(seed).normal(0.0, [0.002, 0.002, 0.003], (len(steps) + 1, 3))
    true = accumulate(np.zeros(3), steps) + noise
    return replace(run, name=f"{kind} {seed}", truth=Trajectory(run.odometry.stamps_ns, true))


@pytest.fixture(scope="module")
def drives():
    return [drive(1, "straight"), drive(2, "spot"), drive(3, "straight"), drive(4, "spot"), drive(5, "both")]


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
    assert not was_fitted(model, replace(drive(6, "both"), name=drives[4].name))


@pytest.mark.slow
def test_a_recording_cut_in_two_has_one_clock_and_the_same_errors(drives, model):
    whole = drives[4]
    rows = len(whole.odometry) // 2
    parts = [
        replace(
            whole,
            name=str(i),
            odometry=whole.odometry.only(own),
            truth=whole.truth.only(own),
            origin_ns=int(whole.odometry.stamps_ns[own][0]),
        )
        for i, own in enumerate((slice(rows), slice(rows, None)))
    ]
    study = one_study([parts[1], *drives[:4], parts[0]])
    clocks = {r.name: (r.clock, r.origin_ns) for r in study}
    assert clocks["0"] == clocks["1"]
    assert all(not clocks[r.name][0] for r in drives[:4])
    found, cut = compare(drives, {"learned": model}), compare(study, {"learned": model})
    assert cut.judged_on == "folds"
    # windows of 10 s begin elsewhere
    assert error_m(cut) == pytest.approx(error_m(found), rel=0.15)


def test_a_recording_whose_clock_cannot_be_told_has_that_of_the_others(drives):
    offset_ns = 80_000_000
    late = [replace(r, odometry=Trajectory(r.odometry.stamps_ns + offset_ns, r.odometry.xyt)) for r in drives]
    late = [replace(r, origin_ns=int(r.odometry.stamps_ns[0])) for r in late]
    short = replace(late[4], name="short", truth=late[4].truth.only(slice(0, 300)))
    clocks = find_clocks([*late, short], Approach())
    assert clocks.held == ("short",)
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
