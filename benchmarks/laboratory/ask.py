"""Run of each case: one function per kind of arm, with plain numbers as results."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from hidden import as_recording, ten_second_error

from laboratory.answer import plain_answer
from laboratory.drives import judges, learning_run
from laboratory.information import expected_information
from laboratory.invariance import variants
from laboratory.planted import planted
from laboratory.sham import sham
from odomcorrupt.effects.expression import user_effect
from odomcorrupt.errors import EffectError
from odomcorrupt.simulation import OUTSIDE
from odomcorrupt.study.select.selection import learn

if TYPE_CHECKING:
    from laboratory.cases import Case
    from odomcorrupt.study.io.recording import Recording
    from odomcorrupt.study.select.result import Learned

__all__ = ["ask"]


def ask(case: Case, real: str) -> dict[str, Any]:
    """Return the results of a case."""
    if case.arm == "planted":
        return planted(case, Path(real))
    if case.arm == "body":
        return _body(case)
    run = learning_run(case)
    recording = as_recording(run)
    if case.arm == "invariance":
        return variants(case, run)
    learned, seconds = _learned(recording)
    answer = plain_answer(learned)
    row: dict[str, Any] = {"answer": answer, "learn_s": seconds, "truth": run.answer["causes"]}
    if case.arm in ("single", "outside"):
        row["expected"] = expected_information(case)
    judged, floor = judges(case)
    row["error"] = _errors(learned, judged, floor)
    if case.arm == "controls":
        row["sham"] = sham(case, recording, judged)
    if case.arm == "outside":
        row["depends_on"] = OUTSIDE[case.causes[0]].depends_on
        row["error"]["offered"] = _offered(learned, judged)
    return row


def _learned(recording: Recording) -> tuple[Learned, float]:
    begun = time.process_time()
    learned = learn([recording])
    return learned, time.process_time() - begun


def _errors(learned: Learned, judged: Recording, floor: Recording) -> dict[str, float]:
    """Return 10 s errors (m) of another drive: uncorrected, with the learned effects, and without the fault."""
    clock = learned.fit.problem.clocks[0]
    return {
        "before": ten_second_error([judged]),
        "after": ten_second_error([judged], learned.fit.effects, clock),
        "floor": ten_second_error([floor]),
    }


def _offered(learned: Learned, judged: Recording) -> float | None:
    """Return the 10 s error with the first offered expression added as well; None if none is offered.

    An expression that is part of the model has been added already. An expression that is offered in the place of an
    effect replaces that effect.
    """
    if not learned.unknown:
        return None
    if learned.unknown[0] in learned.laws:
        return ten_second_error([judged], learned.fit.effects, learned.fit.problem.clocks[0])
    try:
        offered = learned.unknown[0]
        effect = user_effect("offered", offered.expression, {})
        others = (e for e in learned.fit.effects if e.name not in offered.instead_of)
        return ten_second_error([judged], (*others, effect), learned.fit.problem.clocks[0])
    except EffectError:
        return float(np.inf)


def _body(case: Case) -> dict[str, Any]:
    """Return the answer learned from a body simulated in MuJoCo."""
    from mujocosim import simulate_body  # noqa: PLC0415 - heavy, and needed here alone

    run = simulate_body(case.seed, case.causes[0], duration_s=300.0)
    learned, seconds = _learned(as_recording(run))
    return {
        "answer": plain_answer(learned),
        "learn_s": seconds,
        "truth": run.answer["causes"],
        "body": run.answer["body"],
    }
