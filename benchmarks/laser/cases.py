"""Design of the laser arm, fixed before any run."""

from __future__ import annotations

from laboratory.cases import SYSTEMATIC, Case

__all__ = ["CAUSES", "LEARNED_S", "TRAVEL", "laser_cases", "world_of"]

LEARNED_S = 300.0
MOUNTING = ("lever_arm", "mount_yaw", "icr_shift")
CLOCKS = ("time_offset", "clock_skew")
CAUSES = tuple(c for c in SYSTEMATIC if c not in (*MOUNTING, *CLOCKS))
"""Systematic causes except those aliased with the laser's mounting (as icr_shift is) and clock."""
TURNING = ("wheelbase", "unequal_wheels", "turn_asymmetry", "backlash", "lost_increments", "slip_burst")
"""Causes of the gyro arm that act on turns measured by wheels."""
TRAVEL = ("wheel_scale", "speed_scale")
"""Causes of the gyro arm that need travel to be named; turns of wheels change with them by the same factor."""
GYRO_CAUSES = (*TURNING[:2], TRAVEL[0], *TURNING[2:4], TRAVEL[1], *TURNING[4:])
ROUTES = ("office", "loops", "slalom", "yard", "umbmark")
SIZES = ("strong", "medium")
LENGTHS = {"controls": 60, "single": 2 * len(CAUSES) * 5, "corridor": 20, "gyro": 96}
FIRST_SEED = {"controls": 440_000, "single": 441_000, "corridor": 442_000, "gyro": 449_000}
PILOT = -361_000


def laser_cases(*, pilot: bool = False) -> list[Case]:
    """Return all cases in the order of the run: the arms mixed in proportion."""
    made = [
        (i / LENGTHS[arm], arm, _case(arm, i, FIRST_SEED[arm] + i + (PILOT if pilot else 0)))
        for arm in LENGTHS
        for i in range(LENGTHS[arm])
    ]
    return [case for _, _, case in sorted(made, key=lambda entry: entry[:2])]


def world_of(case: Case) -> str:
    """Return the kind of world of a case: rooms and offices alternately, for each route, cause and size."""
    if case.arm == "corridor":
        return "corridor"
    if case.arm == "controls":
        return ("room", "office")[(case.number + case.number // 10) % 2]
    which, again = case.number % len(CAUSES), case.number // len(CAUSES)
    return ("room", "office")[(which + again // 2) % 2]


def _case(arm: str, i: int, seed: int) -> Case:
    if arm == "controls":
        return Case(arm, i, seed, ROUTES[i % 5], yaw_from=("encoders", "gyro")[i // 5 % 2], duration_s=LEARNED_S)
    if arm == "corridor":
        causes = ((), ("wheel_scale",), ("speed_scale",), ("wheelbase",))[i % 4]
        return Case(arm, i, seed, "shuttle", causes, "strong" if causes else "", duration_s=LEARNED_S)
    if arm == "gyro":
        return _gyro_case(i, seed)
    from laboratory.cases import _heading  # noqa: PLC0415 - the laboratory's own rule

    which, again = i % len(CAUSES), i // len(CAUSES)
    cause = (CAUSES[which],)
    return Case(
        arm, i, seed, ROUTES[(which + again) % 5], cause, SIZES[(which + again) % 2], yaw_from=_heading(cause, again),
        duration_s=LEARNED_S,
    )  # fmt: skip


def _gyro_case(i: int, seed: int) -> Case:
    """Return a drive with wheels and a gyro alone: every third is a control."""
    if i % 3 == 0:
        return Case("gyro", i, seed, ROUTES[i // 3 % 5], duration_s=LEARNED_S)
    which, again = (i - i // 3 - 1) % len(GYRO_CAUSES), (i - i // 3 - 1) // len(GYRO_CAUSES)
    return Case(
        "gyro", i, seed, ROUTES[(which + again) % 5], (GYRO_CAUSES[which],), SIZES[(which + again) % 2],
        duration_s=LEARNED_S,
    )  # fmt: skip
