"""Held-out log likelihood per metre driven, with errors from blocks of the drive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.validate.evaluation import Evaluation

__all__ = ["LogScore", "block_differences", "log_score_of"]

_Summed = Literal["node_nats", "sized_nats", "node_metres"]

BLOCK_S = 15.0
"""Errors of a robot are correlated over seconds; blocks of this length, seconds, are nearly independent."""


@dataclass(frozen=True, slots=True)
class LogScore:
    """Log likelihood per metre, and its gain over the first model on the same blocks, with standard errors."""

    per_m: float
    error: float
    gain_per_m: float
    gain_error: float
    blocks: int


def log_score_of(pieces: Sequence[Evaluation], first: Sequence[Evaluation]) -> LogScore:
    """Return the nats per metre of evaluated pieces, and their paired difference from those of the first model."""
    own, base = _blocks(pieces, pieces), _blocks(first, pieces)
    metres = _blocks(pieces, pieces, "node_metres")
    ratio, error = _ratio(own, metres)
    gain, gain_error = _ratio(own - base, metres)
    return LogScore(ratio, error, gain, gain_error, len(metres))


def block_differences(pieces: Sequence[Evaluation], others: Sequence[Evaluation], *, sized: bool) -> Array:
    """Return the difference (b,) in log likelihood, nats, of evaluations of the same recordings, in blocks of time.

    sized : whether to rescale the noise to each recording, see `Evaluation.sized_nats`
    """
    what: _Summed = "sized_nats" if sized else "node_nats"
    difference: Array = _blocks(pieces, pieces, what) - _blocks(others, pieces, what)
    return difference


def _blocks(pieces: Sequence[Evaluation], cut_by: Sequence[Evaluation], what: _Summed = "node_nats") -> Array:
    """Return sums (b,) of log likelihood or metres over blocks of time."""
    sums = []
    for piece, like in zip(pieces, cut_by, strict=True):
        end_s = like.problem.nodes.end_s
        block = ((end_s - end_s[0]) / BLOCK_S).astype(np.int64)
        sums.append(np.bincount(block, getattr(piece, what)))
    joined: Array = np.concatenate(sums)
    return joined


def _ratio(values: Array, metres: Array) -> tuple[float, float]:
    """Return sum over metres and its standard error by the ratio estimator over b blocks (Cochran, 1977, ch. 6)."""
    total, count = float(metres.sum()), len(metres)
    if total <= 0.0:
        return float("nan"), float("nan")
    ratio = float(values.sum()) / total
    if count < 2:
        return ratio, float("nan")
    left = values - ratio * metres
    return ratio, float(np.sqrt(count / (count - 1.0) * float(left @ left))) / total
