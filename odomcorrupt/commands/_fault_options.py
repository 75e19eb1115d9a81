"""What a simulated robot shall have, as options say it."""

from __future__ import annotations

from math import isfinite, nan, radians
from typing import TYPE_CHECKING

import click

from odomcorrupt.errors import EffectError

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["faults_of", "size_of"]

HEADINGS = {"wheels": "encoders", "gyro": "gyro"}
"""Sources of heading, as users and as the simulator call them."""
_LARGEST = 100.0
"""Times its usual size, a flaw makes no drive any more."""


def faults_of(effects: Sequence[str], heading: str | None) -> tuple[list[str], dict[str, dict[str, float | str]]]:
    """Return the names of the faults asked for (none: they are drawn), and their parameters as far as given.

    Parameters
    ----------
    effects : as in "wheelbase:e=0.01", "hidden" or "none"
    heading : {"wheels", "gyro"} or None
        Source of heading asked for.
    """
    from odomcorrupt.simulation.fault_draws import EVERY, names_of, source_of_turns

    if "hidden" in effects and len(effects) > 1:
        raise click.UsageError("--effect hidden: stands alone, since what else there is would be known")
    if "none" in effects and len(effects) > 1:
        raise click.UsageError("--effect none: stands alone; leave it out or leave out the others")
    if not effects or "hidden" in effects:
        return [], {}
    if "none" in effects:
        return ["none"], {}
    given = dict(_parse(text) for text in effects)
    try:
        causes = names_of([text.partition(":")[0].strip() for text in effects])
        chosen = HEADINGS[heading] if heading else source_of_turns(causes)
    except EffectError as error:
        raise click.UsageError(f"--effect {error}") from error
    for name in causes:
        if chosen not in EVERY[name].shows_with:
            raise click.UsageError(f"--heading {heading}: {name} does not show with it; choose the other source")
    return list(causes), given


def _parse(text: str) -> tuple[str, dict[str, float | str]]:
    name, _, rest = text.partition(":")
    values: dict[str, float | str] = {}
    for part in rest.split(",") if rest else ():
        key, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals:
            raise click.UsageError(f"--effect {text}: {part!r} is not key=value; write as in wheel_scale:e=0.01")
        try:
            number = radians(float(value[:-3])) if value.endswith("deg") else float(value)
        except ValueError:
            values[key] = value
            continue
        if not isfinite(number):
            raise click.UsageError(f"--effect {text}: {key} is {value}; write a number, as in wheel_scale:e=0.01")
        values[key] = number
    return name.strip(), values


def size_of(text: str) -> float:
    """Return by how much a size in words or figures multiplies a drawn flaw."""
    from odomcorrupt.simulation.fault_draws import SIZES

    try:
        size = SIZES[text] if text in SIZES else float(text)
    except ValueError:
        size = nan
    if not 0.0 < size <= _LARGEST:
        raise click.UsageError(
            f"--size {text}: give weak, medium, strong or a number of more than 0, up to {_LARGEST:g}"
        )
    return size
