"""Noise laws: variances of the noise on an increment as functions of its travel and turn.

**The alpha convention.** Coefficients are named noise-in_caused-by: `rot_rot, rot_trans, trans_trans, trans_rot` are
alpha1..4, in metres and radians. Their meaning differs between laws, and the numbers are not interchangeable:

* `diffusion`: standard deviation after one metre or one radian; variance grows with distance, at any message rate.
* `linear` (the article; MRPT): standard deviation of one step = coefficient times motion of that step.
* `article-code` (the article's listing, literally): as `linear`, with each standard deviation squared.
* `quadratic` (Probabilistic Robotics, table 5.6; nav2, amcl diff-corrected): *variance* of one step = coefficient times
  squared motion of that step. `velocity` (table 5.3; its alphas in the book's order: trans_trans, trans_rot, rot_trans,
  rot_rot, end_trans, end_rot) and `omni` (amcl omni-corrected, with alpha5) scale the variance likewise.

All but the first depend on the step that they are applied to. A law is one function from magnitudes of motion to
variances; corruption, fit, sampling and density all call these functions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from odomcorrupt.errors import ModelError
from odomcorrupt.geometry.se2 import Increments, rot_trans_rot

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from odomcorrupt.geometry.se2 import Array

_FOUR = ("rot_rot", "rot_trans", "trans_trans", "trans_rot")
_VELOCITY = ("trans_trans", "trans_rot", "rot_trans", "rot_rot", "end_trans", "end_rot")


@dataclass(frozen=True, slots=True)
class Coefficients:
    """Alpha1..4, and coefficients of some laws only.

    rot_time : rad/sqrt(s), angle random walk of a gyro, with any law: noise of the heading that grows with time, also
        at rest, at any message rate (IEEE Std 952-1997, annex C)
    across_trans : sideways noise: for `diffusion` per sqrt(m), 0 unless a fit found it; alpha5 of `omni`
    end_trans, end_rot : alpha5 and alpha6 of `velocity`, for the turn at the end of a step
    white_v, white_omega : m/s and rad/s, standard deviations of white noise on every twist, with any law; it acts
        also at rest, and its drift depends on the message rate
    """

    rot_rot: float
    rot_trans: float
    trans_trans: float
    trans_rot: float
    across_trans: float = 0.0
    end_trans: float = 0.0
    end_rot: float = 0.0
    white_v: float = 0.0
    white_omega: float = 0.0
    rot_time: float = 0.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not 0.0 <= value <= _MAX_COEFFICIENT:
                raise ModelError(f"coefficient {name}: {value}; it must be a number from zero to {_MAX_COEFFICIENT:g}")

    @property
    def noise_free(self) -> bool:
        """Whether all coefficients are zero."""
        return not any(getattr(self, name) for name in self.__slots__)


_MAX_COEFFICIENT = 1e6
"""Largest coefficient: far above any robot's, and its square is still finite."""


class Variances(NamedTuple):
    """Variances of the noise added to n steps, (n,) each: rad^2, m^2, m^2, rad^2.

    rot1 turns the robot before it translates, trans and across shift it along and to the left, rot2 turns it after.
    """

    rot1: Array
    trans: Array
    across: Array
    rot2: Array


class _Rule(Protocol):
    def __call__(self, k: Coefficients, rot1: Array, trans: Array, rot2: Array) -> Variances:
        """Map magnitudes (all >= 0) of turn, travel, turn to variances."""


class Law(NamedTuple):
    """A named noise law.

    per_step : whether its drift depends on the step that it is applied to
    degree : degree of homogeneity of the variances in the coefficients, used by fits
    alphas : names of the coefficients alpha1, alpha2, ...
    meaning : what a coefficient is, for reports
    split : whether rot1 is measured to the bearing of the step; otherwise the turn is split evenly
    arc : whether rot1 is distributed evenly over the translation, instead of preceding it
    along_travel : whether trans and across refer to the direction of travel, instead of the body's x and y
    fitted : whether it is available for fits; imitations of a listing are not
    """

    name: str
    rule: _Rule
    degree: int
    per_step: bool = True
    alphas: tuple[str, ...] = _FOUR
    meaning: str = "variance = coefficient x motion^2"
    split: bool = False
    arc: bool = False
    along_travel: bool = False
    fitted: bool = True

    def coefficients(self, alphas: Sequence[float]) -> Coefficients:
        """Return the coefficients for alpha1, alpha2, ... in the order of the law's source; at least the first four.

        Raises
        ------
        ModelError
            If there are too few or too many.
        """
        if not 4 <= len(alphas) <= len(self.alphas):
            most = f" to {len(self.alphas)}" if len(self.alphas) > 4 else ""
            raise ModelError(f"alpha: {len(alphas)} numbers; the law {self.name} takes 4{most}")
        return Coefficients(**dict.fromkeys(_FOUR, 0.0) | dict(zip(self.alphas, alphas, strict=False)))


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


