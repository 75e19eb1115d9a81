"""odomcorrupt presets: ready-made noise, with its source."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.commands._options import usage_errors
from odomcorrupt.commands._standard import Console, standard_options
from odomcorrupt.errors import ModelError
from odomcorrupt.summary import Line, Summary, command_line

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.model.presets import Preset


@click.command("presets", short_help="List the ready-made noise models, or print one as a model file.")
@click.argument("name", required=False)
@standard_options
def command(name: str | None, *, console: Console) -> None:
    """List the presets with law, numbers and source, or print one of them as a model file, to edit and to add effects.

    The numbers are alpha1, alpha2, ...; what they mean depends on the law.
    """
    from odomcorrupt.model.model_file import format_model
    from odomcorrupt.model.motion_model import MotionModel
    from odomcorrupt.model.presets import PRESETS, preset_named

    if name is None:
        chosen = list(PRESETS.values())
        use = "odomcorrupt INPUT OUTPUT --preset NAME uses it; odomcorrupt presets NAME > robot.toml writes a file"
        console.print(
            _brief(chosen),
            "\n".join([*map(_lines, chosen), use]),
            {"schema": 2, "presets": [_values(p) for p in chosen]},
        )
        return
    with usage_errors(ModelError):
        preset = preset_named(name)
    source = {"preset": preset.name, "from": preset.source}
    text = format_model(MotionModel(preset.noise, source=source))
    console.print(text.rstrip("\n"), text.rstrip("\n"), {"schema": 2} | _values(preset))


def _brief(presets: Sequence[Preset]) -> Summary:
    """Return the names, fitted presets on a separate line."""
    fitted = [p.name for p in presets if p.source.startswith("fitted")]
    stated = [p.name for p in presets if p.name not in fitted]
    count, first = f"{len(presets)} noise models; -v has their laws, numbers and sources", presets[0].name
    lines = [Line("PRESETS", count, "good"), Line("stated", ", ".join(stated)), Line("fitted", ", ".join(fitted))]
    lines.append(Line("use", f"odomcorrupt INPUT OUTPUT --preset {first}"))
    return Summary((*lines, command_line(f"odomcorrupt presets {first} > robot.toml")))


def _values(preset: Preset) -> dict[str, Any]:
    noise = preset.noise
    numbers = dataclasses.asdict(noise.coefficients)
    shown = {key: value for key, value in numbers.items() if value or key in noise.law.alphas}
    return {"name": preset.name, "law": noise.law_name, "coefficients": shown, "source": preset.source}


def _lines(preset: Preset) -> str:
    values = _values(preset)
    numbers = "  ".join(f"{key} {value:.4g}" for key, value in values["coefficients"].items())
    return f"{preset.name}\n  law {values['law']}: {numbers}\n  {preset.source}\n"
