"""Settings shared by all recordings of a study: source of the regressors, node spacing and noise law."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.model.noise_laws import law_named
from odomcorrupt.study.estimate.regressors import choose_side, truth_noise
from odomcorrupt.study.estimate.truth_correlation import independent_spacing_s

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.model.noise_laws import Law
    from odomcorrupt.study.estimate.regressors import Side
    from odomcorrupt.study.io.recording import Recording

__all__ = ["NODE_S", "Approach", "choose_approach"]

NODE_S = 0.5
"""Spacing of nodes for an accurate truth, seconds."""
_COARSE_NODE_S = 1.0
_COARSE_TRUTH_M = 0.008
"""Noise per sample above which a truth has correlated errors (AMCL, SLAM), so that nodes are spaced farther apart."""
_BLIND_NODE_S = 2.0
"""Spacing for a truth without headings: positions show a turn only later; closer nodes take jitter for turn noise."""


@dataclass(frozen=True, slots=True)
class Approach:
    """Settings for all recordings of a study.

    side : source of the regressors, odometry or truth, see `regressors`
    spacing_s : spacing of the nodes, seconds
    law_name : name of the noise law
    """

    side: Side = "odometry"
    spacing_s: float = NODE_S
    law_name: str = "diffusion"

    @property
    def law(self) -> Law:
        """The noise law of that name."""
        return law_named(self.law_name)


def choose_approach(recordings: Sequence[Recording], law_name: str = "diffusion") -> Approach:
    """Return the settings that the recording with the least accurate truth needs."""
    noise_m = max(float(np.hypot(*truth_noise(r.truth)[:2])) / np.sqrt(2.0) for r in recordings)
    spacing_s = NODE_S
    if not all(r.headed for r in recordings):
        spacing_s = _BLIND_NODE_S
    elif noise_m > _COARSE_TRUTH_M or any(r.localised for r in recordings):
        spacing_s = max([_COARSE_NODE_S, *(independent_spacing_s(r) for r in recordings if r.localised)])
    # a relative truth: no interval shorter than its measured motions
    usual_s = [float(np.median(np.diff(r.truth.stamps_ns))) * 1e-9 for r in recordings if r.truth.relative]
    spacing_s = max([spacing_s, *usual_s])
    sides = {choose_side(r, spacing_s) for r in recordings}
    return Approach("truth" if "truth" in sides else "odometry", spacing_s, law_named(law_name).name)
