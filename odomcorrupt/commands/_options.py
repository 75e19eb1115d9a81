"""Building blocks of options: groups, numbers, poses, choices and pictures."""

from __future__ import annotations

import functools
from contextlib import contextmanager
from importlib import import_module
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import click
from click.core import ParameterSource
from click.shell_completion import CompletionItem

from odomcorrupt.errors import ModelError, OdomCorruptError
from odomcorrupt.extras import require
from odomcorrupt.result_files import refuse_existing, write_bytes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from matplotlib.figure import Figure

FILE = click.Path(dir_okay=False, path_type=Path)
Decorator: TypeAlias = "Callable[[Callable[..., Any]], Callable[..., Any]]"


class Setting(click.Option):
    """An option that a file of defaults found in the working directory may set: noise, topic, frame, seed.

    Such a file may come with a download. So no option may be one whose value names a file, a host or code, replaces or
    adds output, raises a limit, or asks for work.
    """


setting = functools.partial(click.option, cls=Setting)
"""Adds a `Setting`, as `click.option` adds an option."""


def completing(module: str, table: str, *, files: bool = False) -> Callable[..., list[CompletionItem]]:
    """Return a shell completion over the names in a module's table, and files; the module is imported on use."""

    def complete(_ctx: click.Context, _param: click.Parameter, typed: str) -> list[CompletionItem]:
        names = getattr(import_module(f"odomcorrupt.{module}"), table)
        found = [CompletionItem(name) for name in (names() if callable(names) else names) if name.startswith(typed)]
        return [*found, CompletionItem(typed, type="file")] if files else found

    return complete


MODELS = completing("model.presets", "PRESETS", files=True)
EFFECTS = completing("effects", "registry")


class EffectText(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.5 only
    """An effect as NAME:KEY=VALUE,...; code, as in my_file.Wobble, only if typed, not from a file of defaults."""

    name = "text"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Return the text."""
        text = str(value)
        source = None if ctx is None or param is None else ctx.get_parameter_source(param.name or "")
        name = text.partition(":")[0]
        if source is ParameterSource.DEFAULT_MAP and "." in name and "=" not in name:
            self.fail(f"{text}: names code, which a file of defaults may not; type it: --effect {text}", param, ctx)
        return text


def added(*options: Decorator) -> Decorator:
    """Return a decorator that adds options to a command, listed on its help page in this order."""

    def add(command: Callable[..., Any]) -> Callable[..., Any]:
        for option in reversed(options):
            command = option(command)
        return command

    return add


def valued(
    *words: str,
    text: str,
    kind: Any = None,
    among: Sequence[str] = (),
    default: float | str | None = None,
    metavar: str | None = None,
    cls: type[click.Option] = click.Option,
) -> Decorator:
    """Return an option with a default, which its help states after `text`; of a choice of words it is the first one.

    kind, among : type of the value, or the words to choose from
    """
    chosen = among[0] if default is None else default
    said = f"{chosen:g}" if isinstance(chosen, float) else chosen
    return click.option(
        *words, cls=cls, type=click.Choice(among) if among else kind, default=chosen, metavar=metavar,
        help=f"{text} [default: {said}]",
    )  # fmt: skip


PICTURES = ("png", "svg", "pdf")


def kind_of(path: Path) -> str:
    """Return the suffix of a file name in lower case, without its dot."""
    return path.suffix.lower().removeprefix(".")


class OutputFile(click.Path):
    """A file that a command writes; `overwrite_option` refuses one that cannot be written before any work is done.

    kinds : suffixes that its name may have, without the dot; () for all
    drawn : whether it has pictures, which the drawing library makes
    """

    def __init__(self, *kinds: str, drawn: bool = False) -> None:
        super().__init__(dir_okay=False, path_type=Path)
        self._kinds, self._drawn = kinds, drawn

    def require_writable(self, path: Path, *, overwrite: bool) -> None:
        """Raise an error if a file has another suffix, exists already, or the drawing library is missing."""
        kind = kind_of(path)
        if self._kinds and kind not in self._kinds:
            wanted = " or .".join(", .".join(self._kinds).rsplit(", .", 1))
            raise click.UsageError(f"{path}: ends in {path.suffix or 'nothing'}; write .{wanted}")
        if self._drawn or kind in PICTURES:
            require("matplotlib")
        refuse_existing(path, overwrite=overwrite)


seed_option = setting(
    "--seed", type=click.IntRange(0), metavar="N", help="Seed of all draws. [default: drawn, and printed]"
)
run_options = added(
    seed_option,
    valued("--run", kind=click.IntRange(0), default=0, metavar="N", text="Number of the run under this seed."),
)
"""Add the options of the draws: their seed, and the run under it."""

OUTPUT, PICTURE, PAGE = OutputFile(), OutputFile(*PICTURES), OutputFile(drawn=True)


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


TRACK = Number("metres between the wheels", 0.0, 10.0, above=True, else_="42.3 cm are 0.423; leave it out if unknown")


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
        # a full turn: a larger heading without a unit is most likely in degrees
        if abs(pose[2]) > 6.2832 and "deg" not in parts[2]:
            self.fail(f"{value!r} has a heading of {pose[2]:g} rad; write {pose[2]:g}deg for degrees", param, ctx)
        return pose


class _Start(_Pose):
    """A pose, or "odom" for the origin of the odometry's frame."""

    name = "X,Y,THETA|odom"
    _else = ", or odom"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the pose as a tuple of three floats, or the word."""
        return value if value == "odom" else super().convert(value, param, ctx)


POSE, START = _Pose(), _Start()


def words_of(option: click.Parameter, value: Any) -> Iterator[str]:
    """Yield the words that give an option its value; none for no value."""
    if value is None:
        return
    for one in value if option.multiple else (value,):
        parts = one if option.nargs > 1 else (",".join(map(repr, one)),) if isinstance(one, tuple) else (one,)
        yield option.opts[0]
        yield from (repr(part).removesuffix(".0") if isinstance(part, float) else str(part) for part in parts)


@contextmanager
def usage_errors(kind: type[OdomCorruptError], before: str = "") -> Iterator[None]:
    """Convert errors of one kind to usage errors: exit code 2, with a hint to the command's help."""
    try:
        yield
    except kind as error:
        raise click.UsageError(f"{before}{error}") from error


def save_picture(path: Path, figure: Figure) -> None:
    """Write a figure in the format of its file name, completely or not at all."""
    from odomcorrupt.report.plots.figure import rendered

    write_bytes(path, rendered(figure, kind_of(path)))
