"""Conversion of coefficients between noise laws.

Two laws count as equal if they give the same drift per metre of a straight drive and per radian of a turn on the spot.
This determines the four coefficients separately: each is the only one that acts on its kind of error (heading, travel)
in its kind of motion. For combined driving and turning the laws still differ: `linear` adds standard deviations, the
others variances.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from odomcorrupt.errors import ModelError
from odomcorrupt.model.motion_model import Noise, Step
from odomcorrupt.model.noise_laws import Coefficients, Law

ANY_STEP = Step(1.0, 1.0)
"""For laws that do not depend on the step."""


@dataclass(frozen=True, slots=True, repr=False)
class Drift:
    """Growth of the variances: per metre of a straight drive, and per radian of a turn on the spot.

    rot_trans : rad^2/m; trans_trans, across_trans : m^2/m; rot_rot : rad^2/rad; trans_rot : m^2/rad
    """

    rot_rot: float
    rot_trans: float
    trans_trans: float
    trans_rot: float
    across_trans: float


def drift_of(noise: Noise) -> Drift:
    """Return the drift of a noise model whose law is applied once per step.

    Raises
    ------
    ModelError
        If a per-step law is applied once per message, because its drift then depends on the message rate.
    """
    law = noise.law
    if law.per_step and noise.step is None:
        raise ModelError(f"law {law.name}: its drift depends on the step; name it, as in --step 0.25m,0.2rad")
    if noise.coefficients.white_v or noise.coefficients.white_omega:
        raise ModelError(
            "white noise on twists grows with time, not with distance; leave it out here and add it to the converted "
            "noise"
        )
    return _drift(law, noise.coefficients, noise.step or ANY_STEP)


def convert(noise: Noise, law: Law, step: Step | None) -> Noise:
    """Return the noise of another law, applied once per step, with the same drift.

    Raises
    ------
    ModelError
        If a step is missing, or the other law cannot give this drift.
    """
    if law.per_step and step is None:
        raise ModelError(f"law {law.name}: its coefficients depend on the step; name it, as in --to-step 0.25m,0.2rad")
    wanted = drift_of(noise)
    nothing = Coefficients(0.0, 0.0, 0.0, 0.0)
    found = {"rot_time": noise.coefficients.rot_time}  # the same with any law
    for field in dataclasses.fields(Drift):
        value = getattr(wanted, field.name)
        if not value:
            continue
        # Variances are homogeneous in the coefficients, so one evaluation gives the scale.
        unit = _drift(law, dataclasses.replace(nothing, **{field.name: 1.0}), step or ANY_STEP)
        if not getattr(unit, field.name):
            raise ModelError(f"law {law.name}: has no {field.name}; the drift of {value:g} from it cannot be converted")
        found[field.name] = float((value / getattr(unit, field.name)) ** (1.0 / law.degree))
    return Noise(law.name, dataclasses.replace(nothing, **found), step if law.per_step else None)


def _drift(law: Law, k: Coefficients, step: Step) -> Drift:
    none, far, half = np.zeros(1), np.array([step.distance_m]), np.array([step.angle_rad / 2.0])
    straight, turn = law.rule(k, none, far, none), law.rule(k, half, none, half)
    return Drift(
        rot_rot=float(turn.rot1[0] + turn.rot2[0]) / step.angle_rad,
        rot_trans=float(straight.rot1[0] + straight.rot2[0]) / step.distance_m,
        trans_trans=float(straight.trans[0]) / step.distance_m,
        trans_rot=float(turn.trans[0]) / step.angle_rad,
        across_trans=float(straight.across[0]) / step.distance_m,
    )


def flags_of(noise: Noise) -> str:
    """Return the options that select a noise."""
    values = [getattr(noise.coefficients, name) for name in noise.law.alphas]
    while len(values) > 4 and not values[-1]:  # the first four must be typed
        values.pop()
    alphas = " ".join(f"{value:.6g}" for value in values)
    return f"--law {noise.law_name} --alpha {alphas}{f' --step {noise.step}' if noise.step is not None else ''}"


def drift_words(noise: Noise) -> tuple[str, str]:
    """Return the standard deviations after ten metres straight, and after a whole turn on the spot, in words."""
    drift = drift_of(noise)
    heading, travel = math.degrees(math.sqrt(10.0 * drift.rot_trans)), math.sqrt(10.0 * drift.trans_trans)
    turned, shifted = (math.sqrt(2.0 * math.pi * variance) for variance in (drift.rot_rot, drift.trans_rot))
    return (
        f"heading {heading:.3g} deg, along {travel:.3g} m",
        f"heading {math.degrees(turned):.3g} deg, along {shifted:.3g} m",
    )
