"""Confidence: probability that an included effect is the cause, against rivals, chance, and unlisted causes.

Let g be the gain of the effect and g_i the gains of its rivals, in nats and minus their penalties. In the final model,
u is the gain that a dependence still offers, w the gain of correlated noise, and m the gain of the effect over the best
basis function in its place. The odds against the effect are

    sum_i exp(T (g_i - g))  +  N exp(-T g)  +  exp(D - T m)  +  E + U u / g + max(B(p), C w / g)

for rivals, chance under the noise model, a basis function, unlisted causes, and noise not as modelled. N candidates
were tested, in units of a common one: the largest of many gains is large by chance (Gross & Vitells 2010, European
Physical Journal C 70). p is the probability that held-out blocks of the drive gain as much if the expected gain is
zero, and B(p) = -e p ln p its least odds (Sellke, Bayarri & Berger 2001, American Statistician 55). A library effect
explains an unlisted cause only in part; the rest appears as a dependence or as correlated noise. T, D, E, U and C are
`temper`, `dependence_nats`, `elsewhere`, `unexplained` and `correlated` of `decisions.PriorOdds`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import e, erfc, exp, inf, isfinite, log, sqrt
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.compensation import error_of
from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.study.estimate.clocks import RIVALS
from odomcorrupt.study.estimate.heading_source import sees_travel
from odomcorrupt.study.estimate.random_process import CORRELATED_NOISE, part_name
from odomcorrupt.study.io.encoders import speeds_in_steps
from odomcorrupt.study.select.decisions import DECISIONS, equal_candidates

if TYPE_CHECKING:
    from odomcorrupt.study.select.decisions import PriorOdds
    from odomcorrupt.study.select.random_effects import DetectedRandomEffect
    from odomcorrupt.study.select.result import Learned, Step

_SHORT_ARM_M = 0.005
"""Largest lever arm, m, that errors of single wheels can imitate."""
_USUAL_TRACK_M, _MOVES_MPS = 0.4, 1e-5
"""Track, m, and change of the error, m/s, for the test whether an effect acts on single wheels."""
_MISFIT_GAIN = 0.2
"""Fraction of an effect's gain up to which a similar effect may be a misfit of its model."""
_LIKE_CLOCK = (*RIVALS, "motor_lag")
"""Effects that a clock offset resembles."""
_LATE = (*_LIKE_CLOCK, "steering_lag", "steering_play")
"""Effects of delay or slip at changes of speed; their models are approximate."""
_DECAYING = ("hard_iron",)
"""Effects whose heading errors decay by themselves, as those of a filter with external poses do."""
_MISFIT_DISPLACEMENT = 0.03
"""Fraction of the largest effect's displacement in 10 s up to which another effect may be a misfit of its model."""
EVEN_ODDS = 0.5
"""Confidence below which a name is doubtful: reported with "perhaps", and dropped if held-out data contradict it."""
_NOT_TESTABLE = "not testable"
"""Beginning of the refusal of effects that a drive does not show."""
HELD_OUT_ERRORS = 2.0
"""Standard errors by which the true held-out gain may exceed its estimate."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """Evidence for and against an effect, nats.

    own : gain of the effect minus its penalty
    rivals : the same for every other candidate that was refitted and not refused; aliases are excluded
    left : gain of the most significant dependence that the final model leaves
    correlated : gain of correlated noise in the final model
    margin : gain over the best basis function in place of the effect, in the final model
    candidates : number of effects that were tested, in units of a common one, see `equal_candidates`
    held_out_errors : gain on held-out data in standard errors; infinite if it was not tested
    """

    own: float
    rivals: tuple[float, ...] = ()
    left: float = 0.0
    correlated: float = 0.0
    margin: float = inf
    candidates: float = 1.0
    held_out_errors: float = inf


def confidence(evidence: Evidence, prior: PriorOdds = DECISIONS.prior) -> float:
    """Return the probability, in [0, 1), that an effect, or an alias of it, is the cause."""
    odds = odds_against(evidence, prior)
    return 1.0 / (1.0 + odds) if isfinite(odds) else 0.0


def odds_against(evidence: Evidence, prior: PriorOdds = DECISIONS.prior) -> float:
    """Return the odds of all alternatives together against an effect: positive, possibly infinite."""
    if not evidence.own > 0.0:
        return inf
    rivals = sum(_exp(prior.temper * (g - evidence.own)) for g in evidence.rivals if isfinite(g))
    chance = evidence.candidates * _exp(-prior.temper * evidence.own)
    dependence = _exp(prior.dependence_nats - prior.temper * evidence.margin)
    left = prior.unexplained * max(evidence.left, 0.0) / evidence.own
    # both measure noise that is not as modelled, which counts once
    noise = max(chance_odds(evidence.held_out_errors), prior.correlated * max(evidence.correlated, 0.0) / evidence.own)
    return rivals + chance + dependence + prior.elsewhere + left + noise


def chance_odds(errors: float) -> float:
    """Return the least odds that the expected value of an estimate this many standard errors above zero is zero."""
    p = 0.5 * erfc(errors / sqrt(2.0))
    return -e * p * log(p) if 0.0 < p < 1.0 / e else float(p > 0.0)


def _exp(nats: float) -> float:
    return exp(min(max(nats, -700.0), 700.0))


def held_out_limit(name: str, nats: float, learned: Learned) -> float:
    """Return the gain of a part of a model on the fitted data, nats, limited by its gain on held-out data.

    name : name of the part
    nats : its gain on the fitted data
    """
    most, error = learned.held_out.get(name, (inf, 0.0))
    return min(nats, max(most + HELD_OUT_ERRORS * error, 0.0))


def evidence_of(step: Step, learned: Learned) -> Evidence:
    """Return the evidence, given the final model, for the effect that a step included."""
    name, (included, *others) = step.added or "", step.candidates
    own = held_out_limit(name, included.gain, learned)
    # overfitting raised the gains of the rivals as much as that of the effect
    overfitted = included.gain - own
    rivals = [c.gain - overfitted for c in others if not c.refused]
    if not sees_travel(learned.fit.problem.recordings):
        # the part of an effect that travels cannot be tested with a gyro, the part that turns may explain as much
        untested = [c for c in others if c.refused.startswith(_NOT_TESTABLE)]
        stepwise = any(speeds_in_steps(recording) for recording in learned.fit.problem.recordings)
        for c in untested:
            visible = c.name == "truncated_velocity" and stepwise and c.score.nats > 0.0
            rivals.append(own if visible else c.score.nats - overfitted)
    if name in _LIKE_CLOCK and learned.clocks.ambiguous_nats > 0.0:
        # the clock offset that was set to zero is a rival, with at most the gain of the effect
        rivals.append(min(own, learned.clocks.ambiguous_nats - overfitted))
    # rivals that are not in the list of candidates, and gain as much
    rivals += [own] * sum(
        (
            _may_be_filter(name, learned),
            _may_be_dead_band(name, learned),
            _may_be_of_wheels(name, learned),
            learned.may_be_losses(name),  # lost increments have the same mean error
            _may_be_misfit(step, learned),
        )
    )
    correlated = max((gain.nats for gain in learned.noise if gain.effect.name in CORRELATED_NOISE), default=0.0)
    return Evidence(
        own,
        tuple(rivals),
        learned.left_nats,
        correlated,
        margin=learned.margins.get(name, inf),
        candidates=equal_candidates([c.name for c in step.candidates], learned.decisions),
        held_out_errors=held_out_errors(*learned.held_out.get(name, (inf, inf))),
    )


def held_out_errors(nats: float, error: float) -> float:
    """Return a held-out gain in standard errors; infinite if its standard error is unknown.

    Gains of blocks differ also because a drive excites the effect in some of them only. If the noise model is right,
    the standard deviation of a gain of G nats is sqrt(2 G), so the smaller of the two is used.
    """
    if error == inf:
        return inf
    return nats / max(min(error, sqrt(2.0 * nats) if nats > 0.0 else inf), 1e-9)


def noise_evidence(gain: DetectedRandomEffect, learned: Learned) -> Evidence:
    """Return the evidence for a random effect; any dependence resembles a slow random gain, or heavy tails.

    The misfit of a lag is large where speeds or steering angles change quickly, and resembles heavy tails. A random
    process with which the model drifts further than the recordings imitates an error that depends on the motion.
    """
    left = 0.0 if gain.effect.layer == "record" else learned.left_nats
    own = held_out_limit(part_name(gain.effect), gain.nats, learned)
    late = [step.candidates[0].gain for step in learned.steps if step.added in _LATE]
    misfit = gain.effect.name == "heavy_tails" and gain.nats < _MISFIT_GAIN * max(late, default=0.0)
    misfit |= gain.effect.name in CORRELATED_NOISE and (learned.drifts_too_far or _loses_slow_turns(learned))
    misfit |= may_be_scale_of_truth(gain, learned)
    return Evidence(own, (own,) if misfit else (), left=left)


def may_be_scale_of_truth(gain: DetectedRandomEffect, learned: Learned) -> bool:
    """Return whether a varying gain of travel may be a varying scale of the truth, which has the same residuals."""
    of_travel = gain.effect.name == "gauss_markov" and getattr(gain.effect, "channel", "") == "along"
    return of_travel and any(recording.own_scale for recording in learned.fit.problem.recordings)


def _loses_slow_turns(learned: Learned) -> bool:
    return any(recording.yaw_dead_band_radps > 0.0 for recording in learned.fit.problem.recordings)


def _may_be_filter(name: str, learned: Learned) -> bool:
    """Return whether an effect may be of the pose updates of a filter, which imitate gains and biases of any kind."""
    pulled = any(recording.pulled_per_s > 0.0 for recording in learned.fit.problem.recordings)
    return pulled and name not in (*RIVALS, *_DECAYING)


def _may_be_dead_band(name: str, learned: Learned) -> bool:
    """Return whether an effect changes the heading of an odometry whose slow turns a dead band has removed."""
    effect = learned.fit.by_name.get(name)
    if effect is None or not _loses_slow_turns(learned):
        return False
    return any(error_of(effect, motion)[:, 2].any() for motion in learned.fit.problem.motions)


def _may_be_misfit(step: Step, learned: Learned) -> bool:
    """Return whether an effect may be a misfit of the model of a far larger one.

    No effect model is exact to 1 %: a steering error enters by the tangent of the angle, for example, and the mean of
    slip bursts is not known better. Nor is a real lag exactly a filter or a delay, or real play rigid; their misfits
    depend on the acceleration.
    """
    moved = {name: one.ten_seconds.moved_m for name, one in learned.contributions.items()}
    bursts_m = learned.error_m if any(gain.effect.name == "slip_burst" for gain in learned.noise) else 0.0
    if step.added in moved and moved[step.added] < _MISFIT_DISPLACEMENT * max(*moved.values(), bursts_m):
        return True
    others = [other.candidates[0].gain for other in learned.steps if other.added in RIVALS and other is not step]
    return step.added in RIVALS and step.candidates[0].gain < _MISFIT_GAIN * max(others, default=0.0)


def _may_be_of_wheels(name: str, learned: Learned) -> bool:
    """Return whether a small lever arm may be an error of single wheels on an unknown track.

    With one larger wheel on a track b, the body's travel in turns is longer, as with a lever arm of
    y = curvature b^2 / 4. Slip of each wheel in proportion to its own speed has a similar effect.
    """
    arm = learned.fit.by_name.get(name) if name == "lever_arm" else None
    motion = learned.fit.problem.motions[0]
    if arm is None or motion.track_m is not None or learned.drive_type.steered:
        return False
    if any(abs(getattr(arm, p.name)) > _SHORT_ARM_M for p in amplitudes(arm)):
        return False
    tracked = replace(motion, track_m=_USUAL_TRACK_M)
    robots = [effect for effect in learned.fit.effects if effect.kind == "effect"]
    return any(np.abs(error_of(e, tracked) - error_of(e, motion)).max() > _MOVES_MPS for e in robots)
