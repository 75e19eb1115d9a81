"""Options of every command: -v, -q, --json, --config; printing of results; defaults from odomcorrupt.toml."""

from __future__ import annotations

import functools
import importlib
import json
import os
import pkgutil
import shutil
import sys
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import click
from click.core import ParameterSource

from odomcorrupt import commands
from odomcorrupt.commands._options import Decorator, OutputFile, Setting, added
from odomcorrupt.input_files import TOML_BYTES, parse_toml, read_input
from odomcorrupt.report.plain import finite
from odomcorrupt.result_files import write_file
from odomcorrupt.summary import Summary, wrapped

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from odomcorrupt.api.result import Result

CONFIG = "odomcorrupt.toml"
"""Name of the file of defaults, read if it is in the working directory: for settings only, as it may be anyone's."""
Files: TypeAlias = "Mapping[Path, Callable[[], object]]"
"""Output files of a command and their writers; if a writer returns text, it is printed instead of `wrote FILE`."""
WORDS = "odomcorrupt.words"
"""Key in click's context for the words typed after the command's name."""
_DEFAULTS = "odomcorrupt.defaults"
"""Key in click's context for the name of the file of defaults, whether it was found, and the options it set."""
_WIDTH = 80


class Console(NamedTuple):
    """Prints the results of a command: eight lines, everything, nothing, or JSON."""

    verbose: bool = False
    quiet: bool = False
    as_json: bool = False

    def show(self, result: Result, *, files: Files | None = None, bag: str | None = None) -> None:
        """Print a result.

        result : result to print
        files : output files, written after the verdict is printed and before the suggested next command
        bag : the bag that was written: text goes to stderr, because stdout may carry a bag; JSON to stdout, except
            if the bag is "-"
        """
        brief = "" if self.as_json or self.quiet else result.brief
        details = result.details() if self.verbose and not self.as_json else ""
        self.print(brief, details, result.to_dict() if self.as_json else None, files=files, bag=bag)

    def print(
        self, brief: Summary | str, details: str, values: Any, *, files: Files | None = None, bag: str | None = None
    ) -> None:
        """Print a result that is a summary, a text and values; parameters as of `show`."""
        files, following = files or {}, ""
        err = bag == "-" if self.as_json else bag is not None
        stream = sys.stderr if err else sys.stdout
        columns = shutil.get_terminal_size((_WIDTH, 24)).columns if stream.isatty() else None
        if self.as_json:
            click.echo(json.dumps(finite(values), indent=2, allow_nan=False), err=err)
        elif not self.quiet:
            if self.verbose:
                click.echo(details if columns is None else wrapped(details, columns), err=err)
                brief = "" if isinstance(brief, str) else brief.below(details)
            if not isinstance(brief, str):
                brief, following = brief.parts(min(_WIDTH, columns or _WIDTH), colour=_colours(stream))
            click.echo(brief, err=err, nl=bool(brief))
        for path, write in files.items():
            said = write()
            self.note(said if isinstance(said, str) else f"wrote {path}")
        if following:
            click.echo(following, err=err)

    def note(self, sentence: str) -> None:
        """Print a sentence on stderr, unless with --quiet."""
        if not self.quiet:
            click.echo(sentence, err=True)

    def detail(self, sentence: str) -> None:
        """Print a sentence on stderr with --verbose only."""
        if self.verbose:
            click.echo(sentence, err=True)


def written(path: Path | None, write: Callable[[Path], object]) -> Files:
    """Return an output and its writer in the form of `Console.show`; empty if no path is given."""
    return {} if path is None else {path: lambda: write(path)}


def printed(path: Path | None, text: Callable[[], str]) -> Files:
    """Return an output and the writer of a text that is made when it is written, in the form of `Console.show`."""
    return written(path, lambda to: write_file(to, text()))


