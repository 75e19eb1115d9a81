"""Readings of encoders and drivers: steps, truncated speeds, increments and counts that are lost."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from odomcorrupt.effects.effect import (
    About,
    Effect,
    Moments,
    Motion,
    RandomCoefficient,
    Recorded,
    State,
    TwistError,
    choice,
    gain,
    parameter,
    stacked,
)
from odomcorrupt.effects.random_processes import copied
from odomcorrupt.effects.wheels import (
    Rims,
    body_of,
    error_of_each_wheel,
    needed_track_m,
    on_every_track,
    rims_of,
    track_parameter,
    trial_speeds,
)
from odomcorrupt.geometry.motion import lost_parts, speed_steps

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.random import Generator
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array


@dataclass(frozen=True, slots=True)
class Quantization(Effect):
    """Each wheel reports whole ticks: its total travel rounded down to a multiple of `step`, from a random phase.

    The remainder of one increment appears in a later one, so the error is bounded. It is not a function of the reported
    motion and cannot be undone: f = 0 for correction and study, where it counts as noise.
    """

    name = "quantization"
    kind = "noise"
    layer = "record"
    needs_track = True
    summary = "wheels report whole ticks"
    about = About(
        equation="reported travel of a wheel = step floor(travel / step + phase)",
        typical="0.1 to 2 mm of wheel travel a tick",
        source="uniform quantization, as in any text on signal processing (Widrow & Kollar 2008)",
        confused_with=("heavy_tails",),
        drive="drive very slowly: increments then come in a lattice, in the odometry alone",
    )

    step: float = parameter("m", "wheel travel of one tick", low=0.0, high=0.1, typical=0.0005)

    def start(self, rng: Generator) -> State:
        """Return the travel of each wheel, right and left, metres: a random phase between two ticks."""
        return tuple((self.step * copied(rng).uniform(size=2)).tolist())

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002 - at any time
        """Return increments of whole ticks; the sideways travel of holonomic robots is unchanged."""
        track = needed_track_m(self, track_m)
        if self.step == 0.0:
            return Recorded(steps, state)
        ends, counted = [], []
        for travel, before in zip(rims_of(steps[:, 0], steps[:, 2], track), state, strict=True):
            so_far = np.cumsum(np.concatenate(([before], travel)))
            ends.append(float(so_far[-1]))
            counted.append(self.step * np.diff(np.floor(so_far / self.step)))
        reported = body_of(Rims(*counted), track)
        reported[:, 1] = steps[:, 1]
        return Recorded(reported, tuple(ends))

    def moments(self, motion: Motion) -> Moments:
        """Return zero mean, and the variance of a tick count with uniformly random phase."""
        track = needed_track_m(self, motion.track_m)
        ticks = [np.abs(u) * motion.dt_s / self.step for u in rims_of(motion.v, motion.omega, track)]
        over = [t - np.floor(t) for t in ticks]
        single = self.step**2 * sum(p * (1.0 - p) for p in over)
        rate = np.divide(1.0, motion.dt_s, out=np.zeros_like(motion.dt_s), where=motion.dt_s > 0.0) ** 2
        variance = stacked(single * rate / 4.0, 0.0, single * rate / track**2, motion.v)
        return Moments(np.zeros((len(motion), 3)), variance)


_LONG_S = 3600.0
_STILL = 0.02
"""Speed, m/s and rad/s, over which the sign of a speed fades: a standing robot sways by about as much. With a tenth of
it, noise of the odometry biased the fitted steps of clean drives by two standard errors."""
_STILL_MEAN = 0.002
"""The same for mean speeds, which have less noise: below the steps of serial protocols."""
_NEAR_S = 0.5
"""Window of the mean speed that a correction reads, seconds: slow turns are reported as single steps among zeros."""
_TICKS = (0.15, 1.0, 0.01)
"""Trial ticks: least and largest, as multiples of the ticks that equal a step, and their relative spacing, by which the
beats of two neighbours hardly differ within the tens of steps of usual speeds."""


@dataclass(frozen=True, slots=True)
class TruncatedVelocity(Effect):
    """f = (step sign(v) / 2, 0, turn sign(omega) / 2): on average half a step is truncated towards zero.

    With rounding = down, it is lost upwards in both directions. Corruption truncates speeds to whole steps. The report
    does not show the remainder, so correction adds its mean, which it reads from the mean speed around each moment.
    Towards rest the sign fades as u / sqrt(u^2 + 0.02^2).

    If speeds are counts of encoder ticks in a loop, they come in steps before the truncation already, and each reported
    step loses another part (`tick`). The steps themselves are then those that the odometry shows.
    """

    name = "truncated_velocity"
    odd = True
    layer = "record"
    summary = "velocities are truncated to whole steps before they are integrated"
    about = About(
        equation="reported v = step trunc(v / step); on average f = (step sign(v) / 2, 0, turn sign(omega) / 2)",
        typical="steps of 1 to 50 mm/s and 0.01 to 0.1 rad/s, of integers in a serial protocol (an estimate)",
        source="rounding towards zero, as an integer cast in C does (ISO/IEC 9899, 6.3.1.4); down, as // in Python",
        confused_with=("dead_band", "wheel_scale", "counts_lost"),
        drive="the same straight, and turns on the spot, very slowly and fast",
    )

    step: float = parameter("m/s", "step of the forward speed", low=0.0, high=0.5, typical=0.02)
    turn: float = parameter("rad/s", "step of the yaw rate", low=0.0, high=1.0, typical=0.05)
    tick: float = parameter(
        "m/s", "rim speed of one encoder tick per loop, if ticks are counted before", low=0.0, high=0.5, typical=0.01,
        amplitude=False, optional=True,
    )  # fmt: skip
    rounding: str = choice("to which side speeds are rounded: towards zero, or down", "zero", "down")

    @classmethod
    def scan(cls, motions: Sequence[Motion]) -> tuple[Self, ...]:
        """Return the mean over all speeds and, if the odometry shows its steps, the beats of each trial tick."""
        steps, track_m = (motions[0].steps, motions[0].track_m) if len(motions) else (None, None)
        if steps is None or track_m is None:
            return (cls(),)
        ends = np.array((2.0 * steps[0], steps[1] * track_m))
        ticks = np.exp(np.arange(np.log(_TICKS[0] * ends.min()), np.log(_TICKS[1] * ends.max()), _TICKS[2]))
        return (cls(), *(cls(tick=float(tick)) for tick in ticks if tick < 0.5))

    @property
    def lost_m(self) -> float:
        """Bound on the uncorrectable error: the odometry does not show the truncated part, between zero and a step."""
        return sum(self.remainder) * _LONG_S

    @property
    def remainder(self) -> tuple[float, float]:
        """Half a step, the largest difference between the truncated part and its mean."""
        return 0.5 * self.step, 0.5 * self.turn

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: half a step in the direction of the motion, or upwards while a speed is reported."""
        return TwistError(self._lost(motion, _STILL), state)

    def _lost(self, motion: Motion, still: float) -> Array:
        """Return the mean (n, 3) of what is truncated; its sign fades over the speed `still`."""
        track_m, steps = motion.track_m, motion.steps
        fades = [u / np.hypot(u, still) for u in (motion.v, motion.omega)]
        if self.rounding == "down":
            lost = [0.5 * fade**2 for fade in fades]
        elif self.tick and track_m is not None and steps is not None:
            lost = [
                part * np.abs(fade)
                for part, fade in zip(lost_parts(motion.v, motion.omega, self.tick, steps, track_m), fades, strict=True)
            ]
        else:
            lost = [0.5 * fade for fade in fades]
        return stacked(self.step * lost[0], 0.0, self.turn * lost[1], motion.v)

    def restored(self, motion: Motion) -> Motion:
        """Return the motion plus f of the mean speeds around each moment, unless the odometry reports rest."""
        moving = (motion.v != 0.0) | (motion.omega != 0.0)
        v, omega = (_mean_around(speed, motion.dt_s) for speed in (motion.v, motion.omega))
        steps = speed_steps(motion.v, motion.omega, motion.dt_s, motion.track_m) if self.tick else None
        mean = replace(motion, v=v, omega=omega, steps=steps)
        f = self._lost(mean, _STILL_MEAN) * moving[:, None]
        return replace(motion, v=motion.v + f[:, 0], omega=motion.omega + f[:, 2])

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:
        """Return increments with speeds truncated to whole steps, of whole ticks if these are counted before."""
        before_s, *phases = state or (0.0, 0.0, 0.0)
        dt = np.diff(t_s, prepend=before_s)
        moves = dt > 0.0
        cut = steps.copy()
        if self.tick > 0.0 and track_m is not None:
            rims = []
            for i, travel in enumerate(rims_of(steps[:, 0], steps[:, 2], track_m)):
                one_m = np.where(moves, self.tick * dt, np.inf)
                so_far = np.cumsum(np.concatenate((phases[i : i + 1], travel / one_m)))
                rims.append(np.where(moves, np.diff(np.floor(so_far)) * self.tick * dt, travel))
                phases[i] = float(so_far[-1])
            cut[:, [0, 2]] = body_of(Rims(*rims), track_m)[:, [0, 2]]
        cut_to = np.trunc if self.rounding == "zero" else np.floor
        for column, size in ((0, self.step), (2, self.turn)):
            if size > 0.0:
                whole = size * dt
                counted = np.divide(cut[:, column], whole, out=np.zeros_like(dt), where=moves)
                cut[:, column] = np.where(moves, whole * cut_to(counted), cut[:, column])
        return Recorded(cut, (float(t_s[-1]), *phases) if len(t_s) else state)


