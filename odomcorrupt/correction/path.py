"""The corrected path of a whole drive: collected in one pass over a bag, handed out in another."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.correction.clock import true_stamps
from odomcorrupt.correction.undo import undo_effects
from odomcorrupt.corruption.covariance import SUMS, NoiseSteps, sum_terms
from odomcorrupt.corruption.path import PathSamples
from odomcorrupt.corruption.step_law import StepGrowth, noise_variances
from odomcorrupt.errors import BagError
from odomcorrupt.geometry.se2 import compose, inverse

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.correction.undo import Undone
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import MotionModel, Noise

__all__ = ["CorrectedPath", "MeasuredPath", "corrected_samples"]


class MeasuredPath:
    """Watches the measured odometry go by; a restart of time begins a new stretch."""

    def __init__(self) -> None:
        self._parts: list[list[PathSamples]] = [[]]

    def restart(self) -> None:
        """Begin a new stretch."""
        self._parts.append([])

    def add(self, samples: PathSamples) -> None:
        """Take the next part of the path."""
        if len(samples):
            self._parts[-1].append(samples)

    def corrected(self, model: MotionModel, start_xyt: Array | None = None) -> list[PathSamples | None]:
        """Return each stretch corrected; None for one in which nothing was measured.

        start_xyt : (3,) where the first pose lies in the frame whose places effects read; None: where it says
        """
        stretches: list[PathSamples | None] = []
        frame_xyt: Array | None = None
        first_ns: int | None = None
        for parts in self._parts:
            if not parts:
                stretches.append(None)
                continue
            stamps_ns = np.concatenate([samples.stamps_ns for samples in parts])
            first_ns = int(stamps_ns[0]) if first_ns is None else first_ns
            xyt = np.concatenate([samples.clean_xyt for samples in parts])
            if start_xyt is not None and frame_xyt is None:
                frame_xyt = compose(start_xyt, inverse(xyt[0]))
            stretches.append(corrected_samples(model, stamps_ns, xyt, first_ns=first_ns, frame_xyt=frame_xyt))
        return stretches


class CorrectedPath:
    """Hands out corrected stretches to whoever feeds it the measured poses that they were made from."""

    def __init__(self, stretches: Sequence[PathSamples | None]) -> None:
        self._stretches = stretches
        self._number = self._next = 0

    def restart(self) -> None:
        """Go on to the next stretch."""
        self._number += 1
        self._next = 0

    def feed(self, stamps_ns: NDArray[np.int64], clean_xyt: Array) -> PathSamples:
        """Return the corrected path at the next n measured poses.

        Raises
        ------
        BagError
            Where these are not the poses of the first pass.

        """
        whole = self._stretches[self._number] if self._number < len(self._stretches) else None
        rows = slice(self._next, self._next + len(stamps_ns))
        if whole is None or not np.array_equal(whole.stamps_ns[rows], stamps_ns):
            raise BagError("the odometry changed while it was being corrected; wait until the bag is complete")
        self._next = rows.stop
        first = rows.start == 0  # what counts once per stretch
        return PathSamples(
            stamps_ns, clean_xyt, whole.error_xyt[rows], whole.sums[:, rows], whole.origin_xy,
            whole.travelled_m[rows], whole.jumps if first else 0, whole.sideways_m if first else 0.0,
        )  # fmt: skip


def corrected_samples(
    model: MotionModel,
    stamps_ns: NDArray[np.int64],
    measured_xyt: Array,
    *,
    first_ns: int,
    frame_xyt: Array | None = None,
) -> PathSamples:
    """Return the corrected path of one stretch of n poses, with the sums that the noise's covariances need.

    Parameters
    ----------
    stamps_ns : (n,)
        Ascending header stamps as they are in the bag.
    measured_xyt : (n, 3)
        Measured poses, metres and radians, finite.
    first_ns
        First stamp of the odometry, from which clocks count.
    frame_xyt : (3,)
        Pose of the odom frame in the frame whose places effects read, None where it is the same.

    """
    clocks = [effect for effect in model.effects if effect.clock]
    t_ns = true_stamps(clocks, stamps_ns, first_ns)
    t_s = (t_ns - t_ns[0]) * np.float64(1e-9)
    undone = undo_effects(model.effects, t_s, measured_xyt, model.track_m, frame_xyt=frame_xyt)
    origin_xy = measured_xyt[0, :2].copy()
    sums = _sums(model.noise, undone, measured_xyt + undone.error_xyt, origin_xy)
    world = np.diff(measured_xyt[:, :2], axis=0)
    travelled_m = np.concatenate(([0.0], np.cumsum(np.where(undone.jump, 0.0, np.hypot(world[:, 0], world[:, 1])))))
    return PathSamples(
        stamps_ns, measured_xyt, undone.error_xyt, sums, origin_xy, travelled_m,
        int(np.count_nonzero(undone.jump)), float(np.abs(undone.driven.dl_m).sum()),
    )  # fmt: skip


def _sums(noise: Noise, undone: Undone, corrected_xyt: Array, origin_xy: Array) -> Array:
    """Return the running sums (SUMS, n) of the noise that the corrected path, which is nobody's draw, still has."""
    driven = undone.driven
    v = noise_variances(noise, driven, undone.driven_s, StepGrowth()).variances
    bearing = np.zeros(len(driven))
    if noise.law.along_travel:
        bearing = np.arctan2(driven.dl_m, driven.ds_m)
    place = (corrected_xyt[:, :2] - origin_xy).T
    travel = corrected_xyt[:-1, 2] + driven.dtheta_rad / 2.0
    terms = sum_terms(
        NoiseSteps(v, place[:, :-1], place[:, 1:], travel, bearing, driven.ds_m, driven.dl_m, arc=noise.law.arc)
    )
    return np.cumsum(np.concatenate((np.zeros((SUMS, 1)), terms), axis=1), axis=1)
