"""All laws on a drive thinned to a few increments of every interval: the same, whatever else is believed."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.study.select.basis import laws
from odomcorrupt.study.select.channels import MOVES, views
from odomcorrupt.study.select.subsample import sampled

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Motion
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.problem import Problem
    from odomcorrupt.study.select.basis import Law
    from odomcorrupt.study.select.channels import Action

__all__ = ["LawSamples"]


class LawSamples:
    """What laws are, and what a unit of error does, on average over each of the K intervals of a problem."""

    def __init__(self, problem: Problem) -> None:
        self._nodes, self._motions = problem.nodes, problem.motions
        self._means: dict[tuple[str, frozenset[str], str], Array] = {}
        self._units: dict[Action, list[tuple[str, Array]]] = {}

    @cached_property
    def laws(self) -> list[Law]:
        """All of them."""
        return laws(self._motions)

    @cached_property
    def _seen(self) -> dict[str, Motion]:
        return views(sampled(self._nodes, self._motions))

    @cached_property
    def _whole(self) -> list[dict[str, Motion]]:
        return [views(m) for m in self._motions]

    def units(self, action: Action) -> list[tuple[str, Array]]:
        """Return the views of an action, and what (K, 3) a unit of error there does to the residuals of an interval."""
        if action not in self._units:
            track_m = self._motions[0].track_m
            moved = [(m.dt_s, action.rates(v, track_m)) for m, v in zip(self._motions, self._whole, strict=True)]
            self._units[action] = [
                (view, self._nodes.column(np.concatenate([dt_s[:, None] * rates[i][1] for dt_s, rates in moved])))
                for i, (view, _) in enumerate(moved[0][1])
            ]
        return self._units[action]

    def means_of_all(self, view: str, action: Action) -> Array:
        """Return the means (K, J) of the parts of all laws that reach what an action acts on."""
        move = "omega" if action.move == "omega" else "v"
        key = (view, action.reaches, move)
        if key not in self._means:
            self._means[key] = self.means(self.reaching(action), view, move)
        return self._means[key]

    def reaching(self, action: Action) -> list[Law]:
        """Return the laws that an action is tried with."""
        return [law for law in self.laws if not action.reaches.isdisjoint(law.reaches)]

    def means(self, tried: Sequence[Law], view: str, move: str) -> Array:
        """Return the means (K, J) of the laws' parts over the intervals, weighted by how far each sample moves."""
        seen, count = self._seen[view], len(self._nodes)
        values = np.stack([part(seen) for law in tried for part in law.parts], axis=1)
        weight = np.abs(MOVES[move](seen)).reshape(count, -1) + 1e-9
        weight = weight / weight.sum(axis=1, keepdims=True)
        means: Array = np.einsum("ks,ksj->kj", weight, values.reshape(count, -1, values.shape[1]))
        return means
