"""Basis functions of one regressor, for errors that no library effect explains.

An error rate is a motion (travel or sideways travel, its absolute value, or turn) times a basis function of one
regressor, such as speed, place or time. Its target, a channel of the body or the wheels, is a separate choice.
Thresholds, places and moments are families with shape parameters; the penalty accounts for the size of the family.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from itertools import pairwise, product
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

import numpy as np

from odomcorrupt.effects.expression import ACCELERATIONS, PAST, VARIABLES, parse_expression
from odomcorrupt.effects.wheels import wheel_motions

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from odomcorrupt.effects.expression import Expression
    from odomcorrupt.geometry.motion import Motion
    from odomcorrupt.geometry.se2 import Array

COEFFICIENTS = ("k", "m")
"""Names of the coefficients in an expression."""
REFINING = 2
"""Factor on the size of a family for each shape parameter that may be refined."""


def evaluated(text: str, motion: Motion, **coefficients: float) -> Array:
    """Return the values (n,) of an expression of this module on a motion of n intervals."""
    variables = {name: getattr(motion, "t_s" if name == "t" else name) for name in VARIABLES}
    before = {f"{name}{PAST}": variables[name] for name in ACCELERATIONS}
    return _parsed(text, tuple(coefficients)).added_to(("yaw",), variables | before | coefficients)


@lru_cache(maxsize=4096)  # refined shapes have texts of their own
def _parsed(text: str, coefficients: tuple[str, ...]) -> Expression:
    return parse_expression(f"yaw += {text}", coefficients)


@dataclass(frozen=True, slots=True)
class BasisFunction:
    """A function of one regressor.

    regressor : name of the regressor
    text : expression of an effect, with coefficients named as in `COEFFICIENTS`
    trials : size of the family that the function is selected from
    reaches : classes of targets, see `Action.reaches`, except those for which the library has the effect
    shape, steps : shape parameters that may be refined, and the first step of a search over each
    with_shape : returns the function with other shape parameters
    related : functions of other shapes to be tried if this one has a large gain
    within : returns the function that is zero far from the values (n,) of its regressor, each with an amount of motion
        (n,), on which it was fitted
    place : region in the plane of the truth, or headings, in words; "" if it is not confined
    """

    regressor: str
    text: str
    trials: int = 1
    reaches: tuple[str, ...] = ("body",)
    shape: tuple[float, ...] = ()
    steps: tuple[float, ...] = ()
    with_shape: Callable[[tuple[float, ...]], BasisFunction] | None = field(default=None, compare=False)
    related: tuple[BasisFunction, ...] = field(default=(), compare=False)
    within: Callable[[Array, Array], BasisFunction] | None = field(default=None, compare=False)
    place: str = field(default="", compare=False)

    @property
    def width(self) -> int:
        """Number of coefficients."""
        return 1 + (f"{COEFFICIENTS[1]} *" in self.text)

    def parts(self, motion: Motion) -> list[Array]:
        """Return the values (n,) of the function of each coefficient on a motion of n intervals."""
        own = COEFFICIENTS[: self.width]
        return [evaluated(self.text, motion, **{name: float(name == one) for name in own}) for one in own]


def _searched(make: Callable[[float], BasisFunction], at: float, step: float) -> BasisFunction:
    """Return a function made with one shape parameter, `at` this value, that may be refined with this first step."""
    return replace(make(at), shape=(at,), steps=(step,), with_shape=lambda moved: _searched(make, moved[0], step))


def basis_functions(motions: Sequence[Motion], *, placed: bool = True, sideways: bool = False) -> list[BasisFunction]:
    """Return every basis function to be tried on these motions.

    placed : whether the motions are in one frame, so that functions of heading and place are possible
    sideways : whether the robot drives sideways, so that functions of that speed are possible
    """
    return [
        *((wave_of_heading(1), wave_of_heading(2), *functions_of_place(motions)) if placed else ()),
        *functions_of_time(motions),
        *functions_of_motion(motions, sideways=sideways),
    ]


# Of the heading: waves, which can be confined to the headings that were driven.
_BINS = 72
"""Number of bins of the heading, 5 degrees each."""
_LEAST_SHARE = 0.005
"""Least fraction of the motion in a bin of headings that count as driven."""
_BRIDGED = 0.25
"""Largest gap between driven headings that a wave is interpolated over, as a fraction of its period."""


class _Arc(NamedTuple):
    """Headings whose difference from a middle, rad, has a larger cosine than `least`."""

    middle: float
    least: float

    @property
    def text(self) -> str:
        """Expression that is 1 at these headings and 0 at others."""
        return f"where(cos(theta {'-' if self.middle >= 0.0 else '+'} {abs(self.middle)}) > {self.least}, 1, 0)"

    @property
    def words(self) -> str:
        """The headings in words, in degrees."""
        middle, half = np.degrees((self.middle, np.arccos(self.least)))
        return f"{middle - half:.0f} to {middle + half:.0f}"


def wave_of_heading(times: int, arcs: Sequence[_Arc] = ()) -> BasisFunction:
    """Return a wave with a number of periods per turn, on arcs of headings if there are any, else on all headings."""
    inner = "theta" if times == 1 else f"{times} * theta"
    text, inside = f"k * cos({inner}) + m * sin({inner})", [arc.text for arc in arcs]
    if arcs:
        text = f"({text}) * {inside[0]}" if len(arcs) == 1 else f"({text}) * max({', '.join(inside)})"
    return BasisFunction(
        "heading",
        text,
        2,
        within=lambda theta, moved: wave_of_heading(times, _driven(theta, moved, _BRIDGED * 360.0 / times)),
        place=f"known from {' and '.join(arc.words for arc in arcs)} deg only" if arcs else "",
    )


def _driven(theta: Array, moved: Array, bridged_deg: float) -> list[_Arc]:
    """Return the arcs of headings that were driven, joined across small gaps; none if that is a full turn.

    theta, moved : (n,) headings, rad, and the amount of motion at each
    bridged_deg : largest gap between headings of one arc
    """
    width = 360.0 / _BINS
    bins = (np.degrees(theta) // width).astype(np.int64) % _BINS
    part = np.bincount(bins, moved, _BINS)
    driven = np.flatnonzero(part > _LEAST_SHARE * part.sum())
    following = np.append(driven[1:], driven[:1] + _BINS)
    last = np.flatnonzero((following - driven - 1) * width > bridged_deg)
    first = following[np.roll(last, 1)]
    half = 0.5 * np.radians(((driven[last] - first) % _BINS + 1) * width)
    middle = (np.radians(first * width) + half + np.pi) % (2.0 * np.pi) - np.pi
    return [_Arc(round(a, 3), round(b, 4)) for a, b in zip(middle.tolist(), np.cos(half).tolist(), strict=True)]


# Of the motion: proportional, step, hinge, saturation, in one direction only, or at rest only.
VALUES = {
    "speed": "abs(v)",
    "yaw_rate": "abs(omega)",
    "acceleration": "a * sign(v)",
    "lateral_acceleration": "abs(v * omega)",
    "yaw_acceleration": "alpha * sign(omega)",
    "time": "t",
    "distance": "distance",
    "sideways_speed": "abs(vy)",
}
_SIDEWAYS = "sideways_speed"
"""Regressor of robots that drive sideways; no other robot has it."""
_SPEEDS = ("speed", "yaw_rate", _SIDEWAYS)
"""Regressors with thresholds that lie between rest and the speeds that are usual."""
_SIGNED = ("acceleration", "yaw_acceleration", "time")
"""Regressors for which values below a threshold are as likely to have an error as values above."""
_OF_WHEELS = ("speed", "acceleration", "time")
"""Regressors with a separate value for each wheel; and time, because a load may change on one side."""
_OF_A_BIAS = ("speed", "yaw_rate", "time")
"""Regressors of a heading rate that also acts at rest, as a gyro bias does."""
_LEAST = {"acceleration": 0.1, "yaw_acceleration": 0.2}
"""Smallest thresholds, m/s^2 and rad/s^2: noise (of ticks) exceeds smaller ones."""
_LEAST_S, _LEAST_SLIP_S, _WITHIN = 2.0, 6.0, 0.9
"""Minimum time, s, beyond a threshold of a speed or in reverse; beyond one of an acceleration, because a few slips of
some tenths of a second would fill less; and the largest threshold of a speed, as a fraction of the speed exceeded for
the first of these: above a cruising speed is only odometry noise, which is also part of the error."""
_HINGED = ("speed", "yaw_rate", "acceleration", "lateral_acceleration", _SIDEWAYS)  # regressors with hinges
STILL = 0.02
"""Rates below which a robot is at rest, m/s and rad/s."""
_CUTS, _TAIL = np.linspace(0.05, 0.95, 19), 0.05 * 2.0 ** (-0.5 * np.arange(1.0, 9.0))
"""Quantiles at which thresholds are tried, and further ones as fractions of the data beyond: hard braking is rare."""


def functions_of_motion(motions: Sequence[Motion], *, sideways: bool = False) -> Iterator[BasisFunction]:
    """Yield every function of the motion to be tried on these motions; see `basis_functions`."""
    for regressor, text in VALUES.items():
        if regressor == _SIDEWAYS and not sideways:
            continue
        yield BasisFunction(regressor, f"k * {text}", reaches=_reaches(regressor, "one"))
        if regressor not in ("distance", "time"):  # nearly the same; steps over time are in `time`
            yield from thresholds(regressor, motions)
        if regressor in _HINGED:
            yield from _hinges(regressor, motions)
    yield from _either_signs(motions)
    yield from _saturations(motions)
    for regressor, text, reaches, trials in _singles(motions, sideways=sideways):
        yield BasisFunction(regressor, text, trials, reaches=reaches)


_Single: TypeAlias = "tuple[str, str, tuple[str, ...], int]"
"""Regressor, text, targets and size of the family of a function without shape."""


def _singles(motions: Sequence[Motion], *, sideways: bool) -> Iterator[_Single]:
    """Yield functions without a shape that is searched.

    Reverse is tested only if the robot drove in reverse: a wheel also runs backwards in turns on the spot.
    """
    ways = [("yaw_rate", "omega"), ("speed", "v")]
    # g-sensitive gyro
    yield "acceleration", "k * a", ("bias",), 1
    # gains of turns that change sign with the direction of travel, and of travel with that of turns, proportional to
    # the centripetal acceleration: an off-centre load, or a wheel that scrubs on one side
    yield "speed", "k * v", ("turning",), 1
    yield "yaw_rate", "k * omega", ("travel",), 1
    if sideways:
        ways.append((_SIDEWAYS, "vy"))
        yield _SIDEWAYS, "k * vy", ("turning",), 1
        yield "yaw_rate", "k * abs(omega)", ("sideways",), 1
        yield _SIDEWAYS, "k", ("sideways gain",), 1
    # in one direction only
    for regressor, name in ways:
        if name == "omega" or np.concatenate([evaluated(name, m) < -STILL for m in motions]).mean() > _least_part(
            motions
        ):
            yield regressor, f"k * where({name} < {-STILL:.4g}, 1, 0)", _reaches(regressor, "one", "both"), 1
    # of one wheel that scrubs in turns to one side
    yield "yaw_rate", "k * max(omega, 0)", ("one",), 2
    yield "yaw_rate", "k * max(-omega, 0)", ("one",), 2
    # only while the robot is at rest, does not drive, or does not turn
    for regressor, name in (("speed", "abs(v)"), ("yaw_rate", "abs(omega)"), ("speed", "max(abs(v), abs(omega))")):
        yield regressor, f"k * where({name} < {STILL:.4g}, 1, 0)", ("bias",), 1


def _reaches(regressor: str, *wheels: str) -> tuple[str, ...]:
    """Return the targets of functions of this regressor; `wheels` only if each wheel has a value of the regressor."""
    both = ("twist",) if regressor == "time" else ()
    return (
        "body",
        *both,
        *(wheels if regressor in _OF_WHEELS else ()),
        *(("bias",) if regressor in _OF_A_BIAS else ()),
        *(("sideways",) if regressor == _SIDEWAYS else ()),
    )


def thresholds(regressor: str, motions: Sequence[Motion]) -> Iterator[BasisFunction]:
    """Yield steps at thresholds of a regressor, at quantiles of its values while the robot moved."""
    ways = (True, False) if regressor in _SIGNED else (True,)
    within = (-_latest(regressor, motions, -1.0) if len(ways) > 1 else 0.0, _latest(regressor, motions))
    cuts = _cuts(regressor, motions)
    cuts = cuts[(cuts >= within[0]) & (cuts <= within[1])]
    for above, (i, cut) in product(ways, enumerate(cuts)):
        gap = float(np.max(np.diff(cuts[max(i - 1, 0) : i + 2]), initial=0.0))
        make = partial(_threshold, regressor, len(cuts) * len(ways), within, ">" if above else "<")
        yield _searched(make, float(cut), 0.5 * gap)


def _either_signs(motions: Sequence[Motion]) -> Iterator[BasisFunction]:
    """Yield steps of one wheel at thresholds of its acceleration's magnitude, as of a belt or a hub that slips.

    They are a family of their own, so that one-sided thresholds do not pay for them.
    """
    wheels = [wheel for m in motions if m.track_m is not None for wheel in wheel_motions(m, m.track_m)]
    if not wheels:
        return
    seen = np.concatenate([np.abs(m.a[np.abs(m.v) > STILL]) for m in wheels])
    levels = np.concatenate((_CUTS, 1.0 - _TAIL[_least_part(motions, _LEAST_SLIP_S) < _TAIL]))
    cuts = np.quantile(seen, np.sort(levels)) if len(seen) else np.zeros(0)
    cuts = np.unique(np.maximum(cuts, _LEAST["acceleration"]))
    for i, cut in enumerate(cuts):
        gap = float(np.max(np.diff(cuts[max(i - 1, 0) : i + 2]), initial=0.0))
        yield _searched(partial(_either_sign, len(cuts)), float(cut), 0.5 * gap)


def _either_sign(trials: int, at: float) -> BasisFunction:
    cut = max(at, _LEAST["acceleration"])
    text = f"k * where(abs(a) > {cut:.4g}, 1, 0)"
    return BasisFunction("acceleration", text, trials * REFINING, ("one",))


def _cuts(regressor: str, motions: Sequence[Motion]) -> Array:
    """Return quantiles of a regressor while the robot moved; for a speed also the limit of rest."""
    text = VALUES[regressor]
    of_speed = regressor in _SPEEDS
    values = [evaluated(text, m) for m in motions]
    rates = [(np.abs(m.v), np.abs(m.omega), of_speed * own) for m, own in zip(motions, values, strict=True)]
    seen = np.concatenate([own[np.max(rate, axis=0) > STILL] for own, rate in zip(values, rates, strict=True)])
    least_s = _LEAST_S if of_speed else _LEAST_SLIP_S
    rare = _TAIL[_least_part(motions, least_s) < _TAIL] if regressor != "time" else _TAIL[:0]
    levels = np.concatenate((rare if regressor in _SIGNED else rare[:0], _CUTS, 1.0 - rare))
    cuts = np.quantile(seen, np.sort(levels)) if len(seen) else np.zeros(0)
    return np.unique(np.append(cuts, STILL) if of_speed else cuts)


def _threshold(
    regressor: str, trials: int, within: tuple[float, float], side: Literal["<", ">"], at: float
) -> BasisFunction:
    least = _LEAST.get(regressor, 0.0)
    cut = float(np.clip(at, *within))
    cut = cut if abs(cut) >= least else float(np.copysign(least, at))
    text = f"k * where({VALUES[regressor]} {side} {cut:.4g}, 1, 0)"
    return BasisFunction(regressor, text, trials * REFINING, _reaches(regressor, "one", "both"))


def _hinges(regressor: str, motions: Sequence[Motion]) -> Iterator[BasisFunction]:
    """Yield functions that grow linearly from a threshold, as of lost grip; for signed regressors on both sides."""
    cuts = [cut for cut in _cuts(regressor, motions)[1::3] if cut > 0.0]
    two_sided = regressor in _SIGNED
    signs = (1.0, -1.0) if two_sided else (1.0,)
    most = {sign: _latest(regressor, motions, sign) for sign in signs}
    shapes = [(sign, float(cut)) for sign in signs for cut in (0.0, *cuts) if cut <= most[sign]]
    for sign, cut in shapes:
        if cut > 0.0 or two_sided:
            step = 0.15 * max(cuts, default=1.0)
            yield _searched(partial(_hinge, regressor, len(shapes), sign, most[sign]), cut, step)


def _latest(regressor: str, motions: Sequence[Motion], sign: float = 1.0) -> float:
    """Return the largest threshold of a speed above which enough data and range are left.

    Infinity for other regressors: an acceleration, for example, is near zero most of the time.
    """
    if regressor not in _SPEEDS:
        return float("inf")
    seen = np.concatenate([sign * evaluated(VALUES[regressor], m) for m in motions])
    return _WITHIN * max(float(np.quantile(seen, 1.0 - _least_part(motions))), 0.0) if len(seen) else 0.0


def _least_part(motions: Sequence[Motion], least_s: float = _LEAST_S) -> float:
    """Return a time, s, as a fraction of the recorded time, at most one."""
    return min(least_s / max(sum(float(m.dt_s.sum()) for m in motions), 1e-9), 1.0)


def _hinge(regressor: str, trials: int, sign: float, most: float, at: float) -> BasisFunction:
    cut = min(max(at, 0.0), most)
    text = f"k * max({'' if sign > 0.0 else '-'}{VALUES[regressor]} - {cut:.4g}, 0)"
    return BasisFunction(regressor, text, trials * REFINING, _reaches(regressor, "one", "both"))


def _saturations(motions: Sequence[Motion]) -> Iterator[BasisFunction]:
    """Yield saturations of a gyro: the part of the yaw rate above its measuring range."""
    most = _latest("yaw_rate", motions)
    cuts = [float(cut) for cut in _cuts("yaw_rate", motions)[1::3] if 0.0 < cut <= most]
    for cut in cuts:
        yield _searched(partial(_saturation, len(cuts), most), cut, 0.15 * max(cuts))


def _saturation(trials: int, most: float, at: float) -> BasisFunction:
    cut = min(max(at, 0.0), most)
    text = f"k * sign(omega) * max(abs(omega) - {cut:.4g}, 0)"
    return BasisFunction("yaw_rate", text, trials * REFINING, reaches=("bias",))


# Of the place: discs, rectangles and strips of floor, and iron that deflects a compass.
_PLACES = 7  # grid lines along each axis
_RADII_M = (0.8, 1.3, 2.0)  # radii of discs, m
_OUTER = (0.03, 0.97)
"""Quantiles of the path's coordinates between which places are tried."""
_STRIPS = 12  # directions of strips over half a turn
_STRIP_APART_M, _MOST_STRIPS = 0.8, 25  # spacing of parallel strips, m, and their largest number
_THIN = 10
"""One of this many poses is used to find where strips contain the path."""
_HALF_WIDTHS_M = (0.4, 0.8)  # of strips, m
_BOX_ANGLES = (0.0, np.pi / 6.0, np.pi / 3.0)  # of rectangles, rad


