"""Model comparison: library effects against basis functions that replace one effect or several at once.

The most similar library effect may be selected for a cause outside the library, or several effects together. So each
included effect, and all of them at once, are removed, to first order, and every basis function is scored instead.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects import registry
from odomcorrupt.effects.ground import RegionSlip
from odomcorrupt.errors import FitError
from odomcorrupt.study.select.candidates import (
    Candidate,
    levels_of,
    library,
    objection,
    tried,
    with_shape_refined,
)
from odomcorrupt.study.select.decisions import equal_candidates, penalty
from odomcorrupt.study.select.dependence import BasisScore, basis_scores, dependences
from odomcorrupt.study.select.elimination import drop_term
from odomcorrupt.study.select.library_search import LibrarySearch
from odomcorrupt.study.select.score import project_out, score_columns
from odomcorrupt.study.terms.basis.place import rectangle_of
from odomcorrupt.study.terms.term import BasisTerm, LibraryTerm

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.motion import Motion
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.estimate.problem import Problem
    from odomcorrupt.study.select.decisions import Decisions
    from odomcorrupt.study.select.dependence import Dependence
    from odomcorrupt.study.select.score import Score
    from odomcorrupt.study.select.screening import CoarseDesign


_WIDE_NATS = 30.0
"""Margin of an effect over basis functions that later refits do not change so much that it matters."""
_VARIED_S = 5.0
"""Time between changes of the speeds at which copies are recognised, s: slower than accelerations."""
_AT_EDGES = 1e-3
"""Fraction of a gain that the same function may lose at its edges: 11 of 86 242 nats of a strip, which a patch cuts
within a step and a basis function between steps."""
_MOST_SPARED = 15.0
"""Largest additional penalty, nats, of an effect that is the same function as a basis function: four parameters."""


@dataclass(frozen=True, eq=False)
class ModelComparison:
    """One or several included effects against the basis functions that may replace them.

    effects : the compared effects of the fit
    bare : the fit without them, see `drop_term`
    nats, penalty : their joint gain minus their penalty, and that penalty
    scores : the best basis function of each regressor and channel, except copies of the effects and functions that a
        refit refutes
    decisions : thresholds of the selection
    """

    effects: tuple[Effect, ...]
    bare: Fit
    nats: float
    penalty: float
    scores: list[BasisScore]
    decisions: Decisions

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the compared effects."""
        return tuple(effect.name for effect in self.effects)

    @property
    def margin(self) -> float:
        """Gain of the effects over the best basis function, nats, both minus their penalties."""
        return self.nats - max((one.score.nats for one in self.scores), default=0.0)

    @cached_property
    def _dependences(self) -> list[Dependence]:
        return dependences(self.bare, self.scores, self.decisions)

    def better(self, by_nats: float) -> list[Dependence]:
        """Return the dependences that gain more than the effects by `by_nats` and are close to the best of them."""
        if self.margin > -by_nats:
            return []
        found = [one for one in self._dependences if one.best is not None and one.best.score.nats > self.nats + by_nats]
        return [one for one in found if one.nats > found[0].nats - self.decisions.alternative_nats]


def compare_each_with_basis(
    fit: Fit,
    effects: Sequence[Effect],
    decisions: Decisions,
    design: CoarseDesign,
    known: Sequence[ModelComparison] = (),
) -> list[ModelComparison]:
    """Return comparisons of effects of a fit with basis functions, of each one and, if several, of all together.

    Several effects may explain one cause together; replacing only one of them would then gain nothing. A function that
    replaces all of them also replaces each one beside the others, so if one has a wide margin, all together have.

    known : comparisons of an earlier, similar fit, of which wide margins are kept
    """
    before = {one.names: one for one in known if one.margin > _WIDE_NATS}
    found = [before.get((effect.name,)) or compare_with_basis(fit, [effect], decisions, design) for effect in effects]
    if len(effects) < 2:
        return found
    paid = sum(one.penalty for one in found) + _for_further(effects, decisions)
    if max(one.margin + one.penalty for one in found) - paid > _WIDE_NATS:
        return found
    names = tuple(effect.name for effect in effects)
    return [*found, before.get(names) or compare_with_basis(fit, effects, decisions, design)]


