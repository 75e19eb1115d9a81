"""The console script, and `python -m odomcorrupt`."""

from __future__ import annotations

import signal

__all__ = ["main"]


def main() -> None:
    """Run the command line; Ctrl-C while it is imported ends the program without a word."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    from odomcorrupt.cli import main as run_main  # noqa: PLC0415 - see above

    run_main()


if __name__ == "__main__":
    main()
