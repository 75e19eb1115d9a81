"""One bag corrected from end to end: read once for the whole drive, read again and written."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from odomcorrupt.bags.open import open_reader, open_writer
from odomcorrupt.correction.clock import ClockInverse
from odomcorrupt.correction.path import CorrectedPath, MeasuredPath
from odomcorrupt.corruption.run import corrupt_bag, outcome_of, provenance
from odomcorrupt.corruption.transform import Transform
from odomcorrupt.model.motion_model import MotionModel, Noise
from odomcorrupt.model.noise_laws import Coefficients

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from odomcorrupt.bags.block import Block
    from odomcorrupt.corruption.run import Container, Outcome
    from odomcorrupt.corruption.transform import Options
    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array

__all__ = ["SILENT", "Corrected", "Effects", "correct_bag", "split_effects"]

SILENT = MotionModel(Noise("diffusion", Coefficients(0.0, 0.0, 0.0, 0.0)))
"""Model that moves nothing, to read the odometry with."""


@dataclass(frozen=True, slots=True)
class Effects:
    """Effects of a model that do something: those that correction takes out, and those it cannot."""

    undone: tuple[Effect, ...]
    left: tuple[Effect, ...]


def split_effects(model: MotionModel) -> Effects:
    """Sort a model's effects: random ones cannot be undone, unless the odometry itself shows what was drawn."""
    active = [effect for effect in model.effects if effect.acts]
    return Effects(
        tuple(effect for effect in active if effect.kind != "noise" or effect.restorable),
        tuple(effect for effect in active if effect.kind == "noise" and not effect.restorable),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Corrected:
    """What a correction did.

    model : the model that was corrected for
    effects : those taken out, and those left
    unplaced : effects of place whose frame was taken to be the odom frame because no start was given
    run : what was moved; drawn values of its drift say how far, expected ones what the noise still does
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
    """Correct a bag; a target of None is a pipe. The output appears when it is complete, or not at all.

    start_xyt : (3,) where the odometry begins, metres and radians, in the frame whose places effects read

    Raises
    ------
    BagError
        Where the input cannot be read or the output not be written.
    TopicError
        Where no odometry is there to be corrected.
    EffectError
        Where no true motion explains the odometry.

    """
    effects = split_effects(model)
    if not effects.undone:
        copied = corrupt_bag(source, target, SILENT, seed=0, run=0, options=options, container=container, watch=watch)
        return Corrected(model=model, effects=effects, unplaced=(), run=copied)
    path = CorrectedPath(_measured(source, options, container).corrected(model, start_xyt))
    clocks = tuple(effect for effect in effects.undone if effect.clock)
    still = tuple(effect for effect in effects.undone if not effect.clock)
    moving = replace(model, effects=(*still, ClockInverse(clocks)))
    transform = Transform(moving, 0, 0, options, path=path)
    with open_reader(source, recover=container.recover) as reader:
        transform.odometry.prepare(reader, reader.name)
        writer = open_writer(
            target, reader, overwrite=container.overwrite, compression=container.compression, level=container.level
        )
        with writer:
            for block in transform.blocks(reader, reader.name, writer):
                writer.write(block)
                watch(block)
            transform.require_frame()
            writer.provenance("odomcorrupt_correct", provenance(model))
        outcome = outcome_of(transform, reader, model, seed=0, run=0)
    unplaced = tuple(effect for effect in still if start_xyt is None and effect.reads_places)
    return Corrected(model=model, effects=effects, unplaced=unplaced, run=outcome)


def _measured(source: Path, options: Options, container: Container) -> MeasuredPath:
    """Read the odometry, in the order in which it will be read again."""
    transform, measured = Transform(SILENT, 0, 0, options), MeasuredPath()
    transform.watchers.append(measured)
    with open_reader(source, recover=container.recover) as reader:
        for _ in transform.blocks(reader, reader.name):
            pass
    return measured
