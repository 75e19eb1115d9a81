"""Expressions of motion as effects: parsed, checked for linearity and units, and made into classes."""

from __future__ import annotations

import ast
import dataclasses
import keyword
import operator
import re
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

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
from odomcorrupt.effects.wheels import Rims, body_of, heading_choice, needed_track_m, wheel_motions
from odomcorrupt.errors import EffectError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from collections.abc import Set as AbstractSet

    from odomcorrupt.geometry.se2 import Array

    Term = Callable[[Mapping[str, Array]], Array]


def affine(node: ast.expr, names: frozenset[str]) -> bool:  # noqa: PLR0911 - one for each kind of term
    """Return whether a term is jointly affine in these parameters: no product of two of them, no function of any."""
    if not _has(node, names) or isinstance(node, ast.Name):
        return True
    match node:
        case ast.UnaryOp(operand=inner):
            return affine(inner, names)
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub(), right=right):
            return affine(left, names) and affine(right, names)
        case ast.BinOp(left=left, op=ast.Mult(), right=right):
            return affine(left, names) and affine(right, names) and not (_has(left, names) and _has(right, names))
        case ast.BinOp(left=left, op=ast.Div(), right=right):
            return affine(left, names) and not _has(right, names)
        case ast.Call(func=ast.Name(id="where"), args=[condition, *either]):
            return not _has(condition, names) and all(affine(term, names) for term in either)
    return False


def vanishes(node: ast.expr, names: frozenset[str]) -> bool:  # noqa: PLR0911 - one for each kind of term
    """Return whether a term is zero if all these parameters are zero."""
    match node:
        case ast.Name(id=name):
            return name in names
        case ast.UnaryOp(operand=inner):
            return vanishes(inner, names)
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub(), right=right):
            return vanishes(left, names) and vanishes(right, names)
        case ast.BinOp(left=left, op=ast.Mult(), right=right):
            return vanishes(left, names) or vanishes(right, names)
        case ast.BinOp(left=left, op=ast.Div()):
            return vanishes(left, names)
        case ast.Call(func=ast.Name(id="where"), args=[_, *either]):
            return all(vanishes(term, names) for term in either)
    return False


def _has(node: ast.expr, names: AbstractSet[str]) -> bool:
    return any(isinstance(part, ast.Name) and part.id in names for part in ast.walk(node))


_UNITS = ("rad", "m", "s")
_PURE = (0, 0, 0)
"""Powers of `_UNITS`: a number without unit."""
_SPEED, _TURN = (0, 1, -1), (1, 0, -1)
_OF = {
    "v": _SPEED, "vy": _SPEED, "omega": _TURN, "a": (0, 1, -2), "alpha": (1, 0, -2), "t": (0, 0, 1), "x": (0, 1, 0),
    "y": (0, 1, 0), "distance": (0, 1, 0), "theta": (1, 0, 0),
}  # fmt: skip
_UNIT_PRESERVING = ("abs", "min", "max", "hypot")
"""Functions with a value in the unit of their arguments; the value of any other has no unit."""


class _Unclear(Exception):  # noqa: N818 - private to this module
    """The unit cannot be derived."""


def amplitude_unit(statements: Sequence[ast.AugAssign], name: str) -> str:
    """Return the unit of a parameter that statements are affine in, e.g. "s^2/m"; "" if none or unclear."""
    for node in statements:
        if _has(node.value, {name}):
            target = _TURN if isinstance(node.target, ast.Name) and node.target.id == "yaw" else _SPEED
            try:
                powers = _times(target, _dimension(node.value, name), -1)
            except _Unclear:
                return ""
            above, below = (
                [_power(u, sign * n) for u, n in zip(_UNITS, powers, strict=True) if sign * n > 0] for sign in (1, -1)
            )
            return " ".join(above or ["1"] * bool(below)) + "".join(f"/{unit}" for unit in below)
    return ""


def _power(unit: str, power: int) -> str:
    return unit if power == 1 else f"{unit}^{power}"


def _times(one: tuple[int, ...], other: tuple[int, ...], power: int = 1) -> tuple[int, ...]:
    return tuple(a + power * b for a, b in zip(one, other, strict=True))


