"""First look at odometry and truth: plain mistakes of wiring, units, signs and axes, before any statistics.

From sums of the motion over windows of some seconds come robust ratios, signs and correlations of the two trajectories,
and the consistency of each with itself. Every mistake is one row of `PATTERNS`: what is seen, its usual causes, what to
change, and how the study goes on. A row that is found is undone and the rest is looked at again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from odomcorrupt.drive_types import STEERED
from odomcorrupt.effects import effect_from_values
from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import Increments, accumulate, increments
from odomcorrupt.geometry.trajectory import distance_along
from odomcorrupt.study.io.plausibility import check_pair, cross_correlation
from odomcorrupt.study.io.raw_trajectory import CLOCK_S
from odomcorrupt.study.io.recording import Mistake

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.raw_trajectory import Samples
    from odomcorrupt.study.io.recording import Recording

_GRID_S = 0.1
"""Step of the lags at which motions are compared."""
_MOVING = 0.2
"""Part of the usual largest motion from which a window counts as moving."""
_FEWEST = 8
"""Fewest windows in motion for a ratio, and directions of a path to compare with its headings."""
_CLEAR, _UNCLEAR = 0.6, 0.4
"""Correlations that two motions have, and do not have, if they are the same but for a factor. Of 19 recordings by
others the better one of speed and yaw rate has at least 0.9."""
_FOLLOWS = 0.9
"""Agreement of headings with the path for a reading that is right; a wrong one has less than `_CLEAR`."""
_WRONG, _SKIDS = 1.3, 1.9
"""Factors from which travel and turns are plainly wrong; skid steering turns up to 1.9 times less than its wheels."""
_FEW_TURNS = 0.1
"""Usual turn in a window, rad, up to which turns are too few to compare."""
_ALIKE = 0.06
"""Relative difference of two factors that are the same."""
_FAST_MPS, _ROBOT_MPS = 60.0, 10.0
"""Speed that no robot has, and one that few have."""
READINGS = (1.0, -1.0, np.pi / 180.0, -np.pi / 180.0, 180.0 / np.pi)
"""Factors by which headings may have to be multiplied."""
UNITS = {"feet": 1.0 / 0.3048, "inches": 1.0 / 0.0254, "centimetres": 100.0, "millimetres": 1000.0}
"""Units of length that are confused with metres, per metre."""
_HINTS = {
    2.0: "diameter for radius, or one edge of the encoder counted instead of two", 4.0: "quadrature counted once",
    180.0 / np.pi: "degrees for radians", 2.0 * np.pi: "turns for radians", 3.6: "km/h for m/s",
    **{per_m: f"{unit} for metres" for unit, per_m in UNITS.items()},
}  # fmt: skip
"""Likely causes of factors near these or their inverses."""


class Ratio(NamedTuple):
    """Ratio of the truth's motion to the odometry's in windows, its relative spread, and the number of windows."""

    value: float = 1.0
    spread: float = np.inf
    number: int = 0

    @property
    def sure(self) -> bool:
        """Whether windows are enough and alike."""
        return self.value > 0.0 and self.number >= _FEWEST and self.spread < 0.5

    def beyond(self, high: float, low: float = 0.0) -> bool:
        """Return whether the ratio is above one factor, or below the inverse of that or of another one."""
        return self.sure and not 1.0 / (low or high) <= self.value <= high


def ratio_of(a: Array, b: Array) -> Ratio:
    """Return the ratio of b (n,) to a (n,): least absolute deviations through the origin, a weighted median."""
    each, weight = b[a != 0.0] / a[a != 0.0], np.abs(a[a != 0.0])
    if not len(each):
        return Ratio()

    def median(x: Array) -> float:
        total = np.cumsum(weight[np.argsort(x)])
        return float(np.sort(x)[np.searchsorted(total, total[-1] / 2.0)])

    value = median(each)
    return Ratio(value, 1.48 * median(np.abs(each - value)) / max(abs(value), 1e-12), len(each))


class _Travel(NamedTuple):
    """Times (n,), and the sums (n, 3) of a trajectory's motion forwards, to the left and about z."""

    t_s: Array
    sums: Array

    def within(self, starts_s: Array, window_s: float) -> Array:
        """Return the motion (k, 3) in windows from times (k,)."""
        edges = (starts_s, starts_s + window_s)
        begin, end = (np.stack([np.interp(t, self.t_s, s) for s in self.sums.T], axis=1) for t in edges)
        return np.asarray(end - begin)


def _travel(path: Samples, origin_ns: int) -> _Travel:
    """Return the motion of a trajectory; positions without headings head along their chords, modulo pi."""
    t_s, xyt = path.seconds_since(origin_ns), path.trajectory().xyt
    forwards = 1.0
    if not path.headed:
        t_s, xyt = _along_chords(t_s, xyt[:, :2])
        forwards = 1.0 if increments(xyt).ds_m.sum() >= 0.0 else -1.0
    rows = increments(xyt).rows * [forwards, forwards, 1.0]
    return _Travel(t_s, np.concatenate((np.zeros((1, 3)), np.cumsum(rows, axis=0))))


def _along_chords(t_s: Array, xy: Array) -> tuple[Array, Array]:
    """Return times and poses (k, 3) of positions, headed along chords that are long beside the positions' noise."""
    noise = float(np.median(np.abs(np.diff(xy, n=2, axis=0)))) if len(xy) > 2 else 0.0
    step_s = max(float(np.median(np.diff(t_s))), 2.0 * _GRID_S)
    while True:
        grid = np.arange(t_s[0], t_s[-1], step_s)
        own = np.stack([np.interp(grid, t_s, x) for x in xy.T], axis=1)
        chord = np.gradient(own, axis=0) if len(grid) > 1 else 0.0 * own
        length = np.linalg.norm(chord, axis=1)
        usual = float(np.percentile(length, 90.0))
        if usual > 15.0 * noise or step_s > 2.0:
            break
        step_s *= 1.5
    moves = length > _MOVING * usual
    double = np.unwrap(2.0 * np.arctan2(chord[moves, 1], chord[moves, 0]))
    return grid, np.column_stack((own, np.interp(grid, grid[moves], double / 2.0) if moves.any() else 0.0 * grid))


class Own(NamedTuple):
    """A trajectory by itself.

    speed_mps : usual speed while it moves
    agreement : for each of `READINGS`, 1 if its path has the directions of its headings so multiplied, 0 if none
    chords : number of directions compared
    fixed : 1 if its headings are constant or opposite
    """

    speed_mps: float
    agreement: tuple[float, ...]
    chords: int
    fixed: float


