"""First look at odometry and truth: plain mistakes of wiring, units, signs and axes, before any statistics.

Every mistake is one row of `PATTERNS`: what is seen in the windows of `motion_windows`, its usual causes, what to
change, and how the study goes on. A row that is found is undone and the rest is looked at again.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from odomcorrupt.drive_types import STEERED
from odomcorrupt.effects import effect_from_values
from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.motion import step_of
from odomcorrupt.geometry.se2 import Increments, accumulate, between, increments, wrap
from odomcorrupt.geometry.trajectory import distance_along
from odomcorrupt.study.io.jumps import reach_of, stretches
from odomcorrupt.study.io.motion_maps import STEERED_WHEELS, WHEELS, linear
from odomcorrupt.study.io.motion_windows import (
    ARM_M,
    ASKEW,
    CLEAR,
    CLOSE,
    COURSES,
    CURVED_RADPM,
    DEGREE,
    FEWEST_WINDOWS,
    FOLLOWS,
    MOVING,
    UNCLEAR,
    Look,
    Travel,
    chords_of,
    concentration,
    correlations_of,
    heading_at_steps,
    moving,
    steady_motion,
    travel_of,
)
from odomcorrupt.study.io.plausibility import check_pair, cross_correlation
from odomcorrupt.study.io.raw_trajectory import (
    BACKWARDS,
    CLOCK_S,
    FEWEST,
    NO_STAMPS,
    READ_AS,
    REPEATED,
    SHARED,
    runs_of,
)
from odomcorrupt.study.io.recording import Mistake

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.raw_trajectory import Samples
    from odomcorrupt.study.io.recording import Recording

_WRONG, _SKIDS = 1.3, 1.9
"""Factors from which travel and turns are plainly wrong; skid steering turns up to 1.9 times less than its wheels."""
_FEW_TURNS = 0.1
"""Usual turn in a window, rad, up to which turns are too few to compare."""
_ALIKE = 0.06
"""Relative difference of two factors that are the same."""
_BENT_RAD = 0.1
"""Turn of a step from which it matters how its travel is directed."""
_LOST = 2.0
"""Turn between messages, rad, beyond which many exceed half a turn and are lost."""
_FAST_MPS, _ROBOT_MPS = 60.0, 10.0
"""Speed that no robot has, and one that few have."""
OF_COURSES = {
    1.0: ("like", "", ""),
    -1.0: ("the other way than", "compass headings; an axis mirrored",
           "x and y exchanged, or one negated; rotated by -yaw"),
    1.0 / DEGREE: ("a 57th of", "degrees, not radians", "yaw in radians is converted to radians again"),
    -1.0 / DEGREE: ("minus a 57th of", "degrees of a compass (clockwise)", "another axis, and degrees"),
    DEGREE: ("57.3 times as far as", "radians that are read as degrees", "x += v cos(yaw) dt with yaw in degrees"),
    0.5: ("half as far as", "twice the angle (z = sin(yaw), w = cos(yaw))", "half of yaw in sine and cosine"),
    2.0: ("twice as far as", "half of the angle, as yaw for yaw / 2 in a quaternion", "steps are rotated by yaw twice"),
    0.0: ("never, unlike", "", "x += v dt: steps are not rotated by yaw, or by yaw converted to radians twice"),
}  # fmt: skip
"""How many times as far as its headings a path turns, one of `COURSES`, in words; usual causes if the headings are
wrong, and if the path is."""
UNITS = {"feet": 1.0 / 0.3048, "inches": 1.0 / 0.0254, "centimetres": 100.0, "millimetres": 1000.0}
"""Units of length that are confused with metres, per metre."""
_LENGTHS = {per_m: f"{unit} for metres" for unit, per_m in UNITS.items()}
_OF_TRAVEL = _LENGTHS | {
    2.0: "diameter for radius, or one edge of the encoder counted instead of two", 4.0: "quadrature counted once",
    3.6: "km/h for m/s", 2.0 * np.pi: "2 pi left out", 30.0 / np.pi: "rpm for rad/s", 2.54: "inches for centimetres",
}  # fmt: skip
_OF_TURNS = _LENGTHS | {2.0: "half of it for the whole", DEGREE: "degrees for radians"}
"""Likely causes of factors near these or their inverses."""

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
    then: str
    find: Callable[..., Figures | None]
    alone: bool = False


class FirstLook(NamedTuple):
    """Odometry and truth with all mistakes undone, and the mistakes.

    gains : ratios of truth to odometry in travel and turns by which the odometry is multiplied, 1 if about right
    dead_band_radps : yaw rate below which the odometry reads zero, 0 if there is none
    ratios : what is left of them, in words
    """

    odometry: Samples
    truth: Samples
    mistakes: tuple[Mistake, ...] = ()
    gains: tuple[float, float] = (1.0, 1.0)
    dead_band_radps: float = 0.0
    ratios: str = ""


def first_look(look: Look) -> FirstLook:
    """Return odometry and truth without plain mistakes, and the mistakes.

    Raises
    ------
    RecordingError
        If nothing can be learned from them as they are; the message says why.
    """
    found: list[Mistake] = []
    gains, band_radps = (1.0, 1.0), 0.0
    if look.paths[1].headed and look.own[1].turned < 1e-6 and (look.own[0].turned > 0.5 or not look.own[1].straight):
        said = "its headings never change: its positions alone are used"
        look = look.having(1, look.paths[1].without_headings().noted(said))
    for pattern in PATTERNS:
        if pattern.name == "inverse":  # clocks are right from here on
            check_pair(*look.paths)
        if pattern.name == "turned axes" and look.agree:  # all others are of motions that differ
            break
        for which in ((0,), (1,)) if pattern.alone else ((),):
            if (figures := pattern.find(look, *which)) is None:
                continue
            found.append(_mistake(pattern, look, figures))
            if (undo := figures.get("undo")) is None:
                found[-1] = found[-1]._replace(then="")
                raise RecordingError(". ".join(one.sentence for one in found))
            gains, band_radps = figures.get("gains", gains), figures.get("dead_band_radps", band_radps)
            look = look.having(i := figures.get("i", 0), undo(look.paths[i]))
    scales = zip(("travel", "turns"), look.scales, strict=True)
    seen = [f"{what} {r.value:.3g} (+-{r.spread:.1%})" if r.sure else f"{what} not comparable" for what, r in scales]
    words = f"in {look.window_s:.2g} s, truth over odometry: {', '.join(seen)}"
    return FirstLook(*look.paths, tuple(found), gains, band_radps, words)


def mistakes_alone(path: Samples) -> list[Mistake]:
    """Return the plain mistakes that odometry shows by itself."""
    look = Look((path, path))
    return [_mistake(one, look, seen) for one in PATTERNS if one.alone and (seen := one.find(look, 0)) is not None]


def _mistake(pattern: Pattern, look: Look, figures: Figures) -> Mistake:
    i = figures.get("i", 0)
    who = look.paths[i].name if "undo" in figures else look.paths[i].place
    words = {"who": who, "other": look.paths[1 - i].name} | figures
    words = {key: f"{value:.3g}" if isinstance(value, float) else value for key, value in words.items()}
    return Mistake(pattern.name, *(text.format(**words) for text in pattern[1:5]))


def factors_of(recordings: Sequence[Recording]) -> tuple[Effect, ...]:
    """Return the effects that multiply an odometry's travel and turns as plain mistakes require, none if they do not.

    All recordings are of one robot, so the first one counts.
    """
    (travel, turn), drive_type = recordings[0].gains, recordings[0].drive_type
    heading = {} if travel == turn else {"heading": "gyro"}
    found = [effect_from_values("wheel_scale", {"e": travel - 1.0, **heading})] if travel != 1.0 else []
    if turn not in (1.0, travel):
        name, e = ("steering_scale", turn - 1.0) if drive_type in STEERED else ("wheelbase", 1.0 / turn - 1.0)
        found.append(effect_from_values(name, {"e": e}))
    return tuple(found)


def _moved_by(path: Samples, rows: Array) -> Samples:
    """Return a trajectory with other motions (n - 1, 3)."""
    moved = accumulate(path.trajectory().xyt[0], Increments.of_rows(rows))
    return replace(path, xyz=np.column_stack((moved[:, :2], path.xyz[:, 2])), yaw_rad=moved[:, 2])


def _by(matrix: Array | Sequence[float]) -> Callable[[Samples], Samples]:
    """Return the function that multiplies a trajectory's motions by a matrix (3, 3) or its diagonal (3,)."""
    whole = np.diag(matrix) if np.ndim(matrix) == 1 else np.asarray(matrix)
    return lambda path: _moved_by(path, increments(path.trajectory().xyt).rows @ whole.T)


def _factor_of_course(look: Look, i: int, beside: Array | float) -> float | None:
    """Return how many times as far as its headings a path turns, one of `COURSES`, None if as far or if unclear.

    beside : directions of its steps from its heading, 0 if it drives ahead
    """
    own, other, path, (travel, turn) = look.own[i], look.own[1 - i], look.paths[i], look.scales
    sideways, line = isinstance(beside, np.ndarray), min(own.line, other.line) > FOLLOWS
    fits = tuple(heading_at_steps(path, k, beside)[1] for k in COURSES) if sideways else own.agreement
    # between messages an angle in degrees turns as 57.3 times the other one does, also if it has no way along the path,
    # unless it travels as many times as far: that is a radius
    unit = not turn.sure or abs(np.log(turn.value ** (2 * i - 1) / DEGREE)) < CLOSE
    unit = unit and not (travel.sure and turn.sure and abs(np.log(travel.value / turn.value)) < _ALIKE)
    unit = unit and look.correlations.diagonal()[:2].min() < FOLLOWS  # by wrong headings it would drive another way
    off = [1.0 - look.turns_by(i, k) if look.headed and unit and fits[0] < FOLLOWS else 1.0 for k in (DEGREE, 1.0)]
    if off[0] < min(1.0 - FOLLOWS, off[1] / 3.0):
        return 1.0 / DEGREE
    # all factors fit two paths along one line, whose turns show it; zero fits one of them
    best = int(np.argmax(fits) if sideways or own.line < FOLLOWS else len(fits) - 1)
    if line and look.headed and turn.sure:
        best = int(np.argmin(np.abs(np.array(COURSES) - turn.value)))
    k = COURSES[best]
    k = 0.0 if abs(k) < 0.1 and fits[-1] > fits[best] - 0.02 else k
    # how many times worse each path follows its headings than this multiple of them
    doubts = [(1.0 - one.agreement[0]) / (1.001 - one.agreement[best]) for one in look.own]
    wrong = fits[0] < CLEAR or (k != 0.0 and not sideways and doubts[i] > 4.0 > 4.0 * doubts[1 - i])
    few = own.chords < FEWEST_WINDOWS or (k == 0.0 and (own.turned < 1.0 or line))
    unlike = few or not wrong or fits[best] < FOLLOWS or (k == -1.0 and own.step > _LOST)
    return None if unlike else k


