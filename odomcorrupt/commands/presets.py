"""odomcorrupt presets: ready-made noise, with its source."""

from __future__ import annotations

import click

from odomcorrupt.commands._options import completing, usage_errors
from odomcorrupt.commands._standard import Console, standard_options
from odomcorrupt.errors import ModelError


@click.command("presets", short_help="List the ready-made noise models, or print one as a model file.")
@click.argument("name", required=False, shell_complete=completing("model.presets", "PRESETS"))
@standard_options
def command(name: str | None, *, console: Console) -> None:
    """List the presets with law, numbers and source, or print one of them as a model file, to edit and to add effects.

    The numbers are alpha1, alpha2, ...; what they mean depends on the law.
    """
    from odomcorrupt.api.catalogue import list_presets
    from odomcorrupt.api.model import Model

    listed = list_presets()
    if name is None:
        console.show(listed)
        return
    with usage_errors(ModelError):
        text = Model.preset(name).toml().rstrip("\n")
    values = next(one for one in listed.to_dict()["presets"] if one["name"] == name)
    console.print(text, text, {"schema": 2, **values})