@dataclass(frozen=True, slots=True)
class TruncatedCounts(Effect):
    """f of a wheel = step sign(u) / 2: each reading is truncated to whole ticks, and its remainder is lost.

    A lost remainder is between nothing and a whole tick, whichever way the wheel turns. Slow wheels are reported as
    single ticks among zeros, so u is the mean rim speed around each moment. Without a track, f applies to the body.
    """

    name = "truncated_counts"
    odd = True
    layer = "record"
    initial = 0.0  # the last stamp, s
    summary = "each reading of a wheel is truncated to whole ticks, and the remainder is lost"
    about = About(
        equation="reported u = step trunc(u / step); on average f_wheel = step sign(u) / 2",
        typical="one tick of 0.2 to 2 mm at 50 readings per second: 0.01 to 0.1 m/s (by arithmetic)",
        source="rounding towards zero, as an integer division in C does (ISO/IEC 9899, 6.5.5)",
        confused_with=("wheel_scale", "speed_scale", "truncated_velocity", "dead_band"),
        drive="the same straight, and turns on the spot, very slowly and fast",
    )

    step: float = parameter("m/s", "rim speed of one tick per reading", low=0.0, high=0.5, typical=0.02)
    track: float = track_parameter()

    @classmethod
    def scan(cls, motions: Sequence[Motion]) -> tuple[Self, ...]:
        """Return the effect on every trial track."""
        return on_every_track((cls(),), motions)

    @property
    def lost_m(self) -> float:
        """Bound on the uncorrectable error: a wheel at a constant speed loses another part of a tick than its mean."""
        return self.step * _LONG_S

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: half a tick in the direction that each wheel turns."""
        v, omega = (_mean_around(speed, motion.dt_s) for speed in (motion.v, motion.omega))
        track_m, half = self.track or motion.track_m, self.step / 2.0
        return TwistError(error_of_each_wheel(lambda u: half * u / np.hypot(u, _STILL_MEAN), v, omega, track_m), state)

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:
        """Return increments of whole ticks of each wheel; sideways travel is unchanged."""
        dt = np.diff(t_s, prepend=state)[:, None]
        v, _, omega = np.divide(steps, dt, out=np.zeros_like(steps), where=dt > 0.0).T
        whole = lambda u: self.step * np.trunc(u / (self.step or 1.0)) - u  # noqa: E731
        lost = error_of_each_wheel(whole, v, omega, self.track or track_m) if self.step else 0.0
        return Recorded(steps + lost * dt, float(t_s[-1]) if len(t_s) else state)


def _mean_around(speed: Array, dt_s: Array) -> Array:
    """Return the mean (n,) of a speed in windows of `_NEAR_S` around the middle of each interval."""
    ends_s = np.concatenate(([0.0], np.cumsum(dt_s)))
    travel = np.concatenate(([0.0], np.cumsum(speed * dt_s)))
    middle_s = (ends_s[:-1] + ends_s[1:]) / 2.0
    first, last = (np.clip(middle_s + side * _NEAR_S / 2.0, 0.0, ends_s[-1]) for side in (-1.0, 1.0))
    return (np.interp(last, ends_s, travel) - np.interp(first, ends_s, travel)) / np.maximum(last - first, 1e-9)


_ROUNDING = 1e-9
"""Largest increment that counts as zero (rounding), metres or radians."""
_MOVING_MPS = 0.05
_NEIGHBOURS = 2
"""Number of increments on each side whose mean is the expected size of a pair of neighbours."""
_LEAST_TICKS, LEAST_WHEEL_TICKS = 1.5, 2.5
"""Smallest neighbour of a lost increment, in ticks: two whole ones; three in evidence that a single wheel loses any."""
_USUAL_QUANTILE, _ROUNDING_M = 0.8, 1e-7
"""Quantile of the changes between increments taken as the usual change; change that counts as zero, metres."""
_ALIKE = 1e-3
"""Relative difference of increments of equal length: a chord is shorter than its arc by a 24th of the turn squared."""
_TRACKS_M, _TRACK_RANGE = (0.03, 3.0), (0.7, 1.4)
"""Tracks that a driver may compute the odometry with: of any robot, and as a multiple of a robot's known track."""
_STEADY = 0.25
"""Largest relative change of the other wheel's speed at such a loss."""


