"""Whether a model is rejected: one level for all looks together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.study.validate.error_rates import CHANNELS
from odomcorrupt.study.validate.pit import Pit, pit_of
from odomcorrupt.study.validate.whiteness import Whiteness, ljung_box

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.validate.calibration import Horizon

__all__ = ["REJECTION_LEVEL", "Look", "Verdict", "pits_of", "verdict_of", "whiteness_of"]

REJECTION_LEVEL = 0.05
"""Probability of rejecting a right model, all looks together."""


@dataclass(frozen=True, slots=True)
class Look:
    """One question put to the data: what it asks, and how likely a right model looks as bad."""

    question: str
    p: float


@dataclass(frozen=True, slots=True)
class Verdict:
    """All looks, the worst first; rejected where one is worse than the level divided by their number (Bonferroni)."""

    level: float
    looks: tuple[Look, ...]

    @property
    def threshold(self) -> float:
        """What a single look must fall below."""
        return self.level / max(len(self.looks), 1)

    @property
    def against(self) -> tuple[Look, ...]:
        """The looks that reject the model."""
        return tuple(look for look in self.looks if look.p < self.threshold)

    @property
    def rejected(self) -> bool:
        """Whether the model is rejected."""
        return bool(self.against)


def pits_of(chains: Sequence[Array]) -> dict[str, Pit]:
    """Return the PIT of every channel of chains of innovations (m, c)."""
    rows = np.concatenate(chains)
    return {CHANNELS[c]: pit_of(rows[:, c]) for c in range(rows.shape[1])}


def whiteness_of(chains: Sequence[Array]) -> dict[str, Whiteness]:
    """Return the whiteness of every channel."""
    return {CHANNELS[c]: ljung_box([chain[:, c] for chain in chains]) for c in range(chains[0].shape[1])}


def verdict_of(horizons: Sequence[Horizon], pits: Mapping[str, Pit], whiteness: Mapping[str, Whiteness]) -> Verdict:
    """Weigh all looks."""
    looks = [Look(f"size of errors over {h.distance_m:g} m of path (NEES)", h.nees_p) for h in horizons]
    looks += [Look(f"distribution of {name} innovations (PIT)", pit.p) for name, pit in pits.items()]
    looks += [Look(f"memory of {name} innovations (Ljung-Box)", white.p) for name, white in whiteness.items()]
    return Verdict(REJECTION_LEVEL, tuple(sorted(looks, key=lambda look: look.p)))
