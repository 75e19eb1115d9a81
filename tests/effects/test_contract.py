"""Every registered effect keeps the contract, and the contract notices those that do not."""

from __future__ import annotations

import copy
import re
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import ByRows, Effect, Moments, TwistError, parameter, stacked
from odomcorrupt.effects.expression import user_effect
from odomcorrupt.testing import ContractError, check_effect


@pytest.mark.parametrize("name", registry())
def test_every_effect_keeps_the_contract(name):
    check_effect(registry()[name])


@pytest.mark.parametrize("name", registry())
def test_every_effect_is_explained(name):
    about = registry()[name].about
    assert all((about.equation, about.typical, about.source, about.drive))
    assert about.confused_with
    assert set(about.confused_with) <= set(registry()) - {name}


def test_names_are_those_of_the_catalogue():
    catalogue = """wheel_scale unequal_wheels wheelbase lever_arm mount_yaw icr_shift gyro_bias gyro_bias_walk
        gyro_scale side_slip accel_slip speed_scale region_slip slope turn_asymmetry scale_drift backlash slip_burst
        gauss_markov heavy_tails quantization lost_increments time_offset clock_skew
        sideways_scale"""
    assert set(catalogue.split()) <= set(registry())


def test_a_users_expression_keeps_the_contract_too():
    check_effect(
        type(user_effect("bumps", "yaw += k * v * abs(omega); along += -c * abs(v) * a", {"k": 0.1, "c": 0.02}))
    )
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
    """Return the good effect with a flaw."""
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
        ({"twist_error": restless}, {}, "not zero at its identity"),
        ({"twist_error": infinite}, {}, "not finite"),
        ({"twist_error": meddling}, {}, "changes v of the motion"),
        ({"twist_error": forgetful}, {}, "cut into pieces of 1"),
        ({"twist_error": placeless}, {}, "reads_places"),
        ({"twist_error": placeless}, {"reads_places": True}, "reads_truth"),
        ({"by_rows": halved}, {}, "by single intervals"),
        ({"start": random_from_the_start, "twist_error": scaled_by_state}, {}, "draws, but its kind"),
        ({"plain": blunt}, {}, "in plain words"),
        ({"twist_error": wasteful, **NOISE}, {"kind": "noise"}, "changes the state"),
        ({"twist_error": seedless, **NOISE}, {"kind": "noise"}, "stated variance"),
        ({}, {"summary": ""}, "summary"),
        ({}, {"kind": "oddity"}, "kind"),
    ],
)
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
