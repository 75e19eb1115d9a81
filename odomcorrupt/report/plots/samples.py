"""Figures of maps, of samples of one motion, of its density with their moments, and of the dispersion along a drive."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.patches import Ellipse as EllipsePatch
from matplotlib.transforms import Affine2D

from odomcorrupt.geometry.se2 import wrap
from odomcorrupt.mapping.occupancy_grid import OCCUPIED, Grid
from odomcorrupt.mapping.scan_map import added_thickness
from odomcorrupt.report.plots.figure import BLACK, BLUE, GREEN, ORANGE, RED, RUNS, SKY, TRUTH, drawn
from odomcorrupt.sampling.samples import Moments, Move, ellipse, linearised_moments, sample_moments

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from odomcorrupt.batching.dispersion import SpreadReport
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.mapping.occupancy_grid import FreeSpace
    from odomcorrupt.mapping.scan_map import ScanMap
    from odomcorrupt.model.noise_laws import Variances
    from odomcorrupt.sampling.density import DensityGrid
    from odomcorrupt.sampling.samples import ParticleSet


PATHS = (TRUTH, RUNS, GREEN)


def draw_scan_maps(maps: Sequence[ScanMap], window_m: float, added: str = "noise alone") -> Figure:
    """Draw maps side by side with equal limits; below, the distance of hits from the walls and the wall thickness."""
    left, right, bottom, top = maps[0].grid.extent
    width = 11.0
    panel = float(np.clip(width / len(maps) * (top - bottom) / (right - left), 2.5, 7.0))
    with drawn(width, panel + 3.6) as figure:
        places = figure.add_gridspec(2, len(maps), height_ratios=(panel, 2.2))
        for i, scan_map in enumerate(maps):
            axes = figure.add_subplot(places[0, i])
            # in the usual colours: free white, occupied black, unknown grey
            _draw_cells(axes, scan_map.grid, scan_map.grid.cells, ("white", BLACK, "#D0D0D0"))
            axes.set_aspect("equal", adjustable="box")
            axes.grid(visible=False)
            axes.plot(*scan_map.path_xyt[:, :2].T, color=PATHS[i], linewidth=1.4)
            axes.plot(*scan_map.path_xyt[0, :2], "s", color=PATHS[i], markersize=6, markeredgecolor="white")
            thick = 100.0 * scan_map.thickness_m[-1]
            axes.set_title(f"{scan_map.name}\nwalls {thick:.1f} cm thick", color=PATHS[i])
            axes.set(xlabel="x (m)", ylabel="y (m)" if i == 0 else "", xlim=(left, right), ylim=(bottom, top))
            axes.locator_params(axis="x", nbins=5)
        below = places[1, :].subgridspec(1, 2)
        off, thickness = (figure.add_subplot(below[0, i]) for i in range(2))
        for colour, scan_map in zip(PATHS[1:], maps[1:], strict=False):
            step_m = scan_map.marks_m[0]
            bars: dict[str, Any] = {"width": 0.9 * step_m, "color": colour, "alpha": 0.8, "label": scan_map.name}
            off.bar(scan_map.marks_m - step_m / 2.0, 100.0 * scan_map.off_surface_m, **bars)
        off.set_title("distance of hits from the walls of the first map (RMS)")
        for colour, style, scan_map in zip(PATHS, ("-", "-", (0, (1, 2))), maps, strict=False):
            line: dict[str, Any] = {"linestyle": style, "color": colour, "markersize": 4, "label": scan_map.name}
            thickness.plot(scan_map.marks_m, 100.0 * scan_map.thickness_m, "o", **line)
        added_m = added_thickness(maps[0].thickness_m, maps[1].thickness_m)
        thickness.plot(maps[0].marks_m, 100.0 * added_m, "s--", color="0.6", markersize=4, label=added)
        thickness.set_title(f"wall thickness (Razlaw et al. 2015), window {window_m:g} m")
        for axes in (off, thickness):
            axes.set(xlabel="distance travelled (m)", ylabel="cm", ylim=(0.0, None), xlim=(0.0, None))
        off.legend(loc="upper left")
        thickness.legend(loc="best", ncols=2)
    return figure


def _draw_cells(
    axes: Axes, grid: Grid, cells: NDArray[Any], colours: Sequence[str], moved: Affine2D | None = None, **more: Any
) -> None:
    """Draw cells of a map, with a colour for each value; `moved` is from its frame to that of the axes."""
    image = axes.imshow(
        cells, origin="lower", extent=grid.extent, cmap=ListedColormap(colours), vmin=0, vmax=max(len(colours) - 1, 1),
        interpolation="nearest", zorder=0, **more,
    )  # fmt: skip
    x, y, yaw = (float(value) for value in grid.origin_xyt)
    image.set_transform(Affine2D().rotate_around(x, y, yaw) + (moved or Affine2D()) + axes.transData)


def draw_free_space(axes: Axes, space: FreeSpace) -> None:
    """Draw a map below other content of the odom frame: walls, and pale where the robot's centre cannot be."""
    x, y, yaw = (float(value) for value in space.map_from_odom)
    to_odom = Affine2D().translate(-x, -y).rotate(-yaw)
    walls = np.where(space.grid.cells == OCCUPIED, 1, np.nan)
    _draw_cells(axes, space.grid, space.blocked, ("white", "#E4E4E4"), to_odom, alpha=0.8)
    _draw_cells(axes, space.grid, walls, (BLACK,), to_odom, alpha=0.8)


