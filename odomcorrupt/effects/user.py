"""User effects: a class for each expression in a model file, equivalent to the library's effects."""

from __future__ import annotations

import dataclasses
import keyword
import re
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from odomcorrupt.effects.effect import (
    About,
    Effect,
    Motion,
    State,
    TwistError,
    check_bounds,
    choices,
    parameter,
    parameters,
)
from odomcorrupt.effects.expression import (
    ACCELERATIONS,
    CHANNELS,
    CONSTANTS,
    FUNCTIONS,
    PAST,
    PLACES,
    SIDES,
    TRUTH_VARIABLES,
    VARIABLES,
    Expression,
    parse_expression,
)
from odomcorrupt.effects.wheels import Rims, body_of, heading_choice, needed_track_m, wheel_motions
from odomcorrupt.errors import EffectError

if TYPE_CHECKING:
    from collections.abc import Mapping

_NAME = re.compile(r"[a-z][a-z0-9_]{0,59}")
_TAKEN = {*VARIABLES, *CONSTANTS, *FUNCTIONS, *CHANNELS, *SIDES, "name", "expression", "heading"}
LARGEST = 1e9
"""Bound of a user's parameter, whose physical limits are unknown; it keeps the numbers finite."""


class UserEffect(Effect):
    """Base class of the classes made by `user_effect`."""

    expression: ClassVar[Expression]

    __slots__ = ()

    @property
    def acts(self) -> bool:
        """Whether it does anything: an amplitude is off zero, or a term of the expression has no amplitude."""
        return super().acts or not self.expression.vanishes

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f of the expression, with the errors of single wheels combined into a twist."""
        own = {p.name: np.float64(getattr(self, p.name)) for p in parameters(self)}
        body = self._variables(motion) | own
        f = np.stack([self.expression.added_to((channel,), body) for channel in CHANNELS], axis=1)
        if self.expression.by_wheel:
            track_m = needed_track_m(self.name, motion.track_m)
            right, left = (self._variables(wheel) | own for wheel in wheel_motions(motion, track_m))
            rims = Rims(
                self.expression.added_to(("right", "wheels"), right), self.expression.added_to(("left", "wheels"), left)
            )
            f += body_of(rims, track_m, getattr(self, "heading", "wheels"))
        return TwistError(f, state)

    def _variables(self, motion: Motion) -> dict[str, Any]:
        """Return the values of the variables, and of the previous interval for discontinuous terms."""
        if self.expression.names.isdisjoint(ACCELERATIONS):
            return _values(motion)
        past = {f"{name}{PAST}": value for name, value in _values(motion.just_before).items()}
        return _values(motion.in_step) | past

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the pickling recipe: the class is created at run time and belongs to no module."""
        own = parameters(self)
        values = {p.name: getattr(self, p.name) for p in own}
        words = {word: getattr(self, word) for word in choices(self)}
        return user_effect, (self.name, self.expression.text, values, {p.name: p.unit for p in own}, words)


def _values(motion: Motion) -> dict[str, Any]:
    return {name: getattr(motion, "t_s" if name == "t" else name) for name in VARIABLES}


def user_effect(
    name: str,
    text: str,
    values: Mapping[str, float],
    units: Mapping[str, str] | None = None,
    words: Mapping[str, str] | None = None,
) -> UserEffect:
    """Return the effect of an expression with the given parameter values.

    A parameter that f is affine in is an amplitude, with identity 0; any other is a shape, which a fit holds fixed.
    An expression that adds to single wheels also has the word-valued parameter `heading`, as the library's do.

    name : name of the effect
    text : the expression, as in "yaw += k * v * abs(omega)"
    values : parameters by name
    units : units of parameters by name; by default those that follow from the expression
    words : values of word-valued parameters, such as {"heading": "gyro"}

    Raises
    ------
    EffectError
        If the name or the expression is invalid.
    """
    for word in (name, *values):
        if not _NAME.fullmatch(word) or keyword.iskeyword(word):
            raise EffectError(f"effect {name}: {word!r} cannot be a name; write small letters, digits and _")
    for word in values:
        if word in _TAKEN:
            raise EffectError(f"effect {name}: the parameter {word!r} has the name of something else; call it k")
    units = units or {}
    expression = parse_expression(text, tuple(values))
    linear, words = expression.linear, words or {}
    if words and not expression.by_wheel:
        raise EffectError(
            f"effect {name}: {next(iter(words))} applies to statements that add to {', '.join(SIDES)} only; leave it "
            "out"
        )
    facts = tuple(
        (
            key,
            units.get(key) or expression.units.get(key, ""),
            key in linear,
            0.0 if key in linear else float(value),
            _magnitude(value),
        )
        for key, value in values.items()
    )
    effect = _class_of(name, text, facts)(**values, **words)
    check_bounds(effect)
    return effect


def _magnitude(value: float) -> float:
    return float(10.0 ** np.round(np.log10(abs(value)))) if value and np.isfinite(value) else 0.01


@cache
def _class_of(name: str, text: str, facts: tuple[tuple[str, str, bool, float, float], ...]) -> type[UserEffect]:
    """Return the class of an expression; cached: the same facts give the same class, and equal effects are equal."""
    expression = parse_expression(text, tuple(key for key, *_ in facts))
    fields: list[tuple[str, type, Any]] = [
        (
            key,
            float,
            parameter(
                unit,
                "of the expression",
                low=-LARGEST,
                high=LARGEST,
                typical=typical,
                identity=identity,
                amplitude=amplitude,
            ),
        )
        for key, unit, amplitude, identity, typical in facts
    ]
    if expression.by_wheel:
        fields.append(("heading", str, heading_choice()))
    namespace = {
        "name": name,
        "kind": "effect",
        "summary": "an effect of the user's own",
        "about": About(text, "", "the model file", (), ""),
        "reads_truth": not expression.names.isdisjoint(TRUTH_VARIABLES),
        "rectifies": expression.rectifies,
        "reads_places": not expression.names.isdisjoint(PLACES),
        "needs_track": expression.by_wheel,
        "expression": expression,
        "__doc__": f"f: {text}",
    }
    return dataclasses.make_dataclass(
        f"User_{name}", fields, bases=(UserEffect,), namespace=namespace, frozen=True, slots=True
    )