def _for_further(effects: Sequence[Effect], decisions: Decisions) -> float:
    """Return what effects after the first pay, nats, for the number of those from which they were selected.

    One cause is likelier than several that imitate it together (Chen & Chen, Biometrika 95, 2008).
    """
    competing = [name for name, kind in registry().items() if kind.kind != "noise"]
    return (len(effects) - 1) * float(np.log(equal_candidates(competing, decisions)))


def compare_with_basis(
    fit: Fit, effects: Sequence[Effect], decisions: Decisions, design: CoarseDesign
) -> ModelComparison:
    """Return the comparison of effects of a fit, taken together, with every basis function in their place.

    Each further effect pays for the number of those from which it was selected, as basis functions do.
    """
    bare = fit
    for effect in effects:
        bare = drop_term(bare, effect)
    columns = _columns(fit.problem, effects)
    (own,) = score_columns(bare, [columns])
    motions, count = fit.problem.motions, len(fit.problem.intervals)
    penalties = sum(penalty(LibraryTerm.of(effect, motions), count, decisions) for effect in effects)
    penalties += _for_further(effects, decisions)
    nats = 0.5 * own.statistic - penalties
    rest, whiten = project_out(bare), bare.noise.whitener.whiten
    whitened = rest.of(whiten(columns))
    sizes = np.linalg.lstsq(whitened, rest.residual, rcond=None)[0]
    other = _at_other_speeds(bare.problem)
    elsewhere = _columns(other, effects)

    def copies(score: Score) -> bool:
        """Return whether a basis function is the same as the effects on any drive: if it fits better, then by chance.

        If it is the same only at the speeds of this drive, the data do not separate the two.
        """
        term = score.term
        return (
            score.nats > nats - decisions.replacement_nats  # else too small a gain to matter
            and explained_share(rest.of(whiten(term.columns(bare.problem))), whitened @ sizes) > decisions.copy_share
            and explained_share(whiten(term.columns(other)), whiten(elsewhere) @ sizes) > decisions.copy_share
        )

    found = [one.without(copies) for one in basis_scores(bare, decisions, design, against_nats=nats)]
    scores = sorted((one for one in found if one is not None), key=lambda one: -one.score.nats)
    others = [e for e in fit.effects if e not in effects]

    def refuted(score: Score) -> bool:
        """Return whether a function explains clearly less in a refit without the effects, with the same weights."""
        if not (with_it := with_effects(fit, (*others, score.estimated), weights_of=fit)):
            return True
        with_it, score = with_shape_refined(with_it, score, decisions, weights_of=fit)
        more = with_it.log_likelihood - fit.log_likelihood - score.penalty + penalties
        return more < -decisions.replacement_nats

    # refit from the best function on, as long as that can change the comparison
    while scores and scores[0].score.nats > nats - decisions.replacement_nats and refuted(scores[0].score):
        del scores[0]
    return ModelComparison(tuple(effects), bare, nats, penalties, scores, decisions)


def margins(compared: Sequence[ModelComparison]) -> dict[str, float]:
    """Return the gain of each effect, alone or with all others, over the best basis function, nats."""
    names = dict.fromkeys(name for own in compared for name in own.names)
    return {name: min(own.margin for own in compared if name in own.names) for name in names}


def rivals(compared: Sequence[ModelComparison], decisions: Decisions) -> list[Dependence]:
    """Return for effects, alone and together, the dependence that may explain them, if there is one."""
    found = [(own.names, own.better(-decisions.rival_nats)[:1]) for own in compared]
    return [replace(one, instead_of=names) for names, nearest in found for one in nearest]


def _columns(problem: Problem, effects: Sequence[Effect]) -> Array:
    return np.concatenate([problem.columns(effect) for effect in effects], axis=2)


def _at_other_speeds(problem: Problem) -> Problem:
    """Return the problem of a drive whose speeds, yaw rates and headings vary slowly and independently around its own.

    Speeds and yaw rates are between half and twice those driven. Only functions that are the same on any drive are the
    same there, while on a drive with all turns alike a function of the yaw rate equals a constant.
    """
    rng = np.random.default_rng(0)
    return replace(problem, motions=tuple(_varied(motion, rng) for motion in problem.motions))


