"""Random effects: detection of coefficients that vary randomly in time, and of outliers.

A gain g(t) on travel or turn, or a bias of the yaw rate, is a Gaussian process over time; a deterministic effect may
look like one. Its marginal likelihood is a sum over eigenvalues, so one decomposition serves all amplitudes of one
correlation time (Rasmussen & Williams 2006, Gaussian Processes for Machine Learning, eq. 5.8, on whitened data).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import eigh

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import parameters
from odomcorrupt.study.estimate.config import INTERVAL_S
from odomcorrupt.study.estimate.drive_type import drive_type_of, sees_travel, stands_still
from odomcorrupt.study.estimate.gauss_newton import orthonormal
from odomcorrupt.study.estimate.outliers import heavy_tails, slip_bursts
from odomcorrupt.study.estimate.random_process import (
    CORRELATED_NOISE,
    FINELY,
    bias_of,
    processes,
    processes_like,
    unit_column,
    unit_knots,
    with_random,
    without_random,
)
from odomcorrupt.study.select.evidence import project_out

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray
    from scipy.sparse import csr_array

    from odomcorrupt.effects.effect import Effect, Motion
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.estimate.random_process import Knots, Process
    from odomcorrupt.study.select.decisions import Decisions

_LEAST_SCALE = 1e-6
"""Smallest standard deviation of a gain that is tried; the largest is the bound of the effect's parameter."""
_FEW, _BESIDE = 0.05, 2
"""Largest fraction of outliers among the intervals if they are events, and intervals affected on either side."""


@dataclass(frozen=True, slots=True)
class DetectedRandomEffect:
    """A detected random effect.

    effect : gauss_markov, gyro_bias_walk, slip_burst, heavy_tails or an encoder effect, with its parameters
    nats : gain in log likelihood minus the penalty of its parameters
    """

    effect: Effect
    nats: float


_BIAS, _WHEELS = ("gyro_bias_walk", ""), ("gauss_markov", "wheels")
"""Name and channel of a bias that varies, and of a difference between the wheels that does."""
_REFIT_NATS = 15.0
"""Largest gain by fitting the noise again, nats, once a process has its own parameters; at most 10 was observed."""
_ITERATIONS, _ALIKE, _SETTLED_NATS = 6, 0.03, 0.5
"""Largest number of iterations between a random coefficient and the other noise; they end if the coefficient changes by
less than the second value, and the log likelihood rises by less than the third, nats."""


def random_coefficients(fit: Fit, decisions: Decisions) -> list[DetectedRandomEffect]:
    """Return the random coefficients detected in the residual of a fit, in decreasing order of their gains."""
    log_count = float(np.log(len(fit.problem.intervals)))
    have = {(e.name, getattr(e, "channel", "")) for e in fit.random}
    found: dict[tuple[str, str], tuple[DetectedRandomEffect, float]] = {}
    evidence = _Evidence(fit)
    drive, blind = drive_type_of(fit.problem.recordings), not sees_travel(fit.problem.recordings)
    still = all(map(stands_still, fit.problem.recordings))
    for process in processes():
        # a heading that moves at rest comes from a gyro, whatever the wheels do
        if not drive.admits(process.kind) or (process.fixed.get("channel") == "wheels" and not still):
            continue
        if blind and process.unit is bias_of:
            continue  # the truth is a gyro, and the bias may be its own
        # a random walk is rough at every scale: with few knots a mean-reverting bias would fit better
        knots = unit_knots(fit.problem, process, FINELY) if process.tau is None else unit_knots(fit.problem, process)
        nats, scale = evidence.of(knots, process)
        effect = process.kind(**{process.scale: scale, **process.fixed})
        least = decisions.correlated_nats if process.numbers == 2 else decisions.mean_reverting_nats
        if _matched(fit) and getattr(effect, "channel", "") == "along":
            least += decisions.map_nats
        one = DetectedRandomEffect(effect, nats - 0.5 * process.numbers * log_count)
        key = (effect.name, getattr(effect, "channel", ""))
        if key not in found or one.nats > found[key][0].nats:
            found[key] = one, least
    bias, wheels = (found.get(key) for key in (_BIAS, _WHEELS))
    if bias and wheels and wheels[0].nats > bias[0].nats - decisions.alternative_nats:
        del found[_BIAS]  # its odometry would turn at rest, too
    named = []
    for key, (one, least) in found.items():
        if key in have:
            continue
        beside, measured = _measured(fit, one, least)
        if measured.nats > least and _in_both_halves(beside, measured.effect):
            named.append(measured)
    return sorted(named, key=lambda one: one.nats, reverse=True)


