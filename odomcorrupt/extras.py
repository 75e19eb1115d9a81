"""Optional libraries: what to type where one is missing."""

from __future__ import annotations

from odomcorrupt.errors import OdomCorruptError

__all__ = ["require"]


def require(library: str, purpose: str, extra: str) -> None:
    """Import an optional library, or say how to install it.

    Parameters
    ----------
    library : str
        Name of the module.
    purpose : str
        What needs it, as in "pictures need it".
    extra : str
        Extra of this package that brings it: "study", "dask" or "pandas".

    Raises
    ------
    OdomCorruptError
        Where it is not installed.

    """
    try:
        __import__(library)
    except ImportError as error:
        raise OdomCorruptError(
            f'{library} is not installed; {purpose}: in a copy of the repository, pip install ".[{extra}]"'
        ) from error