def _varied(motion: Motion, rng: np.random.Generator) -> Motion:
    knots = np.arange(motion.t_s[0], motion.t_s[-1] + 2.0 * _VARIED_S, _VARIED_S)
    speed, turn, heading = (np.interp(motion.t_s, knots, rng.uniform(-1.0, 1.0, len(knots))) for _ in range(3))
    factors = np.stack((2.0**speed, 2.0**speed, 2.0**turn), axis=1)
    return replace(
        motion,
        v=motion.v * factors[:, 0],
        vy=motion.vy * factors[:, 1],
        omega=motion.omega * factors[:, 2],
        theta=motion.theta + np.pi * heading,
        acceleration=motion.acceleration * factors,
        trail=None if motion.trail is None else motion.trail * factors,
        before=None if motion.before is None else motion.before * factors[:, None],
    )


def explained_share(columns: Array, explained: Array) -> float:
    """Return the fraction of the square of a contribution (n,) that columns (n, p) can explain."""
    basis = np.linalg.qr(columns)[0]
    return float(np.sum((basis.T @ explained) ** 2)) / max(float(explained @ explained), 1e-300)


def name_for(fit: Fit, law: Dependence, decisions: Decisions) -> Candidate | None:
    """Return the library effect that can replace an included dependence with about the same gain, if there is one.

    Beside terms that were included later, a known effect may explain as much, and a known cause is likelier a priori.
    One that is the same function of this drive, as a patch of floor may be, is the same cause: it does not pay for more
    shape parameters. An effect that fits only with a physically impossible sign is returned as a refused candidate.
    """
    effect = fit.by_name.get(law.name)
    if effect is None or law.best is None:
        return None
    bare, others = drop_term(fit, effect), [e for e in fit.effects if e is not effect]
    own = law.best.term.columns(bare.problem)
    column_score, own_penalty = score_columns(bare, [own])[0], law.best.score.penalty
    own_nats = 0.5 * column_score.statistic
    least = own_nats - own_penalty - decisions.replacement_nats
    search = LibrarySearch(bare, _with_place(library(bare), law.best.term, bare), decisions)
    explained = bare.noise.whitener.whiten(own) @ column_score.estimate

    def spared(score: Score) -> float:
        """Return what an effect may gain less, nats, if it is the same function of this drive; else 0.

        It pays for no more parameters, and its edges may differ within a step.
        """
        columns = bare.noise.whitener.whiten(score.term.columns(bare.problem))
        same = explained_share(columns, explained) > decisions.copy_share
        return max(score.penalty - own_penalty, 0.0) + _AT_EDGES * own_nats if same else 0.0

    likely = search.scores_above(max(least - _MOST_SPARED - _AT_EDGES * own_nats, 0.0))
    near = sorted((s for s in likely if s.nats + spared(s) > max(least, 0.0)), key=lambda s: -s.nats - spared(s))
    levels = levels_of(search.scores, decisions)
    for score in near[: decisions.shortlist]:
        refused = objection(bare, score, decisions, level=levels[score.term.name])
        if refused:
            candidate = Candidate(score=score, gain=score.nats, refused=refused)
            if candidate.contradicts_physics(decisions):
                return candidate
            continue
        with_it = fit.refit((*others, score.estimated), weights_of=fit)
        gain = with_it.log_likelihood - fit.log_likelihood - score.penalty + own_penalty + spared(score)
        found = tried(fit, with_it, score, gain=gain, least=-decisions.replacement_nats)
        if not found.refused:
            return replace(found, fit=with_it.refit(), gain=score.nats)
    return None


def _with_place(
    families: Sequence[tuple[LibraryTerm, ...]], term: BasisTerm, fit: Fit
) -> list[tuple[LibraryTerm, ...]]:
    """Return families of effects, that of patches with the strip or rectangle of a basis function as a further start.

    A grid of discs hardly leads to a strip that the path crosses far apart.
    """
    rectangle = rectangle_of(term.function)
    if rectangle is None:
        return list(families)
    angle, x, y, half, side = rectangle
    patch = RegionSlip.in_rectangle(angle, (x, y), half, side, fit.problem.motions)
    if term.action.by_wheel:
        patch = replace(patch, contact="wheels", heading=term.action.heading)
    return [
        (*family, LibraryTerm(patch, family[0].trials)) if family[0].name == RegionSlip.name else family
        for family in families
    ]


def with_effects(fit: Fit, effects: Sequence[Effect], weights_of: Fit | None = None) -> Fit | None:
    """Return the refit with these effects, or None if their first estimates are too far off as starting values."""
    try:
        return fit.refit(effects, weights_of=weights_of)
    except FitError:
        return None