def _steps_and_headings(look: Look, i: int) -> Figures | None:
    """Find a path that turns otherwise than its headings; what turns as the other trajectory does is right."""
    path = look.paths[i]
    # a robot that drives sideways follows its heading in the directions that the other one has in its own frame
    beside = look.directions(i) if look.headed else 0.0
    if (k := _factor_of_course(look, i, beside)) is None:
        return None
    yaw = path.yaw_rad if np.ptp(path.yaw_rad) > 2.0 * np.pi + 0.01 else np.unwrap(path.yaw_rad)
    step = np.diff(path.xyz[:, :2] @ [1.0, 1j]) * np.exp(-1j * heading_at_steps(path, k, beside)[0])
    # a path that is mirrored, not rotated by -yaw, has its steps on the other side
    aside = [concentration(2.0 * (np.angle(x) - np.asarray(beside))) for x in (step, np.conj(step))]
    step = np.conj(step) if k == -1.0 and aside[1] > aside[0] and isinstance(beside, np.ndarray) else step
    # how far the path is turned from these headings, but for half a turn
    askew = float(np.angle(np.mean((step * np.exp(-1j * np.asarray(beside))) ** 2))) / 2.0
    turned, sideways = abs(askew) > ASKEW, isinstance(beside, np.ndarray)
    step = step * np.exp(-1j * askew * (turned or not sideways))
    step = np.conj(step) if k == -1.0 and not sideways else step
    rows = np.column_stack((step.real, step.imag * sideways, wrap(np.diff(path.yaw_rad))))
    mended = [replace(path, yaw_rad=k * yaw + askew * turned), _moved_by(path, rows)]
    mended[: 1 + look.headed] = [_ahead(look, i, one) for one in mended[: 1 + look.headed]]
    turns = [look.having(i, one).scales[1] for one in mended]
    far = [abs(float(np.log(turn.value))) if turn.sure else np.inf for turn in turns]
    right = int(k == 0.0 or far[1] < far[0])
    times, *causes = OF_COURSES[k]
    then = (f"its headings are multiplied by {k:.3g}", "its path is made again of its steps and headings")[right]
    if k == 1.0 / DEGREE and not right and np.exp(far[0]) > _WRONG:  # several turns between messages
        mended[0], then = path.without_headings(), "its positions alone are used"
    said = "; ".join(filter(None, causes)) if path is look.paths[1 - i] else causes[right]
    which = f", and its {('path turns', 'headings turn')[right]} as {look.paths[1 - i].name}"
    which *= path is not look.paths[1 - i]
    return {"i": i, "times": times, "which": which, "causes": said, "then": then, "undo": lambda _: mended[right]}


def _flips(look: Look, i: int) -> Figures | None:
    """Find headings that jump by half a turn, alone or with their path, unlike the other's."""
    path = look.paths[i]
    turn, step = wrap(np.diff(path.yaw_rad)), np.linalg.norm(np.diff(path.xyz[:, :2], axis=0), axis=1)
    sides = np.array((np.append(turn[1:], 0.0), np.append(0.0, turn[:-1])))
    sudden = (np.abs(turn) > ASKEW) & (np.abs(sides).max(axis=0) < 0.35)
    turn -= sudden * sides.mean(axis=0)  # the robot turns meanwhile
    alike = sudden & (np.abs(turn) > np.pi - 0.35) & (step < 3.0 * np.percentile(step, 95.0))
    jumps = np.flatnonzero(alike)
    steady = replace(path, yaw_rad=np.unwrap(path.yaw_rad))
    steady.yaw_rad[1:] -= np.cumsum(alike * np.sign(turn) * np.pi)
    if not path.headed or look.own[i].fixed > FOLLOWS or not len(jumps):
        return None
    if look.headed and abs(look.having(i, steady).correlations[2, 2]) < UNCLEAR:
        return None
    # headings that are courses jump where a robot backs up
    ends = np.clip(jumps + np.array(((-FEWEST_WINDOWS,), (0,), (1,), (1 + FEWEST_WINDOWS,))), 0, len(step))
    before, _, after = np.diff(path.xyz[ends, :2], axis=0)
    on = np.sum(before * after, axis=1) > -0.5 * np.prod(np.linalg.norm((before, after), axis=2), axis=0)
    words = {"i": i, "count": len(jumps)}
    if on.mean() >= 0.5:
        return words | {"how": "while its path goes on", "undo": lambda _: _ahead(look, i, steady)}
    rows = increments(path.trajectory().xyt).rows
    rows[:, 2] = np.diff(steady.yaw_rad)
    mended = _moved_by(path, rows)
    other = look.having(i, mended)
    # where the other one backs up, headings are a course
    if not look.headed or abs(other.correlations[0, 0]) < CLEAR:
        return None
    if 1.0 - other.turns_by(i, 1.0) > (1.0 - look.turns_by(i, 1.0)) / 2.0:
        return None
    return words | {"how": "and so does its path, unlike the other's", "undo": lambda _: mended}


def _folded(look: Look, i: int) -> Figures | None:
    """Find headings within half a turn whose sign is lost, unlike that of the path's directions."""
    path, (course, middle) = look.paths[i], chords_of(look.paths[i].xyz[:, :2])
    if (
        not path.headed
        or len(course) < 3 * FEWEST_WINDOWS
        or path.yaw_rad.min() < -_BENT_RAD
        or np.ptp(path.yaw_rad) < 2.0
    ):
        return None
    ways = np.array((course, wrap(course + np.pi)))  # ahead, and backwards
    off = np.abs(np.abs(ways) - path.yaw_rad[middle])
    follows, beside = (one.agreement[0] > FOLLOWS for one in (look.own[i], look.own[1 - i]))
    far = np.percentile(off.min(axis=0), 80.0) > 2.0 * _BENT_RAD
    one_sided = np.mean(np.where(off[0] < off[1], ways[0], ways[1]) < 0.0) < MOVING
    return None if far or follows or (look.headed and not beside) or one_sided else {"i": i}


def _ahead(look: Look, i: int, path: Samples) -> Samples:
    """Return a trajectory turned by half a turn if it drives backwards where the other one does not."""
    ahead_m = float(increments(path.trajectory().xyt).ds_m.sum())
    back = look.having(i, path).correlations[0, 0] < -CLEAR if look.headed else ahead_m < 0.0
    return replace(path, yaw_rad=path.yaw_rad + np.pi) if back else path


def _euler(look: Look, i: int) -> Figures | None:
    """Find odometry that goes along its heading at the beginning (0) or the end (1) of each step, not halfway (1/2)."""
    step = between(*(look.paths[0].trajectory().xyt[part] for part in (slice(-1), slice(1, None))))
    turn, ahead = wrap(step[:, 2]), np.sign(step[:, 0])
    bends = (np.abs(turn) > _BENT_RAD) & (np.abs(turn) < np.pi / 2.0)
    part = (np.arctan2(ahead * step[:, 1], ahead * step[:, 0]) / np.where(bends, turn, np.inf))[bends]
    travel = np.hypot(step[:, 0], step[:, 1])  # by which directions count, as turns on the spot have hardly any
    if i or bends.sum() < 3 * FEWEST_WINDOWS or not travel[bends].any():
        return None
    if np.average(np.abs(part - (k := round(float(np.median(part))))), weights=travel[bends]) > 0.02 or k not in (0, 1):
        return None
    rows = np.column_stack((ahead * travel, 0.0 * turn, turn))
    most = float(np.degrees(np.percentile(np.abs(turn[bends]), 95.0)))
    return {"at": ("beginning", "end")[k], "most": most, "undo": lambda path: _moved_by(path, rows)}


def _unrelated(look: Look, i: int) -> Figures | None:
    """Find headings that follow neither their own path nor the other trajectory."""
    own, other, beside = look.own[i], look.own[1 - i], look.paths[1 - i]
    undo = {"undo": lambda path: path.without_headings()} if i else {}
    turns = other.turned > 0.5 if beside.headed else own.agreement[0] < CLEAR
    if not i and own.turned < 1e-6 and turns:
        return None if own.straight else {"i": i, "what": "never change"}
    # headings that are right beside wheels that are exchanged make one linear function of the two motions
    few = min(own.chords, other.chords) < 3 * FEWEST_WINDOWS or linear(*look.motions[1::-1])[1] > FOLLOWS
    if few or max(own.agreement) > CLEAR or other.agreement[0] < FOLLOWS:
        return None
    if abs(look.correlations[2, 2]) > UNCLEAR:
        return None
    what = "are 0 or 180 deg alone" if own.fixed > FOLLOWS else "turn otherwise"
    return {"i": i, "what": what, **undo}


def _never_turns(look: Look) -> Figures | None:
    """Find odometry that does not turn; what it does where the truth turns on the spot shows why."""
    own, real, _ = look.sizes[1]
    corr, drives = look.correlations[2, 2], look.own[0].turned < 1.0 and look.scales[0].sure
    still = own < 0.1 * real and not look.scales[1].sure and (drives or corr > -UNCLEAR)
    # positions alone show it as a path in all directions beside one along a line
    bent = not look.paths[1].headed and look.own[0].line > FOLLOWS > CLEAR > look.own[1].line
    bent = bent and not look.scales[1].sure
    if not bent and (real <= _FEW_TURNS or not (look.own[0].straight or still)):
        return None
    return {}