def own_of(path: Samples) -> Own:
    """Return the numbers of a trajectory by itself.

    Chords of a path point along its headings or straight backwards, up to a constant mounting angle, so twice their
    difference is constant.
    """
    t_s = path.t_s
    later = np.searchsorted(t_s, t_s + 2.0)
    here = np.flatnonzero(later < len(t_s))
    later = later[here]
    speed = np.linalg.norm(path.xyz[later, :2] - path.xyz[here, :2], axis=1) / (t_s[later] - t_s[here])
    usual = float(np.median(speed[speed > 0.0])) if np.any(speed > 0.0) else 0.0
    if not path.headed:
        return Own(usual, (0.0,) * len(READINGS), 0, 0.0)
    course, middle = _chords(path.xyz[:, :2])
    readings = [path.yaw_rad[middle], np.unwrap(path.yaw_rad)[middle]]
    agreement = [max(_concentration(2.0 * (course - k * yaw)) for yaw in readings) for k in READINGS]
    return Own(usual, tuple(agreement), len(course), _concentration(2.0 * path.yaw_rad))


def _concentration(angle: Array) -> float:
    return float(np.abs(np.mean(np.exp(1j * angle)))) if len(angle) else 0.0


def _chords(xy: Array) -> tuple[Array, NDArray[np.int64]]:
    """Return the angles of chords (k,) of a path (n, 2), a fortieth of its extent long, and samples in the middle."""
    noise = float(np.median(np.abs(np.diff(xy, n=2, axis=0)))) if len(xy) > 2 else 0.0
    extent = float(np.linalg.norm(np.diff(np.percentile(xy, [16.0, 84.0], axis=0), axis=0))) / 2.0
    length = max(extent / 40.0, 15.0 * noise, 1e-6)
    picked, at = [0], 0
    # The travelled distance only bounds the chord from above: continue until the chord itself is long enough.
    gone = distance_along(xy)
    while (at := int(np.searchsorted(gone, gone[at] + length))) < len(xy):
        if np.linalg.norm(xy[at] - xy[picked[-1]]) > length / 2.0:
            picked.append(at)
    ends = np.array(picked)
    chord = np.diff(xy[ends], axis=0)
    return np.arctan2(chord[:, 1], chord[:, 0]), (ends[:-1] + ends[1:]) // 2


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
        one, other = (_travel(p, origin) for p in self.paths)
        first, last = max(one.t_s[0], other.t_s[0]), min(one.t_s[-1], other.t_s[-1]) - window_s
        margin_s = min(CLOCK_S, (last - first) / 4.0)
        starts = np.arange(first + margin_s, last - margin_s, window_s / 4.0)
        here, best = one.within(starts, window_s), (-np.inf, 0.0)
        for lag_s in np.arange(-margin_s, margin_s, _GRID_S).tolist():
            c = _correlations(here, other.within(starts + lag_s, window_s))
            best = max(best, (float(np.sum(c[[0, 0, 2, 2], [0, 2, 0, 2]] ** 2)) - 1e-3 * abs(lag_s), lag_s))
        return here, other.within(starts + best[1], window_s), (starts, starts + best[1])

    @cached_property
    def windows(self) -> tuple[Array, Array, tuple[Array, Array]]:
        """The same, but beside positions alone speeds with the odometry's sign, and turns between long chords only."""
        here, there, times = self.motions
        return (here, there, times) if self.paths[1].headed else (*_by_speeds(here, there), times)

    @cached_property
    def hand(self) -> float:
        """Correlation of the positions across the main axes of 64 windows each: 1 as they are, -1 if mirrored.

        Paths with turns of other sizes have other shapes; of them it is 0.
        """
        if not 1.0 / _WRONG < abs(self.ratio(2).value) < _WRONG:
            return 0.0
        origin = int(self.paths[0].stamps_ns[0])
        both = zip(self.paths, self.windows[2], strict=True)
        own, real = (np.interp(at, p.seconds_since(origin), p.xyz[:, 0] + 1j * p.xyz[:, 1]) for p, at in both)
        total = np.zeros(4)
        for first in range(0, len(own) - 32, 32):
            a, b = (x[first : first + 64] - x[first : first + 64].mean() for x in (own, real))
            size = [float(np.vdot(x, x).real) for x in (a, b)]
            across = [n - abs(x @ x) for n, x in zip(size, (a, b), strict=True)]
            total += [abs(np.vdot(a, b)), abs(a @ b), *np.sqrt(np.maximum([np.prod(across), np.prod(size)], 0.0))]
        same, mirrored, wide, most = total.tolist()
        return (same - mirrored) / wide if max(same, mirrored) > 0.8 * most and wide > 0.001 * most else 0.0

    @cached_property
    def turns_agree(self) -> tuple[float, ...]:
        """For each of `READINGS`, 1 if the truth's headings so multiplied turn as the odometry does, 0 if not."""
        here, _, (_, at) = self.windows
        truth, used = self.paths[1], _moving(here[:, 2])
        t_s = truth.seconds_since(int(self.paths[0].stamps_ns[0]))
        first, last = (np.minimum(np.searchsorted(t_s, t), len(t_s) - 1)[used] for t in (at, at + self.window_s))
        turned = [yaw[last] - yaw[first] for yaw in (truth.yaw_rad, np.unwrap(truth.yaw_rad))]
        return tuple(max(float(np.mean(np.cos(k * x - here[used, 2]))) for x in turned) for k in READINGS)

    @cached_property
    def correlations(self) -> Array:
        """Correlations (3, 3) through the origin of the odometry's v, vy, omega with the truth's."""
        return _correlations(*self.windows[:2])

    def ratio(self, axis: int, other: int | None = None, side: int = 0) -> Ratio:
        """Return the ratio of the truth's motion along an axis to the odometry's, where the odometry moves."""
        here, there, _ = self.windows
        used = _moving(here[:, axis], side)
        return ratio_of(here[used, axis], there[used, axis if other is None else other])

    @cached_property
    def travel(self) -> Ratio:
        """Ratio of travel forwards."""
        return self.ratio(0) if self.correlations[0, 0] > _CLEAR else Ratio()

    @cached_property
    def turn(self) -> Ratio:
        """Ratio of turns."""
        return self.ratio(2) if self.correlations[2, 2] > _CLEAR else Ratio()

    @property
    def turns(self) -> float:
        """Usual turn of the odometry or the truth, the larger one, in windows in which one of them moves, rad."""
        here, there, _ = self.windows
        used = _moving(here[:, 0]) | _moving(there[:, 0])
        return max(float(np.sqrt(np.mean(x[used, 2] ** 2))) if used.any() else 0.0 for x in (here, there))

    @property
    def words(self) -> str:
        """Ratios of travel and turns in words, "" if they are not sure."""
        sure = [(what, r) for what, r in (("travels", self.travel), ("turns", self.turn)) if r.sure]
        times = ["" if abs(r.value - 1.0) < r.spread else f"{r.value:.3g} times " for _, r in sure]
        said = [f"{what} {by}as far (+-{r.spread:.1%})" for (what, r), by in zip(sure, times, strict=True)]
        return f"in {self.window_s:.2g} s the truth {' and '.join(said)} as the odometry" if said else ""

    def at_fault(self) -> tuple[int | None, str]:
        """Return which one turns the wrong way according to a third source, if any does, and that source."""
        here, there, (starts, _) = self.windows
        origin = int(self.paths[0].stamps_ns[0])
        for one in self.witnesses():
            t_s = (one.stamps_ns - origin) * 1e-9
            turned = np.interp(starts + self.window_s, t_s, one.angle) - np.interp(starts, t_s, one.angle)
            agrees = [float(_correlations(np.column_stack((turned,) * 3), x)[0, 2]) for x in (here, there)]
            fault = int(agrees[1] < agrees[0])
            if max(map(abs, agrees)) > _CLEAR and (one.independent or fault == 0):
                return fault, one.name
        return None, ""


