"""What a basis function acts on: a channel of the body, on the rim of one wheel or of both; and what moves it there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.expression import CHANNELS, SIDES
from odomcorrupt.effects.wheels import wheel_motions

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from odomcorrupt.effects.effect import Motion
    from odomcorrupt.geometry.se2 import Array

__all__ = ["MOVES", "Action", "View", "actions_on", "every_action", "views"]

MOVES: dict[str, Callable[[Motion], Array]] = {
    "v": lambda m: m.v,
    "abs(v)": lambda m: np.abs(m.v),
    "omega": lambda m: m.omega,
    "1": lambda m: np.ones(len(m)),
}
"""What an error is proportional to; 1 for one that grows with time."""
_BODY, _RIGHT, _LEFT = "body", "right", "left"
_GROUND, _TOWARD = "ground", 6
"""What carries the robot where it is, and the directions, over half a turn, in which it may."""
_TWIST = "twist"
"""Travel and turn by the same factor, as of two wheels that err alike: what they do at one time needs no track."""


@dataclass(frozen=True, slots=True)
class Action:
    """What a basis function adds to, and what it multiplies.

    target : one of the channels, or of the sides, of expressions; or "ground": along and across at once; or "twist":
        along and yaw at once
    move : key of `MOVES`
    heading : where the odometry's heading comes from; with a gyro, wheels do not turn it
    toward : direction in the world, rad, in which the ground carries the robot
    """

    target: str
    move: str
    heading: str = "wheels"
    toward: float = 0.0

    @property
    def by_wheel(self) -> bool:
        """Whether it acts on single wheels, each as it moves itself."""
        return self.target in SIDES

    @property
    def reaches(self) -> frozenset[str]:
        """What it reaches: the "body", "one" wheel or "both"; the heading over time, a "bias"; "ground" or "twist".

        What turns the body as it travels may be an error of its "heading".
        """
        if self.move == "1":
            return frozenset({"bias"})
        if self.by_wheel:
            return frozenset({"both" if self.target == "wheels" else "one"})
        if self.target in (_GROUND, _TWIST):
            return frozenset({self.target})
        return frozenset({"body", "heading"} if (self.target, self.move) == ("yaw", "v") else {"body"})

    @property
    def channel(self) -> str:
        """The channel of the body where it shows most: the heading, where one wheel is not like the other."""
        if not self.by_wheel:
            return "along" if self.target in (_GROUND, _TWIST) else self.target
        return "along" if self.target == "wheels" or self.heading == "gyro" else "yaw"

    @property
    def per(self) -> str:
        """What its error is an error per: "m" driven, "rad" turned, or "s"."""
        return {"omega": "rad", "1": "s"}.get(self.move, "m")

    @property
    def turn(self) -> float:
        """First step of a search over its direction, rad; 0 where it has none."""
        return 0.5 * np.pi / _TOWARD if self.target == _GROUND else 0.0

    def written(self, function: str) -> str:
        """Return a function as an expression."""
        if self.move == "1":
            return f"{self.target} += {function}"
        if self.target == _TWIST:
            return f"along += v * ({function}); yaw += omega * ({function})"
        if self.target != _GROUND:
            return f"{self.target} += {self.move} * ({function})"
        along, across = (f"{self.move} * {turn}({self.toward:.4g} - theta)" for turn in ("cos", "sin"))
        return f"along += {along} * ({function}); across += {across} * ({function})"

    def rates(self, seen: View, track_m: float | None) -> list[tuple[str, Array]]:
        """Return the views it looks at, and how fast (n, 3) a function of one there moves the odometry."""
        if self.target == _TWIST:
            still = np.zeros(len(seen[_BODY]))
            return [(_BODY, -np.stack((seen[_BODY].v, still, seen[_BODY].omega), axis=1))]
        return [(view, MOVES[self.move](seen[view])[:, None] * unit) for view, unit in self._units(seen, track_m)]

    def _units(self, seen: View, track_m: float | None) -> list[tuple[str, Array]]:
        if self.target == _GROUND:
            away = self.toward - seen[_BODY].theta
            return [(_BODY, -np.stack((np.cos(away), np.sin(away), np.zeros_like(away)), axis=1))]
        if not self.by_wheel or track_m is None:
            return [(_BODY, -np.eye(3)[CHANNELS.index(self.target)])]
        turn = 0.0 if self.heading == "gyro" else 1.0 / track_m
        sides = [(_RIGHT, np.array([-0.5, 0.0, -turn])), (_LEFT, np.array([-0.5, 0.0, turn]))]
        return [part for part in sides if self.target in ("wheels", part[0])]


def every_action() -> list[Action]:
    """Return everything that basis functions are tried on."""
    body = [Action(c, m) for c in CHANNELS for m in MOVES if c == "yaw" or m in ("v", "abs(v)")]
    wheels = [Action("wheels", "v"), Action("wheels", "v", "gyro"), Action("left", "v"), Action("right", "v")]
    return [*body, *wheels, *(Action(_GROUND, "abs(v)", toward=np.pi * i / _TOWARD) for i in range(_TOWARD))]


def actions_on(motions: Sequence[Motion]) -> list[Action]:
    """Return what basis functions can be tried on here: single wheels need a track.

    Without one, what both do at a time is tried on the twist: that both are worn, or carry more, at any track.
    """
    if all(m.track_m is not None for m in motions):
        return every_action()
    return [*(action for action in every_action() if not action.by_wheel), Action(_TWIST, "v")]


View = dict[str, "Motion"]
"""One motion, as the body and as each wheel see it."""


def views(motion: Motion) -> View:
    """Return the motion of the body, and of the wheels where the track is known."""
    if motion.track_m is None:
        return {_BODY: motion}
    right, left = wheel_motions(motion, motion.track_m)
    return {_BODY: motion, _RIGHT: right, _LEFT: left}
