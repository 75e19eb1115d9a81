"""Choice of the truth samples (nodes) between which odometry and truth are compared.

Nodes are about half a second apart, and the same samples for all models and clocks.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.study.estimate.intervals import TURN_M, Intervals, intervals_between

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.recording import Recording

GAP_S = 3.0
"""Multiple of the node spacing above which an interval is a gap in the truth and is not used."""
LEAST_INTERVALS = 20
"""Minimum number of intervals for a fit, of all its recordings."""


def pick_interval_ends(
    truth_s: Array,
    first_s: float,
    last_s: float,
    spacing_s: float,
    among: NDArray[np.bool_] | None = None,
    anchor_s: float | None = None,
) -> NDArray[np.int64]:
    """Return indices of truth samples in [first, last], each at least about `spacing_s` after the previous one.

    Fewer than two samples there are returned as they are.

    truth_s : (n,) times of the truth samples, s, increasing
    first_s, last_s : limits of the times, s
    among : (n,) mask of the samples that may be picked; all by default
    anchor_s : time of one grid point of the nodes; by default that of the first usable sample
    """
    usable = (truth_s >= first_s) & (truth_s <= last_s)
    inside = np.flatnonzero(usable if among is None else usable & among)
    if len(inside) < 2:
        return inside
    begin_s = truth_s[inside[0]]
    if anchor_s is not None:
        begin_s += (anchor_s - begin_s) % spacing_s
    grid = np.arange(begin_s, last_s + spacing_s, spacing_s) - 1e-9
    return np.unique(inside[np.minimum(np.searchsorted(truth_s[inside], grid), len(inside) - 1)])


def intervals_of(recording: Recording, spacing_s: float) -> Intervals:
    """Return the intervals between truth samples `spacing_s` apart, with the odometry between them.

    Raises
    ------
    RecordingError
        If odometry and truth overlap too little.
    """
    truth_s = recording.truth_s
    picked = _ends_of(recording, spacing_s)
    if len(picked) < 2:
        raise RecordingError(
            f"{recording.name}: odometry and truth overlap in {len(picked)} truth samples; check that their stamps "
            "come from one clock"
        )
    start, end = truth_s[picked[:-1]], truth_s[picked[1:]]
    beside = [(end <= step.start_s) | (start >= step.end_s) for step in recording.pose_steps]
    kept = np.flatnonzero(np.all([end - start < GAP_S * spacing_s, *beside], axis=0))
    if not len(kept):
        raise RecordingError(f"{recording.name}: no stretch of {spacing_s:g} s has both odometry and truth")
    return intervals_between(recording, picked, kept)


def _ends_of(recording: Recording, spacing_s: float) -> NDArray[np.int64]:
    """Return indices of the nodes, `spacing_s` apart; for a localisation, the path usually driven in that time apart.

    Errors of a localisation depend on its view and stay the same while the robot stands or creeps. The path length is
    that of the truth, and the grid of nodes starts at the recorded start of the odometry. So nodes are the same samples
    of the truth for all models and clocks: noise of other samples would change the likelihood more than most effects.
    """
    truth_s, ends = recording.truth_s, recording.odometry_s[[0, -1]]
    first = int(np.searchsorted(truth_s[:-1], 0.0))
    if not recording.localised:
        return pick_interval_ends(truth_s, float(ends[0]), float(ends[1]), spacing_s, anchor_s=float(truth_s[first]))
    steps = np.diff(np.nan_to_num(recording.truth.xyt), axis=0)
    gone = np.concatenate(([0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]) + TURN_M * np.abs(steps[:, 2]))))
    pace = gone * (float(truth_s[-1] - truth_s[0]) / max(float(gone[-1]), 1e-9))
    return pick_interval_ends(pace, 0.0, float(pace[-1]), spacing_s, recording.within_odometry, float(pace[first]))


def count_intervals(recording: Recording, spacing_s: float) -> int:
    """Return the number of intervals that `intervals_of` would find."""
    if np.count_nonzero(recording.within_odometry) < 2:
        return 0
    between_them = np.diff(recording.truth_s[_ends_of(recording, spacing_s)])
    return int(np.count_nonzero(between_them < GAP_S * spacing_s))
