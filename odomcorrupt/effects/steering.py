"""Cars and tricycles: the steering angle, and its offset, scale, lag and play."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt
from typing import TYPE_CHECKING, Any, NamedTuple, Self, TypeVar

import numpy as np

from odomcorrupt.drive_types import STEERED
from odomcorrupt.effects.effect import (
    About,
    Effect,
    Motion,
    Recorded,
    State,
    TwistError,
    choice,
    choices,
    gain,
    parameter,
    stacked,
)
from odomcorrupt.effects.lags import lag_remainder

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.se2 import Array


CREEP_MPS = 0.05 - 1e-9
"""Speed below which a path does not show the steering angle, m/s; just below a round 0.05, which rounding may reach."""
_STEEP = (0.3, 0.55)
"""Tangents of the largest steering angle that give trial distances between the axles: 17 and 29 degrees."""
_STEEPER = (0.55, 2.0)
"""The same where the steered wheel is driven, which turns further: 29 and 63 degrees."""
_LOCK_RAD = 1.4
"""Steering angle beyond which its tangent is no path of a car."""
E = TypeVar("E", bound=Effect)


def axles_parameter() -> Any:
    """Return the field of the distance between the axles, a nuisance: the tangent of large steering angles needs it."""
    return parameter(
        "m", "distance between the axles, where steering angles are large; 0: they are small", low=0.0, high=20.0,
        typical=0.5, amplitude=False, optional=True,
    )  # fmt: skip


def driven_choice() -> Any:
    """Return the field of the wheel whose travel is measured: that of a steered one is only in part along the robot."""
    return choice("wheel that is driven and counted; the front one is steered, and needs axles", "rear", "front")


def on_every_axle_distance(effect: E, motions: Sequence[Motion]) -> tuple[E, ...]:
    """Return the effect for small steering angles, and for each trial distance between the axles."""
    v, omega = (np.abs(np.concatenate([getattr(m, name) for m in motions])) for name in ("v", "omega"))
    turning = v > CREEP_MPS
    largest = float(np.quantile(omega[turning] / v[turning], 0.99)) if turning.any() else 0.0
    if not largest > 0.0:
        return (effect,)
    trials: list[dict[str, Any]] = [{"axles": min(tangent / largest, 20.0)} for tangent in _STEEP]
    if "driven" in choices(effect):
        trials += [{"axles": min(tangent / largest, 20.0), "driven": "front"} for tangent in _STEEPER]
    return (effect, *(replace(effect, **trial) for trial in trials))  # type: ignore[type-var]


def steepness(v: Array, omega: Array, axles_m: float) -> Array:
    """Return the tangent (n,) of the steering angle, clipped to 0..1; 0 if the robot hardly travels.

    v, omega : (n,) speed, m/s, and yaw rate, rad/s
    axles_m : distance between the axles
    """
    tangent = np.divide(axles_m * np.abs(omega), np.abs(v), out=np.zeros_like(v), where=np.abs(v) > CREEP_MPS)
    return np.minimum(tangent, 1.0)


def steered(curvature: Array, axles_m: float) -> Array:
    """Return the steering angles (n,) of a path per distance between the axles, rad/m; without it angles are small."""
    return np.arctan(axles_m * curvature) / axles_m if axles_m else curvature


def curvature_at(angle: Array, axles_m: float) -> Array:
    """Return the curvatures (n,), 1/m, of a path steered with angles of `steered`, rad/m."""
    return np.tan(np.clip(axles_m * angle, -_LOCK_RAD, _LOCK_RAD)) / axles_m if axles_m else angle


def turned_front(v: Array, omega: Array, angle: Array | float, axles_m: float) -> Array:
    """Return f (n, 3) of a steered wheel whose travel is measured and that points further left by axles_m * angle.

    Its velocity (v, axles_m omega) is turned; angle (n,) in rad/m, as of `steered`.
    """
    if not axles_m:
        return stacked(0.0, 0.0, angle * v, v)
    sideways = axles_m * omega
    less, sine = np.cos(axles_m * angle) - 1.0, np.sin(axles_m * angle)
    return stacked(less * v - sine * sideways, 0.0, (less * sideways + sine * v) / axles_m, v)


def _bent(it: Any, m: Motion) -> tuple[Array | float, Array | float, Array]:
    """Return f of a steering angle delta + d, curvature = d / L, tan delta = L omega / v; without L delta is small."""
    if it.driven == "front":  # the velocity (v, L omega) of the steered wheel, whose travel is measured, is turned by d
        return tuple(turned_front(m.v, m.omega, it.curvature, it.axles).T)
    steep = 1.0 + steepness(m.v, m.omega, it.axles) ** 2 if it.axles else 1.0
    return 0.0, 0.0, it.curvature * steep * m.v


SteeringOffset = gain(
    "steering_offset",
    "the steering of a car or tricycle is not straight at zero, so that straight lines bend",
    _bent,
    About(
        equation="f_yaw = curvature v; times 1 + (axles omega / v)^2 where the steering angles are large; "
        "f_along = -curvature axles^2 omega if the steered wheel is driven",
        typical="0.2 to 2 degrees: 0.01 to 0.1 rad/m on 0.3 m between the axles, 0.001 to 0.01 rad/m on 2.7 m",
        source="Rajamani, Vehicle Dynamics and Control, chapter 2 (kinematic bicycle model: omega = v tan(delta) / L)",
        confused_with=("gyro_bias", "turn_asymmetry", "mount_yaw"),
        drive="long straights forwards and in reverse, at two speeds, with a stop of a minute",
    ),
    drives=STEERED,
    unsteered="unequal_wheels",
    scan=classmethod(lambda cls, motions: on_every_axle_distance(cls(), motions)),
    curvature=parameter(
        "rad/m", "true curvature of a path that odometry reports as straight", low=-1.0, high=1.0, typical=0.01
    ),
    axles=axles_parameter(),
    driven=driven_choice(),
)


def _turned_more(it: Any, m: Motion) -> tuple[Array | float, Array | float, Array]:
    """Return f of a steering angle delta (1 + e), tan delta = L omega / v; without L delta is small, f = e omega."""
    if it.driven == "front" and it.axles:  # its velocity (v, L omega) is turned by e delta
        delta = np.arctan2(it.axles * m.omega * np.sign(m.v), np.abs(m.v))
        return tuple(turned_front(m.v, m.omega, it.e * delta / it.axles, it.axles).T)
    tangent = np.maximum(steepness(m.v, m.omega, it.axles), 1e-6)
    return 0.0, 0.0, it.e * np.arctan(tangent) * (1.0 + tangent**2) / tangent * m.omega


SteeringScale = gain(
    "steering_scale",
    "the steering ratio of a car or tricycle is off, or the distance between its axles",
    _turned_more,
    About(
        equation="f_yaw = e omega; more in tight curves where the angles are large (axles); "
        "f_along = -e delta axles omega if the steered wheel is driven",
        typical="1 to 10 %: a nominal steering ratio, a servo's gain, an axle distance taken from a drawing",
        source="Rajamani, Vehicle Dynamics and Control, chapter 2 (kinematic bicycle model)",
        confused_with=("turn_asymmetry", "side_slip", "speed_scale"),
        drive="curves of several radii to both sides, at two speeds",
    ),
    drives=STEERED,
    unsteered="wheelbase",
    scan=classmethod(lambda cls, motions: on_every_axle_distance(cls(), motions)),
    e=parameter("", "true over nominal steering angle, minus one; as well nominal over true axle distance, minus one",
                low=-0.9995, high=1999.0, typical=0.03),
    axles=axles_parameter(),
    driven=driven_choice(),
)  # fmt: skip


_ROLLS_MPS = 0.01 - 1e-9
"""Speed from which a path shows the wheels' angle, m/s; just below a round one, which rounding may reach. Wheels turn
quickest at the low speeds of starts and reversals, where odometry from a steering angle has the exact ratio."""
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
        # least part of the recent travel that is in one direction where a path rolls; noise of a robot at rest has none
        return abs(way) >= max(_ROLLS_MPS * time_s, 0.5 * travel)


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
    initial = _Steering()
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

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f, from the lag of the wheels' curvature; for tau < 0, needed for slopes, the opposite."""
        if self.tau < 0.0:  # the opposite of what the lag adds to a largest rate alone
            late, after = replace(self, tau=-self.tau).twist_error(motion, state)
            return TwistError(2.0 * replace(self, tau=0.0).twist_error(motion, state).f - late, after)
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
        f = np.zeros(len(motion))
        f[rolls] = motion.v[rolls] * (curvature_at(wheels, self.axles) - curvature_at(shown, self.axles))
        rest_s = float(motion.dt_s.sum() - time_s[-1])
        return TwistError(stacked(0.0, 0.0, f, f), state._replace(angle=angle, ago_s=rest_s))

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