@dataclass(frozen=True, slots=True)
class LostIncrements(Effect):
    """Each increment is lost with probability `fraction`: the reported pose stops while the robot moves on.

    `wheel` limits the losses to one encoder: the odometry turns about the wheel whose increment is lost. Independent
    losses of both wheels are the effect twice, once for each wheel.

    On average this equals a scale error of the same size, but which increments are lost is random: it counts as noise.
    A correction does not scale up the other increments. It interpolates lost ones, visible as an increment of zero
    between neighbours that move.
    """

    name = "lost_increments"
    kind = "noise"
    layer = "record"
    restorable = True
    summary = "some increments of the odometry are lost, with their travel"
    about = About(
        equation="reported increment, of the robot or of one wheel, = 0 with probability fraction",
        typical="0.1 to 5 % on a bad serial line (an estimate)",
        source="engineering judgement; no published figures known to us",
        confused_with=("wheel_scale", "unequal_wheels", "slip_burst"),
        drive="any: single increments of zero between neighbours that move, in the odometry alone",
    )

    fraction: float = parameter("", "part of the increments that is lost", low=0.0, high=0.9, typical=0.01)
    wheel: str = choice("whose increments are lost: of both wheels at once, or of one", "both", "left", "right")
    track: float = track_parameter()

    def start(self, rng: Generator) -> State:
        """Return the random generator of the losses."""
        return rng

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002 - at any time
        """Return the increments with the lost ones set to zero."""
        rng = copied(state)
        lost = rng.uniform(size=len(steps)) < self.fraction
        if self.wheel == "both":
            return Recorded(np.where(lost[:, None], 0.0, steps), rng)
        return Recorded(np.where(lost[:, None], steps - self._travel_of_wheel(steps, track_m), steps), rng)

    def restored(self, motion: Motion) -> Motion:
        """Return the motion with the clearly lost increments interpolated between their neighbours."""
        if not self.acts:
            return motion
        if self.wheel == "both":
            gone = losses(motion).lost
            v, vy, omega = (_interpolated(speed, gone, motion) for speed in (motion.v, motion.vy, motion.omega))
            return replace(motion, v=v, vy=vy, omega=omega)
        found = wheel_losses(motion, self.track or motion.track_m)
        if found is None:
            return motion
        rims = rims_of(motion.v, motion.omega, found.track_m)._asdict()
        rims[self.wheel] = _interpolated(rims[self.wheel], getattr(found, self.wheel).lost, motion)
        v, _, omega = body_of(Rims(**rims), found.track_m).T
        return replace(motion, v=v, omega=omega)

    def moments(self, motion: Motion) -> Moments:
        """Return mean and variance of the loss."""
        twist = self._twist(motion)
        return Moments(self.fraction * twist, self.fraction * (1.0 - self.fraction) * twist**2)

    def gains(self, motion: Motion) -> tuple[RandomCoefficient, ...]:
        """Return one independent coefficient per increment; the mean loss is not included."""
        variance = self.fraction * (1.0 - self.fraction)
        return (RandomCoefficient(self._twist(motion), np.zeros_like(motion.v), np.full_like(motion.v, variance), 0.0),)

    def _twist(self, motion: Motion) -> Array:
        """Return the part (n, 3) of the twist that a loss takes away."""
        twist = stacked(motion.v, motion.vy, motion.omega, motion.v)
        return twist if self.wheel == "both" else self._travel_of_wheel(twist, motion.track_m)

    def _travel_of_wheel(self, body: Array, track_m: float | None) -> Array:
        """Return the part (n, 3) of a motion of the body (n, 3) that is due to the wheel alone."""
        track = needed_track_m(self, track_m)
        rims = rims_of(body[:, 0], body[:, 2], track)
        still = np.zeros(len(body))
        return body_of(Rims(still, rims.left) if self.wheel == "left" else Rims(rims.right, still), track)


