"""Manoeuvres for identification drives, as speed profiles that fit in a room of a few metres."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import cycle
from math import pi
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_GENTLE = (0.5, 1.2)
_HARD = (2.0, 4.0)
LINE_M = 4.0
_SLOW = 0.3
"""Ratio of slow to fast."""


class Limits(NamedTuple):
    """Largest speed, m/s, and turn rate, rad/s, for a robot: observed ones within harmless bounds."""

    v_mps: float
    omega_radps: float


class Hold(NamedTuple):
    """A change to given speeds at given accelerations (m/s^2, rad/s^2), then constant speeds for a time."""

    v_mps: float
    omega_radps: float
    hold_s: float
    accelerations: tuple[float, float] = _GENTLE


HOME: Literal["home"] = "home"
"""A step of a round: stop, turn towards the start and drive there, because bends without stops do not end there."""
Step: TypeAlias = "Hold | Literal['home']"


@dataclass(frozen=True, slots=True)
class Manoeuvre:
    """One round of a drive, repeated as often as needed.

    sentence : description, after "drive" or "then"
    round : endless iterator of steps within given limits
    least_s : shortest informative duration, seconds
    """

    name: str
    sentence: str
    round: Callable[[Limits], Iterator[Step]]
    least_s: float = 120.0


def straight(way_m: float, v_mps: float, accelerations: tuple[float, float] = _GENTLE) -> Iterator[Hold]:
    """Yield a straight of given length (negative: backwards), from rest to rest."""
    ramp_s = v_mps / accelerations[0]
    sign = 1.0 if way_m > 0.0 else -1.0
    yield Hold(sign * v_mps, 0.0, max(abs(way_m) / v_mps - ramp_s, 0.2), accelerations)
    yield Hold(0.0, 0.0, 0.5, accelerations)


def turn(angle_rad: float, omega_radps: float, accelerations: tuple[float, float] = _GENTLE) -> Iterator[Hold]:
    """Yield a turn on the spot by a given angle, from rest to rest."""
    ramp_s = omega_radps / accelerations[1]
    sign = 1.0 if angle_rad > 0.0 else -1.0
    yield Hold(0.0, sign * omega_radps, max(abs(angle_rad) / omega_radps - ramp_s, 0.2), accelerations)
    yield Hold(0.0, 0.0, 0.5, accelerations)


def _arc(angle_rad: float, v_mps: float, omega_radps: float) -> Iterator[Hold]:
    """Yield a bend without stops before and after it."""
    # A change of sides turns by half a ramp at each end.
    hold_s = max(abs(angle_rad) / omega_radps - omega_radps / _GENTLE[1], 0.2)
    yield Hold(v_mps, omega_radps if angle_rad > 0.0 else -omega_radps, hold_s)


def _bend(limits: Limits) -> Limits:
    """Return the highest speeds in a bend of a radius of about 1 m."""
    return Limits(min(limits.v_mps, 1.2 * limits.omega_radps), min(limits.omega_radps, limits.v_mps / 0.8))


def _stands(limits: Limits) -> Iterator[Hold]:
    for side in cycle((1.0, -1.0)):
        yield Hold(0.0, 0.0, 30.0)
        yield from straight(LINE_M, limits.v_mps)
        yield Hold(0.0, 0.0, 30.0)
        yield from turn(side * pi, limits.omega_radps)
        yield from straight(LINE_M, limits.v_mps)
        yield from turn(side * pi, limits.omega_radps)


def _there_and_back(limits: Limits) -> Iterator[Hold]:
    while True:
        yield from straight(LINE_M, limits.v_mps)
        yield from straight(-LINE_M, 0.6 * limits.v_mps)


def _two_speeds(limits: Limits) -> Iterator[Hold]:
    for part, side in cycle(((_SLOW, 1.0), (1.0, -1.0), (1.0, 1.0), (1.0, -1.0))):
        yield from straight(LINE_M, part * limits.v_mps)
        yield from turn(side * pi, limits.omega_radps)


def _there_and_back_at_two_speeds(limits: Limits) -> Iterator[Hold]:
    for part in cycle((_SLOW, 1.0, 1.0, 1.0)):
        yield from straight(LINE_M, part * limits.v_mps)
        yield Hold(0.0, 0.0, 2.0)
        yield from straight(-LINE_M, part * limits.v_mps)
        yield Hold(0.0, 0.0, 2.0)


def _spins(limits: Limits) -> Iterator[Hold]:
    for part in cycle((1.0, 0.4)):
        yield from turn(2.0 * pi, part * limits.omega_radps)
        yield from turn(-2.0 * pi, part * limits.omega_radps)
        yield Hold(0.0, 0.0, 1.0)


def _squares(limits: Limits) -> Iterator[Hold]:
    for side in cycle((1.0, -1.0)):
        for _ in range(4):
            yield from straight(0.75 * LINE_M, limits.v_mps)
            yield from turn(side * 0.5 * pi, limits.omega_radps)


def _pair(v_mps: float, omega_radps: float) -> Iterator[Hold]:
    """Yield one circle to the left and one to the right, which end a little ahead of their start."""
    for side in (1.0, -1.0):
        yield from _arc(side * 2.0 * pi, v_mps, omega_radps)


def _eight(v_mps: float, omega_radps: float, side: float) -> Iterator[Hold]:
    """Yield two figures of eight, the second mirrored so that it ends where the first began."""
    for _ in range(2):
        yield from _arc(side * 2.0 * pi, v_mps, omega_radps)
        yield from _arc(-side * 3.0 * pi, v_mps, omega_radps)


def _eights(limits: Limits, *, slow_too: bool = False) -> Iterator[Step]:
    v, omega = _bend(limits)
    for side in cycle((1.0, -1.0)):
        yield from _eight(v, omega, side)
        if slow_too:
            yield from _pair(_SLOW * v, _SLOW * omega)
        yield HOME


def _turns_apart(limits: Limits) -> Iterator[Step]:
    """Yield turns at one rate and three speeds (zero, low, high), to separate effects of v omega and of omega."""
    v, omega = _bend(limits)
    for side in cycle((1.0, -1.0)):
        yield from _pair(0.0, omega)
        yield from _pair(_SLOW * v, omega)
        yield from _eight(v, omega, side)
        yield HOME


def _hard(limits: Limits) -> Iterator[Hold]:
    for part, side in cycle(((1.0, 1.0), (0.5, -1.0))):
        for _ in range(3):
            yield from straight(0.4 * LINE_M, part * limits.v_mps, _HARD)
        yield from turn(side * pi, limits.omega_radps, _HARD)


def _star(limits: Limits) -> Iterator[Hold]:
    while True:
        yield from straight(LINE_M, limits.v_mps)
        yield from turn(0.75 * pi, limits.omega_radps)


def _everything(limits: Limits) -> Iterator[Step]:
    (v, omega), bend = limits, _bend(limits)
    for side in cycle((1.0, -1.0)):
        yield from straight(LINE_M, _SLOW * v)
        yield from turn(side * pi, omega)
        yield from straight(LINE_M, v)
        yield from straight(-0.5 * LINE_M, 0.5 * v)
        yield Hold(0.0, 0.0, 10.0)
        yield from _arc(side * 2.0 * pi, _SLOW * bend.v_mps, _SLOW * bend.omega_radps)
        yield from _arc(side * 2.0 * pi, *bend)
        yield Hold(0.0, 0.0, 0.5)
        yield from straight(0.4 * LINE_M, v, _HARD)
        yield from turn(side * 1.5 * pi, omega)
        yield HOME


def _loop(limits: Limits) -> Iterator[Step]:
    while True:
        for _ in range(4):
            yield from straight(0.75 * LINE_M, limits.v_mps)
            yield from _arc(0.5 * pi, *_bend(limits))
        yield HOME


MANOEUVRES: tuple[Manoeuvre, ...] = (
    Manoeuvre("stands", "straights with stops of half a minute between them", _stands),
    Manoeuvre("there_and_back", "straight there, and straight back in reverse", _there_and_back),
    Manoeuvre("two_speeds", "the same straight slowly and fast", _two_speeds),
    Manoeuvre(
        "there_and_back_at_two_speeds",
        "straight there and back in reverse, slowly and fast",
        _there_and_back_at_two_speeds,
    ),
    Manoeuvre("spins", "turns on the spot, left and right, slowly and fast", _spins),
    Manoeuvre("squares", "squares with corners on the spot, to the left and to the right in turn", _squares),
    Manoeuvre("eights", "figures of eight", _eights),
    Manoeuvre("eights_at_two_speeds", "figures of eight, slowly and fast", partial(_eights, slow_too=True)),
    Manoeuvre("turns_apart", "the same turn on the spot, in a tight bend and in a wide one, both ways", _turns_apart),
    Manoeuvre("hard", "short straights with hard starts and hard braking, and turns on the spot between them", _hard),
    Manoeuvre("star", "straights in eight headings, with turns on the spot between them", _star),
    Manoeuvre("everything", "a mixture: straights, bends and turns, slow, fast and in reverse", _everything),
    Manoeuvre("loop", "one loop, repeated", _loop, least_s=600.0),
)
