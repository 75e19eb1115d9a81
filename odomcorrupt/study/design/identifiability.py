"""Effects that the data could not show, with the physical reason, and detection limits of the others."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.effects.wheels import brings_track
from odomcorrupt.study.design.drives import best_plan, missing_motion
from odomcorrupt.study.design.information import sizes
from odomcorrupt.study.estimate.drive_type import GAINS_OF_TURNS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.design.drives import Drives, Gain
    from odomcorrupt.study.design.information import Field
    from odomcorrupt.study.design.plan import Plan
    from odomcorrupt.study.select.candidates import Candidate
    from odomcorrupt.study.select.result import Learned, Step

FOUND = 4.2
"""Size in standard errors at which an effect is found nearly always."""
_LARGE = 2.0
"""Multiple of its typical size from which an effect has to be detectable; smaller limits are stated as such."""
_RULER_ERRORS = 2.0
"""An unnamed scale of the wheels is reported if it exceeds this many standard errors of the laser's scale."""
MASKED = 4.0
"""An included term masks an effect if it increases the effect's standard error by this factor."""
_NO_TRACK = (
    "it acts on single wheels, and the distance between these is not known; give --track where the robot has two that "
    "drive and steer it"
)
_DATA_SHEET = "give --gyro-scale-accuracy from the data sheet"
_TAPE = "compare the map with a tape measure, and give --laser-scale-accuracy"
_REFUSALS = ("not testable", "not separable")
"""Beginnings of refusals that are due to the drive and not to the effect."""


@dataclass(frozen=True, slots=True)
class UntestableEffect:
    """An effect that these data could not show.

    why : the reason, in words
    plan : the drive that would show its typical size, or None
    hint : the alternative if there is no plan
    limited_by_truth : whether the limit is the scale of the sensor that serves as truth, and not the drive
    shows : expected nats of another drive in favour of a typical size, if there is a plan
    """

    effect: str
    why: str
    plan: Plan | None
    hint: str = ""
    limited_by_truth: bool = False
    shows: Gain | None = field(default=None, repr=False, compare=False)


@dataclass(frozen=True, slots=True)
class DetectionLimit:
    """The smallest detectable size of an effect's parameter, in its unit."""

    effect: str
    parameter: str
    size: float
    unit: str


def is_untestable(candidate: Candidate) -> bool:
    """Return whether a candidate was refused because of the drive, or even a large size was not detectable."""
    if candidate.refused.startswith(_REFUSALS) or not candidate.score.separable:
        return True
    sizes_of = zip(amplitudes(candidate.score.effect), candidate.score.standard_error, strict=True)
    return bool(candidate.refused) and any(FOUND * error > _LARGE * p.typical for p, error in sizes_of)


def untestable(drives: Drives, candidate: Candidate) -> UntestableEffect:
    """Return why a candidate cannot be tested on these drives, and the drive on which it could."""
    effect, runs = candidate.score.effect, drives.learned.fit.problem.recordings
    size, error = float(candidate.score.estimate[0]), float(candidate.score.standard_error[0])
    accuracy = max(r.turn_scale_error for r in runs)
    if effect.name in GAINS_OF_TURNS.values() and error < 2.0 * accuracy:
        why = f"the gyro's own scale is known to {100.0 * accuracy:.2g} % only"
        return UntestableEffect(effect.name, why, None, _DATA_SHEET, limited_by_truth=True)
    ruler = max(r.truth_scale_error for r in runs)
    if effect.name == "wheel_scale" and _RULER_ERRORS * ruler < abs(size) and error < 2.0 * ruler:
        why = f"the laser measures {100.0 * size:+.2f} %, and its own scale is known to {100.0 * ruler:.2g} % only"
        return UntestableEffect(effect.name, why, None, _TAPE, limited_by_truth=True)
    beside = [e for e in drives.learned.fit.effects if e.name != effect.name]
    typical = np.array([p.typical for p in amplitudes(effect)])

    def shows(drive: Field) -> float:
        return float(np.min(0.5 * (typical / sizes(effect, beside, [drives.recorded, drive])) ** 2))

    return hidden(drives, type(effect), shows, _short_of(candidate), _masks(drives, effect, beside))


def hidden(drives: Drives, kind: type[Effect], shows: Gain, short_of: str, masks: Sequence[str]) -> UntestableEffect:
    """Return why an effect cannot be tested on these drives, and the drive on which it could.

    shows : expected nats of another drive
    short_of : the reason if no motion is missing
    masks : names of the terms that mask the effect
    """
    plan, nats = best_plan(drives, shows)
    why = missing_motion(drives, shows, nats) or short_of
    why += f", and on this drive it resembles {' and '.join(masks)}" if masks else ""
    if nats < 0.5 * FOUND**2:
        return UntestableEffect(kind.name, why, None, kind.about.drive if kind.about else "")
    return UntestableEffect(kind.name, why, plan, shows=shows)


def _masks(drives: Drives, effect: Effect, beside: Sequence[Effect]) -> list[str]:
    """Return the included terms that mask an effect: without them its standard error would be far smaller."""

    def error(others: Sequence[Effect]) -> float:
        return float(np.max(sizes(effect, others, [drives.recorded])))

    now = error(beside)
    return [e.name for e in beside if MASKED * error([o for o in beside if o is not e]) < now]


def _short_of(candidate: Candidate) -> str:
    """Return which parameter is too uncertain, for a candidate without missing motions."""
    if not candidate.score.separable:
        return "on this drive it resembles other effects"
    own = amplitudes(candidate.score.effect)
    p, error = max(
        zip(own, candidate.score.standard_error, strict=True),
        key=lambda pair: pair[1] / max(pair[0].high, -pair[0].low),
    )
    unit = f" {p.unit}" if p.unit else ""
    return f"too little motion that shows it: {p.name} is known to {float(error):.2g}{unit} only"


def untried(learned: Learned) -> list[UntestableEffect]:
    """Return effects that never became candidates: of single wheels without a track, of places visited only once.

    Effects of robots that move sideways are left out, because this robot does not.
    """
    have = {e.name for e in learned.fit.effects} | {c.score.effect.name for c in learned.rounds[-1].candidates}
    track = all(r.track_m is not None for r in learned.fit.problem.recordings)
    drive = learned.drive_type
    found = []
    for name, kind in registry().items():
        if (
            name in have
            or kind.kind in ("noise", "event")
            or kind.clock
            or kind.aliased_with is not None
            or kind.needs_sideways
            or not drive.admits(kind)
            or (drive.steered and kind.needs_track)
        ):
            continue
        single = kind.needs_track and not (track or brings_track(kind))
        why = _NO_TRACK if single else "this drive has no motion on which to test it"
        found.append(UntestableEffect(name, why, None, kind.about.drive if kind.about else ""))
    return found


def limits(step: Step) -> list[DetectionLimit]:
    """Return the detection limits of all testable effects."""
    return [
        DetectionLimit(c.name, p.name, FOUND * float(error), p.unit)
        for c in step.candidates
        if not is_untestable(c)
        for p, error in zip(amplitudes(c.score.effect), c.score.standard_error, strict=True)
    ]