def _measured(fit: Fit, one: DetectedRandomEffect, least: float) -> tuple[Fit, DetectedRandomEffect]:
    """Return a fit with its noise re-estimated beside a random bias, and the bias with its gain in the refit.

    If intervals last seconds, as with poses of a localisation, or if the angle random walk of a gyro is fitted, the
    fitted noise absorbs most of a random walk of the bias, and a test beside that noise has little power. Otherwise,
    and if no refit is likely to gain `least` nats, both are returned unchanged.
    """
    (process,) = processes_like(one.effect)
    approach = fit.problem.approach
    if process.unit is not bias_of or not (approach.gyro_noise or approach.spacing_s > INTERVAL_S):
        return fit, one
    paid = 0.5 * process.numbers * float(np.log(len(fit.problem.intervals)))
    (usual,) = (p.typical for p in parameters(process.kind) if p.name == process.scale)
    start = process.kind(**{process.scale: max(getattr(one.effect, process.scale), usual), **process.fixed})
    least = max(one.nats, least) + paid
    begun = fit.with_noise_refitted((*fit.random, start))
    effect, more = remeasured(begun, start)
    if begun.log_likelihood + more + _REFIT_NATS - fit.log_likelihood <= least:
        return fit, one
    calmer = fit.refit(random=(*fit.random, effect))
    nats = calmer.log_likelihood - fit.log_likelihood
    mean = registry()["gyro_bias"]()
    if nats > least and mean.name not in fit.by_name:
        # the mean of a bias is no part of the process
        steady = fit.refit((*fit.effects, mean))
        nats = min(nats, calmer.log_likelihood - steady.log_likelihood)
    if nats <= least:
        return fit, one
    return _beside(calmer, effect), DetectedRandomEffect(effect, nats - paid)


def _beside(fit: Fit, effect: Effect) -> Fit:
    """Return a fit without one of its random coefficients, with the noise estimated beside that coefficient."""
    others, design = tuple(e for e in fit.random if e is not effect), fit.design_matrix
    noise = with_random(without_random(fit.noise, fit.problem, design), fit.problem, design, others)
    return replace(fit, noise=noise, random=others)


def _in_both_halves(fit: Fit, effect: Effect) -> bool:
    """Return whether a random coefficient estimated on either half of the intervals holds on the other half.

    It holds where it gains. Events are no random process: if outliers are few, they and their neighbours are left out.
    """
    count = len(fit.problem.intervals)
    outliers = fit.noise.weights > 1.0
    event = np.convolve(outliers, np.ones(2 * _BESIDE + 1), "same") > 0.0
    usual = ~event if outliers.mean() < _FEW else np.ones(count, dtype=bool)
    early = np.cumsum(usual) <= usual.sum() // 2
    family = [
        p for p in processes() if p.kind is type(effect) and p.fixed.get("channel") == getattr(effect, "channel", None)
    ]
    gains = []
    whiten = fit.noise.whitener.whiten
    for process in family:
        mean = [unit_column(fit.problem, process)[:, :, None]] if process.unit is bias_of else []
        free = whiten(np.concatenate([fit.design_matrix, *mean], axis=2))
        columns = unit_knots(fit.problem, process).columns
        white = whiten(columns.reshape(-1, 3, columns.shape[1]))
        sides = (_part(free, white, fit.noise.innovations, np.repeat(usual & side, 3)) for side in (early, ~early))
        gains.append([_gains(*half, _scales(process)) for half in sides])
    both = np.array(gains).swapaxes(0, 1).reshape(2, -1)  # of all processes and scales
    return bool(both[1, np.argmax(both[0])] > 0.0 and both[0, np.argmax(both[1])] > 0.0)


def _matched(fit: Fit) -> bool:
    """Return whether any truth comes from scan matching: from a laser of the recording, or from a localisation."""
    return any(r.matched or r.localised for r in fit.problem.recordings)


def remeasured(fit: Fit, effect: Effect) -> tuple[Effect, float]:
    """Return a random coefficient of a fit with its parameters re-estimated beside the noise, and what that gains."""
    evidence = _Evidence(_beside(fit, effect))
    (present,) = processes_like(effect)
    before = evidence.at(unit_knots(fit.problem, present, FINELY), present, getattr(effect, present.scale))
    best = max(
        (
            (evidence.of(unit_knots(fit.problem, process, FINELY), process), process)
            for process in processes_like(effect, beside=True)
        ),
        key=lambda found: found[0][0],
    )
    (nats, scale), process = best
    return process.kind(**{process.scale: scale, **process.fixed}), nats - before


