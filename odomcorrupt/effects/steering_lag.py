"""Lag of the steered wheels behind the steering angle of the odometry, by a servo or a soft linkage."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from odomcorrupt.drive_types import STEERED
from odomcorrupt.effects.channel_lag import lag_remainder
from odomcorrupt.effects.effect import (
    About,
    Effect,
    Motion,
    Recorded,
    State,
    TwistError,
    parameter,
    parameters,
    stacked,
)
from odomcorrupt.effects.steering import axles_parameter, curvature_at, on_every_axle_distance, steered

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.random import Generator
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array

_BEYOND = (0.05, 0.15, 0.3, 0.5, 0.7, 0.85)
"""Parts of all lag, summed over time, that are due to lags larger than a trial limit."""
_OF_CURVATURE = (1.0, 0.85)
"""Trial limits of large angles, as parts of those of the curvature: angles change less than their tangents."""
_ROLLS_MPS = 0.01 - 1e-9
"""Speed from which a path shows the wheels' angle, m/s; just below a round one, which rounding may reach. Wheels turn
quickest at the low speeds of starts and reversals, where odometry from a steering angle has the exact ratio."""
_ONE_WAY = 0.5
"""Least part of the recent travel that is in one direction where a path rolls; noise of a robot at rest has none."""
_SHARE_S = 2.0
"""Time over which the share of noise in the changes of the turn rate is averaged."""
_STEADY, _SMOOTH_S = 0.1, 1.0
"""Share that steering itself may have, when it turns back, and time constant (s) per share beyond it: 0.3 s for poses
with so much noise that it is all that their turn rate shows."""


class _Steering(NamedTuple):
    """State of the wheels, and of a path from which their angle is taken.

    angle : of the wheels when they last rolled, per distance between the axles, rad/m; None before
    ago_s, last_s : time since then, and last stamp
    sums : way (m), turn (rad), travel (m) and time (s), with weights that decay with age
    turn_rate, change : last turn rate of a path and its last change, rad/s
    shaken, moved : mean change that the next one takes back, and mean change, rad/s
    """

    angle: float | None = None
    ago_s: float = 0.0
    last_s: float = 0.0
    sums: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    turn_rate: float = 0.0
    change: float = 0.0
    shaken: float = 0.0
    moved: float = 0.0

    def seen(self, way: float, turn: float, dt_s: float) -> _Steering:
        """Return the state after an increment of a path: the more of its turn is noise, the longer it is averaged."""
        change = turn / dt_s - self.turn_rate
        back = min(abs(change), abs(self.change)) if change * self.change < 0.0 else 0.0
        gain = min(dt_s / _SHARE_S, 1.0)
        shaken, moved = self.shaken + gain * (back - self.shaken), self.moved + gain * (abs(change) - self.moved)
        smooth_s = _SMOOTH_S * max(shaken / moved - _STEADY, 0.0) if moved > 0.0 else 0.0
        kept = smooth_s / (smooth_s + dt_s)
        way_m, turn_rad, travel_m, time_s = (kept * one for one in self.sums)
        sums = (way_m + way, turn_rad + turn, travel_m + abs(way), time_s + dt_s)
        return self._replace(sums=sums, turn_rate=turn / dt_s, change=change, shaken=shaken, moved=moved)

    @property
    def rolls(self) -> bool:
        """Whether the path shows the curvature: it is neither at rest, with or without noise, nor creeping."""
        way, _, travel, time_s = self.sums
        return abs(way) >= max(_ROLLS_MPS * time_s, _ONE_WAY * travel)


class _Followed(NamedTuple):
    """Where the car rolls (n,), there the angles (k,) of its wheels and of its odometry, rad/m, and the state after."""

    rolls: NDArray[np.bool_]
    wheels: Array
    shown: Array
    after: _Steering


@dataclass(frozen=True, slots=True)
class SteeringLag(Effect):
    """f = (0, 0, v tan(L delta) / L - omega): the wheels' angle L delta follows the odometry's with a first-order lag.

    With L the distance between the axles; without it angles are assumed small. The wheels turn no faster than a servo's
    largest `rate`, and lag no further than the `stop` of a soft linkage. A delay by tau has the same f for steering
    slow against tau. A change of speed in a curve of constant radius is no steering and causes no error. While the
    robot is at rest its wheels continue to the steering angle.

    Corruption inverts the lag. How far the angle of the odometry is ahead of wheels that turn at their largest rate is
    not in their path: corruption takes the smallest lead that they show, that of the lag at this rate. As noise
    of the path would dominate changes of its curvature, this is averaged the longer, the noisier the turn rate is.
    """

    name = "steering_lag"
    layer = "record"
    summary = "a car's or tricycle's wheels follow the steering angle of its odometry late"
    drives = STEERED
    about = About(
        equation="f_yaw = v tan(L d) / L - omega, tau dd / dt + d = e: the wheels' angle d lags behind the odometry's "
        "e = atan(L omega / v) / L, |dd / dt| <= rate, |d - e| <= stop",
        typical="50 to 300 ms by a steering servo whose command is used as its angle; wheels that turn by 1 to 5 "
        "rad/s at most have a rate of 3 to 15 rad/(m s) on 0.3 m between the axles (an estimate)",
        source="first-order lag; Rajamani, Vehicle Dynamics and Control, chapter 2 (kinematic bicycle model); largest "
        "steering rate: Althoff, Koschi & Manzinger 2017, CommonRoad",
        confused_with=("channel_lag", "time_offset", "accel_slip"),
        drive="steer briskly to both sides at a constant speed, and speed up and brake on straights and in curves",
    )

    tau: float = parameter("s", "time constant, or the delay", low=0.0, high=1.0, typical=0.1, step=0.02)
    rate: float = parameter(
        "rad/(m s)", "largest rate of the wheels' angle, per distance between the axles; 0: no limit",
        low=0.0, high=1000.0, typical=5.0, amplitude=False, optional=True,
    )  # fmt: skip
    stop: float = parameter(
        "rad/m", "largest lag of the wheels' angle, per distance between the axles; 0: no limit",
        low=0.0, high=100.0, typical=0.5, amplitude=False, optional=True,
    )  # fmt: skip
    axles: float = axles_parameter()

    @property
    def acts(self) -> bool:
        """Whether the effect does anything: wheels with a largest rate are late without any lag."""
        return self.tau != 0.0 or self.rate != 0.0

    def limited(self, motions: Sequence[Motion]) -> tuple[Self, ...]:
        """Return the lag with trial limits that a part of its steering on these motions exceeds.

        With a limit, those for large steering angles; without one, these differ from small ones in second order only.
        """
        if self.rate or self.stop:
            steep = () if self.axles else on_every_axle_distance(self, motions)[1:]
            return tuple(replace(one, rate=p * one.rate, stop=p * one.stop) for one in steep for p in _OF_CURVATURE)
        if not self.tau > 0.0:
            return ()
        followed = [self._followed(m, _Steering()) for m in motions]
        lags = np.sort(np.abs(np.concatenate([one.wheels - one.shown for one in followed])))[::-1]
        total = np.cumsum(lags)
        if not total.size or total[-1] == 0.0:
            return ()
        stops = lags[np.searchsorted(total, np.array(_BEYOND) * total[-1])].tolist()
        limits = [*(("stop", stop) for stop in stops), *(("rate", stop / self.tau) for stop in stops)]
        high = {p.name: p.high for p in parameters(type(self))}
        return tuple(replace(self, **{name: value}) for name, value in limits if value < high[name])

    def start(self, rng: Generator) -> State:  # noqa: ARG002 - nothing is drawn
        """Return the state of wheels that have not rolled yet."""
        return _Steering()

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f, from the lag of the wheels' curvature; for tau < 0, needed for slopes, the opposite."""
        if self.tau < 0.0:  # the opposite of what the lag adds to a largest rate alone
            late, after = replace(self, tau=-self.tau).twist_error(motion, state)
            return TwistError(2.0 * replace(self, tau=0.0).twist_error(motion, state).f - late, after)
        rolls, wheels, shown, after = self._followed(motion, state)
        f = np.zeros(len(motion))
        f[rolls] = motion.v[rolls] * (curvature_at(wheels, self.axles) - curvature_at(shown, self.axles))
        return TwistError(stacked(0.0, 0.0, f, f), after)

    def _followed(self, motion: Motion, state: _Steering) -> _Followed:
        """Return the angles of the wheels and of the odometry wherever the car rolls."""
        rolls = (np.abs(motion.v) >= _ROLLS_MPS) & (motion.dt_s > 0.0)
        shown = steered(motion.omega[rolls] / motion.v[rolls], self.axles)
        time_s = np.concatenate(([-state.ago_s], np.cumsum(motion.dt_s)[rolls]))
        wheels, angle = np.empty_like(shown), state.angle
        for i, (ahead, ago_s) in enumerate(zip(shown.tolist(), np.diff(time_s).tolist(), strict=True)):
            if angle is None:
                angle = ahead
            else:
                followed = ahead + lag_remainder(self.tau, ago_s) * (angle - ahead)
                angle = _within(_within(followed, angle, self.rate * ago_s), ahead, self.stop)
            wheels[i] = angle
        rest_s = float(motion.dt_s.sum() - time_s[-1])
        return _Followed(rolls, wheels, shown, state._replace(angle=angle, ago_s=rest_s))

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002 - no wheels
        """Return the increments (n, 3) computed from the steering angle whose lagging wheels cause these."""
        reported = steps.copy()
        for i, (ds, turn, now_s) in enumerate(
            zip(steps[:, 0].tolist(), steps[:, 2].tolist(), t_s.tolist(), strict=True)
        ):
            dt_s = now_s - state.last_s
            if dt_s < 0.0:  # time was reset
                state = _Steering(last_s=now_s)
            if not dt_s > 0.0:
                continue
            state = state.seen(ds, turn, dt_s)._replace(last_s=now_s, ago_s=state.ago_s + dt_s)
            if not state.rolls:
                continue
            (true,) = steered(np.array([state.sums[1] / state.sums[0]]), self.axles).tolist()
            if state.angle is not None:
                moved = _within(true - state.angle, 0.0, self.rate * state.ago_s)
                ahead = true + _within(self.tau / state.ago_s * moved, 0.0, self.stop)
                before, after = curvature_at(np.array([true, ahead]), self.axles).tolist()
                reported[i, 2] += ds * (after - before)
            state = state._replace(angle=true, ago_s=0.0)
        return Recorded(reported, state)


def _within(value: float, middle: float, reach: float) -> float:
    """Return the value clipped to `reach` on both sides of the middle; a reach of 0 is no limit."""
    return min(max(value, middle - reach), middle + reach) if reach else value
