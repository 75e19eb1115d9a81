"""Ready-made noise models: law, numbers and where they come from."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from odomcorrupt.errors import ModelError
from odomcorrupt.laws import Coefficients
from odomcorrupt.model import Noise

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["DEFAULT", "PRESETS", "Preset", "preset_named"]

DEFAULT = "typical"


@dataclass(frozen=True, slots=True)
class Preset:
    """A named noise model and its source."""

    name: str
    noise: Noise
    source: str


PRESETS: Mapping[str, Preset] = {
    preset.name: preset
    for preset in (
        Preset(
            DEFAULT,
            Noise("diffusion", Coefficients(0.05, 0.02, 0.05, 0.01)),
            "our judgement of an indoor wheeled robot: about 4 deg of heading and 0.2 m along after 10 m",
        ),
        Preset(
            "article",
            Noise("linear", Coefficients(0.05, math.radians(10.0), 0.05, 0.01)),
            "Adding noise to odometry data published by the Gazebo simulator (2018); per message",
        ),
    )
}


def preset_named(name: str) -> Preset:
    """Return the preset of that name; ModelError names the ones there are."""
    try:
        return PRESETS[name]
    except KeyError:
        raise ModelError(f"no preset is called {name!r}; there are {', '.join(PRESETS)}") from None
