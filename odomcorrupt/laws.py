"""Noise laws: how uncertain one increment is, given how far it went and turned.

**The alpha convention.** Coefficients are named noise-in_caused-by: `rot_rot, rot_trans, trans_trans, trans_rot` are
alpha1..4, in metres and radians. What they mean differs between laws, and the numbers are not interchangeable:

* `diffusion`: standard deviation after one metre or one radian; variance grows with distance, whatever the rate.
* `linear` (the article; MRPT): standard deviation of one step = coefficient times motion of that step.
* `quadratic` (Probabilistic Robotics ch. 5.4; nav2, amcl diff-corrected): *variance* of one step = coefficient times
  squared motion of that step.

The last two depend on the step they are applied to. A law is one function from magnitudes of motion to variances;
corruption, fit, sampling and density all call these same functions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from odomcorrupt.errors import ModelError
from odomcorrupt.increments import Increments, rot_trans_rot

if TYPE_CHECKING:
    from collections.abc import Mapping

    from odomcorrupt.pose import Array

__all__ = ["LAWS", "Coefficients", "Law", "Variances", "law_named", "variances"]


@dataclass(frozen=True, slots=True)
class Coefficients:
    """Alpha1..4, and the sideways noise of `diffusion` (per sqrt(m), 0 unless a fit found it)."""

    rot_rot: float
    rot_trans: float
    trans_trans: float
    trans_rot: float
    across_trans: float = 0.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0.0):
                raise ModelError(f"coefficient {name}: {value}; it must be a finite number, zero or more")

    @property
    def silent(self) -> bool:
        """Whether no noise is drawn at all."""
        return not any(getattr(self, name) for name in self.__slots__)


@dataclass(frozen=True, slots=True)
class Variances:
    """Variances of what is added to n steps, (n,) each: rad^2, m^2, m^2, rad^2.

    rot1 turns the robot before it translates, trans and across shift it along and to the left, rot2 turns it after.
    """

    rot1: Array
    trans: Array
    across: Array
    rot2: Array


class _Rule(Protocol):
    def __call__(self, k: Coefficients, rot1: Array, trans: Array, rot2: Array) -> Variances:
        """Map magnitudes (all >= 0) of turn, travel, turn to variances."""


@dataclass(frozen=True, slots=True)
class Law:
    """A named rule.

    per_step : whether the drift it makes depends on the step it is applied to
    degree : variances are homogeneous of this degree in the coefficients (a fit needs to know)
    """

    name: str
    rule: _Rule
    per_step: bool
    degree: int
    source: str


def _diffusion(k: Coefficients, rot1: Array, trans: Array, rot2: Array) -> Variances:
    turn = rot1 + rot2
    heading = 0.5 * (k.rot_rot**2 * turn + k.rot_trans**2 * trans)
    return Variances(heading, k.trans_trans**2 * trans + k.trans_rot**2 * turn, k.across_trans**2 * trans, heading)


def _linear(k: Coefficients, rot1: Array, trans: Array, rot2: Array) -> Variances:
    turn = rot1 + rot2
    return Variances(
        (k.rot_rot * rot1 + k.rot_trans * trans) ** 2,
        (k.trans_trans * trans + k.trans_rot * turn) ** 2,
        np.zeros_like(trans),
        (k.rot_rot * rot2 + k.rot_trans * trans) ** 2,
    )


def _quadratic(k: Coefficients, rot1: Array, trans: Array, rot2: Array) -> Variances:
    return Variances(
        k.rot_rot * rot1**2 + k.rot_trans * trans**2,
        k.trans_trans * trans**2 + k.trans_rot * (rot1**2 + rot2**2),
        np.zeros_like(trans),
        k.rot_rot * rot2**2 + k.rot_trans * trans**2,
    )


LAWS: Mapping[str, Law] = {
    law.name: law
    for law in (
        Law(
            "diffusion",
            _diffusion,
            per_step=False,
            degree=2,
            source="Probabilistic Robotics' growth, the article's units",
        ),
        Law("linear", _linear, per_step=True, degree=2, source="the article (2018); MRPT CActionRobotMovement2D"),
        Law(
            "quadratic",
            _quadratic,
            per_step=True,
            degree=1,
            source="Probabilistic Robotics ch. 5.4, table 5.6; nav2_amcl",
        ),
    )
}


def law_named(name: str) -> Law:
    """Return the law of that name; ModelError names the ones there are."""
    try:
        return LAWS[name]
    except KeyError:
        raise ModelError(f"no law is called {name!r}; there are {', '.join(LAWS)}") from None


def variances(law: Law, k: Coefficients, steps: Increments) -> Variances:
    """Return the variances of noise on n increments, the law applied to each increment as one step.

    `diffusion` looks at |dtheta| and the length of the travel only, never at its bearing: a parked robot with
    10 um of jitter does not spin. The book laws split the turn at the bearing, see `rot_trans_rot`.
    """
    if not law.per_step:
        half = np.abs(steps.dtheta_rad) / 2.0
        return law.rule(k, half, np.hypot(steps.ds_m, steps.dl_m), half)
    parts = rot_trans_rot(steps)
    return law.rule(k, np.abs(parts.rot1_rad), np.abs(parts.trans_m), np.abs(parts.rot2_rad))
