"""Shapes of effects with memory, refined at their fitted size.

Shape searches use the columns of a small effect. Those of an effect with memory depend on its size: play is crossed the
later, the larger it is, so that the best track for a play of 4 mm differs from that for one of 9 mm.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import shapes
from odomcorrupt.errors import FitError
from odomcorrupt.study.select.score import project_out
from odomcorrupt.study.terms.term import LibraryTerm

if TYPE_CHECKING:
    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.decisions import Decisions
    from odomcorrupt.study.select.score import Score

_MOST_MOVES = 5
"""Largest number of moves; two or three are usual."""
_STEP = 0.02
"""Step of numerical slopes, as a fraction of a shape parameter's typical size."""


def with_shape_at_size(fit: Fit, score: Score, decisions: Decisions) -> tuple[Fit, Score]:
    """Return the fit with the shape of an effect with memory at the maximum of the likelihood, by Gauss-Newton steps.

    score : the term of the effect; fit and score are returned unchanged if no step gains `reshape_nats`
    """
    if not (isinstance(score.term, LibraryTerm) and score.term.remembers and len(score.term.shape)):
        return fit, score
    for _ in range(_MOST_MOVES):
        effect = next(e for e in fit.effects if e.name == score.term.name)
        moved, nats = _moved(fit, effect)
        if nats <= decisions.reshape_nats:
            break
        try:
            shaped = fit.refit([moved if e is effect else e for e in fit.effects])
        except FitError:  # too far off to start from
            break
        if not shaped.log_likelihood > fit.log_likelihood + decisions.reshape_nats:
            break
        shape = [getattr(moved, p.name) for p in shapes(moved)]
        fit, score = shaped, replace(score, term=score.term.with_shape(shape))
    return fit, score


def _moved(fit: Fit, effect: Effect) -> tuple[Effect, float]:
    """Return an effect of a fit at the shape with the largest likelihood to first order, and the gain there, nats."""
    own = [p._replace(step=_STEP * p.typical) for p in shapes(effect)]
    rest = project_out(fit)
    white = rest.of(fit.noise.whitener.whiten(fit.problem.columns(effect, own)))
    moves = np.linalg.lstsq(white, rest.residual, rcond=None)[0]
    values = {
        p.name: float(np.clip(getattr(effect, p.name) + d, p.low, p.high)) for p, d in zip(own, moves, strict=True)
    }
    nats = 0.5 * float((white @ moves) @ rest.residual)
    return replace(effect, **values), nats  # type: ignore[type-var]  # effects are dataclasses
