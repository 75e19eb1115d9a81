"""A wheel is flat on one side, or does not turn about its middle: once a turn it gains less."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np

from odomcorrupt.effects.effect import (
    About,
    Effect,
    Motion,
    Recorded,
    State,
    TwistError,
    choice,
    parameter,
)
from odomcorrupt.effects.wheels import Rims, body_of, needed_track_m, rims_of, track_parameter

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.random import Generator

    from odomcorrupt.geometry.se2 import Array

_ROUNDS, _SOLVED_M = 100, 1e-15
_NARROW = 4.0
"""Concentration of the spot about its middle: half of it lies within a seventh of a turn (von Mises' form)."""
_MEAN = float(np.i0(_NARROW) * np.exp(-_NARROW))
"""The form's mean over a turn."""


class _Turned(NamedTuple):
    """How far the rims have turned, metres as they report it."""

    right: float = 0.0
    left: float = 0.0


@dataclass(frozen=True, slots=True)
class FlatSpot(Effect):
    """f of one wheel = -depth u (exp(4 (cos(q) - 1)) - 0.207 (1 - mean)), or with form = eccentric -depth u cos(q).

    q = 2 pi s / circumference - phase, s the way of the wheel so far as it is reported. Unless `mean` is 1, the mean
    over a turn is taken off (0.207: exp(-4) I0(4), I0 the modified Bessel function): what a wheel loses on average is a
    smaller radius, `wheel_scale` and `unequal_wheels`, and a spot of any circumference would otherwise imitate these.
    """

    name = "flat_spot"
    odd = True
    layer = "record"
    needs_track = True
    summary = "a wheel is flat on one side or out of round: it gains less once a turn"
    about = About(
        equation="f_wheel = -depth u where the wheel rolls over its flat side, once a turn, less its mean",
        typical="2 to 20 % of the way over a seventh of a turn on foam and cheap rubber tyres (an estimate)",
        source="engineering judgement; no published figures known to us",
        confused_with=("unequal_wheels", "wheel_scale", "slip_burst"),
        drive="long straights at a low speed: the heading sways once a turn of the wheel",
    )

    depth: float = parameter("", "part of the way that is lost at the spot", low=-0.5, high=0.5, typical=0.05)
    circumference: float = parameter(
        "m", "way of one turn of the wheel", low=0.05, high=5.0, typical=0.2, identity=0.2, amplitude=False
    )
    phase: float = parameter(
        "rad", "turn from the first pose to the spot", low=-6.3, high=6.3, typical=1.0, amplitude=False
    )
    mean: float = parameter(
        "", "part of what a flat side loses on average that counts", low=0.0, high=1.0, typical=1.0, amplitude=False,
        optional=True,
    )  # fmt: skip
    wheel: str = choice("which wheel it is", "right", "left")
    form: str = choice("a flat side, or a wheel that does not turn about its middle", "flat", "eccentric")
    track: float = track_parameter()

    @classmethod
    def scan(cls, motions: Sequence[Motion]) -> tuple[Self, ...]:  # noqa: ARG003 - of no use here
        """Return nothing: a line in the spectrum over the way shows the circumference, see `study.select.periodic`."""
        return ()

    def whole(self) -> Self:
        """Return the same spot with all that it loses: a flat side makes the radius smaller, too."""
        return replace(self, mean=1.0) if self.form == "flat" else self

    def start(self, rng: Generator) -> State:  # noqa: ARG002 - nothing is drawn
        """Return wheels that have not turned."""
        return _Turned()

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: what one wheel loses while it rolls over the spot."""
        track_m = needed_track_m(self.name, self.track or motion.track_m)
        rims = rims_of(motion.v, motion.omega, track_m)
        ways = [np.cumsum(np.concatenate(([before], u * motion.dt_s))) for before, u in zip(state, rims, strict=True)]
        zero = np.zeros(len(motion))
        if self.wheel == "right":
            lost = Rims(self._lost(rims.right, ways[0]), zero)
        else:
            lost = Rims(zero, self._lost(rims.left, ways[1]))
        return TwistError(body_of(lost, track_m), _Turned(*(float(way[-1]) for way in ways)))

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002 - at any time
        """Return the increments (n, 3) whose way, less what the spot takes of it, is that of these."""
        track_m = needed_track_m(self.name, self.track or track_m)
        rims = rims_of(steps[:, 0], steps[:, 2], track_m)
        true, way = (rims.right, state.right) if self.wheel == "right" else (rims.left, state.left)
        more = np.zeros(len(true))
        for i, gone in enumerate(true.tolist()):
            reported = gone
            for _ in range(_ROUNDS if self.depth else 0):
                last, reported = reported, gone + self.depth * reported * float(self._at(way + 0.5 * reported))
                if abs(reported - last) <= _SOLVED_M:
                    break
            more[i] = reported - gone
            way += reported
        zero = np.zeros(len(true))
        both = Rims(more, zero) if self.wheel == "right" else Rims(zero, more)
        turned = _Turned(way, 0.0) if self.wheel == "right" else _Turned(0.0, way)
        return Recorded(steps + body_of(both, track_m) if self.depth else steps, turned)

    def _lost(self, u: Array, way: Array) -> Array:
        """Return f of a wheel (n,) from its rim speeds and its way (n + 1,)."""
        lost: Array = -self.depth * u * self._at(0.5 * (way[1:] + way[:-1]))
        return lost

    def _at(self, way: Any) -> Any:
        """Return the part of the depth that a wheel loses after its way, of one number or of many."""
        near = np.cos(2.0 * np.pi * way / self.circumference - self.phase)
        return near if self.form == "eccentric" else np.exp(_NARROW * (near - 1.0)) - _MEAN * (1.0 - self.mean)
