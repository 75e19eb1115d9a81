"""Base class of all results: a short summary, full text, plain values, a table and a figure."""

from __future__ import annotations

import shlex
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

from odomcorrupt.errors import OdomCorruptError
from odomcorrupt.extras import require
from odomcorrupt.report.plain import finite
from odomcorrupt.result_files import write_new
from odomcorrupt.summary import Line, command_line

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from odomcorrupt.summary import Summary


@dataclass(frozen=True, slots=True, repr=False, kw_only=True)
class Result(ABC):
    """A result: `print` shows at most eight lines, the verdict first; `details()` is the full text.

    following : suggested next commands, a line each, which `print` shows last; "" for none
    """

    following: str = ""
    schema: ClassVar[int] = 2

    @abstractmethod
    def summary(self) -> Summary:
        """Return the verdict and the lines needed to understand it."""

    def details(self) -> str:
        """Return the full text: the summary unabridged, and tables if there are any."""
        return "\n\n".join(filter(None, (self.summary().full(), self._tables())))

    def _tables(self) -> str:
        return ""

    def to_dict(self) -> dict[str, Any]:
        """Return plain values as printed by `--json`: metres, radians, seconds; see docs/json.md."""
        return {"schema": self.schema, **finite(self._values())}

    @abstractmethod
    def _values(self) -> dict[str, Any]:
        """Return the values of `to_dict` by name; numbers may be numpy's, and unknown or infinite."""

    def rows(self) -> list[dict[str, Any]]:
        """Return the rows of `to_pandas`, with units in the column names; by default one row with all values."""
        return [self._values()]

    def then(self, *words: object) -> Self:
        """Return this result with one more suggested next command.

        words : words of the command; none for no command
        """
        return replace(self, following="\n".join(filter(None, (self.following, shlex.join(map(str, words))))))

    @property
    def brief(self) -> Summary:
        """The summary with the suggested next command."""
        summary = self.summary()
        first, *others = self.following.split("\nodomcorrupt ")
        more = (Line("", f"odomcorrupt {one}", "command") for one in others)
        return summary._replace(lines=(*summary.lines, command_line(first), *more))

    def draw(self, picture: str) -> Figure:
        """Return a figure of this result.

        picture : name of the figure, if there are several; "" for the default one

        Raises
        ------
        OdomCorruptError
            If there is no such figure.
        """
        if picture:
            raise OdomCorruptError(f"{picture}: the class {type(self).__name__} has no pictures by name; leave it out")
        return self._figure()

    def _figure(self) -> Figure:
        raise OdomCorruptError(f"there is no picture of a result of class {type(self).__name__}")

    def to_pandas(self) -> pd.DataFrame:
        """Return the rows of `rows()` as a pandas data frame; needs the extra `pandas`."""
        require("pandas")
        import pandas as pd

        return pd.DataFrame(self.rows())

    def plot(self, path: str | PathLike[str] | None = None, *, picture: str = "", overwrite: bool = True) -> Figure:
        """Return a matplotlib figure, and write it if a path is given.

        path : file to write, .png, .svg or .pdf
        picture : name of the figure, if there are several
        overwrite : whether an existing file is replaced

        Raises
        ------
        OdomCorruptError
            If there is no such figure, the name is not that of a picture file, or the file exists and is not replaced.
        """
        require("matplotlib")
        figure = self.draw(picture)
        if path is not None:
            from odomcorrupt.report.plots.figure import rendered

            target = Path(fspath(path))
            kind = target.suffix.lower().removeprefix(".")
            if kind not in ("png", "svg", "pdf"):
                raise OdomCorruptError(f"{target}: does not name a picture format; end it in .png, .svg or .pdf")
            write_new(target, rendered(figure, kind), overwrite=overwrite)
        return figure

    def __str__(self) -> str:
        return self.brief.text()

    def __repr__(self) -> str:
        verdict = self.summary().lines[0]
        return f"<{type(self).__name__}: {' '.join(filter(None, verdict[:2]))}>"

    def _repr_html_(self) -> str:
        return self.brief.html()
