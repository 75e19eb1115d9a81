"""Figures of a study: errors, NEES, innovations and residuals of models; candidates, dependences, the next drive."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.patches import Circle
from matplotlib.ticker import NullFormatter
from scipy.stats import chi2

from odomcorrupt.report.comparison import MOST, sequence_steps
from odomcorrupt.report.plots.figure import (
    BLACK,
    BLUE,
    COLOURS,
    GREEN,
    ORANGE,
    RED,
    SKY,
    drawn,
    model_panels,
    plain_logarithm,
    short_name,
    style_of,
)
from odomcorrupt.report.plots.paths import draw_paths
from odomcorrupt.study.design.plan import STEP_S, Plan
from odomcorrupt.study.estimate.windows import distance_windows
from odomcorrupt.study.validate.lack_of_fit import CHANNELS, interval_motion, joint_rates, unit_columns

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.select.candidates import Dependence
    from odomcorrupt.study.select.result import Learned, Step
    from odomcorrupt.study.validate.compare import Comparison, ModelEvaluation
    from odomcorrupt.study.validate.evaluation import Evaluation
    from odomcorrupt.study.validate.lack_of_fit import Failure


_BINS = 8
_PER_METRE = ("mm per m", "mm per m", "deg per m")


def draw_residuals(comparison: Comparison) -> Figure:
    """Draw growth of the error against every regressor, a row per channel, with its standard deviation by chance."""
    headed = all(piece.headed for evaluation in comparison.evaluations for piece in evaluation.pieces)
    count = 3 if headed else 2
    # all of up to three models, else the first and the last: more would overlap
    numbered = [(evaluation, i) for i, evaluation in enumerate(comparison.evaluations)]
    shown = numbered if len(numbered) <= 3 else [numbered[0], numbered[-1]]
    first = shown[0][0].pieces
    labels, edges = list(_regressors(first[0])), []
    for label in labels:  # equally wide bins over all but the most extreme values
        low, high = np.quantile(np.concatenate([_regressors(piece)[label] for piece in first]), [0.005, 0.995])
        edges.append(np.linspace(low, max(high, low + 1e-9), _BINS + 1))
    shown_rates: list[list[Array]] = [[] for _ in range(count)]
    with drawn(12.0, 1.0 + 2.1 * count) as figure:
        panels = figure.subplots(count, len(labels), sharey="row", sharex="col", squeeze=False)
        for which, (evaluation, number) in enumerate(shown):
            for d, label in enumerate(labels):
                for c in range(count):
                    rates = _rates(evaluation.pieces, label, c, edges[d])
                    shift = (which - (len(shown) - 1) / 2.0) * 0.22
                    mean, chance = rates
                    centre = (edges[d][:-1] + edges[d][1:]) / 2.0 + shift * (edges[d][1] - edges[d][0])
                    # a bin with hardly a metre would determine the scale of all
                    firm = chance < 6.0 * np.nanmedian(chance)
                    panels[c, d].errorbar(
                        centre[firm], mean[firm], 2.0 * chance[firm], linestyle="", markersize=4, linewidth=1.1,
                        zorder=2 + shift, label=f"{short_name(evaluation.name)} (bars: two standard deviations)",
                        **style_of(number),
                    )  # fmt: skip
                    shown_rates[c].append(rates)
        for c in range(count):
            _limit(panels[c], np.concatenate(shown_rates[c], axis=1))
            panels[c, 0].set_ylabel(f"{CHANNELS[c]} ({_PER_METRE[c]})")
            for axes in panels[c]:
                axes.axhline(0.0, color="0.3", linewidth=0.8, zorder=1)
                axes.tick_params(labelsize=8)
        for axes, label in zip(panels[-1], labels, strict=True):
            axes.set_xlabel(label)
        figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=2 * len(shown))
    return figure


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


def draw_errors(comparison: Comparison) -> Figure:
    """Draw measured errors against distance with each model's expectation, and the 10 s error of each step below.

    Vertical bars are 90 % intervals of the measured values; grey figures on top count the last model's windows.
    """
    with drawn(9.0, 5.9 + 0.28 * len(comparison.evaluations)) as figure:
        parts: Any = figure.subfigures(2, 1, height_ratios=(3.9, 1.1 + 0.28 * len(comparison.evaluations)))
        above, below = parts
        headed = all(piece.headed for evaluation in comparison.evaluations for piece in evaluation.pieces)
        wanted = (("position", "m"), ("yaw", "deg"))[: 2 if headed else 1]
        panels = above.subplots(1, len(wanted), squeeze=False)[0]
        for axes, (what, unit) in zip(panels, wanted, strict=True):
            count = len(comparison.evaluations)
            for i, evaluation in enumerate(comparison.evaluations):
                _curve(axes, evaluation, what, style_of(i), 1.025 ** (2 * i - count + 1))
            axes.set(xscale="log", yscale="log", xlabel="path driven (m)", title=f"{what} error, RMS ({unit})")
            axes.set_ylim(top=1.35 * axes.get_ylim()[1])
            last_m = 0.0
            for h in comparison.evaluations[-1].curve:  # the number of windows, for as many path lengths as fit
                if h.distance_m >= 1.7 * last_m:
                    last_m, at = h.distance_m, (h.distance_m, 1.0)
                    look = {"ha": "center", "va": "top", "fontsize": 7.5, "color": "0.4"}
                    axes.annotate(str(h.windows), at, xycoords=("data", "axes fraction"), **look)
            for axis in (axes.xaxis, axes.yaxis):
                plain_logarithm(axis)
        # one legend entry per kind of line, not per model
        panels[0].plot([], [], color="0.4", marker="|", markersize=9, linewidth=1.3, label="measured, 90 % interval")
        panels[0].plot([], [], color="0.4", linewidth=1.3, linestyle=(0, (4, 3)), label="expected by the model")
        above.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=3)
        _bars(below.subplots(), comparison)
    return figure


def rms_interval(measured: float, windows: int) -> tuple[float, float]:
    """Return the central 90 % interval of a root mean square measured over this many independent windows."""
    tail, square = (1.0 - 0.9) / 2.0, windows * measured**2
    return float(np.sqrt(square / chi2.isf(tail, windows))), float(np.sqrt(square / chi2.ppf(tail, windows)))


def _curve(axes: Axes, evaluation: ModelEvaluation, what: str, style: dict[str, str], shift: float) -> None:
    """Draw measured errors with their 90 % interval, and the model's expectation as a dashed line."""
    distance = np.array([h.distance_m for h in evaluation.curve])
    windows = [h.windows for h in evaluation.curve]
    if what == "yaw":
        measured, expected = np.degrees([[h.measured[2], h.expected[2]] for h in evaluation.curve]).reshape(-1, 2).T
    else:
        pairs = [[h.position_measured, h.position_expected] for h in evaluation.curve]
        measured, expected = np.array(pairs).reshape(-1, 2).T
    ends = np.array([rms_interval(m, n) for m, n in zip(measured, windows, strict=True)]).reshape(-1, 2)
    axes.vlines(distance * shift, *ends.T, color=style["color"], linewidth=1.1, alpha=0.8)
    axes.plot(distance * shift, measured, linewidth=1.3, markersize=4.5, label=short_name(evaluation.name), **style)  # type: ignore[arg-type]
    axes.plot(distance, expected, linewidth=1.3, linestyle=(0, (4, 3)), color=style["color"])


