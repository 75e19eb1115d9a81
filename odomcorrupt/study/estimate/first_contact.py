"""Outlier events that backlash explains at the first motion.

At the start of a drive the position of the gears is unknown.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.gears import Backlash
from odomcorrupt.geometry.motion import motion_of
from odomcorrupt.study.estimate.outliers import single_events, usual_residual

if TYPE_CHECKING:
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.estimate.outliers import Event
    from odomcorrupt.study.io.recording import Recording

_ERRORS = 3.0
"""Usual residuals by which an event may exceed the play."""


def unexplained_events(fit: Fit) -> list[Event]:
    """Return the single events of a fit, except steps of the first motion that play in the model may cause.

    The model assumes gears in contact at the first motion. If they are not, a wheel loses up to the play before its
    first reversal; from then on its gears are known.
    """
    found = single_events(fit)
    play = next((effect for effect in fit.effects if isinstance(effect, Backlash)), None)
    if play is None:
        return found
    recordings = {recording.name: recording for recording in fit.problem.recordings}
    usual = usual_residual(fit)
    return [event for event in found if not _within_play(event, play, recordings[event.recording], usual)]


def _within_play(event: Event, play: Backlash, recording: Recording, usual: np.ndarray) -> bool:
    """Return whether each wheel's lost distance is below the play, and before its first reversal.

    usual : (3,) scale of an interval's residual, m, m, rad
    """
    track_m = play.track or recording.track_m
    if track_m is None:
        return False
    motion = motion_of(recording.odometry_s, recording.odometry.xyt, track_m=track_m)
    ends_s = np.append(recording.odometry_s[1:], np.inf)
    noise_m = _ERRORS * float(np.hypot(usual[0], 0.5 * track_m * usual[2]))
    lost_m = (event.along_m + side * 0.5 * track_m * event.yaw_rad for side in (1.0, -1.0))
    unknown = (event.start_s < ends_s[row] for row in play.first_reversals(motion))
    within = (abs(m) <= noise_m + play.travel * free for m, free in zip(lost_m, unknown, strict=True))
    return all(within) and abs(event.across_m) <= play.travel + _ERRORS * float(usual[1])
