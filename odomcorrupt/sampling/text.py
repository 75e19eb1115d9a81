"""Output of samples: CSV, JSON, and text."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from odomcorrupt.sampling.samples import Moments, Move, ellipse, linearised_moments, sample_moments
from odomcorrupt.summary import Line, Summary, command_line

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import Noise
    from odomcorrupt.model.noise_laws import Variances

_ARTICLE_CODE = (
    "article-code: the listing passes sd*sd where a standard deviation is expected, so what is drawn has deviation "
    "sd^2 (in numbers, whatever the unit), not sd"
)


@dataclass(frozen=True, slots=True)
class Drawn:
    """Samples of a motion and the settings that produced them.

    xyt : (n, 3) metres, radians
    notes : further remarks for the report
    """

    move: Move
    noise: Noise
    variances: Variances
    xyt: Array
    seed: int
    origin: str
    notes: tuple[str, ...] = ()

    @property
    def article_code(self) -> bool:
        """Whether standard deviations are squared, as in the article's listing."""
        return self.noise.law_name == "article-code"


def brief(drawn: Drawn, following: str = "") -> Summary:
    """Return mean and spread of the samples, and those of the linearised model.

    drawn : motion, noise and samples
    following : the command to type next, "" for none
    """
    linear = linearised_moments(drawn.move, drawn.variances)
    drawn_moments = sample_moments(drawn.xyt)
    lines = [Line("SAMPLES", f"{len(drawn.xyt)} of seed {drawn.seed}, mean {_pose(drawn_moments.mean_xyt)}", "good")]
    for name, moments in (("spread", drawn_moments), ("linearised", linear)):
        about = ellipse(moments, 1.0)
        heading = math.degrees(math.sqrt(moments.covariance[2, 2]))
        axes = f"{about.major_m:.3g} m by {about.minor_m:.3g} m at {math.degrees(about.angle_rad) % 180.0:.3g} deg"
        lines.append(Line(name, f"{axes}, heading {heading:.3g} deg (1 sigma)"))
    lines.append(Line("motion", f"{_pose(drawn.move.start_xyt)} to {_pose(drawn.move.end_xyt)}"))
    lines.append(Line("noise", law_words(drawn.noise)))
    lines += [Line("note", _ARTICLE_CODE, "warning")] if drawn.article_code else []
    lines += [Line("note", note, "warning") for note in drawn.notes]
    return Summary((*lines, command_line(following)))


def csv_text(xyt: Array) -> str:
    """Return samples as lines of x, y, theta that parse to the same bits."""
    rows = [",".join(repr(float(value)) for value in row) for row in xyt]
    return "\n".join(["x_m,y_m,theta_rad", *rows]) + "\n"


def drawn_json(drawn: Drawn) -> dict[str, Any]:
    """Return motion, noise, samples and moments (of the samples and linearised) as JSON values."""
    noise, v = drawn.noise, drawn.variances
    parts = drawn.move.parts
    linear = linearised_moments(drawn.move, v)
    about = ellipse(linear, 1.0)
    return {
        "law": noise.law_name,
        "step": None if noise.step is None else str(noise.step),
        "coefficients": dataclasses.asdict(noise.coefficients),
        "source": drawn.origin,
        "seed": drawn.seed,
        "start_xyt": drawn.move.start_xyt.tolist(),
        "odometry_end_xyt": drawn.move.end_xyt.tolist(),
        "rot1_rad": float(parts.rot1_rad[0]),
        "trans_m": float(parts.trans_m[0]),
        "rot2_rad": float(parts.rot2_rad[0]),
        "standard_deviations": {
            name: math.sqrt(float(getattr(v, name)[0])) for name in ("rot1", "trans", "across", "rot2")
        },
        "samples": _moments(sample_moments(drawn.xyt)) if len(drawn.xyt) > 1 else None,
        "linearised": _moments(linear),
        "linearised_ellipse_1_sigma": {
            "centre_xy": about.centre_xy.tolist(),
            "major_m": about.major_m,
            "minor_m": about.minor_m,
            "angle_rad": about.angle_rad,
        },
        "notes": list(drawn.notes),
        "xyt": drawn.xyt.tolist(),
    }


