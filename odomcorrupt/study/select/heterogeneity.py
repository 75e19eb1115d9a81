"""Whether the recordings are of one robot as it was: a tyre was pumped, a load was put on, a gyro was switched on anew.

What differs between recordings and stays the same within each looks like slow noise to a search that believes in one
robot. So each recording is asked for its own numbers, all together, with that noise left out; errors are no smaller
than its blocks say.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.study.estimate.cluster_variance import between_blocks, block_of, inflation, shared_variance
from odomcorrupt.study.estimate.gauss_newton import design_matrix
from odomcorrupt.study.estimate.random_process import without_random
from odomcorrupt.study.io.clock import clock_leaders
from odomcorrupt.study.select.score import left_over

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit

__all__ = ["Disagreement", "disagreements"]

_CHANGING = ("wheel_scale", "unequal_wheels", "wheelbase", "gyro_bias")
"""What loads, tyres, floors and a switch change between two drives."""
_LEVEL = 1e-3
_KNOWN = 0.5
"""Part of what is possible that an error may be, for a recording to have a say."""


@dataclass(frozen=True, slots=True)
class Disagreement:
    """A parameter that recordings disagree about.

    effect, parameter, unit : which it is
    recordings : names of those that can tell
    values, standard_errors : (R,) what each of them says
    p : probability of such a disagreement of one robot
    """

    effect: str
    parameter: str
    unit: str
    recordings: tuple[str, ...]
    values: tuple[float, ...]
    standard_errors: tuple[float, ...]
    p: float


def disagreements(fit: Fit) -> tuple[Disagreement, ...]:
    """Return the parameters that recordings disagree about, the plainest first; none where there is one recording."""
    problem = fit.problem
    leaders = np.array(clock_leaders(problem.recordings))
    runs = [int(leader) for leader in np.unique(leaders)]
    if len(runs) < 2:
        return ()
    kinds = registry()
    own = {e.name: e for e in problem.effects}
    asked = [own.get(name) or kinds[name]() for name in _CHANGING]
    others = tuple(e for e in problem.effects if e.name not in _CHANGING)
    believed = design_matrix(replace(problem, effects=others), fit.free_clocks)
    calm = replace(fit, noise=without_random(fit.noise, problem, believed), random=())
    belongs = leaders[problem.run]
    common = [problem.columns(effect) for effect in asked]
    each = np.concatenate([column * (belongs == run)[:, None, None] for column in common for run in runs], axis=2)
    left = left_over(calm, believed)
    white = left.of(calm.noise.whitener.whiten(each))
    covariance = np.linalg.pinv(white.T @ white, hermitian=True)
    estimate = covariance @ (white.T @ left.residual)
    error = np.sqrt(np.diag(covariance) * _inflated(fit, white @ covariance, left.residual - white @ estimate))
    found = []
    for number, effect in enumerate(asked):
        (p,) = amplitudes(effect)
        rows = slice(number * len(runs), (number + 1) * len(runs))
        able = (error[rows] > 0.0) & (error[rows] < _KNOWN * p.high)
        values, errors = getattr(effect, p.name) + estimate[rows][able], error[rows][able]
        if able.sum() < 2:
            continue
        weight = 1.0 / errors**2
        square = float(np.sum(weight * (values - np.average(values, weights=weight)) ** 2))
        chance = min(1.0, len(_CHANGING) * float(chi2.sf(square, len(values) - 1)))
        if chance < _LEVEL:
            names = tuple(problem.recordings[run].name for run, says in zip(runs, able, strict=True) if says)
            numbers = tuple(values.tolist()), tuple(errors.tolist())
            told = Disagreement(effect.name, p.name, p.unit, names, *numbers, chance)
            found.append((square, told))
    return tuple(told for _, told in sorted(found, key=lambda pair: -pair[0]))


def _inflated(fit: Fit, pull: Array, left: Array) -> Array:
    """Return by how much variances (p,) are larger than the noise model says, for all that blocks show of them."""
    variance, dof = between_blocks(np.repeat(block_of(fit.problem), 3), pull, left)
    return inflation(variance, dof, shared_variance(variance, dof))