def _bars(axes: Axes, comparison: Comparison) -> None:
    # a recording of less than 10 s has no window
    steps = [step for step in sequence_steps(comparison) if isfinite(step[1])]
    if not steps:
        axes.set_axis_off()
        return
    names, millimetres = [short_name(name) for name, _, _ in steps], np.array([error for _, error, _ in steps]) * 1e3
    own = {evaluation.name: colour for evaluation, colour in zip(comparison.evaluations, COLOURS * 9, strict=False)}
    colours = ["0.65" if evaluation is None else own[evaluation.name] for _, _, evaluation in steps]
    bars = axes.barh(np.arange(len(names)), millimetres, color=colours, height=0.7)
    axes.bar_label(bars, labels=[f"{e:.1f} mm" for e in millimetres], padding=4, fontsize=9)
    axes.set_yticks(np.arange(len(names)), names)
    axes.invert_yaxis()
    axes.set(
        title="position error 10 s after starting at the truth, RMS (mm)",
        xlim=(0.0, 1.15 * max(float(millimetres.max()), 1e-9)),
    )


def draw_nees(comparison: Comparison) -> Figure:
    """Draw NEES per degree of freedom and 90 % coverage against path length."""
    with drawn(9.0, 4.2) as figure:
        left, right = figure.subplots(1, 2)
        count = len(comparison.evaluations)
        for i, evaluation in enumerate(comparison.evaluations):
            style: dict[str, Any] = style_of(i) | {"markersize": 5.5, "linewidth": 1.2}
            # shifted sideways, so that the bars do not overlap
            shift = min(1.06, 1.3 ** (1.0 / count)) ** (2 * i - count + 1)
            distance = shift * np.array([h.distance_m for h in evaluation.horizons])
            low, high = np.array([h.nees_bounds for h in evaluation.horizons]).reshape(-1, 2).T
            left.vlines(distance, low, high, color=style["color"], linewidth=7 if count <= 3 else 4, alpha=0.25)
            style["label"] = short_name(evaluation.name)
            left.plot(distance, [h.nees for h in evaluation.horizons], **style)
            inside = [100.0 * float(np.nanmean(h.coverage_90)) for h in evaluation.horizons]
            right.plot(distance, inside, **style)
        left.axhline(1.0, color=BLACK, linewidth=1.0)
        left.set(
            yscale="log",
            title="NEES per degree of freedom\n(1: errors are as large as expected; bars: 95 % range by chance)",
        )
        plain_logarithm(left.yaxis)
        right.axhline(90.0, color=BLACK, linewidth=1.0)
        right.set(
            ylim=(0.0, 102.0), title="errors inside the model's 90 % interval (%)\n(mean over along, across, yaw)"
        )
        distances = [h.distance_m for h in max((j.horizons for j in comparison.evaluations), key=len)]
        for axes in (left, right):
            axes.set(xscale="log", xlabel="path driven (m)")
            axes.set_xticks(distances, [f"{d:g}" for d in distances])
            axes.xaxis.set_minor_formatter(NullFormatter())
        figure.legend(*left.get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return figure


def draw_pit(comparison: Comparison) -> Figure:
    """Draw the difference between the distribution of innovations and the predicted one, with its 95 % band."""
    channels = list(comparison.evaluations[0].pits)
    with drawn(9.0, 3.6) as figure:
        panels = figure.subplots(1, len(channels), sharey=True, squeeze=False)[0]
        for axes, channel in zip(panels, channels, strict=True):
            band = comparison.evaluations[0].pits[channel]
            axes.fill_between(band.at, band.low, band.high, color="0.85", label="95 % of right models stay inside")
            for evaluation, colour in zip(comparison.evaluations, COLOURS, strict=False):
                pit = evaluation.pits[channel]
                label = short_name(evaluation.name)
                axes.step(pit.at, pit.difference, where="mid", color=colour, linewidth=1.4, label=label)
            axes.axhline(0.0, color=BLACK, linewidth=0.8)
            axes.set(title=channel, xlabel="predicted probability", xlim=(0.0, 1.0))
        panels[0].set_ylabel("measured minus predicted")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return figure


_PHASES = 5
_LENGTHS_M = (0.5, 1.0, 2.0, 5.0, 10.0)


def draw_failure_map(comparison: Comparison) -> Figure:
    """Draw a panel for each model."""
    metres = max(float(piece.interval_metres.sum()) for piece in comparison.evaluations[0].pieces)
    # short relative to the drive, and long enough for errors to accumulate
    length_m = max((length for length in _LENGTHS_M if length <= metres / 12), default=_LENGTHS_M[0])
    with model_panels(comparison.evaluations, 4.4, 6.0, 0.9) as (figure, panels):
        lines = [_panel(axes, evaluation, length_m) for axes, evaluation in panels]
        bar = figure.colorbar(
            lines[-1], ax=[axes for axes, _ in panels], location="bottom", shrink=0.6, aspect=40, extend="max",
            label=f"squared error over {length_m:g} m of path, divided by the expected (1: right)",
        )  # fmt: skip
        bar.ax.axvline(1.0, color=BLACK, linewidth=1.2)
    return figure


def _panel(axes: Axes, evaluation: ModelEvaluation, length_m: float) -> LineCollection:
    piece = max(evaluation.pieces, key=lambda p: float(p.interval_metres.sum()))
    xy = piece.problem.intervals.truth_xyt[:, :2]
    segments = np.stack((xy[:-1], xy[1:]), axis=1)
    ratio = _local_ratio(piece, length_m)
    linked = piece.problem.intervals.linked[1:]
    # largest errors on top, where a path crosses itself
    order = np.argsort(ratio[:-1][linked])
    lines = LineCollection(
        list(segments[linked][order]), cmap="cividis_r", linewidths=2.6, capstyle="round", rasterized=True
    )
    lines.set_array(ratio[:-1][linked][order])
    # ratio of measured to expected squared error with the darkest colour
    lines.set_clim(0.0, 4.0)
    axes.add_collection(lines)
    axes.plot(*xy[0], "s", color=BLACK, markersize=7, zorder=4)
    several = len(evaluation.pieces) > 1
    for number, failure in enumerate(evaluation.failures[:MOST], start=1):
        if not several or failure.recording == piece.recording.name:
            _mark(axes, piece, failure, number)
    axes.autoscale_view()
    axes.set_aspect("equal", adjustable="box")
    axes.set(xlabel="x (m)", ylabel="y (m)", title=short_name(evaluation.name))
    return lines


def _mark(axes: Axes, piece: Evaluation, failure: Failure, number: int) -> None:
    """Write the number of a lack of fit at its place; motions and drifts have none."""
    intervals = piece.problem.intervals
    if failure.kind == "place" and failure.place is not None:
        x, y, radius = failure.place
        axes.add_patch(
            Circle((x, y), radius, fill=False, edgecolor=RED, linewidth=1.6, linestyle=(0, (4, 2)), zorder=5)
        )
    elif failure.kind == "time" and failure.span_s is not None:
        during = (intervals.end_s > failure.span_s[0]) & (intervals.start_s < failure.span_s[1])
        part = intervals.truth_xyt[during]
        axes.plot(part[:, 0], part[:, 1], color=RED, linewidth=0.9, linestyle=(0, (2, 2)), zorder=5)
        x, y = map(float, part[len(part) // 2, :2])
    elif failure.kind == "moment" and failure.place is not None:
        x, y, _ = failure.place
        axes.plot(x, y, "X", color=RED, markeredgecolor="white", markersize=9, zorder=6)
    else:
        return
    axes.annotate(
        str(number), (x, y), xytext=(6, 6), textcoords="offset points", fontsize=10, fontweight="bold", color=RED,
        zorder=7,
        bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
    )  # fmt: skip


def _local_ratio(piece: Evaluation, length_m: float) -> Array:
    """Return, for each interval (K,), the mean NEES per degree of freedom of windows that cover it."""
    intervals = piece.problem.intervals
    middle = (intervals.start_s + intervals.end_s) / 2.0
    total, count = np.zeros(len(intervals)), np.zeros(len(intervals))
    for phase in np.arange(_PHASES) / _PHASES:
        windows = distance_windows(piece.left, length_m, phase)
        if not len(windows):
            continue
        errors = piece.errors_of(windows)
        nees = errors.nees / errors.error.shape[1]
        at = np.searchsorted(windows.end_s, middle)
        covered = (at < len(nees)) & (middle >= windows.start_s[0])
        total[covered] += nees[at[covered]]
        count[covered] += 1.0
    return np.divide(total, count, out=np.ones(len(intervals)), where=count > 0.0)


class Picture(NamedTuple):
    """A figure's heading, its description, and the function that draws it."""

    title: str
    caption: str
    draw: Callable[[Comparison], Figure]


PICTURES: Mapping[str, Picture] = {
    "path": Picture(
        "The path",
        "The truth corrupted by each model a hundred times, and the odometry as it was measured, all started at the "
        "truth. Under a right model the measured path looks like one of the runs. Square: start; discs: ends.",
        draw_paths,
    ),
    "error": Picture(
        "Error against distance",
        "Errors after a length of path, windows not overlapping and each started at the truth. Dashed: what the model "
        "expects. Bars: 90 % interval of the measured value; grey figures: how many windows it is measured on.",
        draw_errors,
    ),
    "nees": Picture(
        "NEES by length of path",
        "Rising with distance: a cause is missing, or the noise is correlated in time. Flat but not 1: the noise has "
        "the wrong size. Falling: noise of the truth attributed to the motion.",
        draw_nees,
    ),
    "residuals": Picture(
        "What the error depends on",
        "Growth of the error per metre driven, odometry minus truth, in parts of the drive. Bars that miss zero all "
        "along a curve show on what the error depends; of a right model one in twenty does so by chance.",
        draw_residuals,
    ),
    "map": Picture(
        "Where it fails",
        "The truth's path; dark where errors are larger than expected. Numbers are those of the sentences above: "
        "circles are places, dotted lines stretches of time, crosses moments.",
        draw_failure_map,
    ),
    "pit": Picture(
        "Distribution of the errors",
        "Fraction of the whitened innovations below each predicted quantile, minus the predicted fraction. Outside the "
        "band: S-shaped where the noise has the wrong size, one bump where there is a bias.",
        draw_pit,
    ),
}


_MOST = 7
_STEPS = 6
_GREY = "0.78"
_TICKS = ((0.0, 3.0, 10.0, 100.0, 1e3, 1e4, 1e5), ("0", "3", "10", "100", "1000", "10 000", "100 000"))
_LINEAR = 3.0
"""Limit of the axis's linear part, nats; smaller values are no evidence."""


def draw_candidates(learned: Learned) -> Figure:
    """Draw the best candidates of the first steps and of the last one, on one scale."""
    steps = list(enumerate(learned.rounds, start=1))
    shown = steps if len(steps) <= _STEPS else [*steps[: _STEPS - 1], steps[-1]]
    columns = min(len(shown), 2)
    rows = -(-len(shown) // columns)
    most = max((max(c.evidence, 0.0) for _, step in shown for c in step.candidates), default=1.0)
    with drawn(11.0 if columns == 2 else 8.0, 0.5 + 2.6 * rows) as figure:
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes, (number, step) in zip(panels, shown, strict=False):
            left_out = f" (steps {_STEPS} to {number - 1} not drawn)" if number > len(shown) else ""
            _ranking(axes, f"step {number} of {len(steps)}{left_out}", step)
            axes.set_xscale("symlog", linthresh=_LINEAR, linscale=0.4)
            axes.set_xticks(*_TICKS)
            axes.set_xlim(0.0, 12.0 * max(most, 10.0))
        for axes in panels[len(shown) :]:
            axes.set_axis_off()
    return figure


def _ranking(axes: Axes, title: str, step: Step) -> None:
    ranked = sorted(step.candidates, key=lambda c: (not c.refused, max(c.evidence, 0.0)), reverse=True)[:_MOST]
    nats, looks = [max(c.evidence, 0.0) for c in ranked], []
    for candidate, gain in zip(ranked, nats, strict=True):
        if candidate.score.effect.name == step.added:
            looks.append((BLUE, f"{gain:.0f}"))
        elif candidate.score.effect.name in step.alternatives:
            looks.append((SKY, f"{gain:.0f}, not separable from it"))
        else:
            looks.append((_GREY, candidate.refused or f"{gain:.0f}, others explain it better"))
    colours, labels = zip(*looks, strict=True)
    places = np.arange(len(ranked))
    bars = axes.barh(places, nats, color=colours, height=0.72)
    axes.bar_label(bars, labels=labels, padding=4, fontsize=8)
    axes.set_yticks(places, [c.score.effect.name for c in ranked])
    axes.invert_yaxis()
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("evidence (nats)")
    outcome = f"added {step.name}" if step.name else "nothing more to add"
    axes.set_title(f"{title}: {outcome}")


_REGRESSORS = {
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
    shown = unknown[:3]
    with drawn(11.0, 3.6) as figure:
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
        label, factor = _REGRESSORS.get(one.regressor, (one.regressor, 1.0))
        x, curve, error = one.centres * factor, one.curve, one.curve_error
    curve, error = scale * curve, scale * error
    axes.axhline(0.0, color="0.3", linewidth=0.8)
    axes.fill_between(x, curve - 2.0 * error, curve + 2.0 * error, color=ORANGE, alpha=0.28, linewidth=0)
    axes.plot(x, curve, color="#A06000", linewidth=1.8, marker="o" if len(x) < 20 else "", markersize=4)
    axes.set(xlabel=label, ylabel=f"truth minus odometry ({unit})")


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


def draw_plan(plan: Plan) -> Figure:
    """Draw the path of a robot that follows the plan, and its commands in the first two minutes."""
    path = plan.path
    shown = slice(0, round(120.0 / STEP_S))
    times_s = np.arange(len(plan.v_mps))[shown] * STEP_S
    with drawn(11.0, 3.6) as figure:
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
        above, below = parts[1].subplots(2, 1, sharex=True)
        above.plot(times_s, plan.v_mps[shown], color=BLUE, linewidth=1.3)
        above.set(ylabel="m/s", title="commands, the first two minutes")
        below.plot(times_s, np.degrees(plan.omega_radps[shown]), color=ORANGE, linewidth=1.3)
        below.set(ylabel="deg/s", xlabel="s")
        for axes in (above, below):
            axes.axhline(0.0, color="0.6", linewidth=0.7, zorder=0)
    return figure
