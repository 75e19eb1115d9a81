"""A page of HTML in one file: head, style, script and the elements that all pages share."""

from __future__ import annotations

import base64
from html import escape
from typing import TYPE_CHECKING

from odomcorrupt.report.plots.figure import rendered

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

__all__ = ["CSS", "embedded", "page", "picture", "prose", "table"]

CSS = """
:root { color-scheme: light dark; --ink: #111; --quiet: #555; --paper: #fff; --line: #ddd; --strong-line: #999;
  --panel: #f4f7fa; --panel-line: #d5e0ea; --off: #A33F00; --accent: #0072B2; --alarm: #D55E00; --bar: #777;
  --code: #1d2733; --mark: #F0B400; --measured: #666;
  --model-0: #D55E00; --model-1: #0072B2; --model-2: #009E73; --model-3: #C98A00; --model-4: #CC79A7;
  --model-5: #3A9BD9; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e8eaed; --quiet: #a5adb6; --paper: #14181d; --line: #333b44; --strong-line: #66707b;
    --panel: #1b2229; --panel-line: #33414e; --off: #ff9d63; --accent: #4aa8e0; --alarm: #ff8a4a; --bar: #8d97a1;
    --code: #0c1014; --mark: #c79a00; --measured: #b9c0c7;
    --model-0: #ff8a4a; --model-1: #4aa8e0; --model-2: #2fc79b; --model-3: #f0b840; --model-4: #e3a0c6;
    --model-5: #8ccbf2; }
  /* pictures are drawn on white */
  figure img { background: #fff; border-radius: .3rem; padding: .3rem; filter: brightness(.9); }
}
* { box-sizing: border-box; }
body { font: 16px/1.5 system-ui, "Segoe UI", "DejaVu Sans", Arial, sans-serif; color: var(--ink);
  background: var(--paper); max-width: 72rem; margin: 0 auto; padding: 1.5rem 1.25rem 4rem; overflow-wrap: anywhere; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .25rem; }
h2 { font-size: 1.25rem; margin: 2.2rem 0 .5rem; }
h3 { font-size: 1.05rem; margin: 1.4rem 0 .3rem; }
p { margin: .4rem 0; }
.quiet { color: var(--quiet); font-size: .9rem; }
.verdict { border-left: .4rem solid var(--accent); padding: .1rem 0 .1rem .8rem; font-weight: 600; }
.verdict.rejected { border-left-color: var(--alarm); }
ol { margin: .3rem 0 .8rem; padding-left: 2rem; }
li { margin: .15rem 0; }
figure { margin: 0; }
figure img { display: block; width: 100%; height: auto; }
figcaption { color: var(--quiet); font-size: .92rem; max-width: 52rem; margin: 0 0 .6rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .8rem; font-variant-numeric: tabular-nums; margin: .4rem 0; }
caption { text-align: left; font-weight: 600; padding: .2rem 0; }
th, td { padding: .22rem .5rem; text-align: right; border-bottom: 1px solid var(--line); white-space: nowrap; }
th:first-child, td:first-child { text-align: left; padding-left: 0; }
thead th { border-bottom: 2px solid var(--strong-line); vertical-align: bottom; }
td.off { font-weight: 700; color: var(--off); }
.bar { display: block; height: .7em; background: var(--bar); }
.cards { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(19rem, 100%), 1fr)); gap: .9rem;
  margin: .8rem 0; }
.card { border: 1px solid var(--line); border-top: .3rem solid var(--accent); border-radius: .3rem;
  padding: .7rem .9rem; min-width: 0; }
.card.noise { border-top-color: var(--bar); }
.card.unknown { border-top-color: var(--mark); }
.card h3 { margin: 0; font-size: 1.1rem; }
.card .value { font-size: 1.15rem; font-weight: 600; font-variant-numeric: tabular-nums; margin: .35rem 0 0; }
.card p { margin: .25rem 0; font-size: .92rem; }
.meter { display: block; height: .5rem; background: var(--line); border-radius: .25rem; margin: .3rem 0; }
.meter span { display: block; height: 100%; background: var(--accent); border-radius: .25rem; }
.next { background: var(--panel); border: 1px solid var(--panel-line); border-radius: .3rem; padding: .6rem 1rem; }
.next li { margin: .35rem 0; }
pre { background: var(--code); color: #f1f5f9; padding: .6rem .8rem; border-radius: .3rem; white-space: pre-wrap;
  font: .85rem/1.45 ui-monospace, "DejaVu Sans Mono", monospace; margin: .5rem 0; }
code { font: .9em ui-monospace, "DejaVu Sans Mono", monospace; }
[hidden] { display: none !important; }
#explorer { position: relative; }
.controls { display: flex; flex-wrap: wrap; gap: .4rem .8rem; }
.group { min-width: 0; }
.controls fieldset { border: 1px solid var(--line); border-radius: .3rem; padding: .1rem .7rem .35rem; margin: 0;
  display: flex; flex-wrap: wrap; gap: .1rem 1rem; min-width: 0; }
.controls legend { font-size: .8rem; color: var(--quiet); padding: 0 .3rem; }
.controls label { display: inline-flex; align-items: center; gap: .35rem; font-size: .9rem; min-height: 1.9rem;
  max-width: 100%; }
.controls select, .panel select, .buttons button { font: inherit; font-size: .9rem; color: var(--ink); max-width: 100%;
  background: var(--paper); border: 1px solid var(--strong-line); border-radius: .25rem; min-height: 1.9rem;
  min-width: 0; }
.buttons button { min-width: 2.2rem; }
.swatch { width: .9rem; height: .9rem; border-radius: .2rem; flex: none; }
.panel-head { display: flex; flex-wrap: wrap; justify-content: space-between; align-items: end; gap: .3rem; }
.panel h3 { margin: 1rem 0 .2rem; }
.buttons { display: flex; gap: .3rem; align-items: center; max-width: 100%; }
.buttons label { display: inline-flex; align-items: center; gap: .35rem; font-size: .9rem; max-width: 100%; }
.panel svg { display: block; width: 100%; border: 1px solid var(--line); border-radius: .3rem; overflow: hidden; }
.panel svg:focus { outline: 2px solid var(--accent); }
#plane { cursor: grab; touch-action: pan-y; }
.panel text { font-size: 11px; fill: var(--quiet); }
.panel path { fill: none; vector-effect: non-scaling-stroke; stroke-linejoin: round; stroke-linecap: round; }
.grid { stroke: var(--line); stroke-width: 1; }
path.truth { stroke: var(--ink); stroke-width: 1.8; }
path.odometry { stroke: var(--measured); stroke-width: 1.6; stroke-dasharray: 5 4; }
path.corrected { stroke-width: 1.8; }
path.run { stroke-width: .8; opacity: .4; }
path.mark { stroke: var(--mark); stroke-width: 11; opacity: .75; }
path.curve { stroke-width: 1.7; }
path.expected { stroke-width: 1.3; stroke-dasharray: 6 4; }
.bar-of { stroke-width: 1.6; }
.span { fill: var(--mark); opacity: .35; }
.start { fill: var(--ink); }
.here { fill: none; stroke: var(--ink); stroke-width: 2; }
.place { fill: none; stroke: var(--mark); stroke-width: 2.5; stroke-dasharray: 6 4; }
.cursor { stroke: var(--ink); stroke-width: 1; }
.tip { position: absolute; z-index: 2; pointer-events: none; background: var(--panel); color: var(--ink);
  border: 1px solid var(--strong-line); border-radius: .3rem; padding: .35rem .6rem; font-size: .82rem;
  max-width: min(24rem, 95%); font-variant-numeric: tabular-nums; }
[role="button"] { cursor: pointer; border-radius: .2rem; padding: .1rem .3rem; }
[role="button"]:hover, [role="button"]:focus { background: var(--panel); }
[role="button"][aria-pressed="true"] { background: var(--panel); box-shadow: inset .25rem 0 var(--mark); }
@media (max-width: 40rem) {
  body { padding: 1rem .8rem 3rem; }
  h1 { font-size: 1.35rem; }
  ol { padding-left: 1.4rem; }
}
@page { margin: 14mm; }
@media print {
  :root { color-scheme: light; }
  body { font-size: 10.5pt; max-width: none; padding: 0; color: #111; background: #fff; }
  h2, h3 { break-after: avoid; }
  figure, table, .verdict, .card, li { break-inside: avoid; }
  .scroll { overflow: visible; }
  #explorer { display: none; }
  table { font-size: 7.6pt; }
  th, td { padding: .15rem .35rem; }
  .bar, .verdict, .card, .meter, .meter span, pre { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
  figure img { max-height: 21cm; width: auto; max-width: 100%; }
}
"""


