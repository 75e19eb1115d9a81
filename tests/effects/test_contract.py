"""Every effect of the registry keeps the contract, its documents, its signs, and its twins."""

import copy
import math
import re
import textwrap
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from manoeuvres import CIRCLE, RATE_HZ, REVERSE, SPIN, STOP, STRAIGHT, error, motion, total

from odomcorrupt.drive_types import DRIVE_TYPES
from odomcorrupt.effects import registry
from odomcorrupt.effects.compensation import error_of
from odomcorrupt.effects.effect import ByRows, Effect, Moments, TwistError, amplitudes, parameter, parameters, stacked
from odomcorrupt.effects.expression import FUNCTIONS, VARIABLES, user_effect
from odomcorrupt.effects.ground import Slope
from odomcorrupt.effects.wheels import brings_track
from odomcorrupt.errors import EffectError
from odomcorrupt.model.model_file import parse_model
from odomcorrupt.testing import ContractError, check_effect
from recordings import ROOT


@pytest.mark.parametrize("name", registry())
def test_every_effect_keeps_the_contract(name):
    check_effect(registry()[name])


@pytest.mark.parametrize("name", registry())
def test_every_effect_is_explained(name):
    about = registry()[name].about
    assert all((about.equation, about.typical, about.source, about.drive))
    assert about.confused_with
    assert set(about.confused_with) <= set(registry()) - {name}


def test_a_users_expression_keeps_the_contract_too():
    text = "yaw += k * v * abs(omega); along += -c * abs(v) * a"
    check_effect(type(user_effect("bumps", text, {"k": 0.1, "c": 0.02})))
    check_effect(type(user_effect("waves", "across += k * v * sin(w * x)", {"k": 0.01, "w": 3.0})))


@dataclass(frozen=True, slots=True)
class Good(Effect):
    name: ClassVar[str] = "good"
    kind: ClassVar[str] = "effect"
    summary: ClassVar[str] = "a scale that keeps every promise"
    k: float = parameter("", "of the speed", low=-0.5, high=0.5, typical=0.1)

    def twist_error(self, motion, state):
        return TwistError(stacked(self.k * motion.v, 0.0, 0.0, motion.v), state)


def variant(methods, **facts):
    kind = type("Flawed", (Good,), {"__slots__": (), "name": "flawed", **facts, **methods})
    return dataclass(frozen=True)(kind)


def restless(_self, motion, state):
    return TwistError(stacked(0.0, 0.0, 0.01, motion.v), state)


def infinite(self, motion, state):
    with np.errstate(all="ignore"):
        return TwistError(stacked(self.k / motion.v, 0.0, 0.0, motion.v), state)


def meddling(self, motion, state):
    motion.v[0] += 1.0
    return TwistError(stacked(self.k * motion.v, 0.0, 0.0, motion.v), state)


def forgetful(self, motion, state):
    return TwistError(stacked(self.k * np.cumsum(motion.dt_s), 0.0, 0.0, motion.v), state)


def placeless(self, motion, state):
    return TwistError(stacked(self.k * motion.x, 0.0, 0.0, motion.v), state)


def wasteful(self, motion, state):
    return TwistError(stacked(self.k * state.standard_normal(len(motion)), 0.0, 0.0, motion.v), state)


def seedless(self, motion, state):
    rng = copy.deepcopy(state)
    return TwistError(stacked(self.k * rng.standard_normal(len(motion)), 0.0, 0.0, motion.v), rng)


def begins(_self, rng):
    return rng


def twice_too_small(self, motion):
    return Moments(np.zeros((len(motion), 3)), stacked(self.k**2 / 2.0, 0.0, 0.0, motion.v))


def blunt(self):
    return replace(self, k=abs(self.k))


def random_from_the_start(_self, rng):
    return float(rng.standard_normal())


def scaled_by_state(self, motion, state):
    return TwistError(stacked(self.k * motion.v * state, 0.0, 0.0, motion.v), state)


def halved(self, _motion, state):
    return ByRows(lambda rows, _: stacked(0.5 * self.k * rows.v, 0.0, 0.0, rows.v), state)


