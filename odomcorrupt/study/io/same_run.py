"""Whether odometry and truth are of one drive at all.

Only what is plain is refused: wheels slip, fixes drift and platforms go sideways, but over two seconds even those
move as fast, or turn as fast, as their odometry says. Of 19 recordings by other people the worst agrees by .6 in
one of the two, of two drives of some minutes the best by .4.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.study.io.cross_correlation import likeness

if TYPE_CHECKING:
    from odomcorrupt.study.io.raw_trajectory import Samples

__all__ = ["check_together"]

_WINDOW_S = 2.0
"""Motions are compared over so long: the truth's noise and the wheels' jitter are gone."""
_REACH_S = 60.0
_NEAR_S = 3.0
_STRANGE_NEAR, _STRANGE = 0.45, 0.5
"""Correlation that one drive has in speed or in turning: as the clocks are, and at any shift."""
_TURNS_RADPS, _SPEEDS_MPS, _SPEEDS = 0.05, 0.03, 0.15
"""Deviation of yaw rates, of speeds, and of speeds over their root mean square, below which they may be noise."""


def check_together(here: Samples, there: Samples) -> None:
    """Refuse a truth that plainly moves otherwise than the odometry, whatever its clock.

    Raises
    ------
    RecordingError
        With what was found and the way out.

    """
    reach_s = min(_REACH_S, here.span_s / 2.0)
    alike = likeness(here.trajectory(), there.trajectory(), reach_s, smoothing_s=_WINDOW_S)
    both = (alike.odometry, alike.truth)
    turning = all(s.turn_radps > _TURNS_RADPS for s in both)
    hurrying = all(s.speed_mps > max(_SPEEDS_MPS, _SPEEDS * s.level_mps) for s in both)
    near = np.abs(alike.lag_s) <= _NEAR_S
    best = np.maximum(alike.turn, alike.speed)
    if (turning or hurrying) and best[near].max() < _STRANGE_NEAR and best.max() < _STRANGE:
        raise RecordingError(
            f"{there.place}: does not move as {here.name} does (speeds correlate by {alike.speed.max():.2f}, yaw rates "
            f"by {alike.turn.max():.2f}, at the best shift of up to {reach_s:.0f} s): it is of another drive or of "
            "another robot, or its clock is farther off; name the truth of this run"
        )