def _interpolated(speed: Array, gone: NDArray[np.bool_], motion: Motion) -> Array:
    """Return a speed (n,) with its lost values interpolated between their neighbours."""
    middle = np.cumsum(motion.dt_s) - motion.dt_s / 2.0
    return np.where(gone, np.interp(middle, middle[~gone], speed[~gone]), speed) if gone.any() else speed


class Losses(NamedTuple):
    """Lost increments detected in an odometry.

    lost : (n,) True for increments of zero, single or a few in a row, that should have been several ticks
    seen : number of lost increments detected
    of : number of increments, lost or not, whose loss would have been detected
    hidden : fraction of the moving increments that have too few ticks for a loss to be detected
    fast : fraction of the losses at speeds of at least the median of the increments whose loss would have been detected
    """

    lost: NDArray[np.bool_]
    seen: int
    of: int
    hidden: float
    fast: float

    @property
    def fraction(self) -> float:
        """Fraction of increments lost, among those whose loss would have been detected."""
        return self.seen / max(self.of, 1)


class WheelLosses(NamedTuple):
    """Lost increments detected for each wheel.

    right, left : where both wheels' increments are lost at once, both have the loss
    alone : (right, left) number of losses of the one wheel while the other moves
    track_m : track that the odometry is computed with
    """

    right: Losses
    left: Losses
    alone: tuple[int, int]
    track_m: float