def _dimension(node: ast.expr, name: str) -> tuple[int, ...]:  # noqa: PLR0911 - one for each kind of term
    """Return the powers of `_UNITS` of a term; where it contains a parameter, those of the parameter's factor."""
    match node:
        case ast.Name(id=own):
            return _OF.get(own, _PURE)
        case ast.UnaryOp(operand=inner):
            return _dimension(inner, name)
        case ast.BinOp(left=left, op=ast.Mult() | ast.Div() as op, right=right):
            return _times(_dimension(left, name), _dimension(right, name), 1 if isinstance(op, ast.Mult) else -1)
        case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=int() as power)):
            return _times(_PURE, _dimension(left, name), power)
        case ast.BinOp(left=left, op=ast.Pow()) if _dimension(left, name) != _PURE:
            raise _Unclear
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub(), right=right):
            return _common(name, left, right)
        case ast.Call(func=ast.Name(id="where"), args=[_, *either]):
            return _common(name, *either)
        case ast.Call(func=ast.Name(id="sqrt"), args=[inner]) if _dimension(inner, name) != _PURE:
            raise _Unclear
        case ast.Call(func=ast.Name(id=function), args=args) if function in _UNIT_PRESERVING:
            return _common(name, *args)
    return _PURE


def _common(name: str, *nodes: ast.expr) -> tuple[int, ...]:
    """Return the dimension of the node with the parameter, or the common one: plain numbers take that of the others."""
    own = [node for node in nodes if _has(node, {name})][:1] or nodes
    return next((found for node in own if (found := _dimension(node, name)) != _PURE), _PURE)


CHANNELS = ("along", "across", "yaw")
SIDES = ("left", "right", "wheels")
"""Further targets of a statement: the rim speeds of single wheels, or of both."""
TRUTH_VARIABLES = ("a", "alpha", "x", "y", "theta", "distance")
"""Variables of the true motion; the others are the odometry's."""
PLACES = ("x", "y", "theta")
ACCELERATIONS = ("a", "alpha")
VARIABLES = ("v", "vy", "omega", "t", *TRUTH_VARIABLES)
PAST = " before"
"""Suffix of a variable's name for its value in the previous interval, if that is supplied."""
_ZERO_BELOW = 1e-9
"""Magnitude below which a number counts as zero in sign(), because its sign may be rounding."""
CONSTANTS = {"pi": np.pi}


def _chosen(condition: Array, yes: Array, no: Array) -> Array:
    return np.where(condition != 0.0, yes, no)


def _sign(x: Array) -> Array:
    return np.where(np.abs(x) <= _ZERO_BELOW, 0.0, np.sign(x))


def _folded(function: Callable[[Array, Array], Array], values: tuple[Array, ...]) -> Array:
    out = values[0]
    for value in values[1:]:
        out = function(out, value)
    return out


FUNCTIONS: Mapping[str, tuple[int, int, Callable[..., Array]]] = {
    "sin": (1, 1, np.sin),
    "cos": (1, 1, np.cos),
    "tan": (1, 1, np.tan),
    "exp": (1, 1, np.exp),
    "log": (1, 1, np.log),
    "sqrt": (1, 1, np.sqrt),
    "tanh": (1, 1, np.tanh),
    "abs": (1, 1, np.abs),
    "sign": (1, 1, _sign),
    "atan2": (2, 2, np.arctan2),
    "hypot": (2, 2, np.hypot),
    "min": (2, 8, lambda *x: _folded(np.minimum, x)),
    "max": (2, 8, lambda *x: _folded(np.maximum, x)),
    "where": (3, 3, _chosen),
}
"""Name: fewest arguments, most arguments, numpy function."""
_BINARY: Mapping[type[ast.operator], Callable[[Array, Array], Array]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: np.divide,
}
_COMPARE: Mapping[type[ast.cmpop], Callable[[Array, Array], Array]] = {
    ast.Lt: np.less,
    ast.LtE: np.less_equal,
    ast.Gt: np.greater,
    ast.GtE: np.greater_equal,
}
_MOST_CHARACTERS, _MOST_NODES, _MOST_DEPTH, _HIGHEST_POWER, _LARGEST_NUMBER = 1000, 200, 60, 8.0, 1e12


