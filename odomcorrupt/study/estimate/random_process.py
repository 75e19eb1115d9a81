"""Random coefficients as Gaussian processes over the intervals: their columns, and a whitener that includes them.

The variation that they explain must not be counted again as noise of each step. The process is drawn from its posterior
and subtracted, and the noise of the rest is fitted, over a few iterations. A draw, unlike the posterior mean, leaves
the right amount of noise: stochastic EM (Celeux & Diebolt 1985, Computational Statistics Quarterly 2, section 2).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import block_diag, csr_array, diags_array, hstack

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import stacked
from odomcorrupt.study.estimate.noise_likelihood import DEAD, NoiseLikelihood, fit_noise, with_residual
from odomcorrupt.study.estimate.truth_bias import SHARED, bias_roots, bias_steps, has_bias
from odomcorrupt.study.estimate.whitener import KnotPosterior, band_factor, band_solve, sparse_band

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from odomcorrupt.effects.effect import Effect, Motion
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.intervals import Intervals
    from odomcorrupt.study.estimate.noise_likelihood import NoiseFit, VarianceComponents
    from odomcorrupt.study.estimate.problem import Problem
    from odomcorrupt.study.estimate.whitener import Whitener

CORRELATED_NOISE = ("gauss_markov", "gyro_bias_walk")
"""Names of the random coefficients: effects that are part of a fit's covariance."""
_TAUS_S, _STEP = (2.0, 5.0, 15.0, 40.0), 1.5
"""Correlation times that are tried, s, and the ratio of a neighbour to the best one. Those of a bias are not below the
second: that of a gyro is tens of seconds or more (the minimum of its Allan deviation, Woodman 2007), a shorter one
hardly separable from noise of each step."""
_MOST_KNOTS = 400
_COARSELY, FINELY = 2.0, 8.0
"""Knots per correlation time: few suffice to detect a process, more show how rough it is."""
_LEAST_SCALE = 1e-9
_WALK_S = 20.0
_BREAK_S = 1e3
_MOST_ROUNDS, _SETTLED = 8, 0.03
"""Largest number of draws of a process, and the change of a log coefficient at which they end: about as large as the
scatter between draws."""
_SEED = 20261121


def part_name(effect: Effect) -> str:
    """Return the name of a part of a model; of a random coefficient with its channel, because it may have several."""
    channel = getattr(effect, "channel", "") if effect.kind == "noise" else ""
    return f"{effect.name} ({channel})" if channel else effect.name


@dataclass(frozen=True, slots=True)
class Knots:
    """Values of a process at its knots, which are normal with zero mean, and their contributions to the residuals.

    spread : S (3 K, k), contribution of each knot to each residual, sparse
    precision : Q (k, k), inverse of the prior covariance of the values, sparse
    time_s : (k,) times of the knots
    """

    spread: csr_array
    precision: csr_array
    time_s: Array

    @property
    def mixing(self) -> Array:
        """Root M (k, k) of the prior covariance, for independent standard normal factors."""
        return prior_root(self.precision)

    @property
    def columns(self) -> Array:
        """Root S M (3 K, k) of the process's covariance."""
        return self.spread @ self.mixing


@dataclass(frozen=True, slots=True)
class Process:
    """A gain or bias as a Gaussian process.

    kind, fixed : the effect that it becomes in a model file, and the parameters given
    scale : name of the effect's parameter that is the process's scale
    unit : function that returns the error twist (n, 3) of a unit gain
    tau : correlation time, s; None for a random walk of unit density
    variance : stationary variance at scale 1
    numbers : number of parameters that the penalty counts; a mean-reverting bias has one more than a walk
    """

    kind: type[Effect]
    fixed: dict[str, str | float]
    scale: str
    unit: Callable[[Motion], Array]
    tau: float | None
    variance: float = 1.0
    numbers: int = 2

    @property
    def memory_s(self) -> float:
        """Time for which knots are placed, s: the correlation time, or one that resolves a random walk."""
        return _WALK_S if self.tau is None else self.tau


