"""Write docs/real_robots.md and its pictures: real robots, and another drive of each corrupted with its model.

python docs/make_real_robots.py FOLDER_OF_RECORDINGS
"""

from __future__ import annotations

import re
import sys
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from independent_look import COMPARISON, VERDICT, table
from scipy.stats import binom

from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.effects.expression import UserEffect
from odomcorrupt.errors import EffectError
from odomcorrupt.geometry.se2 import between, wrap
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.motion_model import TruthNoise
from odomcorrupt.report.comparison import sentence
from odomcorrupt.report.findings import dependence, value_text
from odomcorrupt.report.plots.figure import BLUE, TRUTH, drawn
from odomcorrupt.study.estimate.calibrate import RobotFit, fit_robot
from odomcorrupt.study.io import Source, read_runs
from odomcorrupt.study.select.selection import learn
from odomcorrupt.study.validate.compare import compare
from odomcorrupt.study.validate.predictive_check import Replay, replay

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from odomcorrupt.study.io.recording import Recording
    from odomcorrupt.study.validate.compare import ModelEvaluation
    from odomcorrupt.study.validate.evaluation import Evaluation

HERE = Path(__file__).parent
RUNS = 1000
LENGTHS_M = (1.0, 2.0, 5.0)
FEWEST = 5


@dataclass(frozen=True, slots=True)
class Robot:
    """A robot, the recordings it is learned on and the one it is evaluated on; the same: first half, second half."""

    key: str
    title: str
    learned_on: tuple[str, ...]
    judged_on: str
    track_m: float | None = None


INTRODUCTION = """\
# Real robots: does the model reproduce the measured odometry?

Seven robots, recorded by others, are each learned on one drive and evaluated on another one (or on the two halves of a
drive). The truth of the evaluated drive is corrupted a thousand times with the model, by the code that corrupts bags,
and cut into windows of path that do not overlap. The measured odometry of a window should be in the region that holds
90 % of the corrupted ones, in 90 % of windows; a model is **covered** if it has as many there as a right model has, or
exceeds, in 19 of 20 cases. Windows are few: a right model, too, may have 4 of 6.

The log score falls on Create 1, 2 and 3 by 4, 12 and 7 nats per metre, with standard errors of 10, 17 and 16. Models
are those of `odomcorrupt learn`. Lengths are in m, angles in rad unless stated; the noise law is `diffusion`.
`docs/make_real_robots.py` makes this page.
"""

COMMANDS = """\
## How to read this page

**Covered** is a statement on the size of errors, not on their cause. A model with too much noise is covered, too: four
of the six that are covered predict larger errors than were measured. Causes are credible where the error falls to two
fifths or less, few effects are named, and an independent estimate agrees
([last section](#comparison-with-plain-least-squares)): the differential robot, the tricycle and the mecanum base.

**iRobot Create: the effects are not causes.** Their odometry is the commanded velocity. What lies between command and
wheels (delay and slow response of the motors, speeds that the drive rounds or cannot reach) is not an effect of this
library; functions of the command and several effects together approximate it, and their parameters mean nothing alone.
On Create 2 `wheel_scale -14.0 %` takes 9 mm/s from the median speed of 67 mm/s, and `truncated_velocity` adds 10 mm/s;
on straights the robot drove 2.4 % *farther* than commanded. Do not set a wheel radius from such a model. With its ten
effects the error after 10 s is smaller, but the log score is not better than that of noise alone.

**Lawn mower: `dead_band 98 %` is not a fault of the wheels.** It acts below 0.05 m/s, where the odometry creeps 0.7 m
of 1861 m in 203 s, nearly all of it standing: that creeping was no motion. The error after 10 s falls by a fifth only,
and the mower is covered over 1 m with noise alone as well (94 % of windows). What the recordings show is that its
wheels are nearly right; `slip_burst` describes intervals in which the truth falls behind (last section).
"""

ROBOTS = (
    Robot(
        "differential",
        "Differential drive, motion capture (OptiOdom)",
        ("optiodom_diff_free_020120212354_run1", "optiodom_diff_free_030120210001_run1"),
        "optiodom_diff_free_030120210001_run2",
        0.2,
    ),
    Robot(
        "tricycle",
        "Tricycle, motion capture (OptiOdom)",
        ("optiodom_tricyc_free_140120211508_run1",),
        "optiodom_tricyc_free_140120211525_run1",
    ),
    Robot(
        "mecanum", "Mecanum, motion capture (Politecnico di Milano)", ("polimi_mecanum_bag1",), "polimi_mecanum_bag2"
    ),
    Robot("create1", "iRobot Create 1, commanded velocities (MRCLAM)", ("mrclam6_robot1",), "mrclam6_robot1"),
    Robot("create2", "iRobot Create 2, commanded velocities (MRCLAM)", ("mrclam6_robot2",), "mrclam6_robot2"),
    Robot("create3", "iRobot Create 3, commanded velocities (MRCLAM)", ("mrclam6_robot3",), "mrclam6_robot3"),
    Robot("mower", "Lawn mower, RTK GPS without headings (CMU plaza)", ("plaza1",), "plaza1"),
)


