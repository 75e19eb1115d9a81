"""Correction of a bag, and its summary."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

import numpy as np

from odomcorrupt.bags.open import open_reader
from odomcorrupt.correction.undo import ClockInverse, pose_corrections, true_stamps, undo_effects
from odomcorrupt.corruption.covariance import SUMS, NoiseSteps, sum_terms
from odomcorrupt.corruption.path import LEG_M, PathSamples, StepGrowth, noise_variances
from odomcorrupt.corruption.run import corrupt_bag, outcome_of, provenance
from odomcorrupt.corruption.summary import (
    effect_words,
    leg_words,
    lost_lines,
    odometry_line,
    size_words,
    stream_oddities,
)
from odomcorrupt.corruption.transform import Transform
from odomcorrupt.errors import BagError, EffectError
from odomcorrupt.geometry.se2 import compose, inverse
from odomcorrupt.geometry.trajectory import evened
from odomcorrupt.summary import Line, Summary, command_line

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, Block
    from odomcorrupt.correction.undo import Undone
    from odomcorrupt.corruption.run import Container, Outcome
    from odomcorrupt.corruption.transform import Options
    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import MotionModel, Noise


class MeasuredPath:
    """Collects the path of the odometry of this `name` in `parts`; a reset of time begins a new stretch."""

    def __init__(self) -> None:
        self.name = ""
        self.parts: list[list[PathSamples]] = [[]]

    @classmethod
    def of(
        cls, reader: BagReader, model: MotionModel, options: Options, watch: Callable[[Block], None] = lambda _: None
    ) -> Self:
        """Return the path of a bag's odometry, sorted as in a corruption; `watch` is called with every block."""
        transform, measured = Transform(model.identity, 0, 0, options), cls()
        transform.watchers.append(measured)
        for block in transform.blocks(reader, reader.name):
            watch(block)
        measured.name = transform.odometry.name
        return measured

    def restart(self) -> None:
        """Begin a new stretch."""
        self.parts.append([])

    def add(self, samples: PathSamples) -> None:
        """Append the next part of the path."""
        if len(samples):
            self.parts[-1].append(samples)

    def corrected(self, model: MotionModel, start_xyt: Array | None = None) -> list[PathSamples | None]:
        """Return each stretch corrected; None for one without measurements.

        start_xyt : (3,) first pose in the frame of position-dependent effects; None: as the odometry states it
        """
        stretches: list[PathSamples | None] = []
        frame_xyt: Array | None = None
        first_ns: int | None = None
        for parts in self.parts:
            if not parts:
                stretches.append(None)
                continue
            stamps_ns = np.concatenate([samples.stamps_ns for samples in parts])
            first_ns = int(stamps_ns[0]) if first_ns is None else first_ns
            xyt = np.concatenate([samples.clean_xyt for samples in parts])
            if start_xyt is not None and frame_xyt is None:
                frame_xyt = compose(start_xyt, inverse(xyt[0]))
            stretches.append(corrected_samples(model, stamps_ns, xyt, first_ns=first_ns, frame_xyt=frame_xyt))
        return stretches


class CorrectedPath:
    """Source of corrected paths, fed with the measured poses from which they were computed."""

    def __init__(self, stretches: Sequence[PathSamples | None]) -> None:
        self._stretches = stretches
        self._number = self._next = 0

    def restart(self) -> None:
        """Continue with the next stretch."""
        self._number += 1
        self._next = 0

    def feed(self, stamps_ns: NDArray[np.int64], clean_xyt: Array) -> PathSamples:
        """Return the corrected path at the next n measured poses.

        Raises
        ------
        BagError
            If these are not the poses of the first pass.
        """
        whole = self._stretches[self._number] if self._number < len(self._stretches) else None
        rows = slice(self._next, self._next + len(stamps_ns))
        if whole is None or not np.array_equal(whole.stamps_ns[rows], stamps_ns):
            raise BagError("the odometry changed while it was being corrected; wait until the bag is complete")
        self._next = rows.stop
        first = rows.start == 0  # once per stretch
        return PathSamples(
            stamps_ns, clean_xyt, whole.error_xyt[rows], whole.sums[:, rows], whole.origin_xy,
            whole.travelled_m[rows], whole.jumps if first else 0, whole.sideways_m if first else 0.0,
        )  # fmt: skip


