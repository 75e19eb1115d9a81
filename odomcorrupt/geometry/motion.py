"""Motion derived from a trajectory: rates, accelerations, and speeds in steps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from odomcorrupt.geometry.se2 import increments, rotate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array


SMOOTHING_S = 0.2
"""Window of the study's smoothed speeds and accelerations: averages ticks, resolves stops."""
TRAIL_S = 0.05
"""Averaging time of speeds before differentiation, because stamps may be bunched and poses come in ticks."""
ROUGH = (0.01, 0.02)
"""Noise of forward, m/s^2, and yaw acceleration, rad/s^2, above which odometry is rough: a tenth of the least
thresholds that the study tries, and more than any smooth simulation has."""
_BLOCK = 1024


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Motion:
    """Motion over n intervals as reported by the odometry, (n,) each.

    t_s : since the first odometry stamp, seconds, at the end of the interval
    dt_s : length of the interval, seconds; if it is 0 the rates are 0
    v, vy : forward and leftward speed, m/s (signed)
    omega : yaw rate, rad/s
    acceleration : (n, 3) forward and leftward, m/s^2, and yaw acceleration, rad/s^2, see `accelerations`
    x, y, theta : pose at the beginning of the interval, metres and radians
    distance : distance travelled so far, metres
    track_m : the robot's nominal track, metres, or None if unknown
    trail : (n, 3) mean true speeds whose rate is `acceleration`; None if speeds are smooth already
    before : (n, 2, 3) acceleration and trail of the previous interval; None if speeds are smooth already
    reported : (n, 2) travel, m, and turn, rad, of the odometry so far; None if `v` and `omega` are the odometry's
    steps : steps of the reported speed, m/s, and yaw rate, rad/s, see `speed_steps`

    Speeds are the odometry's. Acceleration, pose and distance are the true ones: of the clean motion in corruption, of
    the corrected one in correction, of the smoothest estimate in the study. Forces accelerate the body, and effects
    of the floor depend on its position. Effects of accelerations can be applied and inverted stably only in this way.
    """

    t_s: Array
    dt_s: Array
    v: Array
    vy: Array
    omega: Array
    acceleration: Array
    x: Array
    y: Array
    theta: Array
    distance: Array
    track_m: float | None = None
    trail: Array | None = None
    before: Array | None = None
    reported: Array | None = None
    steps: tuple[float, float] | None = None

    def rolled(self, arm_m: float, before_m: float = 0.0) -> Array:
        """Return the reported travel (n + 1,), m, of a wheel `arm_m` to the right of the centre, from `before_m` on."""
        if self.reported is not None:
            return before_m + np.concatenate(([0.0], self.reported @ (1.0, arm_m)))
        return np.cumsum(np.concatenate(([before_m], (self.v + arm_m * self.omega) * self.dt_s)))

    @property
    def twist(self) -> Array:
        """The reported speeds (n, 3): v, vy, omega."""
        return np.stack((self.v, self.vy, self.omega), axis=1)

    @property
    def speed(self) -> Array:
        """Magnitude of the velocity (n,), m/s."""
        return np.hypot(self.v, self.vy)

    @property
    def travel(self) -> Array:
        """Travel over each interval (n,), m."""
        return self.speed * self.dt_s

    @property
    def in_step(self) -> Motion:
        """The motion with all speeds in step with their accelerations: integrals of their products do not drift."""
        if self.trail is None:
            return self
        return replace(self, v=self.trail[:, 0], vy=self.trail[:, 1], omega=self.trail[:, 2])

    @property
    def just_before(self) -> Motion:
        """The motion in step, with speeds and accelerations of the previous interval."""
        if self.before is None:
            return self.in_step
        return replace(self, acceleration=self.before[:, 0], trail=self.before[:, 1]).in_step

    @property
    def steady_v(self) -> Array:
        """Forward speed (n,), m/s, in step with `a`: the product of both is the rate of half its square."""
        return self.v if self.trail is None else self.trail[:, 0]

    @property
    def a(self) -> Array:
        """Forward acceleration (n,), m/s^2."""
        return self.acceleration[:, 0]

    @property
    def alpha(self) -> Array:
        """Yaw acceleration (n,), rad/s^2."""
        return self.acceleration[:, 2]

    def __len__(self) -> int:
        return len(self.t_s)


