"""Causes outside the library: the regressor is named, the dependence is included, and the error falls."""

from dataclasses import replace

import numpy as np
import pytest
from hidden import as_recording, basis_dependences, ten_second_error
from wandering import RATE_HZ, recording, wander

from odomcorrupt.effects.compensation import error_of
from odomcorrupt.effects.expression import user_effect
from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.simulation import simulate, simulate_without
from odomcorrupt.simulation.faults import SIZES
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.regressors import driving_motion
from odomcorrupt.study.select.selection import learn
from odomcorrupt.study.terms.basis import basis_functions
from odomcorrupt.study.terms.channels import every_action, views
from odomcorrupt.study.terms.term import BasisTerm


def _fitted(seed: int, cause: str | None, **options):
    run = as_recording(simulate(seed, cause, duration_s=300.0, **options))
    return run, fit([run], approach=choose_approach([run]))


def _looked(seed: int, cause: str | None, **options):
    _, fitted = _fitted(seed, cause, **options)
    return basis_dependences(fitted)


def test_an_expression_of_numbers_alone_is_held_while_everything_else_is_fitted():
    run = as_recording(simulate(70, None, duration_s=120.0))
    fixed = user_effect("bend", "yaw += 0.01 * v", {})
    fitted = fit([run], [fixed], approach=choose_approach([run]))
    assert fitted.effects == (fixed,)
    assert len(fitted.standard_errors) == 0


def test_a_wheel_that_ran_backwards_only_in_turns_on_the_spot_was_not_seen_in_reverse():
    """Its error cannot be distinguished from an error of such turns; only a drive in reverse separates them."""
    motion = driving_motion(as_recording(simulate(70, None, duration_s=60.0)), "odometry")
    halting = np.maximum(np.abs(motion.v) - 0.2, 0.0)
    forwards, backwards = (replace(motion, v=sign * halting, omega=motion.omega + 0.5) for sign in (1.0, -1.0))
    assert views(forwards)["left"].v.min() < -0.02
    reverse = "k * where(v < -0.02, 1, 0)"
    assert reverse not in {function.text for function in basis_functions([forwards])}
    assert reverse in {function.text for function in basis_functions([backwards])}


@pytest.mark.slow
def test_a_wheel_that_scrubs_in_turns_to_one_side_is_found_as_such():
    reported, track_m = wander(315, 200.0), 0.4
    lost = (
        (reported.ds_m - 0.5 * track_m * reported.dtheta_rad) * 0.05 * np.maximum(-reported.dtheta_rad * RATE_HZ, 0.0)
    )
    driven = Increments(reported.ds_m - 0.5 * lost, reported.dl_m, reported.dtheta_rad + lost / track_m)
    run = recording(driven, accumulate(np.zeros(3), reported), truth_mm=1.0, truth_rad=0.001, seed=315)
    learned = learn([replace(run, track_m=track_m)])
    assert [effect.name for effect in learned.fit.effects] == ["left_over_yaw_rate"]
    assert "max(-omega, 0)" in learned.laws[0].expression


@pytest.mark.slow
def test_every_basis_function_says_in_its_expression_what_it_computes():
    motion = driving_motion(as_recording(simulate(73, None, duration_s=100.0)), "odometry")
    seen, checked = views(motion), set()
    for function in basis_functions([motion])[::6]:
        values = (0.3, -0.2)[: len(function.parts)]
        for action in (a for a in every_action() if not a.reaches.isdisjoint(function.reaches)):
            expected = np.zeros((len(motion), 3))
            for view, rates in action.rates(seen, motion.track_m):
                size = sum(k * part(seen[view]) for k, part in zip(values, function.parts, strict=True))
                expected -= size[:, None] * rates
            term = BasisTerm(function, action)
            f = error_of(term.effect(values), motion)
            # thresholds are written with four digits: a sample may fall between
            differs = np.abs(f - expected).max(axis=1) > 1e-3 * np.abs(expected).max() + 1e-12
            assert differs.mean() < 0.01, (function.text, action)
            words = {"heading": action.heading} if action.by_wheel else {}
            written = user_effect("written", term.expression(values), {}, words=words)
            assert np.allclose(error_of(written, motion), f, atol=1e-9)
            checked.add((function.text, action))
    assert len(checked) > 500
    assert {action for _, action in checked} == set(every_action())