NOISE = {"start": begins, "moments": twice_too_small}


@pytest.mark.parametrize(
    ("methods", "facts", "complaint"),
    [
        ({"twist_error": restless}, {}, "not zero at its identity"), ({"twist_error": infinite}, {}, "not finite"),
        ({"twist_error": meddling}, {}, "changes v of the motion"),
        ({"twist_error": forgetful}, {}, "cut into pieces of 1"), ({"twist_error": placeless}, {}, "reads_places"),
        ({"twist_error": placeless}, {"reads_places": True}, "reads_truth"),
        ({"by_rows": halved}, {}, "by single intervals"),
        ({"start": random_from_the_start, "twist_error": scaled_by_state}, {}, "draws, but its kind"),
        ({"plain": blunt}, {}, "in plain words"),
        ({"twist_error": wasteful, **NOISE}, {"kind": "noise"}, "changes the state"),
        ({"twist_error": seedless, **NOISE}, {"kind": "noise"}, "stated variance"), ({}, {"summary": ""}, "summary"),
        ({}, {"kind": "oddity"}, "kind"),
    ],
)  # fmt: skip
def test_the_contract_notices(methods, facts, complaint):
    with pytest.raises(ContractError, match=re.escape(complaint)):
        check_effect(variant(methods, **facts))


def test_the_contract_has_nothing_against_a_good_effect():
    check_effect(Good)


def test_the_contract_wants_units_and_bounds():
    @dataclass(frozen=True)
    class Bare(Good):
        name: ClassVar[str] = "bare"
        extra: float = 1.0

    with pytest.raises(ContractError, match="extra"):
        check_effect(Bare)


KINDS = registry()


def varied():
    n = 500
    wave = np.arange(n) / 50.0
    return motion(0.5 + 0.4 * np.sin(wave), np.cos(2.0 * wave), seconds=n / 50.0, track=0.4)


@pytest.mark.parametrize("name", [name for name, kind in KINDS.items() if kind.aliased_with])
def test_twins_have_the_same_regressor(name):
    kind, twin = KINDS[name], KINDS[KINDS[name].aliased_with]
    p = amplitudes(kind)[0]
    ours = error_of(kind(**{p.name: p.typical}), varied())
    theirs = error_of(twin(**{p.name: p.typical}), varied())
    assert ours.any()
    assert np.array_equal(ours, theirs)


@pytest.mark.parametrize("drive_type", DRIVE_TYPES)
def test_no_other_two_effects_of_a_drive_type_have_the_same_regressor(drive_type):
    drive = varied()
    columns = {}
    for name, kind in KINDS.items():
        if kind.kind in ("noise", "event") or kind.aliased_with or drive_type not in (kind.drives or DRIVE_TYPES):
            continue
        for p in amplitudes(kind):
            f = error_of(kind(**{p.name: p.typical}), drive).ravel()
            columns[name, p.name] = f / np.linalg.norm(f) if f.any() else f
    matrix = np.array(list(columns.values()))
    likeness = np.abs(matrix @ matrix.T - np.eye(len(matrix)))
    likeness[~matrix.any(axis=1)] = 0.0
    assert likeness.max() < 0.999


STEERING = ("steering_offset", "steering_play", "steering_scale", "flat_spot")
SHAPED = [n for n, k in KINDS.items() if any(not p.amplitude and not p.optional for p in parameters(k))]
SHAPED += ["hard_iron", "scale_drift"]  # a filter and a time of settling are optional, and tried
SHAPED.remove("flat_spot")  # its circumference is a line of a spectrum


@pytest.mark.parametrize("name", [name for name in SHAPED if KINDS[name].kind not in ("noise", "event")])
def test_a_scan_is_finite_at_the_identity_and_within_bounds(name):
    kind = KINDS[name]
    found = kind.scan([varied(), varied()])
    assert 1 < len(found) <= 400
    assert len(set(found)) == len(found)
    for effect in found:
        assert not effect.acts
        assert all(p.low <= getattr(effect, p.name) <= p.high for p in parameters(effect))


