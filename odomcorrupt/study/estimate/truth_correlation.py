"""How far apart nodes have to lie for the truth's errors at them to be independent.

Errors of a localisation or of a map are alike over a metre or so of path. Compared over less than that they look like a
random walk of the odometry, twenty times as strong as its own. What shows it is how the spread of odometry minus truth
grows with time: by a constant rate for a random walk and for white noise of the truth, by less and less where the
truth's errors are correlated, until these are independent of each other.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.study.estimate.intervals import TURN_M, intervals, pick_nodes

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.recording import Recording

__all__ = ["independent_spacing_s"]

_SPACINGS_S = (1.0, 2.0, 4.0, 8.0)
_PHASES = 4
"""Windows begin at so many places within one length of them."""
_FEW, _ENOUGH = 20, 50
"""Windows that a spread is taken from at least, and nodes that a drive has to have left."""
_GROWS, _SLOWER = 0.2, 0.5
"""A spread grows plainly where its square does by this part when time doubles; and errors are independent from where
it grows at less than this part of its first rate."""
_ALONG, _YAW = 0, 2
_REACH_M = 1.5
"""Path over which errors of a localisation are alike at least: they depend on what is seen from a place."""


def independent_spacing_s(recording: Recording) -> float:
    """Return the spacing of nodes (s) from which on the errors of a noisy truth are independent.

    Of along and yaw, the longer one counts; across, an error of heading grows with the path and hides it. Nodes lie at
    least a metre and a half of usual driving apart, whatever the spread, which systematic errors of the odometry hide,
    and no closer than usual samples of the truth; a drive keeps 50 of them.
    """
    truth_s = recording.truth.seconds_since(recording.origin_ns)
    shared_s = float(min(truth_s[-1], recording.odometry_s[-1]) - max(truth_s[0], recording.odometry_s[0]))
    sampled_s = next((s for s in _SPACINGS_S if s >= 0.9 * float(np.median(np.diff(truth_s)))), _SPACINGS_S[-1])
    possible = [s for s in _SPACINGS_S if s * _ENOUGH <= shared_s]
    if possible:
        steps = np.diff(recording.odometry.xyt, axis=0)
        gone_m = float(np.hypot(steps[:, 0], steps[:, 1]).sum() + TURN_M * np.abs(steps[:, 2]).sum())
        usual_mps = gone_m / float(recording.odometry_s[-1] - recording.odometry_s[0])
        sampled_s = max(sampled_s, next((s for s in possible if s * usual_mps >= _REACH_M), possible[-1]))
    spreads = [_spread(recording, truth_s, s) for s in (*possible, *(2.0 * s for s in possible[-1:]))]
    usable = next((i for i, spread in enumerate(spreads) if spread is None), len(spreads))
    squares = np.array([spread for spread in spreads[:usable] if spread is not None])
    if len(squares) < 3:
        return sampled_s
    rate = np.diff(squares, axis=0) / np.array(_SPACINGS_S[: len(squares) - 1])[:, None]
    found = [sampled_s]
    for channel in (_ALONG, _YAW):
        if rate[0, channel] < _GROWS * squares[0, channel]:
            continue
        slower = np.flatnonzero(rate[:, channel] < _SLOWER * rate[0, channel])
        found += [_SPACINGS_S[int(slower[0])]] if len(slower) else []
    return max(found)


def _spread(recording: Recording, truth_s: Array, length_s: float) -> Array | None:
    """Return the robust variance (3,) of odometry minus truth over windows of a length; None where there are few."""
    odo_s, found = recording.odometry_s, []
    for phase in np.arange(_PHASES) / _PHASES:
        try:
            picked = pick_nodes(truth_s, odo_s[0] + phase * length_s, odo_s[-1], length_s)
        except RecordingError:
            return None
        kept = np.flatnonzero(np.diff(truth_s[picked]) < 1.5 * length_s)
        if len(kept):
            found.append(intervals(recording, picked, kept).residual)
    if sum(map(len, found)) < _FEW:
        return None
    spread: Array = (1.4826 * np.median(np.abs(np.concatenate(found)), axis=0)) ** 2
    return spread
