"""Exported numbers do what the model does: wheels by wheel odometry, alphas and covariances by simulation."""

import math
from functools import cache

import numpy as np
import pytest

from odomcorrupt import export
from odomcorrupt.correction.undo import undo_effects
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.effects import effect_from_values
from odomcorrupt.errors import ModelError
from odomcorrupt.export import Steady, amcl_alphas, amcl_snippet, message_noise, twist_variances, wheel_multipliers
from odomcorrupt.geometry.se2 import Increments, accumulate, increments
from odomcorrupt.model.motion_model import MotionModel, Noise, Setup, Step
from odomcorrupt.model.noise_laws import Coefficients

TRACK = 0.4
DRIVE = Steady(0.5, 0.5, 50.0)
DIFFUSION = Noise("diffusion", Coefficients(0.04, 0.03, 0.05, 0.02))
SILENT = Noise("diffusion", Coefficients(0.0, 0.0, 0.0, 0.0))
NOISES = {
    "diffusion": DIFFUSION,
    "linear per message": Noise("linear", Coefficients(0.3, 0.2, 0.4, 0.1)),
    "quadratic per step": Noise("quadratic", Coefficients(0.02, 0.01, 0.03, 0.005), Step(0.1, 0.3)),
    "velocity per message": Noise("velocity", Coefficients(0.3, 0.4, 0.5, 0.1, end_trans=0.1, end_rot=0.2)),
    "with white twists": Noise("diffusion", Coefficients(0.02, 0.01, 0.02, 0.01, white_v=0.05, white_omega=0.1)),
}


def robot(*effects, track_m=TRACK):
    return MotionModel(SILENT, tuple(effect_from_values(name, values) for name, values in effects), track_m)


def wheel_path(right_m, left_m, track_m):
    """The mid-point rule of a driver, from the travel of its two wheels."""
    along, turn = (right_m + left_m) / 2.0, (right_m - left_m) / track_m
    return accumulate(np.zeros(3), Increments(along, np.zeros_like(along), turn))


@pytest.mark.parametrize(
    ("effects", "tolerance"),
    [
        ((("wheel_scale", {"e": 0.03}),), 1e-9),
        ((("wheelbase", {"e": 0.05}),), 1e-9),
        ((("unequal_wheels", {"curvature": 0.02}),), 1e-9),
        ((("wheel_scale", {"e": -0.02}), ("wheelbase", {"e": 0.3})), 1e-9),
        # a controller applies the curvature's along part to the true track: a product of two small numbers is left
        ((("wheel_scale", {"e": 0.01}), ("wheelbase", {"e": 0.02}), ("unequal_wheels", {"curvature": 0.01})), 2e-3),
    ],
)
def test_a_controller_with_these_multipliers_computes_the_corrected_path(effects, tolerance):
    t_s = np.arange(2000) / 50.0
    right = 0.01 + 0.004 * np.sin(t_s)[1:]
    left = 0.01 + 0.003 * np.cos(0.4 * t_s)[1:]
    nominal = wheel_path(right, left, TRACK)
    model = robot(*effects)
    corrected = nominal + undo_effects(model.effects, t_s, nominal, TRACK).error_xyt
    found = wheel_multipliers(model)
    separation, left_radius, right_radius = found.values()
    controller = wheel_path(right * right_radius, left * left_radius, TRACK * separation)
    assert np.abs(corrected - nominal).max() > 0.05
    np.testing.assert_allclose(controller, corrected, atol=tolerance)