@pytest.mark.parametrize("name", [name for name, kind in KINDS.items() if name not in (*SHAPED, *STEERING)])
def test_an_effect_without_shapes_needs_one_try(name):
    assert KINDS[name].scan([varied()]) == (KINDS[name](),)


@pytest.mark.parametrize(
    "name", [n for n, k in KINDS.items() if brings_track(k) and k.kind != "noise" and n != "flat_spot"]
)
def test_an_effect_of_single_wheels_brings_tracks_where_the_robots_is_not_known(name):
    kind = KINDS[name]
    found = kind.scan([replace(varied(), track_m=None)])
    own = {effect.track for effect in found} - {0.0}
    assert min(own) < 0.2
    assert max(own) > 1.0
    p = amplitudes(kind)[0]
    known = [replace(effect, track=0.4, **{p.name: p.typical}) for effect in found]
    for effect in known:
        bare = error_of(replace(effect, track=0.0), varied())
        assert np.array_equal(error_of(effect, replace(varied(), track_m=None)), bare)


def test_a_scan_of_discs_has_one_near_any_patch_of_the_floor():
    n = 3000
    wave = np.arange(n) / 50.0
    drive = motion(0.5, 0.5 * np.sin(0.3 * wave), seconds=n / 50.0)
    slipped = error_of(KINDS["region_slip"](slip=0.05, x=float(drive.x[900]), y=float(drive.y[900]), radius=1.3), drive)
    best = 0.0
    for disc in KINDS["region_slip"].scan([drive]):
        column = error_of(type(disc)(slip=0.05, x=disc.x, y=disc.y, radius=disc.radius), drive)
        best = max(best, float((column * slipped).sum() / np.linalg.norm(column) / np.linalg.norm(slipped)))
    assert best > 0.85


def test_a_scan_of_a_parked_robot_is_empty():
    assert KINDS["region_slip"].scan([motion(0.0, 0.0)]) == ()


def test_two_slopes_at_right_angles_make_every_slope():
    drive = varied()
    whole = error_of(KINDS["slope"](creep=0.02, direction=0.7), drive)
    east = error_of(KINDS["slope"](creep=0.02 * math.cos(0.7), direction=0.0), drive)
    north = error_of(KINDS["slope"](creep=0.02 * math.sin(0.7), direction=math.pi / 2.0), drive)
    assert east + north == pytest.approx(whole, abs=1e-15)


PAGE = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")


def block(language):
    return textwrap.dedent(re.search(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)[1])


def test_the_expression_is_read():
    effect = parse_model(block("toml")).effects[0]
    assert effect.name == "my_bumps"
    assert effect.acts


def test_the_class_keeps_the_contract():
    names: dict[str, object] = {"__name__": __name__}
    head = "from dataclasses import dataclass\nfrom odomcorrupt.effects.effect import "
    head += "Effect, Motion, State, TwistError, parameter, stacked\n"
    exec(compile(head + block("python"), "effects.md", "exec", dont_inherit=True), names)  # noqa: S102 - our own page
    check_effect(names["Wobble"])


def test_every_word_of_the_language_is_documented():
    listed = PAGE[PAGE.index("Statements add to") : PAGE.index("Nothing else is accepted")]
    assert all(re.search(rf"\b{word}\b", listed) for word in (*VARIABLES, *FUNCTIONS))


@pytest.mark.parametrize("name", ["wheel_scale", "sideways_scale", "wheelbase", "gyro_scale", "steering_scale"])
def test_a_ratio_and_its_inverse_are_both_possible(name):
    (scale,) = (p for p in parameters(registry()[name]) if p.name == "e")
    assert (1.0 + scale.low) * (1.0 + scale.high) == pytest.approx(1.0)


