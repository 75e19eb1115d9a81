"""Optional libraries, with an error that states how to install a missing one."""

from __future__ import annotations

from odomcorrupt.errors import OdomCorruptError


def require(library: str, purpose: str, extra: str) -> None:
    """Import an optional library; if it is missing, raise an error with the command to install it.

    library : name of the module
    purpose : purpose of the library, as in "pictures need it"
    extra : extra of this package that includes it: "study", "dask" or "pandas"

    Raises
    ------
    OdomCorruptError
        If it is not installed.
    """
    try:
        __import__(library)
    except ImportError as error:
        raise OdomCorruptError(
            f'{library} is not installed; {purpose}: in a copy of the repository, pip install ".[{extra}]"'
        ) from error
