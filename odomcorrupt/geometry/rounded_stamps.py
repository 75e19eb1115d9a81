"""Stamps that were rounded: to what, and where a regular publisher's poses were taken.

Drivers and loggers cut stamps to milliseconds, or to hundredths of a second. Speeds and accelerations of such stamps
flicker, and what depends on them (a threshold of the acceleration) with them; both learning and correction therefore
take stamps of a regular publisher from the even grid that they were rounded from.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["evened", "resolution_s"]

_ROUNDED_NS = (100_000_000, 50_000_000, 20_000_000, 10_000_000, 5_000_000, 2_000_000, 1_000_000)
_ALL = 0.999
"""Part of the stamps that are multiples of what they are rounded to."""
_FLOAT_NS = 1_000
"""How far off a multiple a stamp may be that was a float of seconds since 1970, which has steps of 238 ns."""
_USUAL = 1.5
"""Intervals longer than so many times the usual one are gaps."""
_VARY = 0.02
"""Part of the intervals that differ from the usual one where rounding shows: in a regular clock's they do not."""
_EVEN_OVER, _WITHIN, _FITS = 101, 0.6, 0.99
"""Samples over which a publisher keeps its rate, and how far stamps are off an even grid, in parts of what they are
rounded to, nearly all of them."""


def resolution_s(stamps_ns: NDArray[np.int64]) -> float:
    """Return what stamps (n,) are rounded to, seconds; 0 where they are not, or where it cannot be seen.

    Stamps of a clock that ticks regularly lie on a grid without being rounded: intervals have to vary on it.
    """
    steps = np.diff(stamps_ns)
    whole = next((r for r in _ROUNDED_NS if np.mean(_off(stamps_ns, r) <= _FLOAT_NS) >= _ALL), 0) if len(steps) else 0
    if not whole:
        return 0.0
    usual = steps[steps < _USUAL * np.median(steps) + whole]
    varied = float(np.mean(np.abs(usual - np.median(usual)) > whole / 2)) > _VARY
    return whole * 1e-9 if varied else 0.0


def _off(stamps_ns: NDArray[np.int64], whole_ns: int) -> NDArray[np.int64]:
    """Return how far (n,) stamps are off the nearest multiple, nanoseconds."""
    past = stamps_ns % whole_ns
    return np.minimum(past, whole_ns - past)


def evened(stamps_ns: NDArray[np.int64]) -> NDArray[np.int64] | None:
    """Return rounded stamps (n,) of a regular publisher on its even grid, whose rate may slowly change.

    None where stamps are not rounded, or are farther off such a grid than rounding explains.
    """
    rounded_s = resolution_s(stamps_ns)
    if not rounded_s or len(stamps_ns) < 2 * _EVEN_OVER:
        return None
    t_s = (stamps_ns - stamps_ns[0]).astype(np.float64) * 1e-9
    steps = np.diff(t_s)
    usual = steps[steps < _USUAL * np.median(steps) + rounded_s]
    period_s = float(np.mean(usual))
    if period_s < 2.0 * rounded_s:
        return None
    count = np.concatenate(([0.0], np.cumsum(np.maximum(np.round(steps / period_s), 1.0))))
    off = t_s - count * period_s
    half = _EVEN_OVER // 2
    # continued by the line through the samples at each end: a single one is off by all of the rounding
    row = np.arange(_EVEN_OVER)
    before = np.polyval(np.polyfit(row, off[:_EVEN_OVER], 1), np.arange(-half, 0))
    after = np.polyval(np.polyfit(row, off[-_EVEN_OVER:], 1), np.arange(_EVEN_OVER, _EVEN_OVER + half))
    padded = np.concatenate((before, off, after))
    smooth = np.convolve(padded, np.full(_EVEN_OVER, 1.0 / _EVEN_OVER), "valid")
    if np.mean(np.abs(off - smooth) < _WITHIN * rounded_s) < _FITS:
        return None
    even = stamps_ns[0] + np.round((count * period_s + smooth) * 1e9).astype(np.int64)
    return even if np.all(np.diff(even) > 0) else None
