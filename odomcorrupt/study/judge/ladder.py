"""The ladder of a search: every model on the way, judged on halves of the recordings that it was not fitted on."""

from __future__ import annotations

from typing import TYPE_CHECKING

from odomcorrupt.study.fitting.robot import model_of
from odomcorrupt.study.judge.compare import compare

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.study.judge.compare import Judgement
    from odomcorrupt.study.recordings.trajectory import Recording
    from odomcorrupt.study.search.learn import Learned

__all__ = ["held_out_ladder"]


def held_out_ladder(learned: Learned, recordings: Sequence[Recording]) -> tuple[Judgement, ...]:
    """Return a judgement of the model before each addition and of the final one; recordings are those of the search."""
    fits = [look.before for look in learned.rounds if look.added is not None]
    models = {f"{step}": model_of(fitted) for step, fitted in enumerate([*fits, learned.fit])}
    return compare(recordings, models).judgements
