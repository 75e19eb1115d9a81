"""Advice on the next drive: aliased names, untestable effects, and the drive that resolves them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import amplitudes, choices
from odomcorrupt.effects.wheels import brings_track
from odomcorrupt.study.design.drives import ENOUGH_NATS, Drives, best_plan, missing_motion, most_useful
from odomcorrupt.study.design.information import separation, sizes
from odomcorrupt.study.estimate.drive_type import GAINS_OF_TURNS, readings_of
from odomcorrupt.study.select.decisions import DECISIONS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.design.drives import Gain
    from odomcorrupt.study.design.information import Field
    from odomcorrupt.study.design.plan import Plan
    from odomcorrupt.study.select.candidates import Candidate
    from odomcorrupt.study.select.result import Learned, Step

FOUND = DECISIONS.testable_errors
"""Size in standard errors at which an effect is found nearly always."""
_LARGE = 2.0
"""Multiple of its typical size from which an effect has to be detectable; smaller limits are stated as such."""
_RULER_ERRORS = 2.0
"""An unnamed scale of the wheels is reported if it exceeds this many standard errors of the laser's scale."""
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

    plan, nats = best_plan(drives, shows)
    why = missing_motion(drives, shows, nats) or _short_of(candidate)
    if nats < 0.5 * FOUND**2:
        return UntestableEffect(effect.name, why, None, effect.about.drive if effect.about else "")
    return UntestableEffect(effect.name, why, plan, shows=shows)


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


TOO_FEW_NATS = DECISIONS.alternative_nats
"""If ten minutes of the best drive yield less, nats, they do not separate the effects, and no drive is recommended."""

_LOSSES_HINT = "ticks are too coarse to show a lost increment; publish odometry less often, several ticks an increment"
"""Way to separate a larger wheel from lost increments if an increment is only a tick or two."""

_NOT_FITTED = "others explain it better"
"""Refusal of a candidate that was possible by itself but not among the few that were fitted."""


@dataclass(frozen=True, slots=True)
class Ambiguity:
    """Aliased names: effects that these data do not separate.

    why : motion that the drive lacked; "" if none
    plan : the drive that would separate them, or None if no drive can
    nats : expected log likelihood ratio in favour of the right one
    hint : if no drive separates them, what else does; "" if they are merely too small
    gain : expected nats of another drive, if a drive can separate them
    """

    names: tuple[str, ...]
    why: str
    plan: Plan | None
    nats: float
    hint: str = ""
    gain: Gain | None = field(default=None, repr=False, compare=False)


def _ambiguity(drives: Drives, names: tuple[str, ...], gain: Gain) -> Ambiguity:
    """Return an ambiguity with the drive that would separate the names, if one does; gain : nats of another drive."""
    plan, nats = best_plan(drives, gain)
    if nats < TOO_FEW_NATS:
        return Ambiguity(names, "", None, nats)
    return Ambiguity(names, missing_motion(drives, gain, nats), plan, nats, gain=gain)


def open_ambiguities(drives: Drives, step: Step) -> list[Ambiguity]:
    """Return the ambiguities left by a selection step."""
    if step.added is None:
        return []
    kinds = registry()
    rivals = {c.score.effect.name: c for c in step.candidates}
    names = [n for n in step.alternatives if n in rivals]
    found = []
    for name in names:
        pair = (rivals[step.added], rivals[name])
        one, other = ((_as_fitted(c),) for c in pair)
        gain = _gain_of(drives, one, other, max(c.score.inflation for c in pair))
        found.append(_ambiguity(drives, (step.added, name), gain))
    if drives.learned.may_be_losses(step.added):
        found.append(Ambiguity((step.added, "lost_increments"), "", None, 0.0, _LOSSES_HINT))
    said = {step.added, *(name for choice in found for name in choice.names)}
    drive = drives.learned.drive_type
    for twin, kind in kinds.items():
        if kind.aliased_with in said and twin not in said and twin in readings_of(str(kind.aliased_with), drive):
            hint = "; ".join(filter(None, (kind.about.drive if kind.about else "", _correction_hint(drives, kind))))
            found.append(Ambiguity((str(kind.aliased_with), twin), "", None, 0.0, hint))
    return found