def functions_of_place(motions: Sequence[Motion]) -> Iterator[BasisFunction]:
    """Yield every function of the place to be tried on these motions."""
    xs, ys = (spread(np.concatenate([getattr(m, axis) for m in motions]), _OUTER, _PLACES) for axis in ("x", "y"))
    for x, y, radius in product(xs, ys, _RADII_M):
        yield _disc((float(x), float(y), radius))
        yield _iron((float(x), float(y), 0.5 * radius))
    yield from _strips(motions)


def _disc(shape: tuple[float, ...]) -> BasisFunction:
    x, y, radius = shape[0], shape[1], max(shape[2], 0.1)
    return BasisFunction(
        "position",
        f"k * where(hypot(x {_less(x)}, y {_less(y)}) < {radius:.4g}, 1, 0)",
        2 * _PLACES**2 * len(_RADII_M) * REFINING**3,
        reaches=("floor", "ground", "bias"),
        shape=shape,
        steps=(0.4, 0.4, 0.3),
        with_shape=_disc,
        place=f"within {radius:.2g} m of ({x:.1f}, {y:.1f})",
        related=tuple(_box((angle, x, y, radius, radius)) for angle in _BOX_ANGLES),
    )


def _iron(shape: tuple[float, ...]) -> BasisFunction:
    """Return the yaw error per travel of a compass near iron, with a deflection that is bell-shaped in the distance."""
    x, y, reach = shape[0], shape[1], max(shape[2], 0.1)
    right, up = f"(x {_less(x)})", f"(y {_less(y)})"
    bell = f"exp(-({right}**2 + {up}**2) / {2.0 * reach**2:.4g})"
    return BasisFunction(
        "position",
        f"k * -({right} * cos(theta) + {up} * sin(theta)) * {bell}",
        2 * _PLACES**2 * len(_RADII_M) * REFINING**3,
        reaches=("heading",),
        shape=(x, y, reach),
        steps=(0.4, 0.4, 0.2),
        with_shape=_iron,
    )


