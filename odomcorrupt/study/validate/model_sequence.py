"""Model sequence: the models before each inclusion and the final one, evaluated on held-out data."""

from __future__ import annotations

from typing import TYPE_CHECKING

from odomcorrupt.study.estimate.calibrate import model_of
from odomcorrupt.study.validate.compare import compare

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.study.io.recording import Recording
    from odomcorrupt.study.select.stepwise import Learned
    from odomcorrupt.study.validate.compare import Comparison

__all__ = ["sequence_comparison"]


def sequence_comparison(
    learned: Learned, recordings: Sequence[Recording], first: str = "without effects"
) -> Comparison:
    """Return the comparison of the model before each inclusion and of the final one, named by the added term.

    recordings : evaluation data; recordings used in the selection are split in halves, one fitted and one evaluated
    first : name of the initial model
    """
    steps = learned.steps
    # Terms that were included and dropped again are not steps.
    before = [step.before for step in (*learned.rounds[:1], *steps[1:])] if steps else []
    fits = [*before, learned.fit]
    names = [first, *(f"+ {step.name}" for step in steps)]
    return compare(recordings, {name: model_of(fitted) for name, fitted in zip(names, fits, strict=True)})
