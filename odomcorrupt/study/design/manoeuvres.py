"""Manoeuvres for identification drives, as speed profiles that fit in a room of a few metres."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import cycle
from math import pi
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

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
Part: TypeAlias = "Callable[[Limits], Iterable[Step]]"


@dataclass(frozen=True, slots=True)
class Manoeuvre:
    """One round of a drive, repeated as often as needed.

    sentence : description, after "drive" or "then"
    parts : the moves of a round, each a function of the limits
    least_s : shortest informative duration, seconds
    """

    name: str
    sentence: str
    parts: Sequence[Part]
    least_s: float = 120.0

    def round(self, limits: Limits) -> Iterator[Step]:
        """Yield the steps within given limits, endlessly."""
        for part in cycle(self.parts):
            yield from part(limits)


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


def _go(metres: float, part: float = 1.0, accelerations: tuple[float, float] = _GENTLE) -> Part:
    """Return a straight at a part of the largest speed."""
    return lambda limits: straight(metres, part * limits.v_mps, accelerations)


def _turn(angle_rad: float, part: float = 1.0, accelerations: tuple[float, float] = _GENTLE) -> Part:
    """Return a turn on the spot at a part of the largest rate."""
    return lambda limits: turn(angle_rad, part * limits.omega_radps, accelerations)


def _arc(angle_rad: float, part: float = 1.0, omega_part: float = 1.0) -> Part:
    """Return a bend without stops before and after it, at parts of the highest speeds in a radius of about 1 m."""

    def steps(limits: Limits) -> list[Step]:
        v_mps = part * min(limits.v_mps, 1.2 * limits.omega_radps)
        omega_radps = omega_part * min(limits.omega_radps, limits.v_mps / 0.8)
        # A change of sides turns by half a ramp at each end.
        hold_s = max(abs(angle_rad) / omega_radps - omega_radps / _GENTLE[1], 0.2)
        return [Hold(v_mps, omega_radps if angle_rad > 0.0 else -omega_radps, hold_s)]

    return steps


def _rest(seconds: float) -> Part:
    return lambda _: [Hold(0.0, 0.0, seconds)]


def _home(_: Limits) -> list[Step]:
    return [HOME]


def _circles(part: float, omega_part: float) -> list[Part]:
    """Return one circle to the left and one to the right, which end a little ahead of their start."""
    return [_arc(side * 2.0 * pi, part, omega_part) for side in _SIDES]


def _eight(side: float) -> list[Part]:
    """Return two figures of eight, the second mirrored so that it ends where the first began."""
    return [_arc(side * 2.0 * pi), _arc(-side * 3.0 * pi)] * 2


_SIDES = (1.0, -1.0)
_LINE = _go(LINE_M)
# fmt: off
MANOEUVRES: tuple[Manoeuvre, ...] = (
    Manoeuvre("stands", "straights with stops of half a minute between them",
              [p for s in _SIDES for p in (_rest(30.0), _LINE, _rest(30.0), _turn(s * pi), _LINE, _turn(s * pi))]),
    Manoeuvre("there_and_back", "straight there, and straight back in reverse", [_LINE, _go(-LINE_M, 0.6)]),
    Manoeuvre("two_speeds", "the same straight slowly and fast",
              [p for k, s in zip((_SLOW, 1.0, 1.0, 1.0), _SIDES * 2, strict=True)
               for p in (_go(LINE_M, k), _turn(s * pi))]),
    Manoeuvre("there_and_back_at_two_speeds", "straight there and back in reverse, slowly and fast",
              [p for k in (_SLOW, 1.0, 1.0, 1.0) for way in (LINE_M, -LINE_M) for p in (_go(way, k), _rest(2.0))]),
    Manoeuvre("spins", "turns on the spot, left and right, slowly and fast",
              [p for k in (1.0, 0.4) for p in (_turn(2.0 * pi, k), _turn(-2.0 * pi, k), _rest(1.0))]),
    Manoeuvre("squares", "squares with corners on the spot, to the left and to the right in turn",
              [p for s in _SIDES for p in [_go(0.75 * LINE_M), _turn(s * 0.5 * pi)] * 4]),
    Manoeuvre("eights", "figures of eight", [p for s in _SIDES for p in (*_eight(s), _home)]),
    Manoeuvre("eights_at_two_speeds", "figures of eight, slowly and fast",
              [p for s in _SIDES for p in (*_eight(s), *_circles(_SLOW, _SLOW), _home)]),
    # at one rate and three speeds, to separate effects of v omega and of omega
    Manoeuvre("turns_apart", "the same turn on the spot, in a tight bend and in a wide one, both ways",
              [p for s in _SIDES for p in (*_circles(0.0, 1.0), *_circles(_SLOW, 1.0), *_eight(s), _home)]),
    Manoeuvre("hard", "short straights with hard starts and hard braking, and turns on the spot between them",
              [p for k, s in ((1.0, 1.0), (0.5, -1.0))
               for p in [_go(0.4 * LINE_M, k, _HARD)] * 3 + [_turn(s * pi, 1.0, _HARD)]]),
    Manoeuvre("star", "straights in eight headings, with turns on the spot between them", [_LINE, _turn(0.75 * pi)]),
    Manoeuvre("everything", "a mixture: straights, bends and turns, slow, fast and in reverse",
              [p for s in _SIDES for p in (
                  _go(LINE_M, _SLOW), _turn(s * pi), _LINE, _go(-0.5 * LINE_M, 0.5), _rest(10.0),
                  _arc(s * 2.0 * pi, _SLOW, _SLOW), _arc(s * 2.0 * pi), _rest(0.5),
                  _go(0.4 * LINE_M, 1.0, _HARD), _turn(s * 1.5 * pi), _home,
              )]),
    Manoeuvre("loop", "one loop, repeated", [*[_go(0.75 * LINE_M), _arc(0.5 * pi)] * 4, _home], least_s=600.0),
)
# fmt: on