def _strips(motions: Sequence[Motion]) -> Iterator[BasisFunction]:
    """Yield strips across the visited area; each is turned, in a search, about the mean of the path inside it."""
    x, y = (np.concatenate([getattr(m, axis)[::_THIN] for m in motions]) for axis in ("x", "y"))
    for angle in np.pi * np.arange(_STRIPS) / _STRIPS:
        c, s = _axis(float(angle))
        place = c * x + s * y
        low, high = np.quantile(place, _OUTER)
        middles = np.linspace(low, high, int(np.clip((high - low) / _STRIP_APART_M, _PLACES, _MOST_STRIPS)))
        for middle, half in product(middles, _HALF_WIDTHS_M):
            inside = np.abs(place - middle) < half
            if inside.any():
                way = float(np.mean(c * y[inside] - s * x[inside]))
                yield _strip((float(angle), float(c * middle - s * way), float(s * middle + c * way), half))


def _strip(shape: tuple[float, ...]) -> BasisFunction:
    """Return a strip from the angle of its normal, a point on its centre line, and half its width."""
    angle, x, y, half = *shape[:3], max(shape[3], 0.05)
    axis = _axis(angle)
    return BasisFunction(
        "position",
        f"k * where(abs({_ahead(axis, x, y)}) < {half:.4g}, 1, 0)",
        2 * _STRIPS * _MOST_STRIPS * len(_HALF_WIDTHS_M) * REFINING**3,
        reaches=("floor", "both", "ground"),
        shape=(angle, x, y, half),
        steps=(0.2, 0.4, 0.4, 0.2),
        with_shape=_strip,
        place=f"in a strip {2.0 * half:.2g} m wide through ({x:.1f}, {y:.1f})",
    )


