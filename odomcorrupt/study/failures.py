"""Where a model fails, in words: an error per metre in one kind of motion that the model does not expect."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2

if TYPE_CHECKING:
    from odomcorrupt.effects.effect import Motion
    from odomcorrupt.pose import Array
    from odomcorrupt.study.likelihood import Whitener
    from odomcorrupt.study.problem import Problem

__all__ = ["Failure", "failures"]

CHANNELS = ("along", "across", "yaw")
_MIN_SHARE = 0.02


@dataclass(frozen=True, slots=True)
class Failure:
    """A systematic rate of error in one channel during one kind of motion.

    rate, rate_error : per metre driven in that motion (per second at rest); m or rad
    expected : what chance alone would make of it after as much of that motion: one standard deviation of the rate
    amount : metres (seconds at rest) of that motion in the data
    """

    channel: str
    motion: str
    rate: float
    rate_error: float
    amount: float
    p: float

    @property
    def sentence(self) -> str:
        """The finding as a person says it."""
        yaw = self.channel == "yaw"
        resting = self.motion == "at rest"
        per, span = (60.0, "minute") if resting else (10.0, "10 m")
        scale, unit = (np.degrees(per), "deg") if yaw else (per * 1000.0, "mm")
        digits = 2 if yaw else 0
        return (
            f"{self.channel} error grows {self.rate * scale:+.{digits}f} {unit} per {span} {self.motion}; "
            f"by chance it would be within {2.0 * self.rate_error * scale:.{digits}f}"
        )


def failures(problem: Problem, whitener: Whitener, *, level: float = 0.01) -> list[Failure]:
    """Return the failures of a model, the plainest first; empty where the residual has no pattern of this kind.

    The residual is odometry minus truth, so a positive yaw error means that odometry turned too far left.
    """
    r = whitener.whiten(problem.nodes.residual)
    kinds = [_kinds(m) for m in problem.motions]
    found = []
    tried = 0
    for name in kinds[0]:
        amount = sum(float(np.sum(k[name])) for k in kinds)
        total = sum(float(np.sum(k["in all motion"])) for k in kinds)
        if amount < _MIN_SHARE * total:
            continue
        for c, channel in enumerate(CHANNELS):
            rate = np.zeros((sum(len(m) for m in problem.motions), 3))
            rate[:, c] = np.concatenate([k[name] for k in kinds])
            column = whitener.whiten(problem.nodes.column(rate))
            length = float(column @ column)
            if length <= 0.0:
                continue
            tried += 1
            estimate = float(column @ r) / length
            inflation = max(1.0, float(r @ r) / len(r))
            error = float(np.sqrt(inflation / length))
            p = float(chi2.sf((estimate / error) ** 2, 1))
            found.append(Failure(channel, name, estimate, error, amount, p))
    real = [f for f in found if f.p * tried < level]
    return sorted(real, key=lambda f: abs(f.rate / f.rate_error), reverse=True)


def _kinds(motion: Motion) -> dict[str, Array]:
    """Return how much of each kind of motion every interval holds: metres, or seconds at rest."""
    metres = np.hypot(motion.v, motion.vy) * motion.dt_s
    moving = np.abs(motion.v) > 0.02
    curvature = np.where(moving, motion.omega / np.where(moving, motion.v, 1.0), 0.0)
    speed = np.abs(motion.v)
    fast = float(np.median(speed[moving])) if moving.any() else 0.0
    turning = np.abs(curvature) > 0.1
    return {
        "in all motion": metres,
        "in left turns": metres * (moving & turning & (motion.omega > 0.0)),
        "in right turns": metres * (moving & turning & (motion.omega < 0.0)),
        "on straights": metres * (moving & ~turning),
        "in reverse": metres * (motion.v < -0.02),
        "at the faster speeds": metres * (speed > fast),
        "at the slower speeds": metres * (moving & (speed <= fast)),
        "while speeding up": metres * (motion.a * np.sign(motion.v) > 0.1),
        "while braking": metres * (motion.a * np.sign(motion.v) < -0.1),
        "at rest": motion.dt_s * (~moving & (np.abs(motion.omega) < 0.02)),
    }
