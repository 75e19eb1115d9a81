"""Optional libraries, with an error that states how to install a missing one."""

from __future__ import annotations

from odomcorrupt.errors import OdomCorruptError

_EXTRAS = {
    "matplotlib": ("pictures need it", "study"),
    "pandas": ("tables need it", "pandas"),
    "scipy": ("the study needs it", "study"),
}
"""Purposes of optional libraries, and the extras of this package that include them."""


def require(library: str, purpose: str = "") -> None:
    """Import an optional library; if it is missing, raise an error with the command to install it.

    library : name of the module
    purpose : purpose of the library, if it is not the usual one, as in "pictures need it"

    Raises
    ------
    OdomCorruptError
        If it is not installed.
    """
    try:
        __import__(library)
    except ImportError as error:
        raise _missing(library, purpose) from error


def explained(error: ImportError) -> ImportError | OdomCorruptError:
    """Return the error for a missing optional library, with the command to install it; any other error unchanged."""
    library = (error.name or "").partition(".")[0]
    return _missing(library) if library in _EXTRAS else error


def _missing(library: str, purpose: str = "") -> OdomCorruptError:
    usual, extra = _EXTRAS[library]
    return OdomCorruptError(
        f'{library} is not installed; {purpose or usual}: in a copy of the repository, pip install ".[{extra}]"'
    )
