"""Poses and results on the command line."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.extras import require

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

__all__ = ["PICTURES", "POSE", "need_pictures", "picture_kind", "save_picture"]

PICTURES = ("png", "svg", "pdf")


class _Pose(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.5 only
    """A pose, "x,y,heading" in metres and radians; the heading may be in degrees, as in 30deg."""

    name = "X,Y,THETA"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the pose as a tuple of three floats."""
        from odomcorrupt.errors import ModelError
        from odomcorrupt.model.motion_model import parse_alpha

        if not isinstance(value, str):
            return value
        parts = value.split(",")
        try:
            pose = tuple(parse_alpha(part) for part in parts)
        except ModelError:
            pose = ()
        if len(pose) != 3 or "deg" in parts[0] + parts[1]:
            self.fail(f"{value!r} is no pose; write x,y,heading as in 0.2,0.35,10deg", param, ctx)
        return pose


POSE = _Pose()


def need_pictures() -> None:
    """Explain what to install where the drawing library is missing."""
    require("matplotlib", "pictures need it", "study")


def picture_kind(path: Path) -> str | None:
    """Return the kind of picture that a name asks for, None for none."""
    kind = path.suffix.lower().removeprefix(".")
    return kind if kind in PICTURES else None


def save_picture(path: Path, figure: Figure) -> None:
    """Write a figure in the kind its name asks for, whole or not at all."""
    from odomcorrupt.files import write_bytes
    from odomcorrupt.report.plots.figure import rendered

    write_bytes(path, rendered(figure, picture_kind(path) or "png"))
