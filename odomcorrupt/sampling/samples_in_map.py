"""Samples of one motion within a map, p(x_t | u_t, x_t-1, m), by rejection; see `mapping.conditioned_runs`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import MapError, ModelError
from odomcorrupt.mapping.conditioned_runs import MAX_TRIES
from odomcorrupt.sampling.samples import move_sampled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.mapping.free_space import Check, FreeSpace
    from odomcorrupt.model.noise_laws import Variances
    from odomcorrupt.sampling.samples import Move

__all__ = ["FreeSamples", "move_sampled_in_map"]


@dataclass(frozen=True, slots=True)
class FreeSamples:
    """Samples in the free space of a map.

    xyt : (n, 3) metres, radians
    candidates : number of candidates drawn for them
    lost : number of samples given up because none of their tries was free
    free_at_first : number of first tries that were free
    """

    xyt: Array
    candidates: int
    lost: int
    free_at_first: int
    tries: int

    def account(self) -> str:
        """Return the numbers of tries and failures, in one sentence."""
        asked = len(self.xyt) + self.lost
        said = (
            f"map: {self.free_at_first} of {asked} first draws were free, {self.candidates} draws made "
            f"{len(self.xyt)} free samples"
        )
        return said + (f"; {self.lost} were given up after {self.tries} tries each" if self.lost else "")


def move_sampled_in_map(
    move: Move,
    variances: Variances,
    count: int,
    rng: np.random.Generator,
    space: FreeSpace,
    *,
    check: Check = "endpoint",
    tries: int = MAX_TRIES,
) -> FreeSamples:
    """Draw end poses of a motion in the free space of a map; see `samples.move_sampled`.

    Raises
    ------
    MapError
        If the motion begins in a wall, or no candidate is free.

    """
    if tries < 1:
        raise ModelError(f"tries: {tries}; there must be one or more")
    start = move.start_xyt[None, :2]
    if not space.free(start)[0]:
        x, y = start[0]
        raise MapError(
            f"the motion begins at ({x:.3f} m, {y:.3f} m), which the map does not leave free for this robot; check "
            "--map-pose and --robot-radius"
        )
    out = np.empty((count, 3))
    pending: NDArray[np.intp] = np.arange(count)
    candidates = free_at_first = 0
    for attempt in range(tries):
        drawn = move_sampled(move, variances, len(pending), rng)
        candidates += len(drawn)
        good = space.allows(np.broadcast_to(start, (len(drawn), 2)), drawn[:, :2], check)
        out[pending[good]] = drawn[good]
        pending = pending[~good]
        free_at_first += int(np.count_nonzero(good)) if attempt == 0 else 0
        if not len(pending):
            break
    if len(pending) == count:
        raise MapError(
            f"none of {candidates} candidates is free: the motion ends in a wall, and its noise does not lead out of it"
        )
    found = np.delete(out, pending, axis=0)
    return FreeSamples(found, candidates, len(pending), free_at_first, tries)