def _box(shape: tuple[float, ...]) -> BasisFunction:
    """Return a rectangle from the angle of its first axis, its centre, and half the length of each side."""
    angle, x, y = shape[0], shape[1], shape[2]
    half, side = max(shape[3], 0.1), max(shape[4], 0.1)
    c, s = along = _axis(angle)
    across = (-s, c)
    return BasisFunction(
        "position",
        f"k * where(abs({_ahead(along, x, y)}) < {half:.4g}, 1, 0)"
        f" * where(abs({_ahead(across, x, y)}) < {side:.4g}, 1, 0)",
        2 * _PLACES**2 * len(_RADII_M) * len(_BOX_ANGLES) * REFINING**5,
        reaches=("floor", "both", "ground", "bias"),
        shape=(angle, x, y, half, side),
        steps=(0.2, 0.4, 0.4, 0.4, 0.4),
        with_shape=_box,
        place=f"in a rectangle of {2.0 * half:.2g} by {2.0 * side:.2g} m around ({x:.1f}, {y:.1f})",
    )


def rectangle_of(function: BasisFunction) -> tuple[float, float, float, float, float] | None:
    """Return angle of the first axis, centre and half sides of a strip or rectangle, rad and m; None for others.

    The second side of a strip is infinite.
    """
    if function.with_shape not in (_strip, _box):
        return None
    angle, x, y, half, *side = function.shape
    return angle, x, y, half, side[0] if side else np.inf