SIGMAS = 2.0


def draw_banana(move: Move, variances: Variances, xyt: Array, title: str, space: FreeSpace | None = None) -> Figure:
    """Draw samples (n, 3) of a motion's end pose, with their mean, the linearised ellipse, and their headings.

    space : free space that constrained the samples, drawn below
    """
    with drawn(8.6, 5.4) as figure:
        plane, headings = figure.subplots(1, 2, width_ratios=(3, 1))
        if space is not None:
            draw_free_space(plane, space)
        _draw_samples(plane, xyt)
        _ellipses(plane, move, variances, xyt)
        _draw_move(plane, move)
        reach = [_corners(linearised_moments(move, variances)), _corners(sample_moments(xyt))]
        _frame_samples(plane, move, np.concatenate((xyt[:, :2], *reach)))
        _inset(plane, move, variances, xyt)
        _headings(headings, move, xyt)
        figure.legend(*plane.get_legend_handles_labels(), loc="outside lower left", ncols=3)
        figure.suptitle(title, x=0.01, ha="left")
    return figure


def _inset(axes: Axes, move: Move, variances: Variances, xyt: Array) -> None:
    """Draw an enlarged inset of a particle set that is small relative to its motion."""
    extent = float(np.ptp(xyt[:, :2], axis=0).max())
    width = float(np.diff(axes.get_xlim())[0])
    if not 0.0 < extent < 0.25 * width:
        return
    inset = axes.inset_axes((0.47, 0.06, 0.5, 0.5))
    _draw_samples(inset, xyt)
    _ellipses(inset, move, variances, xyt)
    middle = xyt[:, :2].mean(axis=0)
    half = 0.55 * extent
    inset.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half))
    inset.set_aspect("equal")
    inset.tick_params(labelsize=7)
    inset.locator_params(nbins=4)
    inset.set_title("the cloud alone", fontsize=8)
    inset.spines[["top", "right"]].set_visible(True)


def _corners(moments: Moments) -> Array:
    """Return the corners (4, 2) of the box around an ellipse."""
    half = SIGMAS * np.sqrt(np.diag(moments.covariance)[:2])
    return moments.mean_xyt[:2] + half * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])


def _draw_samples(axes: Axes, xyt: Array) -> None:
    """Draw samples as dots that remain visible at high density."""
    size = float(np.clip(6000.0 / len(xyt), 1.0, 12.0))
    axes.scatter(
        xyt[:, 0], xyt[:, 1], s=size, color=BLUE, alpha=0.45, linewidths=0, label=f"{len(xyt)} samples", rasterized=True
    )


