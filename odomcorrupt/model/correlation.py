"""Correlation of the errors of a fit's parameters.

A wheel scale and a wheelbase fitted to one drive are uncertain along one direction, not in a whole box. Robots drawn
from the standard errors alone would therefore differ more than the data allow.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from odomcorrupt.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Mapping, Sequence

    from odomcorrupt.geometry.se2 import Array

MOST = 64
"""Largest number of parameters accepted; no fit has more."""

_DIGITS = 4


@dataclass(frozen=True, slots=True)
class Correlation:
    """Correlations of n parameters' errors.

    names : (n,) as in a model's standard errors: "rot_trans", "wheelbase.e"
    matrix : (n, n) rows of numbers from -1 to 1, symmetric, positive semi-definite
    """

    names: tuple[str, ...] = ()
    matrix: tuple[tuple[float, ...], ...] = ()

    def __len__(self) -> int:
        return len(self.names)

    @classmethod
    def of_covariance(cls, names: Sequence[str], covariance: Array) -> Correlation:
        """Return the correlations in a covariance (n, n); parameters without a variance are left out."""
        own = np.flatnonzero(np.diag(covariance) > 0.0)
        deviation = np.sqrt(np.diag(covariance)[own])
        matrix = np.clip(covariance[np.ix_(own, own)] / np.outer(deviation, deviation), -1.0, 1.0)
        np.fill_diagonal(matrix, 1.0)
        rounded = np.round((matrix + matrix.T) / 2.0, _DIGITS) + 0.0  # no zero below zero
        return cls(tuple(names[i] for i in own.tolist()), tuple(map(tuple, rounded.tolist())))

    @classmethod
    def from_table(cls, table: Mapping[str, Any], known: Container[str]) -> Correlation:
        """Return the correlation in a model file's [fit.correlation]; `known` are the parameters with a standard error.

        If effects or coefficients of the file were edited by hand, the table may name parameters that no longer exist.
        Then the table is ignored with a warning.

        Raises
        ------
        ModelError
            If the table is malformed or its matrix is not a correlation matrix.
        """
        for key in table:
            if key not in ("parameters", "matrix"):
                raise ModelError(f"[fit.correlation]: unknown key {key!r}; known are parameters, matrix")
        names, rows = table.get("parameters", []), table.get("matrix", [])
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise ModelError('fit.correlation.parameters: write a list of names, as in ["rot_trans", "wheelbase.e"]')
        if len(names) > MOST or len(set(names)) < len(names):
            raise ModelError(f"fit.correlation.parameters: {len(names)} names; at most {MOST}, each once")
        matrix = _matrix(rows, len(names))
        lowest = float(np.linalg.eigvalsh(matrix)[0]) if len(names) else 0.0
        # tolerance below zero for eigenvalues of a matrix rounded in a file
        if lowest < -1e-3 * len(names):
            raise ModelError(
                f"fit.correlation.matrix: it is not a correlation matrix (its smallest eigenvalue is {lowest:.3g}, "
                "below 0); move its numbers towards 0"
            )
        gone = [name for name in names if name not in known]
        if gone:
            warnings.warn(
                f"[fit.correlation] is left out: {', '.join(gone)} has no standard error in [noise] or [[effect]] "
                "(edited by hand?); delete the table, or fit again",
                stacklevel=2,
            )
            return cls()
        return cls(tuple(names), tuple(map(tuple, matrix.tolist())))

    def among(self, names: Iterable[str]) -> Correlation:
        """Return the submatrix of these names, in their order; unknown names are left out."""
        where = {name: i for i, name in enumerate(self.names)}
        own = [name for name in names if name in where]
        return Correlation(
            tuple(own), tuple(tuple(self.matrix[where[one]][where[other]] for other in own) for one in own)
        )

    def groups(self) -> list[tuple[str, ...]]:
        """Return groups of names connected, directly or indirectly, by correlations; single names are left out."""
        left = list(range(len(self)))
        found = []
        while left:
            group, edge = [left[0]], [left.pop(0)]
            while edge:
                row = self.matrix[edge.pop()]
                near = [i for i in left if row[i]]
                left = [i for i in left if i not in near]
                group += near
                edge += near
            if len(group) > 1:
                found.append(tuple(self.names[i] for i in sorted(group)))
        return found

    def factor(self) -> list[list[float]]:
        """Return L (n, n), lower triangular with unit rows: L z has this correlation for standard normal z.

        If rounding made the matrix indefinite, negative pivots count as zero. Plain loops in a fixed order give the
        same bits on every machine.
        """
        n = len(self)
        rows = [[0.0] * n for _ in range(n)]
        for i in range(n):
            for j in range(i):
                rest = self.matrix[i][j] - math.fsum(rows[i][k] * rows[j][k] for k in range(j))
                rows[i][j] = rest / rows[j][j] if rows[j][j] > 1e-6 else 0.0
            left = 1.0 - math.fsum(value * value for value in rows[i][:i])
            rows[i][i] = math.sqrt(max(left, 0.0))
            length = math.sqrt(math.fsum(value * value for value in rows[i][: i + 1]))
            rows[i] = [value / length for value in rows[i]]
        return rows

    def lines(self) -> list[str]:
        """Return [fit.correlation] as lines of TOML: names, and one row of the matrix per name."""
        if len(self) < 2:
            return []
        names = ", ".join(f'"{name}"' for name in self.names)
        pairs = zip(self.names, self.matrix, strict=True)
        rows = [f"  [{', '.join(f'{value:.{_DIGITS}f}' for value in row)}],  # {name}" for name, row in pairs]
        return ["", "[fit.correlation]", f"parameters = [{names}]", "matrix = [", *rows, "]"]


def _matrix(rows: Any, n: int) -> Array:
    """Return rows of numbers (n, n) as an array, symmetric with ones on its diagonal."""
    square = isinstance(rows, list) and len(rows) == n and all(isinstance(row, list) and len(row) == n for row in rows)
    if not square:
        raise ModelError(f"fit.correlation.matrix: it must have {n} rows of {n} numbers, one per parameter")
    for row in rows:
        for value in row:
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= 1.0:
                raise ModelError(f"fit.correlation.matrix: {value!r}; write numbers from -1 to 1")
    matrix = np.array(rows, dtype=np.float64).reshape(n, n)
    if not (np.array_equal(matrix, matrix.T) and (np.diag(matrix) == 1.0).all()):
        raise ModelError("fit.correlation.matrix: it must be symmetric, with 1 on its diagonal")
    return matrix