def _upright(look: Look) -> Figures | None:
    own, real = (p.xyz - p.xyz.mean(axis=0) for p in look.paths)
    size, axes = np.linalg.svd(real / np.sqrt(len(real)), full_matrices=False)[1:]
    wide = float(np.linalg.svd(own[:, :2] / np.sqrt(len(own)), compute_uv=False)[1])
    up = int(np.argmax(np.abs(axes[2])))
    if wide < 0.05 or size[1] < 0.5 * wide or size[2] > 0.25 * wide or up == 2:
        return None
    order = [(up + 1) % 3, (up + 2) % 3, up]
    plane = "-".join(sorted("xyz"[k] for k in order[:2]))
    words = {"i": 1, "up": "xyz"[up], "plane": plane}
    return words | {"undo": lambda path: replace(path, xyz=path.xyz[:, order]).without_headings()}


def _stretched(look: Look) -> Figures | None:
    """Find positions of the truth that are farther apart along one axis than along the other."""
    own, real = (look.chords(i, np.array((0.0, 3.0)))[0] for i in (0, 1))  # long beside noise
    moves = moving(np.abs(own)) & moving(np.abs(real))
    course, ratio = 2.0 * np.angle(real[moves]), np.abs(own[moves] / real[moves]) ** 2
    design = np.column_stack((np.ones(len(course)), np.cos(course), np.sin(course)))
    if len(course) < 3 * FEWEST_WINDOWS or concentration(course) > CLEAR:
        return None
    # 1 / factor^2 varies as (mean - wave) / (mean + wave) with twice the course
    mean, *waves = linear(design, ratio[:, None])[0][0]
    wave, along = float(np.hypot(*waves)), float(np.arctan2(-waves[1], -waves[0])) / 2.0
    left, varies = (np.median(np.abs(ratio - x)) for x in (design @ [mean, *waves], np.median(ratio)))
    # what depends on the speed, too, is no factor
    if not CLOSE * mean < wave < 0.8 * mean or left > min(CLEAR * varies, 0.1 * mean):
        return None
    factor = float(np.sqrt((mean + wave) / (mean - wave)))
    # the axis along which lengths agree is right
    across = abs(np.log(mean + wave)) > abs(np.log(mean - wave))
    axis, by = np.exp(1j * (along + across * np.pi / 2.0)), (factor if across else 1.0 / factor) - 1.0
    xy = look.paths[1].xyz[:, :2] @ [1.0, 1j]
    xy = xy + by * axis * (xy * np.conj(axis)).real
    mended = replace(look.paths[1], xyz=np.column_stack((xy.real, xy.imag, look.paths[1].xyz[:, 2])))
    return {"i": 1, "factor": factor, "along": f"{np.degrees(along) % 180.0:.0f}", "undo": lambda _: mended}


def _inverse(look: Look, i: int) -> Figures | None:
    """Find poses whose inverses move as the other trajectory does."""

    def undo(path: Samples) -> Samples:
        turned = -(path.xyz[:, :2] @ [1.0, 1j]) * np.exp(-1j * path.yaw_rad)
        return replace(path, xyz=np.column_stack((turned.real, turned.imag, path.xyz[:, 2])), yaw_rad=-path.yaw_rad)

    if abs(look.correlations[0, 0]) > CLEAR or not look.headed:
        return None
    c = look.having(i, undo(look.paths[i])).correlations
    return {"i": i, "undo": undo} if min(c[0, 0], c[2, 2]) > FOLLOWS else None


def _rate(look: Look) -> Figures | None:
    """Find a clock of another rate or unit: motions correlate after stretching it, by log times or to equal spans."""
    # log times that go as the stamps show nothing: both are then taken to last as long, and the less usual period of
    # messages is at fault
    spans = [path.span_s / (float(np.ptp(path.log_ns)) * 1e-9 if len(path.log_ns) else 1.0) for path in look.paths]
    if logged := all(len(p.log_ns) for p in look.paths) and max(spans) > (1.0 + _ALIKE) * min(spans):
        usual = spans
    else:
        spans = [path.span_s for path in look.paths]
        usual = [float(np.median(np.diff(path.stamps_ns))) / 5e7 for path in look.paths]
    i = int(abs(np.log(usual[1])) > abs(np.log(usual[0])))
    factor = spans[1 - i] / spans[i]
    if not logged and 0.2 < factor < 5.0:
        i, factor = 0, spans[1] / spans[0]

    def stretched(path: Samples, factor: float) -> Samples:
        beside = look.paths[1 - i]
        start = beside.stamps_ns[0] + (path.log_ns[0] - beside.log_ns[0] if logged else 0)
        return path.stamped(start + np.round((path.stamps_ns - path.stamps_ns[0]) * factor).astype(np.int64))

    def alike(factor: float, *, from_start: bool) -> float:
        pair = list(look.paths)
        pair[i] = stretched(pair[i], factor) if factor != 1.0 else pair[i]
        reach_s = min(60.0, *(path.span_s / 2.0 for path in pair))
        one, other = (path.trajectory() for path in pair)
        corr = cross_correlation(one, other, reach_s, from_start=from_start, smoothing_s=2.0)
        return float(np.maximum(corr.both, corr.mirrored).max())

    # farther apart, there is no motion at any shift to compare with
    shared = 0.05 < factor < 20.0 and look.paths[0].shared_s(look.paths[1]) > 0.0
    near = alike(1.0, from_start=False) if shared else 0.0
    least = max(0.7, near + 0.2)
    if abs(np.log(factor)) < _ALIKE / 2.0 and near < 0.7:
        i, factor, least = 0, 1.0, 0.95  # spans are equal if the last messages of one are missing
        for reach in (0.7, 0.035, 0.002):
            trials = factor * np.exp(np.linspace(-reach, reach, 41))
            factor = max(trials.tolist(), key=lambda k: alike(k, from_start=True))
    if abs(np.log(factor)) < _ALIKE / 2.0 or (mended := alike(factor, from_start=True)) < least:
        return None
    words = {"i": i, "doubt": "" if logged else ", or the other one by the inverse", "best": mended}
    return words | {"rate": 1.0 / factor, "factor": float(factor), "undo": lambda path: stretched(path, factor)}


def _late(look: Look) -> Figures | None:
    """Find a clock that is seconds off; a periodic drive looks mirrored half a period later."""
    odometry, truth = (p.trajectory() for p in look.paths)
    corr = cross_correlation(odometry, truth, min(60.0, look.paths[0].span_s / 2.0))
    near = np.abs(corr.lag_s) <= CLOCK_S
    # positions alone, noisy or of turns on the spot, show turns badly
    alike, more = (corr.both, 0.25) if look.paths[1].headed or corr.both.max() > 0.7 else (corr.speed, 0.2)
    best, here = int(np.argmax(alike)), float(alike[near].max())
    most, lag_s = float(alike[best]), float(corr.lag_s[best])
    if most < max(0.7, here + more, float(corr.mirrored[near].max()) + 0.02):
        return None
    words = {"off": f"{abs(lag_s):.1f}", "side": "behind" if lag_s > 0.0 else "ahead of", "shift": f"{lag_s:.1f}"}
    return words | {"i": 1, "best": most, "near": here}


def _turns_late(look: Look) -> Figures | None:
    """Find turns that come later, or earlier, than the travel."""
    path, truth = (p.trajectory() for p in look.paths)
    corr = cross_correlation(path, truth, min(8.0, look.paths[0].span_s / 4.0))
    turn_s, travel_s = (float(corr.lag_s[np.argmax(x)]) for x in (corr.turn, corr.speed))
    late_s, t_s = turn_s - travel_s, look.paths[0].t_s
    if abs(late_s) < 0.6 or min(corr.turn.max(), corr.speed.max()) < FOLLOWS:
        return None
    rows = increments(path.xyt).rows
    rows[:, 2] = np.diff(np.interp(t_s + late_s, t_s, np.unwrap(path.xyt[:, 2])))
    words = {"late": f"{abs(late_s):.1f}", "side": "later" if late_s > 0.0 else "earlier"}
    return words | {"undo": lambda path: _moved_by(path, rows)}


_WHEELS = {
    2: (("left", "right"), np.array(((1.0, -1.0), (1.0, 1.0)))),
    4: (("front left", "front right", "rear left", "rear right"),
        np.array(((1.0, -1.0, -1.0), (1.0, 1.0, 1.0), (1.0, 1.0, -1.0), (1.0, -1.0, 1.0)))),
}  # fmt: skip
"""Two wheels, or four that drive sideways, and how far they roll by a motion, turns in units of their arm."""


def _matrix(look: Look, axes: list[int]) -> tuple[Array, float]:
    """Return the matrix that makes motions along some axes of the truth's, and what it explains of them."""
    here, there, _ = look.motions
    trials = [there]
    if not look.paths[1].headed:  # speeds then have the sign of one of the odometry's motions
        speed = np.hypot(there[:, 0], there[:, 1])
        used = steady_motion(moving(speed))
        here, there, speed = here[used], there[used], speed[used]
        trials = [np.column_stack((np.sign(here[:, k]) * speed, 0.0 * speed, there[:, 2])) for k in (0, 2)]
    if len(here) < FEWEST_WINDOWS:
        return np.eye(len(axes)), 0.0
    matrix, explained = max((linear(x[:, axes], here[:, axes]) for x in trials), key=lambda found: found[1])
    if matrix[0, -1] * matrix[-1, 0] < 0.0 and not look.paths[1].headed:
        matrix[:, 0] *= -1.0
    own, real = (float(correlations_of(x, x)[0, 2]) for x in (here, there))
    if len(axes) > 2:
        return matrix, explained
    if abs(own) > 0.999:
        if abs(real) > 0.95:  # both on one circle: its two gains are not distinguishable
            return matrix, 0.0
        # odometry that pivots about one wheel, whatever the truth's turns: that wheel counts nothing
        curvature, explained = float(np.copysign(np.linalg.norm(here[:, 2]) / np.linalg.norm(here[:, 0]), own)), own**2
        matrix = matrix[0, 0] * np.array(((1.0, 1.0 / curvature), (curvature, 1.0)))
    elif abs(matrix[0, 0]) < 0.1 and np.corrcoef(np.abs(here[:, 2]), np.hypot(*there.T[:2]))[0, 1] > FOLLOWS:
        # turns that follow the truth's travel, beside which its turns are not seen: one wheel reversed
        matrix, explained = np.array(((0.0, 1.0 / matrix[-1, 0]), (matrix[-1, 0], 0.0))), FOLLOWS
    elif abs(matrix[1, 0]) > 1e-6 and look.paths[1].headed:
        # a tracked point to the left of the centre has a part of the turns in its travel
        left_m = (matrix[1, 1] - matrix[0, 0]) / matrix[1, 0]
        if abs(left_m) < 1.0:
            matrix -= [[0.0, matrix[0, 0] * left_m], [0.0, matrix[1, 0] * left_m]]
    return matrix, explained


