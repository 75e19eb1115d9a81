"""Figure of laser maps from clean and from noisy odometry."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.transforms import Affine2D

from odomcorrupt.mapping.occupancy_grid import OCCUPIED, Grid
from odomcorrupt.mapping.scan_map import added_thickness
from odomcorrupt.report.plots.figure import BLACK, GREEN, RUNS, TRUTH, drawing, new_figure

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from odomcorrupt.mapping.occupancy_grid import FreeSpace
    from odomcorrupt.mapping.scan_map import ScanMap

PATHS = (TRUTH, RUNS, GREEN)


def draw_scan_maps(maps: Sequence[ScanMap], window_m: float, added: str = "noise alone") -> Figure:
    """Draw maps side by side with equal limits; below, the distance of hits from the walls and the wall thickness."""
    left, right, bottom, top = maps[0].grid.extent
    width = 11.0
    panel = float(np.clip(width / len(maps) * (top - bottom) / (right - left), 2.5, 7.0))
    with drawing():
        figure = new_figure(width, panel + 3.6)
        places = figure.add_gridspec(2, len(maps), height_ratios=(panel, 2.2))
        for i, scan_map in enumerate(maps):
            axes = figure.add_subplot(places[0, i])
            draw_grid(axes, scan_map.grid)
            axes.plot(*scan_map.path_xyt[:, :2].T, color=PATHS[i], linewidth=1.4)
            axes.plot(*scan_map.path_xyt[0, :2], "s", color=PATHS[i], markersize=6, markeredgecolor="white")
            thick = 100.0 * scan_map.thickness_m[-1]
            axes.set_title(f"{scan_map.name}\nwalls {thick:.1f} cm thick", color=PATHS[i])
            axes.set(xlabel="x (m)", ylabel="y (m)" if i == 0 else "", xlim=(left, right), ylim=(bottom, top))
            axes.locator_params(axis="x", nbins=5)
        below = places[1, :].subgridspec(1, 2)
        _off_surface(figure.add_subplot(below[0, 0]), maps)
        _thickness(figure.add_subplot(below[0, 1]), maps, window_m, added)
    return figure


def draw_grid(axes: Axes, grid: Grid) -> None:
    """Draw a map in the usual colours: free white, occupied black, unknown grey."""
    image = axes.imshow(
        grid.cells, origin="lower", extent=grid.extent, cmap=ListedColormap(["white", BLACK, "#D0D0D0"]), vmin=0,
        vmax=2, interpolation="nearest", zorder=0,
    )  # fmt: skip
    x, y, yaw = (float(value) for value in grid.origin_xyt)
    image.set_transform(Affine2D().rotate_around(x, y, yaw) + axes.transData)
    axes.set_aspect("equal", adjustable="box")


def draw_free_space(axes: Axes, space: FreeSpace) -> None:
    """Draw a map below other content of the odom frame: walls, and pale where the robot's centre cannot be."""
    x, y, yaw = (float(value) for value in space.grid.origin_xyt)
    mx, my, myaw = (float(value) for value in space.map_from_odom)
    to_odom = Affine2D().translate(-mx, -my).rotate(-myaw)
    for layer, colours, most in (
        (space.blocked, ("white", "#E4E4E4"), 1),
        (np.where(space.grid.cells == OCCUPIED, 1, np.nan), (BLACK,), 1),
    ):
        image = axes.imshow(
            layer, origin="lower", extent=space.grid.extent, cmap=ListedColormap(colours), vmin=0, vmax=most,
            interpolation="nearest", zorder=0, alpha=0.8,
        )  # fmt: skip
        image.set_transform(Affine2D().rotate_around(x, y, yaw) + to_odom + axes.transData)


def _off_surface(axes: Axes, maps: Sequence[ScanMap]) -> None:
    """Draw the distance of hits from the clean map's walls, for each part of the drive."""
    for colour, scan_map in zip(PATHS[1:], maps[1:], strict=False):
        middle = scan_map.marks_m - scan_map.marks_m[0] / 2.0
        axes.bar(
            middle, 100.0 * scan_map.off_surface_m, width=0.9 * scan_map.marks_m[0], color=colour, alpha=0.8,
            label=scan_map.name,
        )  # fmt: skip
    axes.set(xlabel="distance travelled (m)", ylabel="cm", ylim=(0.0, None), xlim=(0.0, None))
    axes.set_title("distance of hits from the walls of the first map (RMS)")
    axes.grid(visible=True, axis="y", color="0.92")
    axes.legend(loc="upper left", fontsize=9)


def _thickness(axes: Axes, maps: Sequence[ScanMap], window_m: float, added: str) -> None:
    for colour, style, scan_map in zip(PATHS, ("-", "-", (0, (1, 2))), maps, strict=False):
        axes.plot(
            scan_map.marks_m, 100.0 * scan_map.thickness_m, "o", linestyle=style, color=colour, markersize=4,
            label=scan_map.name,
        )  # fmt: skip
    added_m = added_thickness(maps[0].thickness_m, maps[1].thickness_m)
    axes.plot(maps[0].marks_m, 100.0 * added_m, "s--", color="0.6", markersize=4, label=added)
    axes.set(xlabel="distance travelled (m)", ylabel="cm", ylim=(0.0, None), xlim=(0.0, None))
    axes.set_title(f"wall thickness (Razlaw et al. 2015), window {window_m:g} m")
    axes.grid(visible=True, color="0.92")
    axes.legend(loc="best", ncols=2, fontsize=9)
