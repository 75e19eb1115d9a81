"""The remainder of an effect: what its mean does not take out, and other causes are easily taken for.

Of velocities that were cut to whole steps, the report does not show what was cut off. Half a step on average goes into
the model; what remains varies with the speed and lasts as long as the speed does, as a random gain, a scale or a track
that is a little off would.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit

__all__ = ["within_remainder"]


def within_remainder(fit: Fit, error: Array) -> bool:
    """Return whether an error is usually no larger than the remainder of the effects in the model, if they have any.

    error : (n, 2) along and in yaw, m/s and rad/s
    """
    most = np.sum([effect.remainder for effect in fit.effects], axis=0)
    return bool(np.any(most > 0.0) and np.all(np.sqrt(np.mean(error**2, axis=0)) <= most))
