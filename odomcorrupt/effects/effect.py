"""Effects: physical causes of odometry errors.

An effect is a frozen dataclass whose float fields are its parameters. It gives f, the true body twist minus the
odometry's, as a function of the *odometry-side* motion. The f of several effects add. Corruption solves u' = u - f(u'),
correction adds f, the fit uses -f as a regressor, and the diagnosis tests every registered effect at its identity, so
that an effect is described in its own file alone.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, Self

import numpy as np

from odomcorrupt.effects.motion import Motion
from odomcorrupt.errors import EffectError
from odomcorrupt.rng import stream

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.se2 import Array

__all__ = [
    "About",
    "Drawn",
    "Effect",
    "Gain",
    "Moments",
    "Motion",
    "Parameter",
    "Recorded",
    "TwistError",
    "amplitudes",
    "check_bounds",
    "choice",
    "choices",
    "parameter",
    "parameters",
    "shapes",
    "stacked",
]

Kind = Literal["effect", "setup", "noise", "event"]
"""An event happens once, at a time that its model states: it is put into bags, and no diagnosis tests it."""

Layer = Literal["motion", "record", "draws"]
State = Any


class TwistError(NamedTuple):
    """f as (n, 3): forward m/s, leftward m/s, yaw rad/s; and the state to go on with."""

    f: Array
    state: State


class Recorded(NamedTuple):
    """Increments (n, 3) as reported, metres along, metres left, radians; and the state to go on with."""

    steps: Array
    state: State


class Drawn(NamedTuple):
    """Numbers (n, 4) in place of the noise law's standard normals, and the state to go on with."""

    normals: Array
    state: State


class Moments(NamedTuple):
    """Expectation and variance (n, 3) of f over the intervals of a true motion, from the start on; NaN: not stated."""

    mean: Array
    variance: Array


class Gain(NamedTuple):
    """A random coefficient (autoregressive, first order), and the odometry error per unit of it.

    From interval to interval it is multiplied by `keep`, and noise of variance `kick` is added.

    f : (n, 3) forward m/s, leftward m/s, yaw rad/s; its sign does not matter
    keep, kick : (n,)
    start : its variance before the first interval
    """

    f: Array
    keep: Array
    kick: Array
    start: float


class About(NamedTuple):
    """Description of an effect for help texts and reports.

    equation : f, truth minus odometry, in plain text
    typical : sizes seen on real robots, in words
    source : where it is described
    confused_with : names of effects with similar errors, the most similar first
    drive : the manoeuvre that excites it and separates it from those
    """

    equation: str
    typical: str
    source: str
    confused_with: tuple[str, ...]
    drive: str


class Effect:
    """Base class of effects with defaults; `odomcorrupt.testing.check_effect` tests the contract.

    A subclass is a frozen dataclass that sets the class variables and answers `twist_error`. The body of an effect
    without memory is that one method.

    clock : it acts on a bag by moving stamps; its f is the first-order equivalent for a regression
    layer : "motion" for a function f of the odometry's motion; "record" for what happens between the wheels and the
        message (play, ticks, losses), which acts on the increments after all f; "draws" for the noise law's draws
    needs_track : it acts on single wheels and needs the track
    needs_sideways : only a robot that can drive sideways can have it
    needs_gyro : only an odometry whose heading is a gyro's can have it
    drives : the drive types that can have it; None: all
    restorable : the odometry itself shows what it did, so that it can be undone although it is random
    reads_truth : f depends on acceleration, pose or distance, which a correction estimates on the way
    reads_places : f depends on position or heading in the world frame, which may differ from the odometry's
    odd : near their identity f changes sign with its amplitudes, to the bit: one evaluation gives its slope there
    twin_of : name of the effect with the same f: an alias, which no recording can separate from it
    unsteered : name of the effect of a robot with two driven wheels that a steered robot's is at small angles
    """

    name: ClassVar[str]
    kind: ClassVar[Kind] = "effect"
    summary: ClassVar[str]
    about: ClassVar[About | None] = None
    clock: ClassVar[bool] = False
    layer: ClassVar[Layer] = "motion"
    needs_track: ClassVar[bool] = False
    needs_sideways: ClassVar[bool] = False
    needs_gyro: ClassVar[bool] = False
    drives: ClassVar[frozenset[str] | None] = None
    restorable: ClassVar[bool] = False
    reads_truth: ClassVar[bool] = False
    reads_places: ClassVar[bool] = False
    odd: ClassVar[bool] = False
    twin_of: ClassVar[str | None] = None
    unsteered: ClassVar[str | None] = None

    __slots__ = ()

    @property
    def acts(self) -> bool:
        """Whether it does anything: some amplitude is off its identity."""
        return any(getattr(self, p.name) != p.identity for p in amplitudes(self))

    @property
    def lost_m(self) -> float:
        """Bound on the part of its error that no correction can undo, metres."""
        return 0.0

    @property
    def remainder(self) -> tuple[float, float]:
        """Bounds (m/s, rad/s) on what f, a mean, leaves of its error at any moment: the odometry does not show it."""
        return 0.0, 0.0

    @classmethod
    def scan(cls, motions: Sequence[Motion]) -> tuple[Self, ...]:  # noqa: ARG003 - for effects with shapes
        """Return the effect at its identity for each candidate value of its shape parameters on these motions.

        An effect without shapes is linear at its identity and needs one candidate.
        """
        return (cls(),)

    def plain(self) -> Self:
        """Return the same effect in its usual parametrisation, where there are several."""
        return self

    def whole(self) -> Self:
        """Return the effect with the part of its f that it leaves to others, lest it imitate them; itself if none."""
        return self

    def start(self, rng: np.random.Generator) -> State:  # noqa: ARG002 - for effects that draw
        """Return the state before the first interval; None for an effect without memory."""
        return None

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f over the intervals of `motion`, and the state after them; a state given is never changed."""
        raise NotImplementedError

    @property
    def window_s(self) -> tuple[float, float] | None:
        """When an event acts, from and to, seconds after the first odometry stamp; None: no event, it acts always."""
        return None

    def recorded(
        self,
        steps: Array,
        t_s: Array,  # noqa: ARG002 - for effects of layer "record"
        track_m: float | None,  # noqa: ARG002 - as above
        state: State,
    ) -> Recorded:
        """Return the increments (n, 3) that are reported where `steps` should be; they end at t_s (n,) seconds."""
        return Recorded(steps, state)

    def restored(self, motion: Motion) -> Motion:
        """Return the whole motion that encoders should have reported, from the one they did; for layer "record"."""
        f = self.twist_error(motion, self.start(stream(0, 0, self.name))).f
        return dataclasses.replace(motion, v=motion.v + f[:, 0], vy=motion.vy + f[:, 1], omega=motion.omega + f[:, 2])

    def drawn(self, normals: Array, state: State) -> Drawn:
        """Return what is drawn where the law draws standard normals (n, 4)."""
        return Drawn(normals, state)

    def moments(self, motion: Motion) -> Moments | None:  # noqa: ARG002 - for effects that draw
        """Return expectation and variance of f on a true motion; None for an effect that draws nothing."""
        return None

    def gains(self, motion: Motion) -> tuple[Gain, ...]:  # noqa: ARG002 - for effects that draw
        """Return what it draws on a true motion, numbers independent of each other; none where it does not state them.

        For covariances: to first order, odometry departs from the truth by the sum of their own departures times `f`.
        """
        return ()

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
    step : by how much to change it for a numerical slope of f
    optional : a shape that an effect makes no use of while it is at its identity, and that is held there
    """

    name: str
    unit: str
    meaning: str
    low: float
    high: float
    typical: float
    identity: float
    amplitude: bool
    step: float
    optional: bool = False


