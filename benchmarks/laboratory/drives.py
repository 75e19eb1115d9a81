"""The drives of a case: the one learned from, the judging one, and both without the fault."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from hidden import as_recording

from odomcorrupt.simulation import TRACKERS, Rig, SimulatedRun, simulate, simulate_without
from odomcorrupt.simulation.faults import SIZES

if TYPE_CHECKING:
    from laboratory.cases import Case
    from odomcorrupt.study.io.recording import Recording

__all__ = ["judges", "learning_run", "noiseless_pair", "quiet_run"]

JUDGED_S = 300.0
JUDGE_SEED = 400_000
"""Offset of the seed for another drive of the same robot."""
QUIET = Rig(ticks_per_turn=None)


def learning_run(case: Case) -> SimulatedRun:
    """Return the drive to learn from."""
    return simulate(case.seed, case.causes, duration_s=case.duration_s, **_options(case))


def quiet_run(case: Case) -> SimulatedRun:
    """Return the same drive of the robot without the fault."""
    return simulate_without(case.seed, case.causes, duration_s=case.duration_s, **_options(case))


def noiseless_pair(case: Case) -> tuple[SimulatedRun, SimulatedRun]:
    """Return the drive with and without the fault, both without encoder ticks and truth noise."""
    still = replace(TRACKERS[case.truth], noise_m=0.0, noise_rad=0.0, wander_m=0.0)
    options = _options(case) | {"truth": still, "rig": QUIET, "duration_s": case.duration_s}
    return simulate(case.seed, case.causes, **options), simulate_without(case.seed, case.causes, **options)


def judges(case: Case) -> tuple[Recording, Recording]:
    """Return another drive of the same robot, with and without the fault."""
    options = _options(case) | {"duration_s": JUDGED_S, "robot_seed": case.seed}
    seed = case.seed + JUDGE_SEED
    with_flaw, without = simulate(seed, case.causes, **options), simulate_without(seed, case.causes, **options)
    return as_recording(with_flaw, "judged"), as_recording(without, "floor")


def _options(case: Case) -> dict[str, Any]:
    return {
        "size": SIZES.get(case.size, 1.0),
        "truth": case.truth,
        "route": case.route,
        "yaw_from": case.yaw_from,
        "drive_type": case.drive_type,
    }
