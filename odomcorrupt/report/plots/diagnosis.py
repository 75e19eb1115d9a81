"""Figures of a diagnosis: candidates with their evidence, a dependence, and a drive that would separate causes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from odomcorrupt.report.plots.figure import BLUE, GREEN, ORANGE, SKY, drawing, new_figure
from odomcorrupt.study.design.plan import STEP_S, Plan

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.select.candidates import Candidate
    from odomcorrupt.study.select.dependence import Dependence
    from odomcorrupt.study.select.result import Learned, Step

_MOST = 7
_STEPS = 6
_GREY = "0.78"
_TICKS = ((0.0, 3.0, 10.0, 100.0, 1e3, 1e4, 1e5), ("0", "3", "10", "100", "1000", "10 000", "100 000"))
_LINEAR = 3.0
"""Limit of the axis's linear part, nats; smaller values are no evidence."""


def evidence_nats(candidate: Candidate) -> float:
    """Return the nats of a refit, or half the score statistic if there was none; at least zero."""
    score = candidate.score
    plain = candidate.gain if candidate.fitted is not None else 0.5 * score.statistic / score.inflation
    return max(float(plain), 0.0) if np.isfinite(plain) else 0.0


def draw_candidates(learned: Learned) -> Figure:
    """Draw the best candidates of the first steps and of the last one, on one scale."""
    steps = list(enumerate(learned.rounds, start=1))
    shown = steps if len(steps) <= _STEPS else [*steps[: _STEPS - 1], steps[-1]]
    columns = min(len(shown), 2)
    rows = -(-len(shown) // columns)
    most = max((evidence_nats(c) for _, step in shown for c in step.candidates), default=1.0)
    with drawing():
        figure = new_figure(11.0 if columns == 2 else 8.0, 0.5 + 2.6 * rows)
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes, (number, step) in zip(panels, shown, strict=False):
            left_out = f" (steps {_STEPS} to {number - 1} not drawn)" if number > len(shown) else ""
            _bars(axes, f"step {number} of {len(steps)}{left_out}", step)
            axes.set_xscale("symlog", linthresh=_LINEAR, linscale=0.4)
            axes.set_xticks(*_TICKS)
            axes.set_xlim(0.0, 12.0 * max(most, 10.0))
        for axes in panels[len(shown) :]:
            axes.set_axis_off()
    return figure


def _bars(axes: Axes, title: str, step: Step) -> None:
    ranked = sorted(step.candidates, key=lambda c: (not c.refused, evidence_nats(c)), reverse=True)[:_MOST]
    nats = [evidence_nats(c) for c in ranked]
    colours = [_colour(c, step) for c in ranked]
    places = np.arange(len(ranked))
    bars = axes.barh(places, nats, color=colours, height=0.72)
    labels = [_label(c, n, step) for c, n in zip(ranked, nats, strict=True)]
    axes.bar_label(bars, labels=labels, padding=4, fontsize=8)
    axes.set_yticks(places, [c.score.effect.name for c in ranked])
    axes.invert_yaxis()
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("evidence (nats)")
    outcome = f"added {step.name}" if step.name else "nothing more to add"
    axes.set_title(f"{title}: {outcome}")


def _colour(candidate: Candidate, step: Step) -> str:
    name = candidate.score.effect.name
    if name == step.added:
        return BLUE
    return SKY if name in step.alternatives else _GREY


def _label(candidate: Candidate, nats: float, step: Step) -> str:
    name = candidate.score.effect.name
    if name == step.added:
        return f"{nats:.0f}"
    if name in step.alternatives:
        return f"{nats:.0f}, not separable from it"
    return candidate.refused or f"{nats:.0f}, others explain it better"


_MOST_CURVES = 3
_UNITS = {
    "speed": ("speed (m/s)", 1.0),
    "sideways_speed": ("sideways speed (m/s)", 1.0),
    "yaw_rate": ("yaw rate (deg/s)", float(np.degrees(1.0))),
    "acceleration": ("acceleration (m/s²)", 1.0),
    "lateral_acceleration": ("lateral acceleration (m/s²)", 1.0),
    "yaw_acceleration": ("yaw acceleration (deg/s²)", float(np.degrees(1.0))),
    "time": ("time (s)", 1.0),
    "distance": ("path driven (m)", 1.0),
}


def draw_unknown(unknown: Sequence[Dependence]) -> Figure:
    """Draw the dependences with the clearest curves side by side, with bands of two standard errors."""
    shown = unknown[:_MOST_CURVES]
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


def _places(axes: Axes, one: Dependence, scale: float, unit: str) -> None:
    """Draw a disc for each place: colour shows the error, size its precision."""
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


_SHOWN_S = 120.0


def draw_plan(plan: Plan) -> Figure:
    """Draw the path of a robot that follows the plan, and its commands in the first two minutes."""
    path = plan.path
    shown = slice(0, round(_SHOWN_S / STEP_S))
    times_s = np.arange(len(plan.v_mps))[shown] * STEP_S
    with drawing():
        figure = new_figure(11.0, 3.6)
        parts: Any = figure.subfigures(1, 2, width_ratios=(1.0, 1.9))
        where = parts[0].subplots()
        where.plot(path[:, 0], path[:, 1], color=BLUE, linewidth=1.4)
        where.plot(*path[0, :2], marker="s", color=GREEN, markersize=7, linestyle="")
        size = max(*plan.floor_m, 1.0)
        middle = (path[:, :2].max(axis=0) + path[:, :2].min(axis=0)) / 2.0
        where.set(
            aspect="equal", xlabel="m", ylabel="m", title="path (square: start)",
            xlim=(middle[0] - 0.6 * size, middle[0] + 0.6 * size),
            ylim=(middle[1] - 0.6 * size, middle[1] + 0.6 * size),
        )  # fmt: skip
        where.grid(visible=True, color="0.93")
        above, below = parts[1].subplots(2, 1, sharex=True)
        above.plot(times_s, plan.v_mps[shown], color=BLUE, linewidth=1.3)
        above.set(ylabel="m/s", title="commands, the first two minutes")
        below.plot(times_s, np.degrees(plan.omega_radps[shown]), color=ORANGE, linewidth=1.3)
        below.set(ylabel="deg/s", xlabel="s")
        for axes in (above, below):
            axes.axhline(0.0, color="0.6", linewidth=0.7, zorder=0)
            axes.grid(visible=True, color="0.93")
    return figure
