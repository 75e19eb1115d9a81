"""Excitation of drives: the kinds of motion they contain, and those they lack."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.geometry.motion import slopes

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from odomcorrupt.effects.effect import Motion

__all__ = ["EXCITATIONS", "Excitation", "MissingExcitation", "excitation", "missing_excitations"]

_MOVING_MPS = 0.05
_TURNING_RADPS = 0.1
_SECTORS = 8


@dataclass(frozen=True, slots=True)
class Excitation:
    """Kinds of motion in all drives together.

    forward_m, reverse_m : distance travelled
    left_rad, right_rad, spot_rad : angle turned to either side, and on the spot
    standing_s, minutes : time at rest, and total time
    speeds, turning_speeds : 10 % and 90 % quantiles of the speed, m/s, by distance, and by angle while turning
    hard_s : time at more than 0.25 m/s^2
    headings : number of eight sectors with more than a fiftieth of the distance
    """

    forward_m: float
    reverse_m: float
    left_rad: float
    right_rad: float
    spot_rad: float
    standing_s: float
    minutes: float
    speeds: tuple[float, float]
    turning_speeds: tuple[float, float]
    hard_s: float
    headings: int


@dataclass(frozen=True, slots=True)
class MissingExcitation:
    """An excitation that a drive may lack.

    why : returns a description if it is missing, else ""
    primitives : names of the manoeuvres with this excitation and as little else as possible
    """

    why: Callable[[Excitation], str]
    primitives: tuple[str, ...]


def excitation(motions: Sequence[Motion]) -> Excitation:
    """Return the excitation of all drives together."""
    dt = np.concatenate([m.dt_s for m in motions])
    v = np.concatenate([m.v for m in motions])
    speed = np.concatenate([np.hypot(m.v, m.vy) for m in motions])
    omega = np.concatenate([m.omega for m in motions])
    theta = np.concatenate([m.theta for m in motions])
    # Average over 0.5 s, because the ripple of a motor is no acceleration of the body.
    hard = np.concatenate([np.abs(slopes(m.t_s, m.v[:, None], m.t_s, 0.5)[:, 0]) for m in motions])
    way, turn = speed * dt, omega * dt
    turning = np.abs(omega) > _TURNING_RADPS
    sector = np.floor((theta % (2.0 * pi)) / (2.0 * pi / _SECTORS)).astype(int) % _SECTORS
    share = np.bincount(sector, way, _SECTORS) / max(float(way.sum()), 1e-9)
    return Excitation(
        forward_m=float(way[v > _MOVING_MPS].sum()),
        reverse_m=float(way[v < -_MOVING_MPS].sum()),
        left_rad=float(turn[omega > _TURNING_RADPS].sum()),
        right_rad=-float(turn[omega < -_TURNING_RADPS].sum()),
        spot_rad=float(np.abs(turn)[turning & (speed < _MOVING_MPS)].sum()),
        standing_s=float(dt[(speed < 0.01) & (np.abs(omega) < 0.01)].sum()),
        minutes=float(dt.sum()) / 60.0,
        speeds=_middle(speed, way * (speed > _MOVING_MPS)),
        turning_speeds=_middle(speed, np.abs(turn) * turning),
        hard_s=float(dt[hard > 0.25].sum()),
        headings=int((share > 0.02).sum()),
    )


def _middle(values: np.ndarray, weight: np.ndarray) -> tuple[float, float]:
    """Return the weighted 10 % and 90 % quantiles; zeros if the total weight is zero."""
    total = float(weight.sum())
    if total <= 0.0:
        return 0.0, 0.0
    order = np.argsort(values)
    part = np.cumsum(weight[order]) / total
    low, high = np.interp((0.1, 0.9), part, values[order])
    return float(low), float(high)


def _speed(e: Excitation) -> str:
    low, high = e.speeds
    return f"always near {high:.2g} m/s" if 0.0 < high < 1.3 * low else ""


def _turning_speed(e: Excitation) -> str:
    low, high = e.turning_speeds
    return f"every turn was taken near {high:.2g} m/s" if 0.0 < high < 1.3 * low else ""


def _turned(e: Excitation) -> str:
    least = 0.03 * max(e.left_rad, e.right_rad, 10.0)
    left, right = e.left_rad < least, e.right_rad < least
    return "never turned" if left and right else "never turned left" if left else "never turned right" if right else ""


def _moved(e: Excitation) -> str:
    return "hardly drove" if e.forward_m + e.reverse_m < 5.0 else ""


EXCITATIONS: tuple[MissingExcitation, ...] = (
    MissingExcitation(_moved, ("squares",)),
    MissingExcitation(
        lambda e: "never reversed" if e.reverse_m < 0.01 * e.forward_m + 0.1 else "", ("there_and_back",)
    ),
    MissingExcitation(_turned, ("spins", "eights")),
    MissingExcitation(lambda e: "hardly at rest" if e.standing_s < 10.0 else "", ("stands",)),
    MissingExcitation(_speed, ("two_speeds", "eights_at_two_speeds")),
    MissingExcitation(_turning_speed, ("turns_apart", "eights_at_two_speeds")),
    MissingExcitation(lambda e: "never turned on the spot" if e.spot_rad < 1.0 else "", ("spins",)),
    MissingExcitation(lambda e: "hardly sped up or braked" if e.hard_s < 5.0 else "", ("hard",)),
    MissingExcitation(lambda e: "hardly more than one heading" if e.headings <= 2 else "", ("star",)),
)
"""In the order of evaluation: the more informative first."""


def missing_excitations(drive: Excitation) -> list[tuple[str, tuple[str, ...]]]:
    """Return descriptions of the motions that a drive lacks, with the manoeuvres that contain them."""
    return [(why, lack.primitives) for lack in EXCITATIONS if (why := lack.why(drive))]