def losses(motion: Motion) -> Losses:
    """Return the lost increments of an odometry: those of the whole robot.

    An increment of zero is a loss if both neighbours are clearly larger than the usual change between increments: an
    encoder of coarse ticks reports zeros, but none between increments of two ticks. A late count is not a loss: a
    neighbour catches up, so the two neighbours are longer than the increments around them.
    """
    # assumed distance of the wheels from the middle if the track is unknown, metres: a turn on the spot moves them
    arm_m = 0.2 if motion.track_m is None else motion.track_m / 2.0
    travel = (np.hypot(motion.v, motion.vy) + arm_m * np.abs(motion.omega)) * motion.dt_s
    moves = (np.abs(motion.v) + np.abs(motion.vy) + np.abs(motion.omega)) * motion.dt_s >= _ROUNDING
    return _losses_of(motion, travel, moves, _LEAST_TICKS)


def wheel_losses(motion: Motion, track_m: float | None, ticks: float = _LEAST_TICKS) -> WheelLosses | None:
    """Return the lost increments of each wheel, by the rule of `losses`; None if the odometry's track is unknown.

    The travel of a wheel is exactly zero only for the track that the driver computes with, which may differ from the
    robot's. Losses show it themselves; the robot's is taken if they are few.

    track_m : track of the robot, or None if unknown
    ticks : smallest neighbour of a loss, in ticks
    """
    own_m = _track_of_losses(motion, track_m) or track_m
    if own_m is None:
        return None
    rims = rims_of(motion.v * motion.dt_s, motion.omega * motion.dt_s, own_m)
    exact = _ROUNDING + (_ALIKE + (motion.omega * motion.dt_s) ** 2 / 24.0) * np.maximum(*np.abs(rims))
    moves = [np.abs(travel) > exact for travel in rims]
    right, left = (_losses_of(motion, u, m, ticks) for u, m in zip(rims, moves, strict=True))
    alone = int(np.sum(right.lost & moves[1])), int(np.sum(left.lost & moves[0]))
    return WheelLosses(right, left, alone, own_m)


