"""The whole loop: name the first thing that is missing, believe it exactly, look again, until nothing is left.

Where no known effect explains more, but a simple law of one driver does, the law is believed as effects are: known
effects that only stood in for it fall idle and are dropped, and the error falls by what the law explains.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import amplitudes, parameters
from odomcorrupt.study.estimate.clocks import Clocks, find_clocks
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.drift_error import ten_second_error
from odomcorrupt.study.estimate.gauss_newton import Fit, fit
from odomcorrupt.study.estimate.random_process import WANDERING
from odomcorrupt.study.estimate.robust_errors import with_robust_errors
from odomcorrupt.study.io.encoders import encoder_effects, restore_lost
from odomcorrupt.study.select.acceptance import believable, challenger
from odomcorrupt.study.select.basis_samples import LawSamples
from odomcorrupt.study.select.basis_scores import likeliest
from odomcorrupt.study.select.candidates import Candidate, next_effect, price
from odomcorrupt.study.select.dependence import Unknown, unknown_dependences
from odomcorrupt.study.select.heading_source import with_one_heading
from odomcorrupt.study.select.heterogeneity import Disagreement, disagreements
from odomcorrupt.study.select.model_comparison import ALTERNATIVE_NATS, CHALLENGE_NATS, Rivalry, drop_term, rivalry
from odomcorrupt.study.select.noise_identification import (
    PLAIN_NATS,
    beside_bursts,
    odd_steps_named,
    wandering_gain,
    worth_of,
)
from odomcorrupt.study.select.random_effects import RandomGain
from odomcorrupt.study.select.refit import backward_eliminate, eliminate_random, iterate
from odomcorrupt.study.select.shape_search import Members

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.io.recording import Recording

__all__ = ["Learned", "Round", "learn"]

_MOST = 6
_MOST_NOISE = 2
_MOST_LAWS = 2
_WORTH_NATS = 1.0
"""What a new shape has to gain."""


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
    disagreements : what the recordings do not agree about
    held_out : log likelihood that each part of the model gains on data it was not fitted on, and its standard error
    """

    clocks: Clocks
    rounds: tuple[Round, ...]
    noise: tuple[RandomGain, ...]
    unknown: tuple[Unknown, ...]
    laws: tuple[Unknown, ...]
    margins: Mapping[str, float]
    fit: Fit
    error_m: float
    disagreements: tuple[Disagreement, ...] = ()
    held_out: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def added(self) -> tuple[str, ...]:
        """Names of what the loop added and kept, in order."""
        return tuple(look.added for look in self.steps if look.added is not None)

    @property
    def steps(self) -> tuple[Round, ...]:
        """Looks whose addition the final model still has; of one that left and came back, the later look."""
        kept = {effect.name for effect in self.fit.effects}
        stayed = {look.step: look for look in self.rounds if look.added in kept or look.law in self.laws}
        return tuple(look for look in self.rounds if stayed.get(look.step) is look)


@dataclass(frozen=True, slots=True)
class _Way:
    """One way through the search: its looks, what was believed on it, what is left, and where it has come to."""

    rounds: tuple[Round, ...]
    noise: tuple[RandomGain, ...]
    laws: tuple[Unknown, ...]
    unknown: tuple[Unknown, ...]
    fit: Fit
    margins: Mapping[str, float]

    @property
    def price(self) -> float:
        """Nats that its effects and laws must gain."""
        named = {one.law.effect.name: one.law.price for one in self.laws if one.law is not None}
        motions, count = self.fit.problem.motions, len(self.fit.problem.nodes)
        return sum(
            named[e.name] if e.name in named else price(e, max(len(type(e).scan(motions)), 1), count)
            for e in self.fit.effects
        )