class LineFits:
    """Line fits to samples in windows around given times; sums that depend only on the times are precomputed.

    Running sums make the cost linear in the number of samples; stamps may be uneven. Sums restart every `_BLOCK`
    windows, because over an hour they would lose a thousandth of a speed. If a window has fewer than two samples, the
    nearest ones on both sides are used.

    t_s : (n,) times of the samples, seconds
    at_s : (m,) centres of the windows, seconds
    width_s : width of the windows
    """

    def __init__(self, t_s: Array, at_s: Array, width_s: float) -> None:
        first = np.searchsorted(t_s, at_s - width_s / 2.0, side="left")
        last = np.searchsorted(t_s, at_s + width_s / 2.0, side="right")
        here = np.clip(np.searchsorted(t_s, at_s), 1, len(t_s) - 1)
        first, last = np.minimum(first, here - 1), np.maximum(last, here + 1)
        self._middle, self._spread = np.empty(len(at_s)), np.empty(len(at_s))
        starts = range(0, len(at_s), _BLOCK)
        self._blocks = tuple(_Block.of(t_s, slice(i, i + _BLOCK), first, last) for i in starts)
        for block in self._blocks:
            since, count = block.since_s, block.last - block.first
            st, stt = block.sums(np.stack((since, since**2)))
            self._middle[block.rows] = st / count
            self._spread[block.rows] = np.maximum(stt - st**2 / count, 1e-12)

    def slopes(self, values: Array) -> Array:
        """Return the time derivatives (m, c) of values (n, c): the slopes of the lines.

        They are exactly zero in windows of constant values, so that rounding of the sums does not look like motion.
        """
        of_each = np.ascontiguousarray(values.T)
        slope = np.empty((len(of_each), len(self._middle)))
        changes = np.zeros(of_each.shape[1], dtype=np.int64)
        np.cumsum((of_each[:, 1:] != of_each[:, :-1]).any(axis=0), out=changes[1:])
        for block in self._blocks:
            x = of_each[:, block.samples] - of_each[:, block.samples.start, None]
            own = (block.sums(x * block.since_s) - block.sums(x) * self._middle[block.rows]) / self._spread[block.rows]
            here = changes[block.samples]
            own[:, here[block.first] == here[block.last - 1]] = 0.0
            slope[:, block.rows] = own
        return slope.T


class _Block(NamedTuple):
    """Successive windows of line fits, whose sums are differences of the same running sums.

    rows, samples : indices of the windows, and of the samples in them
    t_s : times of the samples, seconds
    first, last : index of each window's first sample, and of the one after its last, within `samples`
    """

    rows: slice
    samples: slice
    t_s: Array
    first: NDArray[np.int64]
    last: NDArray[np.int64]

    @classmethod
    def of(cls, t_s: Array, rows: slice, first: NDArray[np.int64], last: NDArray[np.int64]) -> Self:
        """Return the block of some windows, given the samples' times and each window's first and last one."""
        first, last = first[rows], last[rows]
        samples = slice(int(first.min()), int(last.max()))
        return cls(rows, samples, t_s[samples], first - samples.start, last - samples.start)

    @property
    def since_s(self) -> Array:
        """Times of the samples since the first one, seconds."""
        return self.t_s - self.t_s[0]

    def sums(self, values: Array) -> Array:
        """Return the sums (c, windows) of values (c, samples) over each window."""
        running = np.empty((len(values), values.shape[1] + 1))
        running[:, 0] = 0.0
        values.cumsum(axis=1, out=running[:, 1:])
        return running.take(self.last, axis=1) - running.take(self.first, axis=1)