def _axis(angle: float) -> tuple[float, float]:
    """Return the unit vector at an angle, rounded so that expressions contain no floating-point residue."""
    c, s = np.round((np.cos(angle), np.sin(angle)), 6) + 0.0
    return float(c), float(s)


def _ahead(axis: tuple[float, float], x: float, y: float) -> str:
    """Return the expression of the coordinate along an axis, relative to a place."""
    (c, s), sign = axis, "-" if axis[1] < 0.0 else "+"
    return f"{c:.4g} * (x {_less(x)}) {sign} {abs(s):.4g} * (y {_less(y)})"


def _less(metres: float) -> str:
    """Return the text that subtracts a length, to a millimetre: some maps have coordinates of 500 km."""
    return f"{'-' if metres >= 0.0 else '+'} {round(abs(metres), 3):.10g}"


def spread(values: Array, outer: tuple[float, float], count: int) -> Array:
    """Return places (count,) along an axis between two quantiles of the values."""
    low, high = np.quantile(values, outer)
    return np.linspace(float(low), float(high), count)


# Of time: exponential settling; of one drive also steps, and spells between two moments.
_SETTLE_S = (30.0, 80.0, 200.0)  # settling times on the grid, s
_QUICKEST_S, _SLOWEST_S = 10.0, 1e4
"""Least and largest settling time that is tried, s; faster settling leaves nothing to observe."""
_SPELLS, _SPELL_PARTS = 10, (0.08, 0.16)
"""Number of centres of a spell that are tried, and half its length as fractions of the whole time."""
_ANYWHERE = ("body", "one", "both", "twist")  # targets of functions of time


