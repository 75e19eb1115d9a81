"""Dependences of the residual on one regressor that no library effect explains, as curves and as terms.

For every regressor (speed, yaw rate, ...) and channel the error per metre is a curve of a few hat functions; for the
heading also the error per radian turned and per second. The joint score of the curve is tested, and its estimate is
reported. Basis functions of one or two coefficients are tested too: they have more power than a curve of eight, and can
be included in the model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.expression import CHANNELS
from odomcorrupt.study.estimate.drive_type import is_holonomic
from odomcorrupt.study.estimate.problem import by_column
from odomcorrupt.study.io.recording import shared_frame
from odomcorrupt.study.select.score import score_columns, score_terms
from odomcorrupt.study.terms.channels import MOVES
from odomcorrupt.study.terms.splines import curve_regressors
from odomcorrupt.study.terms.term import BasisTerm

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from odomcorrupt.geometry.motion import Motion
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.estimate.intervals import Intervals
    from odomcorrupt.study.select.decisions import Decisions
    from odomcorrupt.study.select.score import ColumnScore, Score


@dataclass(frozen=True, slots=True)
class BasisScore:
    """The basis function of one regressor and channel with the largest gain, scored exactly."""

    score: Score

    @property
    def term(self) -> BasisTerm:
        """The basis function with its action."""
        return basis_term(self.score)

    @property
    def kind(self) -> tuple[str, str]:
        """Regressor and channel."""
        return self.term.function.regressor, self.term.action.channel


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Dependence:
    """An error of one channel that depends on one regressor.

    per : unit of motion to which the error refers: "m" driven, "rad" turned, or "s"
    centres : (m,) values of the regressor, or (m, 2) places
    curve, curve_error : (m,) truth minus odometry per `per` at the centres (m/m, rad/m, rad/rad, rad/s), and its error
    p : probability of such a dependence for any regressor if there is none
    nats : gain in log likelihood minus the penalty
    best : the basis function with the largest gain, if any
    expression : a simple effect of that shape, for the user to edit
    instead_of : names of the included effects that it may replace; empty if none

    Equality is identity of objects.
    """

    channel: str
    regressor: str
    per: str
    centres: Array
    curve: Array
    curve_error: Array
    p: float
    nats: float
    best: BasisScore | None
    expression: str
    instead_of: tuple[str, ...] = ()

    @property
    def follows_acceleration(self) -> bool:
        """Whether the regressor is an acceleration, as it is for errors of clocks and of effects that resemble them."""
        return self.regressor.endswith("acceleration")

    @property
    def name(self) -> str:
        """Name of its effect in a model, if a basis function explains it; else ""."""
        return self.best.term.name if self.best is not None else ""

    @property
    def title(self) -> str:
        """Channel and regressor, as in "yaw over speed"."""
        return f"{self.channel} over {self.regressor}"

    @property
    def wheels(self) -> str:
        """Wheels with the error if the term acts on wheels: "left", "right" or "wheels"; else ""."""
        return self.best.term.action.target if self.best is not None and self.best.term.action.by_wheel else ""

    @property
    def wavelength_m(self) -> float | None:
        """Period of an error that is periodic over the travelled distance, m; else None."""
        return self.best.term.function.wavelength_m or None if self.best is not None else None

    @property
    def place(self) -> str:
        """Location of the error in words, as in "within 2 m of (1.0, -0.5)"; "" if it is not confined to a place."""
        return self.best.term.function.place if self.best is not None else ""


def dependence_of(fit: Fit, term: BasisTerm, nats: float, decisions: Decisions) -> Dependence:
    """Return a basis function as a dependence, with the curve of its regressor and channel, scored beside a fit.

    fit : a model without the function
    nats : its gain minus its cost
    """
    (score,) = score_terms(fit, [term], decisions, family=1)
    kind = (term.function.regressor, term.action.channel, term.action.per)
    curve = next(iter(_curves(fit, kind)), None)
    if curve is None:  # the regressor hardly varies: the function alone
        alone = replace(score, estimate=score.estimate[:1], standard_error=score.standard_error[:1])
        return _dependence(kind, np.zeros(1), alone, BasisScore(score), p=score.p, nats=nats)
    return _dependence(kind, curve[1], curve[2], BasisScore(score), p=score.p, nats=nats)


def basis_term(score: Score) -> BasisTerm:
    """Return the term of the score of a basis function; TypeError for any other term."""
    if not isinstance(score.term, BasisTerm):
        raise TypeError(f"{score.term.name} is no basis function")
    return score.term


def _curves(
    fit: Fit, only: tuple[str, str, str] | None = None
) -> list[tuple[tuple[str, str, str], Array, ColumnScore]]:
    """Return for every curve its kind (regressor, channel, per), the centres of its hats, and their joint score.

    only : the kind that is wanted; default all
    """
    motions, intervals = fit.problem.motions, fit.problem.intervals
    travel = np.concatenate([np.hypot(m.v, m.vy) * m.dt_s for m in motions])
    turn = np.concatenate([MOVES["omega"](m) * m.dt_s for m in motions])
    amounts = {"m": travel, "rad": turn, "s": np.concatenate([m.dt_s for m in motions])}
    names, groups, centres = [], [], []
    recordings = fit.problem.recordings
    regressors = curve_regressors(
        motions, placed=shared_frame(recordings) is not None, sideways=is_holonomic(recordings, motions)
    )
    for name, regressor in regressors.items():
        hats = _hats(regressor, motions)
        for per, channels in (("m", CHANNELS), ("rad", ("yaw",)), ("s", ("yaw",))):
            least = 0.01 * np.abs(amounts[per]).sum()
            used = np.array([np.abs(hat * amounts[per]).sum() > least for hat in hats])
            if used.sum() < 2:
                continue
            for channel in channels:
                if only in (None, (name, channel, per)):
                    names.append((name, channel, per))
                    groups.append(_columns_of(intervals, hats, used, -amounts[per], channel))
                    centres.append(regressor(motions[0])[1][used])
    return list(zip(names, centres, score_columns(fit, groups), strict=True))


def _columns_of(intervals: Intervals, hats: Array, used: NDArray[np.bool_], amount: Array, channel: str) -> Array:
    """Return columns (K, 3, m) of errors of a channel: the used hats (k, n) of a regressor times a motion (n,)."""
    columns = []
    errors = np.zeros((len(amount), 3))
    for i in np.flatnonzero(used):
        errors[:, CHANNELS.index(channel)] = hats[i] * amount
        columns.append(intervals.column(errors))
    return by_column(np.stack(columns))


def _hats(regressor: Callable[[Motion], tuple[Array, Array]], motions: Sequence[Motion]) -> Array:
    """Return the values (k, n) of a regressor's hats on all motions; without a copy on a single one."""
    parts = [regressor(motion)[0].T for motion in motions]
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)


