"""Base class, parameters and results of effects: physical causes of odometry errors.

An effect is a frozen dataclass whose float fields are its parameters. It gives f, the true body twist minus the
odometry's, as a function of the *odometry-side* motion. The f of several effects add. Corruption solves u' = u - f(u'),
correction adds f, the fit uses -f as a regressor, and the diagnosis tests every registered effect at its identity.
An effect is therefore described completely by its own file.
"""

from __future__ import annotations

import dataclasses
from functools import lru_cache
from itertools import product
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, Self

import numpy as np

from odomcorrupt.errors import EffectError
from odomcorrupt.geometry.motion import Motion
from odomcorrupt.rng import stream

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array

__all__ = [
    "About",
    "ByRows",
    "Drawn",
    "Effect",
    "Moments",
    "Motion",
    "Parameter",
    "RandomCoefficient",
    "Recorded",
    "TwistError",
    "amplitudes",
    "check_bounds",
    "choice",
    "choices",
    "gain",
    "on_bound",
    "parameter",
    "parameters",
    "shapes",
    "stacked",
]
Kind = Literal["effect", "setup", "noise", "event"]
"""Kinds of effects. An event happens once, at a time stated in the model; it is applied to bags, but not diagnosed."""
Layer = Literal["motion", "record", "draws"]
State = Any


class TwistError(NamedTuple):
    """f as (n, 3): forward m/s, leftward m/s, yaw rad/s; and the state after the last interval."""

    f: Array
    state: State


class ByRows(NamedTuple):
    """f of single intervals of a motion, everything drawn over it included, and the state after the last one.

    f : from the motion of k intervals, and which they are in the whole motion, to (k, 3)
    """

    f: Callable[[Motion, NDArray[np.intp] | slice], Array]
    state: State


class Recorded(NamedTuple):
    """Reported increments (n, 3): metres forward, metres left, radians; and the state after the last one."""

    steps: Array
    state: State


class Drawn(NamedTuple):
    """Draws (n, 4) in place of the noise law's standard normals, and the state after the last one."""

    normals: Array
    state: State


class Moments(NamedTuple):
    """Expectation and variance (n, 3) of f over the intervals of a true motion, from its start; NaN: not stated."""

    mean: Array
    variance: Array


class RandomCoefficient(NamedTuple):
    """Random coefficient (first-order autoregressive), and the odometry error per unit of it.

    At each interval it is multiplied by `keep`, and noise of variance `kick` is added.

    f : (n, 3) forward m/s, leftward m/s, yaw rad/s; its sign does not matter
    keep, kick : (n,)
    start : variance of the coefficient before the first interval
    """

    f: Array
    keep: Array
    kick: Array
    start: float


class About(NamedTuple):
    """Description of an effect for help texts and reports.

    equation : f, truth minus odometry, in plain text
    typical : sizes seen on real robots, in words
    source : publication or measurement that describes it
    confused_with : names of effects with similar errors, the most similar first
    drive : manoeuvre that excites it and separates it from the effects in `confused_with`
    """

    equation: str
    typical: str
    source: str
    confused_with: tuple[str, ...]
    drive: str


