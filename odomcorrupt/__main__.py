"""The console script, and `python -m odomcorrupt`.

Until the command line takes over, Ctrl-C ends the program silently: a console script compiles a regular expression,
and importing the command line takes a tenth of a second. A program started in the background by a shell ignores
Ctrl-C; that is left unchanged.
"""

# Python's `signal` is this module with names as enumerations, which take a tenth of the start-up time to import.
import _signal  # type: ignore[import-not-found]

if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
    _signal.signal(_signal.SIGINT, _signal.SIG_DFL)


def main() -> None:
    """Run the command line."""
    from odomcorrupt.cli import main as run_main  # noqa: PLC0415 - see above

    run_main()


if __name__ == "__main__":
    main()