def _wheel_gains(look: Look) -> Figures | None:
    """Find wheels that count by unequal factors g: motions are J' diag(g) J / n times the truth's, J of `_WHEELS`."""
    if look.agree or (look.headed and any(look.maps)):
        return None
    axes = [0, 1, 2] if look.sideways else [0, 2]
    names, rolls = _WHEELS[2 * len(axes) - 2]
    matrix, explained = _matrix(look, axes)
    by_turn, by_travel = np.abs(matrix[:-1, -1]).sum(), np.abs(matrix[-1, :-1]).sum()
    if explained < FOLLOWS or look.correlations[0, 0] == 0.0 or not 1e-6 < by_turn < 2.0 * by_travel:
        return None
    arm_m = np.array((*axes[1:], np.sqrt(by_turn / by_travel))) ** (np.array(axes) == 2)
    scaled = matrix / arm_m * arm_m[:, None]
    mean = np.diag(np.diag(scaled))
    if look.sideways and np.abs(scaled @ scaled - np.eye(3)).max() < 0.2 < np.abs(scaled - mean).max():
        back = np.asarray(np.linalg.inv(matrix))
        return {"each": "exchanged", "explained": f"{explained:.1%}", "undo": _by(back), "then": _UNDONE,
                "cause": "two wheels are exchanged, or one is reversed", "change": "swap or negate them"}  # fmt: skip
    gains = np.trace(mean) / len(axes) + np.einsum("ij,jk,ik->i", rolls, scaled - mean, rolls) / 2.0
    most = float(np.abs(gains).max())
    off = np.abs(rolls.T @ (gains[:, None] * rolls) / len(rolls) - scaled).max()
    # travel sideways beside two wheels is that of a point off their centre
    if (
        (look.sideways and not look.strafes)
        or off > 0.2 * most
        or np.ptp(gains) < (1.0 - 1.0 / _WRONG) * most * np.sqrt(len(rolls) / 2.0)
    ):
        return None
    dead, reverse = np.abs(gains) < 0.1 * most, gains < -0.3 * most
    wrong = next(x for x in (reverse, dead, np.abs(gains - 1.0) > 0.12, gains < np.inf) if x.any())
    if len(rolls) == 2 and wrong.all() and not (reverse.any() or abs(gains.mean() - 1.0) > _ALIKE):
        return None  # a curvature, as of a steering angle's zero
    which = " and ".join(np.array(names)[wrong]) + (" wheel" if wrong.sum() == 1 else " wheels")
    if reverse.any():
        cause = f"the {which} counts the wrong way: channels A and B of its encoder, or its motor, are exchanged"
        cause += "; of a steered robot, sine and cosine of its angle are" * (len(rolls) == 2)
        change = f"negate the counts of the {which}"
    elif dead.any():
        cause, change = f"the {which} counts nothing: its encoder, cable or topic", _RECORD
    else:
        cause = f"ticks per turn, gear ratio or radius of the {which} wrong by this factor"
        change = f"multiply the counts of the {which} by {1.0 / (k := gains[wrong].mean()):.3g}{_hint(k, _OF_TRAVEL)}"
    figures: Figures = {
        "each": f"that count {', '.join(f'{n} {g:.2f}' for n, g in zip(names, gains, strict=True))} times their way",
        "explained": f"{explained:.1%}", "cause": cause, "change": change, "then": "",
    }  # fmt: skip
    if len(rolls) == 4 or not dead.any():
        # the arm is no better known than the gains, so only what the change says is undone
        mended = np.where(wrong, -1.0 if reverse.any() else gains, 1.0)
        back = np.eye(3)
        back[np.ix_(axes, axes)] = np.linalg.pinv(rolls.T @ (mended[:, None] * rolls) / len(rolls))
        back[np.ix_(axes, axes)] *= arm_m / arm_m[:, None]
        figures |= {"undo": _by(back), "then": _UNDONE}
    return figures


def _reversed(look: Look, turn: float) -> Figures | None:
    """Find odometry that drives backwards and turns as the truth does (1) or the other way (-1)."""
    c = look.correlations
    wrong = look.paths[1].headed and c[0, 0] < -CLEAR and c[2, 2] * turn > CLEAR
    return {"undo": _by((-1.0, -1.0, turn))} if wrong else None


def _turned_axes(look: Look) -> Figures | None:
    """Find axes that are turned by an angle beyond that of a mounting."""
    ways = [x[:, 0] + 1j * x[:, 1] for x in look.windows[:2]]
    used = moving(np.abs(ways[0])) & moving(np.abs(ways[1]))
    apart = np.angle(ways[1] * np.conj(ways[0]))[used]
    angle = float(np.angle(np.mean(np.exp(1j * apart)))) if len(apart) else 0.0
    clear = len(apart) >= FEWEST_WINDOWS and concentration(apart) > FOLLOWS and look.correlations[2, 2] > -CLEAR
    if not look.paths[1].headed:
        angle = -look.own[0].askew
    elif not clear:
        return None
    if not ASKEW < abs(angle) < np.pi - ASKEW / 2.0:
        return None
    aside = [float(np.std(x.imag) / np.std(x)) for x in ways]
    i = int(aside[1] > max(aside[0], UNCLEAR)) if look.paths[1].headed else 0
    turn = angle if i else -angle
    words = {"angle": f"{abs(np.degrees(turn)):.0f}", "side": "left" if turn > 0.0 else "right"}
    return {"i": i, **words, "undo": lambda p: replace(p, yaw_rad=p.yaw_rad + turn)}


def _aside(look: Look) -> Figures | None:
    """Find travel sideways of another sign or size while travel forwards and turns agree."""
    c, side, v = look.correlations, look.ratio(1), look.scales[0]
    drives = look.strafes and all(np.std(x[:, 1]) > MOVING * np.std(x[:, 0]) for x in look.windows[:2])
    clear = min(abs(c[1, 1]), c[0, 0], c[2, 2]) > CLEAR and side.number >= FEWEST_WINDOWS and side.spread < 0.5
    if look.paths[1].headed and min(c[0, 0], c[2, 2]) > CLEAR and not drives:
        here, there = look.windows[0] * (v.value if v.sure else 1.0, 1.0, 1.0), look.windows[1]
        rest = (there[:, 1:2] - here[:, ::2] @ linear(here[:, ::2], there[:, 1:2])[0].T)[:, 0]
        rest = np.abs(np.convolve(rest, np.ones(8) / 8.0, "same"))  # noise of a localisation does not last
        usual = np.percentile(np.abs(there[:, 0]), 80.0)
        # where headings of the truth are turned for a while, it moves sideways only as the odometry drives
        off = (rest > MOVING * usual) & (rest < 2.0 * usual) & (np.abs(here[:, 0]) < rest / 2.0) & look.seen
        return {"how": "never moves sideways, unlike"} if off.mean() > 0.02 and here[:, 1].std() < 0.1 * usual else None
    size = abs(side.value) / v.value
    wrong = not 1.0 / _SKIDS < size < _WRONG
    if not drives or not clear or not look.paths[1].headed or not (wrong or c[1, 1] < 0.0):
        return None
    how = " and ".join(["the other way than"] * int(c[1, 1] < 0.0) + [_far(size)] * wrong)
    return {"how": f"moves sideways {how}", "undo": _by((1.0, np.copysign(size, c[1, 1]), 1.0))}


def _exchanged(look: Look) -> Figures | None:
    c = look.correlations
    # a robot that hardly turns shows it by its travel sideways
    corr = float(c[2, 2] if abs(c[2, 2]) > UNCLEAR else c[1, 1])
    if corr > -CLEAR or c[0, 0] < CLEAR or (look.one_sided(0) and not look.one_sided(1)):  # turns without a sign
        return None
    fault, source = look.at_fault()
    if c[1, 1] > CLEAR:
        return {"corr": corr, "fault": "sideways they agree", "undo": _by((1.0, 1.0, -1.0))}
    words = "whether the odometry or the truth is wrong, these data do not show"
    if fault is not None:
        words = f"{source} turns as {look.paths[1 - fault].name} does, so {look.paths[fault].name} is wrong"
    mirrored = lambda p: replace(p, xyz=p.xyz * [1.0, -1.0, 1.0], yaw_rad=-p.yaw_rad)  # noqa: E731
    return {"i": fault or 0, "corr": corr, "fault": words, "undo": mirrored}