CASES = [
    # effect, values, manoeuvre, seconds, track, what the truth has more than the odometry: m along, m left, rad
    ("wheel_scale", {"e": 0.01}, STRAIGHT, 2.0, None, (0.01, 0.0, 0.0)),
    ("wheel_scale", {"e": 0.01}, SPIN, 2.0, None, (0.0, 0.0, 0.02)),
    ("unequal_wheels", {"curvature": 0.02}, STRAIGHT, 2.0, None, (0.0, 0.0, 0.02)),
    ("unequal_wheels", {"curvature": 0.02}, REVERSE, 2.0, None, (0.0, 0.0, -0.02)),
    ("unequal_wheels", {"curvature": 0.02}, SPIN, 1.0, 0.4, (0.0008, 0.0, 0.0)),
    ("wheelbase", {"e": 0.25}, SPIN, 1.0, None, (0.0, 0.0, -0.2)),
    ("gyro_scale", {"e": 0.2}, SPIN, 1.2, None, (0.0, 0.0, -0.2)),
    ("gyro_scale", {"e": 0.2}, STRAIGHT, 1.0, None, (0.0, 0.0, 0.0)),
    ("lever_arm", {"x": 0.1, "y": 0.05}, SPIN, 1.0, None, (-0.05, 0.1, 0.0)),
    ("icr_shift", {"x": 0.1}, SPIN, 1.0, None, (0.0, 0.1, 0.0)),
    ("icr_shift", {"x": 0.1}, STRAIGHT, 1.0, None, (0.0, 0.0, 0.0)),
    ("mount_yaw", {"yaw": 0.1}, STRAIGHT, 2.0, None, (math.cos(0.1) - 1.0, -math.sin(0.1), 0.0)),
    ("gyro_bias", {"bias": 0.01}, STOP, 3.0, None, (0.0, 0.0, -0.03)),
    ("side_slip", {"k": 0.05}, CIRCLE, 1.0, None, (0.0, -0.02, 0.0)),
    ("side_slip", {"k": 0.05}, SPIN, 1.0, None, (0.0, 0.0, 0.0)),
    ("turn_asymmetry", {"k": 0.01}, SPIN, 1.0, None, (0.0, 0.0, 0.01)),
    ("turn_scrub", {"travel": -0.1}, {"v": 1.0, "omega": -0.5}, 1.0, None, (-0.05, 0.0, 0.0)),
    ("turn_scrub", {"travel": -0.1}, {"v": 0.0, "vy": 1.0, "omega": 0.5}, 1.0, None, (0.0, -0.05, 0.0)),
    ("turn_scrub", {"turn": 0.1}, {"v": 0.0, "omega": -0.5}, 1.0, None, (0.0, 0.0, -0.025)),
    ("off_centre_load", {"x": 0.2}, {"v": 0.5, "omega": 1.0}, 1.0, None, (0.0, 0.0, 0.1)),
    ("off_centre_load", {"y": 0.2}, {"v": 0.0, "vy": -0.5, "omega": 1.0}, 1.0, None, (0.0, 0.0, -0.1)),
    ("turn_asymmetry", {"k": 0.01}, {"v": 0.0, "omega": -1.0}, 1.0, None, (0.0, 0.0, 0.01)),
    ("speed_scale", {"k": 0.02}, STRAIGHT, 2.0, None, (0.01, 0.0, 0.0)),
    ("speed_scale", {"k": 0.02}, REVERSE, 2.0, 0.4, (-0.01, 0.0, 0.0)),
    # rims at +-0.2 m/s: k * 0.2 * 0.2 on each side, apart by the track
    ("speed_scale", {"k": 0.02}, SPIN, 1.0, 0.4, (0.0, 0.0, 0.004)),
    ("accel_slip", {"k": 0.05}, STRAIGHT, 2.0, None, (0.0, 0.0, 0.0)),
    ("slope", {"creep": 0.02, "direction": math.pi / 2}, STRAIGHT, 2.0, None, (0.0, 0.02, 0.0)),
    ("slope", {"creep": 0.02, "direction": 0.0}, REVERSE, 2.0, None, (0.02, 0.0, 0.0)),
    ("slope", {"creep": 0.02, "direction": 0.0}, SPIN, 2.0, None, (0.0, 0.0, 0.0)),
    ("region_slip", {"slip": 0.1, "x": 0.0, "y": 0.0, "radius": 0.5}, STRAIGHT, 2.0, None, (-0.05, 0.0, 0.0)),
    ("region_slip", {"slip": 0.1, "x": 9.0, "y": 0.0, "radius": 0.5}, STRAIGHT, 2.0, None, (0.0, 0.0, 0.0)),
    # edges are crossed within an interval
    ("region_slip", {"slip": 0.1, "x": 0.0, "y": 0.0, "radius": 0.5037}, STRAIGHT, 2.0, None, (-0.05037, 0.0, 0.0)),
    ("region_slip", {"slip": 0.1, "x": -0.5, "y": 0.0, "radius": 0.1237}, REVERSE, 2.0, None, (0.02474, 0.0, 0.0)),
    (
        "region_slip",
        {"slip": 0.1, "x": 0.5, "y": 0.0, "radius": 0.3, "width": 0.2, "angle": math.pi / 6.0},
        STRAIGHT,
        2.0,
        None,
        (-0.1 * 0.6 / math.cos(math.pi / 6.0), 0.0, 0.0),
    ),
    ("region_slip", {"slip": 0.1, "x": 0.1, "y": 0.0, "radius": 0.5}, SPIN, 1.0, None, (0.0, 0.0, -0.1)),
    ("region_slip", {"slip": 0.1, "x": 0.1, "y": 0.0, "radius": 0.05}, SPIN, 1.0, None, (0.0, 0.0, 0.0)),
    ("backlash", {"travel": 0.004}, STRAIGHT, 2.0, 0.4, (0.0, 0.0, 0.0)),
    ("time_offset", {"offset": 0.1}, STRAIGHT, 1.0, None, (0.0, 0.0, 0.0)),
    ("clock_skew", {"rate": 0.01}, SPIN, 1.0, None, (0.0, 0.0, 0.01)),
]