def _colours(stream: Any) -> bool:
    """Tell whether a stream supports colours and the user wants them (https://no-color.org)."""
    return bool(stream.isatty()) and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def standard_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add -v, -q, --json and --config; the command receives the first three as one argument, `console`."""

    @functools.wraps(command)
    def with_console(*args: Any, verbose: bool, quiet: bool, as_json: bool, **given: Any) -> Any:
        if quiet and verbose:
            raise click.UsageError("--quiet and --verbose exclude each other; give one of them")
        console = Console(verbose, quiet, as_json)
        ctx = click.get_current_context()
        file, found, names = ctx.meta.get(_DEFAULTS, ("", False, ()))
        used = [name for name in names if ctx.get_parameter_source(name) is ParameterSource.DEFAULT_MAP]
        if used and (found or not quiet):
            click.echo(f"defaults from {file}: {', '.join(used)}", err=True)
        return command(*args, console=console, **given)

    return added(
        click.option("-v", "--verbose", is_flag=True, help="Print the full report."),
        click.option("-q", "--quiet", is_flag=True, help="Print no result."),
        click.option("--json", "as_json", is_flag=True, help="Print JSON: metres, radians, seconds."),
        click.option(
            "--config", type=click.Path(exists=True, dir_okay=False, path_type=Path), is_eager=True,
            expose_value=False, callback=_read_defaults,
            help=f"File with default values of options. [default: {CONFIG}, if it exists]",
        ),
    )(with_console)  # fmt: skip


def typed_words(*without: str) -> list[str]:
    """Return the words typed after the command's name, for use in a suggested next command.

    without : options to omit with their values, by their long spelling; files that were written are always omitted
    """
    ctx = click.get_current_context()
    options = [option for option in ctx.command.params if isinstance(option.type, OutputFile)
               or {*option.opts} & {*without, "--overwrite"}]  # fmt: skip
    left = {word: option for option in options if isinstance(option, click.Option) for word in option.opts}
    kept, rest = [], list(ctx.meta.get(WORDS, ()))
    while rest:
        word = rest.pop(0)
        option = left.get(word.partition("=")[0])
        if option is None:
            kept.append(word)
        elif not option.is_flag and "=" not in word:
            del rest[: option.nargs]
    return kept


def overwrite_option(what: str = "an existing output", *, passed: bool = False) -> Decorator:
    """Return the option that permits replacing outputs; options of type `OutputFile` are checked against it.

    passed : whether the command receives it, because it writes other files, too
    """

    def add(command: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(command)
        def checked(*args: Any, overwrite: bool, **given: Any) -> Any:
            for option in click.get_current_context().command.params:
                path = given.get(option.name or "")
                if isinstance(option.type, OutputFile) and path is not None:
                    option.type.require_writable(path, overwrite=overwrite)
            return command(*args, **given, **({"overwrite": overwrite} if passed else {}))

        return click.option("--overwrite", "--force", "overwrite", is_flag=True, help=f"Replace {what}.")(checked)

    return add


def output_option(metavar: str = "OUTPUT") -> Decorator:
    """Return -o, an alternative to the last argument."""
    return click.option("-o", "output_option", metavar=metavar, type=click.Path(), help=f"The same as {metavar}.")


def chosen_output(argument: str | None, option: str | None, metavar: str = "OUTPUT") -> str:
    """Return the output given by an argument or -o."""
    if argument is not None and option is not None:
        raise click.UsageError(f"{metavar} and -o: both name the output; give one of them")
    chosen = option if argument is None else argument
    if chosen is None:
        raise click.UsageError(f"Missing argument '{metavar}'.")
    return str(chosen)


def _read_defaults(ctx: click.Context, _: click.Parameter, path: Path | None) -> None:
    """Set a command's defaults from a file: top-level keys for all commands that have them, then its own table.

    Raises
    ------
    click.UsageError
        If a key names no option, or the file was found in the working directory and the option is no `Setting`.
    """
    file = Path(CONFIG) if path is None else path
    if ctx.resilient_parsing or (path is None and not file.exists()):
        return
    defaults: dict[str, Any] = {}
    for command, option, key, value in _entries(file, ctx.command):
        if path is None and not isinstance(option, Setting):
            raise click.UsageError(
                f"{file}: {key}: a file found in the working directory sets noise, topics, frames and seeds only; type "
                f"{option.opts[0]}, or name the file: --config {file}"
            )
        if command is ctx.command:
            alphas = option.name == "alpha" and isinstance(value, list)
            defaults[option.name or ""] = " ".join(map(str, value)) if alphas else value
    if defaults:
        ctx.default_map = {**(ctx.default_map or {}), **defaults}
        ctx.meta[_DEFAULTS] = (str(file), path is None, tuple(sorted(defaults)))


def _entries(file: Path, own: click.Command) -> Iterator[tuple[click.Command, click.Option, str, Any]]:
    """Yield the entries of a file of defaults, tables last: a command that has the option, the option, key, value."""
    data = read_input(file, TOML_BYTES, "file of defaults", click.UsageError)
    try:
        table = parse_toml(data.decode())
    except ValueError as error:
        raise click.UsageError(f"{file}: not valid TOML ({error})") from error
    for key, value in table.items():
        if not isinstance(value, dict):
            every = chain([own], map(command_named, command_names()))
            command = next((one for one in every if key.replace("_", "-") in _named(one)), None)
            if command is None:
                raise click.UsageError(f"{file}: {key}: no command has this option")
            yield command, _named(command)[key.replace("_", "-")], key, value
    for name, values in table.items():
        if not isinstance(values, dict):
            continue
        if name not in command_names():
            raise click.UsageError(f"{file}: [{name}] is not a command; there are {', '.join(command_names())}")
        command = own if name == own.name else command_named(name)
        options = _named(command)
        for key, value in values.items():
            if key.replace("_", "-") not in options:
                raise click.UsageError(
                    f"{file}: [{name}] {key}: is not an option; there are {', '.join(sorted(options))}"
                )
            yield command, options[key.replace("_", "-")], f"[{name}] {key}", value


def _named(command: click.Command) -> dict[str, click.Option]:
    """Return a command's options by their long names, without dashes."""
    options = (p for p in command.params if isinstance(p, click.Option) and p.expose_value)
    return {word[2:]: p for p in options for word in p.opts if word.startswith("--")}


@functools.cache
def command_names() -> dict[str, str]:
    """Return command names and their modules; modules whose names begin with _ are not commands."""
    found = sorted(info.name for info in pkgutil.iter_modules(commands.__path__))
    return {name.replace("_", "-"): f"{commands.__name__}.{name}" for name in found if not name.startswith("_")}


def command_named(name: str) -> click.Command:
    """Return a command, importing its module."""
    command: click.Command = importlib.import_module(command_names()[name]).command
    return command
