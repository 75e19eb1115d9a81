"""A quick look at a thousand laws, each as it is on average over every interval between nodes."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.study.select.basis_samples import LawSamples
from odomcorrupt.study.select.channels import actions_on
from odomcorrupt.study.select.score import left_over

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.basis import Law
    from odomcorrupt.study.select.channels import Action

__all__ = ["QuickLook", "Tried"]

_KEPT = 20
"""Laws of each driver that are whitened."""
_SCALES = (1.0, 0.5, 0.25, 0.125)
_MOST_STEPS = 12
_WORTH_NATS = 0.1
_STARTS, _PLACE = 4, 3
"""From how many laws to start, several on one action if they have so many numbers in their shape."""
_PLAIN_NATS, _PLAIN_PART = 30.0, 0.5
"""What a disc has to explain, and of what the best law explains, for rectangles to be worth their time."""


class Tried(NamedTuple):
    """A law, where it acts, and about how many nats it gains."""

    law: Law
    action: Action
    nats: float


class QuickLook:
    """What laws would explain of what the believed columns (K, 3, q) leave, about."""

    def __init__(self, fit: Fit, believed: Array, samples: LawSamples | None = None) -> None:
        self._whiten, self._left = fit.noise.whitener.whiten, left_over(fit, believed)
        self._pull = fit.noise.whitener.pulled(self._left.residual)
        self._motions = fit.problem.motions
        self._samples = LawSamples(fit.problem) if samples is None else samples

    def everything(self) -> list[Tried]:
        """Return the likeliest laws of every driver on everything that they may act on."""
        found: list[Tried] = []
        for action in actions_on(self._motions):
            mine = self._samples.reaching(action)
            here = [self._samples.means_of_all(view, action) for view, _ in self._samples.units(action)]
            kept = self._promising(mine, action, here)
            first = _first_of(mine)
            parts = np.concatenate([np.arange(first[i], first[i + 1]) for i in kept])
            likely = [mine[i] for i in kept]
            gains = self._gains(likely, action, [mean[:, parts] for mean in here])
            found += [Tried(law, action, g) for law, g in zip(likely, gains, strict=True)]
        return found + self._rectangles(found)

    def _promising(self, tried: Sequence[Law], action: Action, means: Sequence[Array]) -> list[int]:
        """Return which laws to whiten, of each driver the best as they look where intervals knew nothing of each other.

        Their scores are exact: one back-substitution serves them all.
        """
        score = sum(
            np.einsum("ki,ki->k", unit, self._pull) @ mean
            for (_, unit), mean in zip(self._samples.units(action), means, strict=True)
        )
        white = [self._whiten(unit).reshape(-1, 3) for _, unit in self._samples.units(action)]
        length = sum(
            np.einsum("k,kj,kj->j", np.einsum("ki,ki->k", w, x), m, n)
            for w, m in zip(white, means, strict=True)
            for x, n in zip(white, means, strict=True)
        )
        apart = np.asarray(score) ** 2 / np.maximum(np.asarray(length), 1e-300)
        gains = np.add.reduceat(apart, _first_of(tried)[:-1])
        kept: list[int] = []
        for driver in dict.fromkeys(law.driver for law in tried):
            own = [i for i, law in enumerate(tried) if law.driver == driver]
            kept += sorted(own, key=lambda i: -gains[i])[:_KEPT]
        return kept

    def _rectangles(self, found: Sequence[Tried]) -> list[Tried]:
        """Return the best rectangle, where a disc explains much of what any law does: its kin are too many for all."""
        disc = max((t for t in found if t.law.kin), key=lambda t: t.nats, default=None)
        if disc is None or disc.nats < max(_PLAIN_NATS, _PLAIN_PART * max(t.nats for t in found)):
            return []
        actions = [disc.action, *(a for a in actions_on(self._motions) if "both" in a.reaches)]
        turned = []
        for law in self.refined(disc).law.kin:
            tried = [Tried(law, action, self._gain(law, action)) for action in actions]
            turned.append(self.refined(max(tried, key=lambda t: t.nats)))
        return [max(turned, key=lambda t: t.nats)]

    def _gain(self, law: Law, action: Action) -> float:
        here = [self._samples.means([law], view, action.move) for view, _ in self._samples.units(action)]
        return self._gains([law], action, here)[0]

    def forms(self, ranked: Sequence[Tried]) -> list[Tried]:
        """Return the best law, refined, and where it is plain, others of the first few: places have many hills."""
        starts = [ranked[0]]
        for tried in ranked[1:]:
            if len(starts) == _STARTS or ranked[0].nats < _PLAIN_NATS:
                break
            if all(_differ(tried, start) for start in starts):
                starts.append(tried)
        return [self.refined(start) for start in starts]

    def around(self, law: Law, action: Action) -> tuple[Law, Action]:
        """Return the law of the best shape near this one, and the direction in which it acts."""
        best = self.refined(Tried(law, action, self._gain(law, action)))
        return best.law, best.action

    def refined(self, tried: Tried) -> Tried:
        """Return the law of the best shape in the neighbourhood."""
        best = tried
        for scale in _SCALES:
            for _ in range(_MOST_STEPS):
                better = max(self._beside(best, scale), key=lambda t: t.nats, default=best)
                if better.nats <= best.nats + _WORTH_NATS:
                    break
                best = better
        return best

    def _beside(self, tried: Tried, scale: float) -> list[Tried]:
        """Return its neighbours: another shape, or another direction."""
        law, action = tried.law, tried.action
        found = [Tried(law, turned, self._gain(law, turned)) for turned in action.neighbours(scale)]
        if others := list(law.neighbours(scale)):
            here = [self._samples.means(others, view, action.move) for view, _ in self._samples.units(action)]
            gains = self._gains(others, action, here)
            found += [Tried(other, action, gain) for other, gain in zip(others, gains, strict=True)]
        return found

    def _gains(self, tried: Sequence[Law], action: Action, means: Sequence[Array]) -> list[float]:
        """Return half the chi-square that each law explains, from its means on each view."""
        units = (unit for _, unit in self._samples.units(action))
        columns = sum(unit[:, :, None] * mean[:, None, :] for unit, mean in zip(units, means, strict=True))
        raw = self._whiten(np.asarray(columns))
        own = np.einsum("ij,ij->j", raw, raw)
        gains: list[float] = _chi_squares(self._left.of(raw), own, self._left.residual, _first_of(tried)).tolist()
        return gains


def _first_of(tried: Sequence[Law]) -> NDArray[np.int64]:
    """Return where the parts of each law begin, and the end."""
    return np.concatenate(([0], np.cumsum([len(law.parts) for law in tried]))).astype(np.int64)


def _differ(one: Tried, other: Tried) -> bool:
    """Tell whether two laws stand on different hills, for all that is known of their shapes."""
    if one.action != other.action or len(one.law.shape) != len(other.law.shape):
        return True
    if len(one.law.shape) < _PLACE:
        return False
    return any(abs(a - b) > s for a, b, s in zip(one.law.shape, other.law.shape, one.law.steps, strict=True))


def _chi_squares(white: Array, own: Array, r: Array, first: NDArray[np.int64]) -> Array:
    """Return half the chi-square of each group of one or two neighbouring columns."""
    score, length = white.T @ r, np.einsum("ij,ij->j", white, white)
    kept = length > 1e-3 * np.maximum(own, 1e-300)
    single = np.where(kept, score**2 / np.maximum(length, 1e-300), 0.0)
    gains: Array = 0.5 * np.add.reduceat(single, first[:-1])
    for i in np.flatnonzero(np.diff(first) == 2):
        pair = slice(first[i], first[i] + 2)
        normal = white[:, pair].T @ white[:, pair]
        if kept[pair].all() and np.linalg.cond(normal) < 1e6:
            gains[i] = 0.5 * score[pair] @ np.linalg.solve(normal, score[pair])
    return gains