def _draw_move(axes: Axes, move: Move) -> None:
    """Draw the odometry's motion: both poses as arrows, connected by a line."""
    start, end = move.start_xyt, move.end_xyt
    axes.plot(*np.stack((start, end))[:, :2].T, color=BLACK, linewidth=1.0, linestyle=(0, (4, 3)), zorder=4)
    for pose, tip in zip((start, end), _tips(move), strict=True):
        arrow = {"arrowstyle": "-|>", "color": BLACK, "linewidth": 1.6, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", (tip[0], tip[1]), (pose[0], pose[1]), arrowprops=arrow, zorder=6)
    axes.plot(*start[:2], "s", color=BLACK, markersize=6, label="start", zorder=6)
    axes.plot(*end[:2], "o", color="white", markeredgecolor=BLACK, markersize=6, label="odometry's end", zorder=5)


def _tips(move: Move) -> Array:
    """Return the tips (2, 2) of the arrows of both headings."""
    length = 0.22 * max(float(np.hypot(*move.shift_xy)), 0.1)
    poses = np.stack((move.start_xyt, move.end_xyt))
    return poses[:, :2] + length * np.column_stack((np.cos(poses[:, 2]), np.sin(poses[:, 2])))


def _frame_samples(axes: Axes, move: Move, xy: Array) -> None:
    """Set limits that include all points (n, 2) and the motion, with equal scales."""
    points = np.concatenate((xy, move.start_xyt[None, :2], move.end_xyt[None, :2], _tips(move)))
    low, high = points.min(axis=0), points.max(axis=0)
    pad = 0.07 * float((high - low).max()) + 1e-3
    axes.set(xlim=(low[0] - pad, high[0] + pad), ylim=(low[1] - pad, high[1] + pad), xlabel="x (m)", ylabel="y (m)")
    axes.set_aspect("equal", adjustable="box")


def _ellipses(axes: Axes, move: Move, variances: Variances, xyt: Array) -> None:
    own = sample_moments(xyt)
    for moments, colour, style, label in (
        (linearised_moments(move, variances), RED, "-", f"linearised, {SIGMAS:g} sigma"),
        (own, ORANGE, (0, (5, 2)), f"of the samples, {SIGMAS:g} sigma"),
    ):
        draw_ellipse(axes, moments, edgecolor=colour, linestyle=style, linewidth=1.8, label=label, zorder=5)
    mean: dict[str, Any] = {"markersize": 6, "markeredgecolor": "white", "markeredgewidth": 0.6, "zorder": 8}
    axes.plot(*own.mean_xyt[:2], "X", label="mean", color=ORANGE, **mean)


def draw_ellipse(axes: Axes, moments: Moments, **style: Any) -> None:
    """Draw the ellipse of x and y at `SIGMAS` standard deviations."""
    e = ellipse(moments, SIGMAS)
    centre, angle_deg = (e.centre_xy[0], e.centre_xy[1]), float(np.degrees(e.angle_rad))
    axes.add_patch(EllipsePatch(centre, 2 * e.major_m, 2 * e.minor_m, angle=angle_deg, fill=False, **style))


def _headings(axes: Axes, move: Move, xyt: Array) -> None:
    error = np.degrees(xyt[:, 2] - move.start_xyt[2] - move.turn_rad)
    axes.hist(error, bins=25, orientation="horizontal", color=BLUE, alpha=0.6)
    axes.axhline(0.0, color=BLACK, linewidth=1.0, linestyle=(0, (4, 3)))
    reach = 1.08 * max(float(np.abs(error).max()), 1e-6)
    end = float(np.degrees(wrap(move.end_xyt[2])))
    axes.set(ylim=(-reach, reach), xlabel="samples", ylabel=f"heading minus the odometry's {end:.4g} deg (deg)")


def draw_density(move: Move, grid: DensityGrid, xyt: Array, title: str, unit: str) -> Figure:
    """Draw samples (n, 3) on the left and a density on the right, on the same axes."""
    with drawn(10.0, 5.2) as figure:
        left, right = figure.subplots(1, 2, sharex=True, sharey=True)
        image = right.pcolormesh(
            grid.x_m, grid.y_m, np.ma.masked_less(grid.density, 0.01 * grid.density.max()), cmap="Blues",
            shading="nearest", rasterized=True,
        )  # fmt: skip
        _draw_samples(left, xyt)
        shown = grid.density > 1e-3 * grid.density.max()
        rows, columns = np.nonzero(shown.any(axis=1))[0], np.nonzero(shown.any(axis=0))[0]
        box = np.column_stack((grid.x_m[columns[[0, -1]]], grid.y_m[rows[[0, -1]]]))
        for axes in (left, right):
            _draw_move(axes, move)
            _frame_samples(axes, move, np.concatenate((xyt[:, :2], box)))
        left.set_title(f"{len(xyt)} samples")
        right.set_title("closed form, summed over the heading")
        right.set_ylabel("")
        figure.colorbar(image, ax=right, label=unit, shrink=0.85)
        figure.suptitle(title, x=0.01, ha="left")
    return figure


def draw_cloud(cloud: ParticleSet, title: str, space: FreeSpace | None = None) -> Figure:
    """Draw the odometry's path, and at each distance the runs' positions with their ellipse.

    space : free space that constrained the runs, drawn below
    """
    colours = (BLUE, ORANGE, GREEN, RED, SKY)
    size = float(np.clip(2500.0 / len(cloud.xyt), 1.0, 8.0))
    with drawn(8.6, 6.8) as figure:
        axes = figure.subplots()
        if space is not None:
            draw_free_space(axes, space)
        for i, distance in enumerate(cloud.distance_m):
            colour = colours[i % len(colours)]
            points = cloud.xyt[:, i]
            axes.scatter(
                points[:, 0], points[:, 1], s=size, color=colour, alpha=0.45, linewidths=0, rasterized=True, zorder=2
            )
            # white background, so that the line is visible in the particle set
            here = cloud.clean_xyt[i, :2]
            axes.plot(*here, "o", color="white", markeredgecolor=BLACK, markersize=5, zorder=6)
            axes.annotate(
                f"{distance:.3g} m", (here[0], here[1]), xytext=(7, 7), textcoords="offset points", fontsize=9,
                bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.8}, zorder=7,
            )  # fmt: skip
            if space is not None:
                # a set split by walls is not described by two moments
                continue
            draw_ellipse(axes, sample_moments(points), edgecolor=colour, linewidth=1.6, zorder=4)
        axes.plot(*cloud.path_xyt[:, :2].T, color=BLACK, linewidth=1.3, zorder=5, label="odometry")
        axes.plot(*cloud.path_xyt[0, :2], "s", color=BLACK, markersize=7, zorder=6, label="start")
        axes.scatter([], [], s=14, color=BLUE, label=f"{len(cloud.xyt)} runs, after the stated distances")
        if space is None:
            axes.plot([], [], color=BLUE, linewidth=1.6, label=f"their {SIGMAS:g} sigma ellipse")
        axes.set(xlabel="x (m)", ylabel="y (m)", title=title)
        if space is None:
            axes.margins(0.06)
            axes.set_aspect("equal", adjustable="datalim")
        else:
            # the map may be far larger than the area of the drive
            every = np.concatenate((cloud.xyt.reshape(-1, 3), cloud.path_xyt))[:, :2]
            low, high = every.min(axis=0), every.max(axis=0)
            pad = 0.06 * float((high - low).max())
            axes.set(xlim=(low[0] - pad, high[0] + pad), ylim=(low[1] - pad, high[1] + pad))
            axes.set_aspect("equal", adjustable="box")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower left", ncols=4)
    return figure


