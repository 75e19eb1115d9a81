"""Framework of the self-contained HTML pages: head, style, script and common elements."""

from __future__ import annotations

import base64
from hashlib import sha256
from html import escape
from importlib.resources import files
from typing import TYPE_CHECKING

from odomcorrupt import __version__
from odomcorrupt.report.plots.figure import rendered

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

_HEAVY = 600_000
"""Size of a vector figure, bytes, above which it is rasterised if that is smaller; keeps the page below 3 MB."""
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
"""Content security policy: the browser may load nothing but the page itself."""
_STYLE, SCRIPT = (
    files("odomcorrupt.report.html").joinpath(name).read_text(encoding="utf-8") for name in ("page.css", "explorer.js")
)


def page(title: str, body: Sequence[str], legend: str) -> str:
    """Return a whole page with the given elements in its body, and a legend below them.

    The browser may run no script but that of the explorer.
    """
    allowed = f"sha256-{base64.b64encode(sha256(SCRIPT.encode()).digest()).decode()}"
    elements = "\n".join(body)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{_POLICY}; script-src '{allowed}'">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)}</title>
<link rel="icon" href="data:,">
<style>
{_STYLE}</style>
</head>
<body>
{elements}
<p class="quiet">{escape(legend)} Made by odomcorrupt {__version__}.</p>
</body>
</html>
"""


def prose(text: str) -> str:
    """Return a sentence as HTML; text between backticks is code."""
    parts = escape(text).split("`")
    if len(parts) % 2 == 0:
        return escape(text)
    return "".join(f"<code>{part}</code>" if i % 2 else part for i, part in enumerate(parts))


def picture(name: str, title: str, caption: str, figure: Figure) -> str:
    """Return a heading and a figure, with a name for links."""
    return (
        f'<h2>{escape(title)}</h2><figure id="{name}"><figcaption>{prose(caption)}</figcaption>'
        f'<img src="{_embedded(figure)}" alt="{escape(title)}: {escape(caption)}"></figure>'
    )


def table(heads: Sequence[str], rows: Sequence[Sequence[str]], caption: str = "") -> str:
    """Return a table; a cell that begins with ! is highlighted."""
    top = "".join(f'<th scope="col">{escape(head)}</th>' for head in heads)
    lines = [
        "".join(f'<td class="off">{c[1:]}</td>' if c.startswith("!") else f"<td>{c}</td>" for c in row) for row in rows
    ]
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    title = f"<caption>{escape(caption)}</caption>" if caption else ""
    return f'<div class="scroll"><table>{title}<thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


def _embedded(figure: Figure) -> str:
    """Return a figure as a data URL: vectors, or pixels if the vectors are too large."""
    kind, data = "svg+xml", rendered(figure, "svg")
    # a figure with embedded pixels would not become smaller
    if len(data) > _HEAVY and b"data:image/png" not in data:
        pixels = rendered(figure, "png")
        kind, data = ("png", pixels) if len(pixels) < len(data) else (kind, data)
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
