"""What single wheels do: rim speeds of the two sides, and back."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from odomcorrupt.effects.effect import stacked
from odomcorrupt.errors import EffectError

if TYPE_CHECKING:
    from odomcorrupt.pose import Array

__all__ = ["Rims", "body_of", "needed_track_m", "rims_of"]


class Rims(NamedTuple):
    """Something per wheel, (n,) each: speeds in m/s or travel in m."""

    right: Array
    left: Array


def needed_track_m(name: str, track_m: float | None) -> float:
    """Return the track; EffectError where it is not known."""
    if track_m is None:
        raise EffectError(
            f"effect {name}: acts on single wheels and the track is not known; give it in metres with --track, or as "
            "[robot] track = 0.4 in a model file"
        )
    return track_m


def rims_of(along: Array, yaw: Array, track_m: float) -> Rims:
    """Return what the two wheels do where the body moves along and turns, speeds or travel."""
    half = 0.5 * track_m * yaw
    return Rims(along + half, along - half)


def body_of(rims: Rims, track_m: float) -> Array:
    """Return what the body does, (n, 3), where the wheels do this."""
    return stacked(0.5 * (rims.right + rims.left), 0.0, (rims.right - rims.left) / track_m, rims.right)
