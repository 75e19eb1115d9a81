"""What is left when no known effect explains it: the driver on which the error depends, the curve, and a law to try.

For every driver (speed, yaw rate, ...) and channel the error per metre, and of the heading per radian turned, too, is
let free as a curve of a few hat functions. The curve's joint score says whether it is there, its estimate is what the
user sees. Simple laws of one or two numbers are tried beside it: they see what a curve of eight is too blunt for.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.expression import CHANNELS
from odomcorrupt.study.select.basis_scores import best_laws, likeliest
from odomcorrupt.study.select.channels import MOVES
from odomcorrupt.study.select.closed_loop import hardly_turns
from odomcorrupt.study.select.score import score_columns
from odomcorrupt.study.select.splines import curve_drivers

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.basis_scores import ScoredLaw
    from odomcorrupt.study.select.score import ColumnScore

__all__ = ["Unknown", "unknown_dependences"]

_LEVEL = 0.01
_OF_TURNS = ("yaw_rate", "lateral_acceleration", "yaw_acceleration", "heading")
"""Drivers of which a drive that hardly turns shows nothing but how it is steered."""
_LEAST_NATS, _LEAST_NATS_OF_TURNS = 4.0, 25.0
"""What a curve without any law to it has to gain, and one of the yaw over how the robot turns: tight steering (3 per
second) answers to the noise within an interval, and bends such curves by 5 to 24 nats where nothing is wrong."""


@dataclass(frozen=True, slots=True, eq=False)
class Unknown:
    """An error of one channel that follows one driver.

    per : what it is an error per: "m" driven, "rad" turned, or "s"
    centres : (m,) values of the driver, or (m, 2) places
    curve, curve_error : (m,) error of truth minus odometry per `per` there (m/m, rad/m, rad/rad, rad/s), and its error
    p : probability of such a dependence anywhere without any
    nats : log likelihood that it gains, less what its numbers gain by chance
    law : the law that explains most of it, if one does
    expression : a simple effect of that shape, ready to be edited

    Two are the same finding only if they are the same object.
    """

    channel: str
    driver: str
    per: str
    centres: Array
    curve: Array
    curve_error: Array
    p: float
    nats: float
    law: ScoredLaw | None
    expression: str

    @property
    def wheels(self) -> str:
        """Which wheels have the error, where its law acts on these: "left", "right" or "wheels"; else ""."""
        return self.law.action.target if self.law is not None and self.law.action.by_wheel else ""

    @property
    def wavelength_m(self) -> float | None:
        """Of an error that comes back with the way: after how much of it, m."""
        return self.law.law.wavelength_m or None if self.law is not None else None


def unknown_dependences(fit: Fit, believed: Array, likely: Sequence[ScoredLaw] | None = None) -> list[Unknown]:
    """Return the dependences that nothing believed explains, the plainest first; usually none.

    Parameters
    ----------
    fit : the fitted model
    believed : (K, 3, q)
        Columns of what is believed already.
    likely : the likeliest laws, where they are known already

    """
    likely = likeliest(fit, believed) if likely is None else likely
    still = hardly_turns(fit)
    laws = {(found.law.driver, found.action.channel): found for found in best_laws(likely)}
    found = []
    for (driver, channel, per), where, score in _curves(fit, believed):
        of_turns = channel == "yaw" and (per == "rad" or driver in _OF_TURNS)
        if of_turns and still:
            continue
        law = laws.get((driver, channel))
        nats = 0.5 * score.statistic / score.inflation - 0.5 * len(where) * float(np.log(len(fit.problem.nodes)))
        least = _LEAST_NATS_OF_TURNS if of_turns else _LEAST_NATS
        seen = score.separable and score.p < _LEVEL and score.held_out_nats > score.held_out_error and nats > least
        if law is not None and per == law.action.per:
            most = max(nats, law.nats) if seen else law.nats
            p = min(score.p, law.p) if seen else law.p
            found.append(_unknown(driver, channel, per, where, score, p, most, law))
        elif seen and law is None and per != "s":  # a bias that bends is known by its law alone
            found.append(_unknown(driver, channel, per, where, score, score.p, nats, None))
    return sorted(found, key=lambda u: u.nats, reverse=True)


def _curves(fit: Fit, believed: Array) -> list[tuple[tuple[str, str, str], Array, ColumnScore]]:
    """Return the curve of every driver and channel: which it is, where its hats are, and their joint score."""
    motions, nodes = fit.problem.motions, fit.problem.nodes
    travel = np.concatenate([np.hypot(m.v, m.vy) * m.dt_s for m in motions])
    turn = np.concatenate([MOVES["omega"](m) * m.dt_s for m in motions])
    amounts = {"m": travel, "rad": turn, "s": np.concatenate([m.dt_s for m in motions])}
    names, groups, centres = [], [], []
    drivers = curve_drivers(motions)
    for name, (channel, per) in product(drivers, [*((c, "m") for c in CHANNELS), ("yaw", "rad"), ("yaw", "s")]):
        shapes = [drivers[name](m) for m in motions]
        held = np.concatenate([values for values, _ in shapes]) * amounts[per][:, None]
        amount = np.abs(held).sum(axis=0)
        used = amount > 0.01 * np.abs(amounts[per]).sum()
        if used.sum() < 2:
            continue
        columns = []
        for hat in held[:, used].T:
            error = np.zeros((len(hat), 3))
            error[:, CHANNELS.index(channel)] = -hat
            columns.append(nodes.column(error))
        names.append((name, channel, per))
        groups.append(np.stack(columns, axis=2))
        centres.append(shapes[0][1][used])
    return list(zip(names, centres, score_columns(fit, groups, believed), strict=True))


def _unknown(
    driver: str, channel: str, per: str, where: Array, score: ColumnScore, p: float, nats: float, law: ScoredLaw | None
) -> Unknown:
    curve, error = score.estimate, score.standard_error
    if law is not None and law.law.wavelength_m:  # a wave is shown, not the hats that are too wide for it
        where = np.linspace(0.0, law.law.wavelength_m, 13)
        angle = 2.0 * np.pi * where / law.law.wavelength_m
        waves = np.stack((np.cos(angle), np.sin(angle)), axis=1)
        curve, error = waves @ law.score.estimate, np.sqrt(waves**2 @ law.score.standard_error**2)
    return Unknown(
        channel=channel,
        driver=driver,
        per=per,
        centres=where,
        curve=curve,
        curve_error=error,
        p=p,
        nats=nats,
        law=law,
        expression=law.expression if law is not None else _line(driver, channel, per, where, score),
    )


def _line(name: str, channel: str, per: str, where: Array, score: ColumnScore) -> str:
    """Return the simplest effect of the shape of the curve, as an expression with its numbers filled in."""
    curve, weight = score.estimate, 1.0 / np.maximum(score.standard_error, 1e-12) ** 2
    move = "abs(v)" if per == "m" else "omega"
    if name == "heading":
        terms = ("cos(theta)", "sin(theta)", "cos(2 * theta)", "sin(2 * theta)")
        text = " + ".join(f"{k:.3g} * {terms[int(i)]}" for i, k in zip(where, curve, strict=True))
        return f"{channel} += {move} * ({text})"
    if name == "position":
        worst = int(np.argmax(np.abs(curve) * np.sqrt(weight)))
        x, y = where[worst]
        return f"{channel} += {curve[worst]:.3g} * {move} * exp(-((x - {x:.3g})**2 + (y - {y:.3g})**2) / 2)"
    variable = {
        "speed": "v",
        "yaw_rate": "omega",
        "acceleration": "a",
        "lateral_acceleration": "abs(v * omega)",
        "yaw_acceleration": "alpha",
        "time": "t",
    }
    slope, offset = np.polyfit(where, curve, 1, w=np.sqrt(weight))
    return f"{channel} += {move} * ({offset:.3g} + {slope:.3g} * {variable.get(name, name)})"
