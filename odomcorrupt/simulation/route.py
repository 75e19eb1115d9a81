"""An office drive, and how any plan becomes speeds and turn rates over time. Nothing steers on the truth."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

SIDEWAYS_LIMIT_MPS2 = 0.9
ROOM_RADIUS_M = 7.0


@dataclass(frozen=True, slots=True)
class Segment:
    """Ease from the speeds before to these within `ramp_s`, then hold them."""

    v_mps: float
    omega_radps: float
    hold_s: float
    ramp_s: float = 1.0


@dataclass(slots=True)
class _Planner:
    """Dead reckoning on paper: where the plan itself would lead, so that it stays in the room."""

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
        """+1 left, -1 right: a coin that leans towards the middle of the room the farther out the plan is."""
        home_is_left = (-self.place * np.exp(-1j * self.heading_rad)).imag > 0
        lean = 0.25 * min(1.0, abs(self.place) / ROOM_RADIUS_M)
        return 1.0 if self.rng.random() < 0.5 + (lean if home_is_left else -lean) else -1.0

    def straight(self) -> Iterator[Segment]:
        v_mps = float(np.exp(self.rng.uniform(np.log(0.15), np.log(1.2))))
        yield self.to(v_mps, 0.0, self.rng.uniform(1.0, 5.0) / max(v_mps, 0.5))

    def bend(self) -> Iterator[Segment]:
        radius_m = float(np.exp(self.rng.uniform(np.log(0.4), np.log(3.0))))
        fastest_mps = min(1.2, float(np.sqrt(SIDEWAYS_LIMIT_MPS2 * radius_m)))
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

    def next_move(self) -> Iterator[Segment]:
        outward = abs(self.place) > ROOM_RADIUS_M and (self.place * np.exp(-1j * self.heading_rad)).real > 0
        weights = np.array([0.1 if outward else 0.4, 0.4, 0.08, 0.05, 0.07])
        moves = (self.straight, self.bend, self.spot_turn, self.reverse, self.pause)
        return moves[self.rng.choice(len(moves), p=weights / weights.sum())]()


def draw_route(duration_s: float, rng: np.random.Generator) -> tuple[Segment, ...]:
    """Draw an office drive that starts from and ends at rest.

    Parameters
    ----------
    duration_s : float
        The plan is cut so that the robot stands before this time, s.
    """
    planner = _Planner(rng)
    route = [planner.stand(1.5, 2.5)]
    left_s = duration_s - 4.0
    while True:
        for segment in planner.next_move():
            left_s -= segment.ramp_s + segment.hold_s
            if left_s < 0:
                return (*route, Segment(0.0, 0.0, np.inf, 2.0))
            route.append(segment)


def follow(route: Sequence[Segment], grid_s: np.ndarray) -> np.ndarray:
    """Return the commanded speeds: S-shaped ramps (bounded jerk), level between them, from rest.

    Parameters
    ----------
    route : sequence of Segment
        After the last one its speeds are kept.
    grid_s : ndarray, shape (n,)
        Times, s.

    Returns
    -------
    ndarray, shape (n, 2)
        Forward speed in m/s, turn rate in rad/s.
    """
    starts_s = np.concatenate(([0.0], np.cumsum([s.ramp_s + s.hold_s for s in route[:-1]])))
    ramps_s = np.array([s.ramp_s for s in route])
    speeds = np.array([(0.0, 0.0), *((s.v_mps, s.omega_radps) for s in route)])
    now = np.searchsorted(starts_s, grid_s, side="right") - 1
    part = np.clip((grid_s - starts_s[now]) / ramps_s[now], 0.0, 1.0)
    eased = part * part * (3.0 - 2.0 * part)
    return np.asarray(speeds[now] + (speeds[now + 1] - speeds[now]) * eased[:, None])
