"""The console script, and `python -m odomcorrupt`.

From here on until the command line takes over, Ctrl-C ends the program without a word: a console script compiles a
regular expression, and the command line is imported, for a tenth of a second. A shell that starts a program in the
background has it ignore Ctrl-C; that stays.
"""

# Python's `signal` is this with names as enumerations, which take a tenth of the program's start to import.
import _signal  # type: ignore[import-not-found]

if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
    _signal.signal(_signal.SIGINT, _signal.SIG_DFL)

__all__ = ["main"]


def main() -> None:
    """Run the command line."""
    from odomcorrupt.cli import main as run_main  # noqa: PLC0415 - see above

    run_main()


if __name__ == "__main__":
    main()