def _losses_of(motion: Motion, travel: Array, moves: NDArray[np.bool_], ticks: float) -> Losses:
    """Return the lost increments of a travel.

    travel : (n,) metres; neighbours of a loss have the same sign
    moves : (n,) False where the travel is zero
    ticks : smallest neighbour of a loss, in ticks
    """
    gone = np.zeros(len(motion), dtype=bool)
    going = np.flatnonzero(moves)
    way = np.abs(travel[going])
    if len(going) < _NEIGHBOURS + 2:
        return Losses(gone, 0, 0, 0.0, 0.0)
    fast = way > _MOVING_MPS * motion.dt_s[going]
    plain = fast & (way > ticks * _usual_change(going, way))

    last, following = going[:-1], going[1:]
    gap = following - last - 1
    ends_s = np.cumsum(motion.dt_s)
    gap_s = ends_s[following - 1] - ends_s[last]
    # longest gap that counts as a loss, seconds; a longer rest may be a real stop
    alone = (gap == 1) | ((gap > 1) & (gap <= 3) & (gap_s < 0.25))
    zero = alone & plain[:-1] & plain[1:] & (travel[last] * travel[following] > 0.0)
    caught_up = zero & (way[:-1] + way[1:] > 1.35 * 2.0 * _around(way))
    found = zero & ~caught_up
    if caught_up.sum() > found.sum():
        found[:] = False  # the counts of this odometry arrive late: the apparent losses did, too
    # rate of single losses above which losses of several increments in a row are plausible
    if np.sum(found & (gap == 1)) < 0.005 * np.sum(fast):
        found &= gap == 1  # if hardly any increment is lost, several zeros in a row are a stop
    for begin, count in zip(last[found], gap[found], strict=True):
        gone[begin + 1 : begin + 1 + count] = True
    gone &= motion.dt_s > 0.0  # a duplicated stamp is no loss

    pairs = plain[:-1] & plain[1:] & ((gap == 0) | found)
    hidden = 1.0 - float(plain.sum()) / max(int(fast.sum()), 1)
    speed = way / motion.dt_s[going]
    slower = np.minimum(speed[:-1], speed[1:])
    above = float(np.mean(slower[found] >= np.median(slower[pairs]))) if found.any() else 0.0
    return Losses(gone, int(gone.sum()), int(gone.sum()) + int(pairs.sum()), hidden, above)


