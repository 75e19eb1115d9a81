"""Borenstein & Feng's own formulas on the recorded squares, beside what a fit of the same runs says.

Borenstein & Feng 1996, Measurement and correction of systematic odometry errors in mobile robots, IEEE T-RA 12(6):
return position errors of a square driven both ways give E_d (unequal diameters) and E_b (track).

    python benchmarks/umbmark.py ../shared/data/real
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.geometry.se2 import rotate
from odomcorrupt.study.estimate.calibrate import fit_robot
from odomcorrupt.study.io import Source, read_runs
from odomcorrupt.study.select.selection import learn

if TYPE_CHECKING:
    from odomcorrupt.study.io.recording import Recording

TRACK_M = 0.2
SIDE_M = 1.7
CLOCKWISE = ("optiodom_diff_square_231220200029_run1", "optiodom_diff_square_231220200029_run2")
COUNTER = ("optiodom_diff_square_231220200029_run4", "optiodom_diff_square_231220200029_run5")


def read(folder: Path, names: tuple[str, ...]) -> list[Recording]:
    """Return the recordings of these names."""
    return [run for name in names for run in read_runs(Source(folder / f"{name}.mcap", track_m=TRACK_M))]


def return_error(run: Recording) -> np.ndarray:
    """Return where the robot is at the end minus where odometry thinks it is, both from the start pose: x, y (m)."""

    def shift(xyt: np.ndarray) -> np.ndarray:
        return rotate(xyt[-1, :2] - xyt[0, :2], -xyt[0, 2])

    return shift(run.truth.xyt) - shift(run.odometry.xyt)


def main() -> None:
    """Print both sets of numbers."""
    folder = Path(sys.argv[1])
    cw, ccw = read(folder, CLOCKWISE), read(folder, COUNTER)
    x_cw, x_ccw = (np.mean([return_error(run) for run in runs], axis=0)[0] for runs in (cw, ccw))
    alpha, beta = (x_cw + x_ccw) / (-4.0 * SIDE_M), (x_cw - x_ccw) / (-4.0 * SIDE_M)
    radius = SIDE_M / 2.0 / np.sin(beta / 2.0)
    e_d = (radius + TRACK_M / 2.0) / (radius - TRACK_M / 2.0)
    e_b = np.radians(90.0) / (np.radians(90.0) - alpha)
    print(f"Borenstein & Feng: return errors cw {1e3 * x_cw:.1f} mm, ccw {1e3 * x_ccw:.1f} mm")
    print(f"  E_d = {e_d:.5f} (curvature {(e_d - 1.0) / TRACK_M:+.5f} rad/m), E_b = {e_b:.5f}")
    runs = [*cw, *ccw]
    learned = learn(runs)
    robot = fit_robot(runs, learned.fit.effects, law_name="diffusion", clocks=learned.clocks)
    found = {e.name: e for e in robot.fit.effects}
    errors = robot.model.standard_errors
    if "unequal_wheels" in found:
        k, se = found["unequal_wheels"].curvature, errors["unequal_wheels.curvature"]
        half = k * TRACK_M / 2.0
        e_d = (1.0 + half) / (1.0 - half)
        print(f"fit: E_d = {e_d:.5f} +- {se * TRACK_M:.5f} (curvature {k:+.5f} +- {se:.5f} rad/m)")
    if "wheelbase" in found:
        print(f"fit: E_b = {1.0 + found['wheelbase'].e:.5f} +- {errors['wheelbase.e']:.5f}")
    print("fit: everything found:", *(repr(e) for e in robot.fit.effects), sep="\n  ")


if __name__ == "__main__":
    main()
