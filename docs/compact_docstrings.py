"""Lines `name : meaning` of docstrings as a section of the Python reference: an extension of griffe, their reader."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import griffe

if TYPE_CHECKING:
    from collections.abc import Iterator

_ITEM = re.compile(r"^(\*{0,2}\w+(?:, \*{0,2}\w+)*) : (.+)$")


class CompactDocstrings(griffe.Extension):
    """Gives these lines the heading of a section in numpy style, which they lack in the code."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite the docstring of a class or function."""
        if obj.docstring is not None and (obj.is_class or obj.is_function):
            obj.docstring.value = in_sections(obj.docstring.value, "Attributes" if obj.is_class else "Parameters")


def in_sections(text: str, heading: str) -> str:
    """Return a docstring whose block of lines `name : meaning` is a section; unchanged if it has no such block."""
    lines = text.splitlines()
    sections = [i for i, line in enumerate(lines) if re.fullmatch(r"-{3,}", line)]
    end = sections[0] - 1 if sections else len(lines)
    begin = next((i for i, line in enumerate(lines[:end]) if _ITEM.match(line)), end)
    last = next((i for i in range(begin, end) if not lines[i].strip()), end)
    if begin == last:
        return text
    block = [heading, "-" * len(heading), *_items(lines[begin:last])]
    return "\n".join([*lines[:begin], *block, *lines[last:]])


def _items(lines: list[str]) -> Iterator[str]:
    for line in lines:
        item = _ITEM.match(line)
        if item is None:
            yield f"    {line.strip()}"
        else:
            yield item[1]
            yield f"    {item[2]}"
