"""How the report looks, on a screen and on paper. Nothing is loaded from anywhere."""

__all__ = ["CSS"]

CSS = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { font: 16px/1.5 system-ui, "Segoe UI", "DejaVu Sans", Arial, sans-serif; color: #111; background: #fff;
  max-width: 72rem; margin: 0 auto; padding: 1.5rem 1.25rem 4rem; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .25rem; }
h2 { font-size: 1.25rem; margin: 2.2rem 0 .5rem; }
h3 { font-size: 1.05rem; margin: 1.4rem 0 .3rem; }
p { margin: .4rem 0; }
.quiet { color: #555; font-size: .9rem; }
.verdict { border-left: .4rem solid #0072B2; padding: .1rem 0 .1rem .8rem; font-weight: 600; }
.verdict.rejected { border-left-color: #D55E00; }
ol { margin: .3rem 0 .8rem; padding-left: 2rem; }
li { margin: .15rem 0; }
figure { margin: 0; }
figure img { display: block; width: 100%; height: auto; }
figcaption { color: #444; font-size: .92rem; max-width: 52rem; margin: 0 0 .6rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .8rem; font-variant-numeric: tabular-nums; margin: .4rem 0; }
caption { text-align: left; font-weight: 600; padding: .2rem 0; }
th, td { padding: .22rem .5rem; text-align: right; border-bottom: 1px solid #ddd; white-space: nowrap; }
th:first-child, td:first-child { text-align: left; padding-left: 0; }
thead th { border-bottom: 2px solid #999; vertical-align: bottom; }
td.off { font-weight: 700; color: #A33F00; }
.bar { display: block; height: .7em; background: #777; }
.cards { display: grid; grid-template-columns: repeat(auto-fill, minmax(19rem, 1fr)); gap: .9rem; margin: .8rem 0; }
.card { border: 1px solid #ddd; border-top: .3rem solid #0072B2; border-radius: .3rem; padding: .7rem .9rem; }
.card.noise { border-top-color: #777; }
.card.unknown { border-top-color: #E69F00; }
.card h3 { margin: 0; font-size: 1.1rem; }
.card .value { font-size: 1.15rem; font-weight: 600; font-variant-numeric: tabular-nums; margin: .35rem 0 0; }
.card p { margin: .25rem 0; font-size: .92rem; }
.meter { display: block; height: .5rem; background: #e6e6e6; border-radius: .25rem; margin: .3rem 0; }
.meter span { display: block; height: 100%; background: #0072B2; border-radius: .25rem; }
.next { background: #f4f7fa; border: 1px solid #d5e0ea; border-radius: .3rem; padding: .6rem 1rem; }
.next li { margin: .35rem 0; }
pre { background: #1d2733; color: #f1f5f9; padding: .6rem .8rem; border-radius: .3rem; overflow-x: auto;
  font: .85rem/1.45 ui-monospace, "DejaVu Sans Mono", monospace; margin: .5rem 0; }
code { font: .9em ui-monospace, "DejaVu Sans Mono", monospace; }
@page { margin: 14mm; }
@media print {
  body { font-size: 10.5pt; max-width: none; padding: 0; }
  h2, h3 { break-after: avoid; }
  figure, table, .verdict, .card, li { break-inside: avoid; }
  .scroll { overflow: visible; }
  table { font-size: 7.6pt; }
  th, td { padding: .15rem .35rem; }
  .bar, .verdict, .card, .meter, .meter span, pre { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
  figure img { max-height: 21cm; width: auto; max-width: 100%; }
}
"""