class Effect:
    """Base class of effects with defaults; `odomcorrupt.testing.check_effect` tests the contract.

    A subclass is a frozen dataclass that sets the class variables and implements `twist_error`. A memoryless effect
    needs no other method, and may be declared with `gain` in one expression.

    clock : the effect moves the stamps of a bag; its f is the first-order equivalent for a regression
    layer : "motion" for a function f of the odometry's motion; "record" for effects between wheels and message (play,
        ticks, losses), which act on the increments after all f; "draws" for the draws of the noise law
    needs_track : the effect acts on single wheels and needs the track
    needs_sideways : only a robot that can drive sideways can have the effect
    needs_gyro : only odometry with heading from a gyro can have the effect
    drives : drive types that can have the effect; None: all
    restorable : the odometry itself shows the effect, so that it can be undone although it is random
    shown_at_rest : the odometry shows its course while the robot stands, so that a correction interpolates it
    reads_truth : f depends on true acceleration, pose or distance, which a correction has to estimate
    rectifies : f depends on accelerations, and not linearly, so that the effects of their noise do not cancel
    reads_places : f depends on position or heading in the world frame, which may differ from the odometry's
    odd : near the identity f is exactly odd in the amplitudes, so that one evaluation gives its slope there
    aliased_with : name of an effect with the same f (an alias: no recording can separate the two)
    unsteered : for a steered robot's effect, the differential-drive effect that equals it at small steering angles
    initial : state before the first interval of an effect that draws nothing; None for one without memory
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
    shown_at_rest: ClassVar[bool] = False
    reads_truth: ClassVar[bool] = False
    rectifies: ClassVar[bool] = False
    reads_places: ClassVar[bool] = False
    odd: ClassVar[bool] = False
    aliased_with: ClassVar[str | None] = None
    unsteered: ClassVar[str | None] = None
    initial: ClassVar[State] = None

    __slots__ = ()

    @property
    def acts(self) -> bool:
        """Whether the effect does anything: at least one amplitude is off its identity."""
        return any(getattr(self, p.name) != p.identity for p in amplitudes(self))

    @property
    def lost_m(self) -> float:
        """Bound on the part of the error that no correction can undo, metres."""
        return 0.0

    @property
    def remainder(self) -> tuple[float, float]:
        """Bounds (m/s, rad/s) on the error minus f at any moment, if f is only the mean of the error."""
        return 0.0, 0.0

    @classmethod
    def scan(cls, motions: Sequence[Motion]) -> tuple[Self, ...]:  # noqa: ARG003 - for shapes that depend on the drive
        """Return the effect at its identity for each candidate value of its shape parameters on these motions.

        An effect without shapes is linear at its identity and needs one candidate.
        """
        trials = {p.name: p.trials for p in parameters(cls) if p.trials}
        return tuple(cls(**dict(zip(trials, values, strict=True))) for values in product(*trials.values()))

    def related(self) -> tuple[Self, ...]:
        """Return other forms of the effect near this shape, which a search tries only if its gain is large."""
        return ()

    def continued(self, motions: Sequence[Motion]) -> Self:  # noqa: ARG002 - for effects of places
        """Return the effect continued to places that these motions do not reach; the same on the motions."""
        return self

    def plain(self) -> Self:
        """Return the same effect in its usual parametrisation, if it has several."""
        return self

    def whole(self) -> Self:
        """Return the effect with the part of f that it leaves to others, not to imitate them; else itself."""
        return self

    def start(self, rng: np.random.Generator) -> State:  # noqa: ARG002 - for effects that draw
        """Return the state before the first interval."""
        return self.initial

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f over the intervals of `motion`, and the state after them; the given state is not modified.

        By default it is that of `by_rows`. For another layer than "motion" it is 0: what such an effect changes is no
        function of the reported motion.
        """
        if self.layer != "motion" or self.clock:
            return TwistError(np.zeros((len(motion), 3)), state)
        drawn = self.by_rows(motion, state)
        if drawn is None or type(self).by_rows is Effect.by_rows:
            raise NotImplementedError
        return TwistError(drawn.f(motion, slice(None)), drawn.state)

    def by_rows(self, motion: Motion, state: State) -> ByRows | None:  # noqa: ARG002 - for effects with memory
        """Return f by single intervals of a motion; None if f of an interval depends on the motion before it.

        An effect with memory has it if only what it draws is remembered: then corruption solves each interval alone.
        """
        return ByRows(lambda rows, _: self.twist_error(rows, None).f, None) if state is None else None

    @property
    def window_s(self) -> tuple[float, float] | None:
        """Begin and end of an event, seconds after the first odometry stamp; None for an effect that always acts."""
        return None

    def recorded(
        self,
        steps: Array,
        t_s: Array,  # noqa: ARG002 - for effects of layer "record"
        track_m: float | None,  # noqa: ARG002 - as above
        state: State,
    ) -> Recorded:
        """Return the increments that odometry reports for those of the robot, m and rad.

        steps : (n, 3) increments forwards, to the left, and of the yaw
        t_s : (n,) their ends, s after the first odometry stamp
        track_m : distance between the wheels; None if it is not known
        state : that of `start`, or that of the result for the increments before
        """
        return Recorded(steps, state)

    def restored(self, motion: Motion) -> Motion:
        """Return the motion that encoders should have reported, given the one they reported; for layer "record"."""
        f = self.twist_error(motion, self.start(stream(0, 0, self.name))).f
        return dataclasses.replace(motion, v=motion.v + f[:, 0], vy=motion.vy + f[:, 1], omega=motion.omega + f[:, 2])

    def drawn(self, normals: Array, state: State) -> Drawn:
        """Return draws (n, 4) in place of the noise law's standard normals (n, 4), and the state after them."""
        return Drawn(normals, state)

    def moments(self, motion: Motion) -> Moments | None:  # noqa: ARG002 - for effects that draw
        """Return expectation and variance of f on a true motion; None for an effect that draws nothing."""
        return None

    def gains(self, motion: Motion) -> tuple[RandomCoefficient, ...]:  # noqa: ARG002 - for effects that draw
        """Return the random coefficients on a true motion, mutually independent; none if they are not stated.

        For covariances: to first order, the odometry error is the sum of the coefficients' deviations times `f`.
        """
        return ()

    def stamp_shift_s(self, t_s: Array) -> Array:
        """Return the shift (n,) of the odometry's stamps against true time t_s (n,), seconds."""
        return np.zeros_like(t_s)