def functions_of_time(motions: Sequence[Motion]) -> Iterator[BasisFunction]:
    """Yield every function of time to be tried on these motions.

    Exponential decays and rises are those of tyres, motors and sensors that warm up; errors from or between two
    moments, of a load that was carried for a while, have no time in common in several drives.
    """
    for tau_s, rising in product(_SETTLE_S, (False, True)):
        yield _searched(partial(_settling, rising), float(np.log(tau_s)), 0.5)
    ends_s = sorted((float(m.t_s[0]), float(m.t_s[-1])) for m in motions)
    if any(after[0] < before[1] for before, after in pairwise(ends_s)):
        return
    yield from thresholds("time", motions)
    longest_s = max(float(np.ptp(m.t_s)) for m in motions)
    for part, i in product(_SPELL_PARTS, range(_SPELLS)):
        yield _spell((ends_s[0][0] + (i + 0.5) / _SPELLS * longest_s, part * longest_s), 0.25 * longest_s / _SPELLS)


def _settling(rising: bool, log_tau: float) -> BasisFunction:  # noqa: FBT001 - of a partial
    tau_s = float(np.clip(np.exp(min(log_tau, 50.0)), _QUICKEST_S, _SLOWEST_S))
    return BasisFunction(
        "time",
        f"k * (1 - exp(-t / {tau_s:.4g}))" if rising else f"k * exp(-t / {tau_s:.4g})",
        2 * len(_SETTLE_S) * REFINING,
        reaches=(*_ANYWHERE, "bias"),
    )


