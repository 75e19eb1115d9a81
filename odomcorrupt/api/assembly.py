"""Whole bags from the overlays of a batch, which have only the modified topics."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import Any, Unpack

from odomcorrupt.api.bag_options import BagOptions, split_options
from odomcorrupt.api.result import Result
from odomcorrupt.batching import split_layout
from odomcorrupt.batching.manifest import fingerprint_of, read_beginning
from odomcorrupt.errors import BatchError
from odomcorrupt.summary import Line, Summary, command_line


@dataclass(frozen=True, slots=True, repr=False)
class Assembly(Result):
    """A whole bag, written from an overlay and its original.

    path : the bag
    run, original : overlay, and the bag it was made from
    messages : number of messages of the overlay in it
    """

    path: Path
    run: Path
    original: Path
    messages: int

    def summary(self) -> Summary:
        """Return what replaces what."""
        text = f"{self.messages} messages of {self.run.name} in place of those of {self.original.name}"
        return Summary((Line("ASSEMBLED", text, "good"), command_line(["odomcorrupt", "info", self.path])))

    def details(self) -> str:
        """Return the same with paths."""
        return f"{self.path}: {self.messages} messages of {self.run} in place of those of {self.original}."

    def to_dict(self) -> dict[str, Any]:
        """Return the three paths and the number of messages."""
        return {"schema": 2, **self.rows()[0]}

    def rows(self) -> list[dict[str, Any]]:
        """Return the same in one row."""
        paths = {"output": str(self.path), "messages": self.messages, "run": str(self.run)}
        return [{**paths, "input": str(self.original)}]


def assemble(
    run: str | PathLike[str],
    output: str | PathLike[str],
    original: str | PathLike[str] | None = None,
    **options: Unpack[BagOptions],
) -> Assembly:
    """Write the whole bag of a run that `batch(..., output="overlay")` made, which has only the modified topics.

    Parameters
    ----------
    run : path
        Overlay in the directory of its batch.
    output : path
        Bag to write.
    original : path, optional
        Bag that the batch was made from; by default the one noted in the batch, if it is unchanged.
    **options
        See `BagOptions`; those that choose what is modified have no effect.

    Returns
    -------
    Assembly
        The bag, and the number of replaced messages.

    Raises
    ------
    BatchError, BagError
        If the original is missing, has changed, or is not that of the overlay, or a bag cannot be read or written.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> runs = oc.batch("fixtures/office.mcap", "overlays", runs=1, seed=1, output="overlay")
    >>> oc.assemble(runs.paths[0], "whole.mcap").messages
    6000
    """
    overlay, target = Path(fspath(run)), Path(fspath(output))
    if original is None:
        noted = read_beginning(overlay.parent)["input"]
        source = Path(noted["path"])
        if not source.exists():
            raise BatchError(f"{source}: the batch's input is not there; name it with --input")
        if fingerprint_of(source) != noted["hash"]:
            raise BatchError(f"{source}: has changed since the batch was made from it; name the original with --input")
    else:
        source = Path(fspath(original))
    count = split_layout.assemble(overlay, source, target, split_options(options)[1])
    return Assembly(target, overlay, source, count)
