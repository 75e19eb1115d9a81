"""Identification drives: manoeuvres that fit in a room of a few metres, their commands, and an ideal robot on them."""

from __future__ import annotations

import io
from dataclasses import dataclass
from itertools import cycle
from math import pi
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

import numpy as np

from odomcorrupt.bags.messages import write_twists
from odomcorrupt.geometry.se2 import Increments, accumulate, wrap
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.study.io.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from odomcorrupt.effects.effect import Motion
    from odomcorrupt.geometry.se2 import Array

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
    least_s : shortest informative duration, seconds; 0 if any is
    """

    name: str
    sentence: str
    parts: Sequence[Part]
    least_s: float = 0.0

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


STEP_S = 0.05
"""Period of the commands, seconds."""
_FAST = (0.3, 1.2)  # range of the speed limit, m/s
_TURNING = (0.5, 1.2)  # range of the turn rate limit, rad/s
_REST_S = 2.0
_STOP = Hold(0.0, 0.0, 0.5)
_NEAR_M = 0.3  # distance from the start at which no return is needed
_STRAIGHT_RAD = 0.5
"""Smaller turns are left out, because they are too short for the ramps."""


@dataclass(frozen=True, slots=True)
class Plan:
    """Commands with period `STEP_S`, beginning and ending at rest.

    v_mps, omega_radps : (n,)
    """

    manoeuvre: Manoeuvre
    v_mps: Array
    omega_radps: Array

    @property
    def duration_s(self) -> float:
        """Duration, seconds."""
        return len(self.v_mps) * STEP_S

    @property
    def path(self) -> Array:
        """Poses (n + 1, 3) of a robot that follows the commands exactly from the origin, m and rad."""
        return _followed(self.v_mps, self.omega_radps)

    @property
    def floor_m(self) -> tuple[float, float]:
        """Length and width of the floor covered by the path, metres, the longer first."""
        size = np.ptp(self.path[:, :2], axis=0)
        return float(size.max()), float(size.min())

    @property
    def fastest_mps(self) -> float:
        """Largest speed, m/s."""
        return float(np.abs(self.v_mps).max())


def _followed(v_mps: Array, omega_radps: Array, start: Array | None = None) -> Array:
    steps = Increments(v_mps * STEP_S, np.zeros_like(v_mps), omega_radps * STEP_S)
    return accumulate(np.zeros(3) if start is None else start, steps)


def safe_limits(motions: Sequence[Motion]) -> Limits:
    """Return speed limits for a robot: its observed 98 % quantiles, clipped to a range that is harmless indoors."""
    v = np.concatenate([np.abs(m.v) for m in motions])
    omega = np.concatenate([np.abs(m.omega) for m in motions])
    seen = float(np.quantile(v, 0.98)), float(np.quantile(omega, 0.98))
    return Limits(float(np.clip(seen[0], *_FAST)), float(np.clip(seen[1], *_TURNING)))


def plan_of(manoeuvre: Manoeuvre, limits: Limits, duration_s: float) -> Plan:
    """Return the commands of whole moves for at least `duration_s` and the manoeuvre's own least duration."""
    rest = np.zeros((round(_REST_S / STEP_S), 2))
    speeds, now = [rest], np.zeros(2)
    left = round(max(duration_s, manoeuvre.least_s) / STEP_S)
    for step in manoeuvre.round(limits):
        holds = [step] if isinstance(step, Hold) else _homewards(np.concatenate([*speeds, _ramp(now, _STOP)]), limits)
        for hold in holds if isinstance(step, Hold) else [_STOP, *holds]:
            speeds.append(_ramp(now, hold))
            now = np.array(hold[:2])
            left -= len(speeds[-1])
        if left <= 0:
            break
    v, omega = np.concatenate([*speeds, _ramp(now, _STOP), rest]).T
    return Plan(manoeuvre, np.ascontiguousarray(v), np.ascontiguousarray(omega))


def _ramp(now: Array, hold: Hold) -> Array:
    """Return the commands (n, 2) of a ramp to given speeds and of the time at these speeds."""
    wanted = np.array(hold[:2])
    count = max(1, int(np.ceil(np.max(np.abs(wanted - now) / hold.accelerations) / STEP_S)))
    part = np.concatenate((np.arange(1, count + 1) / count, np.ones(round(hold.hold_s / STEP_S))))
    return now + part[:, None] * (wanted - now)


def _homewards(speeds: Array, limits: Limits) -> list[Hold]:
    """Return the moves at rest from the end of commands (n, 2) back to their start, with the initial heading."""
    x, y, theta = _followed(*speeds.T)[-1]
    away = float(np.hypot(x, y))
    if away < _NEAR_M:
        return []
    back = float(np.arctan2(-y, -x))
    moves = [*_turned(back - theta, limits), *straight(away, min(limits.v_mps, max(0.25 * away, 0.1)))]
    return [*moves, *_turned(-back, limits)]


def _turned(angle_rad: float, limits: Limits) -> list[Hold]:
    wrapped = float(wrap(np.array([angle_rad]))[0])
    return list(turn(wrapped, limits.omega_radps)) if abs(wrapped) > _STRAIGHT_RAD else []


def ideal_recording(plan: Plan, like: Recording) -> Recording:
    """Return the recording of an ideal robot and an ideal tracker, starting at the first pose of `like`."""
    stamps_ns = like.origin_ns + (np.arange(len(plan.v_mps) + 1) * round(STEP_S * 1e9)).astype(np.int64)
    odometry = Trajectory(stamps_ns, plan.path)
    truth = Trajectory(stamps_ns, _followed(plan.v_mps, plan.omega_radps, np.nan_to_num(like.truth.xyt[0])))
    return Recording(plan.manoeuvre.name, odometry, truth, like.origin_ns, like.track_m)


def drive_bag(plan: Plan) -> bytes:
    """Return an MCAP whose /cmd_vel executes a plan."""
    twist = np.stack((plan.v_mps, np.zeros_like(plan.v_mps), plan.omega_radps), axis=1)
    bag = io.BytesIO()
    write_twists(bag, np.arange(len(twist), dtype=np.float64) * STEP_S, twist)
    return bag.getvalue()
