"""How fast motion is held against a map: candidates per second, for ends and for whole ways.

python benchmarks/map_conditioned.py
"""

import time

import numpy as np

from odomcorrupt.mapping.occupancy_grid import CHECKS, OCCUPIED, Constraint, Grid, free_space

COUNT = 1_000_000


def office() -> Grid:
    """Thirty by fifteen metres at 5 cm, with a wall every three metres and a door in each."""
    cells = np.zeros((300, 600), dtype=np.uint8)
    cells[[0, -1]] = cells[:, [0, -1]] = OCCUPIED
    cells[:, 60::60] = OCCUPIED
    cells[140:160, 60::60] = 0
    return Grid(cells, 0.05, np.zeros(3))


def main() -> None:
    """Measure and print."""
    began = time.perf_counter()
    space = free_space(office(), 0.2)
    print(f"prepare 600 x 300 cells for a radius of 0.2 m: {1e3 * (time.perf_counter() - began):.1f} ms")
    rng = np.random.default_rng(0)
    start = np.tile([[10.0, 7.5]], (COUNT, 1))
    end = start + rng.normal(scale=1.0, size=start.shape)
    for check in CHECKS:
        began = time.perf_counter()
        free = Constraint(space, check).allows(start, end)
        rate = COUNT / (time.perf_counter() - began)
        print(f"{check}: {rate / 1e6:.2f} million candidates per second, {free.mean():.0%} of them free")


if __name__ == "__main__":
    main()
