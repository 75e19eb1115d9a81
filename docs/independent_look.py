"""Plain least squares on recordings beside the fit: where they differ, and which of them is right.

Written into docs/real_robots.md by docs/make_real_robots.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects import effect_from_values
from odomcorrupt.study.estimate.clocks import find_clocks
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.outliers import events
from odomcorrupt.study.estimate.windows import time_windows
from odomcorrupt.study.io.clock import aligned

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.io.recording import Recording

WINDOW_S = 1.5
STRAIGHT_RADPS = 0.05

COMPARISON = """
## Comparison with plain least squares

Truth over odometry for travel (k), for turning (a), and what each metre adds to the turn (b, rad/m). The plain estimate
is least squares over windows of 1.5 s, truth on odometry with its clock corrected. The fit has the effects
`wheel_scale`, `gyro_scale`, `unequal_wheels` and `mount_yaw`, so k is 1 + e of the first, and a is k over 1 + e of the
second.
"""

VERDICT = """
- **They agree** where wheel errors explain the data: free drives of the differential robot, tricycle, second mecanum
  drive (the publishers state 1.08 for its turning). The first mecanum drive hardly turns, so its a is not identifiable.
- **Squares: the fit is right.** On a square the robot turns one way while it stands, and never while it drives, so a
  and b are nearly collinear and the plain estimate scatters. The fits of the four runs agree within their errors, and
  with the formulas of Borenstein and Feng on the same runs (`python benchmarks/umbmark.py`).
- **Lawn mower: the fit is right.** In 28 intervals the truth falls behind, by 6.5 m of 1861 m in all. A plain k spreads
  that loss over the whole drive; the fit treats the intervals as outliers and finds wheels of nearly nominal size,
  0.9995. Between them half of the motions of half a second agree to 0.3 mm along, so no normal distribution describes
  both, and the NEES reflects the outliers.
- **iRobot Create: neither is right.** On straights the truth goes farther than commanded, in turns much less (last
  two columns), so a single k depends on the share of straights. `learn` reports that the along error depends on the yaw
  rate and that no known effect explains it. With the expression in the model the 10 s error of the other half falls by
  38 to 44 %.
"""


@dataclass(frozen=True, slots=True)
class Look:
    """Truth over odometry: travel, turn, and the turn that each metre adds (rad/m)."""

    k: float
    a: float
    b: float

    def __str__(self) -> str:
        return f"{self.k:.4f}, {self.a:.4f}, {self.b:+.3f}"


def table(runs: Sequence[Recording]) -> list[str]:
    """Return the section's table, a row per recording."""
    lines = ["| recording | plain: k, a, b | fit: k, a, b | outliers | k straight | k in turns |"]
    lines.append("|---|---|---|---|---|---|")
    for run in runs:
        approach = choose_approach([run])
        clocks = find_clocks([run], approach)
        on_time = aligned(run, clocks.clocks[0])
        names = ("wheel_scale", "gyro_scale", "unequal_wheels", "mount_yaw")
        fitted = fit(
            [run],
            [effect_from_values(name, {}) for name in names],
            clocks=clocks.clocks,
            free_clocks=clocks.free,
            approach=approach,
        )
        slips = events(fitted)
        apart = f"{len(slips)}: {sum(e.along_m for e in slips):+.2f} m" if slips else "none"
        straight, turning = (f"{value:.3f}" if np.isfinite(value) else "–" for value in by_turning(on_time))
        lines.append(
            f"| {run.name.removesuffix('.mcap')} | {plain(on_time)} | {numbers(fitted)} | {apart} "
            f"| {straight} | {turning} |"
        )
    return lines


def numbers(fitted: Fit) -> str:
    """Return the three numbers of a fit with their standard errors."""
    scale, gyro, bend = (getattr(fitted.effects[i], name) for i, name in enumerate(("e", "e", "curvature")))
    covariance = fitted.noise.theta_covariance[:3, :3]
    a = (1.0 + scale) / (1.0 + gyro)
    slope = np.array([1.0 / (1.0 + gyro), -a / (1.0 + gyro), 0.0])
    errors = np.sqrt([covariance[0, 0], slope @ covariance @ slope, covariance[2, 2]])
    return f"{1.0 + scale:.4f} ± {errors[0]:.4f}, {a:.4f} ± {errors[1]:.4f}, {bend:+.3f} ± {errors[2]:.3f}"


def plain(recording: Recording) -> Look:
    """Return the least-squares look: truth on odometry over windows of 1.5 s, with a turn per metre and per second."""
    odometry, truth = _steps(recording)
    travel, true_travel = (np.hypot(step[:, 0], step[:, 1]) for step in (odometry, truth))
    way, second = travel * np.sign(odometry[:, 0]), np.full(len(odometry), WINDOW_S)
    turns = np.linalg.lstsq(np.stack((odometry[:, 2], way, second), axis=1), truth[:, 2], rcond=None)[0]
    return Look(float(travel @ true_travel / (travel @ travel)), float(turns[0]), float(turns[1]))


def by_turning(recording: Recording) -> tuple[float, float]:
    """Return k of the windows that go straight, and of those that turn."""
    odometry, truth = _steps(recording)
    travel, true_travel = (np.hypot(step[:, 0], step[:, 1]) for step in (odometry, truth))
    straight = np.abs(odometry[:, 2]) < STRAIGHT_RADPS * WINDOW_S
    parts = [(travel[m] @ true_travel[m], travel[m] @ travel[m]) for m in (straight, ~straight)]
    first, second = (float(shared / own) if own > 0.1 else float("nan") for shared, own in parts)
    return first, second


def _steps(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    windows = time_windows(recording, WINDOW_S)
    return windows.odometry_step, windows.truth_step
