"""Confidence: the probability that an included effect is the cause, among rivals, chance, and causes without a name.

With g the nats that an effect gains and g_i those of its rivals (all less their penalties), u the nats that
dependences still gain in the final model, w those of correlated noise in it, and m the nats by which the final model
prefers the effect to the best basis function in its place, the odds against it are

    sum_i exp(T (g_i - g))  +  exp(-T g)  +  exp(D - T m)  +  E + (U u + C w) / g

for rivals, nothing at all, a basis function, and something else: a cause that is in no library is explained by a known
one in part only, and what is left of it shows as a dependence or as correlated noise. T, D, E, U and C are `temper`,
`dependence_nats`, `elsewhere`, `unexplained` and `correlated` of `decisions.PriorOdds`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import exp, inf, isfinite
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.geometry.motion import error_of
from odomcorrupt.study.estimate.clocks import RIVALS
from odomcorrupt.study.estimate.random_process import CORRELATED_NOISE
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.remainder import within_remainder

if TYPE_CHECKING:
    from odomcorrupt.study.select.decisions import PriorOdds
    from odomcorrupt.study.select.random_effects import RandomCoefficient
    from odomcorrupt.study.select.stepwise import Learned, Step

__all__ = ["Evidence", "confidence", "evidence_of", "held_out_limit", "noise_evidence", "odds_against", "odds_formula"]

_SHORT_ARM_M = 0.005
"""A tracked point may be off by more, and single wheels do not make as much of it."""
_USUAL_TRACK_M, _MOVES_MPS = 0.4, 1e-5
"""A track on which to see whether an effect acts on single wheels, and what it then does."""
_MISFIT = 0.2
"""Part of what an effect explains up to which another one of its kind may be an imperfection of it."""
_LATE = (*RIVALS, "motor_lag", "steering_lag", "steering_play")
"""Effects that are late or slip where speeds change, none of them exactly so."""
_FORM = 0.03
"""Part of what the largest effect moves the odometry by in 10 s up to which another may be an imperfection of it."""
HELD_OUT_ERRORS = 2.0
"""A gain on held-out data may be larger than it was seen by so many of its standard errors."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """What speaks for an effect and against it, in nats.

    own : what it gains, less its penalty
    rivals : the same of every other candidate that was refitted and not refused; twins are no rivals
    left : what the plainest dependence still gains in the final model
    correlated : what correlated noise in the final model gains
    margin : by how much the final model prefers it to the best basis function in its place
    """

    own: float
    rivals: tuple[float, ...] = ()
    left: float = 0.0
    correlated: float = 0.0
    margin: float = inf


def confidence(evidence: Evidence, prior: PriorOdds = DECISIONS.prior) -> float:
    """Return the probability, within [0, 1), that an effect is right, or a twin of what is."""
    odds = odds_against(evidence, prior)
    return 1.0 / (1.0 + odds) if isfinite(odds) else 0.0


def odds_against(evidence: Evidence, prior: PriorOdds = DECISIONS.prior) -> float:
    """Return the odds of rivals, nothing and something else together against an effect; positive, perhaps infinite."""
    if not evidence.own > 0.0:
        return inf
    rivals = sum(_exp(prior.temper * (g - evidence.own)) for g in evidence.rivals if isfinite(g))
    nothing = _exp(-prior.temper * evidence.own)
    dependence = _exp(prior.dependence_nats - prior.temper * evidence.margin)
    rest = prior.unexplained * max(evidence.left, 0.0) + prior.correlated * max(evidence.correlated, 0.0)
    return rivals + nothing + dependence + prior.elsewhere + rest / evidence.own


def odds_formula(prior: PriorOdds = DECISIONS.prior) -> str:
    """Return the formula of `odds_against` with its numbers filled in, as the documents print it."""
    t = "" if prior.temper == 1.0 else f"{prior.temper:g} * "
    left = "u" if prior.unexplained == 1.0 else f"{prior.unexplained:g} * u"
    return (
        f"sum(exp({t}(g_i - g)) for g_i in rivals) + exp(-{t}g) + exp({prior.dependence_nats:g} - {t}m)"
        f" + {prior.elsewhere:g} + ({left} + {prior.correlated:g} * w) / g"
    )


def _exp(nats: float) -> float:
    return exp(min(max(nats, -700.0), 700.0))


def held_out_limit(name: str, nats: float, learned: Learned) -> float:
    """Return the nats that a part of a model gains on the fitted data, no more than data that were not fitted allow."""
    most, error = learned.held_out.get(name, (inf, 0.0))
    return min(nats, max(most + HELD_OUT_ERRORS * error, 0.0))


def evidence_of(step: Step, learned: Learned) -> Evidence:
    """Return the evidence for the effect that a step included, in the light of the final model."""
    gain = step.candidates[0].gain
    own = held_out_limit(step.added or "", gain, learned)
    # what chance gave to the effect on the fitted data it gave to its rivals, too
    rivals = tuple(c.gain - (gain - own) for c in step.candidates[1:] if not c.refused)
    if step.added in (*RIVALS, "motor_lag") and learned.clocks.ambiguous_nats > 0.0:
        # the clock that was left out is a rival like any other; it explains no more than all of what this one does
        rivals = (*rivals, min(own, learned.clocks.ambiguous_nats))
    if step.added not in RIVALS and any(r.pulled_per_s > 0.0 for r in learned.fit.problem.recordings):
        # what a filter that is given poses takes out passes for gains and biases of any kind
        rivals = (*rivals, own)
    if _may_be_of_wheels(step.added or "", learned):
        rivals = (*rivals, own)
    if learned.may_be_losses(step.added or ""):
        rivals = (*rivals, own)  # lost increments are the same on average
    if _may_be_remainder(step.added or "", learned) or _may_be_misfit(step, learned):
        rivals = (*rivals, own)
    correlated = max((gain.nats for gain in learned.noise if gain.effect.name in CORRELATED_NOISE), default=0.0)
    margin = learned.margins.get(step.added or "", inf)
    return Evidence(own, rivals, learned.left_nats, correlated, margin)


def noise_evidence(gain: RandomCoefficient, learned: Learned) -> Evidence:
    """Return the evidence for a random effect; any dependence resembles a slow gain, or heavy tails.

    What the form of a lag leaves stands out where speeds or angles change quickly, as tails do.
    """
    left = 0.0 if gain.effect.layer == "record" else learned.left_nats
    own = held_out_limit(gain.effect.name, gain.nats, learned)
    late = [step.candidates[0].gain for step in learned.steps if step.added in _LATE]
    misfit = gain.effect.name == "heavy_tails" and gain.nats < _MISFIT * max(late, default=0.0)
    return Evidence(own, (own,) if misfit else (), left=left)


def _may_be_remainder(name: str, learned: Learned) -> bool:
    """Return whether an effect may be what another one in the model leaves, see `Effect.remainder`."""
    effect = next((e for e in learned.fit.effects if e.name == name), None)
    if effect is None or max(effect.remainder) > 0.0:
        return False
    return within_remainder(
        learned.fit, np.concatenate([error_of(effect, m)[:, [0, 2]] for m in learned.fit.problem.motions])
    )


def _may_be_misfit(step: Step, learned: Learned) -> bool:
    """Return whether an effect may be what the form of a far larger one leaves.

    No form is exact to a hundredth: a steered wheel is off by the tangent of its angle. Nor is a lag just a filter or
    a delay, or play rigid: what remains of these depends on the acceleration.
    """
    moved = {name: one.ten_seconds.moved_m for name, one in learned.contributions.items()}
    if step.added in moved and moved[step.added] < _FORM * max(moved.values()):
        return True
    others = [other.candidates[0].gain for other in learned.steps if other.added in RIVALS and other is not step]
    return step.added in RIVALS and step.candidates[0].gain < _MISFIT * max(others, default=0.0)


def _may_be_of_wheels(name: str, learned: Learned) -> bool:
    """Return whether a small offset of the tracked point may be part of what single wheels do on an unknown track.

    Of a larger wheel on a track b the body's travel is longer in turns, as of y = curvature b^2 / 4 of a lever arm;
    slip of each wheel by its own speed does alike.
    """
    arm = next((e for e in learned.fit.effects if e.name == name == "lever_arm"), None)
    motion = learned.fit.problem.motions[0]
    if arm is None or motion.track_m is not None or learned.drive_type.steered:
        return False
    if any(abs(getattr(arm, p.name)) > _SHORT_ARM_M for p in amplitudes(arm)):
        return False
    tracked = replace(motion, track_m=_USUAL_TRACK_M)
    robots = [effect for effect in learned.fit.effects if effect.kind == "effect"]
    return any(np.abs(error_of(e, tracked) - error_of(e, motion)).max() > _MOVES_MPS for e in robots)
