"""Confidence: probability that an included effect is the cause, against other models, chance, and unlisted causes.

Let q be the odds, by their evidence, of all sets of terms without the effect that the selection evaluated against those
with it, and g the gain of the effect in nats, at most that on held-out data. In the final model u is the gain that a
dependence still offers, and w the gain of correlated noise. The odds against the effect are

    max(q, exp(-g))  +  s  +  E  +  U (u / g + r)  +  max(B(p), C w / g)

for other models and chance, s causes outside of the selection that explain as much, unlisted causes, and noise not as
modelled. p is the probability that held-out blocks of the drive gain as much if the expected gain is zero, or that an
effect of size zero is estimated as far from it, and B(p) = -e p ln p its least odds (Sellke, Bayarri & Berger 2001,
American Statistician 55). A library effect explains an unlisted cause only in part; the rest appears as a dependence,
as correlated noise, or as squared held-out errors over 10 s that a rejected model does not predict, r in units of those
removed by the effect; or r is the ratio of all that are left to the travel, if that is larger. E, U and C are
`elsewhere`, `unexplained` and `correlated` of `decisions.PriorOdds`.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import e, erfc, exp, inf, log, sqrt
from typing import TYPE_CHECKING

from odomcorrupt.effects.compensation import error_of
from odomcorrupt.study.estimate.clocks import RIVALS
from odomcorrupt.study.estimate.random_process import CORRELATED_NOISE, part_name
from odomcorrupt.study.select.decisions import DECISIONS

if TYPE_CHECKING:
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.decisions import PriorOdds
    from odomcorrupt.study.select.random_effects import DetectedRandomEffect
    from odomcorrupt.study.select.result import Learned, Step

_DECAYING = ("hard_iron",)
"""Effects whose heading errors decay by themselves, as those of a filter with external poses do."""
EVEN_ODDS = 0.5
"""Confidence below which a name is doubtful: reported with "perhaps", and dropped if held-out data contradict it."""
HELD_OUT_ERRORS = 2.0
"""Standard errors by which the true held-out gain may exceed its estimate."""


@dataclass(frozen=True, slots=True)
class Support:
    """Support for an effect, and what speaks against it.

    own : gain of the effect minus its cost, nats, at most that on held-out data
    against : odds of the sets of terms without the effect against those with it
    rivals : number of causes outside of the selection that explain the data as well
    left : gain of the most significant dependence that the final model leaves, nats
    correlated : gain of correlated noise in the final model, nats
    held_out_errors : gain on held-out data in standard errors; infinite if it was not tested
    size_errors : size of the effect in standard errors; infinite if it has none
    unpredicted : squared held-out error that the model does not predict, in units of that removed by the effect
    """

    own: float
    against: float = 0.0
    rivals: int = 0
    left: float = 0.0
    correlated: float = 0.0
    held_out_errors: float = inf
    size_errors: float = inf
    unpredicted: float = 0.0


def confidence(support: Support, prior: PriorOdds = DECISIONS.prior) -> float:
    """Return the probability, in [0, 1), that an effect, or an alias of it, is the cause."""
    return 1.0 / (1.0 + odds_against(support, prior))


def odds_against(support: Support, prior: PriorOdds = DECISIONS.prior) -> float:
    """Return the odds of all alternatives together against an effect: positive, possibly infinite."""
    if not support.own > 0.0:
        return inf
    other = max(support.against, exp(-support.own)) + support.rivals + prior.elsewhere
    left = prior.unexplained * (max(support.left, 0.0) / support.own + support.unpredicted)
    # all measure noise that is not as modelled, which counts once
    chance = chance_odds(min(support.held_out_errors, support.size_errors))
    noise = max(chance, prior.correlated * max(support.correlated, 0.0) / support.own)
    return other + left + noise


def chance_odds(errors: float) -> float:
    """Return the least odds that the expected value of an estimate this many standard errors above zero is zero."""
    p = 0.5 * erfc(errors / sqrt(2.0))
    return -e * p * log(p) if 0.0 < p < 1.0 / e else float(p > 0.0)


def held_out_limit(name: str, nats: float, learned: Learned) -> float:
    """Return the gain of a part of a model on the fitted data, nats, limited by its gain on held-out data."""
    most, error = learned.held_out.get(name, (inf, 0.0))
    return min(nats, max(most + HELD_OUT_ERRORS * error, 0.0))


def support_of(step: Step, learned: Learned, fit: Fit | None = None) -> Support:
    """Return the support, given the final model, for the effect that a step included.

    fit : the reported fit, if it is not that of the search
    """
    name, gain = step.added or "", step.candidates[0].gain
    pulled = any(recording.pulled_per_s > 0.0 for recording in learned.fit.problem.recordings)
    # causes that are no terms of the selection, and explain as much
    rivals = (
        pulled and name not in (*RIVALS, *_DECAYING),  # pose updates of a filter imitate gains and biases of any kind
        _may_be_dead_band(name, learned),
        learned.may_be_losses(name),  # lost increments have the same mean error
    )
    return Support(
        held_out_limit(name, gain, learned),
        learned.against.get(name, 0.0),
        sum(rivals),
        learned.left_nats,
        max((one.nats for one in learned.noise if one.effect.name in CORRELATED_NOISE), default=0.0),
        held_out_errors(*learned.held_out.get(name, (inf, inf))),
        (learned.fit if fit is None else fit).size_errors.get(name, inf),
        learned.contributions[name].ten_seconds.unpredicted(learned.misfit) if name in learned.contributions else 0.0,
    )


def held_out_errors(nats: float, error: float) -> float:
    """Return a held-out gain in standard errors; infinite if its standard error is unknown.

    Gains of blocks differ also because a drive excites the effect in some of them only. If the noise model is right,
    the standard deviation of a gain of G nats is sqrt(2 G), so the smaller of the two is used.
    """
    return inf if error == inf else nats / max(min(error, sqrt(2.0 * nats) if nats > 0.0 else inf), 1e-9)


def noise_support(one: DetectedRandomEffect, learned: Learned) -> Support:
    """Return the support for a random effect; any dependence resembles a slow random gain, or heavy tails.

    A random process with which the model drifts further than the recordings imitates an error of the motion.
    """
    left = 0.0 if one.effect.layer == "record" else learned.left_nats
    own = held_out_limit(part_name(one.effect), one.nats, learned)
    misfit = learned.drifts_too_far and one.effect.layer != "record"
    if one.effect.name in CORRELATED_NOISE:  # slow turns that were lost are such noise
        misfit = misfit or any(recording.yaw_dead_band_radps for recording in learned.fit.problem.recordings)
    return Support(own, rivals=int(misfit), left=left, unpredicted=learned.misfit**2 - 1.0)


def _may_be_dead_band(name: str, learned: Learned) -> bool:
    """Return whether an effect changes the heading alone of an odometry whose slow turns a dead band has removed."""
    effect = learned.fit.by_name.get(name)
    if effect is None or not any(recording.yaw_dead_band_radps for recording in learned.fit.problem.recordings):
        return False
    travel, turn = (any(error_of(effect, motion)[:, k].any() for motion in learned.fit.problem.motions) for k in (0, 2))
    return turn and not travel
