"""A model has to drift about as much as its own recordings, including outliers that its fit left out."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from wandering import noisy_path, recording, wander

from odomcorrupt.geometry.se2 import Increments, increments
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.report.comparison import reproduction_sentence
from odomcorrupt.report.diagnosis import reproduction_json
from odomcorrupt.study import pipeline
from odomcorrupt.study.estimate.calibrate import model_of
from odomcorrupt.study.estimate.config import Approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.outliers import slip_bursts
from odomcorrupt.study.validate.predictive_check import reproduction_of

QUIET = Coefficients(0.006, 0.003, 0.004, 0.0)


def drive(slips=(), *, excursion_m=0.0):
    """Return four minutes with slips of 15 degrees in a second, and a truth that is elsewhere for six seconds."""
    steps = wander(7, 240.0)
    turned = steps.dtheta_rad.copy()
    for at in slips:
        turned[at * 50 : at * 50 + 50] += np.radians(15.0) / 50.0
    run = recording(steps, noisy_path(steps, QUIET, 7), truth_mm=2.0, truth_rad=0.002, seed=7)
    true = run.truth.xyt.copy()
    true[100 * 50 : 106 * 50, 0] += excursion_m
    path = noisy_path(Increments(steps.ds_m, steps.dl_m, turned), QUIET, 7)
    return replace(run, odometry=replace(run.odometry, xyt=path), truth=replace(run.truth, xyt=true))


@pytest.fixture(scope="module")
def plain():
    return fit([drive()], approach=Approach())


@pytest.fixture(scope="module")
def slipped():
    return fit([drive((20, 60, 100, 140, 180, 220))], approach=Approach())


def test_a_model_that_holds_reproduces_the_drift_it_was_learned_from(plain):
    one = reproduction_of(plain, model_of(plain))
    assert one.holds
    assert one.drawn_m == pytest.approx(one.measured_m, rel=0.4)
    assert reproduction_sentence(one) == ""


def test_drift_is_compared_with_the_recording_as_it_was(plain):
    """The fit may have restored lost increments, which the model loses again."""
    run = drive()
    odometry = replace(run.odometry, xyt=run.odometry.xyt * [0.9, 0.9, 1.0])
    one = reproduction_of(plain, model_of(plain), [replace(run, odometry=odometry)], runs=2)
    assert one.measured_m > 1.5 * reproduction_of(plain, model_of(plain), runs=2).measured_m


def test_slips_that_a_robust_fit_left_out_are_missed(slipped):
    one = reproduction_of(slipped, model_of(slipped))
    assert one.too_small
    assert one.outliers == 6
    assert one.outlier_share > 0.8
    assert "6 stretches (" in reproduction_sentence(one)
    assert "slip_burst or push" in reproduction_sentence(one)
    assert reproduction_json(one)["holds"] is False


def test_a_model_that_draws_far_too_much_is_said_to(plain):
    wild = model_of(plain)
    wild = replace(wild, noise=replace(wild.noise, coefficients=Coefficients(0.1, 0.05, 0.08, 0.0)))
    one = reproduction_of(plain, wild)
    assert one.too_large
    assert "its noise is too large" in reproduction_sentence(one)


def test_errors_of_places_in_the_truth_that_were_taken_for_noise_show_in_the_long_run():
    """Beside the truth's own noise 10 s say nothing of a robot that is as good as the cameras' map."""
    t_s = np.arange(0.0, 480.0, 0.02)
    xy = np.column_stack((2.0 * np.cos(0.13 * t_s), 1.5 * np.sin(0.19 * t_s)))
    steps = increments(np.column_stack((xy, np.unwrap(np.arctan2(*np.gradient(xy, axis=0).T[::-1])))))
    path = noisy_path(steps, Coefficients(1e-4, 1e-4, 1e-4, 0.0), 7)
    run = recording(steps, path, truth_mm=4.0, truth_rad=5e-3, seed=7)
    xyt, places = run.truth.xyt.copy(), np.random.default_rng(2)
    waves, phases = places.normal(0.0, 1.4, (2, 40)), places.uniform(0.0, 2.0 * np.pi, (3, 40))
    xyt += [[5e-3, 5e-3, 3e-3]] * np.sum(np.cos((xyt[:, :2] @ waves)[:, None] + phases), axis=2) / np.sqrt(20.0)
    fitted = fit([replace(run, truth=replace(run.truth, xyt=xyt))], approach=Approach())
    one = reproduction_of(fitted, model_of(fitted))
    assert one.long is not None
    assert one.long.too_large
    assert one.drawn_m < 1.5 * one.measured_m
    assert "after a quarter of the drive (120 s), the recording" in reproduction_sentence(one)


def test_an_excursion_of_the_truth_alone_is_no_drift_of_the_robot():
    away = fit([drive(excursion_m=0.5)], approach=Approach())
    one = reproduction_of(away, model_of(away))
    assert one.holds
    assert one.outliers == 0


def spinning(slips, *, part=0.5, seconds=2.0, track_m=0.4):
    """Return two minutes on a floor where the right wheel spins now and then, so that it rolls a part less."""
    steps = wander(7, 120.0)
    ds, turned = steps.ds_m.copy(), steps.dtheta_rad.copy()
    for at in slips:
        inside = slice(round(at * 50), round((at + seconds) * 50))
        right = ds[inside] + turned[inside] * track_m / 2.0
        more = right * part / (1.0 - part)
        ds[inside] += more / 2.0
        turned[inside] += more / track_m
    run = recording(steps, noisy_path(steps, QUIET, 7), truth_mm=2.0, truth_rad=0.002, seed=7)
    path = noisy_path(Increments(ds, steps.dl_m, turned), QUIET, 7)
    return replace(run, odometry=replace(run.odometry, xyt=path), track_m=track_m)


AT = (7, 20, 33, 44, 58, 71, 85, 98, 110)


def test_a_model_with_bursts_slips_about_as_far_as_the_robot_did():
    fitted = fit([spinning(AT)], approach=Approach())
    bursts = slip_bursts(fitted)
    assert bursts is not None
    assert reproduction_of(fitted, model_of(fitted)).too_small
    assert reproduction_of(fitted, model_of(fitted, [bursts]), runs=5).holds


def test_bursts_that_are_too_short_to_see_are_not_made_too_strong():
    fitted = fit([spinning(AT, part=0.4, seconds=0.25)], approach=Approach())
    bursts = slip_bursts(fitted)
    assert bursts is not None
    assert bursts.duration == pytest.approx(0.25)
    assert bursts.slip == pytest.approx(0.4, rel=0.5)
    assert reproduction_of(fitted, model_of(fitted, [bursts]), runs=5).holds


@dataclass(frozen=True)
class Search:
    noise: tuple
    fit: SimpleNamespace


@pytest.mark.parametrize(("with_it", "without", "left"), [("far", "near", 1), ("far", "far", 2), ("near", "near", 2)])
def test_a_process_that_drifts_too_far_is_dropped_if_the_model_drifts_as_far_as_the_recordings_without(
    monkeypatch, with_it, without, left
):
    noise = tuple(
        SimpleNamespace(effect=SimpleNamespace(name=name, kind="noise")) for name in ("quantization", "gauss_markov")
    )
    search = Search(noise, SimpleNamespace(refit=lambda random: SimpleNamespace(random=random)))

    def written(own, _recordings):
        drift = with_it if len(own.noise) == 2 else without
        return None, None, SimpleNamespace(too_large=drift == "far", holds=drift == "near")

    monkeypatch.setattr(pipeline, "_written", written)
    kept, _, said = pipeline._without_excess(search, [])
    assert (kept.noise, len(said)) == (noise[:left], 2 - left)
