"""The console script, and `python -m odomcorrupt`.

Until the command line takes over, Ctrl-C ends the program silently: a console script compiles a regular expression,
and importing the command line takes a tenth of a second. A program started in the background by a shell ignores
Ctrl-C; that is left unchanged.

The working directory, which may be a download, is taken off Python's path before any other import. `python -m` and an
empty entry in PYTHONPATH put it there.
"""

# Python's `signal` is this module with names as enumerations, which take a tenth of the start-up time to import.
import _signal  # type: ignore[import-not-found]
import gc
import os
import sys

if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
    _signal.signal(_signal.SIGINT, _signal.SIG_DFL)


def main() -> None:
    """Run the command line."""
    try:
        here = os.getcwd()  # noqa: PTH109 - nothing is imported before
    except OSError:  # it is removed
        here = ""
    # in a checkout of this package, workers of a batch need it
    if not __file__.startswith(f"{here}{os.sep}odomcorrupt{os.sep}"):
        sys.path[:] = [entry for entry in sys.path if entry not in ("", here)]
    os.environ["PYTHONSAFEPATH"] = "1"  # for workers of a batch that start Python again
    # imports create many objects and little garbage
    gc.set_threshold(50_000)
    from odomcorrupt.cli import main as run_main  # noqa: PLC0415 - see above

    run_main()


if __name__ == "__main__":
    main()
