"""The article's example and the lecture's three settings, ready to be drawn."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from odomcorrupt.errors import ModelError
from odomcorrupt.model.motion_model import Noise
from odomcorrupt.model.noise_laws import Coefficients

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["DEFAULT_EXAMPLE", "EXAMPLES", "Example", "example_named"]

DEFAULT_EXAMPLE = "article"

Pose = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Example:
    """A motion with its noise: poses in metres and radians, how many samples, and whose numbers these are."""

    name: str
    noise: Noise
    start_xyt: Pose
    end_xyt: Pose
    count: int
    source: str


_TURN = (0.0, 0.0, 0.0), (1.0, 0.35, math.radians(40.0))
_OURS = "the lecture's three pictures; motion and values are ours"

EXAMPLES: Mapping[str, Example] = {
    example.name: example
    for example in (
        Example(
            DEFAULT_EXAMPLE,
            Noise("linear", Coefficients(0.05, math.radians(15.0), 0.05, 0.01)),
            (0.0, 0.0, math.radians(30.0)),
            (0.2, 0.35, math.radians(10.0)),
            1000,
            "Adding noise to odometry data published by the Gazebo simulator (2018), its worked example",
        ),
        Example("balanced", Noise("quadratic", Coefficients(0.02, 0.015, 0.006, 0.006)), *_TURN, 500, _OURS),
        Example("translation-heavy", Noise("quadratic", Coefficients(0.002, 0.001, 0.04, 0.01)), *_TURN, 500, _OURS),
        Example("rotation-heavy", Noise("quadratic", Coefficients(0.2, 0.15, 0.0005, 0.0005)), *_TURN, 500, _OURS),
    )
}


def example_named(name: str) -> Example:
    """Return the example of that name; ModelError names the ones there are."""
    try:
        return EXAMPLES[name]
    except KeyError:
        raise ModelError(f"no example is called {name!r}; there are {', '.join(EXAMPLES)}") from None
