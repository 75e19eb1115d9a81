"""Building blocks of options: groups, numbers, poses, choices and pictures."""

from __future__ import annotations

from contextlib import contextmanager
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import click

from odomcorrupt.errors import ModelError, OdomCorruptError
from odomcorrupt.extras import require
from odomcorrupt.result_files import refuse_existing, write_bytes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from matplotlib.figure import Figure

FILE = click.Path(dir_okay=False, path_type=Path)
PICTURES = ("png", "svg", "pdf")
Decorator: TypeAlias = "Callable[[Callable[..., Any]], Callable[..., Any]]"


def added(*options: Decorator) -> Decorator:
    """Return a decorator that adds options to a command, listed on its help page in this order."""

    def add(command: Callable[..., Any]) -> Callable[..., Any]:
        for option in reversed(options):
            command = option(command)
        return command

    return add


def one_of(*words: str, among: Sequence[str], text: str, default: str | None = None) -> Decorator:
    """Return an option with a choice of words, by default the first; its help is `text` and the default."""
    chosen = default or among[0]
    return click.option(*words, type=click.Choice(among), default=chosen, help=f"{text} [default: {chosen}]")


class Number(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.5 only
    """A finite number within bounds; unlike FloatRange, it refuses nan and infinity.

    low, high : bounds; high is allowed, and low unless `above`
    unit : description for messages, as in "metres between the wheels"
    """

    name = "float"

    def __init__(
        self, unit: str, low: float = -1e12, high: float = 1e12, *, above: bool = False, else_: str = ""
    ) -> None:
        self._unit, self._low, self._high, self._above = unit, low, high, above
        self._else = f"; {else_}" if else_ else ""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number."""
        try:
            number = float(value)
        except ValueError:
            number = float("nan")
        enough = number > self._low if self._above else number >= self._low
        if not (isfinite(number) and enough and number <= self._high):
            start = f"more than {self._low:g}" if self._above else f"{self._low:g} or more"
            self.fail(f"{value}; write {self._unit}, {start} and at most {self._high:g}{self._else}", param, ctx)
        return number


class Share(Number):
    """A fraction, also accepted in percent: 0.003 or 0.3%."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number."""
        text = str(value).strip()
        number = super().convert(text.removesuffix("%"), param, ctx)
        return number / 100.0 if text.endswith("%") else number


TRACK = Number("metres between the wheels", 0.0, 99.0, above=True, else_="leave it out where it is not known")


class _Pose(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.5 only
    """A pose, "x,y,heading" in metres and radians; the heading may be in degrees, as in 30deg."""

    name = "X,Y,THETA"
    _else = ""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the pose as a tuple of three floats."""
        from odomcorrupt.model.motion_model import parse_alpha

        if not isinstance(value, str):
            return value
        parts = value.split(",")
        try:
            pose = tuple(parse_alpha(part) for part in parts)
        except ModelError:
            pose = ()
        if len(pose) != 3 or "deg" in parts[0] + parts[1]:
            self.fail(f"{value!r} is not a pose; write x,y,heading as in 0.2,0.35,10deg{self._else}", param, ctx)
        return pose


class _Start(_Pose):
    """A pose, or "odom" for the origin of the odometry's frame."""

    name = "X,Y,THETA|odom"
    _else = ", or odom"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the pose as a tuple of three floats, or the word."""
        return value if value == "odom" else super().convert(value, param, ctx)


POSE, START = _Pose(), _Start()


@contextmanager
def usage_errors(kind: type[OdomCorruptError], before: str = "") -> Iterator[None]:
    """Convert errors of one kind to usage errors: exit code 2, with a hint to the command's help."""
    try:
        yield
    except kind as error:
        raise click.UsageError(f"{before}{error}") from error


def need_pictures() -> None:
    """Raise an error with the extra to install if the drawing library is missing."""
    require("matplotlib", "pictures need it", "study")


def picture_kind(path: Path) -> str | None:
    """Return the picture format of a file name, None if it is not a picture."""
    kind = path.suffix.lower().removeprefix(".")
    return kind if kind in PICTURES else None


def check_picture(path: Path | None, *, overwrite: bool) -> None:
    """Refuse a name that is not a picture's or exists already; called before any work is done."""
    if path is None:
        return
    if picture_kind(path) is None:
        raise click.UsageError(f"{path}: ends in {path.suffix or 'nothing'}; write .png, .svg or .pdf")
    need_pictures()
    refuse_existing(path, overwrite=overwrite)


def save_picture(path: Path, figure: Figure) -> None:
    """Write a figure in the format of its file name, completely or not at all."""
    from odomcorrupt.report.plots.figure import rendered

    write_bytes(path, rendered(figure, picture_kind(path) or "png"))
