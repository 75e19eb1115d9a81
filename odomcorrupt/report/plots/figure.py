"""Common style of all figures: a colour-blind safe palette, light axes, and reproducible files."""

from __future__ import annotations

from contextlib import contextmanager
from io import BytesIO
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import matplotlib.style
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

    from odomcorrupt.study.validate.compare import ModelEvaluation

BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
BLUE, RED, PURPLE = "#0072B2", "#D55E00", "#CC79A7"
"""Okabe & Ito's palette; RED is their vermilion."""
TRUTH, RUNS, LOST = BLACK, BLUE, RED
"""Of all figures: the truth, or clean odometry, which is the truth of its runs; runs and estimates; what is lost."""
COLOURS, MARKERS = (RED, BLUE, GREEN, ORANGE, PURPLE, SKY), ("o", "s", "^", "D", "v", "P")
"""Colour and marker of each model; markers also distinguish them in grey print."""

_OURS: dict[Any, Any] = {
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": "0.92",
    "figure.titlesize": 11,
    "legend.fontsize": 9,
    "legend.frameon": False,
    "svg.hashsalt": "odomcorrupt",
}
_STYLES: list[str | dict[str, Any]] = ["default", _OURS]
"""Matplotlib's own style and ours, not that of a matplotlibrc in this folder."""


_LONGEST = 34
"""Longest model name in a legend, characters."""
_DPI = 150


@contextmanager
def drawn(width_in: float, height_in: float, layout: Any = "constrained") -> Iterator[Figure]:
    """Yield an empty figure while the style is set; it belongs to no window and no global state."""
    with mpl.style.context(_STYLES):
        yield Figure(figsize=(width_in, height_in), layout=layout)


def style_of(number: int) -> dict[str, str]:
    """Return colour and marker of a model by its number."""
    return {"color": COLOURS[number % len(COLOURS)], "marker": MARKERS[number % len(MARKERS)]}


def rendered(figure: Figure, kind: str) -> bytes:
    """Return a figure as a file's bytes, without time stamp and version; kind is "png", "svg" or "pdf"."""
    nothing: dict[str, dict[str, None]] = {
        "png": {"Software": None},
        "svg": {"Date": None, "Creator": None},
        "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    }
    out = BytesIO()
    with mpl.style.context(_STYLES):
        engine = figure.get_layout_engine()
        if engine is not None:
            # savefig would compute the layout twice, drawing the figure once more for that
            engine.execute(figure)
            figure.set_layout_engine("none")
        figure.dpi = _DPI
        if kind == "svg":
            svg: Any = FigureCanvasSVG(figure)
            svg.print_svg(out, metadata=nothing[kind])
        elif kind == "png":
            png: Any = FigureCanvasAgg(figure)
            png.print_png(out, metadata=nothing[kind])
        else:
            figure.savefig(out, format=kind, dpi=_DPI, metadata=nothing[kind])
    return out.getvalue()


def short_name(name: str) -> str:
    """Return a name that fits a legend; the middle of a longer one is left out."""
    return name if len(name) <= _LONGEST else f"{name[: _LONGEST // 2 - 1]}…{name[1 - _LONGEST // 2 :]}"


def plain_logarithm(axis: Axis) -> None:
    """Label a logarithmic axis at 1, 2 and 5 times powers of ten, with plain numbers."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


@contextmanager
def model_panels(
    models: Sequence[ModelEvaluation], pair_in: float, single_in: float, more_in: float
) -> Iterator[tuple[Figure, list[tuple[Axes, ModelEvaluation]]]]:
    """Yield a figure with a panel for each of up to four models; for more, of the first and the last.

    models : models to draw
    pair_in, single_in : height of a row of two panels, and of a panel alone, inches
    more_in : height of the legend, inches
    """
    over = max(len(models) - 4, 0)
    shown = [models[0], *models[1 + over :]]
    columns = min(len(shown), 2)
    rows = -(-len(shown) // columns)
    with drawn(9.0, more_in + (pair_in if columns == 2 else single_in) * rows, "compressed") as figure:
        panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
        for axes in panels[len(shown) :]:
            axes.remove()
        for axes in panels[: len(shown)]:
            axes.tick_params(labelbottom=True, labelleft=True)
        if over:
            names = ", ".join(short_name(one.name) for one in models[1 : 1 + over])
            figure.supxlabel(f"not drawn: {names}", x=0.01, ha="left", fontsize=9)
        yield figure, list(zip(panels, shown, strict=False))