def _track_of_losses(motion: Motion, track_m: float | None) -> float | None:
    """Return the track, metres, that the odometry is computed with, or None if losses of single wheels do not show it.

    If only one wheel's increment is lost, v = +-omega track / 2 exactly. Of the intervals between which the one wheel
    would have stopped and the other kept its speed, those of losses have one and the same ratio.
    """
    v, omega = motion.v[1:-1], motion.omega[1:-1]
    ratio = np.divide(2.0 * np.abs(v), np.abs(omega), out=np.zeros_like(v), where=omega != 0.0)
    lowest, highest = _TRACKS_M if track_m is None else (track_m * part for part in _TRACK_RANGE)
    half = np.where(v * omega > 0.0, 0.5, -0.5) * ratio  # of the wheel that moves
    stopped, other = (
        [motion.v[rows] + side * half * motion.omega[rows] for rows in (slice(None, -2), slice(2, None))]
        for side in (-1.0, 1.0)
    )
    here, mean = 2.0 * np.abs(v), (other[0] + other[1]) / 2.0
    shows = (ratio > lowest) & (ratio < highest) & (stopped[0] * stopped[1] > 0.0)
    shows &= np.minimum(*np.abs(stopped)) > np.maximum(_STEADY * here, _MOVING_MPS)
    shows &= np.abs(2.0 * v - mean) < _STEADY * here
    ratios = np.sort(ratio[shows])
    if not len(ratios):
        return None
    alike = np.searchsorted(ratios, ratios * (1.0 + 2.0 * _ALIKE)) - np.arange(len(ratios))
    first = int(np.argmax(alike))
    # fewest lost increments of a wheel that show the track: their ratios of travel to turn are the same
    return float(np.median(ratios[first : first + alike[first]])) if alike[first] >= 5 else None


def _usual_change(going: NDArray[np.int64], way: Array) -> float:
    """Return the usual non-zero change between consecutive moving increments, metres: about one tick.

    If all are equally long, also while starting and stopping, each is one tick, and zeros between ticks are no losses.
    """
    if np.ptp(way) < _ALIKE * way.max():
        return float(way.max())
    change = np.abs(np.diff(way))[np.diff(going) == 1]
    change = change[change > _ROUNDING_M]
    return float(np.quantile(change, _USUAL_QUANTILE)) if len(change) else 0.0


def _around(way: Array) -> Array:
    """Return the mean (n - 1,) of the increments around each pair of neighbours, excluding the pair."""
    padded = np.concatenate((np.full(_NEIGHBOURS, way[0]), way, np.full(_NEIGHBOURS, way[-1])))
    total = np.convolve(padded, np.ones(2 * _NEIGHBOURS + 2), "valid")
    return (total[: len(way) - 1] - way[:-1] - way[1:]) / (2.0 * _NEIGHBOURS)


_SPEEDS = (0.4, 0.6, 0.75, 0.88)
"""Trial values of the speed limit, as fractions of a drive's highest rim speed."""


# beyond the speed, 1 / (1 + part) of a wheel's rotation is counted; without a track, f applies to the body
CountsLost = gain(
    "counts_lost",
    "encoder counts are lost above a speed: fast wheels go farther than is counted",
    lambda it, m: tuple(error_of_each_wheel(
        lambda u: it.part * np.sign(u) * np.maximum(np.abs(u) - it.speed, 0.0), m.v, m.omega, it.track or m.track_m
    ).T),
    About(
        equation="f_wheel = part (abs(u) - speed) sign(u) where abs(u) > speed",
        typical="from half of full speed on where interrupts of a microcontroller count a fast encoder (an estimate)",
        source="engineering judgement; no published figures known to us",
        confused_with=("speed_scale", "wheel_scale", "dead_band"),
        drive="the same straight at several speeds up to the highest, and fast turns on the spot",
    ),
    odd=True,
    scan=classmethod(lambda cls, motions: on_every_track(
        [cls(speed=speed) for speed in trial_speeds(motions, 0.99, _SPEEDS, 0.02, 10.0)], motions)),
    part=parameter("", "travel lost above the speed, over travel counted there", low=0.0, high=20.0, typical=0.3),
    speed=parameter("m/s", "rim speed above which they are lost", low=0.02, high=10.0, typical=0.3, identity=0.3,
                    amplitude=False),
    track=track_parameter(),
)  # fmt: skip
