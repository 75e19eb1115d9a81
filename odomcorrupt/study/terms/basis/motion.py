"""Basis functions of the motion: proportional, step, hinge, saturation, in one direction only, or at rest only."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from odomcorrupt.effects.wheels import wheel_motions
from odomcorrupt.study.terms.basis.basis_function import REFINING, BasisFunction

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from odomcorrupt.effects.effect import Motion
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.terms.basis.basis_function import Of

VALUES: dict[str, tuple[str, Of]] = {
    "speed": ("abs(v)", lambda m: np.abs(m.v)),
    "yaw_rate": ("abs(omega)", lambda m: np.abs(m.omega)),
    "acceleration": ("a * sign(v)", lambda m: m.a * np.sign(m.v)),
    "lateral_acceleration": ("abs(v * omega)", lambda m: np.abs(m.v * m.omega)),
    "yaw_acceleration": ("alpha * sign(omega)", lambda m: m.alpha * np.sign(m.omega)),
    "time": ("t", lambda m: m.t_s),
    "distance": ("distance", lambda m: m.distance),
    "sideways_speed": ("abs(vy)", lambda m: np.abs(m.vy)),
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
_STILL = 0.02
"""Rates below which a robot is at rest, m/s and rad/s."""
_CUTS, _TAIL = np.linspace(0.05, 0.95, 19), 0.05 * 2.0 ** (-0.5 * np.arange(1.0, 9.0))
"""Quantiles at which thresholds are tried, and further ones as fractions of the data beyond: hard braking is rare."""


def functions_of_motion(motions: Sequence[Motion], *, sideways: bool = False) -> Iterator[BasisFunction]:
    """Yield every function of the motion to be tried on these motions; see `basis_functions`."""
    for regressor, (text, value) in VALUES.items():
        if regressor == _SIDEWAYS and not sideways:
            continue
        yield BasisFunction(regressor, f"k * {text}", (value,), reaches=_reaches(regressor, "one"))
        if regressor not in ("distance", "time"):  # nearly the same; steps over time are in `time`
            yield from thresholds(regressor, motions)
        if regressor in _HINGED:
            yield from _hinges(regressor, motions)
    yield from _either_signs(motions)
    yield from _saturations(motions)
    for regressor, text, value, reaches, trials in _singles(motions, sideways=sideways):
        yield BasisFunction(regressor, text, (value,), trials, reaches=reaches)


_Single: TypeAlias = "tuple[str, str, Of, tuple[str, ...], int]"
"""Regressor, text, function, targets and size of the family of a function without shape."""


def _singles(motions: Sequence[Motion], *, sideways: bool) -> Iterator[_Single]:
    """Yield functions without a shape that is searched.

    Reverse is tested only if the robot drove in reverse: a wheel also runs backwards in turns on the spot.
    """
    speed, yaw_rate = VALUES["speed"], VALUES["yaw_rate"]
    either = ("max(abs(v), abs(omega))", lambda m: np.maximum(np.abs(m.v), np.abs(m.omega)))
    ways: list[tuple[str, str, Of]] = [("yaw_rate", "omega", lambda m: m.omega), ("speed", "v", lambda m: m.v)]
    # g-sensitive gyro
    yield "acceleration", "k * a", lambda m: m.a, ("bias",), 1
    # gains of turns that change sign with the direction of travel, and of travel with that of turns, proportional to
    # the centripetal acceleration: an off-centre load, or a wheel that scrubs on one side
    yield "speed", "k * v", lambda m: m.v, ("turning",), 1
    yield "yaw_rate", "k * omega", lambda m: m.omega, ("travel",), 1
    if sideways:
        ways.append((_SIDEWAYS, "vy", lambda m: m.vy))
        yield _SIDEWAYS, "k * vy", lambda m: m.vy, ("turning",), 1
        yield "yaw_rate", "k * abs(omega)", lambda m: np.abs(m.omega), ("sideways",), 1
        yield _SIDEWAYS, "k", lambda m: np.ones(len(m)), ("sideways gain",), 1
    # in one direction only
    for regressor, name, value in ways:
        if name == "omega" or np.concatenate([value(m) < -_STILL for m in motions]).mean() > _least_part(motions):
            text = f"k * where({name} < {-_STILL:.4g}, 1, 0)"
            yield regressor, text, _below(value, -_STILL), _reaches(regressor, "one", "both"), 1
    # of one wheel that scrubs in turns to one side
    yield "yaw_rate", "k * max(omega, 0)", lambda m: np.maximum(m.omega, 0.0), ("one",), 2
    yield "yaw_rate", "k * max(-omega, 0)", lambda m: np.maximum(-m.omega, 0.0), ("one",), 2
    # only while the robot is at rest, does not drive, or does not turn
    for regressor, (name, value) in (("speed", speed), ("yaw_rate", yaw_rate), ("speed", either)):
        yield regressor, f"k * where({name} < {_STILL:.4g}, 1, 0)", _below(value, _STILL), ("bias",), 1


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
        yield _threshold(regressor, len(cuts) * len(ways), (float(cut),), (0.5 * gap,), above=above, within=within)


def _either_signs(motions: Sequence[Motion]) -> Iterator[BasisFunction]:
    """Yield steps of one wheel at thresholds of its acceleration's magnitude, as of a belt or a hub that slips.

    They are a family of their own, so that one-sided thresholds do not pay for them.
    """
    wheels = [wheel for m in motions if m.track_m is not None for wheel in wheel_motions(m, m.track_m)]
    if not wheels:
        return
    seen = np.concatenate([np.abs(m.a[np.abs(m.v) > _STILL]) for m in wheels])
    levels = np.concatenate((_CUTS, 1.0 - _TAIL[_least_part(motions, _LEAST_SLIP_S) < _TAIL]))
    cuts = np.quantile(seen, np.sort(levels)) if len(seen) else np.zeros(0)
    cuts = np.unique(np.maximum(cuts, _LEAST["acceleration"]))
    for i, cut in enumerate(cuts):
        gap = float(np.max(np.diff(cuts[max(i - 1, 0) : i + 2]), initial=0.0))
        yield _either_sign(len(cuts), (float(cut),), (0.5 * gap,))


def _either_sign(trials: int, shape: tuple[float, ...], steps: tuple[float, ...]) -> BasisFunction:
    cut = max(shape[0], _LEAST["acceleration"])
    return BasisFunction(
        "acceleration",
        f"k * where(abs(a) > {cut:.4g}, 1, 0)",
        (_above(lambda m: np.abs(m.a), cut),),
        trials * REFINING,
        form="step",
        reaches=("one",),
        shape=shape,
        steps=steps,
        with_shape=lambda moved: _either_sign(trials, moved, steps),
    )


def _cuts(regressor: str, motions: Sequence[Motion]) -> Array:
    """Return quantiles of a regressor while the robot moved; for a speed also the limit of rest."""
    value = VALUES[regressor][1]
    of_speed = regressor in _SPEEDS
    moves = [(np.abs(m.v) > _STILL) | (np.abs(m.omega) > _STILL) | (of_speed & (value(m) > _STILL)) for m in motions]
    seen = np.concatenate([value(m)[moving] for m, moving in zip(motions, moves, strict=True)])
    least_s = _LEAST_S if of_speed else _LEAST_SLIP_S
    rare = _TAIL[_least_part(motions, least_s) < _TAIL] if regressor != "time" else _TAIL[:0]
    levels = np.concatenate((rare if regressor in _SIGNED else rare[:0], _CUTS, 1.0 - rare))
    cuts = np.quantile(seen, np.sort(levels)) if len(seen) else np.zeros(0)
    return np.unique(np.append(cuts, _STILL) if of_speed else cuts)


def _threshold(
    regressor: str,
    trials: int,
    shape: tuple[float, ...],
    steps: tuple[float, ...],
    *,
    above: bool,
    within: tuple[float, float],
) -> BasisFunction:
    text, value = VALUES[regressor]
    least = _LEAST.get(regressor, 0.0)
    cut = float(np.clip(shape[0], *within))
    cut = cut if abs(cut) >= least else float(np.copysign(least, shape[0]))
    return BasisFunction(
        regressor,
        f"k * where({text} {'>' if above else '<'} {cut:.4g}, 1, 0)",
        ((_above if above else _below)(value, cut),),
        trials * REFINING,
        form="step",
        reaches=_reaches(regressor, "one", "both"),
        shape=shape,
        steps=steps,
        with_shape=lambda moved: _threshold(regressor, trials, moved, steps, above=above, within=within),
    )


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
            yield _hinge(regressor, len(shapes), (cut,), (step,), sign=sign, most=most[sign])


def _latest(regressor: str, motions: Sequence[Motion], sign: float = 1.0) -> float:
    """Return the largest threshold of a speed above which enough data and range are left.

    Infinity for other regressors: an acceleration, for example, is near zero most of the time.
    """
    if regressor not in _SPEEDS:
        return float("inf")
    seen = np.concatenate([sign * VALUES[regressor][1](m) for m in motions])
    return _WITHIN * max(float(np.quantile(seen, 1.0 - _least_part(motions))), 0.0) if len(seen) else 0.0


def _least_part(motions: Sequence[Motion], least_s: float = _LEAST_S) -> float:
    """Return a time, s, as a fraction of the recorded time, at most one."""
    return min(least_s / max(sum(float(m.dt_s.sum()) for m in motions), 1e-9), 1.0)


def _hinge(
    regressor: str, trials: int, shape: tuple[float, ...], steps: tuple[float, ...], *, sign: float, most: float
) -> BasisFunction:
    text, value = VALUES[regressor]
    cut = min(max(shape[0], 0.0), most)
    return BasisFunction(
        regressor,
        f"k * max({text if sign > 0.0 else f'-{text}'} - {cut:.4g}, 0)",
        (lambda m: np.maximum(sign * value(m) - cut, 0.0),),
        trials * REFINING,
        form="hinge",
        reaches=_reaches(regressor, "one", "both"),
        shape=shape,
        steps=steps,
        with_shape=lambda moved: _hinge(regressor, trials, moved, steps, sign=sign, most=most),
    )


def _saturations(motions: Sequence[Motion]) -> Iterator[BasisFunction]:
    """Yield saturations of a gyro: the part of the yaw rate above its measuring range."""
    most = _latest("yaw_rate", motions)
    cuts = [float(cut) for cut in _cuts("yaw_rate", motions)[1::3] if 0.0 < cut <= most]
    for cut in cuts:
        yield _saturation(len(cuts), (cut,), (0.15 * max(cuts),), most)


def _saturation(trials: int, shape: tuple[float, ...], steps: tuple[float, ...], most: float) -> BasisFunction:
    cut = min(max(shape[0], 0.0), most)
    return BasisFunction(
        "yaw_rate",
        f"k * sign(omega) * max(abs(omega) - {cut:.4g}, 0)",
        (lambda m: np.sign(m.omega) * np.maximum(np.abs(m.omega) - cut, 0.0),),
        trials * REFINING,
        reaches=("bias",),
        shape=shape,
        steps=steps,
        with_shape=lambda moved: _saturation(trials, moved, steps, most),
    )


def _above(value: Of, cut: float) -> Of:
    return lambda m: (value(m) > cut).astype(np.float64)


def _below(value: Of, cut: float) -> Of:
    return lambda m: (value(m) < cut).astype(np.float64)
