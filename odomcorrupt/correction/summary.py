"""Summary of a correction: in a few lines, and in one paragraph."""

from __future__ import annotations

from typing import TYPE_CHECKING

from odomcorrupt.corruption.drift import LEG_M
from odomcorrupt.corruption.summary import (
    effect_words,
    lost_lines,
    moved_words,
    size_words,
    stream_oddities,
    topic_words,
    travel_words,
)
from odomcorrupt.summary import Line, Summary, command_line

if TYPE_CHECKING:
    from odomcorrupt.correction.run import Corrected
    from odomcorrupt.corruption.run import Outcome

_WHY_NOT = {
    "gyro_dead_band": "turns below its threshold were not reported",
    "quantization": "travel below the encoder's resolution was not reported",
    "heavy_tails": "its random draws were not recorded",
}
_NEAR_M = 0.05
"""Position error that is negligible relative to a patch of the floor, metres: a turn on the other side of an edge made
a drift of 0.16 m one of 1.7 m."""
_PLAIN_OFFSET_S = 1e-3
"""Learned clock offset below which a correction is not suggested, seconds: a millimetre at 1 m/s."""
_RANDOM = "its random course was not recorded"
_OF_TRUTH = {"lever_arm": "the truth's tracked point", "mount_yaw": "how the truth is turned"}
_AT_REST = "is read where the robot stands for 0.6 s or more, interpolated between rests, and held after the last one"


def brief(corrected: Corrected, target: str) -> Summary:
    """Return the effects removed, the change of the end pose, the remaining error, and warnings.

    corrected : result of the correction
    target : the output; "-" is a pipe
    """
    drift, taken = corrected.run.drift, _taken_out(corrected)
    of_truth = ", ".join(
        f"{effect.name} ({_OF_TRUTH.get(effect.name, 'of the recordings')})"
        for effect in corrected.model.setup.effects
        if effect.acts and effect.name in _aside(corrected)
    )
    if taken:
        taken += f"; not {of_truth}" if of_truth else ""
        lines = [
            Line("CORRECTED", f"the end pose moves by {size_words(drift.end_drawn_m, drift.end_drawn_rad)}", "good"),
            Line("taken out", taken),
        ]
    else:
        lines = [Line("UNCHANGED", "the model has no effect that can be taken out: the bag was copied", "warning")]
        lines += [Line("set-up", f"{of_truth}: no part of the odometry, so not taken out")] if of_truth else []
    lines += [Line("clock", sentence, "warning") for sentence in _clock_left(corrected)]
    if corrected.unplaced:
        names = ", ".join(effect.name for effect in corrected.unplaced)
        said = f"{names}: taken out at places and headings of the frame {corrected.run.frames.odom}; see --start"
        lines.insert(1, Line("places", said, "warning"))
    lines[1:1] = [Line("places", sentence, "warning") for sentence in _misplaced(corrected)]
    lines[1:1] = lost_lines(corrected.run)
    lines += [
        Line("odometry", f"{moved_words(corrected.run)} ({travel_words(corrected.run)}){topic_words(corrected.run)}")
    ]
    lines += [Line("remains", f"{e.name}: {_WHY_NOT.get(e.name, _RANDOM)}", "warning") for e in corrected.effects.left]
    lines += [Line("remains", f"{e.name} {_AT_REST}") for e in corrected.effects.undone if e.shown_at_rest]
    lines += [Line("remains", sentence.removeprefix("What remains is ")) for sentence in _remains(corrected)]
    odd = (sentence for sentence in _oddities(corrected.run) if not sentence.startswith("Lost: "))
    lines += [Line("anomaly", sentence, "warning") for sentence in odd]
    following = () if target == "-" else (command_line(["odomcorrupt", "info", target]),)
    return Summary((*lines, *following))


