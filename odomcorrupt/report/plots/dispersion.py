"""Figures of the dispersion of a model's runs along a drive."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.patches import Ellipse as EllipsePatch

from odomcorrupt.report.plots.figure import BLACK, BLUE, GREEN, ORANGE, RED, SKY, drawing, new_figure
from odomcorrupt.report.plots.maps import draw_free_space
from odomcorrupt.sampling.samples import ellipse, sample_moments

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from odomcorrupt.batching.dispersion import SpreadReport
    from odomcorrupt.mapping.free_space import FreeSpace
    from odomcorrupt.sampling.particles import ParticleSet

__all__ = ["draw_cloud", "draw_spread"]

SIGMAS = 2.0


def draw_cloud(cloud: ParticleSet, title: str, space: FreeSpace | None = None) -> Figure:
    """Draw the odometry's path, and at each distance the runs' positions with their ellipse.

    space : free space that constrained the runs, drawn below
    """
    colours = (BLUE, ORANGE, GREEN, RED, SKY)
    size = float(np.clip(2500.0 / len(cloud.xyt), 1.0, 8.0))
    with drawing():
        figure = new_figure(8.6, 6.8)
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
            e = ellipse(sample_moments(points), SIGMAS)
            patch = EllipsePatch(
                (e.centre_xy[0], e.centre_xy[1]), 2 * e.major_m, 2 * e.minor_m, angle=float(np.degrees(e.angle_rad)),
                fill=False, edgecolor=colour, linewidth=1.6, zorder=4,
            )  # fmt: skip
            axes.add_patch(patch)
        axes.plot(*cloud.path_xyt[:, :2].T, color=BLACK, linewidth=1.3, zorder=5, label="odometry")
        axes.plot(*cloud.path_xyt[0, :2], "s", color=BLACK, markersize=7, zorder=6, label="start")
        axes.scatter([], [], s=14, color=BLUE, label=f"{len(cloud.xyt)} runs, after so many metres")
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
        axes.grid(visible=True, color="0.92")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower left", ncols=4, fontsize=9)
    return figure


def draw_spread(report: SpreadReport) -> Figure:
    """Draw the true path and the runs, and errors of position and heading against distance."""
    with drawing():
        figure = new_figure(10.0, 5.2)
        grid = figure.add_gridspec(2, 2, width_ratios=(3, 2))
        plane = figure.add_subplot(grid[:, 0])
        for path in report.runs_xy:
            plane.plot(path[:, 0], path[:, 1], color=RED, alpha=0.2, linewidth=0.8)
        plane.plot([], [], color=RED, label=f"{len(report.runs_xy)} of {report.runs} runs")
        plane.plot(report.clean_xy[:, 0], report.clean_xy[:, 1], color=BLUE, linewidth=2.0, label="true path")
        plane.set(xlabel="x in odom, m", ylabel="y in odom, m", title="Where odometry says the robot went")
        plane.set_aspect("equal", adjustable="datalim")
        plane.legend(loc="best", fontsize=9)
        for row, (column, factor, label) in enumerate(
            ((1, 1.0, "position error, m"), (2, 180.0 / np.pi, "heading, deg"))
        ):
            growth = figure.add_subplot(grid[row, 1])
            band = report.band
            below: dict[str, Any] = {"color": BLUE, "alpha": 0.15, "linewidth": 0.0, "label": "predicted, 2 sigma"}
            growth.fill_between(band[:, 0], 2.0 * factor * band[:, column], **below)
            growth.plot(band[:, 0], factor * band[:, column], color=BLUE, linewidth=1.2, label="predicted, 1 sigma")
            errors = report.errors
            for run in errors[:200]:
                growth.plot(run[:, 0], factor * run[:, column], color=RED, alpha=0.12, linewidth=0.7)
            rms = np.sqrt(np.mean(errors[:, :, column] ** 2, axis=0))
            growth.plot(errors[0, :, 0], factor * rms, "o-", color=RED, markersize=3.5, label="runs, rms")
            growth.set(ylabel=label, xlim=(0.0, None), ylim=(0.0, None))
            growth.legend(loc="upper left", fontsize=8)
        growth.set_xlabel("distance driven, m")
        figure.suptitle(f"{report.directory}: {report.runs} runs", x=0.01, ha="left", fontsize=11)
    return figure
