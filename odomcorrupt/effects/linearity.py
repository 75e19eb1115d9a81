"""Linearity of an expression in its parameters, from its syntax tree."""

from __future__ import annotations

import ast


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


def _has(node: ast.expr, names: frozenset[str]) -> bool:
    return any(isinstance(part, ast.Name) and part.id in names for part in ast.walk(node))
