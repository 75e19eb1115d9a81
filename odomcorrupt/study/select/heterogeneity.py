"""Heterogeneity: whether recordings of one robot agree about its parameters, or something was changed between them.

A tyre that was pumped, a load, a gyro that was switched on again differ between recordings and not within one; to a
model of one robot they look like slow noise. So every recording has parameters of its own, estimated together, with
that noise left out; standard errors are cluster-robust.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.study.estimate.cluster_variance import between_blocks, block_of, inflation, shared_variance
from odomcorrupt.study.estimate.random_process import without_random
from odomcorrupt.study.io.clock import clock_leaders
from odomcorrupt.study.select.score import project_out

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit

__all__ = ["ParameterDifference", "disagreements"]

_CHANGING = ("wheel_scale", "unequal_wheels", "wheelbase", "gyro_bias")
"""What loads, tyres, floors and a switch change between two drives."""
_KNOWN = 0.5
"""Part of what is possible that an error may be, for a recording to have a say."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterDifference:
    """A parameter that differs between recordings.

    effect, parameter, unit : which it is
    recordings : names of those that determine it
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


def disagreements(fit: Fit, level: float) -> tuple[ParameterDifference, ...]:
    """Return the parameters that recordings disagree about, the plainest first; none where there is one recording.

    level : probability of any, where there is none
    """
    problem = fit.problem
    leaders = np.array(clock_leaders(problem.recordings))
    runs = [int(leader) for leader in np.unique(leaders)]
    if len(runs) < 2:
        return ()
    kinds = registry()
    own = {e.name: e for e in problem.effects}
    asked = [own.get(name) or kinds[name]() for name in _CHANGING]
    others = replace(
        fit, problem=replace(problem, effects=tuple(e for e in problem.effects if e.name not in _CHANGING))
    )
    calm = replace(others, noise=without_random(fit.noise, problem, others.design_matrix), random=())
    belongs = leaders[problem.run]
    common = [problem.columns(effect) for effect in asked]
    each = np.concatenate([column * (belongs == run)[:, None, None] for column in common for run in runs], axis=2)
    rest = project_out(calm)
    white = rest.of(calm.noise.whitener.whiten(each))
    covariance = np.linalg.pinv(white.T @ white, hermitian=True)
    estimate = covariance @ (white.T @ rest.residual)
    error = np.sqrt(np.diag(covariance) * _inflation(fit, white @ covariance, rest.residual - white @ estimate))
    found = []
    for number, effect in enumerate(asked):
        (p,) = amplitudes(effect)
        rows = slice(number * len(runs), (number + 1) * len(runs))
        able = (error[rows] > 0.0) & (error[rows] < _KNOWN * min(p.high, -p.low))
        values, errors = getattr(effect, p.name) + estimate[rows][able], error[rows][able]
        if able.sum() < 2:
            continue
        weight = 1.0 / errors**2
        square = float(np.sum(weight * (values - np.average(values, weights=weight)) ** 2))
        chance = min(1.0, len(_CHANGING) * float(chi2.sf(square, len(values) - 1)))
        if chance < level:
            one = ParameterDifference(
                effect=effect.name,
                parameter=p.name,
                unit=p.unit,
                recordings=tuple(problem.recordings[run].name for run, can in zip(runs, able, strict=True) if can),
                values=tuple(values.tolist()),
                standard_errors=tuple(errors.tolist()),
                p=chance,
            )
            found.append((square, one))
    return tuple(one for _, one in sorted(found, key=lambda pair: -pair[0]))


def _inflation(fit: Fit, pull: Array, rest: Array) -> Array:
    """Return by how much variances (p,) are larger than the noise model says, as blocks of the drive show it."""
    variance, dof = between_blocks(np.repeat(block_of(fit.problem), 3), pull, rest)
    return inflation(variance, dof, shared_variance(variance, dof))