def corrected_samples(
    model: MotionModel,
    stamps_ns: NDArray[np.int64],
    measured_xyt: Array,
    *,
    first_ns: int,
    frame_xyt: Array | None = None,
) -> PathSamples:
    """Return the corrected path of one stretch of n poses, with the sums that the noise's covariances need.

    stamps_ns : (n,) header stamps as in the bag, ascending
    measured_xyt : (n, 3) measured poses, metres and radians, finite
    first_ns : first stamp of the odometry, the origin of the clocks' time
    frame_xyt : (3,) pose of the odom frame in the frame of position-dependent effects, None if it is the same
    """
    clocks = [effect for effect in model.effects if effect.clock]
    # rates from rounded stamps fluctuate: they are computed on the same even grid as in a fit
    even_ns = evened(stamps_ns)
    t_ns = true_stamps(clocks, stamps_ns if even_ns is None else even_ns, first_ns)
    t_s = (t_ns - t_ns[0]) * np.float64(1e-9)
    steps_xyt = pose_corrections(t_s, measured_xyt).error_xyt if model.setup.pose_corrections else 0.0
    undone = undo_effects(model.effects, t_s, measured_xyt + steps_xyt, model.track_m, frame_xyt=frame_xyt)
    origin_xy = measured_xyt[0, :2].copy()
    error_xyt = undone.error_xyt + steps_xyt
    sums = _sums(model.noise, undone, measured_xyt + error_xyt, origin_xy)
    world = np.diff(measured_xyt[:, :2], axis=0)
    travelled_m = np.concatenate(([0.0], np.cumsum(np.where(undone.jump, 0.0, np.hypot(world[:, 0], world[:, 1])))))
    return PathSamples(
        stamps_ns, measured_xyt, error_xyt, sums, origin_xy, travelled_m,
        int(np.count_nonzero(undone.jump)), float(np.abs(undone.driven.dl_m).sum()),
    )  # fmt: skip


def _sums(noise: Noise, undone: Undone, corrected_xyt: Array, origin_xy: Array) -> Array:
    """Return the running sums (SUMS, n) of the noise that remains in the corrected path."""
    driven = undone.driven
    v = noise_variances(noise, driven, undone.driven_s, StepGrowth()).variances
    bearing = np.zeros(len(driven))
    if noise.law.along_travel:
        bearing = np.arctan2(driven.dl_m, driven.ds_m)
    place = (corrected_xyt[:, :2] - origin_xy).T
    travel = corrected_xyt[:-1, 2] + driven.dtheta_rad / 2.0
    terms = sum_terms(NoiseSteps(v, place[:, :-1], place[:, 1:], travel, bearing, arc=noise.law.arc))
    return np.cumsum(np.concatenate((np.zeros((SUMS, 1)), terms), axis=1), axis=1)


@dataclass(frozen=True, slots=True)
class Effects:
    """Effects of a model off their identity: those that a correction removes, and those it cannot."""

    undone: tuple[Effect, ...]
    left: tuple[Effect, ...]


def split_effects(model: MotionModel) -> Effects:
    """Split a model's effects: random ones cannot be undone, unless the odometry itself shows the draws."""
    active = [effect for effect in model.effects if effect.acts]
    shown = [effect.kind != "noise" or effect.restorable or effect.shown_at_rest for effect in active]
    return Effects(
        tuple(effect for effect, can in zip(active, shown, strict=True) if can),
        tuple(effect for effect, can in zip(active, shown, strict=True) if not can),
    )


