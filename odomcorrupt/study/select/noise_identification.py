"""Which noise is named: gains that wander, and steps that stand out."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.study.estimate.gauss_newton import believed_columns
from odomcorrupt.study.estimate.outliers import set_apart, slip_bursts
from odomcorrupt.study.estimate.random_process import WANDERING
from odomcorrupt.study.estimate.tails import heavy_tails
from odomcorrupt.study.select.model_comparison import ALTERNATIVE_NATS
from odomcorrupt.study.select.random_effects import RandomGain, random_gains
from odomcorrupt.study.select.refit import again

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.candidates import Candidate

__all__ = ["PLAIN_NATS", "beside_bursts", "odd_steps_named", "wandering_gain", "worth_of"]

PLAIN_NATS = 100.0
"""What is counted in the odometry itself needs no statistics."""


def wandering_gain(fitted: Fit, believed: Array, best: Candidate | None) -> RandomGain | None:
    """Return the wandering gain that explains more than every cause does; anything unmodelled looks like one."""
    gains = random_gains(fitted, believed)
    rival = best.gain if best is not None else 0.0
    return gains[0] if gains and gains[0].nats > rival + ALTERNATIVE_NATS else None


def worth_of(gain: RandomGain, calmer: Fit, fitted: Fit) -> float:
    """Return the nats that a wandering gain explains, less its price; more of them once the rest is fitted with it."""
    refitted = calmer.log_likelihood - fitted.log_likelihood - float(np.log(len(fitted.problem.nodes)))
    return max(gain.nats, refitted)


def odd_steps_named(fitted: Fit, *, calm: bool) -> list[RandomGain]:
    """Return bursts of slip, or where nothing else is left, heavy tails."""
    bursts = slip_bursts(fitted)
    if bursts is not None:
        return [RandomGain(bursts, PLAIN_NATS)]
    # matches of a laser have heavy tails of their own
    matched = any(recording.truth.covariance is not None for recording in fitted.problem.recordings)
    tails = heavy_tails(fitted) if calm and not matched else None
    return [RandomGain(*tails)] if tails is not None else []


def beside_bursts(
    noise: list[RandomGain], fitted: Fit, free_clocks: Sequence[tuple[bool, bool]]
) -> tuple[list[RandomGain], Fit]:
    """Drop wandering gains that are not in what is left when all that stands out is set apart: they were the bursts."""
    wandering = {gain.effect.name for gain in noise} & set(WANDERING)
    if not wandering:
        return noise, fitted
    calm = again(fitted, free_clocks, fitted.effects, random=(), weights=set_apart(fitted))
    left = {gain.effect.name for gain in random_gains(calm, believed_columns(calm.problem, free_clocks))}
    if wandering <= left:
        return noise, fitted
    stay = [gain for gain in noise if gain.effect.name not in wandering - left]
    random = [effect for effect in fitted.random if effect.name in left]
    return stay, again(fitted, free_clocks, fitted.effects, random=random)