@dataclass(frozen=True, slots=True)
class Covered:
    """Parts of n windows of a length whose measured odometry lies in the runs' 50 and 90 % regions."""

    length_m: float
    windows: int
    half: float
    most: float

    def __str__(self) -> str:
        return f"{100 * self.half:.0f} / {100 * self.most:.0f} % of {self.windows}"


def covered(paths: Replay, truth_m: float, truth_rad: float, length_m: float) -> Covered | None:
    """Return coverage by windows of path, each started at the truth; noise of the truth is drawn at both ends."""
    marks = np.searchsorted(paths.distance_m, np.arange(0.0, paths.distance_m[-1], length_m))
    if len(marks) - 1 < FEWEST:
        return None
    noise = np.random.default_rng(5).standard_normal((RUNS, len(marks), 3)) * [truth_m, truth_m, truth_rad]
    runs = paths.runs_xyt[:, marks] + noise
    inside = np.array([window(runs[:, i : i + 2], paths.measured_xyt[marks[i : i + 2]]) for i in range(len(marks) - 1)])
    return Covered(length_m, len(inside), float(np.mean(inside <= 0.5)), float(np.mean(inside <= 0.9)))


def window(runs: np.ndarray, measured: np.ndarray) -> float:
    """Return which part of the runs (r, 2, 3) ends a window nearer to their middle than the measured (2, 3) does."""
    ends, own = between(runs[:, 0], runs[:, 1]), between(measured[0], measured[1])
    middle = ends[0]
    ends, own = ends - middle, own - middle
    ends[:, 2], own[2] = wrap(ends[:, 2]), float(wrap(own[2:])[0])
    centre, spread = ends.mean(axis=0), np.linalg.inv(np.cov(ends.T) + 1e-14 * np.eye(3))
    far = np.einsum("ri,ij,rj->r", ends - centre, spread, ends - centre)
    return float(np.mean(far < (own - centre) @ spread @ (own - centre)))


def recordings(folder: Path, robot: Robot) -> tuple[list[Recording], Recording]:
    """Return what is learned on and what is judged."""

    def read(name: str) -> Recording:
        return read_runs(Source(folder / f"{name}.mcap", track_m=robot.track_m))[0]

    if robot.judged_on not in robot.learned_on:
        return [read(name) for name in robot.learned_on], read(robot.judged_on)
    whole = read(robot.judged_on)
    middle = len(whole.truth) // 2
    parts = [
        replace(whole, name=f"{whole.name} {word} half", truth=Trajectory(whole.truth.stamps_ns[s], whole.truth.xyt[s]))
        for word, s in (("first", slice(0, middle)), ("second", slice(middle, None)))
    ]
    return parts[:1], parts[1]


def section(folder: Path, robot: Robot) -> list[str]:
    """Learn, corrupt, judge, draw; return the robot's part of the page."""
    learning, judging = recordings(folder, robot)
    learned = learn(learning)
    random = [gain.effect for gain in learned.noise]
    known = {"noise alone": [], "with what was learned": [*learned.fit.effects, *random]}
    fits = {
        name: fit_robot(learning, effects, law_name="diffusion", clocks=learned.clocks)
        for name, effects in known.items()
    }
    comparison = compare([judging], {name: fit.model for name, fit in fits.items()})
    clock = comparison.clocks.clocks[0]
    lines = [f"## {robot.title}", ""]
    lines.append(
        f"Learned on {', '.join(r.name for r in learning)}; evaluated on {judging.name}, whose odometry clock is "
        f"{clock.offset_s * 1e3:+.0f} ms off and gains {clock.rate * 1e6:+.0f} ppm. Error after 10 s: "
        f"{comparison.raw_error_m * 1e3:.0f} mm as measured, "
        f"{comparison.clock_error_m * 1e3:.0f} mm with its clock corrected."
    )
    lines += ["", "| | " + " | ".join(fits) + " |", "|---|" + "---|" * len(fits)]
    clouds, remarks = {}, []
    for j in comparison.evaluations:
        piece = j.pieces[0]
        try:
            clouds[j.name] = replay(piece, runs=RUNS)
        except EffectError:
            clouds[j.name], left_out = tamer(piece)
            remarks = ["", f"Its {left_out} are too strong for this drive and were left out of the runs."]
    for label, values in rows(fits, comparison.evaluations, clouds):
        if set(values) != {"–"}:
            lines.append(f"| {label} | " + " | ".join(values) + " |")
    last = comparison.evaluations[-1]
    lines += ["", *verdict(last, clouds[last.name], judging), *remarks]
    picture = HERE / "images" / f"real_{robot.key}.png"
    draw(clouds, picture)
    return [*lines, "", f"![{robot.title}](images/{picture.name})", ""]