def _overflows(look: Look, i: int) -> Figures | None:
    """Find increments of a wheel, or of the travel, that jump by one length: the range of its counter."""
    rows = increments(look.paths[0].trajectory().xyt).rows
    n, steps = np.arange(len(rows)), np.abs(np.diff(rows[:, [0, 2]], axis=0))
    both = steps[(steps > np.sort(steps, axis=0)[-3:][:1] / 4.0).all(axis=1)]
    # where one wheel's increments jump, travel changes by half of it and the heading by it over the track
    ends = np.percentile(both[:, 0] / both[:, 1], (25.0, 50.0, 75.0)) if len(both) > 2 else np.arange(3.0)
    # beside a truth that goes as far, jumps are those of play in the gears or of noise
    if i or len(rows) < FEWEST or (look.paths[0] is not look.paths[1] and look.agree):
        return None
    for arm_m in (float(ends[1]), 0.0)[int(ends[2] > 1.3 * ends[0]) :]:
        wheels = rows[:, 0] + np.array(sorted({-arm_m, arm_m}))[:, None] * rows[:, 2]
        jump = np.abs(np.diff(wheels, axis=1))
        wheel_m = float(np.median(jump[jump >= np.sort(jump, axis=None)[-3] / 2.0]))
        same = np.abs(jump - wheel_m) < 0.15 * wheel_m
        if same.sum() < 3:
            continue
        # signed counts jump between the ends of their range, and are usually smaller
        usual, most = np.percentile(np.abs(wheels), (50.0, 99.9)) / wheel_m
        if signed := usual < 0.4 < most < 0.6:
            wheel_m = 256.0 / 255.0 * 2.0 * most * wheel_m
        real = np.unwrap(wheels, period=wheel_m, axis=1)
        count = int(np.sum(np.abs(real - wheels) > wheel_m / 2.0))
        few = np.sum(jump > 0.3 * wheel_m) > 1.1 * same.sum() or np.percentile(np.abs(wheels), 99.0) > 1.2 * wheel_m
        few |= np.ptp(np.percentile(real, (5.0, 95.0), axis=1), axis=0).max() < 0.03 * wheel_m
        # headings that turn by more than half a turn reverse increments, whose size stays
        few |= not signed and np.median(np.abs(np.diff(np.abs(wheels), axis=1))[same]) < 0.1 * wheel_m
        if 2 + 0.01 * len(rows) < count < 0.8 * len(rows) and not few:
            far = (np.abs(real - wheels) > wheel_m / 2.0).any(axis=0)
            rows[:, 0] = real.mean(axis=0)
            rows[:, 2] = (real[1] - real[0]) / (2.0 * arm_m) if arm_m else np.interp(n, n[~far], rows[~far, 2])
            return _counter(count, wheel_m, wheel_m / (2.0 * arm_m or np.inf), real, rows, look.paths[0].t_s[1:][far])
    # jumps that turn a robot by more than half a turn have another sign; rare ones are bridged
    size = np.hypot(rows[:, 0], rows[:, 1])
    speed = size / np.diff(look.paths[0].t_s)
    beside = np.maximum(np.append(speed[1:], np.inf), np.append(np.inf, speed[:-1]))
    far = speed > 3.0 * np.maximum(beside, np.percentile(speed[size > 0.0], 80.0)) if size.any() else size > 0.0
    # resets lead to one pose
    if not 1 < far.sum() < 0.2 * len(far) or np.ptp(look.paths[0].xyz[1:][far], 0).max() < 0.01 * size[far].max():
        return None
    usual = np.stack([np.interp(n, n[~far], x[~far]) for x in rows.T], axis=1)
    bend = float(np.median(np.abs(wrap(rows[far, 2] - usual[far, 2]))))
    size *= (sides := 1 + int(bend > _BENT_RAD))  # of one wheel of two; without a turn it is the only one, or both
    wheel_m = float(np.median(size[far] + sides * np.abs(usual[far, 0])))  # the wheel goes on meanwhile
    at_s = look.paths[0].t_s[1:][far]
    # travel has the cosine of a steering angle
    if np.mean(np.abs(size[far] - wheel_m) < 0.25 * wheel_m) < 0.5 and not _once_a_second(at_s):
        return None
    return _counter(int(far.sum()), wheel_m, bend, size[~far], usual, look.paths[0].t_s[1:][far])


def _counter(count: int, wheel_m: float, turn: float, increments_m: Array, rows: Array, at_s: Array) -> Figures:
    """Return the figures of a counter of a range in metres that overflows; its ticks are gaps of increments.

    turn : of a jump, rad, of whose arc the range is a chord unless the odometry's steps are straight
    """
    arc_m = wheel_m / float(np.sinc(turn / (2.0 * np.pi)))
    size = f"{wheel_m:.3g} m" if arc_m < 1.02 * wheel_m else f"{wheel_m:.3g} m (along arcs {arc_m:.3g} m)"
    gaps = np.diff(np.unique(np.round(np.abs(increments_m), 9)))
    gaps = gaps[gaps > 1e-8]
    tick = float(np.median(gaps[gaps < 1.5 * gaps.min()])) if len(gaps) else np.inf
    bits = round(power := float(np.log2(max(wheel_m / tick, 1.0))))
    cause = "a counter overflows (often of 8 or 16 bits), is read as unsigned, or is reset at stops"
    if bits > 7 and abs(power - bits) < 0.02:
        cause = f"a counter overflows: 2^{bits} ticks of {tick * 1e3:.3g} mm: a counter of {bits} bits"
    if _once_a_second(at_s):
        cause = "once a second: a time step is taken from the nanoseconds alone"
    return {"count": count, "size": size, "cause": cause, "undo": lambda path: _moved_by(path, rows)}


def _once_a_second(at_s: Array) -> bool:
    every_s = np.diff(at_s)
    return len(every_s) > 3 and bool(every_s.min() > 0.5 and np.mean(np.abs(every_s - np.rint(every_s)) < 0.1) > 0.9)


def _lost_sign(look: Look) -> Figures | None:
    """Find motions that have another sign, or none, on one side of zero, or that are those of a steered wheel."""
    one = look.maps[0]
    if one is None or one.kind != "sign":
        return None
    sides = ("left", "right")[:: 1 if one.matrix[1, 1] > 0.0 or one.at == 0.0 else -1]
    rolls = one.channel in (*WHEELS, "travel", "motion")
    turns = {"left turns": f"turns to the {sides[0]}", "right turns": f"turns to the {sides[1]}"}
    part = turns.get(one.channel, one.channel + " in reverse" * rolls)
    causes, change = "an unsigned yaw rate, or an arc cosine; a yaw rate of the absolute speed", "keep the sign"
    if rolls:
        causes, change = _NO_DIRECTION, "count both channels, or give speeds the sign of the command"
    does = f"counts its {part} {'forwards' if rolls else 'the other way'}"
    if one.channel in STEERED_WHEELS:
        does = f"has the travel of a steered wheel, {one.arm_m:.2g} m ahead of its axle"
        causes, change = "the cosine of the steering angle is left out", "multiply by it"
    elif one.at == 0.0:
        does = f"does not count its {part}"
    return {"does": does, "causes": causes, "change": change, "share": f"{look.changed(one).mean():.0%}"}


def _threshold(look: Look, kind: str) -> Figures | None:
    """Find a limit or a dead zone of one of the two, where the other one moves."""
    i, one = next(((i, one) for i, one in enumerate(look.maps) if one is not None and one.kind == kind), (0, None))
    if one is None:
        return None
    k = int(one.channel in ("turns", "curvature"))
    at = abs(one.at * one.matrix[k, k] / (one.matrix[0, 0] if one.channel == "curvature" else 1.0))
    unit = "rad/s" if one.channel == "turns" else "rad per m" if one.channel == "curvature" else "m/s"
    limited, beside = (look.paths[0].place, "the truth")[:: 1 - 2 * i]
    words: Figures = dict(zip(("causes", "change"), (THRESHOLDS if i == 0 else COMMANDS)[kind], strict=True))
    words |= {"one": limited, "beside": beside, "what": QUANTITIES[one.channel], "at": f"{at:.3g} {unit}"}
    words |= {"share": f"{look.changed(one, 1 - i).mean():.0%}"}
    if kind == "dead zone":
        words |= {"undo": lambda path: path, "then": "the study goes on with the rest"}
        if one.channel == "turns on the spot":
            words |= {"causes": _NO_SPOT, "change": "integrate the yaw rate at any speed"}
        if one.channel == "turns" and i == 0:
            words |= {"dead_band_radps": at, "then": "it is part of the model"}
            return None if _slow_turns(look) is not None else words
    return words


def _whole_steps(look: Look) -> Figures | None:
    """Find increments or speeds that are multiples of a step, and by which the truth travels farther than they say."""
    path, (here, there, (starts, _)) = look.paths[0], look.windows
    rows, dt_s = increments(path.trajectory().xyt).rows, np.diff(path.t_s)
    per = dt_s if (speeds := step_of(rows[:, 0]) is None) else np.ones(len(dt_s))
    # odometry that hardly turns has few steps of turns, from which no step is refined
    turns = np.abs(rows[:, 2] / per)[np.abs(rows[:, 2]) > 1e-9]
    step, turn = step_of(rows[:, 0] / per) or 0.0, float(turns.min(initial=np.inf))
    turn = turn if len(turns) and np.mean(np.abs(turns / turn - np.rint(turns / turn)) < 0.02) > 0.99 else 0.0
    if step <= 0.01 * np.percentile(np.abs(rows[:, 0] / per), 90.0) or not look.scales[0].sure or look.sideways:
        return None
    off = there[:, 0] - here[:, 0]
    used = moving(here[:, 0]) & (np.abs(off) <= 6.0 * np.median(np.abs(off)))
    # cut towards zero, or down
    sides = [np.sign(rows[:, 0]), np.abs(np.sign(rows[:, 0]))]
    counted = [step * np.concatenate(([0.0], np.cumsum(side * per))) for side in sides]
    both = Travel(path.t_s, np.stack(counted, axis=1)).within(starts, look.window_s).T
    down = int(np.argmax([np.corrcoef(x[used], off[used])[0, 1] if np.ptp(x[used]) > 0.0 else -1.0 for x in both]))
    steps = both[down]
    # beside a scale error of some percent; windows overlap four times
    noise = 2.0 * float(np.std(off[used])) + 1e-9
    design = np.column_stack((here[used, 0], steps[used])) / noise
    inverse = np.linalg.pinv(design.T @ design + np.diag((1.0 / 0.02**2, 0.0)))
    lost, error = float((inverse @ design.T @ off[used])[1]) / noise, float(np.sqrt(inverse[1, 1]))
    # each of n wheels loses half a step on average, and travel has steps of an n-th of theirs
    wheels = min((1, 2, 4), key=lambda n: abs(np.log(max(lost, 1e-3) / n * 2.0)))
    if turn:  # sum and difference of two whole numbers are both even or both odd
        odd = np.rint(rows[:, 0] / per / step) + np.rint(rows[:, 2] / per / turn)
        wheels = 2 if np.mean(odd % 2.0) < 0.01 else 1
    # increments of ticks lose nothing, and speeds that are rounded neither
    near = abs(lost - wheels / 2.0) < max(0.2, 0.1 * wheels)
    usual = float(np.median(np.abs(rows[:, 0] / per)[np.abs(rows[:, 0]) > 0.0]))
    if lost < max(0.25, 2.5 * error) or not near or not 0.04 * usual < lost * step < 1.1 * usual:
        return None
    # of turns, both wheels lose alike if they are cut down
    halves = np.stack((step * sides[down], 0.0 * per, (not down) * turn * np.sign(rows[:, 2])), axis=1)
    mended = rows + lost * per[:, None] * halves
    said = f"{'speeds' if speeds else 'increments'} are whole steps of {1e3 * wheels * step:.3g} mm{'/s' * speeds}"
    words = {"steps": f"{said} of a wheel", "lost": f"travels {lost:.2f} +- {error:.2f}"}
    return words | {"undo": lambda path: _moved_by(path, mended)}