_HEAVY = 600_000
"""A drawing of more bytes than this is taken as pixels, where these are fewer: the page stays below 3 MB."""
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
"""What the browser is allowed to load: nothing but the page itself."""


def page(title: str, body: Sequence[str], *, script_hash: str = "") -> str:
    """Return a whole page around elements that stand below each other.

    script_hash : of the one inline script that the browser may run; "" where there is none
    """
    policy = f"{_POLICY}; script-src '{script_hash}'" if script_hash else _POLICY
    return "\n".join(
        [
            "<!DOCTYPE html>",
            '<html lang="en">',
            "<head>",
            '<meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{escape(title)}</title>",
            '<link rel="icon" href="data:,">',
            f"<style>{CSS}</style>",
            "</head>",
            "<body>",
            *body,
            "</body>",
            "</html>",
            "",
        ]
    )


def prose(text: str) -> str:
    """Return a sentence as HTML; what stands between backticks is code."""
    parts = escape(text).split("`")
    if len(parts) % 2 == 0:
        return escape(text)
    return "".join(f"<code>{part}</code>" if i % 2 else part for i, part in enumerate(parts))


def picture(name: str, title: str, caption: str, figure: Figure) -> str:
    """Return a heading with a figure below it, named for links."""
    return (
        f'<h2>{escape(title)}</h2><figure id="{name}"><figcaption>{prose(caption)}</figcaption>'
        f'<img src="{embedded(figure)}" alt="{escape(title)}: {escape(caption)}"></figure>'
    )


def table(heads: Sequence[str], rows: Sequence[Sequence[str]], caption: str = "") -> str:
    """Return a table; a cell that begins with ! is one to look at."""
    top = "".join(f'<th scope="col">{escape(head)}</th>' for head in heads)
    lines = [
        "".join(f'<td class="off">{c[1:]}</td>' if c.startswith("!") else f"<td>{c}</td>" for c in row) for row in rows
    ]
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    title = f"<caption>{escape(caption)}</caption>" if caption else ""
    return f'<div class="scroll"><table>{title}<thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


def embedded(figure: Figure) -> str:
    """Return a drawing as an address that carries all of it, as vectors where these are not too many."""
    kind, data = "svg+xml", rendered(figure, "svg")
    # what is heavy because of pixels of its own would not be lighter
    if len(data) > _HEAVY and b"data:image/png" not in data:
        pixels = rendered(figure, "png")
        kind, data = ("png", pixels) if len(pixels) < len(data) else (kind, data)
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
