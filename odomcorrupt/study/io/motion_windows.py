"""Odometry and truth in windows of some seconds: robust ratios, signs, correlations and maps of their motions.

Sums of the motion over windows are what the two have in common whatever their rates, noise and clocks are: windows are
compared at the lag at which motions fit best. Beside positions alone, motions are those along chords.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.signal import lfilter

from odomcorrupt.geometry.se2 import increments, wrap
from odomcorrupt.geometry.trajectory import distance_along
from odomcorrupt.study.io.motion_maps import AGREE, PLAIN, best_map, linear, unexplained
from odomcorrupt.study.io.raw_trajectory import CLOCK_S, runs_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.motion_maps import MotionMap
    from odomcorrupt.study.io.raw_trajectory import Samples

_LAGS_S = (0.0, 0.2, 0.4, 0.8, 1.6)
"""Time constants of a filter, or of motors, that are tried."""
_GRID_S = 0.1
"""Step of the lags at which motions are compared."""
MOVING = 0.2
"""Part of the usual largest motion from which a window counts as moving."""
FEWEST_WINDOWS = 8
"""Fewest windows in motion for a ratio, and directions of a path to compare with its headings."""
CLEAR, UNCLEAR = 0.6, 0.4
"""Correlations that two motions have, and do not have, if they are the same but for a factor. Of 19 recordings by
others the better one of speed and yaw rate has at least 0.9."""
FOLLOWS = 0.9
"""Agreement of headings with the path for a reading that is right; a wrong one has less than `CLEAR`."""
CLOSE, CURVED_RADPM, ARM_M = 0.15, 0.5, 0.03
"""Relative difference of motions that agree, and of turns on straights or travel on the spot: per metre or radian."""
ASKEW = 0.5
"""Angle between axes, rad, beyond which it is no error of a mounting."""
DEGREE = 180.0 / np.pi
COURSES = (1.0, -1.0, 1.0 / DEGREE, -1.0 / DEGREE, DEGREE, 0.5, 2.0, 0.0)
"""How many times as far as its headings a path may turn."""


class Ratio(NamedTuple):
    """Ratio of the truth's motion to the odometry's in windows, its relative spread, and the number of windows."""

    value: float = 1.0
    spread: float = np.inf
    number: int = 0

    @property
    def sure(self) -> bool:
        """Whether windows are enough and alike."""
        return self.value > 0.0 and self.number >= FEWEST_WINDOWS and self.spread < 0.5

    def beyond(self, high: float, low: float = 0.0) -> bool:
        """Return whether the ratio is above one factor, or below the inverse of that or of another one."""
        return self.sure and not 1.0 / (low or high) <= self.value <= high


def weighted_median(x: Array, weight: Array) -> float:
    """Return the weighted median of values (n,)."""
    total = np.cumsum(weight[np.argsort(x)])
    return float(np.sort(x)[np.searchsorted(total, total[-1] / 2.0)])


class Travel(NamedTuple):
    """Times (n,), and the sums (n, 3) of a trajectory's motion forwards, to the left and about z."""

    t_s: Array
    sums: Array

    def within(self, starts_s: Array, window_s: float) -> Array:
        """Return the motion (k, 3) in windows from times (k,)."""
        edges = (starts_s, starts_s + window_s)
        begin, end = (np.stack([np.interp(t, self.t_s, s) for s in self.sums.T], axis=1) for t in edges)
        return np.asarray(end - begin)

    def along_chords(self, t_s: Array) -> Travel:
        """Return the same motion with headings as those of central chords at even times (n,), means over two steps."""
        whole = np.concatenate(([0.0], np.cumsum((self.sums[1:, 2] + self.sums[:-1, 2]) / 2.0 * np.diff(self.t_s))))
        ends = [np.interp(t_s + k * (t_s[1] - t_s[0]), self.t_s, whole) for k in (1.0, -1.0)]
        # beyond its ends the path has no mean; `motions` compares no window there
        sums = np.stack([np.interp(t_s, self.t_s, x) for x in self.sums.T], axis=1)
        return Travel(t_s, np.column_stack((sums[:, :2], (ends[0] - ends[1]) / (2.0 * (t_s[1] - t_s[0])))))