_ELASTIC = 0.05
"""Elastic range before the play opens, as a fraction of the play, so that jitter of the steering does not cross it."""
_AVERAGED_S = 2.0
"""Time over which the noise of the steering angle is averaged."""
_RANGE = 4.0
"""Range of a noise over its mean second difference: 8 standard deviations, and the mean is 1.95 of them."""


class _Linkage(NamedTuple):
    """State of the linkage.

    angle : last steering angle per distance between the axles, rad/m; None before the wheels rolled
    place : position of the linkage in its play, rad/m from the middle; for a true motion, in its elastic range
    side : 1 if the linkage pushes the wheels to the left, -1 to the right, 0 before it has moved
    last_s : end of the last increment, s
    reported : last angle that the odometry reported, rad/m
    change : of that angle, rad/m
    unseen : travel back from that side of which the samples show nothing, rad/m, by noise or between them
    noise : mean second difference of that angle times the root of the way: a noise of the heading, as of the ground
    """

    angle: float | None = None
    place: float = 0.0
    side: float = 0.0
    last_s: float = 0.0
    reported: float | None = None
    change: float = 0.0
    unseen: float = 0.0
    noise: float = 0.0


@dataclass(frozen=True, slots=True)
class SteeringPlay(Effect):
    """f = (0, 0, v tan(L delta) / L - omega): the wheels' angle L delta follows the odometry's through the play.

    With L the distance between the axles; without it angles are assumed small. The wheels keep their angle until the
    linkage, which begins in the middle of the play, has crossed it. Corruption crosses the play at once when the clean
    robot begins to steer back by more than the noise of its path.
    """

    name = "steering_play"
    odd = True
    layer = "record"
    initial = _Linkage()
    summary = "the steering linkage of a car or tricycle has play: its wheels follow only when it is crossed"
    drives = STEERED
    about = About(
        equation="f_yaw = v k - omega; the steering angle of the true curvature k held within +- play / 2 of the "
        "odometry's; play as the curvature of small angles",
        typical="0.5 to 3 degrees at the wheels: 0.03 to 0.2 rad/m on 0.3 m between the axles (an estimate)",
        source="the play operator, as in Visintin 1994, Differential Models of Hysteresis; Rajamani, Vehicle Dynamics "
        "and Control, chapter 2 (kinematic bicycle model)",
        confused_with=("steering_lag", "steering_offset", "turn_asymmetry"),
        drive="curves to both sides in turns, fast and slowly, and straights that begin from either side",
    )

    play: float = parameter(
        "rad/m", "range of the odometry's steering angle that moves nothing, per distance between the axles", low=0.0,
        high=1.0, typical=0.05, step=0.02,
    )  # fmt: skip
    axles: float = axles_parameter()

    @classmethod
    def scan(cls, motions: Sequence[Motion]) -> tuple[Self, ...]:
        """Return the effect for small steering angles, and for large ones."""
        return on_every_axle_distance(cls(), motions)

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: the turn lost in the play; for play < 0, needed for slopes, the opposite."""
        f, sign, half = np.zeros(len(motion)), float(np.sign(self.play)), 0.5 * abs(self.play)
        rolls = np.abs(motion.v) >= CREEP_MPS
        if not rolls.any():
            return TwistError(stacked(0.0, 0.0, f, f), state)
        v, dt_s = motion.v[rolls], motion.dt_s[rolls]
        angle, root = steered(motion.omega[rolls] / v, self.axles), np.sqrt(np.abs(v * dt_s))
        changes = np.diff(angle, prepend=angle[0] if state.angle is None else state.angle)
        second = np.abs(np.diff(changes, prepend=state.change)) * root
        gains = np.minimum(dt_s / _AVERAGED_S, 1.0)
        place, side, noise, unseen = state.place, state.side, state.noise, state.unseen
        before, places, elastic = state.change, [], _ELASTIC * abs(self.play)
        rows = zip(*(column.tolist() for column in (changes, second, root, gains)), strict=True)
        for change, rough, per_way, share in rows:
            reach = max(elastic, _RANGE * noise / per_way if per_way else 0.0)
            top = half + reach
            place = min(max(place + change, -top), top)
            if abs(place) == top:
                side, unseen = float(np.sign(place)), max(reach, abs(change), abs(before))
            before = change
            noise = _averaged(noise, rough, elastic * per_way, share)
            places.append(_linkage(place, side, half, unseen))
        followed = angle - np.array(places)
        f[rolls] = sign * v * (curvature_at(followed, self.axles) - curvature_at(angle, self.axles))
        last = float(angle[-1])
        after = state._replace(
            angle=last, place=place, side=side, unseen=unseen, reported=last, change=float(changes[-1]), noise=noise
        )
        return TwistError(stacked(0.0, 0.0, f, f), after)

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002 - no wheels
        """Return the increments (n, 3) computed from the linkage that steers the wheels through these."""
        ds = steps[:, 0]
        true = steered(np.divide(steps[:, 2], ds, out=np.zeros_like(ds), where=ds != 0.0), self.axles)
        moved, elastic = true.copy(), _ELASTIC * self.play
        before, place, side, last_s, reported, change, _, noise = state
        for i, (way, angle, now_s) in enumerate(zip(ds.tolist(), true.tolist(), t_s.tolist(), strict=True)):
            dt_s, last_s = now_s - last_s, now_s
            if dt_s < 0.0:  # time was reset
                before, place, side = None, 0.0, 0.0
            if not dt_s > 0.0 or abs(way) < CREEP_MPS * dt_s:
                continue
            root = sqrt(abs(way))
            top = max(elastic, _RANGE / root * noise)
            place = min(max(place + angle - (angle if before is None else before), -top), top)
            side, before = float(np.sign(place)) or side, angle
            # the noise is that of the reported angle, which correction knows
            earlier, moved[i] = reported, angle + 0.5 * self.play * side
            reported, last = float(moved[i]), change
            change = 0.0 if earlier is None else reported - earlier
            noise = _averaged(noise, abs(change - last) * root, elastic * root, min(dt_s / _AVERAGED_S, 1.0))
        turned = steps.copy()
        turned[:, 2] += (curvature_at(moved, self.axles) - curvature_at(true, self.axles)) * ds
        return Recorded(turned, _Linkage(before, place, side, last_s, reported, change, 0.0, noise))


def _averaged(noise: float, rough: float, least: float, gain: float) -> float:
    """Return the mean noise after a second difference, without those of steering; `least` ones always count."""
    # second difference over the mean beyond which it is no noise: steering begins or ends, or play is crossed
    return noise + gain * (min(rough, max(4.0 * noise, least)) - noise)


def _linkage(place: float, side: float, half: float, unseen: float) -> float:
    """Return the linkage's place in its play on the way back from a side, of which `unseen` is not in its place."""
    if side and half:
        place = side * half + (place - side * half) / (1.0 - 0.5 * min(unseen / half, 1.0))
    return min(max(place, -half), half)
