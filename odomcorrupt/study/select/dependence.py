"""Dependences: what the residual depends on where no effect of the library explains it, as a curve and as a term.

For every regressor (speed, yaw rate, ...) and channel the error per metre, and of the heading per radian turned and per
second, too, is a curve of a few hat functions. The curve's joint score says whether it is there, its estimate is what
the user sees. Basis functions of one or two coefficients are tried beside it: they see what a curve of eight is too
blunt for, and can be included in the model.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby, islice
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.expression import CHANNELS
from odomcorrupt.study.estimate.problem import by_column
from odomcorrupt.study.select.closed_loop import hardly_turns, may_be_steering
from odomcorrupt.study.select.decisions import penalty
from odomcorrupt.study.select.periodic import waves
from odomcorrupt.study.select.score import score_columns, score_terms
from odomcorrupt.study.select.shape_search import ShapeSearch
from odomcorrupt.study.terms.channels import MOVES
from odomcorrupt.study.terms.splines import curve_regressors
from odomcorrupt.study.terms.term import BasisTerm

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.decisions import Decisions
    from odomcorrupt.study.select.score import ColumnScore, Score
    from odomcorrupt.study.select.screening import CoarseDesign, Screened

__all__ = ["BasisScore", "Dependence", "basis_scores", "dependences"]

_OF_TURNS = ("yaw_rate", "lateral_acceleration", "yaw_acceleration", "heading")
"""Regressors of which a drive that hardly turns shows nothing but how it is steered."""
_MOST_STARTS = 40
"""Terms of one regressor and channel from which shape searches may start."""

_TILT_NATS, _OF_A_TILT = 20.0, ("along", "acceleration")
"""A laser tilts with a robot that brakes, and its scans err along the path: exact odometry shows 8.5 nats of that."""


@dataclass(frozen=True, slots=True)
class BasisScore:
    """The basis function of one regressor and channel that explains most, scored exactly.

    others : other forms with nearly the same score, between which a fit decides
    """

    score: Score
    others: tuple[Score, ...] = ()

    @property
    def term(self) -> BasisTerm:
        """The basis function and what it acts on."""
        return basis_term(self.score)

    @property
    def kind(self) -> tuple[str, str]:
        """Its regressor and channel."""
        return self.term.function.regressor, self.term.action.channel


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Dependence:
    """An error of one channel that follows one regressor.

    per : what it is an error per: "m" driven, "rad" turned, or "s"
    centres : (m,) values of the regressor, or (m, 2) places
    curve, curve_error : (m,) error of truth minus odometry per `per` there (m/m, rad/m, rad/rad, rad/s), and its error
    p : probability of such a dependence anywhere without any
    nats : log likelihood that it gains, less the penalty
    best : the basis function that explains most of it, if one does
    expression : a simple effect of that shape, ready to be edited
    instead_of : name of the included effect in whose place it explains about as much; else ""

    Two are the same finding only if they are the same object.
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
    instead_of: str = ""

    @property
    def follows_acceleration(self) -> bool:
        """Whether its regressor is an acceleration, as where clocks, and whatever resembles them, are wrong."""
        return self.regressor.endswith("acceleration")

    @property
    def name(self) -> str:
        """Name of the effect that it is in a model, where a basis function explains it; else ""."""
        return self.best.term.name if self.best is not None else ""

    @property
    def title(self) -> str:
        """What depends on what, as in "yaw over speed"."""
        return f"{self.channel} over {self.regressor}"

    @property
    def wheels(self) -> str:
        """Which wheels have the error, where its term acts on these: "left", "right" or "wheels"; else ""."""
        return self.best.term.action.target if self.best is not None and self.best.term.action.by_wheel else ""

    @property
    def wavelength_m(self) -> float | None:
        """Of an error that is periodic over the travelled distance: its period, m."""
        return self.best.term.function.wavelength_m or None if self.best is not None else None

    @property
    def place(self) -> str:
        """Where the error is, in words, as in "within 2 m of (1.0, -0.5)"; "" if it is not confined to a place."""
        return self.best.term.function.place if self.best is not None else ""


def basis_scores(fit: Fit, decisions: Decisions, design: CoarseDesign | None = None) -> list[BasisScore]:
    """Return the best basis function of each regressor and channel, scored exactly, whether or not it is significant.

    design : approximate columns, where they are known already for this problem
    """
    count = len(fit.problem.nodes)
    search = ShapeSearch(fit, decisions, design)
    worth = sorted(
        (
            (_kind(s), s.nats - penalty(s.term, count, decisions), i, s)
            for i, s in enumerate(search.promising() + waves(fit))
        ),
        key=lambda w: (w[0], -w[1], w[2]),
    )
    terms: list[BasisTerm] = []
    for _, group in groupby(worth, key=lambda w: w[0]):
        ranked = [s for _, nats, _, s in islice(group, _MOST_STARTS) if nats > decisions.exact_nats]
        terms += search.forms(ranked) if ranked else []
    found: dict[tuple[str, str], list[Score]] = {}
    for term, score in zip(terms, score_terms(fit, terms, decisions, family=1) if terms else [], strict=True):
        if term.action.move == "omega" and may_be_steering(fit, term.columns(fit.problem), score.estimate):
            continue
        if term.share(score.estimate.tolist(), fit.problem.motions) < decisions.max_share:
            found.setdefault((term.function.regressor, term.action.channel), []).append(score)
    return [_with_others(scores, decisions) for scores in found.values()]


