"""Page of results: docs/hidden_effects.md from a results file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from laboratory.advice.tables import advice_section
from laboratory.cases import ARMS, LENGTHS
from laboratory.samples import bodies, plants, sames
from laboratory.tables import (
    confusion,
    controls,
    falls,
    misses,
    mixtures,
    noise,
    outside,
    part,
    reliability,
    single,
    table,
)
from laboratory.verdicts import is_excited

__all__ = ["page"]

Rows = list[dict[str, Any]]
FINDINGS = Path(__file__).with_name("findings.md")
"""Conclusions from the figures, written by hand."""
HEAD = """\
# Benchmark of hidden effects

How far to trust `learn`, measured on simulated recordings whose hidden cause is known. The cause is one effect, two
effects, noise, a cause that is not in the library, or none (controls); the truth is motion capture or RTK.

- **Excited**: the drive contains what shows the cause, by its expected information alone. **Separable**: also beside
  any other single effect.
- **Named**: identified as the cause by `learn`; the effect that is reported is called its name. **Right**: this effect
  is the cause, or equals it in every recording.
- **Error**: 10 s error on another drive of the same robot, after correction with what was learned, over that of the
  same drive without the fault.

`benchmarks/laboratory/protocol.md`, frozen before the run, has the details, and how goals are judged. `python
benchmarks/hidden_effects.py summary` writes this page: goals are beside the figures, and every miss is listed.
"""


def page(rows: Rows, advice: Rows) -> str:
    """Return the whole page in Markdown; `advice` has the results of the advice arm."""
    arm = {name: [row for row in rows if row["case"]["arm"] == name] for name in ARMS}
    good = {name: [row for row in own if "failed" not in row] for name, own in arm.items()}
    excited = [row for row in good["single"] if is_excited(row)]
    lines = [HEAD, FINDINGS.read_text(), "## Cases", ""]
    lines += table(("arm", "planned", "ran", "failed"), [
        [name, LENGTHS[name], len(arm[name]), len(arm[name]) - len(good[name])] for name in ARMS
    ])  # fmt: skip
    lines += ["## Controls: no hidden cause", ""]
    lines += controls("Motion capture", good["controls"], "at most 2 in 200")
    lines += controls("RTK", good["rtk"], "at most 1 in 30")
    lines += [
        "Sham: a wrong effect added on purpose, 10 s error on another drive over that before:",
        "",
        *_shams(good["controls"]),
    ]
    lines += ["## One systematic cause", "", *single(arm["single"]), *confusion(arm["single"])]
    lines += ["Wrong first names:", "", *misses(arm["single"])]
    lines += [
        "## Held-out error",
        "",
        "10 s error over that of the same drive without the fault, before and after learning.",
        "",
    ]
    lines += table(("drives", "number", "before, median / p90", "after, median (goal 1.02)", "p90 (goal 1.08)"), [
        falls(excited, "one cause, excited"),
        *(falls([r for r in excited if r["case"]["size"] == s], f"{s}") for s in ("strong", "medium", "weak")),
        falls(good["single"], "one cause, all"),
        falls(good["mixtures"], "two causes"),
        falls(good["outside"], "outside causes, expressions included"),
        falls(good["controls"], "controls"),
    ])  # fmt: skip
    lines += ["## Causes outside the library", "", *outside(arm["outside"])]
    lines += ["## Two causes", "", *mixtures(arm["mixtures"])]
    lines += ["A systematic and a random cause together:", "", *mixtures(arm["noisy_mixtures"], goals=())]
    lines += ["## Noise causes", "", *noise(arm["noise"])]
    lines += [
        "## Calibration of the confidence",
        "",
        "Included effects, of all drives with one, two or no known cause:",
        "",
    ]
    lines += reliability([*good["controls"], *good["rtk"], *good["single"], *good["mixtures"]])
    lines += [
        "With causes outside the library, for which every known name is wrong:",
        "",
        *reliability(good["outside"]),
    ]
    lines += ["## Invariance: the same drive in another frame, rate or format", "", *sames(good["invariance"])]
    lines += ["## Planted in real recordings", "", *plants(good["planted"])]
    lines += ["## A robot simulated in MuJoCo", "", *bodies(good["body"])]
    lines += advice_section(advice)
    seconds = [row["learn_s"] for row in rows if "learn_s" in row]
    if seconds:
        times = f"median {np.median(seconds):.1f}, 90th percentile {np.quantile(seconds, 0.9):.1f}"
        lines += [
            "## Time",
            "",
            f"CPU seconds to learn from 10 min at 50 Hz (goal 5), on a machine with other load: {times}.",
            "",
        ]
    broken = [row for row in rows if "failed" in row]
    if broken:
        lines += ["## Failed cases", ""]
        lines += [f"- {row['key']}: {row['failed'].strip().splitlines()[-1]}" for row in broken]
    return "\n".join(lines).rstrip() + "\n"


def _shams(rows: Rows) -> list[str]:
    ratios = np.array([row["sham"]["ratio"] for row in rows if "sham" in row])
    if not len(ratios):
        return ["none ran", ""]
    spread = " to ".join(f"{np.quantile(ratios, q):.3f}" for q in (0.1, 0.9))
    lower = [part([bool(r < limit) for r in ratios]) for limit in (0.99, 0.97)]
    said = f"median {np.median(ratios):.3f} (goal: not below 1), 10th to 90th percentile {spread}"
    return [f"{said}; lower by more than 1 % in {lower[0]}, by more than 3 % in {lower[1]}.", ""]