class Expression(NamedTuple):
    """A parsed expression.

    text : source text
    terms : target of each statement, one of `CHANNELS` and `SIDES`, and its function
    names : all variables and parameters in it
    linear : parameters that f is affine in
    vanishes : whether f is zero if all parameters in `linear` are zero
    rectifies : whether it is not affine in accelerations, so that the effects of their noise do not cancel
    units : units of the parameters in `linear`, derived from their factors; "" if not derivable
    """

    text: str
    terms: tuple[tuple[str, Term], ...]
    names: frozenset[str]
    linear: frozenset[str]
    vanishes: bool
    rectifies: bool
    units: Mapping[str, str]

    @property
    def by_wheel(self) -> bool:
        """Whether a statement adds to the rim speed of single wheels."""
        return any(target in SIDES for target, _ in self.terms)

    def added_to(self, targets: Sequence[str], values: Mapping[str, Array]) -> Array:
        """Return the sum (n,) of the statements for these targets, from the values of all names, (n,) or scalar.

        Raises
        ------
        EffectError
            If the result is not finite.
        """
        total = np.zeros(len(values["v"]))
        with np.errstate(all="ignore"):  # reported below
            for target, term in self.terms:
                if target in targets:
                    total += term(values)
        bad = ~np.isfinite(total)
        if bad.any():
            i = int(np.argmax(bad))
            place = ", ".join(f"{name} = {values[name][i]:g}" for name in VARIABLES if name in self.names)
            raise EffectError(
                f"expression {self.text!r}: not a finite number where {place or 'it is evaluated'}; guard it with "
                "max(), abs() or where()"
            )
        return total


def parse_expression(text: str, parameters: tuple[str, ...]) -> Expression:
    """Return the expression parsed from a text with these parameters.

    Raises
    ------
    EffectError
        If the text is not a list of valid statements.
    """
    reader = _Reader(text, parameters)
    if len(text) > _MOST_CHARACTERS:
        raise reader.wrong(f"{len(text)} characters; {_MOST_CHARACTERS} at most")
    try:
        tree = ast.parse(reader.source)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise reader.wrong("it cannot be read; write as in yaw += k * v * abs(omega)") from None
    terms = tuple(reader.statement(node) for node in tree.body)
    if not terms:
        raise reader.wrong("there is nothing in it; write as in yaw += k * v * abs(omega)")
    idle = [name for name in parameters if name not in reader.names]
    if idle:
        raise reader.wrong(f"parameter {idle[0]} does nothing in it")
    linear: frozenset[str] = frozenset()
    for name in parameters:
        if all(affine(node.value, linear | {name}) for node in reader.statements):
            linear |= {name}
    rectifies = not all(affine(node.value, frozenset(ACCELERATIONS)) for node in reader.statements)
    zero = all(vanishes(node.value, linear) for node in reader.statements)
    units = {name: amplitude_unit(reader.statements, name) for name in linear}
    return Expression(text, terms, frozenset(reader.names), linear, zero, rectifies, units)


