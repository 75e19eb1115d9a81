"""Joint fit of a whole model: effects, clocks, noise coefficients and truth noise.

Gauss-Newton on the systematic part, with the noise refitted at every iteration. Effects and clocks are removed from
the data exactly at their current values; a linear step follows, until steps are small against their standard errors.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.errors import RecordingError
from odomcorrupt.study.estimate.intervals import LEAST_INTERVALS
from odomcorrupt.study.estimate.noise_likelihood import VarianceComponents, pseudo_inverse
from odomcorrupt.study.estimate.problem import pose_problem
from odomcorrupt.study.estimate.random_process import CORRELATED_NOISE, fit_noise_beside
from odomcorrupt.study.io.clock import Clock, as_rows, clock_leaders, led

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.config import Approach
    from odomcorrupt.study.estimate.noise_likelihood import NoiseFit
    from odomcorrupt.study.estimate.problem import Problem
    from odomcorrupt.study.io.recording import Recording

_ROUNDS = 6
_NEAR, _SMALL = 2.0, 0.1
"""Step sizes in standard errors below which the robust weights are kept, and below which the iteration ends."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """A fitted model of some recordings.

    components : the noise law's covariances on the problem's intervals
    problem : the recordings with the fitted effects and clocks removed; nothing linear is left in its residual
    random : random coefficients in the model
    noise : coefficients, truth noise, innovations and likelihood
    standard_errors : (p,) of the effects' amplitudes, in order; shapes are not fitted
    clock_errors : (R, 2) standard errors of the clocks' offsets and rates; 0 if a clock was not free
    free_clocks : (R, 2) whether offset and rate of each recording's clock were free
    next_effects, next_clocks : after the last step, which is small and not yet applied to the problem
    """

    problem: Problem
    components: VarianceComponents
    noise: NoiseFit
    random: tuple[Effect, ...]
    standard_errors: Array
    clock_errors: Array
    free_clocks: tuple[tuple[bool, bool], ...]
    next_effects: tuple[Effect, ...]
    next_clocks: tuple[Clock, ...]

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The fitted effects."""
        return self.problem.effects

    @property
    def by_name(self) -> dict[str, Effect]:
        """The fitted effects by their names."""
        return {effect.name: effect for effect in self.effects}

    @property
    def log_likelihood(self) -> float:
        """Log likelihood in nats."""
        return self.noise.log_likelihood

    @cached_property
    def design_matrix(self) -> Array:
        """Columns (K, 3, q) of all free linear parameters: the effects' amplitudes first, then clocks."""
        return design_matrix(self.problem, self.free_clocks)

    @cached_property
    def span(self) -> Array:
        """Orthonormal basis (3 K, q) of the whitened design matrix."""
        return orthonormal(self.noise.whitener.whiten(self.design_matrix))

    def for_reports(self) -> Fit:
        """Return the fit without the data that only refits and tests need."""
        return dataclasses.replace(self, problem=dataclasses.replace(self.problem, smoothers=(), left=()))

    def refit(
        self,
        effects: Sequence[Effect] | None = None,
        *,
        random: Sequence[Effect] | None = None,
        weights_of: Fit | None = None,
        clocks: Sequence[Clock] | None = None,
        free_clocks: Sequence[tuple[bool, bool]] | None = None,
    ) -> Fit:
        """Return a fit of the same recordings, started from this one's clocks and noise.

        effects, random : systematic effects at their starting values, and random ones; default those of this fit
        weights_of : fit whose robust weights are kept, so that likelihoods can be compared; default: re-estimated
        clocks : (R,) starting values of the clocks, kept for those that are not free
        free_clocks : (R, 2) whether offset and rate are free; default: as in this fit
        """
        systematic, random = _kinds(
            self.effects if effects is None else effects, self.random if random is None else random
        )
        return fit_problem(
            self.problem.at(systematic, clocks),
            self.free_clocks if free_clocks is None else free_clocks,
            random=random,
            start=self.noise.free,
            weights_of=weights_of,
        )

    def with_noise_refitted(self, random: Sequence[Effect]) -> Fit:
        """Return the fit with other random coefficients, only its noise estimated again, with the same weights."""
        noise = fit_noise_beside(
            self.problem, self.components, self.design_matrix, random, start=self.noise.free, weights=self.noise.weights
        )
        return dataclasses.replace(self, noise=noise, random=tuple(random))

    @property
    def size_errors(self) -> dict[str, float]:
        """Size of each effect in standard errors, of its amplitude that is farthest from the identity."""
        errors = iter(np.maximum(self.standard_errors, 1e-30).tolist())
        return {
            e.name: max(abs(getattr(e, p.name) - p.identity) / next(errors) for p in amplitudes(e))
            for e in self.effects
        }