def fit_noise_beside(
    problem: Problem,
    components: VarianceComponents,
    columns: Array,
    random: Sequence[Effect],
    *,
    start: Array | None = None,
    weights: Array | None = None,
    bursts: bool = False,
) -> NoiseFit:
    """Return the noise fitted to the residuals without the random coefficients' part; see `fit_noise` for the rest.

    The covariance of the result includes the random coefficients and the truth's bias, see `with_random`.
    """
    intervals, headings, free = problem.intervals, problem.headings, columns
    if has_bias(problem):
        free = np.concatenate((columns, bias_roots(problem)[:, :, :SHARED], *bias_steps(problem)), axis=2)
    if not random or start is None:
        noise = fit_noise(intervals, components, free, headings=headings, start=start, weights=weights, bursts=bursts)
    else:
        even = np.ones(len(intervals)) if weights is None else weights
        noise = NoiseLikelihood(intervals, components, free, even, headings=headings).evaluate(start)
    if not random:
        return with_random(noise, problem, columns, ())
    knots = joined([knots_of(effect, problem) for effect in random])
    for normal in _normals(knots):
        before = noise.free
        rest = replace(intervals, residual=intervals.residual - _drawn(noise, problem, free, knots, normal))
        noise = fit_noise(rest, components, free, headings=headings, start=before, weights=weights, bursts=bursts)
        weights = noise.weights
        plain = before > np.log(DEAD)
        if np.abs(noise.free - before)[plain].max(initial=0.0) < _SETTLED:
            break
    return with_random(noise, problem, columns, random)


def without_process(noise: NoiseFit, problem: Problem, columns: Array, random: Sequence[Effect]) -> Intervals:
    """Return the intervals with a posterior draw of the random coefficients subtracted; the step noise is left."""
    knots = joined([knots_of(effect, problem) for effect in random])
    drawn = _drawn(noise, problem, columns, knots, _normals(knots)[0])
    return replace(problem.intervals, residual=problem.intervals.residual - drawn)


def _normals(knots: Knots) -> Array:
    """Return standard normal draws, one row per round; always the same for the same process."""
    return np.random.default_rng(_SEED).standard_normal((_MOST_ROUNDS, len(knots.time_s)))


def _drawn(noise: NoiseFit, problem: Problem, columns: Array, knots: Knots, normal: Array) -> Array:
    """Return a posterior draw (K, 3) of the processes' contribution to the residuals."""
    whiten = noise.whitener.whiten
    r, design = whiten(problem.intervals.residual)[:, None], whiten(columns)
    posterior = KnotPosterior.of(noise.whitener.knots(knots.spread), knots.precision)
    if columns.shape[2]:
        own = posterior.scores(design)
        normal_matrix = design.T @ design - own.T @ own
        theta = np.linalg.lstsq(normal_matrix, design.T @ r - own.T @ posterior.scores(r), rcond=None)[0]
        r = r - design @ theta
    process: Array = knots.spread @ posterior.values(posterior.scores(r) + normal[:, None])
    return process.reshape(-1, 3)


def with_random(noise: NoiseFit, problem: Problem, columns: Array, random: Sequence[Effect]) -> NoiseFit:
    """Return a noise fit with random coefficients and the truth's bias in its covariance, its linear part re-estimated.

    With neither, the same fit is returned.
    """
    if not random and not has_bias(problem):
        return noise
    wider = widened(noise.whitener, problem, random)
    return noise.with_covariance(wider, with_residual(problem.intervals, columns))


def without_random(noise: NoiseFit, problem: Problem, columns: Array) -> NoiseFit:
    """Return the same noise fit without random coefficients."""
    white = noise.whitener
    if white.process is None:
        return noise
    plain = replace(white, process=None, log_det=white.log_det - white.process.log_growth)
    return noise.with_covariance(widened(plain, problem, ()), with_residual(problem.intervals, columns))


def widened(white: Whitener, problem: Problem, random: Sequence[Effect]) -> Whitener:
    """Return a whitener whose covariance also includes random coefficients and the truth's bias."""
    parts = [knots_of(effect, problem) for effect in random]
    if has_bias(problem):
        roots = bias_roots(problem)  # independent standard normal factors of columns, as knots after all others
        flat = roots.reshape(-1, roots.shape[2])
        parts.append(Knots(csr_array(flat), csr_array(np.eye(flat.shape[1])), np.full(flat.shape[1], np.inf)))
    if not parts:
        return white
    knots = joined(parts)
    process = KnotPosterior.of(white.knots(knots.spread), knots.precision)
    return replace(white, process=process, log_det=white.log_det + process.log_growth)


def joined(parts: Sequence[Knots]) -> Knots:
    """Return the knots of several independent processes together, in order of time, so that the band stays narrow."""
    if len(parts) == 1:
        return parts[0]
    time_s = np.concatenate([part.time_s for part in parts])
    order = np.argsort(time_s, kind="stable")
    spread = csr_array(hstack([part.spread for part in parts], format="csc")[:, order])
    precision = csr_array(block_diag([part.precision for part in parts], format="csr")[order][:, order])
    return Knots(spread, precision, time_s[order])


def knots_of(effect: Effect, problem: Problem) -> Knots:
    """Return the knots of a random coefficient with its parameters."""
    (process,) = processes_like(effect)
    knots = unit_knots(problem, process, FINELY)
    scale = max(getattr(effect, process.scale), _LEAST_SCALE)
    return replace(knots, precision=knots.precision / scale**2)