class _Reader:
    """Translation of a syntax tree into functions; refuses every unsupported node."""

    def __init__(self, text: str, parameters: tuple[str, ...]) -> None:
        self._text, self._parameters = text, parameters
        self.source = "\n".join(line.strip() for line in text.replace(";", "\n").splitlines())
        self._nodes = 0
        self._jumping = False
        self.names: set[str] = set()
        self.statements: list[ast.AugAssign] = []

    def wrong(self, why: str) -> EffectError:
        text = self._text if len(self._text) <= 80 else f"{self._text[:77]}..."
        return EffectError(f"expression {text!r}: {why}")

    def statement(self, node: ast.stmt) -> tuple[str, Term]:
        targets = (*CHANNELS, *SIDES)
        if not (isinstance(node, ast.AugAssign) and isinstance(node.op, ast.Add) and isinstance(node.target, ast.Name)):
            raise self.wrong(f"each statement must add to one of {', '.join(targets)}, as in yaw += k * v")
        if node.target.id not in targets:
            raise self.wrong(f"{node.target.id!r} cannot be added to; there are {', '.join(targets)}")
        self.statements.append(node)
        return node.target.id, self._term(node.value, 0)

    def _term(self, node: ast.expr, depth: int) -> Term:  # noqa: PLR0911 - one for each kind of term
        self._nodes += 1
        if self._nodes > _MOST_NODES or depth > _MOST_DEPTH:
            raise self.wrong(f"too long or too deep; {_MOST_NODES} terms and {_MOST_DEPTH} levels at most")
        match node:
            case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
                return self._number(value)
            case ast.Name(id=name):
                return self._name(name)
            case ast.UnaryOp(op=ast.USub() | ast.UAdd() as sign, operand=inner):
                value_of = self._term(inner, depth + 1)
                return (lambda names: -value_of(names)) if isinstance(sign, ast.USub) else value_of
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                return self._power(left, right, depth)
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
                return _two(_BINARY[type(op)], self._term(left, depth + 1), self._term(right, depth + 1))
            case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in _COMPARE:
                both = _two(_COMPARE[type(op)], self._lagged(left, depth + 1), self._lagged(right, depth + 1))
                return lambda names: np.where(both(names), 1.0, 0.0)
            case ast.Call(func=ast.Name(id=name), args=args, keywords=[]):
                return self._call(name, args, depth)
        shown = ast.get_source_segment(self.source, node) or ""
        raise self.wrong(f"{shown[:40]!r} is not of this language; see `odomcorrupt effects --help`")

    def _lagged(self, node: ast.expr, depth: int) -> Term:
        """Return a term that decides on a discontinuity: it uses values of the previous interval."""
        was, self._jumping = self._jumping, True
        term = self._term(node, depth)
        self._jumping = was
        return term

    def _number(self, value: float) -> Term:
        if not abs(value) <= _LARGEST_NUMBER:
            raise self.wrong(f"a number is larger than {_LARGEST_NUMBER:g}")
        number = np.asarray(float(value))
        return lambda _names: number

    def _name(self, name: str) -> Term:
        if name in CONSTANTS:
            return self._number(CONSTANTS[name])
        if name not in VARIABLES and name not in self._parameters:
            known = ", ".join((*VARIABLES, *CONSTANTS, *self._parameters))
            raise self.wrong(f"{name!r} is not known; there are {known}, and a parameter needs a value, as in k = 0.01")
        self.names.add(name)
        past = f"{name}{PAST}"
        return (lambda names: names.get(past, names[name])) if self._jumping else lambda names: names[name]

    def _power(self, left: ast.expr, right: ast.expr, depth: int) -> Term:
        sign = 1.0
        if isinstance(right, ast.UnaryOp) and isinstance(right.op, ast.USub):
            sign, right = -1.0, right.operand
        number = right.value if isinstance(right, ast.Constant) else None
        if isinstance(number, bool) or not isinstance(number, (int, float)) or number > _HIGHEST_POWER:
            raise self.wrong(f"an exponent must be a number of {_HIGHEST_POWER:g} at most")
        base, exponent = self._term(left, depth + 1), sign * float(number)
        return lambda names: np.power(base(names), exponent)

    def _call(self, name: str, args: list[ast.expr], depth: int) -> Term:
        if name not in FUNCTIONS:
            raise self.wrong(f"there is no function {name!r}; there are {', '.join(FUNCTIONS)}")
        fewest, most, function = FUNCTIONS[name]
        if not fewest <= len(args) <= most:
            raise self.wrong(f"{name} takes {fewest if fewest == most else f'{fewest} to {most}'} arguments")
        jumping = len(args) if name == "sign" else int(name == "where")
        terms = [(self._lagged if i < jumping else self._term)(arg, depth + 1) for i, arg in enumerate(args)]
        return lambda names: function(*(term(names) for term in terms))


def _two(function: Callable[[Array, Array], Array], left: Term, right: Term) -> Term:
    return lambda names: function(left(names), right(names))


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
            track_m = needed_track_m(self, motion.track_m)
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
    units, words = units or {}, words or {}
    expression = parse_expression(text, tuple(values))
    if words and not expression.by_wheel:
        raise EffectError(
            f"effect {name}: {next(iter(words))} applies to statements that add to {', '.join(SIDES)} only; leave it "
            "out"
        )
    facts = tuple(
        (
            key,
            units.get(key) or expression.units.get(key, ""),
            0.0 if key in expression.linear else float(value),
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
def _class_of(name: str, text: str, facts: tuple[tuple[str, str, float, float], ...]) -> type[UserEffect]:
    """Return the class of an expression; cached: the same facts give the same class, and equal effects are equal."""
    expression = parse_expression(text, tuple(key for key, *_ in facts))
    fields: list[tuple[str, type, Any]] = []
    for key, unit, identity, typical in facts:
        linear = key in expression.linear
        field = parameter(
            unit, "of the expression", low=-LARGEST, high=LARGEST, typical=typical, identity=identity, amplitude=linear
        )
        fields.append((key, float, field))
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
