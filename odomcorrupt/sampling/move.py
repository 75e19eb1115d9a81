"""One motion, from a pose to a pose, as odometry tells it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.corruption.step_law import StepGrowth, noise_variances
from odomcorrupt.errors import ModelError
from odomcorrupt.geometry.increments import BEARING_MIN_M, increments, rot_trans_rot

if TYPE_CHECKING:
    from odomcorrupt.geometry.increments import Increments, RotTransRot
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import Noise
    from odomcorrupt.model.noise_laws import Variances

__all__ = ["Move", "move_between", "move_variances"]


@dataclass(frozen=True, slots=True)
class Move:
    """A motion in the plane.

    start_xyt, end_xyt : (3,) odometry before and after, metres and radians
    shift_xy : (2,) from start to end, metres
    along_xy : (2,) unit vector along which noise on the travel acts: the bearing of the motion, or where that means
        nothing (below `BEARING_MIN_M`) the heading after half the turn
    swing : share of rot1's error by which the travel is turned: all of it, or half where a law spreads it over an arc
    steps : the motion as one increment
    """

    start_xyt: Array
    end_xyt: Array
    shift_xy: Array
    along_xy: Array
    swing: float
    steps: Increments

    @property
    def turn_rad(self) -> float:
        """The turn, in [-pi, pi)."""
        return float(self.steps.dtheta_rad[0])

    @property
    def parts(self) -> RotTransRot:
        """The motion as turn, drive, turn."""
        return rot_trans_rot(self.steps)


def move_between(start_xyt: Array, end_xyt: Array, *, arc: bool = False) -> Move:
    """Return the motion between two poses (3,).

    arc : whether the law is one that spreads rot1 over the translation, `Law.arc`
    """
    steps = increments(np.stack((start_xyt, end_xyt)))
    shift = end_xyt[:2] - start_xyt[:2]
    length = float(np.hypot(*shift))
    middle = start_xyt[2] + steps.dtheta_rad[0] / 2.0
    along = shift / length if length >= BEARING_MIN_M else np.array([np.cos(middle), np.sin(middle)])
    return Move(start_xyt, end_xyt, shift, along, 0.5 if arc else 1.0, steps)


def move_variances(noise: Noise, move: Move, *, article_code: bool = False) -> Variances:
    """Return the variances of noise on a motion, (1,) each: those that corruption would draw with.

    Parameters
    ----------
    article_code
        Do as the listing of "Adding noise to odometry data published by the Gazebo simulator" (2018) does: it hands
        `sd * sd` to a function that takes a standard deviation. The deviation drawn with is the square of the
        intended one, in units of itself; the law must be `linear`, the article's.

    """
    if noise.coefficients.white_v or noise.coefficients.white_omega:
        raise ModelError("white noise on twists goes with time, and one motion has none; draw along a bag instead")
    variances = noise_variances(noise, move.steps, np.zeros(1), StepGrowth()).variances
    if not article_code:
        return variances
    if noise.law_name != "linear":
        raise ModelError(f"article-code: law {noise.law_name}; the article's listing knows its own law, linear, only")
    return type(variances)(variances.rot1**2, variances.trans**2, variances.across**2, variances.rot2**2)
