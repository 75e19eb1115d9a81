"""Dependences of the residual on one regressor that no library effect explains, as curves and as terms.

For every regressor (speed, yaw rate, ...) and channel the error per metre is a curve of a few hat functions; for the
heading also the error per radian turned and per second. The joint score of the curve is tested, and its estimate is
reported. Basis functions of one or two coefficients are tested too: they have more power than a curve of eight, and can
be included in the model.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby, islice
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.expression import CHANNELS, LARGEST
from odomcorrupt.study.estimate.drive_type import is_holonomic
from odomcorrupt.study.estimate.problem import by_column
from odomcorrupt.study.io.recording import shared_frame
from odomcorrupt.study.select.decisions import penalty
from odomcorrupt.study.select.periodic import waves
from odomcorrupt.study.select.score import score_columns, score_terms
from odomcorrupt.study.select.screening import least_screened
from odomcorrupt.study.select.shape_search import ShapeSearch
from odomcorrupt.study.terms.channels import MOVES
from odomcorrupt.study.terms.splines import curve_regressors
from odomcorrupt.study.terms.term import BasisTerm

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from odomcorrupt.geometry.motion import Motion
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.estimate.intervals import Intervals
    from odomcorrupt.study.select.decisions import Decisions
    from odomcorrupt.study.select.score import ColumnScore, Score
    from odomcorrupt.study.select.screening import CoarseDesign, Screened

_OF_TURNS = ("yaw_rate", "lateral_acceleration", "yaw_acceleration", "heading")
"""Regressors of turning, which a tight heading control moves by the noise."""
_MOST_STARTS = 40
"""Largest number of terms of one regressor and channel from which shape searches may start."""

_OF_TILT = ("along", "acceleration")
"""Channel and regressor of the error of a truth by laser that tilts when the robot brakes."""


@dataclass(frozen=True, slots=True)
class BasisScore:
    """The basis function of one regressor and channel with the largest gain, scored exactly.

    others : other forms with nearly the same score, to be compared by refits
    """

    score: Score
    others: tuple[Score, ...] = ()

    @property
    def term(self) -> BasisTerm:
        """The basis function with its action."""
        return basis_term(self.score)

    @property
    def kind(self) -> tuple[str, str]:
        """Regressor and channel."""
        return self.term.function.regressor, self.term.action.channel

    def without(self, excluded: Callable[[Score], bool]) -> BasisScore | None:
        """Return the best form that is not excluded, with the other forms; None if all are."""
        forms = [score for score in (self.score, *self.others) if not excluded(score)]
        return BasisScore(forms[0], tuple(forms[1:])) if forms else None


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


def basis_scores(
    fit: Fit, decisions: Decisions, design: CoarseDesign | None = None, *, against_nats: float = 0.0
) -> list[BasisScore]:
    """Return the best basis function of each regressor and channel, scored exactly, whether or not it is significant.

    design : approximate columns, if already computed for this problem
    against_nats : gain that the functions compete with. Of those that can hardly reach it only the best is scored
    """
    count = len(fit.problem.intervals)
    search = ShapeSearch(fit, decisions, design)
    worth = sorted(
        (
            (_kind(s), s.nats - penalty(s.term, count, decisions), i, s)
            for i, s in enumerate(search.promising(against_nats) + waves(fit))
        ),
        key=lambda w: (w[0], -w[1], w[2]),
    )
    terms: list[BasisTerm] = []
    most = max((nats for _, nats, _, _ in worth), default=0.0)
    for kind, group in groupby(worth, key=lambda w: w[0]):
        least = min(least_screened(kind[0], against_nats), most)
        near = [(nats, s) for _, nats, _, s in islice(group, _MOST_STARTS) if nats > decisions.exact_nats]
        terms += search.forms([s for _, s in near]) if near and near[0][0] >= least else []
    found: dict[tuple[str, str], list[Score]] = {}
    scores = score_terms(fit, terms, decisions, family=1) if terms else []
    for term, score in zip(terms, scores, strict=True):
        possible = np.abs(score.estimate).max() < LARGEST  # else the function is zero but for rounding
        if possible and term.share(score.estimate.tolist(), fit.problem.motions) < decisions.max_share:
            found.setdefault((term.function.regressor, term.action.channel), []).append(score)
    return [_with_others(scores, decisions) for scores in found.values()]


def dependences(fit: Fit, scores: Sequence[BasisScore], decisions: Decisions) -> list[Dependence]:
    """Return the dependences that the model does not explain, those with the largest gains first; usually none.

    scores : scores of basis functions, see `basis_scores`
    """
    plain = [one for one in scores if one.score.robust_nats > 0.0 and one.score.significant(decisions.level)]
    by_kind = {one.kind: one for one in plain}
    found = []
    for kind, where, score in _curves(fit):
        regressor, channel, per = kind
        of_turns = channel == "yaw" and (per == "rad" or regressor in _OF_TURNS)
        best = by_kind.get((regressor, channel))
        nats = 0.5 * score.statistic / score.inflation - 0.5 * len(where) * float(np.log(len(fit.problem.intervals)))
        least = decisions.curve_of_turns_nats if of_turns else decisions.curve_nats
        seen = score.significant(decisions.level) and nats > least
        if best is not None and per == best.term.action.per:
            own = best.score
            most = max(nats, own.robust_nats) if seen else own.robust_nats
            p = min(score.p, own.p) if seen else own.p
            found.append(_dependence(kind, where, score, best, p=p, nats=most))
        elif seen and best is None and per != "s":  # a dependence per second requires a basis function
            found.append(_dependence(kind, where, score, None, p=score.p, nats=nats))
    if any(r.matched for r in fit.problem.recordings):
        found = [one for one in found if one.nats > decisions.tilt_nats or (one.channel, one.regressor) != _OF_TILT]
    return sorted(found, key=lambda u: u.nats, reverse=True)


def basis_term(score: Score) -> BasisTerm:
    """Return the term of the score of a basis function; TypeError for any other term."""
    if not isinstance(score.term, BasisTerm):
        raise TypeError(f"{score.term.name} is no basis function")
    return score.term


def _kind(screened: Screened) -> tuple[str, str]:
    return screened.term.function.regressor, screened.term.action.channel


def _with_others(scores: Sequence[Score], decisions: Decisions) -> BasisScore:
    """Return the best score of a kind, with other forms that come close to it."""
    best = max(scores, key=lambda s: s.nats)
    near = [s for s in scores if s is not best and s.nats > decisions.form_share * best.nats]
    return BasisScore(best, tuple(sorted(near, key=lambda s: -s.nats)))


def _curves(fit: Fit) -> list[tuple[tuple[str, str, str], Array, ColumnScore]]:
    """Return for every curve its kind (regressor, channel, per), the centres of its hats, and their joint score."""
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
                names.append((name, channel, per))
                groups.append(_columns_of(intervals, hats[used], -amounts[per], channel))
                centres.append(regressor(motions[0])[1][used])
    return list(zip(names, centres, score_columns(fit, groups), strict=True))


def _columns_of(intervals: Intervals, hats: Array, amount: Array, channel: str) -> Array:
    """Return columns (K, 3, m) of errors of a channel: hats (m, n) of a regressor times an amount of motion (n,)."""
    columns = []
    errors = np.zeros((len(amount), 3))
    for hat in hats:
        errors[:, CHANNELS.index(channel)] = hat * amount
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
