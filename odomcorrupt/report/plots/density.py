"""The picture of a density of end poses beside samples of the same motion."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.report.plots.figure import drawing, new_figure
from odomcorrupt.report.plots.samples import draw_move, draw_samples, frame_samples

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.sampling.density import DensityGrid
    from odomcorrupt.sampling.samples import Move

__all__ = ["draw_density"]


def draw_density(move: Move, grid: DensityGrid, xyt: Array, title: str, unit: str) -> Figure:
    """Draw samples (n, 3) on the left and a density on the right, on the same axes."""
    with drawing():
        figure = new_figure(10.0, 5.2)
        left, right = figure.subplots(1, 2, sharex=True, sharey=True)
        image = right.pcolormesh(
            grid.x_m, grid.y_m, np.ma.masked_less(grid.density, 0.01 * grid.density.max()), cmap="Blues",
            shading="nearest", rasterized=True,
        )  # fmt: skip
        draw_samples(left, xyt)
        shown = grid.density > 1e-3 * grid.density.max()
        rows, columns = np.nonzero(shown.any(axis=1))[0], np.nonzero(shown.any(axis=0))[0]
        box = np.column_stack((grid.x_m[columns[[0, -1]]], grid.y_m[rows[[0, -1]]]))
        for axes in (left, right):
            draw_move(axes, move)
            frame_samples(axes, move, np.concatenate((xyt[:, :2], box)))
        left.set_title(f"{len(xyt)} samples")
        right.set_title("closed form, summed over the heading")
        right.set_ylabel("")
        figure.colorbar(image, ax=right, label=unit, shrink=0.85)
        figure.suptitle(title, x=0.01, ha="left", fontsize=11)
    return figure
