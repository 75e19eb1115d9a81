"""Variance components: the residuals' covariance under a noise law as a weighted sum of fixed matrices."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.model.noise_laws import Coefficients, magnitudes

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array, Increments
    from odomcorrupt.model.noise_laws import Law
    from odomcorrupt.study.estimate.intervals import Intervals

NAMES = ("rot_rot", "rot_trans", "trans_trans", "trans_rot", "across_trans", "end_trans", "end_rot", "rot_time")
"""Coefficients that can be fitted; white noise on twists is not among them, because the truth's noise hides it."""
_OVER_TIME = NAMES.index("rot_time")
_PROBE = (np.array([0.3]), np.array([0.7]), np.array([0.2]))
"""Magnitudes of a test step on which each coefficient, and each interaction of a pair, has an effect if it has any."""


class VarianceComponents:
    """Covariances (K, 3, 3) of the residuals under a noise law, one per coefficient and per interacting pair.

    A law is homogeneous in its coefficients, of degree 1 or 2, and can be split by polarisation. It is the same law
    that corruption uses. With `gyro_noise`, the angle random walk of a gyro, which depends on time, is one more.
    """

    def __init__(self, law: Law, intervals: Intervals, steps: Increments, *, gyro_noise: bool = False) -> None:
        def of(*ones: int) -> Coefficients:
            return Coefficients(**{name: float(i in ones) for i, name in enumerate(NAMES)})

        def rows(*ones: int, on: tuple[Array, ...]) -> Array:
            v = law.rule(of(*ones), *on)
            return np.stack((v.rot1, v.trans, v.across, v.rot2))

        seen = magnitudes(law, steps)
        # noise grows with motion: the largest magnitudes show whether a coefficient has any effect
        most = tuple(np.array([m.max(initial=0.0)]) for m in seen)
        self.active = [i for i in range(len(NAMES)) if rows(i, on=most).any()]
        """Indices of the coefficients that have an effect under this law on this drive."""
        self.unseen = [i for i in range(len(NAMES)) if i not in self.active and rows(i, on=_PROBE).any()]
        """Indices of the coefficients that have an effect under this law, but not on this drive."""
        self._single = {i: intervals.spread(law, law.rule(of(i), *seen), steps) for i in self.active}
        self._pairs: list[tuple[int, int, Array]] = []
        for i, j in combinations(self.active, 2) if law.degree == 2 else ():
            alone, both = rows(i, on=_PROBE) + rows(j, on=_PROBE), rows(i, j, on=_PROBE)
            # most pairs do not interact, and propagating their noise to the nodes is expensive
            if np.abs(both - alone).max() > 1e-12 * np.abs(both).max():
                cross = intervals.spread(law, law.rule(of(i, j), *seen), steps) - self._single[i] - self._single[j]
                self._pairs.append((i, j, cross))
        if gyro_noise:
            self._single[_OVER_TIME] = intervals.over_time(law)
            self.active.append(_OVER_TIME)
        self._degrees = np.array([2 if i == _OVER_TIME else law.degree for i in self.active])

    def parts(self) -> list[Array]:
        """Return the matrices (K, 3, 3), in the order of the weights of `shares`."""
        return [self._single[i] for i in self.active] + [cross for _, _, cross in self._pairs]

    def shares(self, coefficients: Array) -> Array:
        """Return the weights of `parts` for the coefficients (8,) in the order of `NAMES`."""
        single = coefficients[self.active] ** self._degrees
        pairs = [coefficients[i] * coefficients[j] for i, j, _ in self._pairs]
        return np.concatenate((single, pairs))

    def share_slopes(self, coefficients: Array) -> Array:
        """Return the derivatives (a, parts) of `shares` by the logarithms of the a active coefficients."""
        of_pairs = [[coefficients[i] * coefficients[j] * (k in (i, j)) for i, j, _ in self._pairs] for k in self.active]
        single = np.diag(self._degrees * coefficients[self.active] ** self._degrees)
        return np.concatenate((single, np.reshape(of_pairs, (len(self.active), len(self._pairs)))), axis=1)
