"""Model sequence: the model before each inclusion and the final one, evaluated on data that they were not fitted on."""

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
    """Return the comparison of the model before each addition and of the final one, each named by what it adds.

    recordings : what to judge on; those of the search are cut in halves, one fitted and the other judged
    first : what the model is called that the search began with
    """
    steps = learned.steps
    # what was included and dropped again is no step
    before = [look.before for look in (*learned.rounds[:1], *steps[1:])] if steps else []
    fits = [*before, learned.fit]
    names = [first, *(f"+ {look.name}" for look in steps)]
    return compare(recordings, {name: model_of(fitted) for name, fitted in zip(names, fits, strict=True)})