def test_a_steering_controller_with_these_dimensions_computes_the_corrected_path():
    t_s = np.arange(2000) / 50.0
    tangent, travel = np.tan(0.15 * np.sin(0.7 * t_s[1:])), 0.01 + 0.004 * np.sin(t_s[1:])

    def path(radius, axles):
        return accumulate(np.zeros(3), Increments(radius * travel, 0.0 * travel, radius * travel * tangent / axles))

    effects = tuple(effect_from_values(f"{name}_scale", {"e": e}) for name, e in (("steering", 0.05), ("wheel", 0.02)))
    model = MotionModel(SILENT, effects, setup=Setup(drive_type="car"))
    corrected = path(1.0, 0.3) + undo_effects(effects, t_s, path(1.0, 0.3), None).error_xyt
    found = path(*export.wheels_snippet(model, export.Base(wheelbase=0.3, radius=1.0), "node").values.values())
    np.testing.assert_allclose(found, corrected, atol=1e-9)
    assert np.abs(found - path(1.0, 0.3)).max() > 0.05


def test_unequal_wheels_need_a_track_and_the_others_do_not():
    bent = robot(("unequal_wheels", {"curvature": 0.02}), track_m=None)
    with pytest.raises(ModelError, match="track_m"):
        wheel_multipliers(bent)
    assert [*wheel_multipliers(bent, 0.4).values()] == pytest.approx([1.0, 0.996, 1.004])
    wider = wheel_multipliers(robot(("wheelbase", {"e": 0.05}), track_m=None))
    assert wider["wheel_separation_multiplier"] == pytest.approx(1.05)
    with pytest.raises(ModelError, match="no radius"):
        wheel_multipliers(robot(("unequal_wheels", {"curvature": 1.0})), 3.0)


def differential_update(alphas, delta, samples, rng):
    """One update of nav2's differential motion model as its documentation and the book have it, from heading 0."""
    dx, dy, dtheta = delta
    trans = math.hypot(dx, dy)
    rot1 = math.atan2(dy, dx) if trans >= 0.01 else 0.0
    rot2 = dtheta - rot1
    spread_rot = [math.sqrt(alphas["alpha1"] * rot**2 + alphas["alpha2"] * trans**2) for rot in (rot1, rot2)]
    spread_trans = math.sqrt(alphas["alpha3"] * trans**2 + alphas["alpha4"] * (rot1**2 + rot2**2))
    turned = rot1 - rng.normal(0.0, spread_rot[0], samples)
    far = trans - rng.normal(0.0, spread_trans, samples)
    return np.stack(
        (far * np.cos(turned), far * np.sin(turned), turned + rot2 - rng.normal(0.0, spread_rot[1], samples)), 1
    )


def amcl_ends(alphas, delta, updates, samples=6000):
    rng = np.random.default_rng(5)
    pose = np.zeros((samples, 3))
    for _ in range(updates):
        step = differential_update(alphas, delta, samples, rng)
        c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
        pose[:, 0] += c * step[:, 0] - s * step[:, 1]
        pose[:, 1] += s * step[:, 0] + c * step[:, 1]
        pose[:, 2] += step[:, 2]
    return pose


@cache
def model_ends(noise, speed, yaw_rate, seconds, runs=1500):
    t_s = np.arange(round(seconds * DRIVE.rate_hz) + 1) / DRIVE.rate_hz
    n = len(t_s) - 1
    rows = (np.full(n, speed), np.zeros(n), np.full(n, yaw_rate))
    clean = accumulate(np.zeros(3), Increments(*(row / DRIVE.rate_hz for row in rows)))
    stamps_ns = (t_s * 1e9).astype(np.int64)
    model = MotionModel(noise)
    return np.array([NoisyPath(model, seed).feed(stamps_ns, clean).error_xyt[-1] for seed in range(runs)])