def travel_of(path: Samples, origin_ns: int) -> Travel:
    """Return the motion of a trajectory; positions without headings head along their chords, modulo pi."""
    t_s, xyt = path.seconds_since(origin_ns), path.trajectory().xyt
    forwards = 1.0
    if not path.headed:
        t_s, xyt = _along_chords(t_s, xyt[:, :2])
        forwards = 1.0 if increments(xyt).ds_m.sum() >= 0.0 else -1.0
    rows = increments(xyt).rows * [forwards, forwards, 1.0]
    return Travel(t_s, np.concatenate((np.zeros((1, 3)), np.cumsum(rows, axis=0))))


def _along_chords(t_s: Array, xy: Array) -> tuple[Array, Array]:
    """Return times and poses (k, 3) of positions, headed along chords that are long beside the positions' noise."""
    step_s = max(float(np.median(np.diff(t_s))), 2.0 * _GRID_S)
    while True:
        grid = np.arange(t_s[0], t_s[-1], step_s)
        own = np.stack([np.interp(grid, t_s, x) for x in xy.T], axis=1)
        chord = np.gradient(own, axis=0) if len(grid) > 1 else 0.0 * own
        length = np.linalg.norm(chord, axis=1)
        usual = float(np.percentile(length, 90.0))
        if usual > 15.0 * _noise(xy) or step_s > 2.0:
            break
        step_s *= 1.5
    moves = length > MOVING * usual
    double = np.unwrap(2.0 * np.arctan2(chord[moves, 1], chord[moves, 0]))
    return grid, np.column_stack((own, np.interp(grid, grid[moves], double / 2.0) if moves.any() else 0.0 * grid))


class Own(NamedTuple):
    """A trajectory by itself.

    agreement : for each of `COURSES`, 1 if its path has the directions of its headings so multiplied, 0 if none
    chords : number of directions compared
    line : 1 if all its directions are along one line
    fixed : 1 if its headings are constant or opposite
    turned : extent of its headings, rad
    askew : angle of its path to its headings, but for half a turn, rad, 0 if it does not follow them
    step : usual largest turn from one message to the next, rad
    """

    agreement: tuple[float, ...] = (0.0,) * len(COURSES)
    chords: int = 0
    line: float = 0.0
    fixed: float = 0.0
    turned: float = 0.0
    askew: float = 0.0
    step: float = 0.0

    @property
    def straight(self) -> bool:
        """Whether the path has directions and headings of one line alone."""
        return self.turned < 1e-6 and self.chords >= FEWEST_WINDOWS and self.agreement[0] > FOLLOWS


def concentration(angle: Array) -> float:
    """Return the length of the mean unit vector of angles (n,): 1 if all are the same, 0 without any."""
    return float(np.abs(np.mean(np.exp(1j * angle)))) if len(angle) else 0.0


def own_of(path: Samples) -> Own:
    """Return the numbers of a trajectory by itself.

    Chords of a path point along its headings or straight backwards, up to a constant mounting angle, so twice their
    difference is constant.
    """
    course, middle = chords_of(path.xyz[:, :2])
    line = concentration(2.0 * course)
    if not path.headed:
        return Own(line=line)
    readings = [path.yaw_rad[middle], np.unwrap(path.yaw_rad)[middle]]
    agreement = [max(concentration(2.0 * (course - k * yaw)) for yaw in readings) for k in COURSES]
    # along a chord, headings in degrees have all directions
    agreement[COURSES.index(DEGREE)] = heading_at_steps(path, DEGREE)[1]
    fixed = concentration(2.0 * path.yaw_rad)
    askew = float(np.angle(np.mean(np.exp(2j * (course - path.yaw_rad[middle]))))) / 2.0 if len(course) else 0.0
    askew *= agreement[0] > FOLLOWS
    turned, step = float(np.ptp(np.unwrap(path.yaw_rad))), np.percentile(np.abs(wrap(np.diff(path.yaw_rad))), 95.0)
    return Own(tuple(agreement), len(course), line, fixed, turned, askew, float(step))