class LocalSlopes:
    """Smooth twists and accelerations of paths with the same stamps, from line fits in windows around given times.

    t_s : (n,) stamps of the poses, seconds
    at_s : (m,) centres of the windows, seconds
    width_s : width of the windows
    """

    def __init__(self, t_s: Array, at_s: Array, width_s: float) -> None:
        self._poses, self._twists = LineFits(t_s, at_s, width_s), LineFits(at_s, at_s, width_s)

    def twist(self, xyt: Array, heading: Array) -> Array:
        """Return the twists (m, 3) of poses (n, 3) with headings (m,) at the centres."""
        world = self._poses.slopes(xyt)
        return np.concatenate((rotate(world[:, :2], -heading), world[:, 2:]), axis=1)

    def accelerations(self, twist: Array) -> Array:
        """Return the accelerations (m, 3), the slopes of twists (m, 3)."""
        return self._twists.slopes(twist)


def slopes(t_s: Array, values: Array, at_s: Array, width_s: float) -> Array:
    """Return time derivatives (m, c) of values (n, c) at times at_s (m,): slopes of `LineFits`."""
    return LineFits(t_s, at_s, width_s).slopes(values)


class SpeedMemory(NamedTuple):
    """The last `TRAIL_S` of a motion, from which the accelerations of the next intervals are computed.

    clock_s : (m,) elapsed time at the ends of intervals, seconds
    travel : (m, 3) cumulative travel forward (m), leftward (m) and turn (rad) at these times
    latest : (2, 3) acceleration and trail of the last interval
    """

    clock_s: Array
    travel: Array
    latest: Array


class Accelerations(NamedTuple):
    """Accelerations, and the speeds consistent with them.

    rate : (n, 3) m/s^2 and rad/s^2
    trail : (n, 3) the speeds that change at this rate, at the middle of each interval, m/s and rad/s
    before : (n, 2, 3) rate and trail of the interval before each; zero before the first
    memory : state for the next intervals; None before any time has passed
    """

    rate: Array
    trail: Array
    before: Array
    memory: SpeedMemory | None


def accelerations(twist: Array, dt_s: Array, memory: SpeedMemory | None = None) -> Accelerations:
    """Return the accelerations over n intervals from twists (n, 3) and lengths dt_s (n,), seconds.

    Rate of change of the mean speed over the last `TRAIL_S`, from an interval's start to its end. It is causal (with a
    mean delay of `TRAIL_S` / 2), any division of a motion gives the same bits, and its integral over a run is the
    change of speed, at any rate and jitter of stamps. The twist before the first interval is assumed equal to it.
    """
    n = len(dt_s)
    rate = np.zeros((n, 3))
    first = 0
    if memory is None:
        first = int(np.argmax(dt_s > 0.0)) if n else 0
        if not n or dt_s[first] <= 0.0:
            return Accelerations(rate, np.zeros((n, 3)), np.zeros((n, 2, 3)), None)
        before = 2.0 * TRAIL_S
        way = np.stack((-before * twist[first], np.zeros(3)))
        memory = SpeedMemory(np.array([-before, 0.0]), way, np.zeros((2, 3)))
    clock = np.cumsum(np.concatenate((memory.clock_s[-1:], dt_s)))
    travel = np.cumsum(np.concatenate((memory.travel[-1:], twist * dt_s[:, None])), axis=0)
    clock_s = np.concatenate((memory.clock_s, clock[1:]))
    way = np.concatenate((memory.travel, travel[1:]))
    earlier = np.stack([np.interp(clock - TRAIL_S, clock_s, way[:, i]) for i in range(3)], axis=1)
    speed = (travel - earlier) / TRAIL_S
    np.divide(np.diff(speed, axis=0), dt_s[:, None], out=rate, where=(dt_s > 0.0)[:, None])
    kept = max(int(np.searchsorted(clock_s, clock[-1] - TRAIL_S, side="right")) - 1, 0)
    trail = (speed[1:] + speed[:-1]) / 2.0
    trail[:first] = 0.0
    both = np.concatenate((memory.latest[None], np.stack((rate, trail), axis=1)))
    return Accelerations(rate, trail, both[:-1], SpeedMemory(clock_s[kept:].copy(), way[kept:].copy(), both[-1].copy()))


