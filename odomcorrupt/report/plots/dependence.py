"""The picture of what no known effect explains: the error per metre as a curve over what it depends on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.report.plots.figure import ORANGE, drawing, new_figure

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.select.dependence import Dependence

__all__ = ["MOST_CURVES", "draw_unknown"]

MOST_CURVES = 3
_UNITS = {
    "speed": ("speed (m/s)", 1.0),
    "yaw_rate": ("yaw rate (deg/s)", float(np.degrees(1.0))),
    "acceleration": ("acceleration (m/s²)", 1.0),
    "lateral_acceleration": ("lateral acceleration (m/s²)", 1.0),
    "yaw_acceleration": ("yaw acceleration (deg/s²)", float(np.degrees(1.0))),
    "time": ("time (s)", 1.0),
    "distance": ("path driven (m)", 1.0),
}


def draw_unknown(unknown: Sequence[Dependence]) -> Figure:
    """Draw the plainest curves beside each other, with two standard errors about them."""
    shown = unknown[:MOST_CURVES]
    with drawing():
        figure = new_figure(11.0, 3.6)
        for axes, one in zip(figure.subplots(1, len(shown), squeeze=False)[0], shown, strict=True):
            _drawn(axes, one)
            axes.set_title(f"{one.channel} error, {one.nats:.0f} nats")
    return figure


def _drawn(axes: Axes, one: Dependence) -> None:
    per = f"per {one.per}"
    scale, unit = (float(np.degrees(1.0)), f"deg {per}") if one.channel == "yaw" else (1e3, f"mm {per}")
    if one.regressor == "position":
        _places(axes, one, scale, unit)
        return
    if one.regressor == "heading":
        x = np.linspace(-180.0, 180.0, 121)
        angle = np.radians(x)
        waves = np.stack((np.cos(angle), np.sin(angle), np.cos(2 * angle), np.sin(2 * angle)), axis=1)
        waves = waves[:, one.centres.astype(int)]
        curve, error = waves @ one.curve, np.sqrt(waves**2 @ one.curve_error**2)
        label = "heading (deg)"
    else:
        label, factor = _UNITS.get(one.regressor, (one.regressor, 1.0))
        if one.wavelength_m is not None:
            label = "path driven, within a turn of the wheel (m)"
        x, curve, error = one.centres * factor, one.curve, one.curve_error
    _band(axes, x, scale * curve, scale * error)
    axes.set(xlabel=label, ylabel=f"truth minus odometry ({unit})")


def _band(axes: Axes, x: Array, curve: Array, error: Array) -> None:
    axes.axhline(0.0, color="0.3", linewidth=0.8)
    axes.fill_between(x, curve - 2.0 * error, curve + 2.0 * error, color=ORANGE, alpha=0.28, linewidth=0)
    axes.plot(x, curve, color="#A06000", linewidth=1.8, marker="o" if len(x) < 20 else "", markersize=4)
    axes.grid(visible=True, color="0.93")
    axes.set_axisbelow(True)


def _places(axes: Axes, one: Dependence, scale: float, unit: str) -> None:
    """Draw a disc for each place: colour for the error, size for how well it is known."""
    values = scale * one.curve
    most = float(np.abs(values).max()) or 1.0
    weight = 1.0 / np.maximum(one.curve_error, 1e-12)
    dots = axes.scatter(
        one.centres[:, 0], one.centres[:, 1], c=values, cmap="RdBu_r", vmin=-most, vmax=most,
        s=40.0 + 320.0 * weight / weight.max(), edgecolors="0.4", linewidths=0.6,
    )  # fmt: skip
    axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    axes.margins(0.18)
    axes.figure.colorbar(dots, ax=axes, label=f"truth minus odometry ({unit})", shrink=0.85)
