"""Exact columns of laws, and with them the very shape of one that is believed."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.study.select.channels import views
from odomcorrupt.study.select.nelder_mead import hilltop
from odomcorrupt.study.select.score import left_over

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.estimate.problem import Problem
    from odomcorrupt.study.select.basis import Law
    from odomcorrupt.study.select.channels import Action

__all__ = ["LawColumns", "topmost"]

_SIMPLEX = 0.25
"""How far the last look goes at first, in parts of the steps in which a shape was looked for."""


class LawColumns:
    """What laws do to the residuals of a problem."""

    def __init__(self, problem: Problem) -> None:
        self._problem, self._seen = problem, [views(m) for m in problem.motions]

    def of(self, law: Law, action: Action) -> Array:
        """Return (K, 3, p): what a unit of each number of a law does there."""
        moved = []
        for m, seen in zip(self._problem.motions, self._seen, strict=True):
            rates = action.rates(seen, m.track_m)
            moved.append([sum((part(seen[v]) * m.dt_s)[:, None] * rate for v, rate in rates) for part in law.parts])
        columns = [self._problem.nodes.column(np.concatenate(errors)) for errors in zip(*moved, strict=True)]
        return np.stack(columns, axis=2)


def topmost(fit: Fit, believed: Array, law: Law, action: Action) -> tuple[Law, Action]:
    """Return the law of the best shape near this one, and the direction in which it acts if it has one.

    fit, believed : a fit with the law's own work still in its residual, and the columns (K, 3, q) of all else
    """
    columns, left, remade = LawColumns(fit.problem), left_over(fit, believed), law.remade
    turned = bool(action.neighbours(1.0))
    if remade is None and not turned:
        return law, action

    def shaped(values: Array) -> tuple[Law, Action]:
        moved = remade(tuple(values[: len(law.shape)].tolist())) if remade is not None else law
        return moved, replace(action, toward=float(values[-1])) if turned else action

    def gain(values: Array) -> float:
        white = left.of(fit.noise.whitener.whiten(columns.of(*shaped(values))))
        return float((white @ np.linalg.lstsq(white, left.residual, rcond=None)[0]) @ left.residual)

    start = np.array([*law.shape, *([action.toward] if turned else [])])
    steps = _SIMPLEX * np.array([*law.steps, *([action.neighbours(1.0)[1].toward - action.toward] if turned else [])])
    return shaped(hilltop(gain, start, steps))
