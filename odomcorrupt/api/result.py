"""What every result of the interface can do: be read in eight lines, in full, as values, as a table, as a picture."""

from __future__ import annotations

from abc import ABC, abstractmethod
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any

from odomcorrupt.errors import OdomCorruptError
from odomcorrupt.extras import require

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from odomcorrupt.report.text.summary import Summary

__all__ = ["Result"]


class Result(ABC):
    """A result: `print` shows at most eight lines, the verdict first; `details()` everything that is known."""

    __slots__ = ()

    @abstractmethod
    def summary(self) -> Summary:
        """Return the verdict and what is needed to understand it."""

    @abstractmethod
    def details(self) -> str:
        """Return everything as text."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Return plain values as `--json` prints them: metres, radians, seconds; docs/json.md describes them."""

    @abstractmethod
    def rows(self) -> list[dict[str, Any]]:
        """Return the rows of `to_pandas`, with units in the names of the columns."""

    def draw(self, picture: str) -> Figure:
        """Return a picture of this result.

        Parameters
        ----------
        picture : str
            Its name, where there are several; "" for the usual one.

        Returns
        -------
        matplotlib.figure.Figure

        Raises
        ------
        OdomCorruptError
            Where there is no such picture.

        """
        if picture:
            raise OdomCorruptError(f"{picture}: a {type(self).__name__} has one picture only; leave the name out")
        return self._figure()

    def _figure(self) -> Figure:
        raise OdomCorruptError(f"there is no picture of a {type(self).__name__}")

    def to_pandas(self) -> pd.DataFrame:
        """Return the rows of `rows()` as a pandas data frame; needs the extra `pandas`."""
        require("pandas", "tables need it", "pandas")
        import pandas as pd

        return pd.DataFrame(self.rows())

    def plot(self, path: str | PathLike[str] | None = None, *, picture: str = "", overwrite: bool = True) -> Figure:
        """Return a picture as a matplotlib figure, and write it where a path is given.

        Parameters
        ----------
        path : path, optional
            File to write, .png, .svg or .pdf.
        picture : str
            Which picture, where there are several.
        overwrite : bool
            Whether an existing file is replaced.

        Returns
        -------
        matplotlib.figure.Figure

        Raises
        ------
        OdomCorruptError
            Where there is no such picture, the file's name is not that of a picture, or the file exists and stays.

        """
        require("matplotlib", "pictures need it", "study")
        figure = self.draw(picture)
        if path is not None:
            from odomcorrupt.files import refuse_existing, write_bytes
            from odomcorrupt.report.plots.figure import rendered

            target = Path(fspath(path))
            kind = target.suffix.lower().removeprefix(".")
            if kind not in ("png", "svg", "pdf"):
                raise OdomCorruptError(f"{target}: says no kind of picture; end it in .png, .svg or .pdf")
            refuse_existing(target, overwrite=overwrite)
            write_bytes(target, rendered(figure, kind))
        return figure

    def __str__(self) -> str:
        return self.summary().text()

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.summary().headline}>"

    def _repr_html_(self) -> str:
        return self.summary().html()
