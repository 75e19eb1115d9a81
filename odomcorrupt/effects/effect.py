"""What an effect is: a physical cause by which odometry departs from the truth.

An effect is a frozen dataclass whose float fields are its parameters. It answers one question: by how much does the
true body twist exceed the odometry's, f = truth minus odometry, as a function of the *odometry-side* motion? The f of
several effects add. Corruption solves u' = u - f(u'), correction adds f, the fit uses -f as a regressor, diagnosis
tries every registered effect at its identity: nothing about an effect is written anywhere but in its own file.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

import numpy as np

from odomcorrupt.errors import EffectError

if TYPE_CHECKING:
    from odomcorrupt.pose import Array

__all__ = [
    "Effect",
    "Motion",
    "Parameter",
    "TwistError",
    "check_bounds",
    "parameter",
    "parameters",
    "stacked",
]

Kind = Literal["effect", "setup", "noise"]
State = Any


@dataclass(frozen=True, slots=True)
class Motion:
    """Motion over n intervals as the odometry sees it, (n,) each.

    t_s : since the first odometry stamp, seconds, at the end of the interval
    dt_s : length of the interval, seconds; where it is 0 the rates are 0
    v, vy : forward and leftward speed, m/s (signed)
    omega : yaw rate, rad/s
    acceleration : (n, 3) forward and leftward, m/s^2, and yaw acceleration, rad/s^2
    x, y, theta : the clean pose (corruption) or the odometry's (study), metres and radians
    distance : travelled so far, metres
    track_m : the robot's nominal track, or None where it is not known
    """

    t_s: Array
    dt_s: Array
    v: Array
    vy: Array
    omega: Array
    acceleration: Array
    x: Array
    y: Array
    theta: Array
    distance: Array
    track_m: float | None = None

    @property
    def a(self) -> Array:
        """Forward acceleration (n,), m/s^2."""
        return self.acceleration[:, 0]

    @property
    def alpha(self) -> Array:
        """Yaw acceleration (n,), rad/s^2."""
        return self.acceleration[:, 2]

    def __len__(self) -> int:
        return len(self.t_s)


class TwistError(NamedTuple):
    """f as (n, 3): forward m/s, leftward m/s, yaw rad/s; and the state to go on with."""

    f: Array
    state: State


class Effect:
    """The protocol every effect obeys, with its defaults; `odomcorrupt.testing.check_effect` holds it to it.

    A subclass is a frozen dataclass that sets the class variables and answers `twist_error`. The body of an effect
    without memory is that one method. `clock` effects act on a bag by moving stamps, and their f is only what that
    looks like to a regression.
    """

    name: ClassVar[str]
    kind: ClassVar[Kind]
    summary: ClassVar[str]
    clock: ClassVar[bool] = False

    __slots__ = ()

    def start(self, rng: np.random.Generator) -> State:  # noqa: ARG002 - for effects that draw
        """Return the state before the first interval; None for an effect without memory."""
        return None

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f over the intervals of `motion`, and the state after them."""
        raise NotImplementedError

    def stamp_shift_s(self, t_s: Array) -> Array:
        """Return by how much (n,) seconds the odometry's stamps run ahead of true time t_s (n,)."""
        return np.zeros_like(t_s)


@dataclass(frozen=True, slots=True)
class Parameter:
    """What is known of one parameter.

    identity : the value at which the effect does nothing
    low, high : bounds of what makes sense physically; beyond them a value is refused
    typical : a usual size on real robots, for scans and power statements
    amplitude : f is proportional to it (near the identity), so one regressor column finds it; otherwise a shape
    """

    name: str
    unit: str
    meaning: str
    low: float
    high: float
    typical: float
    identity: float
    amplitude: bool


def parameter(
    unit: str,
    meaning: str,
    *,
    low: float,
    high: float,
    typical: float,
    identity: float = 0.0,
    amplitude: bool = True,
) -> Any:
    """Declare a parameter: a dataclass field with unit and bounds; its default is the identity."""
    facts = {
        "unit": unit, "meaning": meaning, "low": low, "high": high,
        "typical": typical, "identity": identity, "amplitude": amplitude,
    }  # fmt: skip
    return dataclasses.field(default=identity, metadata=facts)


def parameters(effect: Effect | type[Effect]) -> tuple[Parameter, ...]:
    """Return the parameters that an effect declares, in order."""
    fields = dataclasses.fields(effect)  # type: ignore[arg-type]  # every subclass is a dataclass
    return tuple(Parameter(name=f.name, **f.metadata) for f in fields if "unit" in f.metadata)


def check_bounds(effect: Effect) -> None:
    """Raise EffectError where a parameter is not a finite number within its bounds."""
    for p in parameters(effect):
        value = getattr(effect, p.name)
        if not (np.isfinite(value) and p.low <= value <= p.high):
            unit = f" {p.unit}" if p.unit else ""
            raise EffectError(
                f"effect {effect.name}, {p.name}: {value:g}; it must lie in [{p.low:g}, {p.high:g}]{unit}"
            )


def stacked(along: Array | float, across: Array | float, yaw: Array | float, like: Array) -> Array:
    """Return f (n, 3) from its three rows; scalars are spread over the shape of `like`."""
    f = np.empty((len(like), 3))
    f[:, 0], f[:, 1], f[:, 2] = along, across, yaw
    return f