def _moments(moments: Moments) -> dict[str, Any]:
    return {"mean_xyt": moments.mean_xyt.tolist(), "covariance": moments.covariance.tolist()}


def report_text(drawn: Drawn) -> str:
    """Return a summary of the samples in a few lines."""
    move, v, parts, degrees = drawn.move, drawn.variances, drawn.move.parts, math.degrees
    rot1, rot2, trans = (float(values[0]) for values in (parts.rot1_rad, parts.rot2_rad, parts.trans_m))
    deviation = [math.sqrt(float(values[0])) for values in (v.rot1, v.trans, v.rot2)]
    lines = [
        f"motion: {_pose(move.start_xyt)} -> {_pose(move.end_xyt)}",
        f"  as turn {degrees(rot1):.4g} deg, drive {trans:.4g} m, turn {degrees(rot2):.4g} deg",
        f"noise: {law_words(drawn.noise)}" + (f" ({drawn.origin})" * bool(drawn.origin)),
        f"  with deviations {degrees(deviation[0]):.4g} deg, {deviation[1]:.4g} m, {degrees(deviation[2]):.4g} deg",
        f"{len(drawn.xyt)} samples, seed {drawn.seed}",
    ]
    if drawn.article_code:
        lines.append(_ARTICLE_CODE)
    sets = [("linearised", linearised_moments(move, v))]
    if len(drawn.xyt) > 1:
        sets.insert(0, ("samples", sample_moments(drawn.xyt)))
    for name, moments in sets:
        about = ellipse(moments, 1.0)
        axes = (
            f"{about.major_m:.4g} m by {about.minor_m:.4g} m, long axis at {degrees(about.angle_rad) % 180.0:.3g} deg"
        )
        lines += [
            f"{name}: mean {_pose(moments.mean_xyt)}, 1 sigma {axes}",
            "  covariance of x, y (m), theta (rad):",
            *("    " + "  ".join(f"{value: .4e}" for value in row) for row in moments.covariance),
        ]
    return "\n".join([*lines, *drawn.notes])


def law_words(noise: Noise) -> str:
    """Return the law and its coefficients, with their alpha convention."""
    numbers = ", ".join(f"{name} {value:.4g}" for name, value in _numbers(noise))
    step = f", once per {noise.step}" if noise.step is not None else ""
    return f"law {noise.law_name} ({law_meaning(noise)}{step}): {numbers}"


def law_meaning(noise: Noise) -> str:
    """Return the meaning of a law's coefficients, for reports."""
    return {
        "diffusion": "deviation after 1 m or 1 rad",
        "linear": "deviation = coefficient x motion",
        "article-code": "deviation = (coefficient x motion)^2",
    }.get(noise.law_name, "variance = coefficient x motion^2")


def title(drawn: Drawn) -> str:
    """Return the title of a plot: two short lines."""
    numbers = "  ".join(f"{name} {value:.3g}" for name, value in _numbers(drawn.noise))
    name = "article-code (sd passed squared)" if drawn.article_code else drawn.noise.law_name
    step = f" per {drawn.noise.step}" if drawn.noise.step is not None else ""
    return f"Where one motion may end: law {name}{step}, {len(drawn.xyt)} samples, seed {drawn.seed}\n{numbers}"


def _numbers(noise: Noise) -> list[tuple[str, float]]:
    """Return the four coefficients, and the others that are not zero."""
    values = dataclasses.asdict(noise.coefficients)
    return [(name, value) for i, (name, value) in enumerate(values.items()) if i < 4 or value]


def _pose(xyt: Array) -> str:
    return f"({xyt[0]:.4g} m, {xyt[1]:.4g} m, {math.degrees(xyt[2]):.4g} deg)"
