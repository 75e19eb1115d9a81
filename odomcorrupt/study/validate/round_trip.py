"""Verification that a fitted model is usable: its file can be read, and it corrects and corrupts the fitted drives.

A dependence fitted to moderate motion may exceed a faster motion, or a parameter may be out of bounds. `correct` and
`corrupt` would refuse such a model. A failing part is dropped, which is reported, also in the model file.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.correction.undo import undo_effects
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.effects.effect import amplitudes, parameters
from odomcorrupt.effects.expression import UserEffect
from odomcorrupt.errors import EffectError, ModelError, OdomCorruptError
from odomcorrupt.geometry.se2 import compose, inverse
from odomcorrupt.model.model_file import format_model, parse_model
from odomcorrupt.study.estimate.problem import undo
from odomcorrupt.study.estimate.windows import drift_of
from odomcorrupt.study.io.clock import Clock, aligned
from odomcorrupt.study.io.headings import with_recomputed_headings
from odomcorrupt.study.validate.predictive_check import overlapping, smooth_truth

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import MotionModel
    from odomcorrupt.study.io.recording import Recording

RUNS = 20
"""Corrupted runs that must succeed for a model with random effects; without these all runs are equal. The first covers
all recordings, each other one `_STRETCH_S` of one of them, because random effects show in a few minutes."""
_STRETCH_S = 300.0
_MIN_DIFFERENCE = 0.05
"""Relative difference within which two errors count as equal."""


@dataclass(frozen=True, slots=True)
class RoundTrip:
    """A model that can be read back, correct and corrupt.

    changes : descriptions of the changes that this needed
    left_out : why each effect of the fitted model that it lacks was left out, by name
    """

    model: MotionModel
    changes: tuple[str, ...] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class _Drive:
    """One fitted recording with corrected clock, and the smoothed truth at its odometry (n, 3)."""

    recording: Recording
    true_xyt: Array


def verified_model(model: MotionModel, recordings: Sequence[Recording]) -> RoundTrip:
    """Return the model in a usable form, and the changes made.

    model : as fitted
    recordings : those that it was fitted to; clocks come from the model's set-up
    """
    drives = [_drive(model, recording) for recording in recordings]
    changes: list[str] = []
    left_out: dict[str, str] = {}
    model = _within_bounds(model, changes)
    while failure := _failure(model, drives):
        # dependences, random effects, others, the latest first
        latest = model.effects[::-1]
        laws = [effect for effect in latest if isinstance(effect, UserEffect)]
        random = [effect for effect in latest if effect.kind == "noise" and effect.acts]
        others = [effect for effect in latest if effect not in (*laws, *random)]
        fewer = [_without(model, effect) for effect in (*laws, *random, *others)]
        # If leaving out no single effect helps, the weakest is dropped, and others are tried.
        repaired, change = next((one for one in fewer if not _failure(one[0], drives)), fewer[0])
        changes.append(f"{change}: {failure}")
        left_out |= dict.fromkeys(_names(model) - _names(repaired), failure)
        model = repaired
    said = (*changes, *bound_notes(model), *_correction_note(model, drives))
    if said:
        model = replace(model, source=dict(model.source) | {"remarks": list(said)})
    return RoundTrip(model, said, left_out)


def _names(model: MotionModel) -> set[str]:
    return {effect.name for effect in model.effects}


def bound_notes(model: MotionModel) -> tuple[str, ...]:
    """Return a sentence for each parameter at its bound."""
    notes = []
    for effect in (*model.effects, *model.setup.effects):
        for p in amplitudes(effect):
            value = getattr(effect, p.name)
            if value != p.identity and min(value - p.low, p.high - value) <= 1e-6 * (p.high - p.low):
                notes.append(
                    f"{effect.name}.{p.name} = {value:.4g} {p.unit}".rstrip() + " is at its physical bound: the "
                    "robot's nominal values, units or topics are wrong, or the cause is another one"
                )
    return tuple(notes)


def _correction_note(model: MotionModel, drives: Sequence[_Drive]) -> list[str]:
    """Return why the errors of `correct` and of the fit differ, if they do.

    The fit uses accelerations of smoothed motion and the places of the truth, the correction those between successive
    poses unless the odometry is rough, and the places of the odometry. The set-up belongs to the truth.
    """
    reading = [effect for effect in model.effects if effect.reads_truth and effect.kind != "noise"]
    # a laser's mounting is known from its scans
    setup = () if all(drive.recording.matched for drive in drives) else model.setup.effects
    if not (reading or setup):
        return []
    beside = () if setup else model.setup.effects
    left_m, fitted_m = _corrected_error(model.effects, beside, drives), _fitted_error(model, drives)
    if not abs(left_m - fitted_m) > _MIN_DIFFERENCE * fitted_m:
        return []
    reasons = []
    if setup:
        names = " and ".join(effect.name for effect in setup)
        reasons.append(
            f"{names} (the position of the truth's tracked point) is not part of `correct`; give it with --effect to "
            "have it taken out, too"
        )
    if reading:
        why = "reads accelerations, and from one pose to the next these are rougher than the fit's smooth ones"
        if all(effect.reads_places for effect in reading):
            why = "acts at places, which drifting odometry reaches too early or late; corruption follows the true path"
        reasons.append(f"{' and '.join(effect.name for effect in reading)} {why}")
    errors = f"leaves {left_m * 1e3:.1f} mm after 10 s on the fitted data, the fit {fitted_m * 1e3:.1f} mm"
    return [f"`correct` with this model {errors}: {'; '.join(reasons)}"]


def _drive(model: MotionModel, recording: Recording) -> _Drive:
    clock = Clock(*model.setup.clocks.get(recording.name, (0.0, 0.0)))
    whole = overlapping(with_recomputed_headings(aligned(recording, clock)))
    return _Drive(whole, smooth_truth(whole)[0])


def _within_bounds(model: MotionModel, changes: list[str]) -> MotionModel:
    """Return the model with every parameter within its bounds."""

    def held(effect: Effect) -> Effect:
        values = {}
        for p in parameters(effect):
            value = getattr(effect, p.name)
            inside = float(np.clip(value, p.low, p.high)) if np.isfinite(value) else p.identity
            if inside != value:
                values[p.name] = inside
                changes.append(f"{effect.name}.{p.name}: {value:.4g} was fitted, {inside:.4g} is possible, and written")
        return replace(effect, **values) if values else effect  # type: ignore[type-var]  # effects are dataclasses

    effects = tuple(held(effect) for effect in model.effects)
    return replace(model, effects=effects, setup=replace(model.setup, effects=tuple(map(held, model.setup.effects))))


def _failure(model: MotionModel, drives: Sequence[_Drive]) -> str:
    """Return the reason why a model cannot be used on these drives; "" if it can."""
    try:
        model = parse_model(format_model(model))
    except (ModelError, EffectError) as error:
        return f"its file would be refused ({error})"
    random = any(effect.kind == "noise" and effect.acts for effect in model.effects)
    plain = replace(model, source={})  # where a learned model has no inverse, corruption would use a lower speed
    for drive in drives:
        try:
            moved = _correction(model.effects, drive)
        except OdomCorruptError:
            return "the fitted odometry could not be corrected with it"
        if not np.isfinite(moved).all():
            return "the fitted odometry corrected with it is not finite"
    for run in range(RUNS if random else 1):
        for drive, rows in _driven(drives, run):
            stamps_ns = drive.recording.odometry.stamps_ns[rows]
            try:
                moved = NoisyPath(plain, 0, run).feed(stamps_ns, drive.true_xyt[rows]).error_xyt
            except OdomCorruptError:
                return "no odometry satisfies it on the fitted drive"
            if not np.isfinite(moved).all():
                return "the fitted drive corrupted with it is not finite"
    return ""


def _driven(drives: Sequence[_Drive], run: int) -> Iterator[tuple[_Drive, slice]]:
    """Yield drives with row ranges for a run: everything in the first run, a stretch of one of them in the others."""
    if run == 0:
        yield from ((drive, slice(None)) for drive in drives)
        return
    turn, number = divmod(run, len(drives))
    drive, share = drives[number], turn / max((RUNS - 1) // len(drives), 1)
    t_s = drive.recording.odometry_s
    begin_s = t_s[0] + max(float(t_s[-1] - t_s[0]) - _STRETCH_S, 0.0) * share
    first, last = np.searchsorted(t_s, (begin_s, begin_s + _STRETCH_S), side="right")
    yield drive, slice(max(int(first) - 1, 0), int(last))


def _fitted_error(model: MotionModel, drives: Sequence[_Drive]) -> float:
    """Return the position error (m) after 10 s of the fit on its data."""
    effects = (*model.effects, *model.setup.effects)
    return drift_of([with_recomputed_headings(undo(d.recording, effects)) for d in drives]).rmse


def _correction(effects: Sequence[Effect], drive: _Drive) -> Array:
    """Return corrected minus measured poses (n, 3), computed as by `correct`; places are in the truth's frame."""
    frame = compose(drive.true_xyt[0], inverse(drive.recording.odometry.xyt[0]))
    t_s, xyt, track_m = drive.recording.odometry_s, drive.recording.odometry.xyt, drive.recording.track_m
    return undo_effects(effects, t_s, xyt, track_m, frame_xyt=frame).error_xyt


def _corrected_error(effects: Sequence[Effect], setup: Sequence[Effect], drives: Sequence[_Drive]) -> float:
    """Return the position error (m) after 10 s of `correct` on the fitted data, with these set-up effects removed."""
    runs = []
    for drive in drives:
        before = drive.recording.odometry
        odometry = replace(before, xyt=before.xyt + _correction(effects, drive))
        runs.append(with_recomputed_headings(undo(replace(drive.recording, odometry=odometry), setup)))
    return drift_of(runs).rmse


def _without(model: MotionModel, effect: Effect) -> tuple[MotionModel, str]:
    numbers = ", ".join(f"{p.name} = {getattr(effect, p.name):.4g} {p.unit}".rstrip() for p in parameters(effect))
    text = f", {effect.expression.text}" if isinstance(effect, UserEffect) else ""
    others = tuple(e for e in model.effects if e is not effect)
    return replace(model, effects=others), f"{effect.name} ({numbers}{text}) left out"
