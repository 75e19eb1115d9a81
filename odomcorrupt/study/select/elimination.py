"""What leaves a model again: terms that later ones have made redundant, and one of two sources of the heading."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import choices, parameters
from odomcorrupt.study.estimate.random_process import CORRELATED_NOISE
from odomcorrupt.study.select.random_effects import is_remainder, remeasured
from odomcorrupt.study.select.score import score_terms
from odomcorrupt.study.terms.heading_source import heading_source_of
from odomcorrupt.study.terms.term import LibraryTerm

if TYPE_CHECKING:
    from collections.abc import Container

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.decisions import Decisions
    from odomcorrupt.study.select.random_effects import RandomCoefficient

__all__ = [
    "absorb",
    "backward_eliminate",
    "drop_term",
    "eliminate_random",
    "eliminate_untested",
    "iterate",
    "one_heading",
    "without_redundant",
]

_ITERATIONS, _ALIKE = 6, 0.03
"""Most iterations of a random coefficient beside the rest of the noise, and the relative change that ends them."""


def drop_term(fit: Fit, effect: Effect) -> Fit:
    """Return the fit without one of its effects: what it explains is in the residual again, its columns are not free.

    To first order, and with the noise as it is with the effect: to test what might stand in its place.
    """
    explained = fit.noise.whitener.whiten(fit.problem.explained(effect))
    noise = replace(fit.noise, innovations=fit.noise.innovations + explained)
    others = tuple(e for e in fit.effects if e is not effect)
    return replace(fit, noise=noise, problem=replace(fit.problem, effects=others, left=()))


def backward_eliminate(fit: Fit, keep: Container[str], decisions: Decisions) -> Fit:
    """Return the fit without the effects that later ones have made redundant, by Wald tests, the least first.

    keep : names of effects that stay in any case
    """
    while fit.effects:
        gains = {name: 0.5 * square for name, square in fit.wald.items() if name not in keep}
        least = min(gains, key=gains.__getitem__, default=None)
        if least is None or gains[least] >= decisions.drop_nats:
            return fit
        fit = fit.refit([e for e in fit.effects if e.name != least])
    return fit


def absorb(fit: Fit, keep: Container[str], decisions: Decisions) -> Fit:
    """Return the fit whose effects act as a whole, without what that makes redundant; the same if nothing is.

    Of a wheel with a flat side, a smaller radius is a part, and no cause beside it.
    """
    whole = [effect.whole() for effect in fit.effects]
    if whole == list(fit.effects):
        return fit
    fewer = backward_eliminate(fit.refit(whole), keep, decisions)
    lost = len(fit.effects) - len(fewer.effects)
    return fewer if fit.log_likelihood - fewer.log_likelihood < decisions.drop_nats * lost else fit


def without_redundant(fit: Fit, keep: Container[str], decisions: Decisions) -> Fit:
    """Return the fit without what its last term made redundant, and with effects that act as a whole."""
    return absorb(backward_eliminate(fit, keep, decisions), keep, decisions)


def eliminate_untested(fit: Fit, keep: Container[str], decisions: Decisions) -> Fit:
    """Return the fit whose effects of the library each explain more than their penalty beside all of the rest.

    What came early was tested beside little, and may be nothing but what a later term, or the law of a cause without a
    name, explains in full. Blocks of the drive say what a likelihood is worth, as they do at inclusion; but what was
    plain once leaves only where nothing is left of it. The least goes first, and the others are tested again.

    keep : names of effects that stay in any case
    """
    while True:
        failing = []
        for effect in fit.effects:
            if effect.name in keep or effect.name not in registry():
                continue
            term = LibraryTerm.of(effect, fit.problem.motions)
            (score,) = score_terms(drop_term(fit, effect), [term], decisions)
            if not score.robust_nats > 0.0:
                failing.append((score.robust_nats, effect.name))
        if not failing:
            return fit
        fit = fit.refit([e for e in fit.effects if e.name != min(failing)[1]])


def eliminate_random(
    named: list[RandomCoefficient], fit: Fit, decisions: Decisions
) -> tuple[list[RandomCoefficient], Fit]:
    """Return named random effects and the fit without random coefficients, where a later term made them redundant."""
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
    """Return a fit with a random coefficient, both estimated in turn until neither changes, and the coefficient."""
    for _ in range(_ITERATIONS):
        new = remeasured(fit, effect)
        if all(np.isclose(getattr(new, p.name), getattr(effect, p.name), rtol=_ALIKE) for p in parameters(new)):
            break
        random = [new if e is effect else e for e in fit.random]
        fit, effect = fit.refit(random=random), new
    return fit, effect


def one_heading(fit: Fit, given: Container[str], decisions: Decisions) -> Fit:
    """Return the fit whose effects agree on the source of the heading: the wheels, unless a gyro explains plainly more.

    One effect by itself may say "gyro" where two of the wheels' only make up for each other in the heading. Where a
    gyro's bias is in the model there is a gyro, and it need not explain more: what wheels do to the heading and what a
    gyro's scale does may be one and the same.

    given : names of effects whose words a user has chosen
    """
    either = [e for e in fit.effects if "heading" in choices(e) and e.name not in given]
    words = {getattr(e, "heading", "") for e in either}
    known = any(e.name == "gyro_bias" for e in fit.effects)
    if heading_source_of(fit.problem.recordings) or not words or ("gyro" not in words and not known):
        return fit
    found: dict[str, Fit] = {}
    # a clock that strays between two samples, and robust weights with it, move the likelihood by more than the word
    clocked = bool(np.any(fit.free_clocks))
    held = [(False, False)] * len(fit.free_clocks)
    for word in ("wheels", "gyro"):
        same = [replace(e, heading=word) if e in either else e for e in fit.effects]  # type: ignore[type-var]
        if clocked:
            found[word] = fit.refit(same, weights=fit.noise.weights, free_clocks=held)
        else:
            found[word] = fit if words == {word} else fit.refit(same)
    least = decisions.known_gyro_nats if known else decisions.unusual_nats
    better = "gyro" if found["gyro"].log_likelihood > found["wheels"].log_likelihood + least else "wheels"
    if words == {better}:
        return fit
    return found[better].refit(free_clocks=fit.free_clocks) if clocked else found[better]