def _slow_turns(look: Look) -> Figures | None:
    """Find odometry that reports no turns below a rate, though the truth turns: a dead band.

    Unequal wheels and a bias turn a robot whose command is straight, too, in proportion to travel or time.
    """
    path, (here, there, (starts, _)), window_s = look.paths[0], look.motions, look.window_s
    rows, dt_s = increments(path.trajectory().xyt).rows, np.diff(path.t_s)
    turn = np.abs(rows[:, 2])
    zero, least = turn <= 1e-9, float(turn[turn > 1e-9].min(initial=np.inf))
    # of a smooth density, as many turns would lie below the least one as up to its double
    above = turn[~zero & (turn < 2.0 * least)] / least - 1.0
    if not look.headed or least < 1e-6 or len(above) < 30 or np.mean((above > 0.05) & (above < 0.95)) < 0.5:
        return None
    rate = least / float(np.median(dt_s))
    zeros_s = np.concatenate(([0.0], np.cumsum(zero * (np.abs(rows[:, 0]) > 1e-6) * dt_s)))
    straight_s = np.interp(starts + window_s, path.t_s, zeros_s) - np.interp(starts, path.t_s, zeros_s)
    slow = (np.abs(here[:, 2]) < rate * window_s) & (straight_s > 0.3 * window_s)
    if slow.sum() < 5 * FEWEST_WINDOWS:
        return None
    steady, missed = np.column_stack((here[slow, 0], np.ones(slow.sum()))), (there - here)[slow, 2]
    missed = missed - steady @ np.linalg.lstsq(steady, missed, rcond=None)[0]
    # 0.4549 is the median of chi-square with 1 degree of freedom; second differences have 6 variances, turns 2
    noise = 2.0 * float(np.median(np.diff(np.unwrap(look.paths[1].yaw_rad), n=2) ** 2)) / 0.4549 / 6.0
    seen = float(np.mean(missed**2)) - noise
    if seen < max(2.0 * noise, (0.1 * rate * window_s) ** 2):
        return None
    return {"rate": float(np.degrees(rate)), "dead_band_radps": rate, "undo": lambda path: path}


def _resets(look: Look, i: int) -> Figures | None:
    """Find lasting jumps of odometry, beyond which it goes on from another pose."""
    path = look.paths[0]
    rows = stretches(path, reach_of(path, path)).rows if i == 0 and len(path) >= FEWEST else ()
    far = {int(own[0]): float(np.linalg.norm(path.xyz[own[0]] - path.xyz[own[0] - 1])) for own in rows[1:]}
    # where nothing is recorded meanwhile, a robot may have gone as far, but not to where it began
    gone = np.linalg.norm(path.xyz[:, :2] - path.xyz[0, :2], axis=1)
    back = (gone[1:] < ARM_M) & (gone[:-1] > 10.0 * ARM_M) & (np.diff(path.t_s) > 0.5)
    far |= {int(k): float(gone[k - 1]) for k in np.flatnonzero(back) + 1 if i == 0}
    jumps = {k: metres for k, metres in sorted(far.items()) if metres > 3.0 * ARM_M}
    where = ", ".join(f"{metres:.2f} m at {path.t_s[k]:.0f} s" for k, metres in jumps.items())
    causes = ["the node or the board was restarted; a counter was reset", "counts or speeds are read as unsigned"]
    alike = len(jumps) > 1 and max(jumps.values()) < (1.0 + _ALIKE / 2.0) * min(jumps.values())
    said = "; ".join(causes[:: -1 if alike else 1])
    return {"where": where, "causes": said, "undo": lambda path: path} if 0 < len(jumps) <= FEWEST_WINDOWS else None


def _publishers(look: Look, i: int) -> Figures | None:
    """Find poses that jump and come back within some messages all the time."""
    xy, few = look.paths[i].xyz[:, :2], 8
    n = len(xy) - few
    far = np.linalg.norm([xy[k : n + k] - xy[:n] for k in range(1, few)], axis=2) if n > 0 else np.zeros((2, 1))
    # ticks that come and go at rest are small
    back = (far[1:].min(axis=0) < 0.1 * far[0]) & (far[0] > max(ARM_M, 0.02 * np.linalg.norm(xy.std(axis=0))))
    found = {"i": i, "share": f"{back.mean():.0%}", "few": few}
    return found | {"far": float(np.median(far[0][back]))} if back.mean() > 0.2 else None


def _time_step(look: Look) -> Figures | None:
    """Find odometry that counts as much from one message to the next whatever the time between them."""
    path, (here, there, (starts, _)) = look.paths[0], look.motions
    speeds = [np.hypot(x[:, 0], x[:, 1]) for x in (here, there)]
    used, number = moving(speeds[0]) & moving(speeds[1]), np.arange(len(path))
    messages = np.interp(starts + look.window_s, path.t_s, number) - np.interp(starts, path.t_s, number)
    every, ratio = np.log(look.window_s / messages[used]), np.log(speeds[1][used] / speeds[0][used])
    low_s, high_s = np.exp(np.percentile(every, (5.0, 95.0))) if used.any() else (1.0, 1.0)
    if used.sum() < 5 * FEWEST_WINDOWS or high_s < (1.0 + 2.0 * _ALIKE) * low_s:
        return None
    # the truth goes as many times as far as the time is longer
    if abs(np.polyfit(every, ratio, 1)[0] - 1.0) > 0.2 or np.corrcoef(every, ratio)[0, 1] < 0.8:
        return None
    step_s = float(np.exp(np.median(every - ratio)))
    rows = increments(path.trajectory().xyt).rows * (np.diff(path.t_s) / step_s)[:, None]
    words = {"low": 1e3 * float(low_s), "high": 1e3 * float(high_s), "step": 1e3 * step_s}
    return words | {"undo": lambda path: _moved_by(path, rows)}


def _clamped(look: Look) -> Figures | None:
    """Find headings that stay at half a turn, or a whole one, while the truth turns."""
    path, (here, there, (starts, _)) = look.paths[0], look.motions
    if not look.headed:
        return None
    at = np.abs(np.abs(path.yaw_rad)[:, None] / np.pi - (1.0, 2.0)).min(axis=1) < 1e-6
    stays = np.interp(starts + look.window_s / 2.0, path.t_s, at) > 0.9
    lost = stays & (np.abs(here[:, 2]) < 1e-6) & moving(there[:, 2])
    return {"share": f"{lost.sum() / moving(there[:, 2]).sum():.0%}"} if lost.sum() >= FEWEST_WINDOWS else None


def _stands(look: Look, i: int) -> Figures | None:
    """Find windows in which one of the two does not move at all while the other one does."""
    here, there = look.motions[:2][:: 1 - 2 * i]
    # a truth has noise, also of a robot that is blocked
    sizes = [np.column_stack((np.hypot(x[:, 0], x[:, 1]), np.abs(x[:, 2]))) for x in (here, there)]
    usual = np.min([np.percentile(size, 95.0, axis=0) for size in sizes], axis=0)  # jumps of one are not usual
    still = (sizes[0] <= (1e-3, 0.04)[i] * usual).all(axis=1)
    moves = sizes[1][:, 0] > 0.5 * np.percentile(sizes[1][:, 0], 95.0)
    lost, runs = moves & still, runs_of(np.asarray(still))
    lost_s, share = float(lost.sum()) * look.window_s / 4.0, float(lost.sum()) / max(moves.sum(), 1)
    # a robot is blocked for shorter times than a driver fails; positions alone do not show its turns on the spot
    least_s = 4.0 if i and look.headed else 8.0
    if lost_s < least_s or (share < CLOSE and all(moves[a:b].sum() * look.window_s <= 2.5 * least_s for a, b in runs)):
        return None
    for a, b in runs:  # a pose that stays is wrong also while the other one rests
        lost[a:b] |= lost[a:b].any()
    words = {"i": i, "causes": _FROZEN[i], "lost": f"{lost_s:.0f}", "share": f"{share:.0%}"}
    return words | {"undo": _without(look, i, lost)}


def _without(look: Look, i: int, lost: NDArray[np.bool_]) -> Callable[[Samples], Samples]:
    """Return the function that leaves some windows (n,), and the end next to them, out of one of the two."""
    middle_s, origin = look.motions[2][i] + look.window_s / 2.0, int(look.paths[0].stamps_ns[0])
    return lambda path: path.only(np.interp(path.seconds_since(origin), middle_s, lost) < 0.5)


def _other_way_round(look: Look) -> Figures | None:
    """Find turns that differ from the truth's by whole turns in all, made in a while."""
    here, there, _ = look.motions
    off = (here - there)[:, 2] * look.seen
    whole, lost = np.cumsum(off[::4]), np.abs(off) > 3.0 * _BENT_RAD  # windows overlap four times
    count = round(float(np.ptp(whole)) / (2.0 * np.pi)) if len(whole) else 0
    opposite = np.sum((here * there)[lost, 2]) < 0.0 and np.median(np.abs(off)) < min(count, 2) * _BENT_RAD
    if not look.headed or not count or concentration(whole) < 0.8 or not opposite:
        return None
    return {"count": count, "undo": _without(look, 0, lost)}


