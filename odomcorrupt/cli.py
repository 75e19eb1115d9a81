"""The command line: a group of commands with `corrupt` as the default.

Commands are found by the names of the modules in `commands`; nothing heavy is imported before a command runs.
"""

from __future__ import annotations

import errno
import gc
import os
import signal
import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import click
from click.shell_completion import CompletionItem

from odomcorrupt import __version__
from odomcorrupt.commands._standard import WORDS, command_named, command_names
from odomcorrupt.errors import OdomCorruptError
from odomcorrupt.extras import explained
from odomcorrupt.standard_streams import install, leave, visible

if TYPE_CHECKING:
    from collections.abc import Sequence

DEFAULT = "corrupt"
_HALF = 1000
"""Half the most characters of an error message."""

_OWN_FLAGS = frozenset({"-h", "--help", "--version"})


class _Group(click.Group):
    """A group that passes the arguments to the default command if the first is not a command."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - click's signature
        """Return the names of the commands."""
        return list(command_names())

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002 - as above
        """Return a command, importing its module."""
        return command_named(cmd_name) if cmd_name in command_names() else None

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Select by the first token: a command, a flag of the group, or else the default command."""
        if args and args[0] not in command_names() and args[0] not in _OWN_FLAGS:
            if not ctx.resilient_parsing:
                _suggest(args[0], alone=len(args) == 1)
            args = [DEFAULT, *args]
        ctx.meta[WORDS] = args[1:]
        return super().parse_args(ctx, args)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Complete commands, and arguments of the default command."""
        found = super().shell_complete(ctx, incomplete)
        default = command_named(DEFAULT)
        sub = click.Context(default, parent=ctx, resilient_parsing=True)
        known = {item.value for item in found}
        found += [item for item in default.shell_complete(sub, incomplete) if item.value not in known]
        if not incomplete.startswith("-"):
            found.append(CompletionItem(incomplete, type="file"))
        return found

    def format_usage(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the usage with and without a command."""
        formatter.write_usage(ctx.command_path, "[OPTIONS] INPUT OUTPUT")
        formatter.write_usage(ctx.command_path, "COMMAND ...", prefix="       ")

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the default command's options, the group's own, and the commands."""
        options = [p for p in command_named(DEFAULT).params if isinstance(p, click.Option)]
        rows = [record for p in (*options, *self.get_params(ctx)) if (record := p.get_help_record(ctx)) is not None]
        with formatter.section("Options"):
            formatter.write_dl(rows)
        self.format_commands(ctx, formatter)


def _suggest(word: str, *, alone: bool) -> None:
    """Raise if a first token is neither a file nor an option, but similar to a command, or the only argument."""
    if word.startswith("-") or Path(word).exists():
        return
    import difflib

    near = difflib.get_close_matches(word, command_names(), 1, 0.75)
    if near:
        raise click.UsageError(f"{word}: no such file, and no such command; did you mean {near[0]}?")
    if alone:
        raise click.UsageError(f"{word}: no such file, and no such command; name a command, or INPUT and OUTPUT")


_HELP = """Add realistic, repeatable drift to the odometry in ROS bags and MCAP; find out what makes your robot drift.

\b
odomcorrupt in.bag out.bag --alpha 0.05 0.02 0.05 0.01 --seed 7
odomcorrupt - - --odom-topic /odom < in.mcap > out.mcap

INPUT and OUTPUT are bags; - is a pipe (MCAP). A bag with the name of a command is given as ./fit."""


@click.group(cls=_Group, help=_HELP, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="odomcorrupt", message="%(prog)s %(version)s")
def cli() -> None:
    """Define the command group."""


def run(args: Sequence[str]) -> int:
    """Run the command line and return its exit code.

    0 done, 1 failed, 2 wrong usage, 3 data lost, 130 interrupted, 141 stdout closed by its reader.
    """
    OdomCorruptError.names_options = True
    try:
        result = cli.main(args=list(args), prog_name="odomcorrupt", standalone_mode=False)
    except ImportError as error:
        if (known := explained(error)) is error:
            raise
        return _report_error(known, args)
    except (click.ClickException, click.Abort, KeyboardInterrupt, OdomCorruptError, OSError, MemoryError) as error:
        return _report_error(error, args)
    finally:
        OdomCorruptError.names_options = False
    return result if isinstance(result, int) else 0


def _report_error(error: BaseException, args: Sequence[str]) -> int:
    """Print an error in one line, and return the exit code."""
    code = 1
    if isinstance(error, click.exceptions.NoArgsIsHelpError):
        error.show()
        code = error.exit_code
    elif isinstance(error, click.ClickException):
        named = args and args[0] in command_names() and args[0] != DEFAULT
        _say(f"{error.format_message()} (see odomcorrupt{f' {args[0]}' if named else ''} --help)")
        code = error.exit_code
    elif isinstance(error.__cause__, EOFError):  # click would report every EOFError as an interruption
        _say(f"a file ended early: {error.__cause__}")
    elif isinstance(error, click.Abort | KeyboardInterrupt):
        kept = str(error.__cause__ or "")
        _say(f"interrupted: {kept or 'nothing unfinished is kept; the same command starts again'}")
        code = 128 + signal.SIGINT
    elif isinstance(error, OdomCorruptError):
        if isinstance(error.__cause__, BrokenPipeError):
            code = 128 + signal.SIGPIPE
        else:
            _say(str(error))
    elif isinstance(error, OSError):
        few = "; allow more (ulimit -n), or use fewer --jobs" if error.errno in (errno.EMFILE, errno.ENFILE) else ""
        _say(("" if error.filename is None else f"{error.filename}: ") + str(error.strerror or error) + few)
    else:
        _say("there is not enough memory for this; a smaller input, or fewer --jobs, takes less")
    return code


def _say(sentence: str) -> None:
    """Print a sentence in one line; of a very long one, which quotes a file, the middle is left out."""
    shown = sentence if len(sentence) <= 2 * _HALF else f"{sentence[:_HALF]} ... {sentence[-_HALF:]}"
    click.echo(f"odomcorrupt: {visible(shown.replace(chr(10), ' '))}", err=True)


def _unwind_on_signals() -> None:
    """Let a kill unwind like an error, so that a half-written output is removed, whenever it comes.

    Python handles a signal that comes just before a system call blocks when that call ends, and ignores exceptions
    within callbacks of weak references: once a second calls are interrupted, and such an exception is raised again.
    """
    lost: list[BaseException] = []

    def handle(number: int, _frame: object) -> None:
        if number != signal.SIGALRM:
            sys.exit(128 + number)
        if lost:
            raise lost.pop()

    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGALRM):
        signal.signal(number, handle)
    signal.setitimer(signal.ITIMER_REAL, 1.0, 1.0)
    keep, ends = lost.append, (SystemExit, KeyboardInterrupt)
    sys.unraisablehook = lambda x: keep(x.exc_value) if isinstance(x.exc_value, ends) else sys.__unraisablehook__(x)


def main() -> NoReturn:
    """Run the command line with the arguments of the program, and exit."""
    install()
    # in one line, without its place in the source
    warnings.showwarning = lambda message, *_where, **_more: _say(f"warning: {message}")
    # the study limits threads of linear algebra itself (`extras.part_of_study`); none at all start faster
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    _unwind_on_signals()
    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:  # as in the background of a shell
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        code = run(sys.argv[1:])
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else 1
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    # the final garbage collection of the interpreter takes a tenth of a short run's time
    gc.freeze()
    leave(code)