def correction_summary(corrected: Corrected) -> str:
    """Return one paragraph: effects removed, change of the odometry, effects that cannot be undone, remaining error."""
    run, taken = corrected.run, _taken_out(corrected)
    if taken:
        source = f"the poses of {run.odometry}{topic_words(run)} ({travel_words(run)})"
        parts = [
            f"Corrected: {moved_words(run)}, computed from {source}.",
            f"Taken out: {taken}.",
            _shift(corrected),
        ]
    else:
        has = "no effect that can be undone" if corrected.effects.left else "no effect"
        parts = [f"Nothing to correct: the model has {has}, so the bag was copied."]
    parts += [
        f"{effect.name} cannot be undone: {_WHY_NOT.get(effect.name, _RANDOM)}." for effect in corrected.effects.left
    ]
    parts += [f"{effect.name} {_AT_REST}." for effect in corrected.effects.undone if effect.shown_at_rest]
    if corrected.unplaced:
        names = ", ".join(effect.name for effect in corrected.unplaced)
        origin = corrected.model.setup.origin
        frame = "the frame of the truth" + (f" (metres east and north of {origin})" if origin else "")
        parts.append(
            f"{names}: depends on position or heading in {frame}, which was taken to be "
            f"{corrected.run.frames.odom}; if it is not, give the start of this drive in it with --start X,Y,THETA."
        )
    parts += _remains(corrected) + _misplaced(corrected)
    aside = _aside(corrected)
    clocked = any(effect.clock for effect in corrected.effects.undone)
    aside += ["clocks"] * (bool(corrected.model.setup.clocks) and not clocked)
    if aside:
        parts.append(
            f"[setup] belongs to the recordings that were fitted and was not applied: {', '.join(aside)}; "
            "to take one of them out, too, give it with --effect."
        )
    return " ".join(parts + _oddities(corrected.run))


def _aside(corrected: Corrected) -> list[str]:
    """Return the names of the set-up's effects, which are not taken out unless they are given."""
    given = {effect.name for effect in corrected.effects.undone}
    return [effect.name for effect in corrected.model.setup.effects if effect.name not in given]


def _taken_out(corrected: Corrected) -> str:
    """Return what was taken out, "" for nothing."""
    steps = ["a filter's steps towards poses"] * corrected.model.setup.pose_corrections
    return ", ".join([*steps, *map(effect_words, corrected.effects.undone)])


def _clock_left(corrected: Corrected) -> list[str]:
    """Return how to remove the time offset of the fitted recordings, if it is significant and was not requested.

    It belongs to a recording's clocks and may be the truth's; it is corrected only if the odometry is always as late.
    """
    if any(effect.clock for effect in corrected.effects.undone):
        return []
    offsets = {name: offset_s for name, (offset_s, _) in corrected.model.setup.clocks.items()}
    name = max(offsets, key=lambda one: abs(offsets[one]), default="")
    offset_s = offsets.get(name, 0.0)
    if abs(offset_s) < _PLAIN_OFFSET_S:
        return []
    why = f"time_offset {offset_s * 1e3:.3g} ms of {name} is not corrected: the truth's clock may cause it"
    side = "late" if offset_s > 0.0 else "early"
    return [f"{why}; if odometry stamps are that {side} in this bag, add --effect time_offset:offset={offset_s:.4g}"]


def _shift(corrected: Corrected) -> str:
    drift = corrected.run.drift
    moved = f"That moves the end pose by {size_words(drift.end_drawn_m, drift.end_drawn_rad)}"
    if drift.leg_drawn_m is None or drift.leg_drawn_rad is None:
        return f"{moved}."
    return f"{moved}, and by {size_words(drift.leg_drawn_m, drift.leg_drawn_rad)} per {LEG_M:.0f} m."


def _remains(corrected: Corrected) -> list[str]:
    if corrected.model.noise.coefficients.noise_free or not corrected.effects.undone:
        return []
    drift = corrected.run.drift
    remains = f"What remains is noise: {size_words(drift.end_expected_m, drift.end_expected_rad)} expected at the end"
    if drift.leg_expected_m is not None and drift.leg_expected_rad is not None:
        remains += f", {size_words(drift.leg_expected_m, drift.leg_expected_rad)} per {LEG_M:.0f} m"
    return [f"{remains} (1 sigma)."]


def _misplaced(corrected: Corrected) -> list[str]:
    """Return a warning if the position error is too large for effects that depend on the position."""
    names = ", ".join(effect.name for effect in corrected.effects.undone if effect.reads_places)
    off_m = corrected.run.drift.end_expected_m
    if not names or corrected.model.noise.coefficients.noise_free or not off_m > _NEAR_M:
        return []
    where = f"{names}: depends on the position, which by the end is uncertain by {off_m:.3g} m or more (1 sigma)"
    wrong = "it may have been taken out in the wrong place; that error is not in the noise above"
    return [f"{where}, so that {wrong}. `compare` uses the true position."]


def _oddities(outcome: Outcome) -> list[str]:
    return stream_oddities(
        outcome, follow="the correction", restart="each stretch was corrected by itself", late="not used to correct"
    )
