"""The ladder of a search: every model on the way, judged on halves of the recordings that it was not fitted on."""

from __future__ import annotations

from typing import TYPE_CHECKING

from odomcorrupt.study.fitting.robot import model_of
from odomcorrupt.study.judge.compare import compare

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.study.judge.compare import Comparison, Judgement
    from odomcorrupt.study.recordings.trajectory import Recording
    from odomcorrupt.study.search.learn import Learned

__all__ = ["held_out_ladder", "ladder_comparison"]


def ladder_comparison(learned: Learned, recordings: Sequence[Recording], first: str = "without effects") -> Comparison:
    """Return the comparison of the model before each addition and of the final one, each named by what it adds.

    recordings : those of the search
    first : what the model is called that the search began with
    """
    steps = [look for look in learned.rounds if look.added is not None]
    fits = [*(look.before for look in steps), learned.fit]
    names = [first, *(f"+ {look.added}" for look in steps)]
    return compare(recordings, {name: model_of(fitted) for name, fitted in zip(names, fits, strict=True)})


def held_out_ladder(learned: Learned, recordings: Sequence[Recording]) -> tuple[Judgement, ...]:
    """Return a judgement of the model before each addition and of the final one; recordings are those of the search."""
    return ladder_comparison(learned, recordings).judgements