def tamer(piece: Evaluation) -> tuple[Replay, str]:
    """Return the cloud of a model without effects that are too strong for this drive, and which these are."""
    calm = tuple(e for e in piece.model.effects if e.kind != "noise")
    for left_out, effects in (
        ("random effects", calm),
        ("laws", tuple(e for e in piece.model.effects if not isinstance(e, UserEffect))),
        ("laws and random effects", tuple(e for e in calm if not isinstance(e, UserEffect))),
    ):
        with suppress(EffectError):
            return replay(replace(piece, model=replace(piece.model, effects=effects)), runs=RUNS), left_out
    return replay(replace(piece, model=replace(piece.model, effects=())), runs=RUNS), "effects"


def rows(
    fits: dict[str, RobotFit], evaluations: tuple[ModelEvaluation, ...], clouds: dict[str, Replay]
) -> list[tuple[str, list[str]]]:
    """Return the table's rows: a label, and a cell for each model."""
    models = list(fits.values())
    table = [("effects", [effects_text(fit) for fit in models])]
    names = ("rot_rot", "rot_trans", "trans_trans", "trans_rot", "across_trans")
    values = [[f"{getattr(fit.model.noise.coefficients, name):.3g}" for name in names] for fit in models]
    table.append(("`" + "`, `".join(names) + "`", [", ".join(own) for own in values]))
    table.append(("truth's noise", [truth_text(fit) for fit in models]))
    table.append(("error after 10 s", [f"{j.ten_second_error_m * 1e3:.1f} mm" for j in evaluations]))
    table.append(("nats per metre", [f"{j.nats.per_m:.1f} ± {j.nats.error:.1f}" for j in evaluations]))
    for length in LENGTHS_M:
        cells = [next((f"{h.nees:.2f} (chance {h.nees_bounds[0]:.2f} to {h.nees_bounds[1]:.2f})"
                       for h in j.horizons if h.distance_m == length), "–") for j in evaluations]  # fmt: skip
        table.append((f"NEES over {length:g} m", cells))
        inside = [cloud_cover(clouds[j.name], j, length) for j in evaluations]
        table.append((f"in the runs' 50 / 90 % region over {length:g} m", [str(c) if c else "–" for c in inside]))
    return table


def cloud_cover(paths: Replay, evaluation: ModelEvaluation, length_m: float) -> Covered | None:
    """Return coverage under the truth's noise that the model states."""
    truth = evaluation.pieces[0].truth
    return covered(paths, truth.xy_m, truth.yaw_rad, length_m)


def truth_text(fit: RobotFit) -> str:
    """Return how noisy the truth is; without headings, what stands for their noise means nothing."""
    truth = fit.model.setup.truth or TruthNoise()
    if not fit.fit.problem.headings:
        return f"{truth.xy_m * 1e3:.2g} mm, no headings, {truth.random_walk * 1e3:.2g} mm/√s"
    return f"{truth.xy_m * 1e3:.2g} mm, {np.degrees(truth.yaw_rad):.2g} deg, {truth.random_walk * 1e3:.2g} mm/√s"


def effects_text(fit: RobotFit) -> str:
    """Return the effects with their sizes."""
    effects = [*fit.model.effects, *fit.model.setup.effects]
    texts = [
        f"{e.name} " + ", ".join(value_text(getattr(e, p.name), None, p.unit) for p in amplitudes(e)) for e in effects
    ]
    return "; ".join(texts) or "none"


