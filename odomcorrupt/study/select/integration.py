"""Recognition of odometry that is integrated by Euler's method, an error that resembles a negative side slip.

Each step v dt is then displaced along the heading at its start and not along that at its middle. The truth therefore
lies v omega dt^2 / 2 per step inside the turn: a side slip of -dt / 2.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.score import Score

__all__ = ["euler_clause"]

_STANDARD_ERRORS, _APART = 3.0, 0.05
"""Greatest difference between twice the slip and the message period, in standard errors or as a fraction of the period
(stamps and regressors filtered over an interval change fitted delays by a few percent)."""


def euler_clause(fit: Fit, score: Score) -> str:
    """Return that the odometry seems to be integrated by Euler's method, as a clause; "" if it does not."""
    if score.effect.name != "side_slip":
        return ""
    period_s = float(np.median(np.concatenate([np.diff(r.odometry_s) for r in fit.problem.recordings])))
    allowed_s = max(_STANDARD_ERRORS * 2.0 * float(score.standard_error[0]), _APART * period_s)
    if abs(2.0 * float(score.estimate[0]) + period_s) > allowed_s:
        return ""
    return (
        f": minus half the {period_s:.3g} s between messages, as odometry shows that is integrated with the heading at "
        "the start of each step (Euler's method) and not at its middle"
    )
