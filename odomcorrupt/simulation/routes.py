"""Commanded velocities over time, and routes as sequences of manoeuvres."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from odomcorrupt.errors import BagError, TopicError

REST_S = 2.0
TYPES = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")


@dataclass(frozen=True, slots=True)
class Commands:
    """Speed commands: times since the first command (s), forward speeds (m/s), turn rates (rad/s); shape (n,) each."""

    times_s: np.ndarray
    v_mps: np.ndarray
    omega_radps: np.ndarray

    @property
    def duration_s(self) -> float:
        """Duration of the commands with a rest before and after, s."""
        return float(self.times_s[-1]) + 2.0 * REST_S


def obey(commands: Commands, grid_s: np.ndarray) -> np.ndarray:
    """Return the speeds (n, 2), m/s and rad/s, set by the base's controller: the last command, limited in acceleration.

    grid_s : (n,) times, s; the first command comes `REST_S` after the first of them, and after the last one the robot
        stops
    """
    step_s = float(grid_s[1] - grid_s[0])
    last = np.searchsorted(commands.times_s, grid_s - REST_S, side="right") - 1
    going = (last >= 0) & (grid_s - REST_S < commands.times_s[-1] + 0.1)
    wanted = np.where(going, np.stack((commands.v_mps[last], commands.omega_radps[last])), 0.0)
    # limits of acceleration, m/s^2 and rad/s^2
    pairs = zip(wanted, (2.5 * step_s, 6.0 * step_s), strict=True)
    return np.column_stack([_approach(row.tolist(), change) for row, change in pairs])


def _approach(wanted: list[float], change: float) -> list[float]:
    now, speeds = 0.0, []
    for speed in wanted:
        now = min(max(speed, now - change), now + change)
        speeds.append(now)
    return speeds


def read_commands(path: str | Path) -> Commands:
    """Return the speed commands of a bag (MCAP file, ROS 1 bag or rosbag2 directory): /cmd_vel, or the only topic.

    Raises
    ------
    BagError
        If the bag cannot be read.
    TopicError
        If it has no such topic, several, or no command.
    """
    from rosbags.highlevel import AnyReader, AnyReaderError  # noqa: PLC0415 - only needed to play a bag
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415 - as above

    try:
        with AnyReader([Path(path)], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            found = [c for c in reader.connections if c.msgtype in TYPES]
            chosen = [c for c in found if c.topic == "/cmd_vel"] or found
            if len({c.topic for c in chosen}) != 1:
                names = ", ".join(sorted({c.topic for c in reader.connections})) or "nothing"
                raise TopicError(
                    f"{path}: not exactly one topic of velocity commands (found {names}); record /cmd_vel as Twist"
                )
            rows = []
            for connection, stamp_ns, data in reader.messages(connections=chosen):
                message = reader.deserialize(data, connection.msgtype)
                twist: Any = getattr(message, "twist", message)
                rows.append((stamp_ns, twist.linear.x, twist.angular.z))
    except (AnyReaderError, OSError) as error:
        raise BagError(f"{path}: cannot be read as a bag ({error})") from error
    if not rows:
        raise TopicError(f"{path}: {chosen[0].topic} carries no command; record some")
    stamps_ns = np.array([row[0] for row in rows], dtype=np.int64)
    speeds = np.array([row[1:] for row in rows])
    return Commands((stamps_ns - stamps_ns[0]) * 1e-9, speeds[:, 0], speeds[:, 1])


ROOM_RADIUS_M = 7.0


@dataclass(frozen=True, slots=True)
class Segment:
    """Segment of a route: a ramp of `ramp_s` from the previous speeds to these, then constant for `hold_s`."""

    v_mps: float
    omega_radps: float
    hold_s: float
    ramp_s: float = 1.0


@dataclass(slots=True)
class _Planner:
    """Random planner, with dead reckoning of the plan to stay inside the room."""

    rng: np.random.Generator
    place: complex = 0j
    heading_rad: float = 0.0
    v_mps: float = 0.0
    omega_radps: float = 0.0

    def to(self, v_mps: float, omega_radps: float, hold_s: float) -> Segment:
        accel_mps2, accel_radps2 = self.rng.uniform(0.25, 0.9), self.rng.uniform(0.8, 2.0)
        gentlest_s = max(abs(v_mps - self.v_mps) / accel_mps2, abs(omega_radps - self.omega_radps) / accel_radps2)
        ramp_s = max(0.2, 1.5 * gentlest_s)
        for v, omega, t in (
            (0.5 * (self.v_mps + v_mps), 0.5 * (self.omega_radps + omega_radps), ramp_s),
            (v_mps, omega_radps, hold_s),
        ):
            self.heading_rad += 0.5 * omega * t
            self.place += v * t * np.sinc(omega * t / (2 * np.pi)) * np.exp(1j * self.heading_rad)
            self.heading_rad += 0.5 * omega * t
        self.v_mps, self.omega_radps = v_mps, omega_radps
        return Segment(v_mps, omega_radps, hold_s, ramp_s)

    def stand(self, low_s: float, high_s: float) -> Segment:
        return self.to(0.0, 0.0, self.rng.uniform(low_s, high_s))

    def side(self) -> float:
        """Return +1 (left) or -1 (right), with higher probability towards the middle of the room farther from it."""
        home_is_left = (-self.place * np.exp(-1j * self.heading_rad)).imag > 0
        lean = 0.25 * min(1.0, abs(self.place) / ROOM_RADIUS_M)
        return 1.0 if self.rng.random() < 0.5 + (lean if home_is_left else -lean) else -1.0

    def straight(self) -> Iterator[Segment]:
        v_mps = float(np.exp(self.rng.uniform(np.log(0.15), np.log(1.2))))
        yield self.to(v_mps, 0.0, self.rng.uniform(1.0, 5.0) / max(v_mps, 0.5))

    def bend(self) -> Iterator[Segment]:
        radius_m = float(np.exp(self.rng.uniform(np.log(0.4), np.log(3.0))))
        fastest_mps = min(1.2, float(np.sqrt(0.9 * radius_m)))
        v_mps = fastest_mps * self.rng.uniform(0.3, 1.0)
        turn_rad = np.radians(self.rng.uniform(30.0, 150.0))
        yield self.to(v_mps, self.side() * v_mps / radius_m, turn_rad * radius_m / v_mps)

    def spot_turn(self) -> Iterator[Segment]:
        yield self.stand(0.1, 0.5)
        omega_radps = self.rng.uniform(0.3, 1.2)
        yield self.to(0.0, self.side() * omega_radps, np.radians(self.rng.uniform(30.0, 150.0)) / omega_radps)
        yield self.stand(0.1, 0.5)

    def reverse(self) -> Iterator[Segment]:
        yield self.stand(0.2, 0.8)
        v_mps = self.rng.uniform(0.15, 0.4)
        curvature_radpm = self.rng.choice((0.0, 0.6, -0.6))
        yield self.to(-v_mps, v_mps * curvature_radpm, self.rng.uniform(0.3, 1.2) / v_mps)
        yield self.stand(0.2, 0.8)

    def pause(self) -> Iterator[Segment]:
        yield self.stand(1.5, 5.0)

    def moves(self) -> Iterator[Segment]:
        kinds = (self.straight, self.bend, self.spot_turn, self.reverse, self.pause)
        while True:
            outward = abs(self.place) > ROOM_RADIUS_M and (self.place * np.exp(-1j * self.heading_rad)).real > 0
            weights = np.array([0.1 if outward else 0.4, 0.4, 0.08, 0.05, 0.07])
            yield from kinds[self.rng.choice(len(kinds), p=weights / weights.sum())]()


def draw_route(duration_s: float, rng: np.random.Generator) -> tuple[Segment, ...]:
    """Return a random office drive that starts and ends at rest.

    duration_s : time before which the robot must be at rest, s
    """
    planner = _Planner(rng)
    return _until(duration_s - 4.0, planner.stand(1.5, 2.5), planner.moves())


def follow(route: Sequence[Segment], grid_s: np.ndarray) -> np.ndarray:
    """Return the commanded speeds (n, 2), m/s and rad/s: S-shaped ramps (bounded jerk) from rest, constant between.

    route : segments in order; the speeds of the last one are kept
    grid_s : (n,) times, s
    """
    starts_s = np.concatenate(([0.0], np.cumsum([s.ramp_s + s.hold_s for s in route[:-1]])))
    ramps_s = np.array([s.ramp_s for s in route])
    speeds = np.array([(0.0, 0.0), *((s.v_mps, s.omega_radps) for s in route)])
    now = np.searchsorted(starts_s, grid_s, side="right") - 1
    part = np.clip((grid_s - starts_s[now]) / ramps_s[now], 0.0, 1.0)
    eased = part * part * (3.0 - 2.0 * part)
    return np.asarray(speeds[now] + (speeds[now + 1] - speeds[now]) * eased[:, None])


SQUARE_M = 4.0
EASY_MPS2 = 0.5
EASY_RADPS2 = 1.2


def _stand(hold_s: float) -> Segment:
    return Segment(0.0, 0.0, hold_s, 0.6)


def _ahead(way_m: float, v_mps: float) -> Iterator[Segment]:
    """Yield a straight drive of this length (negative: in reverse), from rest to rest."""
    ramp_s = 1.5 * v_mps / EASY_MPS2
    if abs(way_m) < v_mps * ramp_s:
        v_mps = float(np.sqrt(abs(way_m) * EASY_MPS2 / 1.5))
        ramp_s = 1.5 * v_mps / EASY_MPS2
    yield Segment(float(np.copysign(v_mps, way_m)), 0.0, max(abs(way_m) / v_mps - ramp_s, 0.0), ramp_s)
    yield Segment(0.0, 0.0, 0.3, ramp_s)


def _spin(angle_rad: float, omega_radps: float) -> Iterator[Segment]:
    """Yield a turn on the spot by this angle, from rest to rest."""
    ramp_s = 1.5 * omega_radps / EASY_RADPS2
    if abs(angle_rad) < omega_radps * ramp_s:
        omega_radps = float(np.sqrt(abs(angle_rad) * EASY_RADPS2 / 1.5))
        ramp_s = 1.5 * omega_radps / EASY_RADPS2
    hold_s = max(abs(angle_rad) / omega_radps - ramp_s, 0.0)
    yield Segment(0.0, float(np.copysign(omega_radps, angle_rad)), hold_s, ramp_s)
    yield Segment(0.0, 0.0, 0.3, ramp_s)


def _loops(rng: np.random.Generator) -> Iterator[Segment]:
    """Yield rounded rectangles, two laps to the left and two to the right, each at its own speed."""
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
    """Yield straight drives forward and in reverse, without turns."""
    while True:
        way_m, there_mps, back_mps = rng.uniform(2.0, 7.0), rng.uniform(0.2, 1.1), rng.uniform(0.2, 0.8)
        yield from _ahead(way_m, there_mps)
        yield _stand(rng.uniform(0.5, 3.0))
        yield from _ahead(-way_m, back_mps)
        yield _stand(rng.uniform(0.5, 3.0))


def _slalom(rng: np.random.Generator) -> Iterator[Segment]:
    """Yield slaloms there and back, each at its own speed."""
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
    """Yield turns on the spot, short drives and reverses, as in a yard."""
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
    """Yield UMBmark squares of 4 m with turns on the spot, five clockwise and five counter-clockwise, repeatedly."""
    v_mps, omega_radps = rng.uniform(0.4, 0.6), rng.uniform(0.6, 0.9)
    for side in cycle((-1.0,) * 5 + (1.0,) * 5):
        for _ in range(4):
            yield from _ahead(SQUARE_M, v_mps)
            yield from _spin(side * 0.5 * np.pi, omega_radps)
        yield _stand(1.5)


def _until(left_s: float, first: Segment, moves: Iterator[Segment]) -> tuple[Segment, ...]:
    """Return a plan of as many moves as fit in a time, with a rest at the end."""
    plan = [first]
    for segment in moves:
        left_s -= segment.ramp_s + segment.hold_s
        if left_s < 0:
            break
        plan.append(segment)
    return (*plan, Segment(0.0, 0.0, np.inf, 2.0))


Route: TypeAlias = Callable[[float, np.random.Generator], tuple[Segment, ...]]


def _from_rest(moves: Callable[[np.random.Generator], Iterator[Segment]]) -> Route:
    """Return a route of moves after a second of rest, which ends at rest before the end."""
    return lambda duration_s, rng: _until(duration_s - 5.0, Segment(0.0, 0.0, 1.0, 1.0), moves(rng))


ROUTES: dict[str, Route] = {
    "office": draw_route,
    "loops": _from_rest(_loops),
    "shuttle": _from_rest(_shuttle),
    "slalom": _from_rest(_slalom),
    "yard": _from_rest(_yard),
    "umbmark": _from_rest(_umbmark),
}
"""Generator of each route by name: its arguments are duration, s, and random stream; it returns segments."""
