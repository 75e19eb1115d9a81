"""What every command prints for -h, in the page of the commands: a hook of mkdocs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.cli import DEFAULT, cli

if TYPE_CHECKING:
    from mkdocs.structure.pages import Page

_COLUMNS = 80
_NOTE = "This page is filled when the site is built; in the repository use `odomcorrupt COMMAND -h`.\n"


def on_page_markdown(markdown: str, *, page: Page, **_: Any) -> str:
    """Return a page as it is, and that of the commands with the help of each behind it."""
    if page.file.src_uri != "commands.md":
        return markdown
    group = click.Context(cli, info_name="odomcorrupt", terminal_width=_COLUMNS, help_option_names=["-h", "--help"])
    parts = [_section("odomcorrupt", cli.get_help(group))]
    for name in cli.list_commands(group):
        command = cli.get_command(group, name)
        if command is not None and name != DEFAULT:
            own = click.Context(command, group, name, terminal_width=_COLUMNS)
            parts.append(_section(f"odomcorrupt {name}", command.get_help(own)))
    return "\n\n".join([markdown.replace(_NOTE, "").rstrip(), *parts]) + "\n"


def _section(name: str, text: str) -> str:
    return f"## {name}\n\n```text\n{text}\n```"
