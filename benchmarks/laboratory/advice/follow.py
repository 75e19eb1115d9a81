"""Get advice on a first drive, drive the advised bag, and diagnose both drives together."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from hidden import as_recording

from laboratory.advice.blind import first_drive, on_the_way, place_of
from laboratory.advice.verdicts import settled
from laboratory.answer import plain_answer
from odomcorrupt.simulation import read_commands, simulate
from odomcorrupt.simulation.faults import SIZES
from odomcorrupt.study.design.advise import advise
from odomcorrupt.study.design.plan import drive_bag
from odomcorrupt.study.select.selection import learn

if TYPE_CHECKING:
    from laboratory.advice.cases import AdviceCase
    from odomcorrupt.simulation import Commands, SimulatedRun
    from odomcorrupt.study.design.advise import Advice

__all__ = ["follow"]

NEXT_SEED = 400_000
"""Offset of the seed for the following drive of the same robot."""
MOST_DRIVES = 2
"""Maximum number of advised drives: a second one if the first did not settle the cause; the goal is for the first."""


def follow(case: AdviceCase) -> dict[str, Any]:
    """Return the answers after the first drive and after each advised drive."""
    first = _run(case, 0, first_drive(case.first, case.seed))
    recordings = [on_the_way(case.first, as_recording(first, "first"))]
    looks = []
    for drive in range(MOST_DRIVES + 1):
        begun = time.process_time()
        learned = learn(recordings)
        between = time.process_time()
        advice = advise(learned)
        spent = {"learn_s": between - begun, "advise_s": time.process_time() - between}
        looks.append({"answer": plain_answer(learned), **_plain(advice), **spent})
        so_far = {"case": asdict(case), "looks": looks}
        route = _through_a_bag(advice)
        if route is None or drive == MOST_DRIVES or (drive and settled(so_far, drive)):
            break
        recordings.append(as_recording(_run(case, drive + 1, route), f"next {drive + 1}"))
    return {"truth": first.answer["causes"], "looks": looks}


def _plain(advice: Advice) -> dict[str, Any]:
    plan = advice.best
    return {
        "choices": [
            {"names": list(c.names), "why": c.why, "drive": c.plan.manoeuvre.name if c.plan else "", "nats": c.nats}
            for c in advice.choices
        ],
        "untestable": [
            {"effect": u.effect, "why": u.why, "drive": u.plan.manoeuvre.name if u.plan else ""}
            for u in advice.untestable
        ],
        "best": None if plan is None else {"drive": plan.manoeuvre.name, "minutes": plan.duration_s / 60.0},
    }


def _through_a_bag(advice: Advice) -> Commands | None:
    """Return the advised drive as a robot would get it: written to a bag by the program and read back."""
    if advice.best is None:
        return None
    with TemporaryDirectory() as folder:
        path = Path(folder) / "next.mcap"
        path.write_bytes(drive_bag(advice.best))
        return read_commands(path)


def _run(case: AdviceCase, drive: int, route: Commands) -> SimulatedRun:
    return simulate(
        case.seed + drive * NEXT_SEED,
        case.cause,
        route=route,
        duration_s=route.duration_s,
        size=SIZES[case.size],
        parameters=place_of(case.cause, case.seed),
        yaw_from=case.yaw_from,
        drive_type=case.drive_type,
        robot_seed=case.seed,
    )