def draw_spread(report: SpreadReport) -> Figure:
    """Draw the true path and the runs, and errors of position and heading against distance."""
    with drawn(10.0, 5.2) as figure:
        grid = figure.add_gridspec(2, 2, width_ratios=(3, 2))
        plane = figure.add_subplot(grid[:, 0])
        for path in report.runs_xy:
            plane.plot(path[:, 0], path[:, 1], color=RUNS, alpha=0.2, linewidth=0.8)
        plane.plot([], [], color=RUNS, label=f"{len(report.runs_xy)} of {report.runs} runs")
        plane.plot(report.clean_xy[:, 0], report.clean_xy[:, 1], color=TRUTH, linewidth=2.0, label="clean path")
        plane.set(xlabel="x in odom, m", ylabel="y in odom, m", title="Paths by the corrupted odometry")
        plane.set_aspect("equal", adjustable="datalim")
        plane.legend(loc="best")
        for row, (column, factor, label) in enumerate(
            ((1, 1.0, "position error, m"), (2, 180.0 / np.pi, "heading, deg"))
        ):
            growth = figure.add_subplot(grid[row, 1])
            band = report.band
            below: dict[str, Any] = {"color": TRUTH, "alpha": 0.15, "linewidth": 0.0, "label": "predicted, 2 sigma"}
            growth.fill_between(band[:, 0], 2.0 * factor * band[:, column], **below)
            growth.plot(band[:, 0], factor * band[:, column], color=TRUTH, linewidth=1.2, label="predicted, 1 sigma")
            errors = report.errors
            for run in errors[:200]:
                growth.plot(run[:, 0], factor * run[:, column], color=RUNS, alpha=0.12, linewidth=0.7)
            rms = np.sqrt(np.mean(errors[:, :, column] ** 2, axis=0))
            growth.plot(errors[0, :, 0], factor * rms, "o-", color=RUNS, markersize=3.5, label="runs, rms")
            growth.set(ylabel=label, xlim=(0.0, None), ylim=(0.0, None))
            growth.legend(loc="upper left", fontsize=8)
        growth.set_xlabel("distance driven, m")
        figure.suptitle(f"{report.directory}: {report.runs} runs", x=0.01, ha="left")
    return figure
