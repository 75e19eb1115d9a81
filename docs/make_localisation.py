"""What learned odometry does to a Monte-Carlo localiser: the figures and the picture of docs/localisation.md.

    python docs/make_localisation.py ../shared/data --folder work

A model of the differential robot is learned from two of its free drives. The perfect odometry of the rob521 simulation
is then corrupted by that robot, and by robots whose noise and effects are up to 32 times as large, 30 runs each.
`examples/localise.py` localises every run with three settings of amcl's alphas; `score` says what came of it.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator

from odomcorrupt.effects.effect import amplitudes, check_bounds
from odomcorrupt.export import Steady, amcl_alphas
from odomcorrupt.model.model_file import format_model, read_model
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.report.plots.figure import BLUE, GREEN, ORANGE, RED, drawn, rendered
from odomcorrupt.scoring.errors import Limits
from odomcorrupt.scoring.run import ScoreReport, score

if TYPE_CHECKING:
    from odomcorrupt.model.motion_model import MotionModel

ROOT = Path(__file__).parent.parent
FACTORS = (0, 1, 2, 4, 8, 16, 32)
RUNS, SEED = 30, 7
LOST_M = 0.5
DRIVES = ("optiodom_diff_free_020120212354_run1.mcap", "optiodom_diff_free_030120210001_run1.mcap")


def scaled(model: MotionModel, factor: float) -> MotionModel:
    """Return a model with noise and effects so many times as large; what would leave its bounds stays at them."""
    k = model.noise.coefficients
    noise = {name: factor * getattr(k, name) for name in Coefficients.__slots__}
    effects = []
    for effect in model.effects:
        if effect.layer == "draws":
            effects.append(effect)
            continue
        sizes = {p.name: np.clip(factor * getattr(effect, p.name), p.low, p.high) for p in amplitudes(effect)}
        grown = replace(effect, **{name: float(size) for name, size in sizes.items()})
        check_bounds(grown)
        effects.append(grown)
    coefficients = replace(k, **noise)
    return replace(
        model, noise=replace(model.noise, coefficients=coefficients), effects=tuple(effects), standard_errors={}
    )


def command(*words: object) -> None:
    """Run a command, and stop where it fails."""
    subprocess.run([str(word) for word in words], check=True)  # noqa: S603 - our own


def learned(data: Path, folder: Path) -> MotionModel:
    """Return the differential robot, learned where that has not been done yet."""
    path = folder / "robot.toml"
    if not path.exists():
        drives = [data / "real" / name for name in DRIVES]
        command(sys.executable, "-m", "odomcorrupt", "learn", *drives, "--track", "0.2", "-o", path)
    return read_model(path)


def made(data: Path, folder: Path, robot: MotionModel) -> Path:
    """Make the batches, and return their directory."""
    bag, runs = data / "real" / "rob521_gazebo.mcap", folder / "runs"
    for factor in FACTORS:
        model = folder / f"x{factor:02d}.toml"
        model.write_text(format_model(scaled(robot, factor)), encoding="utf8")
        command(
            sys.executable, "-m", "odomcorrupt", "batch", bag, runs / model.stem, "--runs", RUNS, "--model", model,
            "--seed", SEED, "--output", "trajectories",
        )  # fmt: skip
    return runs


def settings(robot: MotionModel) -> dict[str, tuple[float, ...]]:
    """Return amcl's alphas by name: too small by far, those of the learned robot, nav2's defaults."""
    *exported, _ = amcl_alphas(robot.noise, 0.25, 0.2, drive=Steady(0.5, 0.5, 50.0)).values()
    return {"1e-8": (1e-8,) * 4, "exported": tuple(exported), "defaults (0.2)": (0.2,) * 4}


def results(data: Path, folder: Path, runs: Path, chosen: dict[str, tuple[float, ...]]) -> dict[str, list[ScoreReport]]:
    """Return a report for each setting and each factor, and one of all factors at the end."""
    bag, grid = data / "real" / "rob521_gazebo.mcap", data / "bags" / "maps" / "rob521_gazebo.yaml"
    found = {}
    for number, (name, alphas) in enumerate(chosen.items()):
        estimates = folder / f"estimates{number}"
        if not estimates.exists():
            command(
                sys.executable, ROOT / "examples" / "localise.py", bag, grid, runs, estimates, "--alphas", *alphas,
                "--truth", "/ground_truth",
            )  # fmt: skip
        every = [(runs / f"x{factor:02d}", estimates / f"x{factor:02d}") for factor in FACTORS]
        found[name] = [_score(*one) for one in [*every, (runs, estimates)]]
    return found


def _score(runs: Path, estimates: Path) -> ScoreReport:
    return score(runs, truth="/ground_truth", outputs=estimates, align="none", limits=Limits(lost_m=LOST_M))


def draw(found: dict[str, list[ScoreReport]]) -> bytes:
    """Return the picture: error over drift for each setting."""
    with drawn(9.0, 4.6) as figure:
        axes = figure.subplots()
        for (name, reports), colour in zip(found.items(), (RED, BLUE, ORANGE, GREEN), strict=False):
            drift = [np.median([100.0 * run.drift for run in report.runs]) for report in reports[:-1]]
            drift[0] = 0.5 * drift[1]
            median = [report.summary("ate_m").median.value for report in reports[:-1]]
            p90 = [report.summary("ate_m").p90.value for report in reports[:-1]]
            axes.plot(drift, median, "o-", color=colour, label=f"alphas {name}")
            axes.plot(drift, p90, ":", color=colour)
            point = reports[-1].breakdown
            if point.width is not None:
                axes.axvline(100.0 * point.drift, color=colour, linewidth=1.0, alpha=0.5)
                axes.text(100.0 * point.drift, 0.038, " 5 % lost", color=colour, fontsize=8)
        axes.set(xscale="log", yscale="log", ylim=(0.025, 9.0), ylabel="ATE of the localisation, m")
        axes.set_xlabel("drift of the odometry, % of the way (rms over 10 m)")
        axes.plot([], [], ":", color="0.4", label="9 of 10 runs below")
        for at, words in (
            (drift[0], "perfect\nodometry"),
            (drift[1], "the learned\nrobot"),
            (drift[-1], "32 times\nas much"),
        ):
            axes.text(at, 0.0265, words, ha="center", fontsize=8.5)
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axis.set_minor_locator(NullLocator())
        axes.set_xlim(left=0.8 * drift[0])
        axes.xaxis.set_major_locator(FixedLocator([1, 2, 5, 10, 20]))
        axes.set_title("A localiser under the drift of a learned robot, and of larger ones")
        axes.legend(loc="upper left", fontsize=9)
    return rendered(figure, "png")


def main() -> None:
    """Print the table and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--folder", type=Path, required=True)
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    robot = learned(given.data, given.folder)
    chosen = settings(robot)
    found = results(given.data, given.folder, made(given.data, given.folder, robot), chosen)
    print("| alphas | " + " | ".join(f"x{factor}" for factor in FACTORS) + " | break-down point |")
    print("|---" * (len(FACTORS) + 2) + "|")
    for name, reports in found.items():
        cells = []
        for report in reports[:-1]:
            lost = f", {report.failed} lost" if report.failed else ""
            cells.append(f"{report.summary('ate_m').median.value:.3f} m{lost}")
        point = reports[-1].breakdown
        at = f"{point.drift:.1%} ({point.low:.1%} to {point.high:.1%})" if point.width else f"above {point.low:.1%}"
        print(f"| {name} | " + " | ".join(cells) + f" | {at} |")
    drifts = [f"{np.median([run.drift for run in r.runs]):.2%}" for r in next(iter(found.values()))[:-1]]
    print(f"median drift: {', '.join(drifts)}; alphas: {chosen}")
    (ROOT / "docs" / "images" / "localisation.png").write_bytes(draw(found))


if __name__ == "__main__":
    main()
