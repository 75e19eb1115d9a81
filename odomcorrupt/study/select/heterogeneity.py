"""Heterogeneity: test for differences between the parameters of several recordings of one robot.

Tyre pressure, load and the bias of a restarted gyro differ between recordings and not within one. In a common model
they look like slow noise. The test therefore estimates separate parameters for each recording, jointly and without that
noise; standard errors are cluster-robust.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.study.estimate.random_process import without_random
from odomcorrupt.study.estimate.robust_errors import between_blocks, block_of, inflation, shared_variance
from odomcorrupt.study.io.clock import clock_leaders
from odomcorrupt.study.select.evidence import project_out

if TYPE_CHECKING:
    from odomcorrupt.study.estimate.gauss_newton import Fit

_CHANGING = ("wheel_scale", "unequal_wheels", "wheelbase", "gyro_bias")
"""Effects whose size loads, tyres, floors and a restart change between drives."""
_LARGEST_ERROR = 0.5
"""Largest standard error of a recording that is compared, as a fraction of the parameter's physical range."""
_FEWEST = 4
"""Least number of recordings that can form groups."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterDifference:
    """A parameter that differs between recordings.

    effect, parameter, unit : names of the effect and its parameter, and the unit
    recordings : names of the R recordings that determine the parameter
    values, standard_errors : (R,) estimates from each of them
    p : probability of such a difference for an unchanged robot
    """

    effect: str
    parameter: str
    unit: str
    recordings: tuple[str, ...]
    values: tuple[float, ...]
    standard_errors: tuple[float, ...]
    p: float

    @property
    def groups(self) -> tuple[float, list[str], list[str]] | None:
        """Two groups of recordings that are farther apart than each is wide, None if there are none.

        By how much the parameter is larger in the second group, and the names of the recordings of both.
        """
        values, order = np.array(self.values), np.argsort(self.values)
        cut = int(np.argmax(np.diff(values[order]))) + 1
        both = order[:cut], order[cut:]
        apart = float(values[both[1]].mean() - values[both[0]].mean())
        if len(order) < _FEWEST or 2.0 * max(float(np.ptp(values[some])) for some in both) > apart:
            return None
        low, high = ([self.recordings[i] for i in sorted(some.tolist())] for some in both)
        return apart, low, high


def disagreements(fit: Fit, level: float) -> tuple[ParameterDifference, ...]:
    """Return the parameters that differ between recordings, the most significant first; none for a single recording.

    level : probability of any reported difference if there is none
    """
    problem = fit.problem
    leaders = np.array(clock_leaders(problem.recordings))
    runs = [int(leader) for leader in np.unique(leaders)]
    if len(runs) < 2:
        return ()
    tested = [fit.by_name.get(name) or registry()[name]() for name in _CHANGING]
    kept = tuple(e for e in problem.effects if e.name not in _CHANGING)
    others = replace(fit, problem=replace(problem, effects=kept))
    without_noise = replace(others, noise=without_random(fit.noise, problem, others.design_matrix), random=())
    belongs = leaders[problem.run]
    common = [problem.columns(effect) for effect in tested]
    each = np.concatenate([column * (belongs == run)[:, None, None] for column in common for run in runs], axis=2)
    rest = project_out(without_noise)
    white = rest.of(without_noise.noise.whitener.whiten(each))
    covariance = np.linalg.pinv(white.T @ white, hermitian=True)
    estimate = covariance @ (white.T @ rest.residual)
    left = rest.residual - white @ estimate
    variance, dof = between_blocks(np.repeat(block_of(fit.problem), 3), white @ covariance, left)
    error = np.sqrt(np.diag(covariance) * inflation(variance, dof, shared_variance(variance, dof)))
    found = []
    for number, effect in enumerate(tested):
        (p,) = amplitudes(effect)
        rows = slice(number * len(runs), (number + 1) * len(runs))
        valid = (error[rows] > 0.0) & (error[rows] < _LARGEST_ERROR * min(p.high, -p.low))
        values, errors = getattr(effect, p.name) + estimate[rows][valid], error[rows][valid]
        if valid.sum() < 2:
            continue
        weight = 1.0 / errors**2
        square = float(np.sum(weight * (values - np.average(values, weights=weight)) ** 2))
        chance = min(1.0, len(_CHANGING) * float(chi2.sf(square, len(values) - 1)))
        if chance < level:
            one = ParameterDifference(
                effect=effect.name,
                parameter=p.name,
                unit=p.unit,
                recordings=tuple(problem.recordings[run].name for run, can in zip(runs, valid, strict=True) if can),
                values=tuple(values.tolist()),
                standard_errors=tuple(errors.tolist()),
                p=chance,
            )
            found.append((square, one))
    return tuple(one for _, one in sorted(found, key=lambda pair: -pair[0]))