def _by_speeds(here: Array, there: Array) -> tuple[Array, Array]:
    """Return motions (n, 3) beside positions alone: speeds with the odometry's sign, turns between long chords only."""
    here, there = here.copy(), there.copy()
    ahead = np.abs(here[:, 1]) < 0.3 * np.abs(here[:, 0])
    sign = np.where(here[:, 0] < 0.0, -1.0, 1.0)
    for one in (here, there):
        one[:, 0], one[:, 1] = sign * np.hypot(one[:, 0], one[:, 1]), 0.0
    steady = _moving(here[:, 0]) & _steady(_moving(there[:, 0]) & ahead)
    here[~steady, 2] = there[~steady, 2] = 0.0
    return here, there


def _steady(moves: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return where windows (n,) and both neighbours that share no time with them move."""
    steady = moves.copy()
    for k in range(1, 5):
        steady[k:] &= moves[:-k]
        steady[:-k] &= moves[k:]
    return steady


def _moving(x: Array, side: int = 0) -> NDArray[np.bool_]:
    """Return where a motion (n,) is clearly not at rest, on one side of zero if one is named."""
    size = np.abs(x)
    big = size > _MOVING * np.percentile(size, 95.0) if len(x) else size > 0.0
    return np.asarray(big & (x * side > 0.0) if side else big)


def _correlations(a: Array, b: Array) -> Array:
    """Return the correlations (3, 3) through the origin of motions (n, 3), clipped at 1.5 times the largest."""

    def scaled(x: Array) -> Array:
        most = 1.5 * np.percentile(np.abs(x), 95.0, axis=0)
        x = np.clip(x, -most, most)
        size = np.sqrt(np.mean(x**2, axis=0))
        return np.asarray(x / np.where(size > 1e-9, size, np.inf))

    return np.asarray(scaled(a).T @ scaled(b) / max(len(a), 1))


def _linear(x: Array, y: Array) -> tuple[Array, float]:
    """Return the matrix (k, k) of y = M x for motions (n, k), outliers left out, and the least part explained."""
    used = np.ones(len(x), dtype=bool)
    least = 0.02 * np.percentile(np.abs(y), 95.0, axis=0)
    for _ in range(5):
        matrix = np.linalg.lstsq(x[used], y[used], rcond=None)[0].T
        off = np.abs(y - x @ matrix.T)
        used = (off <= 6.0 * np.maximum(np.median(off, axis=0), least)).all(axis=1)
    explained = 1.0 - np.sum(off[used] ** 2, axis=0) / np.maximum(np.sum(y[used] ** 2, axis=0), 1e-12)
    return np.asarray(matrix, dtype=np.float64), float(explained.min()) * float(used.mean() > _CLEAR)


Figures: TypeAlias = dict[str, Any]
"""Figures of a mistake for its texts. `i` is the path at fault, 0 for the odometry (default) and 1 for the truth;
`undo` a function of that path that undoes it, without which nothing can be learned; `gains` the ratios of truth to
odometry in travel and turns, if these are parts of the model."""


class Pattern(NamedTuple):
    """A row of the table: texts with their figures in braces, and how it is found.

    find : figures of the mistake in a look, None if it is not there
    alone : whether one path shows it by itself; `find` has its number as another argument
    """

    name: str
    seen: str
    causes: str
    change: str
    find: Callable[..., Figures | None]
    then: str = ""
    alone: bool = False


class FirstLook(NamedTuple):
    """Odometry and truth with all mistakes undone, and the mistakes.

    gains : ratios of truth to odometry in travel and turns by which the odometry is multiplied, 1 if about right
    ratios : what is left of them, in words
    """

    odometry: Samples
    truth: Samples
    mistakes: tuple[Mistake, ...] = ()
    gains: tuple[float, float] = (1.0, 1.0)
    ratios: str = ""


def first_look(look: Look) -> FirstLook:
    """Return odometry and truth without plain mistakes, and the mistakes.

    Raises
    ------
    RecordingError
        If nothing can be learned from them as they are; the message says why.
    """
    found: list[Mistake] = []
    gains = (1.0, 1.0)
    for pattern in PATTERNS:
        if pattern is _MOTIONS[0]:
            check_pair(*look.paths)
        for n in (0, 1) if pattern.alone else (None,):
            figures = pattern.find(look) if n is None else pattern.find(look, n)
            if figures is None:
                continue
            mistake = _mistake(pattern, look, figures)
            gains, undo = figures.get("gains", gains), figures.get("undo")
            if undo is None:
                raise RecordingError(mistake.sentence)
            i = figures.get("i", 0)
            found.append(mistake)
            one, other = look.paths
            look = replace(look, paths=(one, undo(other)) if i else (undo(one), other))
    return FirstLook(*look.paths, tuple(found), gains, look.words)


def mistakes_alone(path: Samples) -> list[Mistake]:
    """Return the plain mistakes that odometry shows by itself."""
    look = Look((path, path))
    return [_mistake(one, look, seen) for one in PATTERNS if one.alone and (seen := one.find(look, 0)) is not None]


def check_alone(path: Samples) -> None:
    """Refuse odometry that shows a plain mistake by itself."""
    for mistake in mistakes_alone(path):
        raise RecordingError(mistake.sentence)


def _mistake(pattern: Pattern, look: Look, figures: Figures) -> Mistake:
    i = figures.get("i", 0)
    who = look.paths[i].name if "undo" in figures else look.paths[i].place
    words = {"who": who, "other": look.paths[1 - i].name} | figures
    words = {key: f"{value:.3g}" if isinstance(value, float) else value for key, value in words.items()}
    texts = (pattern.seen, pattern.causes, pattern.change, pattern.then)
    return Mistake(pattern.name, *(text.format(**words) for text in texts))


_COPIED_WINDOW_S = 0.5
_LAG_STEPS_S = (1.0, 0.02, 0.002, 0.0002)
"""Largest lag of a copied travel, and steps of the search for it."""
_NO_SENSOR_M, _NO_SENSOR = 1e-4, 5e-4
"""Usual difference of travel in half a second, m and relative to the travel, that no sensor reaches: in 15 recordings
by others it is 0.2 mm and more."""
_ROUGH_M, _AS_ROUGH = 1e-6, 0.3
"""Noise of odometry's steps, m, of which less is rounding of a smooth simulation; that of the truth relative to it."""


def check_travel(odometry: Samples, truth: Samples) -> None:
    """Refuse a truth whose travel is the odometry's with its noise, at whatever lag and rate.

    Filters that take speed from the wheels and heading from a gyro have slip, ticks and noise of the wheels in their
    travel. Exact poses of a simulator may agree as well, but they are smooth where the odometry has ticks.
    """
    if not truth.headed or truth.covariance is not None or truth.relative:
        return
    own, real = (_travel(path, int(odometry.stamps_ns[0])) for path in (odometry, truth))
    rough_m, truly_m = (_noise_of_steps(np.diff(path.sums[:, 0])) for path in (own, real))
    if rough_m < _ROUGH_M or truly_m < _AS_ROUGH * rough_m:
        return
    reach_s = _LAG_STEPS_S[0]
    starts = np.arange(max(own.t_s[0], real.t_s[0]), min(own.t_s[-1], real.t_s[-1]), _COPIED_WINDOW_S)
    starts = starts[(starts >= own.t_s[0] + reach_s) & (starts < own.t_s[-1] - reach_s - _COPIED_WINDOW_S)]
    own_m = own.within(starts, _COPIED_WINDOW_S)[:, 0]
    used = _moving(own_m)
    if used.sum() < 2 * _FEWEST:
        return
    starts, own_m = starts[used], own_m[used]

    def off_m(lag_s: float) -> float:
        return float(np.median(np.abs(real.within(starts + lag_s, _COPIED_WINDOW_S)[:, 0] - own_m)))

    lag_s = 0.0
    for reach_s, step_s in pairwise(_LAG_STEPS_S):
        lag_s = min(np.arange(lag_s - reach_s, lag_s + reach_s, step_s).tolist(), key=off_m)
    found_m, gone_m = off_m(lag_s), float(np.median(np.abs(own_m)))
    if found_m < min(_NO_SENSOR_M, _NO_SENSOR * gone_m):
        raise RecordingError(
            f"{truth.place}: repeats the travel of {odometry.name} with its noise and slip (usually to "
            f"{found_m * 1e3:.2g} mm in {gone_m * 1e3:.0f}): a filter that takes its speed from these wheels, so that "
            "errors of travel cannot be seen; name a truth that does not come from them"
        )


def _noise_of_steps(steps_m: Array) -> float:
    """Return the usual noise of a step (n,) while the robot moves, from second differences of the steps, m."""
    rough = np.abs(np.diff(steps_m, n=2))[_moving(steps_m)[2:]]
    return float(np.median(rough)) / np.sqrt(20.0) if len(rough) else 0.0


def factors_of(recordings: Sequence[Recording]) -> tuple[Effect, ...]:
    """Return the effects that multiply an odometry's travel and turns as plain mistakes require, none if they do not.

    All recordings are of one robot, so the first one counts.
    """
    (travel, turn), drive_type = recordings[0].gains, recordings[0].drive_type
    if travel == turn:
        return (effect_from_values("wheel_scale", {"e": travel - 1.0}),) if travel != 1.0 else ()
    found = [effect_from_values("wheel_scale", {"e": travel - 1.0, "heading": "gyro"})] if travel != 1.0 else []
    if turn != 1.0 and drive_type in STEERED:
        found.append(effect_from_values("steering_scale", {"e": turn - 1.0}))
    elif turn != 1.0:
        found.append(effect_from_values("wheelbase", {"e": 1.0 / turn - 1.0}))
    return tuple(found)


def _moved_by(path: Samples, rows: Array) -> Samples:
    """Return a trajectory with other motions (n - 1, 3)."""
    moved = accumulate(path.trajectory().xyt[0], Increments.of_rows(rows))
    return replace(path, xyz=np.column_stack((moved[:, :2], path.xyz[:, 2])), yaw_rad=moved[:, 2])


def _by(matrix: Array) -> Callable[[Samples], Samples]:
    """Return the function that multiplies a trajectory's motions by a matrix (3, 3)."""
    return lambda path: _moved_by(path, increments(path.trajectory().xyt).rows @ matrix.T)


def _speed(look: Look, i: int) -> Figures | None:
    own, real = look.own[i].speed_mps, look.own[1].speed_mps
    return {"i": i, "speed": own, "undo": lambda p: replace(p, xyz=p.xyz / 1e3)} if min(own, real) > _FAST_MPS else None


def _mirrored_headings(look: Look, i: int) -> Figures | None:
    """Find headings that turn the other way than the path; what contradicts the other trajectory is mirrored."""
    own, turn = look.own[i], float(look.correlations[2, 2])
    # how many times worse each path follows its headings than their negatives
    doubts = [(1.0 - own.agreement[0]) / (1.001 - own.agreement[1]) if own.chords else 0.0 for own in look.own]
    doubt, other = doubts[i], doubts[1 - i]
    alone = own.agreement[1] > _FOLLOWS and (own.agreement[0] < _CLEAR or doubt > 4.0 > 4.0 * other)
    if own.chords < _FEWEST or not (alone or (look.hand * turn < -_UNCLEAR and doubt > max(other, 0.25))):
        return None
    axis = 1.0 if turn < 0.0 or look.hand > _UNCLEAR else -1.0
    undo = lambda path: replace(path, xyz=path.xyz * [1.0, axis, 1.0], yaw_rad=-axis * path.yaw_rad)  # noqa: E731
    return {"i": i, "undo": undo}


def _unit_of_headings(look: Look, i: int) -> Figures | None:
    """Find headings in another unit by the path, or by the odometry's turns if the path has other directions."""
    own = look.own[i]
    by_path = own.chords >= _FEWEST and max(own.agreement) > _FOLLOWS
    if not look.paths[i].headed or (own.chords >= _FEWEST and own.agreement[0] > _CLEAR) or not (by_path or i):
        return None
    agreement = own.agreement if by_path else look.turns_agree
    k = int(np.argmax(agreement))
    if k < 2 or agreement[0] > _CLEAR or agreement[k] < _FOLLOWS:
        return None
    words = ("degrees, not radians", "degrees of a compass (clockwise)", "read as degrees, but are radians")

    def undo(path: Samples) -> Samples:
        course, middle = _chords(path.xyz[:, :2])
        readings = (READINGS[k] * path.yaw_rad, READINGS[k] * np.unwrap(path.yaw_rad))
        return replace(path, yaw_rad=max(readings, key=lambda yaw: _concentration(2.0 * (course - yaw[middle]))))

    return {"i": i, "factor": READINGS[k], "unit": words[k - 2], "undo": undo}


def _folded(look: Look, i: int) -> Figures | None:
    """Find headings of half a circle alone: at its ends they jump."""
    path = look.paths[i]
    steps = np.abs(np.diff(path.yaw_rad))
    jumps = steps > 0.75 * np.pi
    half = path.headed and np.ptp(path.yaw_rad) < np.pi + 0.05 and look.own[i].fixed < _FOLLOWS
    if not half or not 1 < jumps.sum() < 0.5 * len(steps):
        return None

    def undo(path: Samples) -> Samples:
        mended = replace(path, yaw_rad=np.unwrap(path.yaw_rad, period=np.pi))
        back = increments(mended.trajectory().xyt).ds_m.sum() < 0.0
        return replace(mended, yaw_rad=mended.yaw_rad + np.pi * back)

    return {"i": i, "count": int(jumps.sum()), "undo": undo}


def _unrelated(look: Look, i: int) -> Figures | None:
    """Find headings that follow neither their own path nor the other trajectory."""
    (own, other), (path, beside) = (look.own, look.paths) if i == 0 else (look.own[::-1], look.paths[::-1])
    undo = {"undo": lambda path: path.without_headings()} if i else {}
    turns = np.ptp(np.unwrap(beside.yaw_rad)) > 0.5 if beside.headed else own.agreement[0] < _CLEAR
    if path.headed and np.ptp(path.yaw_rad) < 1e-6 and turns:
        return {"i": i, "what": "never change", **undo}
    if path.headed and not beside.headed and np.ptp(path.yaw_rad) < 1e-6 and own.agreement[0] < _CLEAR:
        return {"i": i, "what": "never change", **undo}
    few = min(own.chords, other.chords) < 3 * _FEWEST
    if few or max(own.agreement) > _CLEAR or other.agreement[0] < _FOLLOWS or abs(look.correlations[2, 2]) > _UNCLEAR:
        return None
    return {"i": i, "what": "are 0 or 180 deg alone" if own.fixed > _FOLLOWS else "turn otherwise", **undo}


def _upright(look: Look) -> Figures | None:
    def width(plane: Array) -> float:  # the smaller standard deviation of points about their axes
        return float(np.linalg.svd(plane - plane.mean(axis=0), compute_uv=False)[-1] / np.sqrt(len(plane)))

    wide, xyz = width(look.paths[0].xyz[:, :2]), look.paths[1].xyz
    if wide < 0.05 or width(xyz[:, :2]) > 0.25 * wide:
        return None
    for up, plane in (("y", [2, 0]), ("x", [1, 2])):
        if width(xyz[:, plane]) > 0.5 * wide:
            columns = [*plane, "xyz".index(up)]
            undo = lambda path, order=columns: replace(path, xyz=path.xyz[:, order]).without_headings()  # noqa: E731
            return {"i": 1, "up": up, "plane": "-".join(sorted("xyz"[k] for k in plane)), "undo": undo}
    return None


def _rate(look: Look) -> Figures | None:
    """Find a clock of another rate or unit: motions correlate after stretching it, by log times or to equal spans."""
    # without log times both are taken to last as long, and the less usual period of messages is at fault
    logged = all(len(path.log_ns) and np.ptp(path.log_ns) > 0 for path in look.paths)
    spans = [path.span_s / (float(np.ptp(path.log_ns)) * 1e-9 if logged else 1.0) for path in look.paths]
    usual = spans if logged else [float(np.median(np.diff(path.stamps_ns))) / 5e7 for path in look.paths]
    i = int(abs(np.log(usual[1])) > abs(np.log(usual[0])))
    factor = spans[1 - i] / spans[i]
    if not logged and 0.2 < factor < 5.0:
        i, factor = 0, spans[1] / spans[0]
    if 1.0 / _WRONG < factor < _WRONG:
        return None

    def undo(path: Samples) -> Samples:
        first = path.stamps_ns[0]
        return path.stamped(first + np.round((path.stamps_ns - first) * factor).astype(np.int64))

    def alike(one: Samples, other: Samples, *, from_start: bool) -> float:
        reach_s = min(60.0, one.span_s / 2.0, other.span_s / 2.0)
        corr = cross_correlation(one.trajectory(), other.trajectory(), reach_s, from_start=from_start, smoothing_s=2.0)
        return float(np.maximum(corr.both, corr.mirrored).max())

    one, other = look.paths
    mended = alike(*((one, undo(other)) if i else (undo(one), other)), from_start=True)
    # farther apart, there is no motion at any shift to compare with
    near = alike(one, other, from_start=False) if 0.05 < factor < 20.0 else 0.0
    if mended < max(0.7, near + 0.2):
        return None
    doubt = "" if logged else ", or the other one by the inverse"
    return {"i": i, "rate": 1.0 / factor, "factor": factor, "best": mended, "doubt": doubt, "undo": undo}


def _late(look: Look) -> Figures | None:
    """Find a clock that is seconds off; a periodic drive looks mirrored half a period later."""
    odometry, truth = (p.trajectory() for p in look.paths)
    corr = cross_correlation(odometry, truth, min(60.0, look.paths[0].span_s / 2.0))
    near = np.abs(corr.lag_s) <= CLOCK_S
    best, here = int(np.argmax(corr.both)), float(corr.both[near].max())
    most, lag_s = float(corr.both[best]), float(corr.lag_s[best])
    if most < max(0.7, 2.0 * here, float(corr.mirrored[near].max()) + 0.02):
        return None
    side = "behind" if lag_s > 0.0 else "ahead of"
    return {"i": 1, "off": f"{abs(lag_s):.1f}", "side": side, "shift": f"{lag_s:.1f}", "best": most, "near": here}


_WHEELS = {
    2: ("left", "right"), 4: ("front left", "front right", "rear left", "rear right"),
}  # fmt: skip
_ROLLS = {
    2: np.array(((1.0, 0.0, -1.0), (1.0, 0.0, 1.0))),
    4: np.array(((1.0, -1.0, -1.0), (1.0, 1.0, 1.0), (1.0, 1.0, -1.0), (1.0, -1.0, 1.0))),
}
"""How far two wheels, or four that drive sideways, roll by a motion, turns in units of their arm."""


def _wheel_gains(look: Look) -> Figures | None:
    """Find wheels that count by unequal factors g: motions are J' diag(g) J / n times the truth's, J of `_ROLLS`."""
    here, there, _ = look.motions
    rolls = _ROLLS[4 if np.std(here[:, 1]) > 0.1 * np.std(here[:, 0]) else 2]
    axes = [0, 1, 2] if len(rolls) == 4 else [0, 2]
    trials = [there]
    if not look.paths[1].headed:  # speeds then have the sign of one of the odometry's motions
        used = _steady(_moving(np.hypot(there[:, 0], there[:, 1])))
        here, there = here[used], there[used]
        speed = np.hypot(there[:, 0], there[:, 1])
        trials = [np.column_stack((np.sign(here[:, k]) * speed, 0.0 * speed, there[:, 2])) for k in (0, 2)]
    if len(here) < _FEWEST:
        return None
    small, explained = max((_linear(x[:, axes], here[:, axes]) for x in trials), key=lambda found: found[1])
    own, real = (float(_correlations(x, x)[0, 2]) for x in (here, there))
    if len(rolls) == 2 and abs(own) > 0.999 and abs(real) < 0.95:
        # odometry that pivots about one wheel, whatever the truth's turns: that wheel counts nothing
        curvature = float(np.copysign(np.linalg.norm(here[:, 2]) / np.linalg.norm(here[:, 0]), own))
        small = small[0, 0] * np.array(((1.0, 1.0 / curvature), (curvature, 1.0)))
    matrix = np.zeros((3, 3))
    matrix[np.ix_(axes, axes)] = small
    if matrix[0, 2] * matrix[2, 0] < 0.0 and not look.paths[1].headed:
        matrix[:, 0] *= -1.0
    by_turn, by_travel = np.abs(matrix[:2, 2]).sum(), np.abs(matrix[2, :2]).sum()
    if explained < _FOLLOWS or min(by_turn, by_travel) < 1e-6 or by_turn > by_travel:
        return None
    arm_m = float(np.sqrt(by_turn / by_travel))
    scaled = matrix * [1.0, 1.0, 1.0 / arm_m] * np.array((1.0, 1.0, arm_m))[:, None]
    mean = np.diag(np.diag(scaled))
    between = np.einsum("ij,jk,ik->i", rolls, scaled - mean, rolls) / 2.0
    gains = np.trace(mean) / len(axes) + between
    most = float(np.abs(gains).max())
    made = rolls.T @ (gains[:, None] * rolls) / len(rolls)
    if np.abs(made - scaled).max() > 0.2 * most or np.ptp(gains) < (1.0 - 1.0 / _WRONG) * most:
        return None
    names = _WHEELS[len(rolls)]
    dead, reverse = np.abs(gains) < 0.1 * most, gains < -0.3 * most
    wrong = next(x for x in (reverse, dead, np.abs(gains - 1.0) > 0.15, gains < np.inf) if x.any())
    which = " and ".join(np.array(names)[wrong]) + (" wheel" if wrong.sum() == 1 else " wheels")
    factor = float(np.mean(gains[wrong]))
    if reverse.any():
        cause = f"the {which} counts the wrong way: channels A and B of its encoder, or its motor, are exchanged"
        change = f"negate the counts of the {which}"
    elif dead.any():
        cause, change = f"the {which} counts nothing: its encoder, cable or topic", _RECORD
    else:
        cause = f"ticks per turn, gear ratio or radius of the {which} wrong by this factor{_hint(factor)}"
        change = f"multiply the counts of the {which} by {1.0 / factor:.3g}"
    figures: Figures = {
        "each": ", ".join(f"{name} {gain:.2f}" for name, gain in zip(names, gains.tolist(), strict=True)),
        "arm_m": arm_m, "explained": f"{explained:.1%}", "cause": cause, "change": change, "then": "",
    }  # fmt: skip
    if len(rolls) == 4 or not dead.any():
        # the arm is no better known than the gains, so only what the change says is undone
        mended = np.where(wrong, -1.0 if reverse.any() else gains, 1.0)
        back = np.linalg.pinv(rolls.T @ (mended[:, None] * rolls) / len(rolls))
        back *= np.array((1.0, 1.0, 1.0 / arm_m))[:, None] * [1.0, 1.0, arm_m]
        figures |= {"undo": _by(back), "then": "this is undone in the odometry, and not in the model"}
    return figures


def _reversed(look: Look, turn: float) -> Figures | None:
    """Find odometry that drives backwards and turns as the truth does (1) or the other way (-1)."""
    c = look.correlations
    if not look.paths[1].headed or c[0, 0] > -_CLEAR or min(c[2, 2] * turn, look.hand * turn + 1.0) < _CLEAR:
        return None
    return {"corr": float(c[0, 0]), "undo": _by(np.diag((-1.0, -1.0, turn)))}


def _sideways(look: Look) -> Figures | None:
    c = look.correlations
    for i, corr in ((0, float(c[1, 0])), (1, float(c[0, 1]))):
        x = look.windows[:2][i]
        aside = np.std(x[:, 1]) > np.std(x[:, 0]) and look.paths[1].headed
        if aside and abs(corr) > max(_CLEAR, abs(c[0, 0]) + 1.0 - _CLEAR):
            turn = np.sign(corr) * np.pi / 2.0
            undo = lambda path, turn=turn: replace(path, yaw_rad=path.yaw_rad + turn)  # noqa: E731
            return {"i": i, "side": "y" if corr > 0.0 else "-y", "corr": corr, "undo": undo}
    return None


def _exchanged(look: Look) -> Figures | None:
    c = look.correlations
    turn, hand = float(c[2, 2]), look.hand
    corr = min(turn, hand * _CLEAR / _UNCLEAR)
    if corr > -_CLEAR or c[0, 0] < _CLEAR or max(hand, turn) > _UNCLEAR:
        return None
    fault, source = look.at_fault()
    if c[1, 1] > _CLEAR:
        words = "sideways they agree"
        return {"corr": corr, "fault": words, "undo": _by(np.diag((1.0, 1.0, -1.0)))}
    words = "whether the odometry or the truth is wrong, these data do not show"
    if fault is not None:
        words = f"{source} turns as {look.paths[1 - fault].name} does, so {look.paths[fault].name} is wrong"
    undo = lambda path: replace(path, xyz=path.xyz * [1.0, -1.0, 1.0], yaw_rad=-path.yaw_rad)  # noqa: E731
    return {"i": fault or 0, "corr": max(corr, -1.0), "fault": words, "undo": undo}


def _overflows(look: Look, i: int) -> Figures | None:
    """Find steps of odometry that are far longer than usual and of about equal length."""
    rows = increments(look.paths[0].trajectory().xyt).rows
    size = np.hypot(rows[:, 0], rows[:, 1])
    at = np.flatnonzero(size > 10.0 * np.percentile(size[size > 0.0], 90.0)) if size.any() else np.zeros(0, int)
    if i or not 1 < len(at) < 0.05 * len(rows):
        return None
    before = np.maximum(at - 1, 0)
    wheel_m = 2.0 * float(np.median(size[at] + size[before]))  # the wheel goes on meanwhile
    if np.mean(np.abs(2.0 * size[at] - wheel_m) < 0.1 * wheel_m) < 0.5:
        return None
    steps = np.unique(np.round(np.abs(2.0 * np.delete(rows[:, 0], at)), 9))
    gaps = np.diff(steps[steps < 0.1 * wheel_m])
    gaps = gaps[gaps > 1e-8]
    tick = float(np.median(gaps[gaps < 1.5 * gaps.min()])) if len(gaps) else np.inf
    bits = round(power := float(np.log2(max(wheel_m / tick, 1.0))))
    known = bits > 7 and abs(power - bits) < 0.02
    width = f"2^{bits} ticks of {tick * 1e3:.3g} mm: a counter of {bits} bits" if known else "often 16 bits"
    rows[at] = rows[before]
    return {"count": len(at), "wheel_m": wheel_m, "width": width, "undo": lambda path: _moved_by(path, rows)}


def _one_way(look: Look, axis: int) -> Figures | None:
    """Find motions of the truth to a side of zero on which the odometry's motion along an axis never is."""
    here, there, _ = look.windows
    # beside a centre of turning, a tracked point goes back in turns on the spot
    straight = np.abs(there[:, 0]) > 0.5 * np.abs(there[:, 2]) if axis == 0 else np.ones(len(here), dtype=bool)
    for side in (-1, 1) if look.paths[1].headed else ():
        real, counted = _moving(there[:, axis], side) & straight, _moving(here[:, axis], side)
        if not real.any() or real.sum() < max(0.01 * len(real), 10.0 * counted.sum()):
            continue
        ahead = np.median(here[real, axis] / there[real, axis]) < -0.5
        enough = real.sum() >= (_FEWEST / 2.0 if ahead else _FEWEST)
        other = _moving(there[:, axis], -side)
        low, high = np.percentile(here[other, axis] / there[other, axis], (25.0, 75.0)) if other.any() else (0.0, 0.0)
        if enough and 0.0 < high < 2.0 * low and np.mean(here[real, axis] * side > 0.0) < 0.1:
            how = "drives forwards there" if ahead else "stands there"
            return {"share": f"{real.mean():.0%}", "how": how, "side": "right" if side < 0 else "left"}
    return None


def _stands(look: Look) -> Figures | None:
    """Find windows in which the odometry does not move at all while the truth does."""
    here, there, (starts, _) = look.motions
    speed = np.hypot(there[:, 0], there[:, 1])
    moves = speed > 0.5 * np.percentile(speed, 95.0)
    lost = moves & (np.abs(here) <= 1e-3 * np.percentile(np.abs(here), 95.0, axis=0)).all(axis=1)
    lost_s = float(lost.sum()) * look.window_s / 4.0
    if lost_s < 10.0 or lost.sum() < 0.2 * moves.sum():
        return None
    begins = starts[lost]

    def undo(path: Samples) -> Samples:
        after = np.searchsorted(begins, path.t_s) - 1
        return path.only((after < 0) | (path.t_s - begins[np.maximum(after, 0)] > look.window_s))

    return {"lost": f"{lost_s:.0f}", "share": f"{lost.sum() / moves.sum():.0%}", "undo": undo}


def _turns_otherwise(look: Look) -> Figures | None:
    """Find odometry whose travel is the truth's and whose turns are not."""
    c, (here, there, _) = look.correlations, look.windows
    used = _moving(there[:, 0])
    turns = [float(np.sqrt(np.mean(x[used, 2] ** 2))) for x in (here, there)] if used.any() else [0.0]
    few = min(turns) < _FEW_TURNS or used.sum() < 5 * _FEWEST
    if few or abs(c[2, 2]) > _UNCLEAR or np.corrcoef(here[:, 0], there[:, 0])[0, 1] < _FOLLOWS:
        return None
    return {"corr": float(c[2, 2])}


def _truth_unit(look: Look) -> Figures | None:
    k, speeds = look.travel.value, [own.speed_mps for own in look.own]
    unit = next((name for name, per_m in UNITS.items() if look.travel.sure and abs(k / per_m - 1.0) < 0.1), None)
    if unit is None or speeds[1] < _ROBOT_MPS or speeds[0] > _ROBOT_MPS:
        return None
    return {"i": 1, "far": k, "unit": unit, "speed": speeds[1], "undo": lambda p: replace(p, xyz=p.xyz / UNITS[unit])}


def _ratios(look: Look, travel: bool, turn: bool, *, alike: bool = False) -> Figures | None:  # noqa: FBT001
    """Find which of travel and turns are plainly wrong, by the same factor or not."""
    v, w = look.travel, look.turn
    wrong = v.beyond(_WRONG)
    # chords of positions smooth turns
    same = v.sure and w.sure and abs(v.value / w.value - 1.0) < (_ALIKE if look.paths[1].headed else 4.0 * _ALIKE)
    if (wrong, w.beyond(_WRONG, _WRONG if wrong else _SKIDS)) != (travel, turn) or same is not alike:
        return None
    if not w.sure and look.turns > _FEW_TURNS:
        return None
    gains = v.value if travel else 1.0, v.value if alike else w.value if turn else 1.0
    sides = [look.ratio(2, side=side) for side in (1, -1)]
    large = [max(k, 1.0 / k) for k in gains]
    far = [f"{x:.3g} times {'less than' if k > 1.0 else 'as far as'}" for x, k in zip(large, gains, strict=True)]
    beside = ", left and right alike" if all(s.sure for s in sides) else ""
    if beside and abs(sides[0].value / sides[1].value - 1.0) > 2.0 * _ALIKE:
        beside = f", left {sides[0].value:.3g} and right {sides[1].value:.3g} times"
    separation = gains[0] / gains[1]
    return {
        "travels": far[0], "turns": far[1], "hint": _hint(gains[0]), "hint_turn": _hint(separation), "v": gains[0],
        "gains": gains, "separation": separation, "sides": beside,
        "agree": f"turns {'agree' if w.sure else 'are too few to compare'}",
        "track": f" ({look.track_m:.4g} -> {look.track_m * separation:.4g} m)" if look.track_m else "",
        "truth": "; or lengths of the truth in another unit" if gains[0] > 1.0 else "",
        "undo": _by(np.diag((gains[0], *gains))),
    }  # fmt: skip


def _hint(factor: float) -> str:
    """Return the likely cause of a factor near one of `_HINTS` or its inverse, in brackets."""
    off = {said: abs(np.log(max(factor, 1.0 / factor) / near)) for near, said in _HINTS.items()}
    nearest = min(off, key=off.__getitem__)
    return f" ({nearest})" if off[nearest] < 1.5 * _ALIKE else ""


_RECORD = "mend it and record again"
_KEPT = "the model has the factor, and is of this odometry as it is"

# fmt: off
_CLOCKS = (
    Pattern(
        "clock rate",
        "{who}: its clock advances {rate} s in a second of {other}'s{doubt} (stretched, motions correlate by {best})",
        "stamps in another unit, or counted at another rate; a simulation slower than its clock",
        "give stamps of one clock in seconds", _rate, "its stamps are multiplied by {factor}",
    ),
)
_MOTIONS = (
    Pattern(
        "overflow", "{who}: {count} jumps of the same size, {wheel_m} m of one wheel", "a counter overflows: {width}",
        "subtract counts as signed integers of the counter's width", _overflows, "the jumps are taken out", alone=True,
    ),
    Pattern(
        "speed", "{who}: usually moves at {speed} m/s", "millimetres for metres", "give metres (columns x_mm, y_mm)",
        _speed, "its lengths are divided by 1000", alone=True,
    ),
    Pattern(
        "quaternion without w",
        "{who}: its orientations are no unit quaternions (w is 0 in all): its headings never change",
        "w was never set beside z = sin(yaw / 2)",
        "set w = cos(yaw / 2), or make poses of its twists with `odomcorrupt integrate`",
        lambda look, i: {"i": i} if look.paths[i].no_w and look.own[i].fixed > _FOLLOWS else None, alone=True,
    ),
    Pattern(
        "unit of headings", "{who}: its headings, not its path, are of another unit: {unit}",
        "degrees given to a function of radians, or the other way round; a column with the wrong name",
        "name the column yaw_deg or yaw_rad, as it is; for a bag, convert before making quaternions", _unit_of_headings,
        "its headings are multiplied by {factor}", alone=True,
    ),
    Pattern(
        "folded headings", "{who}: its headings are of half a circle alone, and jump by 180 deg {count} times",
        "an arc cosine or tangent of one argument; an angle modulo 180 deg", "take atan2 of both components", _folded,
        "the jumps are undone", alone=True,
    ),
    Pattern(
        "mirrored headings", "{who}: its headings turn the other way than its path does",
        "an axis is mirrored; compass headings", "turn a compass by 90 deg - yaw, or flip the axis", _mirrored_headings,
        "mirrored so that it turns as {other} does", alone=True,
    ),
    Pattern(
        "plane", "{who}: moves in its {plane} plane, not in x-y: {up} points up there", "axes of a camera or of a game",
        "turn it so that z points up", _upright, "turned so; its positions alone are used",
    ),
    Pattern(
        "headings of the truth", "{who}: its headings do not follow its own path: they {what}",
        "its attitude turns about another axis (y up); orientation not estimated; another body", "publish yaw about z",
        lambda look: _unrelated(look, 1), "its positions alone are used",
    ),
    Pattern(
        "headings of the odometry", "{who}: its headings do not follow its own path: they {what}",
        "orientation never filled in, or filled from another source than the position", _RECORD,
        lambda look: _unrelated(look, 0),
    ),
    Pattern(
        "late clock",
        "{who}: its clock is {off} s {side} the odometry's (motions correlate by {best} there, by {near} as they are)",
        "clocks that are not synchronised; one of the files began later", "give --truth-shift {shift}", _late,
    ),
    Pattern(
        "stands still", "{who} stands still for {lost} s while {other} moves ({share} of its motion)",
        "messages repeated by a driver that lost its wheels; a cable; wheels that are lifted", _RECORD, _stands,
        "these stretches are left out",
    ),
    Pattern(
        "wheel gains", "{who} moves as with wheels that count {each} times their way (this explains {explained})",
        "{cause}", "{change}", _wheel_gains, "{then}",
    ),
    Pattern(
        "forward is -x",
        "{who} drives backwards where the truth drives forwards (correlation {corr}); turns agree",
        "the base frame looks backwards; both wheels are negated and exchanged; the truth is mounted backwards",
        "negate and exchange left and right, or turn the base frame by 180 deg", lambda look: _reversed(look, 1.0),
        "the odometry is turned by 180 deg",
    ),
    Pattern(
        "both wheels negated", "{who} drives backwards and turns right where the truth drives ahead and turns left",
        "both encoders count the wrong way", "negate the counts of both wheels", lambda look: _reversed(look, -1.0),
        "the odometry's motions are negated",
    ),
    Pattern(
        "forward is y", "{who} drives along its {side} axis where {other} drives along x (correlation {corr})",
        "x and y exchanged; a base or a marker turned by 90 deg", "turn its frame by 90 deg", _sideways,
        "turned by 90 deg",
    ),
    Pattern(
        "left and right exchanged", "odometry and truth turn opposite ways (correlation {corr}): {fault}",
        "left and right wheels or encoders exchanged; an axis of the truth mirrored, or compass headings",
        "exchange left and right, or flip the axis", _exchanged, "{who} is mirrored",
    ),
    Pattern(
        "never reverses", "{who} never drives in reverse, the truth does in {share} of its time; it {how}",
        "encoders without direction (one channel, or a counter that cannot count down); unsigned speeds",
        "count both channels, or give speeds the sign of the command; " + _RECORD, lambda look: _one_way(look, 0),
    ),
    Pattern(
        "never turns one way", "{who} never turns {side}, the truth does in {share} of its time",
        "an unsigned yaw rate, or an angle from an arc cosine", "keep the sign; " + _RECORD,
        lambda look: _one_way(look, 2),
    ),
    Pattern(
        "turns otherwise",
        "{who} travels as the truth does, but its turns do not follow the truth's (correlation {corr})",
        "degrees given to a tangent or sine; the angle of another joint or axis", _RECORD, _turns_otherwise,
    ),
    Pattern(
        "unit of the truth", "{who} travels {far} times as far as {other}, usually at {speed} m/s",
        "{unit} for metres", "give metres (columns x_mm, y_cm, z_ft name their unit)", _truth_unit, "taken as {unit}",
    ),
    Pattern(
        "wheel radius", "{who} travels and turns {travels} the truth, by the same factor",
        "wheel radius, gear ratio or ticks per turn wrong by this factor{hint}", "`wheel_radius` x {v}",
        lambda look: _ratios(look, True, True, alike=True), _KEPT,
    ),
    Pattern(
        "wheel separation", "{who} turns {turns} the truth{sides}; travel agrees",
        "wheel separation (or steering ratio, or gyro scale) wrong by this factor{hint_turn}",
        "`wheel_separation` x {separation}{track}", lambda look: _ratios(look, False, True), _KEPT,
    ),
    Pattern(
        "travel", "{who} travels {travels} the truth; {agree}",
        "gear ratio, ticks per turn or wheel radius, and headings from a gyro{hint}{truth}", "`wheel_radius` x {v}",
        lambda look: _ratios(look, True, False), _KEPT,
    ),
    Pattern(
        "travel and turns", "{who} travels {travels} the truth, and turns {turns} it",
        "wheel radius (gear ratio, ticks per turn){hint}, and wheel separation{hint_turn}",
        "`wheel_radius` x {v}, `wheel_separation` x {separation}{track}",
        lambda look: _ratios(look, True, True), _KEPT,
    ),
)
# fmt: on
PATTERNS = (*_CLOCKS, *_MOTIONS)
"""Plain mistakes in the order in which they are tested and undone."""
