"""Design of the study, fixed before any run: arms, causes, sizes, routes and seeds.

The order within an arm is such that any initial part is balanced over causes, sizes and routes. The arms are mixed in
proportion to their lengths, so that a run that is cut short is a smaller sample of the same design.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from odomcorrupt.effects import registry
from odomcorrupt.simulation import CAUSES, OUTSIDE, ROUTES
from odomcorrupt.simulation.faults import EVERY, SIZES

__all__ = ["ARMS", "CLOCKS", "LENGTHS", "PILOT", "RANDOM", "SYSTEMATIC", "Case", "cases", "same_class"]

RANDOM = ("gauss_markov", "gyro_bias_walk", "heavy_tails", "lost_increments", "quantization", "slip_burst")
CLOCKS = ("clock_skew", "time_offset")
SYSTEMATIC = tuple(sorted(set(CAUSES) - set(RANDOM)))
"""Causes in the library that are always active: geometry, sensors, contact and clocks."""
KNOWN_AS = {
    "wet_patch": "region_slip", "wet_strip": "region_slip", "eccentric_wheel": "flat_spot",
    "magnetic_heading": "hard_iron",
}  # fmt: skip
"""Causes that are separate in the simulator, and their name in the library."""
SINGLE = (*SYSTEMATIC, *KNOWN_AS)
UNKNOWN = tuple(sorted(set(OUTSIDE) - set(KNOWN_AS)))
"""Causes without an effect in the library."""
FIRST_SEED = {
    "controls": 520_000, "rtk": 520_300, "single": 521_000, "noise": 521_300, "outside": 521_400, "mixtures": 521_500,
    "noisy_mixtures": 521_600, "invariance": 521_700, "planted": 521_800, "body": 521_900,
}  # fmt: skip
"""First seed of each arm, not used by any test, fixture, pilot or earlier run."""
LENGTHS = {
    "controls": 200, "rtk": 60, "single": 180, "noise": 36, "outside": 45, "mixtures": 60, "noisy_mixtures": 20,
    "invariance": 5, "planted": 12, "body": 7,
}  # fmt: skip
ARMS = tuple(LENGTHS)
FIRST = {
    "controls": 102, "rtk": 30, "single": 66, "noise": 18, "outside": 15, "mixtures": 42, "noisy_mixtures": 6,
    "invariance": 5, "planted": 12, "body": 7,
}  # fmt: skip
"""Number of cases of each arm that are run before all others, in case the run is cut short."""
PILOT = 9_000 - 520_000
"""Offset of a pilot's seeds, so that they are never fresh ones."""
PLANTS = ("wheel_scale", "unequal_wheels", "gyro_bias", "wheelbase")
BODIES = (
    "larger_right_wheel", "larger_wheels", "wider_axle", "soft_tyres", "one_sided_load", "slippery_patch",
    "tilted_floor",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Case:
    """One drive to be learned from.

    causes : faults of the robot; the planted effect in the arm "planted", the built cause in "body"
    size : a key of the laboratory's sizes, or "" if not applicable
    """

    arm: str
    number: int
    seed: int
    route: str
    causes: tuple[str, ...] = ()
    size: str = ""
    truth: str = "mocap"
    yaw_from: str = "encoders"
    drive_type: str = "differential"
    duration_s: float = 600.0

    @property
    def key(self) -> str:
        """Name of the case in the results file."""
        return f"{self.arm}/{self.number}"


def same_class(name: str) -> str:
    """Return the common name of all effects with exactly the same f."""
    name = KNOWN_AS.get(name, name)
    kind = registry().get(name)
    return (kind.aliased_with if kind is not None else None) or name


def cases(*, pilot: bool = False) -> list[Case]:
    """Return all cases in the order of the run."""
    shift = PILOT if pilot else 0
    made = [_case(arm, i, FIRST_SEED[arm] + shift + i) for arm in ARMS for i in range(LENGTHS[arm])]
    return sorted(made, key=_turn)


def _turn(case: Case) -> tuple[bool, float, int]:
    """Return the sort key of a case: first parts of all arms in proportion, then the rest likewise."""
    first = FIRST[case.arm]
    late = case.number >= first
    part = (case.number - first) / (LENGTHS[case.arm] - first) if late else (case.number + 0.5) / first
    return late, part, ARMS.index(case.arm)


def _case(arm: str, i: int, seed: int) -> Case:
    routes, sizes = list(ROUTES), list(SIZES)
    if arm in ("controls", "rtk"):
        return Case(
            arm, i, seed, routes[i % 6],
            truth="rtk" if arm == "rtk" else "mocap",
            yaw_from=("encoders", "gyro")[i // 6 % 2],
            drive_type="skid" if i // 12 % 3 == 2 else "differential",
        )  # fmt: skip
    if arm in ("single", "noise", "outside"):
        names = {"single": SINGLE, "noise": RANDOM, "outside": UNKNOWN}[arm]
        which, again = i % len(names), i // len(names)
        third, rep = again % 3, again // 3
        return Case(
            arm, i, seed, routes[(which + third + 3 * rep) % 6], (names[which],), sizes[(which + third + rep) % 3],
            yaw_from=_heading((names[which],), rep),
            drive_type="skid" if rep == 1 else "differential",
        )  # fmt: skip
    if arm in ("mixtures", "noisy_mixtures"):
        pair = _pair(i, noisy=arm == "noisy_mixtures")
        return Case(arm, i, seed, routes[i % 6], pair, sizes[(i + i // 6) % 3], yaw_from=_heading(pair, i))
    if arm == "invariance":
        return Case(arm, i, seed, routes[i], (("wheelbase",), ("side_slip",), (), ("lever_arm",), ("gyro_bias",))[i],
                    "medium" if i != 2 else "", yaw_from="gyro" if i == 4 else "encoders")  # fmt: skip
    if arm == "planted":
        return Case(arm, i, seed, "real", (PLANTS[(i + i // 4) % 4],))
    return Case(arm, i, seed, "office", (BODIES[i],))


def _heading(causes: tuple[str, ...], turn: int) -> str:
    """Return a heading source with which all of these causes are visible; alternating if both would do."""
    usable = [source for source in ("encoders", "gyro") if all(source in EVERY[c].shows_with for c in causes)]
    return usable[turn % len(usable)]


def _pair(i: int, *, noisy: bool) -> tuple[str, str]:
    """Return two random causes that are visible with the same heading source and are not aliases."""
    rng = np.random.default_rng((51, i, noisy))
    while True:
        first, second = (str(n) for n in (rng.choice(SYSTEMATIC), rng.choice(RANDOM if noisy else SYSTEMATIC)))
        shared = set(EVERY[first].shows_with) & set(EVERY[second].shows_with)
        if shared and same_class(first) != same_class(second):
            return first, second