def _one_curvature(look: Look) -> Figures | None:
    """Find odometry that keeps one curvature for long, as of a dead gyro or wheel, while the truth turns otherwise."""
    if any(look.maps):
        return None
    _, there, (starts, _) = look.motions
    path = travel_of(look.paths[0], int(look.paths[0].stamps_ns[0]))
    v = look.scales[0].value if look.scales[0].sure else 1.0
    here = path.within(starts, look.window_s) * [v, v, 1.0]
    speeds = [np.hypot(x[:, 0], x[:, 1]) for x in (here, there)]
    moves, usual = moving(speeds[0]), int(40.0 / look.window_s)
    # wheels without direction travel where the truth turns on the spot
    seen = look.seen & (speeds[0] < 3.0 * speeds[1] + 0.02 * np.percentile(speeds[0], 95.0))
    turning = np.abs(here[:, 2]) > 1e-6
    ahead = turning & moves & (np.abs(here[:, 0]) > np.abs(here[:, 1]))
    bend = _densest(here[ahead, 2] / here[ahead, 0], usual)
    bend *= abs(bend) > CURVED_RADPM  # a wheel is nearer than 2 m
    rate = _densest(here[turning, 2], usual)
    arcs = f"drives arcs of {1.0 / max(abs(bend), 1e-6):.2g} m to the {'left' if bend > 0.0 else 'right'}"
    quiet = 1e-6 + 0.02 * float(np.percentile(np.abs(there[:, 2]), 95.0))
    turned, pivots = there[:, 2], bend * here[:, 0]
    for does, own, off in (
        ("has one heading", 0.0 * turned, turned),
        (f"{arcs}, as about a wheel at rest,", pivots, turned - bend * there[:, 0]),
        (f"turns at {np.degrees(rate) / look.window_s:.2g} deg/s", rate + 0.0 * turned, turned),
    ):
        turns = moving(off) & seen & (moves | ~own.any())
        runs = sorted(runs_of(np.asarray(np.abs(here[:, 2] - own) < quiet)), key=lambda run: -turns[slice(*run)].sum())
        lost = np.zeros(len(starts), dtype=bool)
        for run in [run for run in runs if turns[slice(*run)].sum() >= FEWEST_WINDOWS]:
            lost[slice(*run)] = True
        # a loose contact loses a wheel, and half of the travel, for some moments each
        ratios = [speeds[0][x & moves] / (speeds[1][x & moves] + 1e-9) for x in (lost, ~lost)]
        if own is not pivots or not min(map(len, ratios)) or np.median(ratios[0]) > 0.75 * np.median(ratios[1]):
            lost[:] = False
            lost[slice(*(runs[0] if runs else (0, 0)))] = True
        many = turns[lost].sum()
        few = many * look.window_s < 40.0 or turns.sum() - many < FEWEST_WINDOWS
        # noise of the truth's headings does not add up, and a gyro's dead band has no usual turns
        few = few or min(look.own[0].turned, np.ptp(off[lost].cumsum()) / 4.0) < 1.0
        # commands of even curvature follow there, and other mistakes do not elsewhere
        follows = [abs(correlations_of(here[x], there[x])[2, 2]) for x in (lost, ~lost)] if not few else [1.0, 1.0]
        if follows[0] > FOLLOWS or (look.paths[1].headed and follows[1] < CLEAR):
            continue
        parts = f", in {len(runs_of(lost))} parts" * (len(runs_of(lost)) > 1)
        when = f"from {starts[lost][0]:.0f} s to {starts[lost][-1] + look.window_s:.0f} s{parts}"
        return {"when": when, "does": does, "undo": _without(look, 0, lost)}
    return None