def parameter(
    unit: str,
    meaning: str,
    *,
    low: float,
    high: float,
    typical: float,
    identity: float = 0.0,
    amplitude: bool = True,
    step: float | None = None,
    optional: bool = False,
) -> Any:
    """Declare a parameter: a dataclass field with unit and bounds; its default is the identity."""
    facts = {
        "unit": unit, "meaning": meaning, "low": low, "high": high, "typical": typical, "identity": identity,
        "amplitude": amplitude, "step": 1e-3 * typical if step is None else step,
        "optional": optional,
    }  # fmt: skip
    return dataclasses.field(default=identity, metadata=facts)


def choice(meaning: str, *options: str) -> Any:
    """Declare a parameter that is one of a few words; its default is the first of them."""
    return dataclasses.field(default=options[0], metadata={"meaning": meaning, "options": options})


def choices(effect: Effect | type[Effect]) -> dict[str, tuple[str, ...]]:
    """Return the parameters of an effect that are words, and the words they may be."""
    fields = dataclasses.fields(effect)  # type: ignore[arg-type]  # every subclass is a dataclass
    return {f.name: f.metadata["options"] for f in fields if "options" in f.metadata}


def parameters(effect: Effect | type[Effect]) -> tuple[Parameter, ...]:
    """Return the parameters that a class of effects declares, in order; of an effect, those that it makes use of."""
    declared = _declared(effect if isinstance(effect, type) else type(effect))  # type: ignore[arg-type]  # it is hashable
    if isinstance(effect, type):
        return declared
    return tuple(p for p in declared if not p.optional or getattr(effect, p.name) != p.identity)


@lru_cache(maxsize=256)
def _declared(kind: type[Effect]) -> tuple[Parameter, ...]:
    """Return the parameters of a class of effects; thousands of fits ask for the same ones."""
    fields = dataclasses.fields(kind)  # type: ignore[arg-type]  # every subclass is a dataclass
    return tuple(Parameter(name=f.name, **f.metadata) for f in fields if "unit" in f.metadata)


def amplitudes(effect: Effect | type[Effect]) -> tuple[Parameter, ...]:
    """Return the parameters that f is proportional to: the ones a linear fit may move while shapes are held."""
    return tuple(p for p in parameters(effect) if p.amplitude)


def shapes(effect: Effect) -> tuple[Parameter, ...]:
    """Return the parameters of an effect's shape, which a search may move."""
    return tuple(p for p in parameters(effect) if not p.amplitude)


def check_bounds(effect: Effect) -> None:
    """Raise EffectError where a parameter is not a finite number within its bounds, or not one of its words."""
    for name, options in choices(effect).items():
        if getattr(effect, name) not in options:
            raise EffectError(f"effect {effect.name}, {name}: {getattr(effect, name)!r}; write {' or '.join(options)}")
    for p in parameters(effect):
        value = getattr(effect, p.name)
        if isinstance(value, str):
            raise EffectError(f"effect {effect.name}, {p.name}: {value!r}; it must be a number")
        if not (np.isfinite(value) and p.low <= value <= p.high):
            unit = f" {p.unit}" if p.unit else ""
            raise EffectError(
                f"effect {effect.name}, {p.name}: {value:g}; it must lie in [{p.low:g}, {p.high:g}]{unit}"
            )


def stacked(along: Array | float, across: Array | float, yaw: Array | float, like: Array) -> Array:
    """Return f (n, 3) from its three rows; scalars are spread over the shape of `like`."""
    rows = np.empty((3, len(like)))  # each dense in memory: most of what follows takes one row at a time
    rows[0], rows[1], rows[2] = along, across, yaw
    return rows.T