def test_a_strip_is_refined_to_where_it_lies_wheel_by_wheel():
    run = simulate(79, "wet_strip", duration_s=300.0)
    recording = as_recording(run)
    fitted = fit([recording], approach=choose_approach([recording]))
    found = basis_dependences(fitted)[0]
    assert (found.regressor, found.wheels) == ("position", "wheels")
    strip = run.answer["parameters"]
    away = np.exp(-1j * strip["direction"]) * (
        run.truth_xyt[:, 0] - strip["x"] + 1j * (run.truth_xyt[:, 1] - strip["y"])
    )
    angle, x, y, half = found.term.function.shape
    found_away = np.cos(angle) * (run.truth_xyt[:, 0] - x) + np.sin(angle) * (run.truth_xyt[:, 1] - y)
    wet = np.abs(away.imag) < 0.5 * strip["width"]
    assert 0.02 < wet.mean() < 0.8
    assert np.mean(wet == (np.abs(found_away) < half)) > 0.97
    assert found.score.estimate[0] == pytest.approx(-strip["slip"], rel=0.15)


@pytest.mark.slow
def test_on_a_patch_where_one_wheel_slips_before_the_other_the_region_says_so():
    run = simulate(80, "wet_patch", duration_s=400.0)
    learned = learn([as_recording(run)])
    (patch,) = learned.fit.effects
    assert (patch.name, patch.contact) == ("region_slip", "wheels")
    assert patch.radius == pytest.approx(run.answer["parameters"]["radius"], rel=0.1)
    assert patch.slip == pytest.approx(run.answer["parameters"]["slip"], rel=0.1)


@pytest.mark.slow
def test_nothing_is_found_where_nothing_is_wrong():
    assert [_looked(seed, None) for seed in (74, 75, 76)] == [[], [], []]


def test_a_wheel_off_its_centre_is_found_by_its_wavelength():
    found = _looked(77, "eccentric_wheel")[0]
    assert (found.channel, found.regressor) == ("yaw", "distance")
    # radii are drawn between 70 and 120 mm
    assert 2.0 * np.pi * 0.07 < found.wavelength_m < 2.0 * np.pi * 0.12


def test_a_compass_that_iron_turns_shows_as_an_error_per_radian_over_the_heading():
    found = _looked(78, "magnetic_heading")[0]
    assert (found.channel, found.regressor, found.per) == ("yaw", "heading", "rad")
    assert "omega * (" in found.expression


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "cause", "channel", "driver"),
    [
        (82, "floor_grain", "across", "heading"),
    ],
)
def test_the_law_of_a_cause_that_no_library_has_brings_the_error_down(seed, cause, channel, driver):
    options = {"robot_seed": seed, "size": 2.0}
    learned = learn([as_recording(simulate(seed, cause, **options))])
    assert (learned.unknown[0].channel, learned.unknown[0].regressor) == (channel, driver)
    assert learned.laws == learned.unknown[:1]
    judged = as_recording(simulate(seed + 100, cause, duration_s=300.0, **options))
    floor = ten_second_error([as_recording(simulate_without(seed + 100, cause, duration_s=300.0, **options))])
    after = ten_second_error([judged], learned.fit.effects)
    assert after < 1.25 * floor
    assert ten_second_error([judged]) > 1.3 * floor


@pytest.mark.slow
def test_an_effect_that_does_not_last_leaves_room_for_what_it_imitated():
    # slip under acceleration was admitted, redundant once outliers were weighted again, and admitted again, six times
    run = simulate(191_407, ["braking_drag"], duration_s=600.0, size=SIZES["medium"], route="loops")
    learned = learn([as_recording(run)])
    assert not learned.added
    assert [(one.regressor, one.channel) for one in learned.laws] == [("acceleration", "along")]
