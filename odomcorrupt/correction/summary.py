"""What a correction did: in a few lines, and in one paragraph."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from odomcorrupt.corruption.drift import LEG_M
from odomcorrupt.effects.effect import parameters
from odomcorrupt.report.text.summary import Line, Summary, command_line

if TYPE_CHECKING:
    from odomcorrupt.correction.run import Corrected
    from odomcorrupt.effects.effect import Effect

__all__ = ["brief", "correction_summary"]

_WHY_NOT = {
    "quantization": "what fell between two ticks was never reported",
    "heavy_tails": "the noise was drawn, and nobody kept the draws",
}
_NEAR_M = 0.2
"""An error of place that hardly matters to a patch of the floor."""
_RANDOM = "it wandered at random, and nobody recorded how"


def brief(corrected: Corrected, target: str) -> Summary:
    """Return what was taken out, by how much that moves the end pose, what remains, and what is odd.

    Parameters
    ----------
    corrected : what the correction did
    target : the output; "-" is a pipe
    """
    undone, drift = corrected.effects.undone, corrected.drift
    if undone:
        lines = [
            Line("CORRECTED", f"the end pose moves by {_size(drift.end_drawn_m, drift.end_drawn_rad)}", "good"),
            Line("taken out", ", ".join(_effect(effect) for effect in undone)),
        ]
    else:
        lines = [Line("UNCHANGED", "the model has no effect that can be taken out: the bag was copied", "warning")]
    lines += [Line("odometry", f"{_moved(corrected)} ({_drive(corrected)})")]
    lines += [Line("remains", f"{e.name}: {_WHY_NOT.get(e.name, _RANDOM)}", "warning") for e in corrected.effects.left]
    lines += [Line("remains", sentence.removeprefix("What remains is ")) for sentence in _remains(corrected)]
    lines += [Line("odd", sentence, "warning") for sentence in _oddities(corrected)]
    if corrected.strayed:
        names = ", ".join(effect.name for effect in corrected.strayed)
        lines.append(Line("places", f"{names}: taken in the frame {corrected.frames.odom}; see --start", "warning"))
    following = () if target == "-" else (command_line(["odomcorrupt", "info", target]),)
    return Summary((*lines, *following))


def correction_summary(corrected: Corrected) -> str:
    """Return one paragraph: what was taken out, how far that moved the odometry, what cannot be undone and remains."""
    undone = corrected.effects.undone
    if undone:
        parts = [
            f"Corrected: {_moved(corrected)}, driven by {corrected.driver} ({_drive(corrected)}).",
            f"Taken out: {', '.join(_effect(effect) for effect in undone)}.",
            _shift(corrected),
        ]
    else:
        has = "none that can be undone" if corrected.effects.left else "none"
        parts = [f"Nothing to correct: of effects the model has {has}, so the bag was copied."]
    parts += [
        f"{effect.name} cannot be undone: {_WHY_NOT.get(effect.name, _RANDOM)}." for effect in corrected.effects.left
    ]
    if corrected.strayed:
        names = ", ".join(effect.name for effect in corrected.strayed)
        origin = corrected.model.setup.origin
        frame = "the frame of the truth" + (f" (metres east and north of {origin})" if origin else "")
        parts.append(
            f"{names}: acts by place or heading in {frame}, which was taken to be "
            f"{corrected.frames.odom}; if it is not, say with --start X,Y,THETA where in it this drive began."
        )
    parts += _remains(corrected) + _misplaced(corrected)
    given = {effect.name for effect in undone}
    aside = [effect.name for effect in corrected.model.setup.effects if effect.name not in given]
    aside += ["clocks"] * (bool(corrected.model.setup.clocks) and not any(effect.clock for effect in undone))
    if aside:
        parts.append(
            f"[setup] belongs to the recordings that were fitted and stays out of this: {', '.join(aside)}; "
            "to take one of them out, too, give it with --effect."
        )
    return " ".join(parts + _oddities(corrected))


def _moved(corrected: Corrected) -> str:
    topics = [f"{count} messages on {topic}" for topic, count in sorted(corrected.changes.odometry.items())]
    edges = [f"{count} transforms {edge}" for edge, count in sorted(corrected.changes.edges.items())]
    return ", ".join([*topics, *(edges or [f"no transform from {corrected.frames.odom}"])])


def _drive(corrected: Corrected) -> str:
    return f"{corrected.drift.distance_m:.4g} m in {corrected.drift.duration_s:.4g} s"


def _effect(effect: Effect) -> str:
    values = ", ".join(f"{p.name} {getattr(effect, p.name):.4g} {p.unit}".rstrip() for p in parameters(effect))
    return f"{effect.name} ({values})"


def _shift(corrected: Corrected) -> str:
    drift = corrected.drift
    moved = f"That moves the end pose by {_size(drift.end_drawn_m, drift.end_drawn_rad)}"
    if drift.leg_drawn_m is None or drift.leg_drawn_rad is None:
        return f"{moved}."
    return f"{moved}, and by {_size(drift.leg_drawn_m, drift.leg_drawn_rad)} per {LEG_M:.0f} m."


def _remains(corrected: Corrected) -> list[str]:
    if corrected.model.noise.coefficients.silent or not corrected.effects.undone:
        return []
    drift = corrected.drift
    remains = f"What remains is noise: {_size(drift.end_expected_m, drift.end_expected_rad)} expected at the end"
    if drift.leg_expected_m is not None and drift.leg_expected_rad is not None:
        remains += f", {_size(drift.leg_expected_m, drift.leg_expected_rad)} per {LEG_M:.0f} m"
    return [f"{remains} (1 sigma)."]


def _misplaced(corrected: Corrected) -> list[str]:
    """Say what odometry alone cannot know: where the robot is in a long drive."""
    names = ", ".join(effect.name for effect in corrected.effects.undone if effect.reads_places)
    off_m = corrected.drift.end_expected_m
    if not names or corrected.model.noise.coefficients.silent or not off_m > _NEAR_M:
        return []
    where = f"{names}: taken out where the corrected odometry says the robot is, which by the end is {off_m:.3g} m off"
    return [f"{where} (1 sigma): in a long drive that is another place. `compare`, which has the truth, knows better."]


def _size(metres: float, radians: float) -> str:
    return f"{metres:.3g} m, {math.degrees(radians):.3g} deg"


def _oddities(corrected: Corrected) -> list[str]:
    said = [
        f"/tf_static holds {edge}: published once for all time, it cannot follow the correction."
        for edge in sorted(corrected.changes.static)
    ]
    said += [f"Lost: {loss}." for loss in corrected.losses]
    if corrected.changes.held:
        said.append(f"The correction was held for {corrected.changes.held} of these, beyond the odometry's last stamp.")
    if corrected.restarts:
        said.append(f"Time jumped back {corrected.restarts} times: each stretch was corrected by itself.")
    if corrected.drift.jumps:
        said.append(f"The pose jumped {corrected.drift.jumps} times: the correction was held across.")
    if corrected.late:
        said.append(f"{corrected.late} odometry messages came more than a second late: moved, but not looked at.")
    if corrected.leaps:
        said.append(f"{corrected.leaps} odometry stamps lie far ahead of their neighbours': not looked at.")
    if corrected.unusable:
        said.append(f"{corrected.unusable} odometry poses are not numbers: left alone.")
    return said
