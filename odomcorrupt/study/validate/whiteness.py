"""Whether whitened innovations are white: Ljung-Box per channel (Biometrika 65, 1978, 297-303).

Innovations of a right model know nothing of the ones before them. Where they do, the error remembers: a bias that
wanders, a cause that lasts, a truth whose noise is not white.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.se2 import Array

__all__ = ["LAGS", "Whiteness", "ljung_box"]

LAGS = 20


@dataclass(frozen=True, slots=True)
class Whiteness:
    """Autocorrelation of one channel.

    correlation : (lags,) at lags 1, 2, ... intervals
    statistic : Ljung and Box's Q, chi-square with as many degrees as lags where innovations are white
    """

    correlation: Array
    statistic: float
    p: float


def ljung_box(chains: Sequence[Array], lags: int = LAGS) -> Whiteness:
    """Test innovations (n,) of unbroken chains; no pair is made across a break."""
    count = sum(len(chain) for chain in chains)
    mean = sum(float(chain.sum()) for chain in chains) / max(count, 1)
    centred = [chain - mean for chain in chains]
    power = sum(float(chain @ chain) for chain in centred)
    if count <= lags + 1 or power <= 0.0:
        return Whiteness(np.full(lags, np.nan), float("nan"), 1.0)
    rho = np.array([sum(float(c[k:] @ c[:-k]) for c in centred if len(c) > k) / power for k in range(1, lags + 1)])
    statistic = float(count * (count + 2.0) * np.sum(rho**2 / (count - np.arange(1, lags + 1))))
    return Whiteness(rho, statistic, float(chi2.sf(statistic, lags)))
