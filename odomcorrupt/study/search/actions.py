"""Where a law acts: on a channel of the body, on the rim of one wheel or of both; and what moves it there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.expression import CHANNELS, SIDES
from odomcorrupt.effects.wheels import wheel_motions

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from odomcorrupt.effects.effect import Motion
    from odomcorrupt.pose import Array

__all__ = ["MOVES", "Action", "View", "actions_on", "every_action", "views"]

MOVES: dict[str, Callable[[Motion], Array]] = {
    "v": lambda m: m.v,
    "abs(v)": lambda m: np.abs(m.v),
    "omega": lambda m: m.omega,
    "1": lambda m: np.ones(len(m)),
}
"""What an error goes with; 1 for one that grows with time."""
_BODY, _RIGHT, _LEFT = "body", "right", "left"


@dataclass(frozen=True, slots=True)
class Action:
    """What a law adds to, and what it multiplies.

    target : one of the channels, or of the sides, of expressions
    move : key of `MOVES`
    heading : where the odometry's heading comes from; with a gyro, wheels do not turn it
    """

    target: str
    move: str
    heading: str = "wheels"

    @property
    def by_wheel(self) -> bool:
        """Whether it acts on single wheels, each as it moves itself."""
        return self.target in SIDES

    @property
    def reach(self) -> str:
        """Whether it acts on the "body", on "one" wheel or on "both"; or on the heading as time goes, as a "bias"."""
        if self.move == "1":
            return "bias"
        if not self.by_wheel:
            return "body"
        return "both" if self.target == "wheels" else "one"

    @property
    def channel(self) -> str:
        """The channel of the body where it shows most: the heading, where one wheel is not like the other."""
        if not self.by_wheel:
            return self.target
        return "along" if self.target == "wheels" or self.heading == "gyro" else "yaw"

    @property
    def per(self) -> str:
        """What its error is an error per: "m" driven, "rad" turned, or "s"."""
        return {"omega": "rad", "1": "s"}.get(self.move, "m")

    def written(self, law: str) -> str:
        """Return a law's rate in the language of expressions."""
        return law if self.move == "1" else f"{self.move} * ({law})"

    def parts(self, track_m: float | None) -> list[tuple[str, Array]]:
        """Return the views it looks at, and what (3,) a unit of error there does to the odometry."""
        if not self.by_wheel or track_m is None:
            return [(_BODY, -np.eye(3)[CHANNELS.index(self.target)])]
        turn = 0.0 if self.heading == "gyro" else 1.0 / track_m
        sides = [(_RIGHT, np.array([-0.5, 0.0, -turn])), (_LEFT, np.array([-0.5, 0.0, turn]))]
        return [part for part in sides if self.target in ("wheels", part[0])]


def every_action() -> list[Action]:
    """Return all that laws are tried on."""
    body = [Action(c, m) for c in CHANNELS for m in MOVES if c == "yaw" or m in ("v", "abs(v)")]
    return [*body, Action("wheels", "v"), Action("wheels", "v", "gyro"), Action("left", "v"), Action("right", "v")]


def actions_on(motions: Sequence[Motion]) -> list[Action]:
    """Return what laws can be tried on here: single wheels need a track."""
    known = all(m.track_m is not None for m in motions)
    return [action for action in every_action() if known or not action.by_wheel]


View = dict[str, "Motion"]
"""One motion, as the body and as each wheel see it."""


def views(motion: Motion) -> View:
    """Return the motion of the body, and of the wheels where the track is known."""
    if motion.track_m is None:
        return {_BODY: motion}
    right, left = wheel_motions(motion, motion.track_m)
    return {_BODY: motion, _RIGHT: right, _LEFT: left}
