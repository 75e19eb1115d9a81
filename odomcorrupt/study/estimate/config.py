"""How recordings are looked at: what drives the regressors, how far apart nodes lie, which noise law is fitted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.model.noise_laws import law_named
from odomcorrupt.study.estimate.intervals import lay_nodes
from odomcorrupt.study.terms.regressors import choose_side, truth_noise

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.model.noise_laws import Law
    from odomcorrupt.study.io.recording import Recording
    from odomcorrupt.study.terms.regressors import Side

__all__ = ["NODE_S", "Approach", "choose_approach"]

NODE_S = 0.5
"""Spacing of nodes for a good truth, seconds."""
_COARSE_NODE_S = 1.0
_COARSE_TRUTH_M = 0.008
"""A truth noisier than this per sample has coloured noise (RTK, SLAM): nodes lie farther apart than its correlation."""
_TO_DEVIATION = 1.4826
"""Standard deviation of normal errors over their median absolute deviation."""
_CORRELATED_NODE_S, _FEWEST_NODES = 5.0, 60
"""Spacing where errors of a localisation are alike for seconds; but a drive is to have so many intervals."""
_SLOW_S = 0.1
"""A truth that comes no more often is a localisation; cameras and motion capture err anew at every frame."""
_FADES = 3.0
_GROWN = 1.5
"""Errors are correlated where their variance grows so many times as fast over 1 to 4 s as over 4 to 32 s; and by this
factor at least, which independent errors do not."""
_BLIND_NODE_S = 2.0
"""Positions alone show a turn by where it leads to; at closer nodes their filter's jitter passes for noise of turns."""


@dataclass(frozen=True, slots=True)
class Approach:
    """One choice for all recordings of a study.

    side : where regressors come from, see `regressors`
    spacing_s : of the nodes
    law_name : the noise law
    """

    side: Side = "odometry"
    spacing_s: float = NODE_S
    law_name: str = "diffusion"

    @property
    def law(self) -> Law:
        """The noise law itself."""
        return law_named(self.law_name)


def choose_approach(recordings: Sequence[Recording], law_name: str = "diffusion") -> Approach:
    """Return what suits the worst of the recordings."""
    noise_m = max(float(np.hypot(*truth_noise(r.truth)[:2])) / np.sqrt(2.0) for r in recordings)
    spacing_s = _COARSE_NODE_S if noise_m > _COARSE_TRUTH_M else NODE_S
    if not all(r.headed for r in recordings):
        spacing_s = _BLIND_NODE_S
    else:
        spacing_s = max(spacing_s, *(_correlated_spacing(r) for r in recordings))
    sides = {choose_side(r, spacing_s) for r in recordings}
    return Approach("truth" if "truth" in sides else "odometry", spacing_s, law_named(law_name).name)


def _correlated_spacing(recording: Recording) -> float:
    """Return how far apart (s) nodes have to be where the headings of a localisation err alike for seconds; else 0.

    The variance of such an error's change grows with the time between two looks until they know nothing of each other;
    that of what wheels do goes on growing. What is in proportion to turns, travel and time is taken out first.
    """
    truth_s = recording.truth.seconds_since(recording.origin_ns)[recording.truth.known]
    if len(truth_s) < 2 or float(np.median(np.diff(truth_s))) < _SLOW_S:
        return 0.0
    nodes = lay_nodes(recording, 1.0)
    turn = nodes.odometry_step[:, 2]
    usual = np.column_stack((turn, np.abs(turn), nodes.distance_m, nodes.end_s - nodes.start_s))
    error = nodes.residual[:, 2]
    middle = np.median(error)
    plain = np.abs(error - middle) <= 5.0 * _TO_DEVIATION * np.median(np.abs(error - middle))
    left = np.cumsum(error - usual @ np.linalg.lstsq(usual[plain], error[plain], rcond=None)[0])
    chain = np.cumsum(~nodes.linked)

    def grown(steps: int) -> float:
        change = (left[steps:] - left[:-steps])[chain[steps:] == chain[:-steps]]
        return float(_TO_DEVIATION * np.median(np.abs(change))) ** 2 if len(change) else float("nan")

    early = (grown(4) - grown(1)) / 3.0
    late = np.fmin((grown(16) - grown(4)) / 12.0, (grown(32) - grown(8)) / 24.0)
    if not (early > _FADES * max(late, 0.0) and grown(4) > _GROWN * grown(1)):
        return 0.0
    return min(_CORRELATED_NODE_S, float(np.sum(nodes.end_s - nodes.start_s)) / _FEWEST_NODES)