def dependences(fit: Fit, scores: Sequence[BasisScore], decisions: Decisions) -> list[Dependence]:
    """Return the dependences that the model does not explain, the plainest first; usually none.

    scores : of basis functions, see `basis_scores`
    """
    still = hardly_turns(fit)
    plain = [one for one in scores if one.score.robust_nats > 0.0 and one.score.significant(decisions.level)]
    by_kind = {one.kind: one for one in plain}
    found = []
    for kind, where, score in _curves(fit):
        regressor, channel, per = kind
        of_turns = channel == "yaw" and (per == "rad" or regressor in _OF_TURNS)
        if of_turns and still:
            continue
        best = by_kind.get((regressor, channel))
        nats = 0.5 * score.statistic / score.inflation - 0.5 * len(where) * float(np.log(len(fit.problem.nodes)))
        least = decisions.curve_of_turns_nats if of_turns else decisions.curve_nats
        seen = score.significant(decisions.level) and nats > least
        if best is not None and per == best.term.action.per:
            own = best.score
            most = max(nats, own.robust_nats) if seen else own.robust_nats
            p = min(score.p, own.p) if seen else own.p
            found.append(_dependence(kind, where, score, best, p=p, nats=most))
        elif seen and best is None and per != "s":  # a bias that bends is known by its basis function alone
            found.append(_dependence(kind, where, score, None, p=score.p, nats=nats))
    if any(r.matched for r in fit.problem.recordings):
        found = [one for one in found if one.nats > _TILT_NATS or (one.channel, one.regressor) != _OF_A_TILT]
    return sorted(found, key=lambda u: u.nats, reverse=True)


def basis_term(score: Score) -> BasisTerm:
    """Return the term of a score that is known to be a basis function."""
    if not isinstance(score.term, BasisTerm):
        raise TypeError(f"{score.term.name} is no basis function")
    return score.term


def _kind(screened: Screened) -> tuple[str, str]:
    return screened.term.function.regressor, screened.term.action.channel


def _with_others(scores: Sequence[Score], decisions: Decisions) -> BasisScore:
    """Return the best of a kind, with those that come near it."""
    best = max(scores, key=lambda s: s.nats)
    return BasisScore(best, tuple(s for s in scores if s is not best and s.nats > decisions.form_share * best.nats))


def _curves(fit: Fit) -> list[tuple[tuple[str, str, str], Array, ColumnScore]]:
    """Return the curve of every regressor and channel: which it is, where its hats are, and their joint score."""
    motions, nodes = fit.problem.motions, fit.problem.nodes
    travel = np.concatenate([np.hypot(m.v, m.vy) * m.dt_s for m in motions])
    turn = np.concatenate([MOVES["omega"](m) * m.dt_s for m in motions])
    amounts = {"m": travel, "rad": turn, "s": np.concatenate([m.dt_s for m in motions])}
    names, groups, centres = [], [], []
    regressors = curve_regressors(motions)
    for name, regressor in regressors.items():
        shapes = [regressor(m) for m in motions]
        hats = np.concatenate([values.T for values, _ in shapes], axis=1)
        for per, channels in (("m", CHANNELS), ("rad", ("yaw",)), ("s", ("yaw",))):
            held = hats * -amounts[per]
            used = np.abs(held).sum(axis=1) > 0.01 * np.abs(amounts[per]).sum()
            if used.sum() < 2:
                continue
            for channel in channels:
                columns = []
                for hat in held[used]:
                    error = np.zeros((3, len(hat)))
                    error[CHANNELS.index(channel)] = hat
                    columns.append(nodes.column(error.T))
                names.append((name, channel, per))
                groups.append(by_column(np.stack(columns)))
                centres.append(shapes[0][1][used])
    return list(zip(names, centres, score_columns(fit, groups), strict=True))


def _dependence(
    kind: tuple[str, str, str], where: Array, score: ColumnScore, best: BasisScore | None, *, p: float, nats: float
) -> Dependence:
    """Return a dependence of a kind (regressor, channel, per) from the score of its curve and its basis function."""
    regressor, channel, per = kind
    curve, error = score.estimate, score.standard_error
    if best is not None and best.term.function.wavelength_m:  # a wave is shown, not the hats that are too wide for it
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
