"""Print the tables of docs/laser.md that are measured on recordings of others.

    python docs/make_real_lasers.py FOLDER [BAG ...]

FOLDER holds bags with odometry and laser scans, no truth. For each: lag; scale and turns (what the odometry has to be
multiplied by) and curvature on straights (heading error per metre) against the laser with their robust standard errors
(all three fitted at once); what is learned from the whole drive; and the error of odometry after 10 s on each half of
the drive, measured against the laser, clock and mounting right, before and after what was learned from the other half
alone is taken out. A pair of recordings of one robot is learned on one and evaluated on the other in the same way.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects import effect_from_values
from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.errors import OdomCorruptError
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.report.findings import value_text
from odomcorrupt.study.estimate.calibrate import fit_robot
from odomcorrupt.study.estimate.clocks import find_clocks
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.robust_errors import with_robust_errors
from odomcorrupt.study.estimate.windows import time_windows
from odomcorrupt.study.io import Source, read_runs
from odomcorrupt.study.select.selection import learn
from odomcorrupt.study.validate.compare import compare

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.study.io.recording import Recording

BAGS = ("turtlebot4_mac_floor", "cmu_wean_1", "cmu_wean_3", "mines_rover_exp1", "intel_1hz")
PAIRS = (("cmu_wean_1", "cmu_wean_3"),)
ALWAYS = (("wheel_scale", {"heading": "gyro"}), ("gyro_scale", {}), ("unequal_wheels", {}))
"""Scale of travel (which must not scale turns, too), scale of turns, and turns for each metre."""


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Error of odometry after 10 s (m) against the laser on a drive that was not learned from.

    names : what was learned
    before_m, calibrated_m, after_m : as measured; with scale, turns and curvature taken out; with what was learned
        taken out
    windows : number of windows of 10 s
    """

    names: tuple[str, ...]
    before_m: float
    calibrated_m: float
    after_m: float
    windows: int

    def __str__(self) -> str:
        calibrated = f"{1e3 * self.before_m:.0f} -> {1e3 * self.calibrated_m:.0f} mm"
        learned = f"learned {1e3 * self.after_m:.0f} mm ({', '.join(self.names) or 'nothing'})"
        return f"{calibrated}, {learned}, {self.windows} windows"


def read(folder: Path, name: str) -> list[Recording]:
    """Return the recordings of a bag whose truth is its laser."""
    return read_runs(Source(folder / f"{name}.mcap", scan="/scan"))


def halves(runs: Sequence[Recording]) -> tuple[list[Recording], list[Recording]]:
    """Return the first and the second half of a drive, by time."""
    spans = [run.truth.seconds_since(runs[0].origin_ns) for run in runs]
    middle_s = 0.5 * (spans[0][0] + spans[-1][-1])
    first, second = [], []
    for run, t_s in zip(runs, spans, strict=True):
        for part, rows, word in ((first, t_s < middle_s, "first"), (second, t_s >= middle_s, "second")):
            if np.count_nonzero(rows) > 1:
                covariance = None if run.truth.covariance is None else run.truth.covariance[rows]
                truth = Trajectory(run.truth.stamps_ns[rows], run.truth.xyt[rows], covariance)
                part.append(replace(run, name=f"{run.name} {word} half", truth=truth))
    return first, second


def held_out(learning: Sequence[Recording], judging: Sequence[Recording]) -> HeldOut | str:
    """Learn on some recordings, and judge the effects that were found on others."""
    try:
        learned = learn(learning)
        fits = {
            name: fit_robot(learning, effects, law_name="diffusion", clocks=learned.clocks)
            for name, effects in (
                ("noise alone", []),
                ("calibrated", [effect_from_values(*each) for each in ALWAYS]),
                ("learned", list(learned.fit.effects)),
            )
        }
        judged = compare(judging, {name: fitted.model for name, fitted in fits.items()}).evaluations
    except OdomCorruptError as error:
        return f"- ({error})"
    count = sum(len(time_windows(run)) for run in judging)
    return HeldOut(learned.added, *(evaluation.ten_second_error_m for evaluation in judged), count)


def against_the_laser(runs: Sequence[Recording]) -> list[str]:
    """Return lag, and the scale, turns and curvature of the odometry with their standard errors."""
    approach = choose_approach(runs)
    clocks = find_clocks(runs, approach)
    setup = [effect_from_values(name, {}) for name in ("lever_arm", "mount_yaw")]
    effects = [*(effect_from_values(*each) for each in ALWAYS), *setup]
    found = with_robust_errors(
        fit(runs, effects, approach=approach, clocks=clocks.clocks, free_clocks=clocks.free, start=clocks.noise)
    )
    sizes = np.concatenate([[getattr(e, p.name) for p in amplitudes(e)] for e in found.effects])
    (scale, turns, curvature), errors = sizes[:3], found.standard_errors[:3]
    lag_s = np.mean([clock.offset_s for clock in found.problem.clocks])
    return [
        f"{lag_s:.2f} s",
        f"{1.0 + scale:.4f} +- {errors[0]:.4f}",
        f"{1.0 / (1.0 + turns):.3f} +- {errors[1]:.3f}",
        f"{np.degrees(curvature):+.2f} +- {np.degrees(errors[2]):.2f} deg/m",
    ]


def learned_names(runs: Sequence[Recording]) -> str:
    """Return what is learned from a whole drive, with the sizes."""
    learned = learn(runs)
    errors = iter(learned.fit.standard_errors)
    found = []
    for effect in learned.fit.effects:
        sizes = [f"{value_text(getattr(effect, p.name), next(errors), p.unit)}" for p in amplitudes(effect)]
        if effect.name in learned.added:
            found.append(f"{effect.name} {', '.join(sizes)}")
    return "; ".join(found) or "nothing"


def main(folder: Path, names: Sequence[str]) -> None:
    """Print a row for each bag, then one for each pair."""
    heads = ("recording", "lag", "scale", "turns", "curvature", "learned from all of it", "second half", "first half")
    print("| " + " | ".join(heads) + " |\n" + "|---" * len(heads) + "|")
    known = {}
    for name in names:
        known[name] = runs = read(folder, name)
        first, second = halves(runs)
        crossed = [str(held_out(first, second)), str(held_out(second, first))]
        print("| " + " | ".join([name, *against_the_laser(runs), learned_names(runs), *crossed]) + " |", flush=True)
    for one, other in PAIRS:
        if one in known and other in known:
            print(f"\n{other} by {one}: {held_out(known[one], known[other])}")
            print(f"{one} by {other}: {held_out(known[other], known[one])}", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:] or BAGS)