def _article_code(k: Coefficients, rot1: Array, trans: Array, rot2: Array) -> Variances:
    """Return the variances of the article's listing, which passes sd * sd in place of a standard deviation."""
    v = _linear(k, rot1, trans, rot2)
    return Variances(v.rot1**2, v.trans**2, v.across**2, v.rot2**2)


def _quadratic(k: Coefficients, rot1: Array, trans: Array, rot2: Array) -> Variances:
    return Variances(
        k.rot_rot * rot1**2 + k.rot_trans * trans**2,
        k.trans_trans * trans**2 + k.trans_rot * (rot1**2 + rot2**2),
        np.zeros_like(trans),
        k.rot_rot * rot2**2 + k.rot_trans * trans**2,
    )


def _velocity(k: Coefficients, rot1: Array, trans: Array, rot2: Array) -> Variances:
    """Return the variances for noise on v and omega; the step's time cancels: v dt is travel, omega dt is turn."""
    turn2, trans2 = (rot1 + rot2) ** 2, trans**2
    return Variances(
        k.rot_trans * trans2 + k.rot_rot * turn2,
        k.trans_trans * trans2 + k.trans_rot * turn2,
        np.zeros_like(trans),
        k.end_trans * trans2 + k.end_rot * turn2,
    )


def _omni(k: Coefficients, rot1: Array, trans: Array, rot2: Array) -> Variances:
    turn2, trans2 = (rot1 + rot2) ** 2, trans**2
    return Variances(
        np.zeros_like(trans),
        k.trans_trans * trans2 + k.trans_rot * turn2,
        k.across_trans * trans2 + k.trans_rot * turn2,
        k.rot_rot * turn2 + k.rot_trans * trans2,
    )


_SQUARED = "deviation = (coefficient x motion)^2"

LAWS: Mapping[str, Law] = {
    law.name: law
    for law in (
        Law("diffusion", _diffusion, per_step=False, degree=2, meaning="deviation after 1 m or 1 rad"),
        Law("linear", _linear, degree=2, split=True, meaning="deviation = coefficient x motion"),
        Law("quadratic", _quadratic, degree=1, split=True),
        Law("velocity", _velocity, degree=1, alphas=_VELOCITY, arc=True),
        Law("omni", _omni, degree=1, alphas=(*_FOUR, "across_trans"), along_travel=True),
        Law("article-code", _article_code, degree=4, split=True, fitted=False, meaning=_SQUARED),
    )
}
"""Noise laws by name; the module's docstring gives their sources."""


def law_named(name: str) -> Law:
    """Return the law with a given name; a ModelError lists the available names."""
    try:
        return LAWS[name]
    except KeyError:
        raise ModelError(f"no law is called {name!r}; there are {', '.join(LAWS)}") from None


def variances(law: Law, k: Coefficients, steps: Increments) -> Variances:
    """Return the variances of noise on n increments, with the law applied to each increment as one step.

    `diffusion` uses only |dtheta| and the length of the travel, not its bearing, so a parked robot with 10 um of jitter
    does not spin. Laws with `split` divide the turn at the bearing, see `rot_trans_rot`. White noise on twists and the
    angle random walk, which depend on time, are not included.
    """
    return law.rule(k, *magnitudes(law, steps))


def magnitudes(law: Law, steps: Increments) -> tuple[Array, Array, Array]:
    """Return the arguments of a law: rot1, trans and rot2 of each step, (n,) each, non-negative."""
    if not law.split:
        half = np.abs(steps.dtheta_rad) / 2.0
        travel = np.hypot(steps.ds_m, steps.dl_m)
        # the book's v dt is the length of the arc, and the step is its chord
        return half, travel / np.sinc(half / np.pi) if law.arc else travel, half
    parts = rot_trans_rot(steps)
    return np.abs(parts.rot1_rad), np.abs(parts.trans_m), np.abs(parts.rot2_rad)
