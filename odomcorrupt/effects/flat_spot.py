"""A wheel that is flat on one side or eccentric: it gains less once per turn."""

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
_CONCENTRATION = 4.0
"""Concentration of the spot (von Mises shape): half of it lies within a seventh of a turn."""
_MEAN = float(np.i0(_CONCENTRATION) * np.exp(-_CONCENTRATION))
"""Mean of the von Mises shape over a turn."""


class _Turned(NamedTuple):
    """Travel of the rims so far as reported, metres."""

    right: float = 0.0
    left: float = 0.0


@dataclass(frozen=True, slots=True)
class FlatSpot(Effect):
    """f_wheel = -depth u (exp(4 (cos(q) - 1)) - 0.207 (1 - mean)); with form = eccentric, -depth u cos(q).

    q = 2 pi s / circumference - phase, s the reported travel of the wheel so far. Unless `mean` is 1, the mean over a
    turn is subtracted (0.207: exp(-4) I0(4), I0 the modified Bessel function). The mean loss is a smaller radius, that
    is, `wheel_scale` and `unequal_wheels`, and a spot of any circumference could otherwise imitate these.
    """

    name = "flat_spot"
    odd = True
    layer = "record"
    needs_track = True
    summary = "a wheel is flat on one side or out of round: it advances less once a turn"
    about = About(
        equation="f_wheel = -depth u where the wheel rolls over its flat side, once a turn, less its mean",
        typical="2 to 20 % of the way over a seventh of a turn on foam and cheap rubber tyres (an estimate)",
        source="engineering judgement; no published figures known to us",
        confused_with=("unequal_wheels", "wheel_scale", "slip_burst"),
        drive="long straights at a low speed: the heading sways once a turn of the wheel",
    )

    depth: float = parameter("", "part of the travel that is lost at the spot", low=-0.5, high=0.5, typical=0.05)
    circumference: float = parameter(
        "m", "travel in one turn of the wheel", low=0.05, high=5.0, typical=0.2, identity=0.2, amplitude=False
    )
    phase: float = parameter(
        "rad", "turn from the first pose to the spot", low=-6.3, high=6.3, typical=1.0, amplitude=False
    )
    mean: float = parameter(
        "", "fraction of the flat side's mean loss that is included", low=0.0, high=1.0, typical=1.0, amplitude=False,
        optional=True,
    )  # fmt: skip
    wheel: str = choice("which wheel it is", "right", "left")
    form: str = choice("a flat side, or a wheel with an off-centre axle", "flat", "eccentric")
    track: float = track_parameter()

    @classmethod
    def scan(cls, motions: Sequence[Motion]) -> tuple[Self, ...]:  # noqa: ARG003 - interface of Effect
        """Return no candidates: the spectrum over the travel shows the circumference, see `study.select.periodic`."""
        return ()

    def whole(self) -> Self:
        """Return the same spot including its mean loss: a flat side also makes the radius smaller."""
        return replace(self, mean=1.0) if self.form == "flat" else self

    def start(self, rng: Generator) -> State:  # noqa: ARG002 - nothing is drawn
        """Return the state before any travel."""
        return _Turned()

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: the speed that one wheel loses as it rolls over the spot."""
        track_m = needed_track_m(self.name, self.track or motion.track_m)
        rims = rims_of(motion.v, motion.omega, track_m)
        arms_m = 0.5 * track_m, -0.5 * track_m
        ways = [motion.rolled(arm_m, before) for arm_m, before in zip(arms_m, state, strict=True)]
        zero = np.zeros(len(motion))
        if self.wheel == "right":
            lost = Rims(self._lost(rims.right, ways[0]), zero)
        else:
            lost = Rims(zero, self._lost(rims.left, ways[1]))
        return TwistError(body_of(lost, track_m), _Turned(*(float(way[-1]) for way in ways)))

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002 - at any time
        """Return the increments (n, 3) that, less the loss of the spot, equal the given ones."""
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
        """Return f of a wheel (n,) from its rim speeds and its travel (n + 1,)."""
        return -self.depth * u * self._at(0.5 * (way[1:] + way[:-1]))

    def _at(self, way: Any) -> Any:
        """Return the fraction of `depth` that a wheel loses at its travel, scalar or array."""
        near = np.cos(2.0 * np.pi * way / self.circumference - self.phase)
        return near if self.form == "eccentric" else np.exp(_CONCENTRATION * (near - 1.0)) - _MEAN * (1.0 - self.mean)
