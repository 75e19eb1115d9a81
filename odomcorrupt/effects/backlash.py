"""Gear backlash: after each reversal the motor turns a little before the wheel does."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from odomcorrupt.effects.effect import About, Effect, Motion, Recorded, State, TwistError, parameter
from odomcorrupt.effects.wheels import (
    Rims,
    body_of,
    heading_choice,
    needed_track_m,
    on_every_track,
    rims_of,
    track_parameter,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.random import Generator

    from odomcorrupt.geometry.se2 import Array

SWAY_M = 1e-4
"""Smallest backward travel of a wheel that counts as a reversal, metres: parked robots sway and cross no play."""


class _Gear(NamedTuple):
    """State of a gear: motor position in the play, metres from its middle; side is 0 before the first wheel motion."""

    place: float
    side: float


AT_REST = _Gear(0.0, 0.0)
"""State before the first wheel motion."""


@dataclass(frozen=True, slots=True)
class Backlash(Effect):
    """f_wheel = -u while the motor crosses the play: `travel` is lost at each reversal of a wheel.

    The encoder is on the motor. The play operator acts on the motor's travel, after a small elastic sway. The gears are
    in contact at the first motion. In corruption the play is crossed instantly, because the clean robot does not wait
    for it.
    """

    name = "backlash"
    odd = True
    layer = "record"
    needs_track = True
    summary = "gears have play: travel is lost at each reversal of a wheel"
    about = About(
        equation="f_wheel = -u while the motor crosses the play, 0 in touch; u the rim speed; no yaw with a gyro",
        typical="2 to 15 mm at the rim (1 to 8 degrees at the wheel; an estimate)",
        source="the play operator, as in Visintin 1994, Differential Models of Hysteresis",
        confused_with=("time_offset", "accel_slip"),
        drive="drive forth and back, and turn on the spot after straights, many times",
    )

    travel: float = parameter("m", "lost at each reversal of a wheel", low=0.0, high=0.05, typical=0.005, step=0.004)
    heading: str = heading_choice()
    track: float = track_parameter()

    @classmethod
    def scan(cls, motions: Sequence[Motion]) -> tuple[Self, ...]:
        """Return the effect, on each trial track if the robot's track is unknown."""
        return on_every_track((cls(),), motions)

    @property
    def lost_m(self) -> float:
        """Bound on the uncorrectable error, metres: with a gyro, odometry has only the mean of both motors' travel."""
        return 0.0 if self.heading == "wheels" else abs(self.travel)

    def first_reversals(self, motion: Motion) -> tuple[int, int]:
        """Return the intervals in which the right and the left wheel first reverse; their number, if never."""
        track = needed_track_m(self.name, self.track or motion.track_m)
        sides = (_sides(u * motion.dt_s, AT_REST)[0] for u in rims_of(motion.v, motion.omega, track))
        right, left = (int(np.argmax(np.append(np.diff(side) != 0.0, True))) for side in sides)
        return right, left

    def start(self, rng: Generator) -> State:  # noqa: ARG002 - nothing is drawn
        """Return the state before the first motion of both wheels."""
        return AT_REST, AT_REST

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: minus the motor speed within the play; for negative `travel` (numerical slopes), its opposite."""
        track = needed_track_m(self.name, self.track or motion.track_m)
        width, sign = abs(self.travel), np.sign(self.travel)
        rate = np.divide(1.0, motion.dt_s, out=np.zeros_like(motion.dt_s), where=motion.dt_s > 0.0)
        lost, gears = [], []
        for u, gear in zip(rims_of(motion.v, motion.omega, track), state, strict=True):
            inside, after = crossed(u * motion.dt_s, gear, width)
            lost.append(-sign * inside * rate)
            gears.append(after)
        return TwistError(body_of(Rims(*lost), track, self.heading), tuple(gears))

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002 - at any time
        """Return the motors' increments: those of the wheels, plus the whole play when a wheel reverses."""
        track = needed_track_m(self.name, self.track or track_m)
        extra, gears = [], []
        for travel, gear in zip(rims_of(steps[:, 0], steps[:, 2], track), state, strict=True):
            side, after = _sides(travel, gear)
            extra.append(0.5 * self.travel * np.diff(side))
            gears.append(after)
        return Recorded(steps + body_of(Rims(*extra), track, self.heading), tuple(gears))


def crossed(travel: Array, gear: _Gear, width: float) -> tuple[Array, _Gear]:
    """Return the part (n,) of a motor's travel that is spent inside the play, and the gear's state after it.

    The position is clipped to half the play plus the sway on both sides; within the play the wheel does not move.
    """
    half = 0.5 * width
    before, first, side = _first_touch(travel, gear)
    if not side:
        return np.zeros(len(travel)), _Gear(before, 0.0)
    # the gears are in contact at the first motion: nothing is lost
    start = gear.place if gear.side else side * (half + SWAY_M)
    places = _bounded(start, travel[first:], half + SWAY_M)
    inside = np.zeros(len(travel))
    inside[first:] = np.diff(np.clip(places, -half, half))
    return inside, _Gear(float(places[-1]), side)


def _sides(travel: Array, gear: _Gear) -> tuple[Array, _Gear]:
    """Return the side of the play (n + 1,) touched by a wheel's gears, 1 or -1; first before the first increment."""
    before, first, side = _first_touch(travel, gear)
    if not side:
        return np.zeros(len(travel) + 1), _Gear(before, 0.0)
    start = gear.place if gear.side else side * SWAY_M
    places = _bounded(start, travel[first:], SWAY_M)
    # exactly in the middle, the gears keep their side
    known = np.flatnonzero(np.concatenate(([True], places[1:] != 0.0)))
    signs = np.concatenate(([side], np.sign(places[1:])))
    touched = signs[known[np.searchsorted(known, np.arange(len(places)), side="right") - 1]]
    return np.concatenate((np.full(first, side), touched)), _Gear(float(places[-1]), float(touched[-1]))


def _first_touch(travel: Array, gear: _Gear) -> tuple[float, int, float]:
    """Return the position so far, the index of the first increment in contact, and its side (0: no contact yet)."""
    if gear.side:
        return gear.place, 0, gear.side
    places = np.cumsum(np.concatenate(([gear.place], travel)))
    moved = np.abs(places) >= SWAY_M
    if not moved.any():
        return float(places[-1]), len(travel), 0.0
    first = int(np.argmax(moved))
    return float(places[first]), first, float(np.sign(places[first]))


def _bounded(start: float, travel: Array, top: float) -> Array:
    """Return positions (n + 1,) that follow the travel, clipped to +- top after every step."""
    count, step, places = len(travel), travel.item, np.empty(len(travel) + 1)
    backward, forward = np.flatnonzero(travel < 0.0), np.flatnonzero(travel > 0.0)
    places[0] = place = start
    i = 0
    while i < count:
        place += step(i)
        i += 1
        if -top <= place <= top:
            places[i] = place
            continue
        # at the bound until the travel reverses
        place, back = (top, backward) if place > top else (-top, forward)
        after = bisect_left(back, i)
        until = int(back[after]) if after < len(back) else count
        places[i : until + 1] = place
        i = until
    return places
