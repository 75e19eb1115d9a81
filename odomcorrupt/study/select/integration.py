"""Detection of odometry integrated by Euler's method, whose error equals a negative side slip.

Such odometry moves by v dt along the heading at the start of a step instead of that at its middle. So each step of the
truth is displaced by v omega dt^2 / 2 towards the inside of the turn, as by a side slip of -dt / 2.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.score import Score

_STANDARD_ERRORS, _APART = 3.0, 0.05
"""Largest difference between twice the slip and the message period, in standard errors or as a fraction of the period:
stamps, and regressors filtered over an interval, change fitted delays by a few percent."""


def euler_clause(fit: Fit, score: Score) -> str:
    """Return a clause that names Euler's method as the likely cause of a negative side slip; "" if it is not."""
    if score.effect.name != "side_slip":
        return ""
    period_s = float(np.median(np.concatenate([np.diff(r.odometry_s) for r in fit.problem.recordings])))
    allowed_s = max(_STANDARD_ERRORS * 2.0 * float(score.standard_error[0]), _APART * period_s)
    if abs(2.0 * float(score.estimate[0]) + period_s) > allowed_s:
        return ""
    return (
        f": minus half the {period_s:.3g} s between messages, as in odometry integrated with the heading at the "
        "start of each step (Euler's method) instead of at its middle"
    )
