"""The whole loop: name the first thing that is missing, believe it exactly, look again, until nothing is left."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.study.approach import choose_approach
from odomcorrupt.study.fit import Fit, fit
from odomcorrupt.study.search import Candidate, Clocks, find_clocks, next_effect, ten_second_error

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.trajectory import Recording

__all__ = ["Learned", "Round", "learn"]

_MOST = 6
_DROP_NATS = 3.3
ALTERNATIVE_NATS = 3.0
"""Effects that explain the data this nearly as well are alternatives: the data cannot tell them apart."""


@dataclass(frozen=True, slots=True)
class Round:
    """One look: the model before it, all candidates (the one that was added first), and what was added."""

    before: Fit
    candidates: tuple[Candidate, ...]
    added: str | None

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
    """Clocks, the rounds in order (the last one added nothing, or the limit was reached), and the final fit."""

    clocks: Clocks
    rounds: tuple[Round, ...]
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
    approach = choose_approach(recordings, law_name)
    clocks = find_clocks(recordings, approach)
    fitted = fit(recordings, start, clocks=clocks.clocks, free_clocks=clocks.free, approach=approach)
    rounds: list[Round] = []
    while True:
        candidates = next_effect(fitted, clocks.free)
        best = candidates[0] if candidates and not candidates[0].refused else None
        full = len(rounds) >= most
        rounds.append(Round(fitted, tuple(candidates), None if best is None or full else best.score.effect.name))
        if best is None or best.fit is None or full:
            break
        # believe it: robust weights are taken anew, because what looked like outliers may be explained now
        fitted = fit(
            recordings,
            best.fit.effects,
            clocks=best.fit.problem.clocks,
            free_clocks=clocks.free,
            approach=approach,
            start=best.fit.noise.free,
        )
    fitted = _without_idlers(fitted, clocks, {e.name for e in start})
    return Learned(clocks, tuple(rounds), fitted, ten_second_error(fitted))


def _without_idlers(fitted: Fit, clocks: Clocks, keep: set[str]) -> Fit:
    """Drop effects that the later ones have made idle: a Wald test first, because refits cost time."""
    while len(fitted.effects) > 1:
        idle = [name for name, gain in _wald(fitted).items() if gain < _DROP_NATS and name not in keep]
        if not idle:
            return fitted
        problem = fitted.problem
        fitted = fit(
            problem.recordings,
            [e for e in problem.effects if e.name != idle[0]],
            clocks=problem.clocks,
            free_clocks=clocks.free,
            approach=problem.approach,
            start=fitted.noise.free,
        )
    return fitted


def _wald(fitted: Fit) -> dict[str, float]:
    """Return about how many nats each effect is worth, weakest first."""
    worth = {}
    position = 0
    for effect in fitted.effects:
        own = amplitudes(effect)
        rows = slice(position, position + len(own))
        position += len(own)
        away = np.array([getattr(effect, p.name) - p.identity for p in own])
        covariance = fitted.noise.theta_covariance[rows, rows]
        worth[effect.name] = 0.5 * float(away @ np.linalg.pinv(covariance, hermitian=True) @ away)
    return dict(sorted(worth.items(), key=lambda pair: pair[1]))