def learn(
    recordings: Sequence[Recording], start: Sequence[Effect] = (), *, law_name: str = "diffusion", most: int = _MOST
) -> Learned:
    """Search from a model with the given effects; `most` bounds how many are added."""
    encoders = encoder_effects(recordings[0])
    recordings = [restore_lost(recording, encoders) for recording in recordings]
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
    search = _Search({e.name for e in start}, tuple(RandomGain(e, PLAIN_NATS) for e in encoders), most)
    way = search.from_here(fitted)
    other = search.law_first(way)
    if other is not None and _explains_more(other, way):
        way = other
    kept = {effect.name for effect in way.fit.effects}
    believed_laws = tuple(one for one in way.laws if one.law is not None and one.law.effect.name in kept)
    told = with_robust_errors(way.fit, kept - search.given)
    errors = tuple((float(offset), float(rate)) for offset, rate in told.clock_errors)
    clocks = replace(clocks, clocks=told.problem.clocks, errors=errors)
    return Learned(
        clocks, way.rounds, way.noise, (*believed_laws, *way.unknown), believed_laws, way.margins, told,
        ten_second_error(told), disagreements(told),
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Search:
    """How to search: which clocks are free, what the user gave, what encoders did, and how many effects at most."""

    given: set[str]
    encoders: tuple[RandomGain, ...]
    most: int

    def from_here(self, fitted: Fit, first: Round | None = None) -> _Way:
        """Look, believe and look again until nothing is left; `first` is a look that has been taken already."""
        rounds: list[Round] = [first] if first is not None else []
        noise = list(self.encoders)
        laws: list[Unknown] = [first.law] if first is not None and first.law is not None else []
        tested: tuple[Fit, dict[str, Rivalry]] = (fitted, {})
        while True:
            candidates = next_effect(fitted)
            best = candidates[0] if candidates and not candidates[0].refused else None
            believed = fitted.design_matrix()
            gain = wandering_gain(fitted, believed, best) if len(fitted.random) < _MOST_NOISE else None
            unknown, samples = [], LawSamples(fitted.problem)
            if best is None or gain is not None:
                unknown = unknown_dependences(fitted, believed, likeliest(fitted, believed, samples))
            if best is None:
                tested = _tested(fitted, rounds, samples)
            lawful = None
            if len(laws) < _MOST_LAWS and (best is None or gain is not None):
                lawful = challenger(fitted, tested[1]) if best is None else None
                lawful = lawful or believable(fitted, unknown)
            if gain is not None:
                calmer = fitted.refit(random=(*fitted.random, gain.effect))
                explained = max((lawful.nats if lawful else 0.0, *(u.nats for u in unknown)))
                if worth_of(gain, calmer, fitted) > explained + ALTERNATIVE_NATS:
                    fitted, effect = iterate(calmer, gain.effect)
                    noise.append(replace(gain, effect=effect))
                    continue
            if lawful is not None and best is not None and lawful.nats < best.gain + CHALLENGE_NATS:
                lawful = None
            if lawful is not None:
                laws.append(lawful.law)
                rounds.append(Round(fitted, tuple(candidates), None, lawful.law))
                fitted = backward_eliminate(lawful.fit, self.given)
                noise, fitted = eliminate_random(noise, fitted)
                continue
            full = len([r for r in rounds if r.added is not None]) >= self.most
            rounds.append(Round(fitted, tuple(candidates), None if best is None or full else best.score.effect.name))
            if best is None or best.fit is None or full:
                break
            # believe it: robust weights are taken anew, because what looked like outliers may be explained now
            fitted = best.fit.refit()
            fitted = _reshaped(fitted, best.score.effect.name)
        return self._ended(fitted, rounds, noise, laws, unknown, tested)

    def _ended(
        self,
        fitted: Fit,
        rounds: Sequence[Round],
        noise: list[RandomGain],
        laws: Sequence[Unknown],
        unknown: Sequence[Unknown],
        tested: tuple[Fit, dict[str, Rivalry]],
    ) -> _Way:
        """Return where the looks have come to: odd stretches named, one heading, nothing idle, each name tested."""
        odd = odd_steps_named(fitted, calm=not noise and not unknown)
        noise, fitted = beside_bursts(noise, fitted) if odd else (noise, fitted)
        noise += odd
        fitted = with_one_heading(fitted, self.given, fitted.refit)
        fitted = backward_eliminate(fitted, self.given)
        bursts = [gain.effect for gain in odd if gain.effect.name == "slip_burst"]
        if bursts:  # what they do is no noise of every step
            fitted = fitted.refit((*fitted.effects, *bursts))
        if tested[0] is not fitted:
            tested = _tested(fitted, rounds, LawSamples(fitted.problem))
        margins = {name: own.margin for name, own in tested[1].items()}
        return _Way(tuple(rounds), tuple(noise), tuple(laws), tuple(unknown), fitted, margins)

    def law_first(self, way: _Way) -> _Way | None:
        """Return the way that begins with a law, where one explains more than the first name and names did not suffice.

        Several names together may stand in for one law, and none of them then gives way to it alone.
        """
        first = way.rounds[0]
        if first.added is None or not (way.laws or way.unknown or min(way.margins.values(), default=1.0) < 0.0):
            return None
        believed = first.before.design_matrix()
        lawful = believable(first.before, unknown_dependences(first.before, believed))
        if lawful is None or lawful.nats < first.candidates[0].gain + CHALLENGE_NATS:
            return None
        return self.from_here(lawful.fit, Round(first.before, first.candidates, None, lawful.law))


def _explains_more(one: _Way, other: _Way) -> bool:
    """Tell whether one way explains plainly more than another, whichever stretches are set apart as odd.

    Names are the likelier before; not where the other way needed a law besides.
    """
    worth = other.price - one.price
    same = other.fit.refit(weights=one.fit.noise.weights)
    turned = one.fit.refit(weights=other.fit.noise.weights)
    return min(
        one.fit.log_likelihood - same.log_likelihood + worth, turned.log_likelihood - other.fit.log_likelihood + worth
    ) > (ALTERNATIVE_NATS if other.laws else CHALLENGE_NATS)  # fmt: skip


def _tested(fitted: Fit, rounds: Sequence[Round], samples: LawSamples) -> tuple[Fit, dict[str, Rivalry]]:
    """Return a fit, and for each of its effects that was added how laws do in its place."""
    added = {look.added for look in rounds}
    return fitted, {e.name: rivalry(fitted, e, samples) for e in fitted.effects if e.name in added}


def _reshaped(fitted: Fit, name: str) -> Fit:
    """Look for the shape of an effect anew, now that what it explains is no noise any more."""
    (effect,) = (e for e in fitted.effects if e.name == name)
    if all(p.amplitude for p in parameters(effect)):
        return fitted
    bare, believed = drop_term(fitted, effect)
    still = replace(effect, **{p.name: p.identity for p in amplitudes(effect)})  # type: ignore[type-var]
    look = Members(bare, believed)
    moved = look.topmost(look.best([still, *type(effect).scan(fitted.problem.motions)]))
    others = [e for e in fitted.effects if e is not effect]
    shaped = fitted.refit([*others, moved])
    return shaped if shaped.log_likelihood > fitted.log_likelihood + _WORTH_NATS else fitted
