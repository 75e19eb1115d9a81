"""Backward elimination: terms made redundant by later ones, and the decision between two sources of the heading."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import choices, on_bound, parameters
from odomcorrupt.study.estimate.drift_error import drift
from odomcorrupt.study.estimate.heading_source import heading_source_of, turns_at_rest
from odomcorrupt.study.estimate.random_process import CORRELATED_NOISE
from odomcorrupt.study.select.random_effects import is_remainder, remeasured
from odomcorrupt.study.select.score import score_terms
from odomcorrupt.study.terms.term import LibraryTerm

if TYPE_CHECKING:
    from collections.abc import Container

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.estimate.drift_error import Drift
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.decisions import Decisions
    from odomcorrupt.study.select.random_effects import DetectedRandomEffect

_ITERATIONS, _ALIKE, _SETTLED_NATS = 6, 0.03, 0.5
"""Largest number of iterations between a random coefficient and the other noise; they end if the coefficient changes by
less than the second value, and the log likelihood rises by less than the third, nats."""


def drop_term(fit: Fit, effect: Effect) -> Fit:
    """Return the fit without one of its effects: its contribution is back in the residual, its columns are removed.

    To first order and with unchanged noise, for tests of replacements.
    """
    explained = fit.noise.whitener.whiten(fit.problem.explained(effect))
    noise = replace(fit.noise, innovations=fit.noise.innovations + explained)
    others = tuple(e for e in fit.effects if e is not effect)
    return replace(fit, noise=noise, problem=replace(fit.problem, effects=others, left=()))


def drift_grows(after: Drift, before: Drift, decisions: Decisions) -> bool:
    """Return whether a drift is larger than another one of the same data, see `Decisions.drift_factor`."""
    return after.worse_than(
        before, factor=decisions.drift_factor, plain=decisions.drift_plain, errors=decisions.drift_errors
    )


def backward_eliminate(fit: Fit, keep: Container[str], decisions: Decisions) -> Fit:
    """Return the fit without effects that are no longer significant in Wald tests, the least significant first.

    Effects that need an impossible size beside a later term are dropped, too.

    keep : names of effects that stay in any case
    """
    while fit.effects:
        gains = {name: 0.5 * square for name, square in fit.wald.items() if name not in keep}
        gains |= {e.name: -1.0 for e in fit.onward.effects if e.name in gains and on_bound(e)}
        least = min(gains, key=gains.__getitem__, default=None)
        if least is None or gains[least] >= decisions.drop_nats:
            return fit
        fit = fit.refit([e for e in fit.effects if e.name != least])
    return fit


def absorb(fit: Fit, keep: Container[str], decisions: Decisions) -> Fit:
    """Return the fit with effects in their complete form (`Effect.whole`), without effects that this makes redundant.

    The mean radius error of a wheel with a flat spot, for example, is part of that effect and no cause beside it. The
    fit is returned unchanged if its likelihood falls too much.
    """
    whole = [effect.whole() for effect in fit.effects]
    if whole == list(fit.effects):
        return fit
    fewer = backward_eliminate(fit.refit(whole), keep, decisions)
    lost = len(fit.effects) - len(fewer.effects)
    return fewer if fit.log_likelihood - fewer.log_likelihood < decisions.drop_nats * lost else fit


def without_redundant(fit: Fit, keep: Container[str], decisions: Decisions) -> Fit:
    """Return the fit without effects that its last term made redundant, with effects in their complete form."""
    return absorb(backward_eliminate(fit, keep, decisions), keep, decisions)


def eliminate_untested(fit: Fit, keep: Container[str], decisions: Decisions) -> Fit:
    """Return the fit without library effects whose robust gain beside all other terms is below their penalty.

    An early effect was tested beside few others; a later term or basis function may explain the same completely. Gains
    are cluster-robust, as at inclusion, but the threshold is lower: the penalty alone. The weakest effect is dropped
    first and the others are tested again. One whose removal makes the 10 s error plainly larger stays: gains of a lag
    differ by orders of magnitude between manoeuvres, which the robust test takes for contradictions.

    keep : names of effects that stay in any case
    """
    needed = set[str]()
    while True:
        failing = []
        for effect in fit.effects:
            if effect.name in keep or effect.name not in registry():
                continue
            term = LibraryTerm.of(effect, fit.problem.motions)
            (score,) = score_terms(drop_term(fit, effect), [term], decisions)
            if not score.robust_nats > 0.0 and effect.name not in needed:
                failing.append((score.robust_nats, effect.name))
        if not failing:
            return fit
        weakest = min(failing)[1]
        fewer = fit.refit([e for e in fit.effects if e.name != weakest])
        if drift(fewer).rmse > decisions.drift_plain * drift(fit).rmse:
            needed.add(weakest)
        else:
            fit = fewer


def eliminate_random(
    named: list[DetectedRandomEffect], fit: Fit, decisions: Decisions
) -> tuple[list[DetectedRandomEffect], Fit]:
    """Return named random effects and the fit, both without random coefficients that a later term made redundant."""
    if remainders := [e for e in fit.random if is_remainder(fit, e)]:
        named = [one for one in named if one.effect not in remainders]
        fit = fit.refit(random=[e for e in fit.random if e not in remainders])
    if not fit.random:
        return named, fit
    calm = fit.refit(random=())
    least = decisions.drop_nats + decisions.correlated_nats * len(fit.random)
    if fit.log_likelihood - calm.log_likelihood >= least:
        return named, fit
    return [one for one in named if one.effect.name not in CORRELATED_NOISE], calm


def iterate(fit: Fit, effect: Effect) -> tuple[Fit, Effect]:
    """Return a fit and its random coefficient after alternating re-estimation of both until convergence."""
    for _ in range(_ITERATIONS):
        new, _ = remeasured(fit, effect)
        alike = all(np.isclose(getattr(new, p.name), getattr(effect, p.name), rtol=_ALIKE) for p in parameters(new))
        calmer = fit.refit(random=[new if e is effect else e for e in fit.random])
        if alike and calmer.log_likelihood < fit.log_likelihood + _SETTLED_NATS:
            break
        fit, effect = calmer, new
    return fit, effect


def continued(fit: Fit) -> Fit:
    """Return the model with effects of places continued to places that the drives do not reach."""
    effects = [effect.continued(fit.problem.motions) for effect in fit.effects]
    return fit if effects == list(fit.effects) else fit.refit(effects)


def one_heading(fit: Fit, given: Container[str], decisions: Decisions) -> Fit:
    """Return the fit with one source of the heading for all effects: the wheels, unless a gyro gains clearly more.

    A single effect may prefer "gyro" only because two wheel effects cancel in the heading. If a gyro bias is in the
    model, or the odometry turns at rest, no gain is required: heading errors of wheels and a gyro's scale error may be
    the same function, and a robot may hardly turn on a patch. A gyro that gains less is chosen too if the wheels
    increase the drift. With a laser as truth, whose scale is uncertain, the likelihood hardly penalises wheel effects
    that distort travel to leave turns unchanged.

    given : names of effects whose parameters were chosen by the user
    """
    either = [e for e in fit.effects if "heading" in choices(e) and e.name not in given]
    words = {getattr(e, "heading", "") for e in either}
    known = "gyro_bias" in fit.by_name or all(map(turns_at_rest, fit.problem.recordings))
    if heading_source_of(fit.problem.recordings) or not words or ("gyro" not in words and not known):
        return fit
    found: dict[str, Fit] = {}
    # free clocks and robust weights change the likelihood by more than the source of the heading, so both are fixed
    clocked = bool(np.any(fit.free_clocks))
    held = [(False, False)] * len(fit.free_clocks)
    for word in ("wheels", "gyro"):
        same = [replace(e, heading=word) if e in either else e for e in fit.effects]  # type: ignore[type-var]
        if clocked:
            found[word] = fit.refit(same, weights_of=fit, free_clocks=held)
        else:
            found[word] = fit if words == {word} else fit.refit(same)
    least = decisions.known_gyro_nats if known else decisions.unusual_nats
    more = found["gyro"].log_likelihood - found["wheels"].log_likelihood
    if 0.0 < more <= least and drift_grows(drift(found["wheels"]), drift(found["gyro"]), decisions):
        least = 0.0
    better = "gyro" if more > least else "wheels"
    if words == {better}:
        return fit
    return found[better].refit(free_clocks=fit.free_clocks) if clocked else found[better]
