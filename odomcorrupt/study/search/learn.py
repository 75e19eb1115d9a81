"""The whole loop: name the first thing that is missing, believe it exactly, look again, until nothing is left.

Where no known effect explains more, but a simple law of one driver does, the law is believed as effects are: known
effects that only stood in for it fall idle and are dropped, and the error falls by what the law explains.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import amplitudes, parameters
from odomcorrupt.study.fitting.approach import choose_approach
from odomcorrupt.study.fitting.clocks import Clocks, find_clocks
from odomcorrupt.study.fitting.drift import ten_second_error
from odomcorrupt.study.fitting.events import slip_bursts
from odomcorrupt.study.fitting.gauss_newton import Fit, believed_columns, fit
from odomcorrupt.study.fitting.random_process import WANDERING
from odomcorrupt.study.fitting.tails import heavy_tails
from odomcorrupt.study.recordings.encoders import encoder_effects, refilled
from odomcorrupt.study.search.candidates import HARM, Candidate, next_effect
from odomcorrupt.study.search.heading import with_one_heading
from odomcorrupt.study.search.members import best_member
from odomcorrupt.study.search.random_gain import RandomGain, random_gains
from odomcorrupt.study.search.rivals import CHALLENGE_NATS, better_law, law_margin, put_back
from odomcorrupt.study.search.unknown import Unknown, unknown_dependences

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.pose import Array
    from odomcorrupt.study.recordings.trajectory import Recording

__all__ = ["Learned", "Round", "learn"]

_MOST = 6
_MOST_NOISE = 2
_PLAIN_NATS = 100.0
"""What is counted in the odometry itself needs no statistics."""
_MOST_LAWS = 2
_LAWS_TRIED = 4
_DROP_NATS = 3.3
_WORTH_NATS = 1.0
"""What a new shape has to gain."""
_NOISE_PRICE = 6.0
"""Nats that a wandering gain is worth by chance, and as much as it has to gain to be named."""
ALTERNATIVE_NATS = 3.0
"""Effects that explain the data this nearly as well are alternatives: the data cannot tell them apart."""


@dataclass(frozen=True, slots=True)
class Round:
    """One look: the model before it, all candidates (the one that was added first), and what was added.

    law : what no known effect explains, where its law was believed in this look
    """

    before: Fit
    candidates: tuple[Candidate, ...]
    added: str | None
    law: Unknown | None = None

    @property
    def step(self) -> str | None:
        """What came into the model: the name of an effect, or on what a law depends; None if nothing did."""
        return f"{self.law.channel} over {self.law.driver}" if self.law is not None else self.added

    @property
    def alternatives(self) -> tuple[str, ...]:
        """Effects that would have done nearly as well as the added one."""
        if self.added is None:
            return ()
        best = self.candidates[0].gain
        rivals = [c for c in self.candidates[1:] if not c.refused and c.gain > best - ALTERNATIVE_NATS]
        names = [self.added, *(c.score.effect.name for c in rivals)]
        twins = [name for name, kind in registry().items() if kind.twin_of in names]
        return (*names[1:], *twins)


@dataclass(frozen=True, slots=True)
class Learned:
    """What a search found.

    clocks : those of the recordings
    rounds : looks in order; the last one added nothing, or the limit was reached
    noise : what encoders did, and wandering gains that were named and believed
    unknown : what no known effect explains
    laws : those of them whose laws are believed: the final fit has them
    margins : by how many nats each known effect that was added explains more than the best law would instead
    fit : the final fit
    error_m : its position error after 10 s on the fitted data
    """

    clocks: Clocks
    rounds: tuple[Round, ...]
    noise: tuple[RandomGain, ...]
    unknown: tuple[Unknown, ...]
    laws: tuple[Unknown, ...]
    margins: Mapping[str, float]
    fit: Fit
    error_m: float

    @property
    def added(self) -> tuple[str, ...]:
        """Names of what the loop added and kept, in order."""
        kept = {effect.name for effect in self.fit.effects}
        return tuple(r.added for r in self.rounds if r.added in kept)


def learn(
    recordings: Sequence[Recording], start: Sequence[Effect] = (), *, law_name: str = "diffusion", most: int = _MOST
) -> Learned:
    """Search from a model with the given effects; `most` bounds how many are added."""
    encoders = encoder_effects(recordings[0])
    recordings = [refilled(recording, encoders) for recording in recordings]
    approach = choose_approach(recordings, law_name)
    clocks = find_clocks(recordings, approach)
    fitted = fit(
        recordings,
        [e for e in start if e.kind != "noise"],
        clocks=clocks.clocks,
        free_clocks=clocks.free,
        approach=approach,
        random=[e for e in start if e.name in WANDERING],
    )
    rounds: list[Round] = []
    noise = [RandomGain(effect, _PLAIN_NATS) for effect in encoders]
    laws: list[Unknown] = []
    while True:
        candidates = next_effect(fitted, clocks.free)
        best = candidates[0] if candidates and not candidates[0].refused else None
        believed = believed_columns(fitted.problem, clocks.free)
        gain = _wandering(fitted, believed, best) if len(fitted.random) < _MOST_NOISE else None
        unknown = unknown_dependences(fitted, believed) if best is None or gain is not None else []
        lawful = None
        if best is None and len(laws) < _MOST_LAWS:
            lawful = _challenged(fitted, clocks, {r.added for r in rounds}) or _believable(fitted, clocks, unknown)
        explained = max((lawful.nats if lawful else 0.0, *(u.nats for u in unknown)))
        if gain is not None and gain.nats > explained + ALTERNATIVE_NATS:
            noise.append(gain)
            fitted = _again(fitted, clocks, fitted.effects, random=(*fitted.random, gain.effect))
            continue
        if lawful is not None:
            laws.append(lawful.law)
            rounds.append(Round(fitted, tuple(candidates), None, lawful.law))
            fitted = _without_idlers(lawful.fit, clocks, {e.name for e in start})
            noise, fitted = _without_idle_noise(noise, fitted, clocks)
            continue
        full = len([r for r in rounds if r.added is not None]) >= most
        rounds.append(Round(fitted, tuple(candidates), None if best is None or full else best.score.effect.name))
        if best is None or best.fit is None or full:
            break
        # believe it: robust weights are taken anew, because what looked like outliers may be explained now
        fitted = _again(best.fit, clocks, best.fit.effects, random=best.fit.random)
        fitted = _reshaped(fitted, clocks, best.score.effect.name)
    bursts = slip_bursts(fitted)
    if bursts is not None:
        noise.append(RandomGain(bursts, _PLAIN_NATS))
    elif not noise and not unknown and (tails := heavy_tails(fitted)) is not None:
        noise.append(RandomGain(*tails))
    given = {e.name for e in start}
    fitted = with_one_heading(fitted, given, lambda said: _again(fitted, clocks, said, random=fitted.random))
    fitted = _without_idlers(fitted, clocks, given)
    kept = {effect.name for effect in fitted.effects}
    believed_laws = tuple(one for one in laws if one.law is not None and one.law.effect.name in kept)
    added = {r.added for r in rounds}
    margins = {e.name: law_margin(fitted, e, clocks.free) for e in fitted.effects if e.name in added}
    return Learned(
        clocks, tuple(rounds), tuple(noise), (*laws, *unknown), believed_laws, margins, fitted, ten_second_error(fitted)
    )


def _reshaped(fitted: Fit, clocks: Clocks, name: str) -> Fit:
    """Look for the shape of an effect anew, now that what it explains is no noise any more."""
    (effect,) = (e for e in fitted.effects if e.name == name)
    if all(p.amplitude for p in parameters(effect)):
        return fitted
    bare, believed = put_back(fitted, effect, clocks.free)
    still = replace(effect, **{p.name: p.identity for p in amplitudes(effect)})  # type: ignore[type-var]
    moved = best_member(bare, [still, *type(effect).scan(fitted.problem.motions)], believed)
    others = [e for e in fitted.effects if e is not effect]
    again = _again(fitted, clocks, [*others, moved], random=fitted.random)
    return again if again.log_likelihood > fitted.log_likelihood + _WORTH_NATS else fitted


def _wandering(fitted: Fit, believed: Array, best: Candidate | None) -> RandomGain | None:
    """Return the wandering gain that explains more than every cause does; anything unmodelled looks like one."""
    gains = random_gains(fitted, believed)
    rival = best.gain if best is not None else 0.0
    return gains[0] if gains and gains[0].nats > rival + ALTERNATIVE_NATS else None


class _Lawful(NamedTuple):
    """A dependence whose law may be believed, the fit with it, and the nats that it gains, prices paid."""

    law: Unknown
    fit: Fit
    nats: float


def _believable(fitted: Fit, clocks: Clocks, unknown: Sequence[Unknown]) -> _Lawful | None:
    """Return the plainest dependence whose law gains and does not spoil the path, and the fit with it."""
    have = {effect.name for effect in fitted.effects}
    lawful = [(one, one.law) for one in unknown if one.law is not None and one.law.effect.name not in have]
    for one, law in lawful[:_LAWS_TRIED]:
        again = _again(fitted, clocks, (*fitted.effects, law.effect), random=fitted.random)
        gain = again.log_likelihood - fitted.log_likelihood - law.price
        if gain > 0.0 and ten_second_error(again) <= HARM * ten_second_error(fitted):
            return _Lawful(one, again, gain)
    return None


def _challenged(fitted: Fit, clocks: Clocks, added: set[str | None]) -> _Lawful | None:
    """Return a law that explains plainly more than a known effect which was added, and the fit with it instead."""
    for effect in fitted.effects:
        found = better_law(fitted, effect, clocks.free) if effect.name in added else None
        if found is None:
            continue
        one, worth = found
        law = one.law
        others = [e for e in fitted.effects if e is not effect]
        if law is None or law.effect.name in {e.name for e in others}:
            continue
        again = _again(fitted, clocks, (*others, law.effect), random=fitted.random)
        gain = again.log_likelihood - fitted.log_likelihood - law.price + worth
        if gain > CHALLENGE_NATS and ten_second_error(again) <= HARM * ten_second_error(fitted):
            return _Lawful(one, again, gain)
    return None


def _without_idle_noise(noise: list[RandomGain], fitted: Fit, clocks: Clocks) -> tuple[list[RandomGain], Fit]:
    """Drop wandering gains that a law has made idle."""
    if not fitted.random:
        return noise, fitted
    calm = _again(fitted, clocks, fitted.effects, random=())
    if fitted.log_likelihood - calm.log_likelihood >= _DROP_NATS + _NOISE_PRICE * len(fitted.random):
        return noise, fitted
    return [gain for gain in noise if gain.effect.name not in WANDERING], calm


def _again(fitted: Fit, clocks: Clocks, effects: Sequence[Effect], random: Sequence[Effect]) -> Fit:
    """Fit the same recordings again, from where a fit has come to."""
    problem = fitted.problem
    return fit(
        problem.recordings,
        effects,
        clocks=problem.clocks,
        free_clocks=clocks.free,
        approach=problem.approach,
        start=fitted.noise.free,
        random=random,
    )


def _without_idlers(fitted: Fit, clocks: Clocks, keep: set[str]) -> Fit:
    """Drop effects that the later ones have made idle: a Wald test first, because refits cost time."""
    while fitted.effects:
        worth = {name: 0.5 * square for name, square in fitted.wald.items() if name not in keep}
        idlest = min(worth, key=worth.__getitem__, default=None)
        if idlest is None or worth[idlest] >= _DROP_NATS:
            return fitted
        kept = [e for e in fitted.effects if e.name != idlest]
        fitted = _again(fitted, clocks, kept, random=fitted.random)
    return fitted
