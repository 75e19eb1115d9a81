"""Random effects: coefficients that vary with time, for which deterministic effects are easily mistaken; and outliers.

A gain g(t) on travel, on turn, or a bias of the yaw rate is a Gaussian process over time; its marginal likelihood is a
sum over eigenvalues, so all amplitudes of one correlation time cost one decomposition (Rasmussen & Williams 2006,
Gaussian Processes for Machine Learning, eq. 5.8, on whitened data).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import eigh

from odomcorrupt.effects.effect import parameters
from odomcorrupt.study.estimate.outliers import set_apart, slip_bursts
from odomcorrupt.study.estimate.random_process import (
    CORRELATED_NOISE,
    FINELY,
    bias_of,
    processes,
    processes_like,
    rooted,
    unit_column,
    with_random,
    without_random,
)
from odomcorrupt.study.estimate.tails import heavy_tails
from odomcorrupt.study.select.score import project_out
from odomcorrupt.study.terms.drive_type import drive_type_of
from odomcorrupt.study.terms.heading_source import sees_travel

if TYPE_CHECKING:
    from collections.abc import Callable

    from scipy.sparse import csr_array

    from odomcorrupt.effects.effect import Effect, Motion
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.estimate.random_process import Process, Root
    from odomcorrupt.study.select.decisions import Decisions

__all__ = [
    "RandomCoefficient",
    "beside_bursts",
    "gain_in_refit",
    "outlier_effects",
    "random_coefficients",
    "remeasured",
]

_LEAST_SCALE = 1e-6
"""Smallest standard deviation of a gain that is tried; the largest is the effect's bound."""


@dataclass(frozen=True, slots=True)
class RandomCoefficient:
    """A random effect that a search names.

    effect : gauss_markov, gyro_bias_walk, slip_burst, heavy_tails, or what encoders did, with its parameters
    nats : log likelihood that it gains, less the penalty of its parameters
    """

    effect: Effect
    nats: float


_MAP_NATS = 20.0
"""Additional nats required of a varying gain of travel where the truth is a map's, whose distortions vary, too."""


def random_coefficients(fit: Fit, decisions: Decisions) -> list[RandomCoefficient]:
    """Return the random coefficients that the residual of a fit shows, those that gain most first."""
    log_count = float(np.log(len(fit.problem.nodes)))
    have = {(e.name, getattr(e, "channel", "")) for e in fit.random}
    found: dict[tuple[str, str], tuple[RandomCoefficient, float]] = {}
    evidence = _Evidence(fit)
    drive, blind = drive_type_of(fit.problem.recordings), not sees_travel(fit.problem.recordings)
    for process in processes():
        if not drive.admits(process.kind):
            continue
        if blind and process.unit is bias_of:
            continue  # it is the gyro's own
        # a walk is rough at every scale: with few knots it would lose to a bias that comes back
        root = rooted(fit.problem, process, FINELY) if process.tau is None else rooted(fit.problem, process)
        nats, scale = evidence.of(root, process)
        effect = process.kind(**{process.scale: scale, **process.fixed})
        least = decisions.mean_reverting_nats if process.mean_reverting else decisions.correlated_nats
        if _matched(fit) and getattr(effect, "channel", "") == "along":
            least += _MAP_NATS
        one = RandomCoefficient(effect, nats - 0.5 * process.numbers * log_count)
        key = (effect.name, getattr(effect, "channel", ""))
        if key not in found or one.nats > found[key][0].nats:
            found[key] = one, least
    named = [one for key, (one, least) in found.items() if one.nats > least and key not in have]
    return sorted(named, key=lambda one: one.nats, reverse=True)


def _matched(fit: Fit) -> bool:
    """Whether a truth comes from matched scans: a laser's own, or a localisation's."""
    return any(r.matched or r.localised for r in fit.problem.recordings)


def gain_in_refit(one: RandomCoefficient, without: Fit, with_it: Fit) -> float:
    """Return the nats that a random coefficient gains; more of them once everything else is fitted beside it."""
    refitted = with_it.log_likelihood - without.log_likelihood - float(np.log(len(without.problem.nodes)))
    return max(one.nats, refitted)