def _spell(shape: tuple[float, ...], step_s: float) -> BasisFunction:
    middle_s, half_s = shape[0], max(shape[1], 1.0)
    return BasisFunction(
        "time",
        f"k * where(abs(t - {middle_s:.6g}) < {half_s:.6g}, 1, 0)",
        len(_SPELL_PARTS) * _SPELLS * REFINING**2,
        reaches=(*_ANYWHERE, "bias"),
        shape=(middle_s, half_s),
        steps=(2.0 * step_s, step_s),
        with_shape=lambda moved: _spell(moved, step_s),
    )


_GRID = 4  # grid lines of the floor along each axis
_FINEST = 0.05
"""Least distance of hats, as a fraction of the regressor's range: noise of the odometry enters regressor and error."""


def curve_regressors(
    motions: Sequence[Motion], *, placed: bool = True, sideways: bool = False
) -> dict[str, Callable[[Motion], tuple[Array, Array]]]:
    """Return for each regressor a function from a motion to the hats (n, m) and their centres.

    placed : whether the motions are in one frame, so that heading and position are regressors
    sideways : whether the robot drives sideways, so that this speed is a regressor
    """
    of: dict[str, tuple[int, Callable[[Motion], Array]]] = {  # number of hats, and the values
        "speed": (6, lambda m: m.v),
        "yaw_rate": (6, lambda m: m.omega),
        "acceleration": (6, lambda m: m.a),
        "lateral_acceleration": (6, lambda m: np.abs(m.v * m.omega)),
        "yaw_acceleration": (6, lambda m: m.alpha),
        "time": (8, lambda m: m.t_s),
        "distance": (8, lambda m: m.distance),
    }
    if sideways:
        of["sideways_speed"] = (6, lambda m: m.vy)
    regressors: dict[str, Callable[[Motion], tuple[Array, Array]]] = {}
    for name, (hats, value) in of.items():
        moving = np.concatenate([value(m)[m.speed > 0.02] for m in motions])
        if len(moving) < 100:
            continue
        knots = _apart(np.quantile(moving, np.linspace(0.02, 0.98, hats)))
        if len(knots) > 2:
            regressors[name] = lambda m, v=value, k=knots: (_linear_hats(v(m), k), k)  # type: ignore[misc]
    if not placed:
        return regressors
    regressors["heading"] = _harmonics
    xs, ys = (spread(np.concatenate([getattr(m, k) for m in motions]), (0.02, 0.98), _GRID) for k in "xy")
    regressors["position"] = _tiles(xs, ys)
    return regressors


