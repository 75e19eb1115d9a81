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
from odomcorrupt.result_files import refuse_existing

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

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


def typed_effects(ctx: click.Context, option: click.Parameter, effects: tuple[str, ...]) -> tuple[str, ...]:
    """Return effects as NAME:KEY=VALUE,...; code, as in my_file.Wobble, only if typed, not from a file of defaults."""
    for text in effects if ctx.get_parameter_source(option.name or "") is ParameterSource.DEFAULT_MAP else ():
        name = text.partition(":")[0]
        if "." in name and "=" not in name:
            raise click.BadParameter(f"{text}: names code, which a file of defaults may not; type it: --effect {text}")
    return effects


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


def number(
    unit: str, low: float = -1e12, high: float = 1e12, *, above: bool = False, share: bool = False, else_: str = ""
) -> Callable[[object], float]:
    """Return a type of finite numbers within bounds; unlike FloatRange, it refuses nan and infinity.

    unit : description for messages, as in "metres between the wheels"
    low, high : bounds; high is allowed, and low unless `above`
    share : whether it is a fraction that is also accepted in percent: 0.003 or 0.3%
    else_ : way out, for messages
    """

    def read(value: object) -> float:
        text = str(value).strip().removesuffix("%") if share else str(value)
        try:
            found = float(text)
        except ValueError:
            found = float("nan")
        enough = found > low if above else found >= low
        if not (isfinite(found) and enough and found <= high):
            start = f"more than {low:g}" if above else f"{low:g} or more"
            said = f"{text}; write {unit}, {start} and at most {high:g}{f'; {else_}' if else_ else ''}"
            raise click.BadParameter(said)
        return found / 100.0 if share and str(value).strip().endswith("%") else found

    read.__name__ = "float"  # click shows it on help pages
    return read


TRACK = number("metres between the wheels", 0.0, 10.0, above=True, else_="42.3 cm are 0.423; leave it out if unknown")


def pose(value: Any, else_: str = "") -> Any:
    """Return a pose, "x,y,heading" in metres and radians, as three floats; the heading may be in degrees, as 30deg."""
    from odomcorrupt.model.motion_model import parse_alpha

    if not isinstance(value, str):
        return value
    parts = value.split(",")
    try:
        found = tuple(parse_alpha(part) for part in parts)
    except ModelError:
        found = ()
    if len(found) != 3 or "deg" in parts[0] + parts[1]:
        raise click.BadParameter(f"{value!r} is not a pose; write x,y,heading as in 0.2,0.35,10deg{else_}")
    # a full turn: a larger heading without a unit is most likely in degrees
    if abs(found[2]) > 6.2832 and "deg" not in parts[2]:
        raise click.BadParameter(f"{value!r} has a heading of {found[2]:g} rad; write {found[2]:g}deg for degrees")
    return found


def start(value: Any) -> Any:
    """Return a pose, or "odom" for the origin of the odometry's frame."""
    return value if value == "odom" else pose(value, ", or odom")


pose.__name__, start.__name__ = "X,Y,THETA", "X,Y,THETA|odom"


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