@pytest.mark.slow
@pytest.mark.parametrize("name", list(NOISES))
def test_amcls_particles_spread_on_a_straight_drive_as_the_model_does(name):
    alphas = amcl_alphas(NOISES[name], 0.25, 0.2, drive=DRIVE)
    particles = amcl_ends(alphas, (0.25, 0.0, 0.0), 20)
    drawn = model_ends(NOISES[name], DRIVE.speed, 0.0, 5.0 / DRIVE.speed)
    np.testing.assert_allclose(particles[:, :1].std(axis=0), drawn[:, :1].std(axis=0), rtol=0.1)
    np.testing.assert_allclose(particles[:, 1:].std(axis=0), drawn[:, 1:].std(axis=0), rtol=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("name", list(NOISES))
@pytest.mark.parametrize("turn", ["rolling", "spot"])
def test_amcls_particles_spread_in_turns_as_the_model_does(name, turn):
    alphas = amcl_alphas(NOISES[name], 0.25, 0.2, turn=turn, drive=DRIVE)
    # rolling so slowly that the way does not count, but far enough to have a bearing
    chord = 0.011 if turn == "rolling" else 0.0
    delta = (chord * math.cos(0.1), chord * math.sin(0.1), 0.2)
    particles = amcl_ends(alphas, delta, 15)
    drawn = model_ends(NOISES[name], 0.0, DRIVE.yaw_rate, 3.0 / DRIVE.yaw_rate)
    assert particles[:, 2].std() == pytest.approx(drawn[:, 2].std(), rel=0.1)
    # along the bearing of each step, where both put the noise of the travel
    assert np.hypot(*particles[:, :2].std(axis=0)) == pytest.approx(np.hypot(*drawn[:, :2].std(axis=0)), rel=0.2)


def test_amcls_own_law_at_its_own_step_comes_back():
    k = Coefficients(0.2, 0.1, 0.3, 0.15)
    own = Noise("quadratic", k, Step(0.25, 0.2))
    assert [*amcl_alphas(own, 0.25, 0.2, drive=DRIVE).values()][:4] == pytest.approx([0.2, 0.1, 0.3, 0.15])
    omni = Noise("omni", Coefficients(0.2, 0.1, 0.3, 0.15, across_trans=0.05), Step(0.25, 0.2))
    assert [*amcl_alphas(omni, 0.25, 0.2, drive=DRIVE, omni=True).values()] == pytest.approx(
        [0.2, 0.1, 0.3, 0.15, 0.05]
    )
    assert '"nav2_amcl::OmniMotionModel"' in amcl_snippet(MotionModel(omni), 0.25, 0.2, "rolling", DRIVE).text


def test_alphas_depend_on_the_rate_only_where_they_say_so():
    for name, noise in NOISES.items():
        text = amcl_snippet(MotionModel(noise), 0.25, 0.2, "rolling", DRIVE).text
        assert ("depends on the message rate" in text) is (name not in {"diffusion", "quadratic per step"})
    slow, fast = (amcl_alphas(DIFFUSION, 0.25, 0.2, drive=Steady(v, v, h)) for v, h in ((0.1, 10.0), (1.0, 100.0)))
    assert slow == pytest.approx(fast)


@pytest.mark.parametrize("name", list(NOISES))
def test_twist_variances_are_those_of_the_models_velocities(name):
    noise = NOISES[name]
    found = twist_variances(noise, DRIVE)
    t_s = np.arange(20_001) / DRIVE.rate_hz
    n = len(t_s) - 1
    rows = (np.full(n, DRIVE.speed), np.zeros(n), np.full(n, DRIVE.yaw_rate))
    clean = accumulate(np.zeros(3), Increments(*(row / DRIVE.rate_hz for row in rows)))
    samples = NoisyPath(MotionModel(noise), 7).feed((t_s * 1e9).astype(np.int64), clean)
    noisy = increments(clean + samples.error_xyt)
    drawn = [np.var(part * DRIVE.rate_hz) for part in (noisy.ds_m, noisy.dl_m, noisy.dtheta_rad)]
    assert found == pytest.approx(drawn, rel=0.08)


def test_a_robot_at_rest_has_no_noise_but_that_of_its_twists():
    rest = Steady(0.0, 0.0, 50.0)
    assert message_noise(NOISES["quadratic per step"], rest).heading == 0.0
    assert message_noise(DIFFUSION, rest).along == 0.0
    assert message_noise(NOISES["with white twists"], rest).along == pytest.approx((0.05 / 50.0) ** 2)
