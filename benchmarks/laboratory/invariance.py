"""Variants of one drive: other frames, later, at half rate, with gaps, and in every bag format."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from hidden import as_recording
from sourcebags import topic, write

from laboratory.answer import plain_answer
from odomcorrupt.geometry.se2 import compose
from odomcorrupt.study.io import Source, read_runs
from odomcorrupt.study.select.selection import learn

if TYPE_CHECKING:
    from collections.abc import Iterator

    from laboratory.cases import Case
    from odomcorrupt.simulation import SimulatedRun
    from odomcorrupt.study.io.recording import Recording

__all__ = ["variants"]

LATER_NS = 10**18
ELSEWHERE = np.array([13.0, -7.0, 2.1]), np.array([-31.0, 4.0, -1.3])
"""Poses to which the frames of odometry and truth are moved."""


@dataclass(frozen=True)
class _Rows:
    """Stamps (n,), positions (n, 3) and quaternions (n, 4), as needed by the bag writer."""

    stamps_ns: np.ndarray
    xyz: np.ndarray
    quat: np.ndarray

    def __len__(self) -> int:
        return len(self.stamps_ns)


def variants(case: Case, run: SimulatedRun) -> dict[str, Any]:
    """Return the answers of all variants by name, and the true causes."""
    answers: dict[str, Any] = {}
    seen: dict[bytes, str] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, recording in _transformed(case, run, Path(folder)):
            # identical recordings are learned from only once
            before = seen.setdefault(_fingerprint(recording), name)
            answers[name] = answers[before] if before in answers else plain_answer(learn([recording]))
    return {"answers": answers, "truth": run.answer["causes"]}


def _fingerprint(recording: Recording) -> bytes:
    paths = (recording.odometry, recording.truth)
    return sha256(b"".join(part.tobytes() for path in paths for part in (path.stamps_ns, path.xyt))).digest()


def _transformed(case: Case, run: SimulatedRun, folder: Path) -> Iterator[tuple[str, Recording]]:
    yield "as it came", as_recording(run)
    yield (
        "other frames",
        as_recording(
            replace(run, odom_xyt=compose(ELSEWHERE[0], run.odom_xyt), truth_xyt=compose(ELSEWHERE[1], run.truth_xyt))
        ),
    )
    yield (
        "1e9 s later",
        as_recording(
            replace(run, odom_stamps_ns=run.odom_stamps_ns + LATER_NS, truth_stamps_ns=run.truth_stamps_ns + LATER_NS)
        ),
    )
    yield "half rate", as_recording(_kept(run, np.arange(len(run.odom_stamps_ns)) % 2 == 0))
    rng = np.random.default_rng((53, case.number))
    holed = _kept(run, rng.random(len(run.odom_stamps_ns)) > 0.05)
    seen = rng.random(len(run.truth_stamps_ns)) > 0.05
    yield (
        "5 % dropped",
        as_recording(replace(holed, truth_stamps_ns=run.truth_stamps_ns[seen], truth_xyt=run.truth_xyt[seen])),
    )
    odom, truth = _rows(run.odom_stamps_ns, run.odom_xyt), _rows(run.truth_stamps_ns, run.truth_xyt)
    sent = topic("/odom", "Odometry", odom), topic("/truth", "PoseStamped", truth, frame="world")
    for name, file in (("MCAP", "a.mcap"), ("db3", "b"), ("ROS 1 bag", "c.bag")):
        yield name, _read(Source(write(folder / file, *sent), track_m=run.track_m))
    for name, rows in (("odom.tum", odom), ("truth.tum", truth)):
        _write_tum(folder / name, rows)
    yield "TUM", _read(Source(folder / "odom.tum", truth_path=folder / "truth.tum", track_m=run.track_m))


def _read(source: Source) -> Recording:
    (recording,) = read_runs(source)
    return recording


def _kept(run: SimulatedRun, keep: np.ndarray) -> SimulatedRun:
    return replace(
        run, odom_stamps_ns=run.odom_stamps_ns[keep], odom_xyt=run.odom_xyt[keep], odom_twist=run.odom_twist[keep]
    )


def _rows(stamps_ns: np.ndarray, xyt: np.ndarray) -> _Rows:
    zero = np.zeros(len(xyt))
    half = 0.5 * xyt[:, 2]
    return _Rows(
        stamps_ns, np.column_stack((xyt[:, :2], zero)), np.column_stack((zero, zero, np.sin(half), np.cos(half)))
    )


def _write_tum(path: Path, rows: _Rows) -> None:
    lines = [
        f"{stamp // 10**9}.{stamp % 10**9:09d} " + " ".join(f"{value:.9f}" for value in (*xyz, *quat))
        for stamp, xyz, quat in zip(rows.stamps_ns.tolist(), rows.xyz, rows.quat, strict=True)
    ]
    path.write_text("\n".join(lines) + "\n")
