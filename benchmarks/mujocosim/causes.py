"""What can be wrong with the body or its floor: how large, how it is built, and how the answer calls it.

Where the effects' table has a name for it, the answer uses that name and gives what the standing wheels measure.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from mujocosim.body import RADIUS_M, TRACK_M, Body, Standing

Drawn = dict[str, float]
G = 9.81
SOFT_S = 0.04
"""Time constant of soft tyres: they give 0.4 mm under 60 N, and creep visibly."""


@dataclass(frozen=True, slots=True)
class Cause:
    """Drawn parameters, the body they make, and the answer read off the standing body."""

    draw: Callable[[np.random.Generator], Drawn]
    spoil: Callable[[Body, Drawn], Body]
    answer: Callable[[Standing, Drawn], Mapping[str, Drawn]]


def _signed(low: float, high: float, rng: np.random.Generator) -> float:
    return float(rng.choice((-1.0, 1.0)) * rng.uniform(low, high))


def _yielding(p: Drawn) -> Mapping[str, Drawn]:
    """Name what soft contact does in turns: a sideways speed dies away within half of its time constant.

    Along, it is a lag of the same length (slip speed in proportion to acceleration), for which there is no name.
    """
    return {"side_slip": {"k": 0.49 * p["softness"]}} if "softness" in p else {}


def _measured(standing: Standing, drawn: Drawn) -> Mapping[str, Drawn]:
    """Name what the rolling radii say, by what the driver believes of them."""
    right_m, left_m = standing.rolling_m
    known = {
        "unequal_wheels": {"curvature": float((right_m - left_m) / (RADIUS_M * TRACK_M))},
        "wheel_scale": {"e": float(0.5 * (right_m + left_m) / RADIUS_M - 1.0)},
    }
    sizes = {"unequal_wheels": abs(right_m - left_m) / RADIUS_M, "wheel_scale": abs(known["wheel_scale"]["e"])}
    return {name: known[name] for name in known if sizes[name] > 1e-4} | _yielding(drawn)


def _named(name: str) -> Callable[[Standing, Drawn], Mapping[str, Drawn]]:
    return lambda _, drawn: {name: drawn}


def _tilt(body: Body, p: Drawn) -> Body:
    pull = G * np.sin(p["angle"])
    down = (pull * np.cos(p["direction"]), pull * np.sin(p["direction"]), -G * np.cos(p["angle"]))
    return replace(body, softness_s=p["softness"], gravity=tuple(float(part) for part in down))


CAUSES: dict[str, Cause] = {
    "larger_right_wheel": Cause(
        lambda rng: {"e": rng.uniform(0.002, 0.006)},
        lambda body, p: replace(body, radius_right_m=RADIUS_M * (1 + p["e"])),
        _measured,
    ),
    "larger_wheels": Cause(
        lambda rng: {"e": _signed(0.005, 0.02, rng)},
        lambda body, p: replace(body, radius_right_m=RADIUS_M * (1 + p["e"]), radius_left_m=RADIUS_M * (1 + p["e"])),
        _measured,
    ),
    "wider_axle": Cause(
        lambda rng: {"e": _signed(0.01, 0.04, rng)},
        lambda body, p: replace(body, track_m=TRACK_M * (1 + p["e"])),
        _named("wheelbase"),
    ),
    "soft_tyres": Cause(
        lambda _: {"softness": SOFT_S},
        lambda body, p: replace(body, softness_s=p["softness"]),
        lambda _, drawn: _yielding(drawn),
    ),
    "one_sided_load": Cause(
        lambda rng: {"softness": SOFT_S, "mass": rng.uniform(4.0, 8.0), "y": _signed(0.1, 0.14, rng)},
        lambda body, p: replace(body, softness_s=p["softness"], load_kg=p["mass"], load_y_m=p["y"]),
        _measured,
    ),
    "slippery_patch": Cause(
        lambda rng: {"x": rng.uniform(0.5, 2.0), "y": 0.0, "radius": rng.uniform(0.8, 1.5), "friction": 0.05},
        lambda body, p: replace(body, patch=(p["x"], p["y"], p["radius"], p["friction"])),
        _named("slippery_patch"),
    ),
    "tilted_floor": Cause(
        lambda rng: {
            "softness": SOFT_S,
            "angle": np.radians(rng.uniform(2.0, 5.0)),
            "direction": rng.uniform(-np.pi, np.pi),
        },
        _tilt,
        _named("tilted_floor"),
    ),
}
"""`soft_tyres` is no flaw but the control of `one_sided_load` and `tilted_floor`: soft contact has a bias of its own.

On a tilted floor the body creeps even while it stands, unlike rubber, and hardly at all (0.03 mm/s at 5 degrees): as a
cause it is next to nothing, and says so.
"""