def remeasured(fit: Fit, effect: Effect) -> Effect:
    """Return a random coefficient of a fit with its parameters estimated beside the noise of the fit."""
    design = fit.design_matrix
    others = [e for e in fit.random if e is not effect]
    noise = with_random(without_random(fit.noise, fit.problem, design), fit.problem, design, others)
    evidence = _Evidence(replace(fit, noise=noise, random=tuple(others)))
    best = max(
        (
            (evidence.of(rooted(fit.problem, process, FINELY), process), process)
            for process in processes_like(effect, beside=True)
        ),
        key=lambda found: found[0][0],
    )
    (_, scale), process = best
    return process.kind(**{process.scale: scale, **process.fixed})


def outlier_effects(fit: Fit, decisions: Decisions, *, tails: bool) -> list[RandomCoefficient]:
    """Return bursts of slip where outliers are slips, or if asked for, heavy tails where they are on both sides."""
    bursts = slip_bursts(fit)
    if bursts is not None:
        return [RandomCoefficient(bursts, decisions.counted_nats)]
    # matches of a laser have heavy tails of their own, and a gyro shows one axis of three
    testable = tails and not _matched(fit) and sees_travel(fit.problem.recordings)
    heavy = heavy_tails(fit) if testable else None
    return [RandomCoefficient(*heavy)] if heavy is not None else []


def beside_bursts(
    named: list[RandomCoefficient], fit: Fit, decisions: Decisions
) -> tuple[list[RandomCoefficient], Fit]:
    """Drop random coefficients that are not there once all outliers are set apart: they were the bursts."""
    correlated = {one.effect.name for one in named} & set(CORRELATED_NOISE)
    if not correlated:
        return named, fit
    calm = fit.refit(random=(), weights=set_apart(fit))
    there = {one.effect.name for one in random_coefficients(calm, decisions)}
    if correlated <= there:
        return named, fit
    stay = [one for one in named if one.effect.name not in correlated - there]
    return stay, fit.refit(random=[effect for effect in fit.random if effect.name in there])


class _Evidence:
    """What processes explain of the residual of a fit; those with the same knots share what becomes of these."""

    def __init__(self, fit: Fit) -> None:
        self._fit = fit
        self._known: dict[tuple[Callable[[Motion], Array], bytes], tuple[Array, Array]] = {}

    def of(self, root: Root, process: Process) -> tuple[float, float]:
        """Return the nats that the best scale of a process gains, and that scale."""
        information, score = self._of_knots(root.spread, process)
        strength, vectors = eigh(root.mixing.T @ information @ root.mixing)
        strength = np.maximum(strength, 0.0)
        score = (vectors.T @ (root.mixing.T @ score)) ** 2
        (most,) = (p.high for p in parameters(process.kind) if p.name == process.scale)
        scales = np.geomspace(_LEAST_SCALE, most, 121)
        for _ in range(2):
            q = scales[:, None] ** 2
            gains = 0.5 * np.sum(q * score / (1.0 + q * strength) - np.log1p(q * strength), axis=1)
            best = int(np.argmax(gains))
            nats, scale = float(gains[best]), float(scales[best])
            scales = np.geomspace(0.9 * scale, min(1.1 * scale, most), 21)
        return nats, scale

    def _of_knots(self, spread: csr_array, process: Process) -> tuple[Array, Array]:
        """Return what the residual says of knots beside the model: information (k, k) and score (k,)."""
        key = process.unit, spread.data.tobytes()
        if key not in self._known:
            # about what a bias varies, and where a walk starts, is not its business
            unit = unit_column(self._fit.problem, process)[:, :, None]
            rest = project_out(self._fit, *((unit,) if process.unit is bias_of else ()))
            white = self._fit.noise.whitener
            both = white.transposed(np.column_stack((rest.basis, rest.residual)))
            spanned = spread.T @ both[:, :-1]
            information = white.information(spread) - spanned @ spanned.T
            self._known[key] = information, spread.T @ both[:, -1]
        return self._known[key]
