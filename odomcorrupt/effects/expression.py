"""Parser of user expressions into numpy functions; no code is ever executed.

    yaw += k * v * abs(omega); along += -c * where(a > 0, a, 0) * abs(v)

A statement adds a rate to truth minus odometry, along (m/s), across (m/s, to the left) or yaw (rad/s), or to the rim
speed (m/s) of the left wheel, the right one or both; expressions of a wheel use that wheel's own motion. Terms are
numbers, the names of `VARIABLES` and of the parameters, + - * / **, comparisons and the functions of `FUNCTIONS`;
attributes, items and other calls are refused. Size, depth and exponents are bounded.

If an expression uses an acceleration, speeds are those in step with it. Discontinuous terms (a comparison, a sign,
the condition of where) then use the previous interval: a law that toggles its own condition would have no solution.
"""

from __future__ import annotations

import ast
import operator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.effects.linearity import affine, vanishes
from odomcorrupt.effects.units import amplitude_unit
from odomcorrupt.errors import EffectError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from odomcorrupt.geometry.se2 import Array

    Term = Callable[[Mapping[str, Array]], Array]

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
        tree = ast.parse("\n".join(line.strip() for line in text.replace(";", "\n").splitlines()))
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
        raise self.wrong(f"{ast.unparse(node)[:40]!r} is not of this language; see `odomcorrupt effects --help`")

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


def _two(
    function: Callable[[Array, Array], Array],
    left: Term,
    right: Term,
) -> Term:
    return lambda names: function(left(names), right(names))