def fit(
    recordings: Sequence[Recording],
    effects: Sequence[Effect] = (),
    *,
    approach: Approach,
    clocks: Sequence[Clock] | None = None,
    free_clocks: Sequence[tuple[bool, bool]] | None = None,
    random: Sequence[Effect] = (),
    start: Array | None = None,
) -> Fit:
    """Return the fit of effects (starting at their present values), the clocks' free offsets and rates, and the noise.

    approach : intervals, side of the regressors and noise law
    clocks, free_clocks : clock of each recording, and whether offset and rate are free; default: right and known
    random : random coefficients in the model, with their parameters
    start : noise to start from, of an earlier fit of the same recordings
    """
    systematic, random = _kinds(effects, random)
    problem = pose_problem(recordings, systematic, clocks, approach=approach)
    return fit_problem(problem, free_clocks, random=random, start=start)


def _kinds(effects: Sequence[Effect], random: Sequence[Effect]) -> tuple[list[Effect], list[Effect]]:
    """Return the systematic effects, and all random ones."""
    return [e for e in effects if e.kind != "noise"], [*random, *(e for e in effects if e.kind == "noise")]


def fit_problem(
    problem: Problem,
    free_clocks: Sequence[tuple[bool, bool]] | None = None,
    *,
    random: Sequence[Effect] = (),
    start: Array | None = None,
    weights_of: Fit | None = None,
    nearly: bool = False,
    held: Array | None = None,
) -> Fit:
    """Return the fit that begins with the effects and clocks of a problem, see `fit`.

    random : random effects in the model, never estimated here: coefficients are included with their given parameters;
        slip bursts allow any number of outliers
    weights_of : fit of the same recordings whose robust weights are kept, at whatever clocks; default: re-estimated
    nearly : end at a step within two standard errors, see `Fit.next_effects`; for callers that do not use the residuals
    held : (p,) standard deviations of a normal prior of the effects' amplitudes at their values in the problem;
        infinite for those without one; default: no prior

    Raises
    ------
    RecordingError
        If the recordings have too few intervals together.
    """
    if len(problem.intervals) < LEAST_INTERVALS:
        names = ", ".join(recording.name for recording in problem.recordings)
        raise RecordingError(
            f"{names}: only {len(problem.intervals)} stretches of {problem.approach.spacing_s:g} s have both odometry "
            f"and truth; {LEAST_INTERVALS} are needed: record longer, or check both clocks"
        )
    begun = problem.effects
    coefficients = tuple(e for e in random if e.name in CORRELATED_NOISE)
    bursts = any(e.name == "slip_burst" for e in random)
    recordings, approach = problem.recordings, problem.approach
    effects, clocks = problem.effects, problem.clocks
    leaders = clock_leaders(recordings)
    free = np.array(free_clocks if free_clocks is not None else [(False, False)] * len(recordings))
    own_free = led(free, leaders)
    weights, weighted = (None, problem) if weights_of is None else (weights_of.noise.weights, weights_of.problem)
    for i in range(_ROUNDS):
        problem = problem.at(effects, clocks) if i else problem
        if weights is not None:
            weights = _carried(weights, weighted, problem)
        columns = design_matrix(problem, free)
        components = VarianceComponents(approach.law, problem.intervals, problem.steps, gyro_noise=approach.gyro_noise)
        noise = fit_noise_beside(
            problem, components, columns, coefficients, start=start, weights=weights, bursts=bursts
        )
        start, weighted = noise.free, problem
        errors = np.sqrt(np.maximum(np.diag(noise.theta_covariance), 0.0))
        whole = noise.theta
        if held is not None:  # to the maximum of likelihood times prior
            away = _made(begun, effects, np.zeros(len(whole)))
            precision = np.diag(np.append(held**-2.0, np.zeros(len(away) - len(held))))
            normal = pseudo_inverse(noise.theta_covariance)
            whole = pseudo_inverse(normal + precision) @ (normal @ whole - precision @ away)
        effects, change = moved(effects, whole), np.zeros(free.shape)
        change[own_free] = whole[len(whole) - int(own_free.sum()) :]
        rows = (as_rows(clocks) + change).tolist()
        clocks = tuple(Clock(*rows[leader]) for leader in leaders)
        step = _made(problem.effects, effects, whole)
        if not np.any(np.abs(step) > (_NEAR if nearly else _SMALL) * errors):
            break
        if not np.any(np.abs(step) > _NEAR * errors):
            # this close to convergence, the set of outliers no longer changes
            weights = noise.weights
    own = sum(len(amplitudes(e)) for e in effects)
    clock_errors = np.zeros(free.shape)
    clock_errors[own_free] = errors[own:]
    return Fit(
        problem=problem,
        components=components,
        noise=noise,
        random=coefficients,
        standard_errors=errors[:own],
        clock_errors=clock_errors[leaders],
        free_clocks=tuple((bool(offset), bool(rate)) for offset, rate in free),
        next_effects=effects,
        next_clocks=clocks,
    )


