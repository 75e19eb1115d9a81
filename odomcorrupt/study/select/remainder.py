"""Remainder of an effect: the part of its error beside the modelled mean, which resembles other causes.

Example: velocities truncated to whole steps. The model contains the mean error, half a step. The rest is unknown,
varies with the speed and persists as long as the speed does, like a random gain or a small error of scale or track.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.counts import Quantization

if TYPE_CHECKING:
    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit

_SAME = 0.2
"""Largest relative difference of ticks and of fitted steps of speed that are the same: wide steps are known to 10 %."""


def within_remainder(fit: Fit, error: Array) -> bool:
    """Return whether the root mean square of an error is within the remainder of the effects in the model, if any.

    error : (n, 2) along and in yaw, m/s and rad/s
    """
    most = np.sum([effect.remainder for effect in fit.effects], axis=0)
    return bool(np.any(most > 0.0) and np.all(np.sqrt(np.mean(error**2, axis=0)) <= most))


def are_its_steps(fit: Fit, effect: Effect) -> bool:
    """Return whether ticks are the steps of speed that an effect of the model leaves: twice its remainder along.

    A wheel's tick is twice the least travel of the robot.
    """
    most = sum(one.remainder[0] for one in fit.effects)
    if not isinstance(effect, Quantization) or not most > 0.0:
        return False
    step = 2.0 * most * float(np.median(fit.problem.motions[0].dt_s))
    return abs(effect.step / (2.0 * step) - 1.0) < _SAME
