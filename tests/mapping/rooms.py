"""A room with walls, and a drive straight on."""

import numpy as np

from odomcorrupt.mapping.occupancy_grid import OCCUPIED, Grid
from odomcorrupt.model.motion_model import MotionModel
from odomcorrupt.model.presets import preset_named

RESOLUTION = 0.1

MODEL = MotionModel(preset_named("typical").noise)


def room(*walls):
    """Ten by ten metres about the origin; walls are boxes x0, y0, x1, y1."""
    cells = np.zeros((100, 100), dtype=np.uint8)
    for x0, y0, x1, y1 in walls:
        c = (np.array([x0, y0, x1, y1]) / RESOLUTION + 50).astype(int)
        cells[c[1] : c[3], c[0] : c[2]] = OCCUPIED
    return Grid(cells, RESOLUTION, np.array([-5.0, -5.0, 0.0]))


def drive(n=300):
    """Four metres along x in three seconds."""
    xyt = np.zeros((n, 3))
    xyt[:, 0] = np.linspace(0, 4, n)
    return np.arange(n) * 10**7, xyt
