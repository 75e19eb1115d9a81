"""Stamps of when a pose arrived and not of when it was taken: the intervals vary, the steps between poses do not."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.raw_trajectory import Samples

__all__ = ["jitter_signs"]

_AROUND = 21
"""Samples over which speeds are taken to be the same."""
_MOVING_MPS = 0.1
_FEW = 200
_LEAST_S = 2e-3
"""Less than this moves a robot by a millimetre or two."""
_SHARE, _PLAINLY = 0.5, 4.0
"""Steps follow their intervals one to one where these are true; stamps jitter where by less, plainly."""
_GAP = 3.0


def jitter_signs(path: Samples) -> list[str]:
    """Notice stamps that jitter, which a fit can only take for noise of every step."""
    off_s = _jitter_s(path)
    if off_s is None:
        return []
    seen = "the intervals between them vary, the steps between its poses do not"
    what = "what is learned as noise holds that, too; stamp poses when they are taken"
    return [f"{path.name}: its stamps are off by about {off_s * 1e3:.2g} ms each ({seen}), and {what}"]


def _jitter_s(path: Samples) -> float | None:
    """Return the deviation of stamps, seconds, where the poses know nothing of it; None where stamps are right."""
    interval_s = np.diff(path.stamps_ns) * 1e-9
    way_m = np.linalg.norm(np.diff(path.xyz[:, :2], axis=0), axis=1)
    if len(interval_s) < _FEW:
        return None
    usual_s, usual_m = _around(interval_s), _around(way_m)
    speed = usual_m / np.maximum(usual_s, 1e-9)
    used = (speed > _MOVING_MPS) & (interval_s < _GAP * np.median(interval_s))
    used[: _AROUND // 2] = used[-(_AROUND // 2) :] = False
    if used.sum() < _FEW:
        return None
    expected, real = (speed * (interval_s - usual_s))[used], (way_m - usual_m)[used]
    square = float(expected @ expected)
    off_s = float(np.std((interval_s - usual_s)[used])) / np.sqrt(2.0)
    if off_s < _LEAST_S:
        return None
    share = float(expected @ real) / square
    error = float(np.std(real - share * expected)) / np.sqrt(square)
    return off_s if share + _PLAINLY * error < _SHARE else None


def _around(values: Array) -> Array:
    """Return the mean (n,) of so many values around each."""
    mean: Array = np.convolve(values, np.full(_AROUND, 1.0 / _AROUND), "same")
    return mean
