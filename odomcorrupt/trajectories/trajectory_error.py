"""Position and heading error of a path against the truth, over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.geometry.se2 import compose, inverse, wrap

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.recording import Trajectory

__all__ = ["PathError", "path_error"]


@dataclass(frozen=True, slots=True)
class PathError:
    """A path and the truth at n common stamps, aligned at the first of them.

    t_s : (n,) seconds since the path's first stamp
    path_xyt, truth_xyt : (n, 3) in the truth's frame
    """

    t_s: Array
    path_xyt: Array
    truth_xyt: Array

    @property
    def position_m(self) -> Array:
        """Position error (n,), metres."""
        out: Array = np.hypot(*(self.path_xyt - self.truth_xyt)[:, :2].T)
        return out

    @property
    def heading_rad(self) -> Array:
        """Heading error (n,), path minus truth, radians."""
        return wrap(self.path_xyt[:, 2] - self.truth_xyt[:, 2])


def path_error(stamps_ns: NDArray[np.int64], xyt: Array, truth: Trajectory) -> PathError | None:
    """Return a path (n, 3) and the truth at common stamps; None where they do not overlap in time.

    The truth is interpolated at the path's stamps. Only the first common pose is aligned: an alignment over the whole
    path would hide part of the error.
    """
    shared = (stamps_ns >= truth.stamps_ns[0]) & (stamps_ns <= truth.stamps_ns[-1])
    if np.count_nonzero(shared) < 2:
        return None
    origin = int(stamps_ns[0])
    t_s = (stamps_ns[shared] - origin) * np.float64(1e-9)
    true = truth.at(t_s, origin)
    own = xyt[shared]
    return PathError(t_s, compose(compose(true[0], inverse(own[0])), own), true)
