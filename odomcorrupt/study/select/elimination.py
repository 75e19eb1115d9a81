"""Backward elimination: terms made redundant by later ones."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import on_bound, parameters
from odomcorrupt.study.estimate.random_process import CORRELATED_NOISE
from odomcorrupt.study.select.random_effects import remeasured

if TYPE_CHECKING:
    from collections.abc import Container

    from odomcorrupt.effects.effect import Effect
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


def eliminate_random(
    named: list[DetectedRandomEffect], fit: Fit, decisions: Decisions
) -> tuple[list[DetectedRandomEffect], Fit]:
    """Return named random effects and the fit, both without random coefficients that a later term made redundant."""
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
