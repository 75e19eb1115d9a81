"""Mechanics between motor and floor: play, dead bands, and wheels that are not round."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np

from odomcorrupt.effects.effect import About, Effect, Motion, Recorded, State, TwistError, choice, parameter
from odomcorrupt.effects.wheels import (
    Rims,
    body_of,
    error_of_each_wheel,
    heading_choice,
    needed_track_m,
    on_every_track,
    rims_of,
    track_parameter,
    trial_speeds,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

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
    initial = AT_REST, AT_REST
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

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: minus the motor speed within the play; for negative `travel` (numerical slopes), its opposite."""
        track = needed_track_m(self, motion.track_m)
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
        track = needed_track_m(self, track_m)
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


_SPEEDS = (0.1, 0.25, 0.5)
"""Trial values of the band's upper end, as fractions of a drive's usual speed."""
_RISE = 1.25
"""With beyond = full: ratio of the speed from which commands are followed fully to the band's upper end."""


@dataclass(frozen=True, slots=True)
class DeadBand(Effect):
    """f_wheel = -loss u up to `speed`; beyond it -loss speed sign(u), or (beyond = full) soon zero.

    u is the commanded and reported rim speed. With loss = 1 the wheel stands still within the band, as a motor below
    the duty cycle that overcomes its friction. Without a track, the band applies to the body's speed.
    """

    name = "dead_band"
    odd = True
    layer = "record"
    summary = "wheels do not follow slow commands: the robot moves less than its odometry reports"
    about = About(
        equation="f_wheel = -loss u where abs(u) < speed; -loss speed sign(u) beyond (beyond = full: 0)",
        typical="a tenth to a third of full speed on geared hobby motors without speed control (an estimate)",
        source="Coulomb friction of DC motors; Olsson, Astrom, Canudas de Wit, Gafvert & Lischinsky 1998, "
        "European Journal of Control 4(3)",
        confused_with=("wheel_scale", "speed_scale", "truncated_velocity", "counts_lost"),
        drive="the same straight, and turns on the spot, at several speeds, the slowest that moves it among them",
    )

    loss: float = parameter("", "part of the speed that is lost within the band", low=0.0, high=1.25, typical=0.8)
    speed: float = parameter(
        "m/s", "rim speed at which the band ends", low=0.005, high=2.0, typical=0.05, identity=0.05, amplitude=False
    )
    beyond: str = choice("what is lost beyond the band: as much as at its end, or nothing", "less", "full")
    track: float = track_parameter()

    @classmethod
    def scan(cls, motions: Sequence[Motion]) -> tuple[Self, ...]:
        """Return a candidate for each trial end of the band and, on a known track, for either loss beyond it.

        The two gain at other speeds. On a track that is only tried, the sharp end of a band fits any event of a slow
        wheel: a lawn mower got noise four times too large beside it.
        """
        ends = trial_speeds(motions, 0.9, _SPEEDS, 0.005, 2.0)
        losses = ("less",) if motions[0].track_m is None else ("less", "full")
        return on_every_track([cls(speed=end, beyond=beyond) for beyond in losses for end in ends], motions)

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: minus the speed lost at the commanded speed."""
        track_m = self.track or motion.track_m
        return TwistError(error_of_each_wheel(lambda u: -self._lost(u), motion.v, motion.omega, track_m), state)

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:
        """Return the increments that must be commanded to obtain these."""
        last_s = float(t_s[-1]) if len(t_s) else state
        dt = np.diff(t_s, prepend=0.0 if state is None else state)
        if self.loss == 0.0 or not len(steps):
            return Recorded(steps, last_s)
        v, _, omega = np.divide(steps.T, dt, out=np.zeros_like(steps.T), where=dt > 0.0)
        more = error_of_each_wheel(lambda u: self._commanded(u) - u, v, omega, self.track or track_m)
        return Recorded(steps + more * dt[:, None], last_s)

    def _lost(self, u: Array) -> Array:
        """Return the lost speed (n,) at commanded speeds."""
        fast = np.abs(u)
        lost = np.minimum(fast, self.speed)
        if self.beyond == "full":
            lost = lost * np.clip((_RISE * self.speed - fast) / ((_RISE - 1.0) * self.speed), 0.0, 1.0)
        return self.loss * np.sign(u) * lost

    def _commanded(self, u: Array) -> Array:
        """Return the commanded speeds (n,) for these wheel speeds, linear between the corners."""
        at = np.array([0.0, self.speed, _RISE * self.speed, 1e3])
        reached = at - self._lost(at)
        reached = np.maximum.accumulate(reached + 1e-15 * np.arange(len(at)))
        return np.sign(u) * np.where(u == 0.0, 0.0, np.interp(np.abs(u), reached, at))


_ROUNDS, _SOLVED_M = 100, 1e-15
_CONCENTRATION = 4.0
"""Concentration of the spot (von Mises shape): half of it lies within a seventh of a turn."""
_MEAN = float(np.i0(_CONCENTRATION) * np.exp(-_CONCENTRATION))
"""Mean of the von Mises shape over a turn."""


@dataclass(frozen=True, slots=True)
class FlatSpot(Effect):
    """f_wheel = -depth u (exp(4 (cos(q) - 1)) - 0.207 (1 - mean)); with form = eccentric, -depth u cos(q).

    q = 2 pi s / circumference - phase, s the reported travel of the wheel so far. Unless `mean` is 1, the mean over a
    turn is subtracted (0.207: exp(-4) I0(4), I0 the modified Bessel function). The mean loss is a smaller radius, that
    is, `wheel_scale` and `unequal_wheels`, and a spot of any circumference could otherwise imitate these.
    """

    name = "flat_spot"
    odd = True
    layer = "record"
    needs_track = True
    initial = 0.0, 0.0  # travel of the rims so far as reported, right and left, m
    summary = "a wheel is flat on one side or out of round: it advances less once a turn"
    about = About(
        equation="f_wheel = -depth u where the wheel rolls over its flat side, once a turn, less its mean",
        typical="2 to 20 % of the way over a seventh of a turn on foam and cheap rubber tyres (an estimate)",
        source="engineering judgement; no published figures known to us",
        confused_with=("unequal_wheels", "wheel_scale", "slip_burst"),
        drive="long straights at a low speed: the heading sways once a turn of the wheel",
    )

    depth: float = parameter("", "part of the travel that is lost at the spot", low=-0.5, high=0.5, typical=0.05)
    circumference: float = parameter(
        "m", "travel in one turn of the wheel", low=0.05, high=5.0, typical=0.2, identity=0.2, amplitude=False
    )
    phase: float = parameter(
        "rad", "turn from the first pose to the spot", low=-6.3, high=6.3, typical=1.0, amplitude=False
    )
    mean: float = parameter(
        "", "fraction of the flat side's mean loss that is included", low=0.0, high=1.0, typical=1.0, amplitude=False,
        optional=True,
    )  # fmt: skip
    wheel: str = choice("which wheel it is", "right", "left")
    form: str = choice("a flat side, or a wheel with an off-centre axle", "flat", "eccentric")
    track: float = track_parameter()

    @classmethod
    def scan(cls, motions: Sequence[Motion]) -> tuple[Self, ...]:  # noqa: ARG003 - interface of Effect
        """Return no candidates: the spectrum over the travel shows the circumference, see `study.select.periodic`."""
        return ()

    def related(self) -> tuple[Self, ...]:
        """Return a flat side including its mean loss: it also makes the radius smaller."""
        return (replace(self, form="flat", mean=1.0),)

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: the speed that one wheel loses as it rolls over the spot."""
        track_m = needed_track_m(self, motion.track_m)
        rims = rims_of(motion.v, motion.omega, track_m)
        arms_m = 0.5 * track_m, -0.5 * track_m
        ways = [motion.rolled(arm_m, before) for arm_m, before in zip(arms_m, state, strict=True)]
        lost = [
            self._lost(u, way) * (side == self.wheel) for side, u, way in zip(Rims._fields, rims, ways, strict=True)
        ]
        return TwistError(body_of(Rims(*lost), track_m), tuple(float(way[-1]) for way in ways))

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002 - at any time
        """Return the increments (n, 3) that, less the loss of the spot, equal the given ones."""
        track_m = needed_track_m(self, track_m)
        rims = rims_of(steps[:, 0], steps[:, 2], track_m)
        true, way = (rims.right, state[0]) if self.wheel == "right" else (rims.left, state[1])
        more = np.zeros(len(true))
        for i, gone in enumerate(true.tolist()):
            reported = gone
            for _ in range(_ROUNDS if self.depth else 0):
                last, reported = reported, gone + self.depth * reported * float(self._at(way + 0.5 * reported))
                if abs(reported - last) <= _SOLVED_M:
                    break
            more[i] = reported - gone
            way += reported
        right = float(self.wheel == "right")
        reported = steps + body_of(Rims(right * more, (1.0 - right) * more), track_m) if self.depth else steps
        return Recorded(reported, (right * way, (1.0 - right) * way))

    def _lost(self, u: Array, way: Array) -> Array:
        """Return f of a wheel (n,) from its rim speeds and its travel (n + 1,)."""
        return -self.depth * u * self._at(0.5 * (way[1:] + way[:-1]))

    def _at(self, way: Any) -> Any:
        """Return the fraction of `depth` that a wheel loses at its travel, scalar or array."""
        near = np.cos(2.0 * np.pi * way / self.circumference - self.phase)
        return near if self.form == "eccentric" else np.exp(_CONCENTRATION * (near - 1.0)) - _MEAN * (1.0 - self.mean)
