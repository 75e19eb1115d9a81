"""Figure of the error's dependence on regressors: growth per metre against speed, yaw rate, acceleration and others."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.report.plots.figure import COLOURS, MARKERS, drawing, new_figure, short_name
from odomcorrupt.study.validate.error_rates import CHANNELS, interval_motion, joint_rates, unit_columns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.validate.compare import Comparison, ModelEvaluation
    from odomcorrupt.study.validate.evaluation import Evaluation

_BINS = 8
_UNITS = ("mm per m", "mm per m", "deg per m")


def draw_residuals(comparison: Comparison) -> Figure:
    """Draw growth of the error against every regressor, a row per channel, with its standard deviation by chance."""
    headed = all(piece.headed for evaluation in comparison.evaluations for piece in evaluation.pieces)
    count = 3 if headed else 2
    shown = _shown(comparison)
    first = shown[0][0].pieces
    labels = list(_regressors(first[0]))
    edges = [_edges(np.concatenate([_regressors(piece)[label] for piece in first])) for label in labels]
    drawn: list[list[Array]] = [[] for _ in range(count)]
    with drawing():
        figure = new_figure(12.0, 1.0 + 2.1 * count)
        panels = figure.subplots(count, len(labels), sharey="row", sharex="col", squeeze=False)
        for which, (evaluation, number) in enumerate(shown):
            for d, label in enumerate(labels):
                for c in range(count):
                    rates = _rates(evaluation.pieces, label, c, edges[d])
                    shift = (which - (len(shown) - 1) / 2.0) * 0.22
                    _points(panels[c, d], rates, edges[d], evaluation, number, shift)
                    drawn[c].append(rates)
        for c in range(count):
            _limit(panels[c], np.concatenate(drawn[c], axis=1))
            panels[c, 0].set_ylabel(f"{CHANNELS[c]} ({_UNITS[c]})")
            for axes in panels[c]:
                axes.axhline(0.0, color="0.3", linewidth=0.8, zorder=1)
                axes.grid(visible=True, color="0.93")
                axes.tick_params(labelsize=8)
        for axes, label in zip(panels[-1], labels, strict=True):
            axes.set_xlabel(label)
        figure.legend(
            *panels[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=2 * len(shown), fontsize=9
        )
    return figure


def _shown(comparison: Comparison) -> list[tuple[ModelEvaluation, int]]:
    """Return all of up to three models, else the first and the last, with their numbers: more would overlap."""
    numbered = [(evaluation, i) for i, evaluation in enumerate(comparison.evaluations)]
    return numbered if len(numbered) <= 3 else [numbered[0], numbered[-1]]


def _regressors(piece: Evaluation) -> dict[str, Array]:
    """Return the regressors by label, each over the K intervals of a segment, in customary units."""
    m = interval_motion(piece.problem)
    return {
        "speed (m/s)": m.v,
        "yaw rate (deg/s)": np.degrees(m.omega),
        "acceleration (m/s²)": m.a,
        "time (s)": m.t_s,
        "heading (deg)": np.degrees(np.arctan2(np.sin(m.heading), np.cos(m.heading))),
        "path driven (m)": m.distance,
    }


def _edges(values: Array) -> Array:
    """Return the edges of equally wide bins over all but the most extreme values."""
    low, high = np.quantile(values, [0.005, 0.995])
    return np.linspace(low, max(high, low + 1e-9), _BINS + 1)


def _rates(pieces: Sequence[Evaluation], regressor: str, channel: int, edges: Array) -> Array:
    """Return growth per metre (bins,) in mm or deg, and one standard deviation of chance (bins,), over all pieces."""
    weight, total = np.zeros(_BINS), np.zeros(_BINS)
    for piece in pieces:
        part = np.clip(np.digitize(_regressors(piece)[regressor], edges) - 1, 0, _BINS - 1).astype(np.int64)
        unit = unit_columns(piece.problem)[:, :, channel]
        rates = joint_rates(piece.whitener, piece.innovations, unit, part, _BINS)
        known = np.isfinite(rates.estimate) & (rates.allowed > 0.0)
        own = np.divide(1.0, rates.allowed**2, out=np.zeros(_BINS), where=known)
        weight += own
        total += own * np.where(known, rates.estimate, 0.0)
    scale = np.degrees(1.0) if channel == 2 else 1e3
    mean = np.divide(total, weight, out=np.full(_BINS, np.nan), where=weight > 0.0)
    chance = np.divide(1.0, np.sqrt(weight), out=np.full(_BINS, np.nan), where=weight > 0.0)
    return scale * np.stack((mean, chance))


def _points(axes: Axes, rates: Array, edges: Array, evaluation: ModelEvaluation, number: int, shift: float) -> None:
    mean, chance = rates
    centre = (edges[:-1] + edges[1:]) / 2.0 + shift * (edges[1] - edges[0])
    # a bin with hardly a metre would determine the scale of all
    firm = chance < 6.0 * np.nanmedian(chance)
    axes.errorbar(
        centre[firm], mean[firm], 2.0 * chance[firm], fmt=MARKERS[number % len(MARKERS)],
        color=COLOURS[number % len(COLOURS)], markersize=4, linewidth=1.1, zorder=2 + shift,
        label=f"{short_name(evaluation.name)} (bars: two standard deviations)",
    )  # fmt: skip


def _limit(row: Sequence[Axes], rates: Array) -> None:
    """Scale a row by its well-determined bins; triangles at the border represent bins beyond it.

    rates : (2, n) growth and standard deviation of all bins in the row
    """
    mean, chance = rates[:, np.isfinite(rates).all(axis=0)]
    if not len(mean):
        return
    well = chance <= 2.0 * np.median(chance)
    most = 1.3 * float((np.abs(mean) + 2.0 * chance)[well].max())
    if most > float((np.abs(mean) + 2.0 * chance).max()):
        return
    for axes in row:
        axes.set_ylim(-most, most)
        for bars in axes.containers:
            line = bars[0]
            x, y = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
            for sign, marker in ((1.0, "^"), (-1.0, "v")):
                beyond = sign * y > most
                axes.plot(
                    x[beyond], np.full(beyond.sum(), 0.96 * sign * most), marker, color=line.get_color(), markersize=6,
                    markerfacecolor="white",
                )  # fmt: skip