class Parameter(NamedTuple):
    """Description of one parameter.

    identity : the value at which the effect does nothing
    low, high : physically sensible bounds; a value beyond them is refused
    typical : usual size on real robots, for scans and statements of power
    amplitude : f is proportional to it (near the identity), so one regressor column finds it; otherwise a shape
    step : step for a numerical slope of f
    optional : a shape that has no influence at its identity and is then held there
    trials : values of a shape at which the effect is tried first
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
    trials: tuple[float, ...] = ()


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
    trials: tuple[float, ...] = (),
) -> Any:
    """Return a dataclass field that declares a parameter with its unit and bounds; its default is the identity.

    unit, meaning : for help texts and reports; "" for a number without a unit
    low, high, typical : bounds, and the size on a usual robot
    identity : value at which the effect does nothing
    amplitude : whether f is proportional to it; else it is a shape
    step : change for numerical derivatives; by default a thousandth of the typical size
    optional : whether a shape at its identity is neither counted as a parameter nor printed
    trials : values of a shape at which the effect is tried first
    """
    facts = {
        "unit": unit, "meaning": meaning, "low": low, "high": high, "typical": typical, "identity": identity,
        "amplitude": amplitude, "step": 1e-3 * typical if step is None else step,
        "optional": optional, "trials": trials,
    }  # fmt: skip
    return dataclasses.field(default=identity, metadata=facts)


def choice(meaning: str, *options: str) -> Any:
    """Return a dataclass field for a parameter that is one of a few words; its default is the first one."""
    return dataclasses.field(default=options[0], metadata={"meaning": meaning, "options": options})


def choices(effect: Effect | type[Effect]) -> dict[str, tuple[str, ...]]:
    """Return the word-valued parameters of an effect, with their options."""
    fields = dataclasses.fields(effect)  # type: ignore[arg-type]  # every subclass is a dataclass
    return {f.name: f.metadata["options"] for f in fields if "options" in f.metadata}


def parameters(effect: Effect | type[Effect]) -> tuple[Parameter, ...]:
    """Return the parameters declared by an effect class, in order; for an effect, only those with an influence."""
    declared = _declared(effect if isinstance(effect, type) else type(effect))  # type: ignore[arg-type]  # it is hashable
    if isinstance(effect, type):
        return declared
    return tuple(p for p in declared if not p.optional or getattr(effect, p.name) != p.identity)


@lru_cache(maxsize=256)
def _declared(kind: type[Effect]) -> tuple[Parameter, ...]:
    """Return the parameters declared by an effect class; cached, because thousands of fits need them."""
    fields = dataclasses.fields(kind)  # type: ignore[arg-type]  # every subclass is a dataclass
    return tuple(Parameter(name=f.name, **f.metadata) for f in fields if "unit" in f.metadata)


def amplitudes(effect: Effect | type[Effect]) -> tuple[Parameter, ...]:
    """Return the parameters that f is proportional to: a linear fit estimates them with the shapes held fixed."""
    return tuple(p for p in parameters(effect) if p.amplitude)


def shapes(effect: Effect) -> tuple[Parameter, ...]:
    """Return the shape parameters of an effect, which a non-linear search estimates."""
    return tuple(p for p in parameters(effect) if not p.amplitude)


def on_bound(effect: Effect) -> tuple[str, float] | None:
    """Return name and value of an amplitude that a fit has moved to its bound; None if there is none."""
    for p in amplitudes(effect):
        value = getattr(effect, p.name)
        # distance to a bound, as a fraction of the bound, at which a fitted value counts as on the bound
        if value != p.identity and any(abs(value - bound) <= 1e-6 * abs(bound) for bound in (p.low, p.high)):
            return p.name, value
    return None


def check_bounds(effect: Effect) -> None:
    """Raise EffectError if a parameter is not a finite number within its bounds, or not one of its words."""
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


def gain(
    name: str,
    summary: str,
    f: Callable[[Any, Motion], tuple[Array | float, Array | float, Array | float]],
    about: About,
    **facts: Any,
) -> Any:
    """Return the class of an effect without memory, given its f in one expression.

    f : from the effect and n intervals of a motion to f along (m/s), across (m/s) and in yaw (rad/s), (n,) or scalar
    facts : the parameters by name, made by `parameter` and `choice`, and class variables of `Effect` that differ

    The class is named as the effect, in capitals: `gain("mount_yaw", ...)` is to be assigned to `MountYaw`.
    """

    def twist_error(self: Effect, motion: Motion, state: State) -> TwistError:
        return TwistError(stacked(*f(self, motion), motion.v), state)

    fields = [(key, Any, value) for key, value in facts.items() if isinstance(value, dataclasses.Field)]
    traits = {key: value for key, value in facts.items() if not isinstance(value, dataclasses.Field)}
    namespace = {
        "name": name, "summary": summary, "about": about, "twist_error": twist_error, "__doc__": about.equation,
        "__module__": f.__module__, **traits,
    }  # fmt: skip
    kind = name.title().replace("_", "")
    return dataclasses.make_dataclass(kind, fields, bases=(Effect,), namespace=namespace, frozen=True, slots=True)


def stacked(along: Array | float, across: Array | float, yaw: Array | float, like: Array) -> Array:
    """Return f (n, 3) from its three components (n,): m/s forwards, m/s to the left, rad/s.

    Scalars are broadcast to the shape of `like` (n,).
    """
    rows = np.empty((3, len(like)))  # contiguous rows: most of the code that follows takes one component at a time
    rows[0], rows[1], rows[2] = along, across, yaw
    return rows.T
