"""A drive thinned to a few increments of every interval: enough to see where a shape has to be looked at closely."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.geometry.motion import error_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect, Motion
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.intervals import Intervals
    from odomcorrupt.study.estimate.problem import Problem

__all__ = ["Glance", "sampled"]

_SAMPLES = 5
"""Increments of each interval that are looked at."""


def sampled(nodes: Intervals, motions: Sequence[Motion]) -> Motion:
    """Return a few increments of each of the K intervals, evenly spread and as many of each, as one motion."""
    last = np.append(nodes.first[1:], len(nodes.source)) - 1
    steps = np.linspace(nodes.first, last, _SAMPLES).round().astype(np.int64).T.ravel()
    chosen = nodes.source[steps]
    first = motions[0]
    names = [f.name for f in fields(first) if isinstance(getattr(first, f.name), np.ndarray)]
    arrays: dict[str, Any] = {n: np.concatenate([getattr(m, n) for m in motions])[chosen] for n in names}
    return replace(first, **arrays)


class Glance:
    """About what effects of one amplitude do to the residuals, each at a constant rate over every interval."""

    def __init__(self, problem: Problem) -> None:
        self._seen = sampled(problem.nodes, problem.motions)
        dt_s = np.concatenate([m.dt_s for m in problem.motions])
        self._held = np.stack([problem.nodes.column(dt_s[:, None] * unit) for unit in np.eye(3)], axis=2)

    def columns(self, family: Sequence[Effect]) -> Array:
        """Return (K, 3, J): what a small change of each effect's amplitude does, if it remembers nothing."""
        rates = np.empty((len(self._held), 3, len(family)))
        for j, effect in enumerate(family):
            (p,) = amplitudes(effect)
            acting = replace(effect, **{p.name: p.identity + p.step})  # type: ignore[type-var]  # effects are dataclasses
            rate = error_of(acting, self._seen).reshape(len(rates), _SAMPLES, 3).mean(axis=1)
            rates[:, :, j] = -rate / p.step
        columns: Array = np.einsum("kic,kcj->kij", self._held, rates)
        return columns