def _densest(x: Array, count: int) -> float:
    """Return the mode of values (n,), of the shortest interval with `count` of them; 0 if its negative is one, too."""
    x = np.sort(x)
    if len(x) <= count:
        return 0.0
    at = float(x[int(np.argmin(x[count:] - x[:-count])) + count // 2])
    # a limit is reached on both sides
    same, other = (np.sum(np.abs(x - k * at) < 0.02 * abs(at)) for k in (1.0, -1.0))
    return at if other < 0.2 * same else 0.0


def _turns_too_far(look: Look) -> Figures | None:
    """Find odometry that turns by about half a turn and more from one message to the next, unlike the truth."""
    path, (_, there, _), most = look.paths[0], look.windows, look.own[0].step
    usual = float(np.percentile(np.abs(there[:, 2]), 95.0)) * path.span_s / len(path) / look.window_s
    if not most > _LOST > 10.0 * usual:
        return None
    # between messages a robot that turns so fast drives an arc
    arcs_m = np.diff(distance_along(path.xyz[:, :2])) / np.sinc(wrap(np.diff(path.yaw_rad)) / (2.0 * np.pi))
    causes = ["wheel separation in other units (centimetres, millimetres)", "degrees for radians"]
    if look.paths[1].headed and look.turns_by(0, DEGREE) > look.turns_by(0, UNITS["centimetres"]):
        causes.reverse()
    said, far = "; ".join(causes), float(arcs_m.sum()) / path.span_s / max(look.speeds_mps[1], 1e-9)
    if far > UNITS["feet"]:
        said = f"wheel radius in other units (centimetres, millimetres): it travels about {far:.0f} times as far, too"
    return {"most": np.degrees(most), "usual": np.degrees(usual), "causes": said}


def _unit_of_lengths(look: Look) -> Figures | None:
    """Find lengths in another unit than metres: one moves so fast as no robot does, the other so many times slower."""
    (k, *_), speeds = look.scales[0], look.speeds_mps
    i, far = int(k > 1.0), max(k, 1.0 / k) if look.scales[0].sure else 1.0
    unit = next((name for name, per_m in UNITS.items() if abs(far / per_m - 1.0) < 0.1), None)
    # odometry that is only somewhat too fast is rather of another wheel or gear
    slow = speeds[i] < (_FAST_MPS, _ROBOT_MPS)[i] or speeds[1 - i] > _ROBOT_MPS
    if unit is None or slow or look.scales[1].beyond(_SKIDS):
        return None
    undo = lambda path: replace(path, xyz=path.xyz / UNITS[unit])  # noqa: E731
    return {"i": i, "far": f"{far:.0f}", "unit": unit, "speed": speeds[i], "undo": undo}


def _ratios(look: Look, travel: bool, turn: bool, *, alike: bool = False) -> Figures | None:  # noqa: FBT001
    """Find which of travel and turns are plainly wrong, by the same factor or not, unless they only lag."""
    if look.lags_s != [(0.0, 0.0)] * 2:
        return None
    v, w = look.scales
    # chords of positions smooth turns
    same = v.sure and w.sure and abs(v.value / w.value - 1.0) < (_ALIKE if look.paths[1].headed else 4.0 * _ALIKE)
    wrong = v.beyond(_WRONG) or (same and w.beyond(_WRONG))
    turns = w.beyond(_WRONG, _WRONG if wrong else _SKIDS) or (same and wrong)
    few = not w.sure and (look.sizes[1][:2].max() > _FEW_TURNS or v.spread > 2.0 * _ALIKE or look.sideways)
    few = few and not (v.beyond(2.0 * _SKIDS) and v.spread < _ALIKE)
    left, right = (look.ratio(2, side) for side in (1, -1))
    # beside positions alone, turns of two sides that differ by far have another cause
    few = few or (turn and not look.headed and min(left.value, right.value) < 0.5 * max(left.value, right.value))
    if (wrong, turns) != (travel, turn) or same is not alike or few:
        return None
    gains = v.value if travel else 1.0, v.value if alike else w.value if turn else 1.0
    if turn and abs(left.value - right.value) > 0.5 * w.value and look.paths[1].headed:
        # turns that differ by a part of the travel, as by a steering's zero, are no factor
        part, explained = linear(look.windows[0][:, ::2], look.windows[1][:, 2:])
        if explained > FOLLOWS and abs(np.log(max(part[0, 1], 1e-3))) < np.log(_WRONG):
            return None
    beside = ", left and right alike" if left.sure and right.sure else ""
    if beside and abs(left.value / right.value - 1.0) > 2.0 * _ALIKE:
        beside = f", left {left.value:.3g} and right {right.value:.3g} times"
    separation = gains[0] / gains[1]
    return {
        "travels": _far(gains[0]), "turns": _far(gains[1]), "hint": _hint(gains[0], _OF_TRAVEL),
        "hint_turn": _hint(separation, _OF_TURNS),
        "v": gains[0], "gains": gains, "separation": separation, "sides": beside,
        "agree": f"turns {'agree' if w.sure else 'are too few to compare'}",
        "track": f" ({look.track_m:.4g} -> {look.track_m * separation:.4g} m)" if look.track_m else "",
        "undo": _by((gains[0], *gains)),
    }  # fmt: skip


def _far(gain: float) -> str:
    return f"{max(gain, 1.0 / gain):.3g} times {'less than' if gain > 1.0 else 'as far as'}"


def _hint(factor: float, causes: dict[float, str]) -> str:
    """Return the cause of the nearest of some factors or their inverses, in brackets."""
    off, nearest = min((abs(np.log(max(factor, 1.0 / factor) / near)), said) for near, said in causes.items())
    return f" ({nearest})" if off < 1.5 * _ALIKE else ""


_STAMPS = (REPEATED, NO_STAMPS, SHARED, BACKWARDS)
_RECORD = "mend it and record again"
_UNDONE = "this is undone in the odometry, and not in the model"
_NO_DIRECTION = "encoders without direction (one channel, or a counter that cannot count down); unsigned speeds"
QUANTITIES = {
    "travel": "speeds", "turns": "yaw rates", "curvature": "turns per metre", "turns on the spot": "turns at speeds",
} | {wheel: f"speeds of its {wheel}" for wheel in WHEELS}  # fmt: skip
THRESHOLDS = {
    "limit": (
        "ticks lost above a speed; a counter, message or sensor (gyro, steering) that saturates; curvature times speed",
        "count by hardware, or with fewer ticks; a wider type or range",
    ),
    "dead zone": (
        "a threshold of slow wheels, a gyro or a steering angle; values cut to integers; speeds by the time of ticks",
        "leave the threshold out, or apply it at rest",
    ),
}
COMMANDS = {
    "limit": ("odometry of commands, which the robot does not follow beyond this speed; wheels that spin",
              "count the wheels"),
    "dead zone": ("odometry of commands, which the robot does not follow below this speed", "count the wheels"),
}  # fmt: skip
_FROZEN = (
    "a driver that lost its wheels, and repeats a message",
    "a robot that is blocked while its wheels spin, or beside odometry of commands; a tracker that lost its target",
)
_NO_SPOT = "a yaw rate by curvature times speed, or headings that are integrated above a speed alone"
_KEPT = "the model has the factor, and is of this odometry as it is"

# fmt: off
PATTERNS = (
    Pattern("stamps", "{note}", "stamps in whole seconds, or one for all poses of a loop; nanoseconds without their "
            "leading zeros; never filled in; a column of another unit",
            "stamp each pose when measured, in seconds and nanoseconds; name a column t_ms or t_us", "they are used",
            lambda look, i: next(({"i": i, "note": one, "undo": lambda path: path} for one in look.paths[i].notes
                                  if one.endswith(_STAMPS) or (READ_AS in one and READ_AS not in
                                                               "".join(look.paths[1 - i].notes))), None), alone=True),
    Pattern("clock rate",
            "{who}: its clock advances {rate} s in a second of {other}'s{doubt} (stretched, motions correlate by "
            "{best})", "stamps in another unit, or counted at another rate; a simulation slower than its clock; a "
            "queue that grows, read slower than it is filled",
            "give stamps of one clock in seconds", "its stamps are multiplied by {factor}", _rate),
    Pattern("time step", "{who} counts for each message as for {step} ms, though they come every {low} to {high} ms",
            "v dt with a constant dt, whatever time the loop takes; increments since the last message, of which some "
            "are lost", "measure dt by a clock; send counts or poses, not increments",
            "its increments are multiplied by the time they took", _time_step),
    Pattern("inverse", "{who}: the inverses of its poses, not these, move as {other} does",
            "the fixed frame in the moving one is published (base -> odom, map in camera)",
            "invert the transform before publishing", "its poses are inverted", _inverse, alone=True),
    Pattern("overflow", "{who}: {count} jumps of the same size, {size} of one wheel",
            "{cause}", "subtract counts as signed integers of the counter's width, and stamps as whole numbers",
            "the jumps are taken out", _overflows, alone=True),
    Pattern("publishers", "{who}: {share} of its poses jump by {far} m and back within {few} messages",
            "several robots or nodes publish on one topic", "give each its own topic", "", _publishers, alone=True),
    Pattern("resets", "{who}: its pose jumps by {where}, and goes on from there",
            "{causes}", "keep pose and counts over a restart", "the parts are recordings of their own", _resets,
            alone=True),
    Pattern("quaternion without w",
            "{who}: its orientations are no unit quaternions (w is 0 or 1 in all): its headings are wrong",
            "w was never set beside z = sin(yaw / 2)",
            "set w = cos(yaw / 2), or make poses of its twists with `odomcorrupt integrate`", "",
            lambda look, i: {"i": i} if look.paths[i].no_w else None, alone=True),
    Pattern("steps and headings", "{who}: its path turns {times} its headings{which}",
            "{causes}", "convert angles once, before quaternions, sines and cosines; turn a compass by 90 deg - yaw; a "
            "column's name says its unit (yaw_deg, yaw_rad)", "{then}", _steps_and_headings, alone=True),
    Pattern("folded headings", "{who}: its headings stay within half a turn, its path goes to both sides of it",
            "an arc cosine, by which the sign of an angle is lost", "take atan2 of both components; " + _RECORD, "",
            _folded, alone=True),
    Pattern("flips", "{who}: its headings jump by 180 deg {how} ({count} times)",
            "an arc cosine or tangent of one argument; an angle modulo 180 deg, or 180 for 360 at its wrap; a course "
            "over ground; markers that a tracker confuses; the frame of a wheel, which rolls",
            "take atan2 of both components; make markers asymmetric", "the jumps are undone", _flips, alone=True),
    Pattern("plane", "{who}: moves in its {plane} plane, not in x-y: {up} points up there",
            "axes of a camera or of a game", "turn it so that z points up",
            "turned so; its positions alone are used", _upright),
    Pattern("stretched", "{who}: its lengths are {factor} times as long along one axis, {along} deg from x, as across",
            "degrees of longitude taken as long as those of latitude, without its cosine; pixels that are not square",
            "convert each axis to metres", "its positions are mended", _stretched),
    Pattern("headings of the truth", "{who}: its headings do not follow its own path: they {what}",
            "its attitude turns about another axis (y up); an arc sine or cosine; orientation not estimated; another "
            "body",
            "publish yaw about z", "its positions alone are used", lambda look: _unrelated(look, 1)),
    Pattern("headings of the odometry", "{who}: its headings do not follow its own path: they {what}",
            "orientation never filled in, or filled from another source than the position", _RECORD, "",
            lambda look: _unrelated(look, 0)),
    Pattern("never turns", "{who} never turns, {other} does", "a steering angle or yaw rate that stays 0 or is of "
            "another axis; one counter read for both wheels, or without direction where it turns on the spot alone",
            _RECORD, "", _never_turns),
    Pattern("clamped headings", "{who}: its headings stay at a half or whole turn in {share} of {other}'s turns",
            "an angle that is clamped to its range", "wrap it; " + _RECORD, "", _clamped),
    Pattern("late clock",
            "{who}: its clock is {off} s {side} the odometry's (motions correlate by {best} there, by {near} as they "
            "are)", "clocks that are not synchronised; one of the files began later", "give --truth-shift {shift}", "",
            _late),
    Pattern("late turns", "{who}: its turns come {late} s {side} than its travel",
            "a queue of a gyro's messages, or of one board's, that are stamped on arrival; a filter",
            "stamp each message when measured, and read the last one", _UNDONE, _turns_late),
    Pattern("other way round", "{who} turns the other way round, by 360 deg in all, {count} times",
            "angles are averaged or filtered across +-180 deg", "wrap differences of angles before filtering them",
            "these stretches are left out", _other_way_round),
    Pattern("Euler steps", "{who}: each step goes along its heading at the step's {at}, and turns by up to {most} deg",
            "x += v cos(yaw) dt at a low rate", "use yaw halfway, or integrate at the rate of the wheels",
            "steps are taken as arcs, and not in the model", _euler, alone=True),
    Pattern("stands still", "{who} stands still for {lost} s while {other} moves ({share} of its motion)",
            "{causes}", _RECORD,
            "these stretches are left out", lambda look: _stands(look, 0) or _stands(look, 1)),
    Pattern("turns too far",
            "{who} turns by {most} deg and more between messages, {other} by {usual}: beyond 180 deg turns are lost",
            "{causes}", "give lengths in metres and angles in radians; " + _RECORD, "", _turns_too_far),
    Pattern("whole steps", "{who}: its {steps}, and the rest is lost: the truth {lost} half "
            "steps farther each time", "integers in a loop or a protocol, cut off",
            "keep the remainder for the next cycle, or take floating point",
            "half a step is added each time, and not in the model",
            _whole_steps),
    Pattern("wheel gains", "{who} moves as with wheels {each} (this explains {explained})",
            "{cause}", "{change}", "{then}", _wheel_gains),
    Pattern("sign", "{who} {does} ({share} of the time)", "{causes}", "{change}; " + _RECORD, "", _lost_sign),
    Pattern("limit", "{one} has {what} of at most {at}; {beside} has larger ones in {share} of the time", "{causes}",
            "{change}; " + _RECORD, "", lambda look: _threshold(look, "limit")),
    Pattern("dead zone", "{one} has no {what} below {at}; {beside} has, in {share} of the time", "{causes}",
            "{change}; " + _RECORD, "{then}", lambda look: _threshold(look, "dead zone")),
    Pattern("one heading", "{who} {does} {when} while it travels and {other} turns otherwise",
            "a gyro, or that wheel's encoder, that died (cable, topic); a steering angle or yaw rate that stays; "
            "orientation no longer filled in; a clamped angle", _RECORD, "this stretch is left out", _one_curvature),
    Pattern("slow turns", "{who} reports no turns slower than {rate} deg/s, {other} turns then, too",
            "a dead band against the noise of a gyro or of increments; speeds cut to whole steps",
            "leave it out, or apply it at rest alone", "it is part of the model",
            _slow_turns),
    Pattern("turned axes", "{who} drives {angle} deg to the {side} of where {other} drives",
            "a base or a marker turned by this angle; x and y exchanged, or wheels of an omni drive in another order",
            "turn its frame by this angle", "turned back", _turned_axes),
    Pattern("forward is -x", "{who} drives backwards where the truth drives forwards; turns agree",
            "the base frame looks backwards; both wheels are negated and exchanged; the truth is mounted backwards",
            "negate and exchange left and right, or turn the base frame by 180 deg",
            "the odometry is turned by 180 deg", lambda look: _reversed(look, 1.0)),
    Pattern("both wheels negated", "{who} drives backwards and turns right where the truth drives ahead and turns left",
            "both encoders count the wrong way", "negate the counts of both wheels",
            "the odometry's motions are negated", lambda look: _reversed(look, -1.0)),
    Pattern("left and right exchanged", "odometry and truth turn opposite ways (correlation {corr}): {fault}",
            "left and right wheels or encoders exchanged; an axis of the truth mirrored, or compass headings",
            "exchange left and right, or flip the axis", "{who} is mirrored", _exchanged),
    Pattern("sideways", "{who} {how} {other}; forwards they agree",
            "two wheels are exchanged; the sideways part of the kinematics has another sign or factor, or is left out",
            "mend the sideways part", _UNDONE, _aside),
    Pattern("unit of lengths", "{who} travels {far} times as far as {other}, usually at {speed} m/s",
            "{unit} for metres", "give metres (columns x_mm, y_cm, z_ft name their unit)",
            "taken as {unit}, and the model is of metres", _unit_of_lengths),
    Pattern("wheel radius", "{who} travels and turns {travels} the truth, by the same factor",
            "wheel radius, gear ratio or ticks per turn wrong by this factor{hint}", "`wheel_radius` x {v}", _KEPT,
            lambda look: _ratios(look, True, True, alike=True)),
    Pattern("wheel separation", "{who} turns {turns} the truth{sides}; travel agrees",
            "wheel separation (or steering ratio, or gyro scale) wrong by this factor{hint_turn}",
            "`wheel_separation` x {separation}{track}", _KEPT, lambda look: _ratios(look, False, True)),
    Pattern("travel", "{who} travels {travels} the truth; {agree}",
            "gear ratio, ticks per turn or wheel radius, and headings from a gyro{hint}; or lengths of the truth in "
            "another unit, or without scale (one camera)", "`wheel_radius` x {v}", _KEPT,
            lambda look: _ratios(look, True, False)),
    Pattern("travel and turns", "{who} travels {travels} the truth, and turns {turns} it",
            "wheel radius (gear ratio, ticks per turn){hint}, and wheel separation{hint_turn}",
            "`wheel_radius` x {v}, `wheel_separation` x {separation}{track}", _KEPT,
            lambda look: _ratios(look, True, True)),
)
# fmt: on
"""Plain mistakes in the order in which they are tested and undone."""