def _correction_hint(drives: Drives, twin: type[Effect]) -> str:
    """Return how to apply the robot's twin of a set-up effect in `correct`, which ignores set-up effects; or ""."""
    own = drives.learned.fit.by_name.get(twin.aliased_with or "")
    if own is None or own.kind != "setup" or twin.kind == "setup":
        return ""
    values = ",".join(f"{p.name}={getattr(own, p.name):.4g}" for p in amplitudes(twin))
    return (
        f"if it is the robot and not where the truth is taken, a correction removes it only as {twin.name}: "
        f"give `correct` --effect {twin.name}:{values}"
    )


def _gain_of(drives: Drives, one: Sequence[Effect], other: Sequence[Effect], inflation: float) -> Gain:
    """Return a function of a drive: the expected nats it adds to the separation of two models, in the worse case."""
    beside = [e for e in drives.learned.fit.effects if e.name not in {own.name for own in (*one, *other)}]
    pairs = [
        pair
        for x in _variants(drives, one, beside)
        for y in _variants(drives, other, beside)
        for pair in ((x, y), (y, x))
    ]

    def nats(*drive: Field) -> float:
        fields = [drives.recorded, *drive]
        return min(separation(x, y, beside, fields) for x, y in pairs) / inflation

    known = nats()
    return lambda drive: nats(drive) - known


def _variants(drives: Drives, effects: Sequence[Effect], beside: Sequence[Effect]) -> list[Sequence[Effect]]:
    """Return a single effect with every heading source that these data leave open, its own first; others as they are.

    Straights do not show whether wheels or a gyro give the heading; the information of a turn depends on it.
    """
    if len(effects) > 1:
        return [effects]
    (effect,) = effects
    words = choices(effect).get("heading", ())
    others = [replace(effect, heading=word) for word in words if word != getattr(effect, "heading", word)]  # type: ignore[type-var]
    unseen = [o for o in others if separation((effect,), (o,), beside, [drives.recorded]) < ENOUGH_NATS]
    return [(variant,) for variant in (effect, *unseen)]


def _as_fitted(candidate: Candidate) -> Effect:
    """Return the effect with its fitted amplitude, or with its estimated one if it was not fitted."""
    effect, estimate = candidate.score.effect, candidate.score.estimate
    if candidate.fitted is None:
        sizes = {p.name: float(value) for p, value in zip(amplitudes(effect), estimate, strict=True)}
        return replace(effect, **sizes)  # type: ignore[type-var]  # effects are dataclasses
    return candidate.fitted


@dataclass(frozen=True, slots=True)
class Advice:
    """Open questions after a selection; `best` is the plan that answers most of them, ambiguities first."""

    choices: tuple[Ambiguity, ...]
    untestable: tuple[UntestableEffect, ...]
    limits: tuple[DetectionLimit, ...]
    best: Plan | None


def advise(learned: Learned) -> Advice:
    """Return the questions that these data leave open, and the drives that would answer them."""
    drives = Drives(learned)
    choices = list[Ambiguity]()
    for step in learned.steps:
        choices += open_ambiguities(drives, step)
    last = learned.rounds[-1]
    named = {name for choice in choices for name in choice.names}
    refused = [c for c in last.candidates if is_untestable(c) and c.score.effect.name not in named]
    unseen = [untestable(drives, c) for c in refused]
    gains = [choice.gain for choice in choices if choice.gain is not None]
    shown = [one.shows for one in unseen if one.shows is not None]
    unseen += untried(learned)
    best = most_useful(drives, gains, shown) if gains or shown else None
    limits = [
        DetectionLimit(c.name, p.name, FOUND * float(error), p.unit)
        for c in last.candidates
        if not is_untestable(c)
        for p, error in zip(amplitudes(c.score.effect), c.score.standard_error, strict=True)
    ]
    return Advice(tuple(choices), tuple(unseen), tuple(limits), best)
