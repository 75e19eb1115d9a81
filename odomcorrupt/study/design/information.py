"""Expected information of a drive: regressor columns of planned manoeuvres, whitened with the noise of the fit.

The expected log likelihood ratio between A and the best-fitting B is half the squared norm of the whitened residuals
caused by A, after projection orthogonal to the columns of B and of all free parameters (clocks and included effects).
Columns of recorded and planned drives are stacked, so that existing information counts. A clock belongs to one drive.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import block_diag

from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.study.design.plan import ideal_recording
from odomcorrupt.study.estimate.problem import pose_problem
from odomcorrupt.study.estimate.random_process import with_random
from odomcorrupt.study.estimate.whitener import whitener
from odomcorrupt.study.io.headings import UNKNOWN_RAD

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.design.plan import Plan
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.estimate.problem import Problem
    from odomcorrupt.study.estimate.whitener import Whitener


@dataclass(frozen=True, slots=True)
class Field:
    """A recorded or planned drive, with the whitener of its residuals.

    clocks : (3 K, c) whitened columns of its clock's free parameters
    """

    problem: Problem
    whitener: Whitener
    clocks: Array
    _known: dict[Effect, Array] = field(init=False, default_factory=dict, repr=False)
    """Cache of whitened columns by effect, because few are used again and again."""

    def white(self, effects: Sequence[Effect]) -> Array:
        """Return whitened columns (3 K, p) of the amplitudes of several effects."""
        parts = [np.zeros((3 * len(self.problem.intervals), 0))]
        for effect in (one for one in effects if amplitudes(one)):
            if effect not in self._known:
                self._known[effect] = self.whitener.whiten(self.problem.columns(effect))
            parts.append(self._known[effect])
        return np.concatenate(parts, axis=1)


def recorded_field(fit: Fit) -> Field:
    """Return the fitted drives as one field: their problem, whitener, and columns of the free clocks."""
    own, white = sum(len(amplitudes(e)) for e in fit.problem.effects), fit.noise.whitener
    clocks = fit.design_matrix[:, :, own:]
    return Field(fit.problem, white, white.whiten(clocks) if clocks.size else np.zeros((3 * len(clocks), 0)))


def planned_field(fit: Fit, plan: Plan) -> Field:
    """Return a planned drive, with the noise of the fit and a clock with free offset and rate."""
    problem = pose_problem([ideal_recording(plan, fit.problem.recordings[0])], approach=fit.problem.approach)
    truth = fit.noise.truth if fit.problem.headings else replace(fit.noise.truth, yaw_rad=UNKNOWN_RAD)
    q = problem.intervals.covariance(fit.problem.approach.law, fit.noise.coefficients, problem.steps)
    clocks = problem.clock_columns()
    noise = replace(fit.noise, whitener=whitener(problem.intervals, q, truth))
    white = with_random(noise, problem, clocks, fit.random).whitener
    return Field(problem, white, white.whiten(clocks))


def separation(
    one: Sequence[Effect], other: Sequence[Effect], beside: Sequence[Effect], fields: Sequence[Field]
) -> float:
    """Return the expected log likelihood ratio, nats, in favour of effects with their present amplitudes if true.

    other : effects of the alternative
    beside : effects that are free in both models
    """
    away = np.array([getattr(effect, p.name) - p.identity for effect in one for p in amplitudes(effect)])
    signal, rest = _stacked(one, (*other, *beside), fields)
    return 0.5 * float(np.sum(_without(rest, signal @ away) ** 2))


def sizes(effect: Effect, beside: Sequence[Effect], fields: Sequence[Field]) -> Array:
    """Return standard errors (p,) of an effect's amplitudes, others `beside` it free, of all drives; inf if unknown."""
    signal, rest = _stacked((effect,), beside, fields)
    left = _without(rest, signal)
    scale = np.sqrt(np.maximum(np.sum(signal**2, axis=0), 1e-300))
    normal = (left / scale).T @ (left / scale)
    if not signal.any() or np.linalg.eigvalsh(normal)[0] < 1e-8:
        return np.full(signal.shape[1], np.inf)
    return np.sqrt(np.diag(np.linalg.inv(normal))) / scale


def _stacked(own: Sequence[Effect], beside: Sequence[Effect], fields: Sequence[Field]) -> tuple[Array, Array]:
    """Return columns of `own` and of all other parameters: drives stacked, clocks block-diagonal."""
    signal, shared = (np.concatenate([field.white(some) for field in fields]) for some in (own, beside))
    return signal, np.concatenate((shared, block_diag(*(field.clocks for field in fields))), axis=1)


def _without(rest: Array, signal: Array) -> Array:
    """Return the projection of signals (n,) or (n, p) orthogonal to columns (n, q)."""
    rest = rest[:, np.abs(rest).max(axis=0, initial=0.0) > 0.0]
    if not rest.shape[1]:
        return signal
    unit = rest / np.linalg.norm(rest, axis=0)
    u, size, _ = np.linalg.svd(unit, full_matrices=False)
    basis = u[:, size > 1e-8 * size[0]]
    return signal - basis @ (basis.T @ signal)