@pytest.mark.parametrize(("name", "values", "drive", "seconds", "track", "expected"), CASES)
def test_truth_minus_odometry_is_what_paper_says(name, values, drive, seconds, track, expected):
    found = total(name, values, motion(**drive, seconds=seconds, track=track))
    assert found == pytest.approx(expected, abs=1e-12)


SYSTEMATIC_AT_REST = ["wheel_scale", "wheelbase", "side_slip", "accel_slip", "speed_scale", "slope", "scale_drift"]


@pytest.mark.parametrize("name", SYSTEMATIC_AT_REST)
def test_at_rest_only_a_gyro_goes_wrong(name):
    amplitude = {"wheel_scale": "e", "wheelbase": "e", "slope": "creep", "scale_drift": "rate"}.get(name, "k")
    assert not error(name, {amplitude: 1e-4}, motion(**STOP)).any()


def test_scale_drift_grows_with_time():
    drive = motion(0.5, 0.2, seconds=100.0)
    f = error("scale_drift", {"rate": 1e-5}, drive)
    assert f[-1] == pytest.approx([5e-4, 0.0, 2e-4])
    assert (f * drive.dt_s[:, None]).sum(axis=0)[0] == pytest.approx(0.5 * 1e-5 * 100.0**2 / 2.0, rel=1e-3)


def test_slip_by_acceleration_falls_behind_at_the_start_and_comes_back_at_the_stop():
    up = np.linspace(0.0, 1.0, 50, endpoint=False)
    drive = motion(np.concatenate((np.zeros(10), up, np.ones(50), up[::-1], np.zeros(10))), 0.0, seconds=170 / RATE_HZ)
    lag = np.cumsum(error("accel_slip", {"k": 0.05}, drive)[:, 0] * drive.dt_s)
    # -k/2 v^2 while it drives, and nothing when it stands again
    assert lag[85] == pytest.approx(-0.05 / 2.0)
    assert lag[-1] == pytest.approx(0.0, abs=1e-15)
    assert lag.max() < 1e-3


def test_slip_by_acceleration_is_behind_in_reverse_too():
    drive = motion(-np.linspace(0.0, 1.0, 50), 0.0)
    assert total("accel_slip", {"k": 0.05}, drive)[0] == pytest.approx(0.05 / 2.0, rel=0.06)