def heading_at_steps(path: Samples, factor: float, beside: Array | float = 0.0) -> tuple[Array, float]:
    """Return a multiple of the headings at that part of each step (n - 1,) where it fits steps best, and how well.

    beside : directions of the steps from that heading, rad, of a robot that drives sideways
    """
    place, parts = path.xyz[:, :2] @ [1.0, 1j], (0.0, 0.5, 1.0)
    yaws = factor * np.array((path.yaw_rad, np.unwrap(path.yaw_rad)))
    # directions are those of chords that are long beside noise, unless the heading turns too far along them
    usual, far = np.median(np.abs(np.diff(place))), isinstance(beside, np.ndarray) and abs(factor) <= 2.0
    every = min(int(15.0 * _noise(path.xyz[:, :2]) / max(usual, 1e-9)), len(path) // 20) if far else 1
    rows = np.arange(0, len(path), max(every, 1))
    aside = beside[rows[:-1]] if isinstance(beside, np.ndarray) else 0.0
    angle, moves = np.angle(step := np.diff(place[rows])), moving(np.abs(step))
    # the steps of a mirrored path are on the other side of its headings
    sides = [aside, -aside] if factor == -1.0 and far else [aside]
    fits = [
        max(concentration(2.0 * (angle - side - yaw[rows[:-1]] - part * np.diff(yaw[rows]))[moves]) for side in sides)
        for yaw in yaws for part in parts
    ]  # fmt: skip
    best = int(np.argmax(fits))
    yaw = yaws[best // len(parts)]
    return yaw[:-1] + parts[best % len(parts)] * np.diff(yaw), fits[best]


def chords_of(xy: Array) -> tuple[Array, NDArray[np.int64]]:
    """Return the angles of chords (k,) of a path (n, 2), a fortieth of its extent long, and samples in the middle."""
    extent = float(np.linalg.norm(np.diff(np.percentile(xy, [16.0, 84.0], axis=0), axis=0))) / 2.0
    length = max(extent / 40.0, 15.0 * _noise(xy), 1e-6)
    picked, at = [0], 0
    # The travelled distance only bounds the chord from above: continue until the chord itself is long enough.
    gone = distance_along(xy)
    while (at := int(np.searchsorted(gone, gone[at] + length))) < len(xy):
        if np.linalg.norm(xy[at] - xy[picked[-1]]) > length / 2.0:
            picked.append(at)
    ends = np.array(picked)
    chord = np.diff(xy[ends], axis=0)
    return np.arctan2(chord[:, 1], chord[:, 0]), (ends[:-1] + ends[1:]) // 2


def _noise(xy: Array) -> float:
    return float(np.median(np.abs(np.diff(xy, n=2, axis=0)))) if len(xy) > 2 else 0.0


class Witness(NamedTuple):
    """Turns by a third source, a gyro or wheels: increasing stamps (n,), and angles (n,) of any scale.

    independent : whether the odometry is not made of it, so that it may contradict the truth
    """

    name: str
    stamps_ns: NDArray[np.int64]
    angle: Array
    independent: bool


@dataclass(frozen=True, eq=False)
class Look:
    """Odometry and truth, and numbers of both.

    paths : odometry and truth
    witnesses : other sources of turns, read only if the two contradict each other
    track_m : as given
    """

    paths: tuple[Samples, Samples]
    witnesses: Callable[[], Sequence[Witness]] = tuple
    track_m: float | None = None

    @cached_property
    def own(self) -> tuple[Own, Own]:
        """Each trajectory by itself."""
        return own_of(self.paths[0]), own_of(self.paths[1])

    @property
    def window_s(self) -> float:
        """Length of the windows, s: four samples of either trajectory and more."""
        return float(np.clip(4e-9 * max(float(np.median(np.diff(p.stamps_ns))) for p in self.paths), 1.0, 8.0))

    @cached_property
    def motions(self) -> tuple[Array, Array, tuple[Array, Array]]:
        """Motions (n, 3) of odometry and truth in windows, and their times in each, at the lag that fits best."""
        origin, window_s = int(self.paths[0].stamps_ns[0]), self.window_s
        one, other = (travel_of(p, origin) for p in self.paths)
        if not self.paths[1].headed:
            one = one.along_chords(other.t_s)
        first, last = max(one.t_s[0], other.t_s[0]), min(one.t_s[-1], other.t_s[-1]) - window_s
        margin_s = min(CLOCK_S, (last - first) / 4.0)
        starts = np.arange(first + margin_s, last - margin_s, window_s / 4.0)
        here, found = one.within(starts, window_s), [(-np.inf, -np.inf, 0.0)]
        for lag_s in np.arange(-margin_s, margin_s, _GRID_S).tolist():
            pair = [here, other.within(starts + lag_s, window_s)]
            sizes = [np.abs(np.column_stack((x[:, 0] + 1j * x[:, 1], 0.0 * x[:, 0], x[:, 2]))) for x in pair]
            each = [correlations_of(*pair), correlations_of(*(x - x.mean(axis=0) for x in sizes))]
            found.append((*(float(np.sum(c[::2, ::2] ** 2)) - 1e-3 * abs(lag_s) for c in each), lag_s))
        # of positions alone, and of motions whose sign is lost, only sizes are alike
        signed, sized, _ = np.max(found, axis=0)
        by_size = not self.paths[1].headed or sized > signed + 0.5
        lag_s = max(found, key=lambda one: one[int(by_size)])[-1]
        return here, other.within(starts + lag_s, window_s), (starts, starts + lag_s)

    @cached_property
    def windows(self) -> tuple[Array, Array, tuple[Array, Array]]:
        """The same, but beside positions alone speeds with the odometry's sign, and turns between long chords only."""
        if self.paths[1].headed:
            return self.motions
        pair, times = self.motions[:2], self.motions[2]
        sign = np.where(pair[0][:, 0] < 0.0, -1.0, 1.0)
        speeds = [sign * np.hypot(x[:, 0], x[:, 1]) for x in pair]
        here, there = (np.column_stack((v, 0.0 * v, x[:, 2] * self.steady)) for v, x in zip(speeds, pair, strict=True))
        return here, there, times

    @cached_property
    def steady(self) -> NDArray[np.bool_]:
        """Windows (n,) in which turns are seen: all beside headings, those between long chords beside positions."""
        pair = self.motions[:2]
        if self.paths[1].headed:
            return np.ones(len(pair[0]), dtype=bool)
        one, other = (moving(np.hypot(x[:, 0], x[:, 1])) for x in pair)
        return np.asarray(one & steady_motion(other & (np.abs(pair[0][:, 1]) < 0.3 * np.abs(pair[0][:, 0]))))

    @cached_property
    def sampled(self) -> list[tuple[Array, Array, float]]:
        """Times (k,), rates (k, 2) of travel and turns, and the step between them, s, of each of the two."""
        origin, starts, found = int(self.paths[0].stamps_ns[0]), self.motions[2], []
        both = [travel_of(path, origin) for path in self.paths]
        for i, path in enumerate(both):
            step_s = float(np.clip(3e-9 * np.median(np.diff(self.paths[i].stamps_ns)), _GRID_S, 0.5))
            t_s = np.arange(path.t_s[0], path.t_s[-1] - step_s, step_s)
            rates = path.within(t_s, step_s)[:, ::2] / step_s
            if not self.paths[1].headed:  # speeds of positions have the sign of the odometry's
                ahead = both[0].within(t_s + (starts[0] - starts[1])[0], step_s)[:, 0] if i else rates[:, 0]
                rates[:, 0] = np.where(ahead < 0.0, -1.0, 1.0) * np.abs(rates[:, 0])
            found.append((t_s, rates, step_s))
        return found

    def rates(self, i: int, lag_s: tuple[float, float] | None = None) -> tuple[Array, Callable[[Array], Array]]:
        """Return rates (k, 2) of travel and turns of one of the two, and their sums (n, 2) in steady windows.

        lag_s : time constant of a low-pass filter of the rates, and the shift of the windows; those of `lags_s` by
            default
        """
        t_s, rates, step_s = self.sampled[i]
        time_s, later_s = lag_s or self.lags_s[i]
        keeps = np.exp(-step_s / max(time_s, 1e-3))
        edges, starts_s = np.append(t_s, t_s[-1] + step_s), self.motions[2][i][self.steady] + later_s

        def sums(of: Array) -> Array:
            whole = np.concatenate((np.zeros((1, 2)), np.cumsum(of * step_s, axis=0)))
            return Travel(edges, whole).within(starts_s, self.window_s)

        return np.asarray(lfilter((1.0 - keeps,), (1.0, -keeps), rates, axis=0)), sums

    @cached_property
    def lags_s(self) -> list[tuple[float, float]]:
        """Time constant and shift, s, of the low-pass filter of each one's rates that makes them the other's.

        Zero where it explains little more. If the truth's rates have to be filtered, the odometry lags.
        """
        found, few = [], bool(self.steady.sum() < 5 * FEWEST_WINDOWS)
        for i, other in enumerate(self.windows[1::-1]):
            motions, lost = other[self.steady, ::2], {}
            for lag_s in () if few else _LAGS_S:
                for later_s in np.arange(0.0, lag_s + 0.01, _GRID_S).tolist():
                    rates, sums = self.rates(i, (lag_s, later_s))
                    lost[lag_s, later_s] = unexplained(sums(rates), motions)[1]
            best = min(lost, key=lost.__getitem__, default=(0.0, 0.0))
            found.append(best if not few and lost[best] < min(0.5 * lost[0.0, 0.0], PLAIN) else (0.0, 0.0))
        return found

    @cached_property
    def maps(self) -> tuple[MotionMap | None, MotionMap | None]:
        """Maps of the truth's motions that make the odometry's, and the reverse, None where a matrix is as good."""
        if self.steady.sum() < 5 * FEWEST_WINDOWS or self.sideways or (self.paths[1].headed and self.strafes):
            return None, None
        pair = [motions[self.steady, ::2] for motions in self.windows[:2]]
        found = [best_map(*self.rates(1 - i), motions, signs=i == 0) for i, motions in enumerate(pair)]
        one = found[i := int(found[1].residual < found[0].residual)]
        changed = self.changed(one, 1 - i)
        rest = ~changed & moving(self.windows[:2][1 - i][self.steady, 0])
        clear = one.without > AGREE and one.residual < min(0.4, (0.5, 0.6)[int(one.without > PLAIN)] * one.without)
        # it acts several times, and not always; beside motions that nearly agree it needs no other factor
        clear &= one.without > PLAIN or bool(np.abs(np.diag(one.matrix) - 1.0).max() < 0.1)
        if not clear or len(runs_of(changed)) < 3 or rest.sum() < FEWEST_WINDOWS:
            return None, None
        return (None, one) if i else (one, None)

    def changed(self, one: MotionMap, i: int = 1) -> NDArray[np.bool_]:
        """Return in which of the steady windows a map changes the motion of one of the two."""
        rates, sums = self.rates(i)
        before, after = sums(rates), sums(one.of(rates))
        far = np.abs(after - before) > CLOSE * np.percentile(np.abs(before), 80.0, axis=0)
        return np.asarray(far.any(axis=1))

    @cached_property
    def seen(self) -> NDArray[np.bool_]:
        """Windows (n,) in which both have poses; motions are interpolated over gaps."""
        origin, times = int(self.paths[0].stamps_ns[0]), self.motions[2]
        ends = [
            np.searchsorted(path.seconds_since(origin), np.array((t_s, t_s + self.window_s)))
            for path, t_s in zip(self.paths, times, strict=True)
        ]
        return np.asarray((np.diff(ends, axis=1) > 1).all(axis=(0, 1)))

    def chords(self, i: int, ends: Array) -> Array:
        """Return complex displacements (k - 1, n) of one of the two between ends (k,) in windows from their starts."""
        at_s, path = self.motions[2][i] + self.window_s * ends[:, None], self.paths[i]
        places = np.interp(at_s, path.seconds_since(int(self.paths[0].stamps_ns[0])), path.xyz[:, :2] @ [1.0, 1j])
        return np.asarray(np.diff(places, axis=0))

    @cached_property
    def correlations(self) -> Array:
        """Correlations (3, 3) through the origin of v, vy, omega of the two; on the spot of omega alone."""
        (travel, turn), c = self.sizes, correlations_of(*self.windows[:2])
        return c if travel[:2].max() > ARM_M * turn[:2].min() else c * np.diag((0.0, 0.0, 1.0))

    def ratio(self, axis: int, side: int = 0, by: int | None = None) -> Ratio:
        """Return the ratio of the truth's motion along an axis to the odometry's, a weighted median of windows.

        side, by : sign of the odometry's motion along an axis, the same one by default, in these windows
        """
        here, there, _ = self.windows
        used = moving(here[:, axis]) & moving(here[:, axis if by is None else by], side) & (here[:, axis] != 0.0)
        if not used.any():
            return Ratio()
        each, weight = there[used, axis] / here[used, axis], np.abs(here[used, axis])
        value = weighted_median(each, weight)
        return Ratio(value, 1.48 * weighted_median(np.abs(each - value), weight) / max(abs(value), 1e-12), len(each))

    @cached_property
    def scales(self) -> tuple[Ratio, Ratio]:
        """Ratios of travel forwards and of turns."""
        travel, turn = (self.ratio(k) if self.correlations[k, k] > CLEAR else Ratio() for k in (0, 2))
        return travel, turn

    @cached_property
    def sizes(self) -> tuple[Array, Array]:
        """Usual travel (3,), m, and turn (3,), rad, in windows of the odometry, of the truth, and of the difference."""
        here, there, _ = self.windows
        every = np.square((here, there, there - here))
        return np.sqrt(every[:, :, :2].sum(axis=2).mean(axis=1)), np.sqrt(every[:, :, 2].mean(axis=1))

    def having(self, i: int, path: Samples) -> Look:
        """Return the look with another path for one of the two."""
        return replace(self, paths=(self.paths[0], path) if i else (path, self.paths[1]))

    def turns_by(self, i: int, factor: float) -> float:
        """Return how well one turns by a factor times the other from pose to pose, but for whole turns: 1 if so."""
        path, other = self.paths[i], self.paths[1 - i]
        times = self.having(i, path.without_headings()).motions[2]
        origin = int(self.paths[0].stamps_ns[0])
        at_s = path.seconds_since(origin) + (times[1 - i] - times[i])[0]
        turned = np.interp(at_s, other.seconds_since(origin), np.unwrap(other.yaw_rad))
        return concentration(np.diff(path.yaw_rad) - factor * np.diff(turned))

    @property
    def headed(self) -> bool:
        """Whether these are two trajectories with headings."""
        return self.paths[0] is not self.paths[1] and all(path.headed for path in self.paths)

    def one_sided(self, i: int) -> bool:
        """Return whether nearly all turns of one of the two are to one side."""
        few, many = sorted(np.sum(moving(self.windows[:2][i][:, 2], side)) for side in (1, -1))
        return bool(few < 0.1 * many)

    def directions(self, i: int) -> Array | float:
        """Return the other one's direction of travel in its own frame, rad, in each step of a path; 0 if ahead."""
        motion, path = self.motions[:2][1 - i], self.paths[i]
        follows = max(self.own[1 - i].fixed, self.own[i].agreement[0]) > FOLLOWS
        if follows or motion[:, 1].std() < 0.3 * motion[:, 0].std():
            return 0.0
        at_s = path.seconds_since(int(self.paths[0].stamps_ns[0]))
        middle_s = (at_s[1:] + at_s[:-1] - self.window_s) / 2.0
        ahead, aside = (np.interp(middle_s, self.motions[2][i], x) for x in motion[:, :2].T)
        return np.asarray(np.arctan2(aside, ahead))

    @property
    def agree(self) -> bool:
        """Whether travel and turns agree in usual windows, beside what a lever arm or a slight curvature changes."""
        travel, turn = self.sizes
        if not self.paths[1].headed and abs(self.own[0].askew) > ASKEW:
            return False
        close = turn[2] < CLOSE * max(*turn[:2], CURVED_RADPM * travel[:2].min())
        return bool(close and travel[2] < CLOSE * max(*travel[:2], ARM_M * turn[:2].min()))

    @property
    def speeds_mps(self) -> list[float]:
        """Mean speeds of the two."""
        return [float(np.hypot(*x[:, :2].T).mean()) / self.window_s for x in self.motions[:2]]

    @property
    def sideways(self) -> bool:
        """Whether the odometry drives sideways, too."""
        return bool(np.std(self.motions[0][:, 1]) > 0.1 * np.sqrt(np.mean(self.motions[0][:, 0] ** 2)))

    @cached_property
    def strafes(self) -> bool:
        """Whether the truth drives sideways, beyond what a point off the centre does in turns."""
        there = self.motions[1]
        aside = there[:, 1:2] - there[:, ::2] @ linear(there[:, ::2], there[:, 1:2])[0].T
        return bool(aside.std() > 0.1 * np.sqrt(np.mean(there[:, 0] ** 2)))

    def at_fault(self) -> tuple[int | None, str]:
        """Return which one turns the wrong way according to a third source, if any does, and that source."""
        here, there, (starts, _) = self.windows
        origin = int(self.paths[0].stamps_ns[0])
        for one in self.witnesses():
            t_s = (one.stamps_ns - origin) * 1e-9
            turned = np.interp(starts + self.window_s, t_s, one.angle) - np.interp(starts, t_s, one.angle)
            agrees = [float(correlations_of(np.column_stack((turned,) * 3), x)[0, 2]) for x in (here, there)]
            fault = int(agrees[1] < agrees[0])
            if max(map(abs, agrees)) > CLEAR and (one.independent or fault == 0):
                return fault, one.name
        return None, ""


def steady_motion(moves: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return where windows (n,) and both neighbours that share no time with them move."""
    around = np.lib.stride_tricks.sliding_window_view(np.pad(moves, 4, constant_values=True), 9)
    return np.asarray(around.all(axis=1))


def moving(x: Array, side: int = 0) -> NDArray[np.bool_]:
    """Return where a motion (n,) is clearly not at rest, on one side of zero if one is named."""
    size = np.abs(x)
    big = size > MOVING * np.percentile(size, 95.0) if len(x) else size > 0.0
    return np.asarray(big & (x * side > 0.0) if side else big)


def correlations_of(a: Array, b: Array) -> Array:
    """Return the correlations (3, 3) through the origin of motions (n, 3), clipped at 1.5 times the largest."""

    def scaled(x: Array) -> Array:
        most = 1.5 * np.percentile(np.abs(x), 95.0, axis=0)
        x = np.clip(x, -most, most)
        size = np.sqrt(np.mean(x**2, axis=0))
        return np.asarray(x / np.where(size > 1e-9, size, np.inf))

    return np.asarray(scaled(a).T @ scaled(b) / max(len(a), 1))