def is_rough(twist: Array, dt_s: Array) -> bool:
    """Tell whether noise (ticks, jitter) exceeds `ROUGH` in the accelerations of n twists (n, 3) over dt_s (n,), s.

    Fourth differences of successive accelerations cancel smooth driving; their median while the robot moves ignores
    the few steps of speed that an effect with a threshold causes.
    """
    moving = twist.any(axis=1) & (dt_s > 0.0)
    rough = np.diff(accelerations(twist, dt_s).rate[moving][:, [0, 2]], n=4, axis=0)
    if not len(rough):
        return False
    # a median of magnitudes is 0.6745 standard deviations, and a fourth difference has 70 variances
    noise = np.median(np.abs(rough), axis=0) / (0.6745 * np.sqrt(70.0))
    return bool((noise > ROUGH).any())


def motion_of(t_s: Array, xyt: Array, *, track_m: float | None = None) -> Motion:
    """Return the motion over the n - 1 intervals between poses xyt (n, 3) at times t_s (n,), seconds.

    Speeds are the mean speeds of the intervals, so that adding f to them and composing the poses is exact. They match
    smooth accelerations, too, which may replace those given.
    """
    steps = increments(xyt)
    dt = np.diff(t_s)
    rate = np.divide(1.0, dt, out=np.zeros_like(dt), where=dt > 0.0)
    twist = steps.rows * rate[:, None]
    travel = np.hypot(steps.ds_m, steps.dl_m)
    faster = accelerations(twist, dt)
    return Motion(
        t_s=t_s[1:], dt_s=dt, v=twist[:, 0], vy=twist[:, 1], omega=twist[:, 2], acceleration=faster.rate,
        x=xyt[:-1, 0], y=xyt[:-1, 1], theta=xyt[:-1, 2], distance=np.cumsum(travel), track_m=track_m,
    )  # fmt: skip


_ON, _ALL = 0.02, 0.995
"""Largest distance from a multiple, steps, for this share of the speeds: printed numbers have few digits."""
_MOST = 1000
"""Largest multiple: of finer steps nothing is lost."""
_FLICKER = (0.15, 0.08)
"""Least share of moving intervals in which speed or yaw rate goes a step up and down again, or down and up, if ticks
are counted before. Jitter of the loop makes speeds flicker in proportion to their size, and yaw rates less, because
most driving is straight. Measured without ticks: at most 0.11 and 0.04 in seven drives; with ticks of a third of a
step and more, yaw rates 0.13 to 0.28 in eight."""
_ROUNDS, _GAIN = 12, 0.4
"""Rounds of the inversion, and its gain: the mean rises by up to two steps per step where ticks and steps coincide."""
_EXACTLY = 1.0 + 1e-9


def speed_steps(v: Array, omega: Array, dt_s: Array, track_m: float | None) -> tuple[float, float] | None:
    """Return the steps, m/s and rad/s, of which all reported speeds (n,) are multiples and between which they flicker.

    None if there are no steps, or if speeds do not flicker: then they are no counts of ticks in a loop. Increments are
    multiples in the loop's period, even if stamps vary, or speeds are in the time between stamps. Ticks of encoders
    alone give steps as well, of both channels in the ratio of half the track, and lose nothing.
    """
    found = _steps_shown(v, omega, dt_s)
    if found is None or are_ticks((found.along, found.turn), track_m):
        return None
    along, turn, scale = found
    flickers = _flicker(v * scale / along) > _FLICKER[0] or _flicker(omega * scale / turn) > _FLICKER[1]
    return (along, turn) if flickers else None


class _Shown(NamedTuple):
    """Steps of speed, m/s, and yaw rate, rad/s, of speeds multiplied by `scale` (n,)."""

    along: float
    turn: float
    scale: Array


def _steps_shown(v: Array, omega: Array, dt_s: Array) -> _Shown | None:
    """Return the steps of which all reported speeds (n,) are multiples, whatever their cause; None without any."""
    usual_s = float(np.median(dt_s)) if len(dt_s) > 2 else 0.0
    if not usual_s > 0.0:
        return None
    for scale in (dt_s / usual_s, np.ones_like(dt_s)):
        along, turn = step_of(v * scale), step_of(omega * scale)
        if along is not None and turn is not None:
            return _Shown(along, turn, scale)
    return None


