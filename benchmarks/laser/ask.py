"""Run of each drive: the same search with motion capture and with the laser as truth, with plain numbers as results."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from hidden import as_recording, ten_second_error
from laboratory.answer import errors_of, plain_answer
from laboratory.information import expected_information

from laser.cases import world_of
from laser.drives import EXACT, SCALE_ERROR, drive, laser_recordings, mocap_recording
from laser.gyro import ask_gyro
from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import between, compose, rotate, wrap
from odomcorrupt.simulation import simulate
from odomcorrupt.simulation.faults import SIZES
from odomcorrupt.study.design.advise import is_untestable
from odomcorrupt.study.select.selection import learn
from odomcorrupt.study.validate.held_out import drop_unsupported_parts

if TYPE_CHECKING:
    from collections.abc import Sequence

    from laboratory.cases import Case

    from laser.drives import Seen
    from odomcorrupt.study.io.laser_truth import LaserRun
    from odomcorrupt.study.io.recording import Recording
    from odomcorrupt.study.select.result import Learned

__all__ = ["ask"]

JUDGE_SEED, JUDGED_S = 400_000, 240.0


def ask(case: Case, *, gyro_walk: float | None = None) -> dict[str, Any]:
    """Return the results of a case.

    gyro_walk : random walk of the bias in the arm of the gyro, rad/s/sqrt(s); default: drawn
    """
    if case.arm == "gyro":
        return ask_gyro(case, gyro_walk)
    options: dict[str, Any] = {
        "size": SIZES.get(case.size, 1.0),
        "route": case.route,
        "yaw_from": case.yaw_from,
        "drive_type": case.drive_type,
    }
    causes = list(case.causes) or None
    seen = drive(case.seed, causes, world_of(case), duration_s=case.duration_s, **options)
    begun = time.process_time()
    try:
        recordings, run = laser_recordings(seen)
    except RecordingError as error:
        # nothing is named; the message lists the effects that are not testable
        return {"world": world_of(case), "refused": str(error)}
    matching_s = time.process_time() - begun
    mocap = _learned([mocap_recording(seen)])
    laser = _learned(recordings)
    answer = plain_answer(laser)
    row: dict[str, Any] = {
        "world": world_of(case),
        "answer": answer,
        "mocap": plain_answer(mocap),
        "truth": seen.run.answer["causes"],
        "scale": seen.scale,
        "lag_s": seen.lag_s,
        "matching_s": matching_s,
        "accuracy": _accuracy(seen, run),
        "weak": float(run.path.weak.mean()),
        "untestable": [c.score.effect.name for c in laser.rounds[-1].candidates if is_untestable(c)],
    }
    if case.causes:
        row["errors"] = {c: errors_of(row["truth"][c], c, answer["found"]) for c in case.causes}
        row["mocap_errors"] = {c: errors_of(row["truth"][c], c, row["mocap"]["found"]) for c in case.causes}
    if case.arm == "single":
        row["expected"] = expected_information(case, SCALE_ERROR)
        row["expected_by_mocap"] = expected_information(case)
    judged = simulate(case.seed + JUDGE_SEED, causes, truth=EXACT, duration_s=JUDGED_S, robot_seed=case.seed, **options)
    recording = as_recording(judged, "judged")
    row["error"] = {
        "before": ten_second_error([recording]),
        "mocap": ten_second_error([recording], _robots(mocap)),
        "laser": ten_second_error([_in_the_map(recording, seen, recordings[0])], _robots(laser)),
    }
    known = [_with_exact_scale(one, seen.scale) for one in recordings]
    row["error"]["exact_scale"] = ten_second_error([_in_the_map(recording, seen, known[0])], _robots(_learned(known)))
    return row


def _learned(recordings: Sequence[Recording]) -> Learned:
    """Return what a user gets: the result of the search without parts that fail on the halves of the drive."""
    return drop_unsupported_parts(learn(recordings))[0]


def _with_exact_scale(taught: Recording, scale: float) -> Recording:
    """Return a recording with the laser's drawn scale error divided out of its truth, and its scale taken as known."""
    xyt = taught.truth.xyt / (1.0 + scale, 1.0 + scale, 1.0)
    return replace(taught, truth=replace(taught.truth, xyt=xyt), truth_scale_error=0.0)


def _in_the_map(judged: Recording, seen: Seen, taught: Recording) -> Recording:
    """Return a recording with its exact truth in the frame of the laser's map, in which places and slopes were learned.

    The frame is fitted by least squares to all poses of the learned drive: a single pose has errors of millimetres.
    """
    origin_ns = int(seen.exact.stamps_ns[0])
    exact = seen.exact.at((taught.truth.stamps_ns - origin_ns) * 1e-9 - seen.lag_s, origin_ns)[:, :2]
    centre, laid = exact.mean(axis=0), taught.truth.xyt[:, :2].mean(axis=0)
    (x, y), (u, v) = (exact - centre).T, (taught.truth.xyt[:, :2] - laid).T
    turn = float(np.arctan2(x @ v - y @ u, x @ u + y @ v))
    xyt = judged.truth.xyt
    moved = laid + rotate(xyt[:, :2] - centre, np.full(len(xyt), turn))
    return replace(judged, truth=replace(judged.truth, xyt=np.column_stack((moved, xyt[:, 2] + turn))))


def _robots(learned: Learned) -> list[Any]:
    """Return the effects of the robot, without the set-up (mounting of the truth)."""
    return [effect for effect in learned.fit.effects if effect.kind != "setup"]


def _accuracy(seen: Seen, run: LaserRun) -> dict[str, list[float]]:
    """Return root mean square and robust deviation of the laser's motion over 1 s: along, across (mm), yaw (deg)."""
    path = run.path
    origin_ns = int(seen.exact.stamps_ns[0])
    t_s = path.t_s + (run.calibration.motion.origin_ns - origin_ns) * 1e-9 - seen.lag_s
    real = compose(seen.exact.at(np.clip(t_s, 0.0, None), origin_ns), seen.mount)
    real[:, :2] *= 1.0 + seen.scale
    ahead = np.searchsorted(path.t_s, path.t_s + 0.999)
    rows = np.flatnonzero(ahead < len(t_s))
    rows = rows[np.abs(path.t_s[ahead[rows]] - path.t_s[rows] - 1.0) < 0.05]
    laser = compose(path.xyt, run.calibration.motion.mount)
    miss = between(laser[rows], laser[ahead[rows]]) - between(real[rows], real[ahead[rows]])
    miss[:, 2] = wrap(miss[:, 2])
    units = np.array([1e3, 1e3, np.degrees(1.0)])
    return {
        "rms": (np.sqrt(np.mean(miss**2, axis=0)) * units).tolist(),
        "robust": (1.4826 * np.median(np.abs(miss), axis=0) * units).tolist(),
    }
