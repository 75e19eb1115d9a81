"""Noise laws and poses in words, and samples as CSV."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import Noise


def csv_text(xyt: Array) -> str:
    """Return samples as lines of x, y, theta that parse to the same bits."""
    rows = [",".join(repr(float(value)) for value in row) for row in xyt]
    return "\n".join(["x_m,y_m,theta_rad", *rows]) + "\n"


def law_words(noise: Noise) -> str:
    """Return the law and its coefficients, with their alpha convention."""
    numbers = ", ".join(f"{name} {value:.4g}" for name, value in law_numbers(noise))
    step = f", once per {noise.step}" if noise.step is not None else ""
    return f"law {noise.law_name} ({law_meaning(noise)}{step}): {numbers}"


def law_meaning(noise: Noise) -> str:
    """Return the meaning of a law's coefficients, for reports."""
    return {
        "diffusion": "deviation after 1 m or 1 rad",
        "linear": "deviation = coefficient x motion",
        "article-code": "deviation = (coefficient x motion)^2",
    }.get(noise.law_name, "variance = coefficient x motion^2")


def law_numbers(noise: Noise) -> list[tuple[str, float]]:
    """Return the four coefficients, and the others that are not zero."""
    values = dataclasses.asdict(noise.coefficients)
    return [(name, value) for i, (name, value) in enumerate(values.items()) if i < 4 or value]


def pose_words(xyt: Array) -> str:
    """Return a pose in metres and degrees."""
    return f"({xyt[0]:.4g} m, {xyt[1]:.4g} m, {math.degrees(xyt[2]):.4g} deg)"
