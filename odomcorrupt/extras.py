"""Optional libraries, with an error that states how to install a missing one."""

from __future__ import annotations

from functools import wraps
from importlib import import_module
from typing import TYPE_CHECKING

from odomcorrupt.errors import OdomCorruptError

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import ParamSpec, TypeVar

    P = ParamSpec("P")
    T = TypeVar("T")

_EXTRAS = {
    "matplotlib": ("pictures need it", "study"),
    "pandas": ("tables need it", "pandas"),
    "scipy": ("the study needs it, and a sweep over ranges", "study"),
    "threadpoolctl": ("the study needs it", "study"),
}
"""Purposes of optional libraries, and the extras of this package that include them."""


def require(library: str) -> None:
    """Import an optional library by the name of its module.

    Raises
    ------
    OdomCorruptError
        If it is not installed, with the command to install it.
    """
    try:
        __import__(library)
    except ImportError as error:
        raise _missing(library) from error


def part_of_study(function: Callable[P, T]) -> Callable[P, T]:
    """Return a function that requires the libraries of the study and runs with one thread of linear algebra.

    Threads of a BLAS only wait for each other on matrices as small as those of a drive.
    """

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> T:
        for library in ("scipy", "threadpoolctl"):
            require(library)
        import_module("scipy.linalg")  # its BLAS is not that of NumPy; only a loaded one can be limited
        with import_module("threadpoolctl").threadpool_limits(1, user_api="blas"):
            return function(*args, **kwargs)

    return limited


def explained(error: ImportError) -> ImportError | OdomCorruptError:
    """Return the error for a missing optional library, with the command to install it; any other error unchanged."""
    library = (error.name or "").partition(".")[0]
    return _missing(library) if library in _EXTRAS else error


def _missing(library: str) -> OdomCorruptError:
    purpose, extra = _EXTRAS[library]
    return OdomCorruptError(
        f'{library} is not installed; {purpose}: in a copy of the repository, pip install ".[{extra}]"'
    )