def _apart(knots: Array) -> Array:
    """Return ascending knots without those too close to the previous one."""
    least, kept = _FINEST * (knots[-1] - knots[0]), [knots[0]]
    for knot in knots[1:]:
        if knot - kept[-1] > least:
            kept.append(knot)
    return np.array(kept)


def _linear_hats(values: Array, knots: Array) -> Array:
    """Return piecewise linear hats (n, m) with sum one, constant beyond the outer knots."""
    clipped = np.clip(values, knots[0], knots[-1])
    return np.stack([np.interp(clipped, knots, unit) for unit in np.eye(len(knots))]).T


def _harmonics(motion: Motion) -> tuple[Array, Array]:
    """Return cosines and sines of the heading and of twice the heading (n, 4), and their indices."""
    angles = np.stack([np.cos(motion.theta), np.sin(motion.theta), np.cos(2 * motion.theta), np.sin(2 * motion.theta)])
    return angles.T, np.arange(4.0)


def _tiles(xs: Array, ys: Array) -> Callable[[Motion], tuple[Array, Array]]:
    places = np.array([(x, y) for x in xs for y in ys])

    def shape(motion: Motion) -> tuple[Array, Array]:
        across, up = _linear_hats(motion.x, xs), _linear_hats(motion.y, ys)
        return (across[:, :, None] * up[:, None, :]).reshape(len(motion), -1), places

    return shape
