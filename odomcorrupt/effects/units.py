"""Units of an expression's amplitudes, derived from their factors: k of yaw += k * v is in rad/m."""

from __future__ import annotations

import ast
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Sequence


class _Dimension(NamedTuple):
    """Powers of metres, radians and seconds."""

    m: int = 0
    rad: int = 0
    s: int = 0

    def times(self, other: _Dimension, power: int = 1) -> _Dimension:
        return _Dimension(*(mine + power * its for mine, its in zip(self, other, strict=True)))


_PURE = _Dimension()
_SPEED, _TURN = _Dimension(m=1, s=-1), _Dimension(rad=1, s=-1)
_OF = {
    "v": _SPEED, "vy": _SPEED, "omega": _TURN, "a": _Dimension(m=1, s=-2), "alpha": _Dimension(rad=1, s=-2),
    "t": _Dimension(s=1), "x": _Dimension(m=1), "y": _Dimension(m=1), "distance": _Dimension(m=1),
    "theta": _Dimension(rad=1),
}  # fmt: skip
_UNIT_PRESERVING = ("abs", "min", "max", "hypot")
"""Functions with a value in the unit of their arguments; the value of any other has no unit."""


class _Unclear(Exception):  # noqa: N818 - private to this module
    """The unit cannot be derived."""


def amplitude_unit(statements: Sequence[ast.AugAssign], name: str) -> str:
    """Return the unit of a parameter that statements are affine in, e.g. "s^2/m"; "" if none or unclear."""
    for node in statements:
        if _has(node.value, name):
            target = _TURN if isinstance(node.target, ast.Name) and node.target.id == "yaw" else _SPEED
            try:
                return _written(target.times(_factor_of(node.value, name), -1))
            except _Unclear:
                return ""
    return ""


def _has(node: ast.AST, name: str) -> bool:
    return any(isinstance(inner, ast.Name) and inner.id == name for inner in ast.walk(node))


def _factor_of(node: ast.expr, name: str) -> _Dimension:
    """Return the dimension of the parameter's factor."""
    match node:
        case ast.Name(id=own) if own == name:
            return _PURE
        case ast.UnaryOp(operand=inner):
            return _factor_of(inner, name)
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub(), right=right):
            return _factor_of(left if _has(left, name) else right, name)
        case ast.BinOp(left=left, op=ast.Mult(), right=right):
            with_it, other = (left, right) if _has(left, name) else (right, left)
            return _factor_of(with_it, name).times(_dimension(other))
        case ast.BinOp(left=left, op=ast.Div(), right=right) if not _has(right, name):
            return _factor_of(left, name).times(_dimension(right), -1)
        case ast.Call(func=ast.Name(id="where"), args=[_, yes, no]):
            return _factor_of(yes if _has(yes, name) else no, name)
    raise _Unclear


def _dimension(node: ast.expr) -> _Dimension:  # noqa: PLR0911 - one for each kind of term
    match node:
        case ast.Name(id=own):
            return _OF.get(own, _PURE)
        case ast.UnaryOp(operand=inner):
            return _dimension(inner)
        case ast.BinOp(left=left, op=ast.Mult(), right=right):
            return _dimension(left).times(_dimension(right))
        case ast.BinOp(left=left, op=ast.Div(), right=right):
            return _dimension(left).times(_dimension(right), -1)
        case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=int() as power)):
            return _PURE.times(_dimension(left), power)
        case ast.BinOp(left=left, op=ast.Pow()) if _dimension(left) != _PURE:
            raise _Unclear
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub(), right=right):
            return _first(left, right)
        case ast.Call(func=ast.Name(id=function), args=args):
            return _called(function, args)
    return _PURE


def _called(function: str, args: Sequence[ast.expr]) -> _Dimension:
    if function == "where":
        return _first(*args[1:])
    if function == "sqrt" and _dimension(args[0]) != _PURE:
        raise _Unclear
    return _first(*args) if function in _UNIT_PRESERVING else _PURE


def _first(*nodes: ast.expr) -> _Dimension:
    """Return the common dimension of several nodes: plain numbers take that of the others."""
    return next((d for d in map(_dimension, nodes) if d != _PURE), _PURE)


def _written(dimension: _Dimension) -> str:
    powers = dimension._asdict()
    above = [_power(unit, powers[unit]) for unit in ("rad", "m", "s") if powers[unit] > 0]
    below = [_power(unit, -powers[unit]) for unit in ("rad", "m", "s") if powers[unit] < 0]
    if not above and not below:
        return ""
    return " ".join(above or ["1"]) + "".join(f"/{unit}" for unit in below)


def _power(unit: str, power: int) -> str:
    return unit if power == 1 else f"{unit}^{power}"