def outlier_effects(fit: Fit, decisions: Decisions, *, tails: bool) -> list[DetectedRandomEffect]:
    """Return slip bursts if the outliers are slips, or heavy tails if requested and outliers have both signs.

    With a gyro as the truth neither is detectable: it measures no travel, and one axis of three.
    """
    if not sees_travel(fit.problem.recordings):
        return []
    if (bursts := slip_bursts(fit)) is not None:
        return [DetectedRandomEffect(bursts, decisions.counted_nats)]
    # errors of scan matching have heavy tails themselves
    corrected = any(r.in_map for r in fit.problem.recordings)  # in steps, which make tails
    heavy = heavy_tails(fit) if tails and not corrected and not _matched(fit) else None
    return [DetectedRandomEffect(*heavy)] if heavy is not None else []


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


class _Evidence:
    """Gains of random processes on the residual of a fit; processes with the same knots share computed matrices."""

    def __init__(self, fit: Fit) -> None:
        self._fit = fit
        self._known: dict[tuple[Callable[[Motion], Array], int, bytes], tuple[Array, Array]] = {}

    def of(self, knots: Knots, process: Process) -> tuple[float, float]:
        """Return the gain at the best scale of a process, nats, and that scale."""
        spectrum, scales = self._spectrum(knots, process), _scales(process)
        for _ in range(2):
            gains = _gains(*spectrum, scales)
            best = int(np.argmax(gains))
            nats, scale = float(gains[best]), float(scales[best])
            scales = np.geomspace(0.9 * scale, min(1.1 * scale, _scales(process)[-1]), 21)
        return nats, scale

    def at(self, knots: Knots, process: Process, scale: float) -> float:
        """Return the gain of a process at a scale, nats."""
        return float(_gains(*self._spectrum(knots, process), np.array([scale]))[0])

    def _spectrum(self, knots: Knots, process: Process) -> tuple[Array, Array]:
        (information, score), mixing = self._of_knots(knots.spread, process), knots.mixing
        return _spectrum(mixing.T @ information @ mixing, mixing.T @ score)

    def _of_knots(self, spread: csr_array, process: Process) -> tuple[Array, Array]:
        """Return information (k, k) and score (k,) of the knots beside the model."""
        # the number of knots too: without travel, all weights of a gain of travel are zero
        key = process.unit, spread.shape[1], spread.data.tobytes()
        if key not in self._known:
            # the mean of a bias, and the start of a walk, are not part of the process
            unit = unit_column(self._fit.problem, process)[:, :, None]
            rest = project_out(self._fit, *((unit,) if process.unit is bias_of else ()))
            white = self._fit.noise.whitener
            both = white.transposed(np.column_stack((rest.basis, rest.residual)))
            spanned = spread.T @ both[:, :-1]
            information = white.information(spread) - spanned @ spanned.T
            self._known[key] = information, spread.T @ both[:, -1]
        return self._known[key]


def _scales(process: Process) -> Array:
    """Return the scales (121,) at which a process is evaluated."""
    (most,) = (p.high for p in parameters(process.kind) if p.name == process.scale)
    return np.geomspace(_LEAST_SCALE, most, 121)


def _part(beside: Array, white: Array, innovations: Array, rows: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return the eigenvalues (m,) of a process's information on some rows of the data, and squared scores (m,)."""
    basis, white, r = orthonormal(beside[rows]), white[rows], innovations[rows]
    white, r = (part - basis @ (basis.T @ part) for part in (white, r))
    return _spectrum(white.T @ white, white.T @ r)


def _spectrum(information: Array, score: Array) -> tuple[Array, Array]:
    """Return the eigenvalues (m,) of an information matrix, and the squared scores (m,) along its eigenvectors."""
    strength, vectors = eigh(information, driver="evd")
    return np.maximum(strength, 0.0), (vectors.T @ score) ** 2


def _gains(strength: Array, score: Array, scales: Array) -> Array:
    """Return the gains (s,) of a process at given scales (s,), nats, from the results of `_spectrum`."""
    q = scales[:, None] ** 2
    return 0.5 * np.sum(q * score / (1.0 + q * strength) - np.log1p(q * strength), axis=1)
