"""The picture of the candidates: how many nats each would gain, step by step, and which were refused."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.report.plots.figure import BLUE, SKY, drawing, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from odomcorrupt.study.select.candidates import Candidate
    from odomcorrupt.study.select.stepwise import Learned, Step

__all__ = ["draw_candidates", "evidence_nats"]

_MOST = 7
_STEPS = 6
_GREY = "0.78"
_TICKS = ((0.0, 3.0, 10.0, 100.0, 1e3, 1e4, 1e5), ("0", "3", "10", "100", "1000", "10 000", "100 000"))
_LINEAR = 3.0
"""Below this many nats the axis is linear: less than that is no evidence."""


def evidence_nats(candidate: Candidate) -> float:
    """Return the nats of a refit, or half the score statistic where there was none; never less than zero."""
    score = candidate.score
    plain = candidate.gain if candidate.fit is not None else 0.5 * score.statistic / score.inflation
    return max(float(plain), 0.0) if np.isfinite(plain) else 0.0


def draw_candidates(learned: Learned) -> Figure:
    """Draw the best candidates of the first steps and of the last one, on one scale."""
    steps = list(enumerate(learned.rounds, start=1))
    shown = steps if len(steps) <= _STEPS else [*steps[: _STEPS - 1], steps[-1]]
    columns = min(len(shown), 2)
    rows = -(-len(shown) // columns)
    most = max((evidence_nats(c) for _, look in shown for c in look.candidates), default=1.0)
    with drawing():
        figure = new_figure(11.0 if columns == 2 else 8.0, 0.5 + 2.6 * rows)
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes, (number, look) in zip(panels, shown, strict=False):
            left_out = f" (steps {_STEPS} to {number - 1} not drawn)" if number > len(shown) else ""
            _bars(axes, f"step {number} of {len(steps)}{left_out}", look)
            axes.set_xscale("symlog", linthresh=_LINEAR, linscale=0.4)
            axes.set_xticks(*_TICKS)
            axes.set_xlim(0.0, 12.0 * max(most, 10.0))
        for axes in panels[len(shown) :]:
            axes.set_axis_off()
    return figure


def _bars(axes: Axes, title: str, look: Step) -> None:
    ranked = sorted(look.candidates, key=lambda c: (not c.refused, evidence_nats(c)), reverse=True)[:_MOST]
    nats = [evidence_nats(c) for c in ranked]
    colours = [_colour(c, look) for c in ranked]
    places = np.arange(len(ranked))
    bars = axes.barh(places, nats, color=colours, height=0.72)
    labels = [_label(c, n, look) for c, n in zip(ranked, nats, strict=True)]
    axes.bar_label(bars, labels=labels, padding=4, fontsize=8)
    axes.set_yticks(places, [c.score.effect.name for c in ranked])
    axes.invert_yaxis()
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("evidence (nats)")
    outcome = f"added {look.added}" if look.added else "nothing more to add"
    axes.set_title(f"{title}: {outcome}")


def _colour(candidate: Candidate, look: Step) -> str:
    name = candidate.score.effect.name
    if name == look.added:
        return BLUE
    return SKY if name in look.alternatives else _GREY


def _label(candidate: Candidate, nats: float, look: Step) -> str:
    name = candidate.score.effect.name
    if name == look.added:
        return f"{nats:.0f}"
    if name in look.alternatives:
        return f"{nats:.0f}, cannot be told from it"
    return candidate.refused or f"{nats:.0f}, others explain it better"
