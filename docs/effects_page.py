"""Tables of all effects, in the page of the effects: a hook of mkdocs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import choices, parameters

if TYPE_CHECKING:
    from mkdocs.structure.pages import Page

    from odomcorrupt.effects.effect import Effect

_PLACE = (
    "The site of this documentation has a table of all effects here, made from the code; in the repository use\n"
    "`odomcorrupt effects`.\n"
)
_KINDS = {
    "effect": "Systematic errors",
    "noise": "Random errors",
    "event": "Single events",
    "setup": "Properties of the measurement",
}


def on_page_markdown(markdown: str, *, page: Page, **_: Any) -> str:
    """Return a page as it is, and that of the effects with tables of the library."""
    return markdown.replace(_PLACE, f"{library()}\n", 1) if page.file.src_uri == "effects.md" else markdown


def library() -> str:
    """Return a section with a table for each kind of effect, in Markdown."""
    lines = ["## The library", "", "`track` is the distance between the wheels, if that of the robot is not known."]
    for kind, title in _KINDS.items():
        lines += [
            "",
            f"### {title}",
            "",
            "| effect | what happens | parameters | truth minus odometry |",
            "|---|---|---|---|",
        ]
        lines += [_row(name, one) for name, one in registry().items() if one.kind == kind]
    return "\n".join(lines)


def _row(name: str, kind: type[Effect]) -> str:
    """Return the row of an effect."""
    numbers = [
        f"`{p.name}`" if p.name == "track" else f"`{p.name}`: {p.meaning}; typically {p.typical:g} {p.unit}".rstrip()
        for p in parameters(kind)
    ]
    words = [f"`{word}`: {' or '.join(options)}" for word, options in choices(kind).items()]
    summary = kind.summary + (f"; equals `{kind.aliased_with}` in every recording" if kind.aliased_with else "")
    equation = kind.about.equation if kind.about is not None else ""
    cells = (f"`{name}`", summary, "<br>".join([*numbers, *words]), equation)
    return f"| {' | '.join(cell.replace('|', '&#124;') for cell in cells)} |"