def prior_deviations(effects: Sequence[Effect]) -> Array:
    """Return the standard deviations (p,) of the normal prior of the effects' amplitudes: twice their typical sizes.

    For `fit_problem`: without a prior, a scale that the data do not show ends anywhere within its bounds.
    """
    return np.array([2.0 * p.typical for effect in effects for p in amplitudes(effect)])


def design_matrix(problem: Problem, free_clocks: Sequence[tuple[bool, bool]] | Array) -> Array:
    """Return the columns (K, 3, q) of all free linear parameters: effects first, then clocks."""
    free = led(np.asarray(free_clocks), clock_leaders(problem.recordings))
    parts = [problem.columns(effect) for effect in problem.effects]
    if free.any():
        parts.append(problem.clock_columns()[:, :, free.ravel()])
    return np.concatenate(parts, axis=2) if parts else np.zeros((len(problem.intervals), 3, 0))


def orthonormal(white: Array) -> Array:
    """Return an orthonormal basis (n, c) of the space spanned by columns (n, c)."""
    return np.linalg.qr(white)[0] if white.shape[1] else white


def _carried(weights: Array, before: Problem, now: Problem) -> Array:
    """Return robust weights (K,) transferred to the current nodes: a clock step may add, remove or shift nodes."""
    if np.array_equal(before.intervals.start_s, now.intervals.start_s):
        return weights
    carried = np.ones(len(now.intervals))
    for r in range(len(now.recordings)):
        old, new = np.flatnonzero(before.run == r), np.flatnonzero(now.run == r)
        middle = (before.intervals.start_s[old] + before.intervals.end_s[old]) / 2.0
        wanted = (now.intervals.start_s[new] + now.intervals.end_s[new]) / 2.0
        right = np.clip(np.searchsorted(middle, wanted), 1, len(middle) - 1)
        nearest = right - (wanted - middle[right - 1] < middle[right] - wanted)
        carried[new] = weights[old[nearest]]
    return carried


def _made(before: Sequence[Effect], after: Sequence[Effect], theta: Array) -> Array:
    """Return the parameter steps as applied: a parameter at its bound moves no farther."""
    own = [(getattr(a, p.name) - getattr(b, p.name)) for b, a in zip(before, after, strict=True) for p in amplitudes(b)]
    return np.concatenate((np.array(own, dtype=np.float64), theta[len(own) :]))


def moved(effects: Sequence[Effect], theta: Array) -> tuple[Effect, ...]:
    """Return the effects after a step, whose first values are those of their amplitudes, within their bounds."""
    step = iter(theta.tolist())
    after = []
    for effect in effects:
        values = {
            p.name: float(np.clip(getattr(effect, p.name) + next(step), p.low, p.high)) for p in amplitudes(effect)
        }
        after.append(dataclasses.replace(effect, **values))  # type: ignore[type-var]
    return tuple(after)