def processes(taus_s: Sequence[float] = _TAUS_S, biases_s: Sequence[float] = _TAUS_S[1:]) -> list[Process]:
    """Return gains with correlation times `taus_s`, a random walk, and mean-reverting biases with `biases_s`.

    The candidates are the default; biases have not the shortest correlation time, see `_TAUS_S`.
    """
    kinds = registry()
    markov = [
        Process(kinds["gauss_markov"], {"tau": tau, "channel": channel}, "sigma", unit, tau)
        for channel, unit in (
            ("along", lambda m: stacked(m.v, 0.0, 0.0, m.v)),
            ("yaw", lambda m: stacked(0.0, 0.0, m.omega, m.v)),
            ("wheels", lambda m: stacked(0.0, 0.0, m.v, m.v)),
        )
        for tau in taus_s
    ]
    walk = kinds["gyro_bias_walk"]
    biases = [Process(walk, {"tau": tau}, "density", bias_of, tau, 0.5 * tau, 3) for tau in biases_s]
    return [*markov, Process(walk, {"tau": 0.0}, "density", bias_of, None), *biases]


def processes_like(effect: Effect, *, beside: bool = False) -> list[Process]:
    """Return the process of an effect; with `beside`, also those with neighbouring correlation times."""
    tau_s = getattr(effect, "tau", 0.0)
    channel = getattr(effect, "channel", None)
    taus_s = [tau_s / _STEP, tau_s, tau_s * _STEP] if beside and tau_s else [tau_s]
    every = processes(taus_s, [t for t in taus_s if t >= _TAUS_S[1] or t == tau_s])
    own = [p for p in every if p.kind is type(effect) and p.fixed.get("channel") == channel]
    return [p for p in own if (p.tau is None) == (tau_s == 0.0)]


def bias_of(motion: Motion) -> Array:
    """Return the error twist (n, 3) of a unit bias of the yaw rate."""
    return stacked(0.0, 0.0, 1.0, motion.v)


def unit_column(problem: Problem, process: Process) -> Array:
    """Return the contribution (K, 3) of a constant unit gain to the residuals."""
    return problem.intervals.column(np.concatenate([-process.unit(m) * m.dt_s[:, None] for m in problem.motions]))


def unit_knots(problem: Problem, process: Process, parts: float = _COARSELY) -> Knots:
    """Return the knots of a process at scale 1, with `parts` knots per correlation time."""
    intervals = problem.intervals
    # separate the runs in time: the process is independent in each
    time = intervals.end_s + problem.run * (float(intervals.end_s.max()) + 1e4)
    gaps = np.diff(time)
    step = max(process.memory_s / parts, float(gaps[gaps < _BREAK_S].sum()) / _MOST_KNOTS)
    cells = np.unique(np.floor(time / step))
    knots = np.unique(np.concatenate((cells, cells + 1.0))) * step
    # interpolate between the two neighbouring knots, both of which exist
    left = np.minimum(np.searchsorted(knots, time, side="right") - 1, len(knots) - 2)
    part = (time - knots[left]) / step
    unit, rows, left = unit_column(problem, process).ravel(), np.arange(3 * len(intervals)), np.repeat(left, 3)
    weights = np.concatenate((unit * np.repeat(1.0 - part, 3), unit * np.repeat(part, 3)))
    where = np.tile(rows, 2), np.concatenate((left, left + 1))
    spread = csr_array((weights, where), shape=(len(rows), len(knots)))
    return Knots(spread, precision_of(process, np.diff(knots)), knots)


def precision_of(process: Process, gaps_s: Array) -> csr_array:
    """Return the precision (k, k) of a process at scale 1 at knots with given gaps (k - 1,), s.

    Each value is a multiple of the previous one, plus an independent change. A random walk restarts after long breaks.
    """
    if process.tau is None:
        keeps, varies = np.where(gaps_s > _BREAK_S, 0.0, 1.0), np.where(gaps_s > _BREAK_S, 1.0, gaps_s)
    else:
        keeps = np.exp(-gaps_s / process.tau)
        varies = process.variance * -np.expm1(-2.0 * gaps_s / process.tau)
    deviation = np.sqrt(np.concatenate(([process.variance], varies)))
    changes = diags_array([1.0 / deviation, -keeps / deviation[1:]], offsets=[0, -1])
    return csr_array(changes.T @ changes)


def prior_root(precision: csr_array) -> Array:
    """Return a root (k, k) of the prior covariance of a process from its precision."""
    return band_solve(band_factor(sparse_band(precision)), np.eye(precision.shape[0]), transposed=True)