def test_the_slope_is_fixed_in_the_world():
    for heading in np.linspace(-3.0, 3.0, 7):
        along, across, _ = total(
            "slope", {"creep": 0.02, "direction": 1.0}, motion(**STRAIGHT, seconds=2.0, heading=heading)
        )
        east = along * math.cos(heading) - across * math.sin(heading)
        north = along * math.sin(heading) + across * math.cos(heading)
        assert (east, north) == pytest.approx((0.02 * math.cos(1.0), 0.02 * math.sin(1.0)))


@pytest.mark.parametrize("first", [0.5, -0.5])
def test_backlash_loses_its_travel_at_each_reversal_and_not_at_the_first_start(first):
    legs = np.repeat([0.0, first, -first, first, 0.0], 50)
    lost = total("backlash", {"travel": 0.004}, motion(legs, 0.0, seconds=5.0, track=0.4))
    assert lost == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)  # one each way
    once = total("backlash", {"travel": 0.004}, motion(legs[:150], 0.0, seconds=3.0, track=0.4))
    assert once == pytest.approx([math.copysign(0.004, first), 0.0, 0.0], abs=1e-12)


def test_castors_turn_the_robot_after_each_reversal_and_the_next_one_turns_it_back():
    legs = np.concatenate((np.full(100, 0.2), np.full(100, -0.2)))
    kick = {"angle": 0.03, "way": 0.1}
    assert not error("castor_kick", kick, motion(legs[:100], 0.0, seconds=2.0)).any()
    there = error("castor_kick", kick, motion(legs, 0.0, seconds=4.0))
    # within the way on which they swing, and a parked robot's sway
    assert not there[130:].any()
    assert total("castor_kick", kick, motion(legs, 0.0, seconds=4.0)) == pytest.approx([0.0, 0.0, -0.03], abs=1e-12)
    back = motion(np.concatenate((legs, legs)), 0.0, seconds=8.0)
    assert total("castor_kick", kick, back) == pytest.approx([0.0, 0.0, -0.03], abs=1e-12)


def test_a_complementary_filter_takes_the_turn_of_the_wheels_seconds_late():
    drive = motion(0.0, np.repeat([1.0, 0.0], [100, 1900]), seconds=40.0)
    late = error("complementary_filter", {"e": 0.25, "tau": 5.0}, drive)[:, 2] / RATE_HZ
    assert late.sum() == pytest.approx(-0.2 * 2.0, rel=1e-3)
    assert late[:100].sum() == pytest.approx(-0.2 * (2.0 - 4.0 * (1.0 - math.exp(-0.5))), rel=0.01)


def test_backlash_of_one_wheel_turns_the_robot():
    """A turn to the left on the spot after driving on: the left wheel alone reverses."""
    drive = motion(np.repeat([0.5, 0.0], 50), np.repeat([0.0, 1.0], 50), seconds=2.0, track=0.4)
    assert total("backlash", {"travel": 0.004}, drive) == pytest.approx([0.002, 0.0, -0.01], abs=1e-12)


def test_a_parked_robot_that_sways_has_no_backlash():
    rng = np.random.default_rng(3)
    sway = rng.normal(0.0, 5e-6, 200) * RATE_HZ
    drive = motion(np.concatenate((np.full(50, 0.5), sway)), 0.0, seconds=5.0, track=0.4)
    assert not error("backlash", {"travel": 0.004}, drive).any()


def test_effects_of_single_wheels_ask_for_the_track():
    with pytest.raises(EffectError, match="track"):
        error("backlash", {"travel": 0.004}, motion(**STRAIGHT))


def test_a_slope_is_reported_as_a_creep_towards_where_it_goes():
    drive = motion(**CIRCLE)
    for creep, direction in ((-0.015, 0.5), (0.01, 4.0)):
        told = (slope := Slope(creep=creep, direction=direction)).plain()
        assert told.creep > 0.0
        assert -np.pi <= told.direction <= np.pi
        assert error_of(told, drive) == pytest.approx(error_of(slope, drive), abs=1e-12)
