"""Routes with names: each a plan of speeds that begins and ends at rest."""

from collections.abc import Callable, Iterator
from itertools import cycle

import numpy as np

from odomcorrupt.simulation.route import Segment, draw_route

SQUARE_M = 4.0
EASY_MPS2 = 0.5
EASY_RADPS2 = 1.2


def _stand(hold_s: float) -> Segment:
    return Segment(0.0, 0.0, hold_s, 0.6)


def _ahead(way_m: float, v_mps: float) -> Iterator[Segment]:
    """Drive so far (negative: backwards), from rest to rest."""
    ramp_s = 1.5 * v_mps / EASY_MPS2
    if abs(way_m) < v_mps * ramp_s:
        v_mps = float(np.sqrt(abs(way_m) * EASY_MPS2 / 1.5))
        ramp_s = 1.5 * v_mps / EASY_MPS2
    yield Segment(float(np.copysign(v_mps, way_m)), 0.0, max(abs(way_m) / v_mps - ramp_s, 0.0), ramp_s)
    yield Segment(0.0, 0.0, 0.3, ramp_s)


def _spin(angle_rad: float, omega_radps: float) -> Iterator[Segment]:
    """Turn on the spot by so much, from rest to rest."""
    ramp_s = 1.5 * omega_radps / EASY_RADPS2
    if abs(angle_rad) < omega_radps * ramp_s:
        omega_radps = float(np.sqrt(abs(angle_rad) * EASY_RADPS2 / 1.5))
        ramp_s = 1.5 * omega_radps / EASY_RADPS2
    hold_s = max(abs(angle_rad) / omega_radps - ramp_s, 0.0)
    yield Segment(0.0, float(np.copysign(omega_radps, angle_rad)), hold_s, ramp_s)
    yield Segment(0.0, 0.0, 0.3, ramp_s)


def _loops(rng: np.random.Generator) -> Iterator[Segment]:
    """Drive rounded rectangles, two laps to the left, two to the right, each lap at a speed of its own."""
    long_m, short_m, bend_m = rng.uniform(3.0, 6.0), rng.uniform(1.5, 3.0), rng.uniform(0.7, 1.3)
    for side in cycle((1.0, -1.0)):
        for _ in range(2):
            v_mps = float(rng.uniform(0.3, min(1.0, np.sqrt(0.8 * bend_m))))
            ease_s = 0.4
            for leg_m in (long_m, short_m, long_m, short_m):
                yield Segment(v_mps, 0.0, leg_m / v_mps, 1.0 + v_mps)
                yield Segment(v_mps, side * v_mps / bend_m, 0.5 * np.pi * bend_m / v_mps - ease_s, ease_s)
                yield Segment(v_mps, 0.0, 0.1, ease_s)
        yield Segment(0.0, 0.0, rng.uniform(1.0, 4.0), 1.5)


def _shuttle(rng: np.random.Generator) -> Iterator[Segment]:
    """Go straight ahead and straight back, never turning."""
    while True:
        way_m, there_mps, back_mps = rng.uniform(2.0, 7.0), rng.uniform(0.2, 1.1), rng.uniform(0.2, 0.8)
        yield from _ahead(way_m, there_mps)
        yield _stand(rng.uniform(0.5, 3.0))
        yield from _ahead(-way_m, back_mps)
        yield _stand(rng.uniform(0.5, 3.0))


def _slalom(rng: np.random.Generator) -> Iterator[Segment]:
    """Weave between poles, there and back, each time at another speed."""
    for v_mps in cycle((0.3, 0.6, 0.9, 0.45)):
        poles, swing_rad = 2 * int(rng.integers(2, 4)), rng.uniform(0.6, 1.1)
        omega_radps = rng.uniform(0.5, 0.65) / max(v_mps, 0.5)
        for side in (1.0, -1.0):
            yield Segment(v_mps, 0.0, 0.5, 1.5 * v_mps / EASY_MPS2)
            for pole in range(poles + 1):
                swing_s = (2.0 if 0 < pole < poles else 1.0) * swing_rad / omega_radps
                yield Segment(v_mps, side * (-1.0) ** pole * omega_radps, max(swing_s - 0.5, 0.05), 0.5)
            yield Segment(v_mps, 0.0, 0.5, 0.5)
            yield _stand(rng.uniform(0.5, 2.0))
            yield from _spin(np.pi * rng.choice((-1.0, 1.0)), 0.8)


def _yard(rng: np.random.Generator) -> Iterator[Segment]:
    """Turn on the spot, go a little way, perhaps back off: a yard full of pallets."""
    while True:
        for _ in range(int(rng.integers(1, 3))):
            yield from _spin(rng.choice((-1.0, 1.0)) * rng.uniform(0.5, 3.2), rng.uniform(0.3, 1.2))
            yield _stand(rng.uniform(0.2, 1.0))
        way_m = rng.uniform(0.6, 2.5)
        yield from _ahead(way_m, rng.uniform(0.3, 0.9))
        yield _stand(rng.uniform(0.2, 1.5))
        if rng.random() < 0.6:
            yield from _ahead(-way_m * rng.uniform(0.5, 1.0), rng.uniform(0.2, 0.5))


def _umbmark(rng: np.random.Generator) -> Iterator[Segment]:
    """Drive squares of 4 m with corners on the spot, five clockwise, five the other way, over and over."""
    v_mps, omega_radps = rng.uniform(0.4, 0.6), rng.uniform(0.6, 0.9)
    for side in cycle((-1.0,) * 5 + (1.0,) * 5):
        for _ in range(4):
            yield from _ahead(SQUARE_M, v_mps)
            yield from _spin(side * 0.5 * np.pi, omega_radps)
        yield _stand(1.5)


def _until(duration_s: float, moves: Iterator[Segment]) -> tuple[Segment, ...]:
    """Cut a plan so that the robot stands before the end."""
    plan, left_s = [Segment(0.0, 0.0, 1.0, 1.0)], duration_s - 5.0
    for segment in moves:
        left_s -= segment.ramp_s + segment.hold_s
        if left_s < 0:
            break
        plan.append(segment)
    return (*plan, Segment(0.0, 0.0, np.inf, 2.0))


ROUTES: dict[str, Callable[[float, np.random.Generator], tuple[Segment, ...]]] = {
    "office": draw_route,
    "loops": lambda duration_s, rng: _until(duration_s, _loops(rng)),
    "shuttle": lambda duration_s, rng: _until(duration_s, _shuttle(rng)),
    "slalom": lambda duration_s, rng: _until(duration_s, _slalom(rng)),
    "yard": lambda duration_s, rng: _until(duration_s, _yard(rng)),
    "umbmark": lambda duration_s, rng: _until(duration_s, _umbmark(rng)),
}
"""Name, and what draws the route: its duration, s, and its random stream in, segments out."""
