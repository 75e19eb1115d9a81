"""Effects that a user writes as an expression in a model file: each becomes a class like those of the library."""

from __future__ import annotations

import dataclasses
import keyword
import re
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, check_bounds, parameter, parameters
from odomcorrupt.effects.expression import (
    CHANNELS,
    CONSTANTS,
    FUNCTIONS,
    TRUTH_VARIABLES,
    VARIABLES,
    Expression,
    parse_expression,
)
from odomcorrupt.errors import EffectError

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["UserEffect", "user_effect"]

_NAME = re.compile(r"[a-z][a-z0-9_]{0,59}")
_TAKEN = {*VARIABLES, *CONSTANTS, *FUNCTIONS, *CHANNELS, "name", "expression"}
_FAR = 1e9
"""Nobody knows what is physically possible for a user's parameter; this keeps it a number."""


class UserEffect(Effect):
    """What the classes made by `user_effect` have in common."""

    expression: ClassVar[Expression]

    __slots__ = ()

    @property
    def acts(self) -> bool:
        """Whether it does anything: an amplitude is off zero, or something in it has no amplitude."""
        return super().acts or not self.expression.vanishes

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: the expression."""
        values = {name: getattr(motion, "t_s" if name == "t" else name) for name in VARIABLES}
        values |= {p.name: np.float64(getattr(self, p.name)) for p in parameters(self)}
        return TwistError(self.expression.rates(values), state)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how to make it again: its class has no place in any module."""
        own = parameters(self)
        values = {p.name: getattr(self, p.name) for p in own}
        return user_effect, (self.name, self.expression.text, values, {p.name: p.unit for p in own})


def user_effect(
    name: str, text: str, values: Mapping[str, float], units: Mapping[str, str] | None = None
) -> UserEffect:
    """Return the effect of an expression, with the values of its parameters.

    A parameter that f is affine in is an amplitude, 0 where it does nothing; any other is a shape, which a fit holds.

    Raises
    ------
    EffectError
        For a name that cannot be one, or an expression that is none.

    """
    for word in (name, *values):
        if not _NAME.fullmatch(word) or keyword.iskeyword(word):
            raise EffectError(f"effect {name}: {word!r} cannot be a name; write small letters, digits and _")
    for word in values:
        if word in _TAKEN:
            raise EffectError(f"effect {name}: the parameter {word!r} has the name of something else; call it k")
    units = units or {}
    linear = parse_expression(text, tuple(values)).linear
    facts = tuple(
        (key, units.get(key, ""), key in linear, 0.0 if key in linear else float(value), _magnitude(value))
        for key, value in values.items()
    )
    effect = _class_of(name, text, facts)(**values)
    check_bounds(effect)
    return effect


def _magnitude(value: float) -> float:
    return float(10.0 ** np.round(np.log10(abs(value)))) if value and np.isfinite(value) else 0.01


@cache
def _class_of(name: str, text: str, facts: tuple[tuple[str, str, bool, float, float], ...]) -> type[UserEffect]:
    """Return the class of an expression; the same again for the same facts, so that equal effects are equal."""
    expression = parse_expression(text, tuple(key for key, *_ in facts))
    fields = [
        (
            key,
            float,
            parameter(
                unit, "of the expression", low=-_FAR, high=_FAR, typical=typical, identity=identity, amplitude=amplitude
            ),
        )
        for key, unit, amplitude, identity, typical in facts
    ]
    namespace = {
        "name": name,
        "kind": "effect",
        "summary": "an effect of the user's own",
        "about": About(text, "", "the model file", (), ""),
        "reads_truth": not expression.names.isdisjoint(TRUTH_VARIABLES),
        "expression": expression,
        "__doc__": f"f: {text}",
    }
    return dataclasses.make_dataclass(
        f"User_{name}", fields, bases=(UserEffect,), namespace=namespace, frozen=True, slots=True
    )
