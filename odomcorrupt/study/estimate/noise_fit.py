"""Maximum likelihood of the noise coefficients and of the truth's own noise, outliers set apart."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2

from odomcorrupt.study.estimate.noise_likelihood import NoiseFit, NoiseTask

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.intervals import Intervals
    from odomcorrupt.study.estimate.variance_components import LawPieces

__all__ = ["fit_noise"]

_ROBUST_ROUNDS = 5
_CHANCE, _SIGNAL = 0.002, 0.05
"""Parts of the nodes: as many suspects as chance makes, and so many that they are no outliers."""
_OUTLIER = float(chi2.isf(2e-4, 3))
"""A node whose squared innovations sum to more is a suspect: one in 5000 is by chance, so trimming biases nothing."""


def fit_noise(
    nodes: Intervals,
    pieces: LawPieces,
    columns: Array,
    *,
    start: Array | None = None,
    weights: Array | None = None,
    headings: bool = True,
    elsewhere: bool = False,
    bursts: bool = False,
) -> NoiseFit:
    """Fit coefficients and truth noise by maximum likelihood; columns (K, 3, m) are free linear terms throughout.

    Intervals whose innovations are too large to be chance get a larger covariance of their own, monotonously; the fit
    is repeated; slips and gross errors of the truth then do not pass for ordinary noise. Where that would be more than
    a few nodes in a hundred they are signal, and the fit is left plain, unless bursts are known of. Given weights (K,)
    are kept as they are, so that likelihoods can be compared. Without headings, the truth's are unknown: their noise is
    held flat. A start from elsewhere, of a fit with other columns, is looked at as critically as a first guess.
    """
    ones = np.ones(len(nodes))
    task = NoiseTask(nodes, pieces, columns, ones if weights is None else weights, headings=headings)
    if start is None or len(start) != len(task.first_guess()):
        free = task.second_look(task.climb(task.first_guess()))
    elif weights is not None:
        free = task.climb(start)
    else:
        # what has died while much else was still wrong may live now
        free = task.climb(task.revived(start))
        free = task.second_look(free) if elsewhere else free
    plain = done = task.evaluate(free)
    if weights is not None:
        return plain
    for _ in range(_ROBUST_ROUNDS):
        square = np.sum(done.innovations.reshape(-1, 3) ** 2, axis=1)
        worse = square > _OUTLIER
        if worse.mean() < _CHANCE:
            break
        heavier = np.where(worse, done.weights * square / 3.0, done.weights)
        task = NoiseTask(nodes, pieces, columns, heavier, headings=headings)
        done = task.evaluate(task.climb(task.revived(done.free)))
    return plain if np.mean(done.weights > 1.0) > _SIGNAL and not bursts else done
