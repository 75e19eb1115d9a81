"""Heavy-tailed noise: steps that are now and then much larger than normal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import About, Drawn, Effect, Motion, State, TwistError, parameter
from odomcorrupt.effects.random_state import copied

if TYPE_CHECKING:
    from numpy.random import Generator

    from odomcorrupt.geometry.se2 import Array


@dataclass(frozen=True, slots=True)
class HeavyTails(Effect):
    """Student's t in place of the noise law's normal draws, scaled to the law's variance, so that covariances hold.

    t with nu degrees of freedom is a normal over sqrt(chi-square / nu); nu - 2 in place of nu gives variance 1.
    """

    name = "heavy_tails"
    kind = "noise"
    layer = "draws"
    summary = "the noise has heavy tails: rare steps are much larger than normal ones"
    about = About(
        equation="draws of the noise law ~ Student t with 1 / inverse_dof degrees of freedom and variance 1",
        typical="0.1 to 0.3, ten to three degrees of freedom (an estimate)",
        source="Lange, Little & Taylor 1989, JASA 84 (the t distribution for robust modelling)",
        confused_with=("slip_burst", "gauss_markov", "region_slip"),
        drive="none in particular: visible in single increments, since sums over many are nearly normal",
    )

    inverse_dof: float = parameter("", "one over the degrees of freedom; 0 is normal", low=0.0, high=0.45, typical=0.2)

    def start(self, rng: Generator) -> State:
        """Return the random generator of the widths."""
        return rng

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f = 0: the effect changes the noise, not the motion."""
        return TwistError(np.zeros((len(motion), 3)), state)

    def drawn(self, normals: Array, state: State) -> Drawn:
        """Return t-distributed draws in place of the normals (n, 4), each with its own width."""
        if self.inverse_dof == 0.0:
            return Drawn(normals, state)
        rng = copied(state)
        dof = 1.0 / self.inverse_dof
        return Drawn(normals * np.sqrt((dof - 2.0) / rng.chisquare(dof, normals.shape)), rng)
