"""Shapes and limits of effects with memory, found at their fitted size.

Shape searches use the columns of a small effect. Those of an effect with memory depend on its size: play is crossed the
later, the larger it is, so that the best track for a play of 4 mm differs from that for one of 9 mm. Limits have no
column at all before the effect has a size.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import shapes
from odomcorrupt.errors import EffectError, FitError
from odomcorrupt.study.estimate.drift_error import drift
from odomcorrupt.study.select.elimination import drift_grows
from odomcorrupt.study.select.score import project_out, score_columns
from odomcorrupt.study.terms.term import LibraryTerm

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.decisions import Decisions
    from odomcorrupt.study.select.score import Score

_MOST_MOVES = 5
"""Largest number of moves; two or three are usual."""
_PARTS = (1.0, 0.5, 0.25)
"""Parts of a move that are tried in turn until the likelihood rises: far from the maximum a whole one goes too far."""
_STEP = 0.02
"""Step of numerical slopes, as a fraction of a shape parameter's typical size."""


def with_shape_at_size(fit: Fit, score: Score, decisions: Decisions) -> tuple[Fit, Score]:
    """Return the fit with the shape of an effect with memory at the maximum of the likelihood, by Gauss-Newton steps.

    score : the term of the effect; fit and score are returned unchanged if no step gains `reshape_nats`
    """
    if not (isinstance(score.term, LibraryTerm) and score.term.remembers and len(score.term.shape)):
        return fit, score
    fit = _at_maximum(fit, score.term.name, decisions)
    (effect,) = (e for e in fit.effects if e.name == score.term.name)
    shape = [getattr(effect, p.name) for p in shapes(effect)]
    return fit, replace(score, term=score.term.with_shape(shape))


def without_optional_shape(fit: Fit, score: Score) -> tuple[Fit, Score]:
    """Return the fit with optional shape parameters of a term left out, if it is likelier so with the same weights.

    They were selected beside the noise of a model without the effect. With a wrong one (a tick whose beats differ) the
    noise remains too large to show a better one.

    score : the term of the effect; fit and score are returned unchanged if nothing is left out
    """
    effect = fit.by_name[score.term.name]
    left_out = {p.name: p.identity for p in shapes(effect) if p.optional}
    plain = replace(effect, **left_out)  # type: ignore[type-var]  # effects are dataclasses
    if plain == effect or not isinstance(score.term, LibraryTerm):
        return fit, score
    without = _refitted(fit, effect, plain, fit)
    if without is None or not without.log_likelihood > fit.log_likelihood:
        return fit, score
    start = replace(score.term.start, **left_out)  # type: ignore[type-var]
    return without.refit(), replace(score, term=replace(score.term, start=start))


def _at_maximum(fit: Fit, name: str, decisions: Decisions, weights_of: Fit | None = None) -> Fit:
    """Return the fit with the shape of one of its effects moved as long as a step gains `reshape_nats`.

    weights_of : fit whose robust weights are kept for comparison; default: re-estimated
    """
    for _ in range(_MOST_MOVES):
        (effect,) = (e for e in fit.effects if e.name == name)
        moves, nats = _moves(fit, effect)
        shaped = None
        if nats > decisions.reshape_nats:
            for part in _PARTS:
                shaped = _refitted(fit, effect, _moved(effect, part * moves), weights_of)
                if shaped is not None and shaped.log_likelihood > fit.log_likelihood + decisions.reshape_nats:
                    break
                shaped = None
        if shaped is None:
            break
        fit = shaped
    return fit


def _refitted(fit: Fit, effect: Effect, moved: Effect, weights_of: Fit | None) -> Fit | None:
    """Return the fit with an effect replaced; None if it is too far off to start from, or lacks its track."""
    try:
        return fit.refit([moved if e is effect else e for e in fit.effects], weights_of=weights_of)
    except (FitError, EffectError):
        return None


def with_limit(fit: Fit, name: str, decisions: Decisions) -> Fit:
    """Return the fit with a limit (an optional shape) of one of its effects, refined; unchanged if it has none.

    Trial values are tested as single columns, the change from the unlimited effect. The best is refitted with the same
    robust weights, and moved to the maximum of the likelihood. It has to gain the penalty of its additional parameter
    and of the number of trials. Then those of the limited effect are tried.
    """
    effect = fit.by_name[name]
    trials = effect.limited(fit.problem.motions)
    if not trials:
        return fit
    scores = score_columns(fit, [fit.problem.replacement(effect, trial) for trial in trials])
    best = max(range(len(trials)), key=lambda i: scores[i].statistic if scores[i].estimate[0] > 0.0 else 0.0)
    more = len(shapes(trials[best])) - len(shapes(effect))
    penalty_nats = 0.5 * more * float(np.log(len(fit.problem.intervals))) + float(np.log(len(trials)))
    if not (scores[best].significant(decisions.level) and 0.5 * scores[best].statistic > penalty_nats):
        return fit
    found = _limited(fit, effect, [trials[best]], penalty_nats, decisions)
    if found is None:
        return fit
    (effect,) = (e for e in found.effects if e.name == name)
    further = effect.limited(fit.problem.motions)
    if not further:
        return found
    # its limit changes with it, so that it has no single column
    penalty_nats = 0.5 * float(np.log(len(fit.problem.intervals))) + float(np.log(len(further)))
    return _limited(found, effect, further, penalty_nats, decisions) or found


def _limited(
    fit: Fit, effect: Effect, trials: Sequence[Effect], penalty_nats: float, decisions: Decisions
) -> Fit | None:
    """Return the fit with the likeliest trial limit of an effect, refined; None if it gains less than its penalty."""
    tried = [one for one in (_refitted(fit, effect, trial, fit) for trial in trials) if one is not None]
    if not tried:
        return None
    found = _at_maximum(max(tried, key=lambda one: one.log_likelihood), effect.name, decisions, fit)
    gain = found.log_likelihood - fit.log_likelihood - penalty_nats
    if gain <= decisions.reshape_nats or drift_grows(drift(found), drift(fit), decisions):
        return None
    return found.refit()


def _moves(fit: Fit, effect: Effect) -> tuple[Array, float]:
    """Return the changes (s,) of an effect's shape to its largest likelihood, to first order, and the gain, nats."""
    own = [p._replace(step=_STEP * p.typical) for p in shapes(effect)]
    rest = project_out(fit)
    white = rest.of(fit.noise.whitener.whiten(fit.problem.columns(effect, own)))
    moves = np.linalg.lstsq(white, rest.residual, rcond=None)[0].astype(np.float64)
    return moves, 0.5 * float((white @ moves) @ rest.residual)


def _moved(effect: Effect, moves: Array) -> Effect:
    """Return an effect with its shape changed by `moves` (s,), within bounds."""
    own = zip(shapes(effect), moves, strict=True)
    values = {p.name: float(np.clip(getattr(effect, p.name) + move, p.low, p.high)) for p, move in own}
    return replace(effect, **values)  # type: ignore[type-var]  # effects are dataclasses
