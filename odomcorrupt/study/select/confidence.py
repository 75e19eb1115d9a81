"""How sure a name is: the posterior share of what was named among its listed rivals, chance, and something else.

With g the nats that a name gains and g_i those of its rivals (all less what their parameters gain by chance), u the
nats that curves over speed, time, heading and so on still gain when everything named is believed, and w those of
gains that were named as wandering, the odds against the name are

    sum_i exp(T (g_i - g))  +  exp(-T g)  +  exp(LAW - T m)  +  ELSE + (LEFT u + WANDER w) / g

rivals, nothing at all, a law of one driver (m: by how many nats the name explains more), and something else: a cause
that is in no library is explained by a known one in part only, and what is left of it shows, as a curve or as noise
that remembers. `calibrated` alone turns odds into the probability that is told.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, inf, isfinite, log
from typing import TYPE_CHECKING

from odomcorrupt.study.estimate.random_process import WANDERING

if TYPE_CHECKING:
    from odomcorrupt.study.select.stepwise import Learned, Round

__all__ = ["Evidence", "calibrated", "confidence", "evidence_of", "odds_against"]

TEMPER = 1.0
"""T: how much a nat counts; below 1 where the noise model is too narrow."""
ELSE = 0.005
"""Odds against any name however plain: names that the library does not have."""
LEFT = 1.0
"""What is left unexplained, in parts of what the name explains, counts as much as odds against it."""
WANDER = 0.2
"""The same of noise that remembers, which may well be there besides."""
LAW = 1.5
"""Nats by which a law of one driver is the likelier before: of 90 names of the laboratory's third and fourth runs that
explained 2 to 6 nats more than the best law would, 81 were right and 9 wrong, 8 of these for causes of no library."""
HELD_OUT_ERRORS = 2.0
"""A gain on held-out data may be larger than it was seen by so many of its standard errors."""
SLOPE, SHIFT = 1.0, 0.0
"""Of the calibration line in log odds; to be fitted to a reliability curve."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """What speaks for a name and against it, in nats.

    own : what it gains, less what its parameters gain by chance
    rivals : the same of every other candidate that was refitted and not refused; twins are no rivals
    margin : by how much the final model prefers it to the best law of one driver, prices paid
    left : what the plainest unknown dependence still gains in the end
    wandering : what gains that were named as wandering do
    """

    own: float
    rivals: tuple[float, ...] = ()
    left: float = 0.0
    wandering: float = 0.0
    margin: float = inf


def confidence(evidence: Evidence) -> float:
    """Return the probability, within (0, 1), that a name is right, or a twin of what is."""
    return calibrated(odds_against(evidence))


def odds_against(evidence: Evidence) -> float:
    """Return the odds of rivals, nothing and something else together against the name; positive, perhaps infinite."""
    if not evidence.own > 0.0:
        return inf
    rivals = sum(exp(min(TEMPER * (g - evidence.own), 700.0)) for g in evidence.rivals if isfinite(g))
    nothing = exp(-min(TEMPER * evidence.own, 700.0))
    rest = LEFT * max(evidence.left, 0.0) + WANDER * max(evidence.wandering, 0.0)
    law = exp(min(max(LAW - TEMPER * evidence.margin, -700.0), 700.0))
    return rivals + nothing + law + ELSE + rest / evidence.own


def calibrated(odds: float) -> float:
    """Return the probability told for odds against a name: a line in log odds, the one thing that calibration moves."""
    if not isfinite(odds):
        return 0.0
    return 1.0 / (1.0 + exp(min(max(SLOPE * log(odds) + SHIFT, -700.0), 700.0)))


def evidence_of(look: Round, learned: Learned) -> Evidence:
    """Return the evidence for what a look added, in the light of what is left when the search has ended."""
    own, rivals = look.candidates[0].gain, tuple(c.gain for c in look.candidates[1:] if not c.refused)
    # what data that were not fitted say, gives a gain on fitted ones its limit
    nats, error = learned.held_out.get(look.added or "", (inf, 0.0))
    own = min(own, max(nats + HELD_OUT_ERRORS * error, 0.0))
    left = max((u.nats for u in learned.unknown), default=0.0)
    wandering = max((gain.nats for gain in learned.noise if gain.effect.name in WANDERING), default=0.0)
    margin = learned.margins.get(look.added or "", inf)
    return Evidence(own, rivals, left, wandering, margin)
