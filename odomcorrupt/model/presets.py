"""Predefined noise models with their coefficients and sources.

Those of real robots can be refitted with `benchmarks/fit_presets.py`: noise only, without systematic effects.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from odomcorrupt.errors import ModelError
from odomcorrupt.model.motion_model import Noise
from odomcorrupt.model.noise_laws import Coefficients

if TYPE_CHECKING:
    from collections.abc import Mapping

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
            "our judgement of an indoor wheeled robot: about 3.6 deg of heading and 0.16 m along after 10 m straight",
        ),
        Preset(
            "article",
            Noise("linear", Coefficients(0.05, math.radians(10.0), 0.05, 0.01)),
            "Adding noise to odometry data published by the Gazebo simulator (2018); per message",
        ),
        Preset(
            "optitrack-diff-drive",
            Noise("diffusion", Coefficients(0.0084, 0.0068, 0.0023, 0.00089, 0.0015)),
            "fitted to seven runs of a small differential drive under OptiTrack (OptiOdom, Sousa et al. 2022)",
        ),
        Preset(
            "optitrack-tricycle",
            Noise("diffusion", Coefficients(0.026, 0.028, 0.0063, 0.003, 0.0021)),
            "fitted to two runs of a tricycle under OptiTrack (OptiOdom, Sousa et al. 2022)",
        ),
        Preset(
            "mrclam-create",
            Noise("diffusion", Coefficients(0.094, 0.023, 0.014, 0.026, 0.0045)),
            "fitted to three runs of iRobot Creates; odometry is their commands (UTIAS MRCLAM 6, Leung et al. 2011)",
        ),
    )
}


def preset_named(name: str) -> Preset:
    """Return the preset with a given name; a ModelError lists the available names."""
    try:
        return PRESETS[name]
    except KeyError:
        raise ModelError(f"no preset is called {name!r}; there are {', '.join(PRESETS)}") from None