def are_ticks(steps: tuple[float, float], track_m: float | None) -> bool:
    """Return whether steps of speed, m/s, and yaw rate, rad/s, are in the ratio of ticks of two wheels."""
    # relative difference of both steps, as speeds of a rim, below which they are ticks of encoders
    return track_m is not None and abs(0.5 * steps[1] * track_m / steps[0] - 1.0) < 0.01


def has_steps_of_speed(v: Array, omega: Array, dt_s: Array, track_m: float) -> bool:
    """Return whether speeds (n,) and yaw rates are reported in whole steps that are no ticks of two wheels."""
    found = _steps_shown(v, omega, dt_s)
    return found is not None and not are_ticks((found.along, found.turn), track_m)


def _flicker(speed: Array) -> float:
    """Return the share of moving intervals in which a speed (n,), in steps, is a local extremum."""
    change = np.diff(np.rint(speed))
    turns = change[:-1] * change[1:] < 0.0
    moves = (np.lib.stride_tricks.sliding_window_view(speed, 3) != 0.0).any(axis=1)
    return float(np.mean(turns[moves])) if moves.any() else 0.0


def step_of(values: Array) -> float | None:
    """Return the step of which values (n,) are multiples: the least difference of two of them, refined; or None."""
    size = np.abs(values[values != 0.0])
    largest = float(size.max(initial=0.0))
    if not largest > 0.0:
        return None
    levels = np.unique(np.round(size / (1e-6 * largest))) * 1e-6 * largest
    gaps = np.diff(levels)
    gaps = gaps[gaps > largest / _MOST]
    if not len(gaps):
        return None
    step = float(gaps.min())
    for _ in range(2):
        count = np.rint(size / step)
        step = float(size @ count / max(count @ count, 1.0))
    count = np.rint(size / step)
    # fewest different multiples that show a step, or between which values change all the time
    plain = len(np.unique(count)) >= 4 or np.mean(np.diff(np.rint(values / step)) != 0.0) > 0.1
    return step if plain and np.mean(np.abs(size / step - count) < _ON) >= _ALL else None


def lost_parts(
    v: Array, omega: Array, tick_mps: float, steps: tuple[float, float], track_m: float
) -> tuple[Array, Array]:
    """Return the parts of a step (n,), forward and in yaw, that are lost where the mean reported speeds are v, omega.

    Between two counts a wheel reports both, in proportion; the phases of the wheels are independent. The mean of the
    truncated counts is inverted by iteration from half a step more.

    tick_mps : rim speed of one tick per loop
    """
    true_v, true_w = (u + 0.5 * step * np.sign(u) for u, step in zip((v, omega), steps, strict=True))
    for _ in range(_ROUNDS):
        mean_v, mean_w = _mean_truncated(true_v, true_w, tick_mps, steps, track_m)
        true_v, true_w = true_v + _GAIN * (v - mean_v), true_w + _GAIN * (omega - mean_w)
    return (true_v - v) / steps[0], (true_w - omega) / steps[1]


def _mean_truncated(
    v: Array, omega: Array, tick_mps: float, steps: tuple[float, float], track_m: float
) -> tuple[Array, Array]:
    """Return the means (n,) of truncated speed and yaw rate over the phases of the ticks."""
    right, left = (v + 0.5 * track_m * omega) / tick_mps, (v - 0.5 * track_m * omega) / tick_mps
    whole_right, whole_left = np.floor(right), np.floor(left)
    mean_v, mean_w = np.zeros_like(v), np.zeros_like(v)
    for a, p in ((0.0, 1.0 - right + whole_right), (1.0, right - whole_right)):
        for b, q in ((0.0, 1.0 - left + whole_left), (1.0, left - whole_left)):
            r, s = whole_right + a, whole_left + b
            # a count that equals a step exactly is not lost to rounding of its product
            mean_v += p * q * steps[0] * np.trunc(0.5 * (r + s) * tick_mps / steps[0] * _EXACTLY)
            mean_w += p * q * steps[1] * np.trunc((r - s) * tick_mps / track_m / steps[1] * _EXACTLY)
    return mean_v, mean_w