def require_start(model: MotionModel) -> None:
    """Raise EffectError if a model has position-dependent effects and the start pose in their frame is not given.

    Its effects of position and heading were learned in the frame of a truth; in another frame they increase errors.
    """
    names = ", ".join(effect.name for effect in model.placed)
    if names:
        raise EffectError(
            f"{names}: depends on position or heading in the frame of the truth that the model was learned from; give "
            "the pose at which this odometry begins in it with --start X,Y,THETA, or --start odom where that frame is "
            "the odometry's own"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Corrected:
    """Result of a correction.

    model : model that was used
    effects : effects removed, and effects left
    unplaced : effects of place for which the odom frame was assumed because no start pose was given
    run : messages modified; drawn values of its drift are the correction, expected ones the remaining noise
    """

    model: MotionModel
    effects: Effects
    unplaced: tuple[Effect, ...]
    run: Outcome


def correct_bag(
    source: Path,
    target: Path | None,
    model: MotionModel,
    *,
    options: Options,
    container: Container,
    start_xyt: Array | None = None,
    watch: Callable[[Block], None] = lambda _: None,
) -> Corrected:
    """Correct a bag; return the effects removed and left, and the messages modified.

    The output is written completely or not at all.

    source : measured bag, read twice
    target : corrected bag; None is a pipe
    model : effects to remove, and the noise that remains
    options : messages to modify
    container : reading and writing of bags
    start_xyt : (3,) pose at which the odometry begins in the frame of effects of place, metres and radians;
        None: as it states
    watch : called with every block written

    Raises
    ------
    BagError
        If the input cannot be read or the output cannot be written.
    TopicError
        If the bag has no odometry to correct.
    EffectError
        If no true motion explains the odometry.
    """
    effects = split_effects(model)
    if not (effects.undone or model.setup.pose_corrections):
        copied = corrupt_bag(
            source, target, model.identity, seed=0, run=0, options=options, container=container, watch=watch
        )
        return Corrected(model=model, effects=effects, unplaced=(), run=copied)
    with open_reader(source, recover=container.recover) as reader:
        path = CorrectedPath(MeasuredPath.of(reader, model, options).corrected(model, start_xyt))
    clocks = tuple(effect for effect in effects.undone if effect.clock)
    still = tuple(effect for effect in effects.undone if not effect.clock)
    moving = replace(model, effects=(*still, ClockInverse(clocks)))
    transform = Transform(moving, 0, 0, options, path=path)
    with open_reader(source, recover=container.recover) as raw:
        output = container.target(target, raw)
        reader = output.reader
        transform.odometry.prepare(reader, reader.name)
        with container.writer(target, output) as writer:
            for block in transform.blocks(reader, reader.name, writer):
                writer.write(block)
                watch(block)
            transform.require_source()
            writer.provenance("odomcorrupt_correct", provenance(model))
        outcome = outcome_of(transform, reader, model, seed=0, run=0)
    # learned models either have a start pose or were declared not to need one
    unplaced = tuple(e for e in still if start_xyt is None and e.reads_places and e not in model.placed)
    return Corrected(model=model, effects=effects, unplaced=unplaced, run=outcome)


_WHY_NOT = {
    "gyro_dead_band": "turns below its threshold were not reported",
    "quantization": "travel below the encoder's resolution was not reported",
    "heavy_tails": "its random draws were not recorded",
}
_RANDOM = "its random course was not recorded"
_OF_TRUTH = {"lever_arm": "the truth's tracked point", "mount_yaw": "how the truth is turned"}
_AT_REST = "is read where the robot stands for 0.6 s or more, interpolated between rests, and held after the last one"


def brief(corrected: Corrected, target: str) -> Summary:
    """Return the effects removed, the change of the end pose, the remaining error, and warnings.

    corrected : result of the correction
    target : the output; "-" is a pipe
    """
    drift, steps = corrected.run.drift, ["a filter's steps towards poses"] * corrected.model.setup.pose_corrections
    taken = ", ".join([*steps, *map(effect_words, corrected.effects.undone)])
    of_truth = ", ".join(
        f"{effect.name} ({_OF_TRUTH.get(effect.name, 'of the recordings')})"
        for effect in corrected.model.setup.effects
        if effect.acts and effect.name in _aside(corrected)
    )
    if taken:
        taken += f"; not {of_truth}" if of_truth else ""
        said = f"the end pose moves by {size_words(drift.end_drawn_m, drift.end_drawn_rad)}"
        lines = [Line("CORRECTED", said, "good", full=said + leg_words(drift)), Line("taken out", taken)]
    else:
        lines = [Line("UNCHANGED", "the model has no effect that can be taken out: the bag was copied", "warning")]
        lines += [Line("set-up", f"{of_truth}: no part of the odometry, so not taken out")] if of_truth else []
    lines += [Line("clock", sentence, "warning") for sentence in _clock_left(corrected)]
    if corrected.unplaced:
        names = ", ".join(effect.name for effect in corrected.unplaced)
        said = f"{names}: taken out at places and headings of the frame {corrected.run.frames.odom}"
        origin = corrected.model.setup.origin
        of = "that of the truth" + (f" (metres east and north of {origin})" if origin else "")
        full = f"{said}, taken to be {of}; if it is not, give the start of this drive in it with --start X,Y,THETA"
        lines.insert(1, Line("places", f"{said}; see --start", "warning", full=full))
    lines[1:1] = [Line("places", sentence, "warning") for sentence in _misplaced(corrected)]
    lines[1:1] = lost_lines(corrected.run)
    lines.append(odometry_line(corrected.run))
    lines += [Line("remains", f"{e.name}: {_WHY_NOT.get(e.name, _RANDOM)}", "warning") for e in corrected.effects.left]
    lines += [Line("remains", f"{e.name} {_AT_REST}") for e in corrected.effects.undone if e.shown_at_rest]
    if corrected.effects.undone and not corrected.model.noise.coefficients.noise_free:
        remains = f"noise: {size_words(drift.end_expected_m, drift.end_expected_rad)} expected at the end"
        if drift.leg_expected_m is not None and drift.leg_expected_rad is not None:
            remains += f", {size_words(drift.leg_expected_m, drift.leg_expected_rad)} per {LEG_M:.0f} m"
        lines.append(Line("remains", f"{remains} (1 sigma)."))
    odd = stream_oddities(
        corrected.run, follow="the correction", restart="each stretch was corrected by itself",
        late="not used to correct",
    )  # fmt: skip
    lines += [Line("anomaly", sentence, "warning") for sentence in odd if not sentence.startswith("Lost: ")]
    clocks = corrected.model.setup.clocks and not any(effect.clock for effect in corrected.effects.undone)
    if aside := [*_aside(corrected), *["clocks"] * bool(clocks)]:
        said = f"[setup] belongs to the recordings that were fitted and was not applied: {', '.join(aside)}"
        lines.append(Line("set-up", "", full=f"{said}; to take one of them out, too, give it with --effect"))
    following = () if target == "-" else (command_line(["odomcorrupt", "info", target]),)
    return Summary((*lines, *following))


def _aside(corrected: Corrected) -> list[str]:
    """Return the names of the set-up's effects, which are not taken out unless they are given."""
    given = {effect.name for effect in corrected.effects.undone}
    return [effect.name for effect in corrected.model.setup.effects if effect.name not in given]


def _clock_left(corrected: Corrected) -> list[str]:
    """Return how to remove the time offset of the fitted recordings, if it is significant and was not requested.

    It belongs to a recording's clocks and may be the truth's; it is corrected only if the odometry is always as late.
    """
    if any(effect.clock for effect in corrected.effects.undone):
        return []
    offsets = {name: offset_s for name, (offset_s, _) in corrected.model.setup.clocks.items()}
    name, offset_s = max(offsets.items(), key=lambda one: abs(one[1]), default=("", 0.0))
    # learned clock offset below which a correction is not suggested, seconds: a millimetre at 1 m/s
    if abs(offset_s) < 1e-3:
        return []
    why = f"time_offset {offset_s * 1e3:.3g} ms of {name} is not corrected: the truth's clock may cause it"
    side = "late" if offset_s > 0.0 else "early"
    return [f"{why}; if odometry stamps are that {side} in this bag, add --effect time_offset:offset={offset_s:.4g}"]


def _misplaced(corrected: Corrected) -> list[str]:
    """Return a warning if the position error is too large for effects that depend on the position."""
    names = ", ".join(effect.name for effect in corrected.effects.undone if effect.reads_places)
    off_m = corrected.run.drift.end_expected_m
    # position error that is negligible relative to a patch of the floor, metres: a turn on the other side of an edge
    # made a drift of 0.16 m one of 1.7 m
    if not names or corrected.model.noise.coefficients.noise_free or not off_m > 0.05:
        return []
    where = f"{names}: depends on the position, which by the end is uncertain by {off_m:.3g} m or more (1 sigma)"
    wrong = "it may have been taken out in the wrong place; that error is not in the noise above"
    return [f"{where}, so that {wrong}. `compare` uses the true position."]
