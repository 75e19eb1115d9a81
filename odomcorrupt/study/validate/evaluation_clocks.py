"""Clocks with which models are evaluated: the same for all models of a comparison.

If each were evaluated with its best clock, a clock would make up for a part of the errors of a wrong model (late travel
looks like slip at starts). But a clock is known within its standard error only. A model that is rejected is therefore
tested again with the offset that is most likely for it within two standard errors; a wrong model gains no more than
this, because the range does not depend on it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.study.estimate.clocks import Clocks, clock_rivals, find_clocks
from odomcorrupt.study.estimate.problem import undo
from odomcorrupt.study.estimate.windows import drift_of
from odomcorrupt.study.io.clock import Clock, aligned
from odomcorrupt.study.io.headings import with_headings, with_recomputed_headings
from odomcorrupt.study.validate.goodness_of_fit import PRACTICAL_FACTOR

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.model.motion_model import MotionModel
    from odomcorrupt.study.estimate.config import Approach
    from odomcorrupt.study.io.recording import Recording
    from odomcorrupt.study.validate.calibration import Horizon

_MAX_ERROR_RATIO = 0.97
"""A clock estimated with a model applied is accepted only if it reduces the 10 s error at least to this ratio."""


def clocks_beside(
    recordings: Sequence[Recording], approach: Approach, model: MotionModel, plain: Clocks | None = None
) -> Clocks:
    """Return the clocks estimated from the raw odometry or with a model applied, or zero clocks: the least 10 s error.

    A strong effect can mask or imitate a clock offset, so clocks are also estimated from the model's residuals.
    """
    rivals = clock_rivals(recordings)
    plain = plain or find_clocks(recordings, approach, rivals)
    effects = [_effects(model, r) for r in recordings]
    if not any(effect.kind != "noise" for own in effects for effect in own):
        return plain
    corrected = without_effects_of(model, recordings)
    applied = find_clocks(corrected, approach, rivals)

    def error_m(clocks: Sequence[Clock]) -> float:
        on_time = [aligned(r, c) for r, c in zip(recordings, clocks, strict=True)]
        left = [with_recomputed_headings(undo(r, own)) for r, own in zip(on_time, effects, strict=True)]
        return drift_of(left).rmse

    found = plain
    n = len(recordings)
    none = replace(
        plain, clocks=(Clock(),) * n, free=((False, False),) * n, errors=((0.0, 0.0),) * n, ranges_s=((0.0, 0.0),) * n
    )
    for other in (none, applied):
        if error_m(other.clocks) < _MAX_ERROR_RATIO * error_m(found.clocks):
            found = other
    return found


def can_be_of_clocks(horizons: Sequence[Horizon], recordings: Sequence[Recording], clocks: Clocks) -> bool:
    """Return whether clocks within their ranges can explain too large errors: a cheap bound for clearly wrong models.

    An offset changes the error over a window by at most twice the speed times the change.
    """
    shift_m = max(
        (2.0 * _speed(r) * (high - low) for r, (low, high) in zip(recordings, clocks.ranges_s, strict=False)),
        default=0.0,
    )
    excess_m = [h.position_measured - PRACTICAL_FACTOR * h.position_expected for h in horizons]
    return shift_m > 0.0 and not any(own > shift_m for own in excess_m)


def _speed(recording: Recording) -> float:
    """Return the speed (m/s) that the odometry exceeds in 1 % of its intervals."""
    gone_m = np.hypot(*np.diff(recording.odometry.xyt[:, :2], axis=0).T)
    return float(np.quantile(gone_m, 0.99) / np.median(np.diff(recording.odometry_s)))


def _effects(model: MotionModel, recording: Recording) -> tuple[Effect, ...]:
    """Return the effects of a model that apply in a recording's frame, and those of its measurement."""
    return (*model.in_frame(recording.frame).effects, *model.setup.effects)


def without_effects_of(model: MotionModel, recordings: Sequence[Recording]) -> list[Recording]:
    """Return recordings with the effects of a model removed from the odometry and their truth unchanged.

    Effects that depend on the heading in the world need headings, which a truth of positions lacks.
    """
    found = []
    for recording in recordings:
        left = undo(with_headings(recording), _effects(model, recording))
        found.append(replace(left, truth=recording.truth, heading_error_rad=recording.heading_error_rad))
    return found
