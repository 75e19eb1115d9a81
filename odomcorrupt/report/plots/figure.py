"""What every picture shares: colours that everybody tells apart, quiet axes, and files that are the same every time."""

from __future__ import annotations

from contextlib import contextmanager
from io import BytesIO
from typing import TYPE_CHECKING, Any, TypeVar

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

__all__ = [
    "BLACK",
    "BLUE",
    "GREEN",
    "ORANGE",
    "RED",
    "SKY",
    "YELLOW",
    "drawing",
    "new_figure",
    "remove_unused",
    "rendered",
    "short_name",
    "shown_models",
]

BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
YELLOW, BLUE, RED, PURPLE = "#F0E442", "#0072B2", "#D55E00", "#CC79A7"
"""Okabe & Ito's palette; RED is their vermilion."""

_STYLE: dict[Any, Any] = {
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "legend.frameon": False,
    "svg.hashsalt": "odomcorrupt",
}


_MOST_PANELS = 4
_DPI = 150
_T = TypeVar("_T")


@contextmanager
def drawing() -> Iterator[None]:
    """Set the style while a picture is drawn."""
    with mpl.rc_context(_STYLE):
        yield


def new_figure(width_in: float, height_in: float) -> Figure:
    """Return an empty figure, with no window or global state behind it."""
    return Figure(figsize=(width_in, height_in), layout="constrained")


def rendered(figure: Figure, kind: str) -> bytes:
    """Return a figure as a file's bytes; kind is "png", "svg" or "pdf". No clock and no version goes in."""
    nothing: dict[str, dict[str, None]] = {
        "png": {"Software": None},
        "svg": {"Date": None, "Creator": None},
        "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    }
    out = BytesIO()
    with drawing():
        engine = figure.get_layout_engine()
        if engine is not None:
            # savefig would lay it out twice, and draw it once more for that
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


def short_name(name: str, most: int = 34) -> str:
    """Return a name as long as a legend can hold; of a longer one the middle is left out."""
    if len(name) <= most:
        return name
    half = (most - 1) // 2
    return f"{name[:half]}…{name[-half:]}"


def shown_models(models: Sequence[_T]) -> list[_T]:
    """Return the models that get a panel each: all of four, else the first, which the others improve, and the last."""
    if len(models) <= _MOST_PANELS:
        return list(models)
    return [models[0], *models[1 - _MOST_PANELS :]]


def remove_unused(panels: Any, used: int) -> None:
    """Remove the panels (rows, columns) behind the used ones; what stands above them gets the tick labels they had."""
    columns = panels.shape[1]
    for number, axes in enumerate(panels.flat):
        if number >= used:
            axes.remove()
        elif number + columns >= used:
            axes.tick_params(labelbottom=True)
