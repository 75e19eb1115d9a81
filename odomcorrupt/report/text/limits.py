"""What the data of a study leave open, in lines: alternatives, limits of the truth, of the drives, of the set-up."""

from __future__ import annotations

from dataclasses import replace
from math import degrees
from typing import TYPE_CHECKING

from odomcorrupt.effects import registry
from odomcorrupt.report.findings import clocks_found
from odomcorrupt.report.text.design import inseparable_sentence
from odomcorrupt.study.estimate.drive_type import readings_of
from odomcorrupt.summary import ALWAYS, FIRST, SPARE, Line, Summary

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.study.design.advise import Advice
    from odomcorrupt.study.estimate.calibrate import RobotFit
    from odomcorrupt.study.io.recording import Mistake
    from odomcorrupt.study.select.result import Learned

_LIKE_SINGLE_WHEELS = ("lever_arm", "icr_shift", "time_offset")
"""Effects that resemble errors of single wheels: a larger wheel shifts turns as the y of a lever arm does."""
_PER_METRE = {"rot_trans": "of heading", "trans_trans": "along", "across_trans": "across"}


def mistakes_first(brief: Summary, mistakes: Sequence[Mistake]) -> Summary:
    """Return a summary that begins with plain mistakes: what is seen, usual causes, and what to change."""
    lines = []
    for one in mistakes:
        change = f"{one.change}; {one.then}" if one.then else one.change
        lines += [Line("MISTAKE", one.said, "bad", ALWAYS), Line("causes", one.causes, weight=FIRST)]
        lines.append(Line("change", change, "warning", ALWAYS))
    return Summary((*lines, *brief.lines), brief.most + len(lines))


def drive_lines(search: Learned) -> list[Line]:
    """Return the drive type, if names depend on an inferred one, or on the default of a robot that may be steered."""
    drive = search.drive_type
    if drive.reason:
        return [Line("drive type", f"{drive.sentence}; --drive-type overrules it")]
    of_wheels = {kind.unsteered for kind in registry().values()} & set(search.added)
    if not (drive.least_radius_m and of_wheels):
        return []
    said = f"it never turned on the spot (smallest radius {drive.least_radius_m:.2g} m): if it steers, --drive-type car"
    return [Line("drive type", said, "warning")]


def track_lines(search: Learned, *, failed: bool) -> list[Line]:
    """Return the approximations due to an unknown track, if a finding may depend on them."""
    recordings = search.fit.problem.recordings
    if search.drive_type.name != "differential" or any(r.track_m is not None for r in recordings):
        return []
    named = (*search.added, *(one.name for one in search.unknown))
    if not (named or failed or any(clocks_found(search.clocks))):
        return []
    fitted = [e.name for e in search.fit.effects if getattr(e, "track", 0.0)]
    ghosts = [name for name in search.added if name in _LIKE_SINGLE_WHEELS]
    said = f"that of {', '.join(fitted)} was fitted" if fitted else "errors of single wheels are approximated"
    said += f", {', '.join(ghosts)} may come from them" if ghosts else ""
    return [Line("track", f"not given: {said}; measure it (--track)", "warning")]


def open_lines(search: Learned, advice: Advice) -> list[Line]:
    """Return the alternatives that the data cannot separate and the drive to do so, if there are any that matter."""
    matters = tuple(choice for choice in advice.choices if not search.is_negligible(choice.names[0]))
    said = inseparable_sentence(replace(advice, choices=matters), lambda name: readings_of(name, search.drive_type))
    return [Line("open", said, "warning", SPARE)] if said else []


def limit_lines(advice: Advice) -> list[Line]:
    """Return the effects hidden by the scale error of a gyro or laser that serves as truth, and the remedy."""
    hidden = [one for one in advice.untestable if one.limited_by_truth]
    return [Line("not testable", f"{one.effect}: {one.why}; {one.hint}", "warning") for one in hidden]


def untested_lines(search: Learned, advice: Advice) -> list[Line]:
    """Return the frequent causes that the drives could not show, for a model without findings."""
    common = search.decisions.common
    names = [one.effect for one in advice.untestable if one.effect in common and not one.limited_by_truth]
    said = f"{', '.join(names)}: not visible in these data (-v: why, and what would show it)"
    return [Line("not testable", said, "warning")] if names else []


def hidden_noise(result: RobotFit | None) -> list[Line]:
    """Return a line on noise for which a localisation gives only an upper bound."""
    hidden = [] if result is None else [i for i in result.noise_at_most if i.name in _PER_METRE]
    if not hidden:
        return []
    bounds = [f"{degrees(i.high):.2g} deg" if i.name == "rot_trans" else f"{i.high * 1e3:.2g} mm" for i in hidden]
    most = ", ".join(f"{bound} {_PER_METRE[i.name]}" for bound, i in zip(bounds, hidden, strict=True))
    return [
        Line(
            "noise",
            f"at most {most} after a metre (95 %): the localisation's own errors mask it; the model has the estimate",
        )
    ]