def _dependence(
    kind: tuple[str, str, str], where: Array, score: ColumnScore, best: BasisScore | None, *, p: float, nats: float
) -> Dependence:
    """Return a dependence of a kind (regressor, channel, per) from the score of its curve and its basis function."""
    regressor, channel, per = kind
    curve, error = score.estimate, score.standard_error
    if best is not None and best.term.function.wavelength_m:  # report the wave: hats are too wide to resolve it
        where = np.linspace(0.0, best.term.function.wavelength_m, 13)
        angle = 2.0 * np.pi * where / best.term.function.wavelength_m
        unit = np.stack((np.cos(angle), np.sin(angle)), axis=1)
        curve, error = unit @ best.score.estimate, np.sqrt(unit**2 @ best.score.standard_error**2)
    expression = (
        _line(regressor, channel, per, where, score)
        if best is None
        else best.term.expression(best.score.estimate.tolist())
    )
    return Dependence(
        channel=channel,
        regressor=regressor,
        per=per,
        centres=where,
        curve=curve,
        curve_error=error,
        p=p,
        nats=nats,
        best=best,
        expression=expression,
    )


def _line(name: str, channel: str, per: str, where: Array, score: ColumnScore) -> str:
    """Return a simple effect with about the shape of the curve, as an expression with its numbers filled in."""
    curve, weight = score.estimate, 1.0 / np.maximum(score.standard_error, 1e-12) ** 2
    travel = "hypot(v, vy)" if name == "sideways_speed" else "abs(v)"
    move = travel if per == "m" else "omega"
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
        "sideways_speed": "vy",
    }
    slope, offset = np.polyfit(where, curve, 1, w=np.sqrt(weight))
    return f"{channel} += {move} * ({offset:.3g} + {slope:.3g} * {variable.get(name, name)})"
