"""How far a bag has got, on terminals only."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Self

import click

from odomcorrupt.standard_streams import visible

if TYPE_CHECKING:
    from types import TracebackType

    from odomcorrupt.bags.block import Block

__all__ = ["Progress", "say"]

PAUSE_S = 0.2
"""Time between two lines: often enough to look alive."""


class Progress:
    """Counts blocks as they go by, and says so on stderr where that is a terminal."""

    def __init__(self) -> None:
        self._shown = sys.stderr.isatty()
        self._next_s = time.monotonic() + PAUSE_S
        self._bytes = 0
        self._first_ns: int | None = None

    def __call__(self, block: Block) -> None:
        """Take note of a block."""
        if not self._shown or not len(block.table):
            return
        self._bytes += block.data.size
        if self._first_ns is None:
            self._first_ns = int(block.table["log_ns"][0])
        if time.monotonic() >= self._next_s:
            self._next_s = time.monotonic() + PAUSE_S
            past_s = (int(block.table["log_ns"][-1]) - self._first_ns) * 1e-9
            click.echo(f"\r\x1b[K{past_s:.0f} s of the bag, {self._bytes / 1e6:.0f} MB", nl=False, err=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._shown:
            click.echo("\r\x1b[K", nl=False, err=True)


def say(paragraph: str) -> None:
    """Print a paragraph on stderr, folded where that is a terminal."""
    paragraph = visible(paragraph)
    folded = click.wrap_text(paragraph, click.get_current_context().terminal_width or 100)
    click.echo(folded if sys.stderr.isatty() else paragraph, err=True)
