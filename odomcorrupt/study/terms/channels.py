"""Actions of basis functions: a channel of the body, or the rim of one wheel or both, and a factor of motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.expression import CHANNELS, SIDES
from odomcorrupt.effects.wheels import wheel_motions
from odomcorrupt.study.terms.basis import evaluated

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Motion
    from odomcorrupt.geometry.se2 import Array

MOVES = ("v", "abs(v)", "omega", "1", "vy", "abs(vy)")
"""Factors of motion that multiply an error; 1 for an error that grows with time."""
_SIDEWAYS = ("vy", "abs(vy)")
"""Factors of a robot that drives sideways."""
_OF_YAW = ("omega", "1")
"""Factors that only errors of the heading have."""
_BODY, _RIGHT, _LEFT = "body", "right", "left"
_GROUND, _TOWARD = "ground", 6
"""Target of errors along a direction in the world, and the number of directions, over half a turn, that are tried."""
_TWIST = "twist"
"""Target of errors that scale travel and turn alike: equal errors of both wheels, which need no track."""


@dataclass(frozen=True, slots=True)
class Action:
    """Target of a basis function, and the motion by which the function is multiplied.

    target : a channel or side of expressions; or "ground": along and across at once; or "twist": along and yaw at once
    move : one of `MOVES`
    heading : source of the odometry's heading, "wheels" or "gyro"; with a gyro, errors of wheels do not turn it
    toward : direction in the world, rad, of the displacement for the target "ground"
    """

    target: str
    move: str
    heading: str = "wheels"
    toward: float = 0.0

    @property
    def by_wheel(self) -> bool:
        """Whether the action is on single wheels, each with its own motion."""
        return self.target in SIDES

    @property
    def reaches(self) -> frozenset[str]:
        """Classes of the target: "body", "floor", "one" wheel, "both", "bias", "ground", "twist" or "heading".

        "turning" is the gain of turns, "travel" that of travel ahead or sideways.
        "sideways" is an error per sideways travel; "sideways gain" one that no library effect has in constant ratio.
        "bias" is a heading error over time; "heading" is a yaw error per travel, which an error of a compass may cause.
        "floor" is what wheels that slip on a patch can cause. They do not push a robot to one of its sides, both
        forwards and in reverse: where it seems so, the headings of the truth are wrong.
        """
        if self.move == "1":
            return frozenset({"bias"})
        if self.move in _SIDEWAYS:
            known = (self.target, self.move) in (("across", "vy"), ("yaw", "vy"))  # sideways_scale, sideways_turn
            travel = ["travel"] if (self.target, self.move) == ("across", "vy") else []
            return frozenset({"sideways", *travel} if known else {"sideways", "sideways gain"})
        if self.by_wheel:
            return frozenset({"both" if self.target == "wheels" else "one"})
        if self.target in (_GROUND, _TWIST):
            return frozenset({self.target})
        if self.target == "across":
            return frozenset({"body"})
        own = {("yaw", "v"): ["heading"], ("yaw", "omega"): ["turning"], ("along", "v"): ["travel"]}
        return frozenset({"body", "floor", *own.get((self.target, self.move), [])})

    @property
    def channel(self) -> str:
        """Channel of the body with the largest error: yaw, if the wheels turn the heading and their errors differ."""
        if not self.by_wheel:
            return "along" if self.target in (_GROUND, _TWIST) else self.target
        return "along" if self.target == "wheels" or self.heading == "gyro" else "yaw"

    @property
    def per(self) -> str:
        """Unit of motion to which the error refers: "m" driven, "rad" turned, or "s"."""
        return {"omega": "rad", "1": "s"}.get(self.move, "m")

    @property
    def turn(self) -> float:
        """First step of a search over the direction, rad; 0 if the target has none."""
        return 0.5 * np.pi / _TOWARD if self.target == _GROUND else 0.0

    def written(self, function: str) -> str:
        """Return the expression of an effect for a function given as text."""
        if self.move == "1":
            return f"{self.target} += {function}"
        if self.target == _TWIST:
            return f"along += v * ({function}); yaw += omega * ({function})"
        if self.target != _GROUND:
            return f"{self.target} += {self.move} * ({function})"
        along, across = (f"{self.move} * {turn}({self.toward:.4g} - theta)" for turn in ("cos", "sin"))
        return f"along += {along} * ({function}); across += {across} * ({function})"

    def rates(self, seen: View, track_m: float | None) -> list[tuple[str, Array]]:
        """Return the views that the action reads, each with the residual's rate (n, 3) for a function equal to 1."""
        if self.target == _TWIST:
            still = np.zeros(len(seen[_BODY]))
            return [(_BODY, -np.stack((seen[_BODY].v, still, seen[_BODY].omega), axis=1))]
        return [(view, evaluated(self.move, seen[view])[:, None] * unit) for view, unit in self._units(seen, track_m)]

    def _units(self, seen: View, track_m: float | None) -> list[tuple[str, Array]]:
        if self.target == _GROUND:
            away = self.toward - seen[_BODY].theta
            return [(_BODY, -np.stack((np.cos(away), np.sin(away), np.zeros_like(away)), axis=1))]
        if not self.by_wheel or track_m is None:
            return [(_BODY, -np.eye(3)[CHANNELS.index(self.target)])]
        turn = 0.0 if self.heading == "gyro" else 1.0 / track_m
        sides = [(_RIGHT, np.array([-0.5, 0.0, -turn])), (_LEFT, np.array([-0.5, 0.0, turn]))]
        return [part for part in sides if self.target in ("wheels", part[0])]


def every_action(*, sideways: bool = False) -> list[Action]:
    """Return every action that basis functions are tried with, for a robot that drives sideways or not."""
    moves = [m for m in MOVES if sideways or m not in _SIDEWAYS]
    body = [Action(c, m) for c in CHANNELS for m in moves if c == "yaw" or m not in _OF_YAW]
    wheels = [Action("wheels", "v"), Action("wheels", "v", "gyro"), Action("left", "v"), Action("right", "v")]
    return [*body, *wheels, *(Action(_GROUND, "abs(v)", toward=np.pi * i / _TOWARD) for i in range(_TOWARD))]


def actions_on(motions: Sequence[Motion], *, sideways: bool = False) -> list[Action]:
    """Return the actions that are possible on these motions: those on single wheels need a track.

    Without a track, equal errors of both wheels over time (wear, load) are tried on the twist instead.
    """
    actions = every_action(sideways=sideways)
    if all(m.track_m is not None for m in motions):
        return actions
    return [*(action for action in actions if not action.by_wheel), Action(_TWIST, "v")]


View = dict[str, "Motion"]
"""The motion of the body and of each wheel, by name."""


def views(motion: Motion) -> View:
    """Return the motion of the body and, if the track is known, of the wheels."""
    if motion.track_m is None:
        return {_BODY: motion}
    right, left = wheel_motions(motion, motion.track_m)
    return {_BODY: motion, _RIGHT: right, _LEFT: left}