def verdict(evaluation: ModelEvaluation, paths: Replay, judging: Recording) -> list[str]:
    """Say whether the measured odometry is covered; where not, what is left of it and what would explain it."""
    found = [c for length in LENGTHS_M if (c := cloud_cover(paths, evaluation, length)) is not None]
    short = [c for c in found if c.most < least_covered(c.windows)]
    if not short:
        wide = [h for h in evaluation.horizons if h.nees < h.nees_bounds[0]]
        cautious = " The model predicts larger errors than were measured: its noise is too large." if wide else ""
        return [f"**Covered**: the number of windows in the runs' 90 % region agrees with a right model.{cautious}"]
    where = ", ".join(
        f"{c.length_m:g} m (a right model: at least {100 * least_covered(c.windows):.1f} %)" for c in short
    )
    rates = [f for f in evaluation.failures if f.kind in {"motion", "place", "time"}]
    lines = [f"**Not covered** over {where}." + (" What is left, odometry minus truth:" if rates else "")]
    lines += ["", *(f"- {sentence(f)}" for f in rates[:2])] if rates else []
    own = learn([judging])
    names = [*own.added, *(gain.effect.name for gain in own.noise)]
    unknown = [dependence(u) for u in own.unknown[:3]]
    known = f"**What would explain it**, learned on the evaluated run itself: {', '.join(names) or 'no known effect'}"
    return [*lines, "", known + (f"; and what no known effect explains: {', '.join(unknown)}." if unknown else ".")]


def least_covered(windows: int) -> float:
    """Return the part of so many windows that a right model has in its 90 % region in at least 19 of 20 cases."""
    return float(binom.ppf(0.05, windows, 0.9)) / windows


def overview(page: str) -> list[str]:
    """Return the table of all robots, from the text of their sections."""
    lines = [
        "| robot | 10 s error as measured, clock corrected | noise alone | learned | nats per metre | covered |",
        "|---|---|---|---|---|---|",
    ]
    for part in page.split("\n## ")[1:]:
        measured = re.search(r"Error after 10 s: (.*) as measured, (.*) with its clock corrected", part)
        if measured is not None:
            errors, nats = (
                re.findall(r"[-\d.]+(?: mm| ±)", next(line for line in part.splitlines() if line.startswith(label)))
                for label in ("| error after 10 s |", "| nats per metre |")
            )
            change = " to ".join(value.removesuffix(" ±") for value in nats)
            lengths = re.findall(r"(\d+ m) \(a right model", part)
            covers = f"not over {', '.join(lengths)}" if lengths else "yes"
            cells = (part.partition("\n")[0], f"{measured[1]}, {measured[2]}", *errors, change, covers)
            lines.append(f"| {' | '.join(cells)} |")
    return lines


def draw(clouds: dict[str, Replay], file: Path) -> None:
    """Draw a hundred of the runs of each model, the truth and the measured odometry."""
    with drawn(8.0, 4.4) as figure:
        panels = figure.subplots(1, len(clouds), sharex=True, sharey=True)
        for axes, (name, paths) in zip(panels, clouds.items(), strict=True):
            panel(axes, paths, name)
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=9)
        # paths of equal axes may need more height than the layout gives them: the picture grows, no label is cut
        figure.savefig(file, dpi=75, metadata={"Software": None}, bbox_inches="tight", pad_inches=0.05)


def panel(axes: Axes, paths: Replay, name: str) -> None:
    """Draw one model's runs."""
    for i, run in enumerate(paths.runs_xyt[:100]):
        axes.plot(
            run[:, 0], run[:, 1], color=BLUE, linewidth=0.6, alpha=0.2, label="100 corrupted truths" if i == 0 else None
        )
    axes.plot(*paths.truth_xyt[:, :2].T, color=TRUTH, linewidth=1.2, label="truth")
    axes.plot(*paths.measured_xyt[:, :2].T, "--", color="0.4", linewidth=1.6, label="measured odometry")
    axes.set(title=name, xlabel="x (m)", ylabel="y (m)")
    axes.set_aspect("equal", adjustable="box")
    axes.grid(visible=True, color="0.93")


def main(folder: Path) -> None:
    """Write the page."""
    lines = []
    for robot in ROBOTS:
        print(robot.title, flush=True)
        part = section(folder, robot)
        print("\n".join(part), flush=True)
        lines += part
    runs = [
        read_runs(Source(path, track_m=0.2 if "_diff_" in path.name else None))[0]
        for path in sorted(folder.glob("*.mcap"))
        if not path.name.startswith("rob521")
    ]
    lines = [INTRODUCTION, *overview("\n" + "\n".join(lines)), "", COMMANDS, *lines]
    lines += [*COMPARISON.strip().splitlines(), "", *table(runs), *VERDICT.rstrip().splitlines()]
    (HERE / "real_robots.md").write_text("\n".join(lines).rstrip() + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
