"""Laws that may be believed: where nothing known explains more, or instead of a name that only stood in for one."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.study.estimate.drift_error import drift
from odomcorrupt.study.select.basis_columns import topmost
from odomcorrupt.study.select.model_comparison import ALTERNATIVE_NATS, CHALLENGE_NATS, drop_term
from odomcorrupt.study.select.screening import QuickLook

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.basis_scores import ScoredLaw
    from odomcorrupt.study.select.dependence import Unknown
    from odomcorrupt.study.select.model_comparison import Rivalry

__all__ = ["Lawful", "believable", "challenger"]

_TRIED = 4
_WORTH_NATS = 1.0
"""What a new shape has to gain."""


class Lawful(NamedTuple):
    """A dependence whose law may be believed, the fit with it, and the nats that it gains, prices paid."""

    law: Unknown
    fit: Fit
    nats: float


def believable(fitted: Fit, unknown: Sequence[Unknown]) -> Lawful | None:
    """Return the plainest dependence whose law gains and does not spoil the path; of some as plain, as fits say."""
    have = {effect.name for effect in fitted.effects}
    lawful = [(one, one.law) for one in unknown if one.law is not None and one.law.effect.name not in have]
    best, plainest = None, -np.inf
    for one, law in lawful[:_TRIED]:
        if one.nats < plainest - ALTERNATIVE_NATS:
            break
        form, with_it = _reshaped(*_best_form(fitted, law))
        gain = with_it.log_likelihood - fitted.log_likelihood - form.price
        if gain > max(0.0, best.nats if best else 0.0) and not drift(with_it).worse_than(drift(fitted)):
            said = one if form is law else replace(one, law=form, expression=form.expression)
            best, plainest = Lawful(said, with_it, gain), max(plainest, one.nats)
    return best


def _best_form(fitted: Fit, law: ScoredLaw) -> tuple[ScoredLaw, Fit]:
    """Return the form of a law that explains most when everything is fitted with it, and that fit."""
    have = {effect.name for effect in fitted.effects}
    forms = [form for form in (law, *law.others) if form.effect.name not in have]
    fits = [(form, fitted.refit((*fitted.effects, form.effect))) for form in forms]
    return max(fits, key=lambda found: found[1].log_likelihood - found[0].price)


def _reshaped(form: ScoredLaw, with_it: Fit) -> tuple[ScoredLaw, Fit]:
    """Return a law and its fit with the shape looked for anew, now that what it explains is no noise any more."""
    effect = next(e for e in with_it.effects if e.name == form.effect.name)
    bare, believed = drop_term(with_it, effect)
    law, action = topmost(bare, believed, *QuickLook(bare, believed).around(form.law, form.action))
    moved = replace(form, law=law, action=action)
    if (law.shape, action) == (form.law.shape, form.action):
        return form, with_it
    others = [e for e in with_it.effects if e is not effect]
    shaped = with_it.refit((*others, moved.effect))
    return (moved, shaped) if shaped.log_likelihood > with_it.log_likelihood + _WORTH_NATS else (form, with_it)


def challenger(fitted: Fit, rivalries: Mapping[str, Rivalry]) -> Lawful | None:
    """Return a law that explains plainly more than a known effect which was added, believed in its place."""
    for effect in fitted.effects:
        if effect.name not in rivalries:
            continue
        own, others = rivalries[effect.name], [e for e in fitted.effects if e is not effect]
        best = None
        for one, law in own.better_laws():
            if law.effect.name in {e.name for e in others}:
                continue
            with_it = fitted.refit((*others, law.effect))
            gain = with_it.log_likelihood - fitted.log_likelihood - law.price + own.price
            least = best.nats if best else CHALLENGE_NATS
            if gain > least and not drift(with_it).worse_than(drift(fitted)):
                best = Lawful(one, with_it, gain)
        if best is not None:
            return best
    return None
