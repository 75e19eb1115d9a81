"""Settings shared by all recordings of a study: source of the regressors, node spacing and noise law.

Node spacing: errors of a localisation or of a map are correlated over a metre or so of path. Over shorter intervals
they look like a random walk of the odometry, twenty times as strong as its own. They are detected from the growth of
the variance of odometry minus truth with time. Its rate is constant for a random walk and for white noise of the truth.
It decreases if the truth's errors are correlated, until they are independent of each other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.model.noise_laws import law_named
from odomcorrupt.study.estimate.drive_type import sees_travel, turns_at_rest
from odomcorrupt.study.estimate.intervals import TURN_M
from odomcorrupt.study.estimate.regressors import choose_side, truth_noise

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.model.noise_laws import Law
    from odomcorrupt.study.estimate.regressors import Side
    from odomcorrupt.study.io.recording import Recording

INTERVAL_S = 0.5
"""Spacing of nodes for an accurate truth, seconds."""
_COARSE_INTERVAL_S = 1.0
_COARSE_TRUTH_M = 0.008
"""Noise per sample above which a truth has correlated errors (AMCL, SLAM), so that nodes are spaced farther apart."""
_BLIND_INTERVAL_S = 2.0
"""Spacing for a truth without headings: positions show a turn only later; closer nodes take jitter for turn noise."""


@dataclass(frozen=True, slots=True)
class Approach:
    """Settings for all recordings of a study.

    side : source of the regressors, odometry or truth, see `regressors`
    spacing_s : spacing of the nodes, seconds
    law_name : name of the noise law
    gyro_noise : whether the angle random walk of a gyro is fitted: the odometry's heading changes at rest, and the
        truth is no gyro, whose own noise it might be
    """

    side: Side = "odometry"
    spacing_s: float = INTERVAL_S
    law_name: str = "diffusion"
    gyro_noise: bool = False

    @property
    def law(self) -> Law:
        """The noise law of that name."""
        return law_named(self.law_name)


def choose_approach(recordings: Sequence[Recording], law_name: str = "diffusion") -> Approach:
    """Return the settings that the recording with the least accurate truth needs."""
    noise_m = max(float(np.hypot(*truth_noise(r.truth)[:2])) / np.sqrt(2.0) for r in recordings)
    spacing_s = INTERVAL_S
    if not all(r.headed for r in recordings):
        spacing_s = _BLIND_INTERVAL_S
    elif noise_m > _COARSE_TRUTH_M or any(r.localised for r in recordings):
        spacing_s = max([_COARSE_INTERVAL_S, *(independent_spacing_s(r) for r in recordings if r.localised)])
    # a relative truth: no interval shorter than its measured motions
    usual_s = [float(np.median(np.diff(r.truth.stamps_ns))) * 1e-9 for r in recordings if r.truth.relative]
    spacing_s = max([spacing_s, *usual_s])
    noisy = sum(choose_side(r, spacing_s) == "truth" for r in recordings)
    return Approach(
        "truth" if 2 * noisy >= len(recordings) else "odometry",
        spacing_s,
        law_named(law_name).name,
        gyro_noise=sees_travel(recordings) and any(map(turns_at_rest, recordings)),
    )


_SPACINGS_S = (1.0, 2.0, 4.0, 8.0)
_ENOUGH = 50
"""Least number of nodes that remain in a drive."""
_REACH_M = 1.5
"""Correlation length of a localisation's errors, m of path: they depend on the view from a place."""


def independent_spacing_s(recording: Recording) -> float:
    """Return the node spacing (s) at which the errors of a localisation are independent: 1.5 m of usual driving.

    It is no shorter than the truth's usual sampling interval, and leaves at least 50 nodes in a drive.
    """
    truth_s = recording.truth_s
    shared_s = float(min(truth_s[-1], recording.odometry_s[-1]) - max(truth_s[0], recording.odometry_s[0]))
    sampled_s = next((s for s in _SPACINGS_S if s >= 0.9 * float(np.median(np.diff(truth_s)))), _SPACINGS_S[-1])
    possible = [s for s in _SPACINGS_S if s * _ENOUGH <= shared_s]
    if not possible:
        return sampled_s
    steps = np.diff(recording.odometry.xyt, axis=0)
    gone_m = float(np.hypot(steps[:, 0], steps[:, 1]).sum() + TURN_M * np.abs(steps[:, 2]).sum())
    usual_mps = gone_m / float(recording.odometry_s[-1] - recording.odometry_s[0])
    return max(sampled_s, next((s for s in possible if s * usual_mps >= _REACH_M), possible[-1]))
