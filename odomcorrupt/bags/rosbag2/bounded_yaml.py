"""YAML from untrusted sources: plain data of bounded size, checked event by event before construction."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, NamedTuple

from odomcorrupt.errors import BagError
from odomcorrupt.input_files import read_input

if TYPE_CHECKING:
    from pathlib import Path

LARGEST_BYTES = 4 << 20
LARGEST_NODES = 50_000
"""Two thousand topics; the parser takes 20 us for each."""
DEEPEST = 24
LONGEST_S = 20.0
"""CPU time."""
_SHOWN = 200
"""Maximum number of characters of a problem in an error message."""


def read_text(path: Path) -> str:
    """Return the text of a small regular file; BagError for others, such as a pipe that would block."""
    try:
        return read_input(path, LARGEST_BYTES, "metadata of a recorder", BagError).decode()
    except UnicodeDecodeError as error:
        raise BagError(f"{path}: cannot be read: {shown(error)}") from error


def load_yaml(text: str, kind: str = "safe") -> Any:
    """Return the data of a YAML text, for kind "rt" with comments and quotes; ValueError if invalid or too large."""
    from ruamel.yaml.error import YAMLError  # noqa: PLC0415 - as above

    if len(text) > LARGEST_BYTES:
        raise ValueError(f"it has more than {LARGEST_BYTES} bytes")
    try:
        yaml = yaml_of(kind)
        yaml.Parser = _bounded(yaml.Parser)
        return yaml.load(text)
    except (YAMLError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise ValueError(yaml_problem(error)) from error


def yaml_of(kind: str) -> Any:
    """Return a YAML reader and writer; lines are never folded."""
    # Slow to import, and needed for directories only.
    from ruamel.yaml import YAML  # noqa: PLC0415

    yaml = YAML(typ=kind, pure=True)
    yaml.preserve_quotes = True
    yaml.width = 1 << 30
    return yaml


def yaml_problem(error: Exception) -> str:
    """Return an error in one short line; those of YAML quote the document."""
    mark = getattr(error, "problem_mark", None)
    where = f" in line {mark.line + 1}" if mark is not None else ""
    return shown(getattr(error, "problem", None) or error) + where


def shown(problem: object) -> str:
    """Return a problem, or another text, in one short line."""
    strerror = getattr(problem, "strerror", None)
    text = " ".join(str(strerror or problem).split())
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


def _bounded(parser: type[Any]) -> type[Any]:
    """Return a YAML parser that raises ValueError where a document exceeds the bounds, as soon as it is read.

    Bounded are the depth, the size with aliases written out, and the CPU time; no key may be a list or a map. Data are
    constructed once the tree composed from the events is complete.
    """
    from ruamel.yaml import events as kinds  # noqa: PLC0415 - as above

    class Bounded(parser):  # type: ignore[misc] # a class of ruamel.yaml
        def __init__(self, *given: Any, **named: Any) -> None:
            super().__init__(*given, **named)
            self._begun, self._bounds = time.thread_time(), _Bounds()

        def get_event(self) -> Any:
            event = super().get_event()
            bounds = self._bounds
            if isinstance(event, kinds.SequenceEndEvent | kinds.MappingEndEvent):
                bounds.close()
            elif isinstance(event, kinds.AliasEvent):
                bounds.add(event.anchor, alias=True)
            elif isinstance(event, kinds.CollectionStartEvent):
                bounds.open(event.anchor, mapping=isinstance(event, kinds.MappingStartEvent))
            elif isinstance(event, kinds.ScalarEvent):
                bounds.add(event.anchor)
            if time.thread_time() - self._begun > LONGEST_S:
                raise ValueError(f"it takes more than {LONGEST_S:.0f} s to read")
            return event

    return Bounded


class _Open(NamedTuple):
    """A list or map that is being read; `nodes` is how many there were before it."""

    mapping: bool
    anchor: str | None
    nodes: int


class _Bounds:
    """Counter of a document's nodes, with aliases expanded."""

    def __init__(self) -> None:
        self._nodes = 0
        self._sizes: dict[str, int] = {}
        self._open: list[_Open] = []
        self._children = [0]

    def add(self, anchor: str | None, *, alias: bool = False) -> None:
        """Count a scalar, or the nodes of an alias."""
        if alias and anchor not in self._sizes:
            raise ValueError(f"*{anchor} stands for what it is part of, or for nothing")
        size = self._sizes[str(anchor)] if alias else 0
        if anchor is not None and not alias:
            self._sizes[anchor] = 0
        self._children[-1] += 1
        self._nodes += 1 + size
        if self._nodes > LARGEST_NODES:
            raise ValueError(f"it has more than {LARGEST_NODES} entries")

    def open(self, anchor: str | None, *, mapping: bool) -> None:
        """Begin a list or map."""
        if self._open and self._open[-1].mapping and self._children[-1] % 2 == 0:
            raise ValueError("a key is a list or a map")
        self.add(None)
        self._open.append(_Open(mapping, anchor, self._nodes))
        self._children.append(0)
        if len(self._open) > DEEPEST:
            raise ValueError(f"it is nested more than {DEEPEST} levels deep")

    def close(self) -> None:
        """End a list or map."""
        done = self._open.pop()
        self._children.pop()
        if done.anchor is not None:
            self._sizes[done.anchor] = self._nodes - done.nodes
