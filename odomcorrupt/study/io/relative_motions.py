"""Relative motions from a file as truth, as scan matchers and visual odometry write them.

The CSV header names two times, dx, dy and dyaw (t0,t1,dx,dy,dyaw; also t1,t2 or start,end; dtheta), each motion in the
axes of its start. Its covariance in the same axes is optional: six columns xx,xy,xyaw,yy,yyaw,yawyaw. Motions that join
end to end form chains; overlaps and loop closures are left out.
"""

from __future__ import annotations

import io
import itertools
import re
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import between, compose, inverse, wrap
from odomcorrupt.input_files import open_input
from odomcorrupt.laser.calibrate import hand_eye
from odomcorrupt.study.io.raw_trajectory import FEWEST, Samples
from odomcorrupt.study.io.segments import MIN_HEADED_S, MIN_PART_S
from odomcorrupt.study.io.text import guess_tick, read_lines, split_line, whole_rows

if TYPE_CHECKING:
    from collections.abc import Container, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array

_TIMES = (("t0", "t1"), ("t1", "t2"), ("start", "end"), ("from", "to"), ("start_s", "end_s"), ("t0_s", "t1_s"))
_YAWS = ("dyaw", "dtheta", "dth", "dpsi")
_COVARIANCE = ("xx", "xy", "xyaw", "yy", "yyaw", "yawyaw")
_MAX_LINES = 5_000_000
_JOINED = 0.02
"""Motions join if the time between them is at most this fraction of the shorter one."""
_TURNED_RAD = np.radians(15.0)  # smaller mounting yaws are left to the fit
_GROSS, _UNKNOWN_M2 = 10.0, 100.0  # a failed match: ratio to the median difference, and the variance it then gets


class Motions(NamedTuple):
    """n relative motions: start and end times (n,) ns, poses (n, 3) of the end in the frame of the start, covariances.

    covariance : (n, 3, 3) in the axes of the start, or None
    """

    place: str
    name: str
    start_ns: NDArray[np.int64]
    end_ns: NDArray[np.int64]
    xyt: Array
    covariance: Array | None


def read_motions(path: Path, shift_s: float = 0.0) -> Motions:
    """Return the relative motions in a CSV file, at times later by a shift.

    Raises
    ------
    RecordingError
        If the file has no such header, or a line does not match it.
    """
    place, notes = str(path), list[str]()
    with io.TextIOWrapper(open_input(path, RecordingError), "utf-8-sig", errors="replace", newline="") as stream:
        lines = read_lines(stream, place)
        rows = (split_line(row, ",") for row in lines if not row.cells[0].startswith("#"))
        header = next(rows, None)
        if header is None:
            raise RecordingError(f"{place}: is empty; its first line names t0,t1,dx,dy,dyaw")
        at = _columns(header.cells, place)
        table = list(itertools.islice(whole_rows(rows, len(header.cells), notes), _MAX_LINES))
    if len(table) < FEWEST:
        raise RecordingError(f"{place}: holds {len(table)} relative motions; {FEWEST} and more are needed")
    tick = guess_tick([row.number(at[0]) for row in table])
    start, end = (np.array([row.nanoseconds(one, tick) for row in table]) + round(shift_s * 1e9) for one in at[:2])
    values = np.array([[row.number(one) for one in at[2:]] for row in table])
    if not np.isfinite(values).all():
        raise RecordingError(f"{place}: holds a number that is not finite; leave its line out")
    xyt, covariance = values[:, :3], None
    if len(at) > 5:
        covariance = np.zeros((len(values), 3, 3))
        for column, (i, j) in enumerate(((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))):
            covariance[:, i, j] = covariance[:, j, i] = values[:, 3 + column]
        if not (np.linalg.eigvalsh(covariance)[:, 0] > 0.0).all():
            raise RecordingError(f"{path}: a covariance is not positive definite; leave its columns out")
    back = end < start
    xyt = np.where(back[:, None], inverse(xyt), xyt)
    return Motions(str(path), path.name, np.minimum(start, end), np.maximum(start, end), xyt, covariance)


def chains_of(motions: Motions, odometry: Samples) -> list[Samples]:
    """Return the chains of motions of at least 15 s, as truths of relative poses in the robot's frame.

    A sensor mounted with a yaw of more than 15 deg is calibrated against the odometry (hand-eye calibration), and its
    motions are transformed; the remaining mounting offset is a free parameter of every fit.

    Raises
    ------
    RecordingError
        If no chain lasts 15 s.
    """
    motions, gross, said = _on_robot(motions, odometry)
    chains = _chains(motions, gross)
    lasting = _lasting(motions, chains)
    if len(gross):
        whole = _lasting(motions, _chains(motions))
        # An error of one motion would count in all that is computed over longer times.
        breaks = 2 * sum(map(len, lasting)) >= sum(map(len, whole))
        if not breaks:
            plain = np.broadcast_to(np.diag([1e-4, 1e-4, 1e-4]), (len(motions.xyt), 3, 3))
            covariance = (plain if motions.covariance is None else motions.covariance).copy()
            covariance[sorted(gross)] = np.diag([_UNKNOWN_M2, _UNKNOWN_M2, _UNKNOWN_M2])
            motions, lasting = motions._replace(covariance=covariance), whole
        many = "1 motion differs" if len(gross) == 1 else f"{len(gross)} motions differ"
        verb = "is" if len(gross) == 1 else "are"
        said.append(f"{many} grossly from the odometry's and {verb} {'left out' if breaks else 'given no weight'}")
    if not lasting:
        longest = max((float(motions.end_ns[c[-1]] - motions.start_ns[c[0]]) * 1e-9 for c in chains), default=0.0)
        raise RecordingError(
            f"{motions.place}: motions join end to end for {longest:.1f} s at most, {MIN_PART_S:g} s are needed: the "
            "end of each is to be the start of the next"
        )
    used = sum(len(c) for c in lasting)
    if used < len(motions.start_ns):
        said.append(
            f"{used} of {len(motions.start_ns)} motions join end to end in {len(lasting)} chains that last; the others "
            "(overlaps, loop closures, strays) are left out"
        )
    found = [_chain(motions, np.array(c)) for c in lasting]
    found[0] = found[0].noted(*said)
    return found


def _chain(motions: Motions, rows: NDArray[np.int64]) -> Samples:
    """Return a chain as a truth, with poses integrated from its motions."""
    poses, xyt = np.zeros((len(rows) + 1, 3)), motions.xyt
    for k, row in enumerate(rows):
        poses[k + 1] = compose(poses[k], xyt[row])
        poses[k + 1, 2] = poses[k, 2] + wrap(xyt[row, 2])
    covariance = None
    if motions.covariance is not None:
        covariance = motions.covariance[np.concatenate((rows[:1], rows))]
    stamps_ns = np.concatenate((motions.start_ns[rows[:1]], motions.end_ns[rows]))
    return Samples.planar(motions.place, motions.name, stamps_ns, poses, covariance=covariance, relative=True)


def _lasting(motions: Motions, chains: Sequence[list[int]]) -> list[list[int]]:
    """Return the chains of at least 15 s; if there are longer ones, only those with enough intervals for two halves."""
    span_s = [float(motions.end_ns[c[-1]] - motions.start_ns[c[0]]) * 1e-9 for c in chains]
    least_s = MIN_HEADED_S if max(span_s, default=0.0) >= MIN_HEADED_S else MIN_PART_S
    return [chain for chain, own_s in zip(chains, span_s, strict=True) if own_s >= least_s]


def _chains(motions: Motions, without: Container[int] = ()) -> list[list[int]]:
    """Return chains of rows that join end to end; of motions with the same start, the shortest is used.

    without : rows that no chain contains
    """
    order = np.lexsort((motions.end_ns, motions.start_ns))
    span = motions.end_ns - motions.start_ns
    chains: list[list[int]] = []
    for row in order.tolist():
        if span[row] <= 0 or row in without:
            continue
        if chains:
            last = chains[-1][-1]
            room = _JOINED * float(min(span[row], span[last]))
            apart = float(motions.start_ns[row] - motions.end_ns[last])
            if apart < -room:
                continue
            if apart <= room:
                chains[-1].append(row)
                continue
        chains.append([row])
    return chains


class _OnRobot(NamedTuple):
    """Motions in the robot's frame, rows with gross errors, and a note on the sensor's mounting if it was taken out."""

    motions: Motions
    gross: frozenset[int]
    said: list[str]


def _on_robot(motions: Motions, odometry: Samples) -> _OnRobot:
    """Return the motions in the robot's frame, and those with gross errors.

    The sensor's mounting is removed if its yaw is large. Motions that differ from the odometry's by more than ten times
    the median difference are failed matches.
    """
    path, origin = odometry.trajectory(), int(odometry.stamps_ns[0])
    start: Array = (motions.start_ns - origin).astype(np.float64) * 1e-9
    end: Array = (motions.end_ns - origin).astype(np.float64) * 1e-9
    last = float(odometry.stamps_ns[-1] - origin) * 1e-9
    inside = np.flatnonzero((start >= 0.0) & (end <= last) & (end > start))
    if len(inside) < FEWEST:
        raise RecordingError(
            f"{motions.place}: {len(inside)} of {len(start)} motions lie in the time of {odometry.name}: give their "
            "times on the odometry's clock (--truth-shift moves them)"
        )
    own = between(path.at(start[inside], origin), path.at(end[inside], origin))
    seen, said = motions.xyt, []
    further = np.abs(np.hypot(*own[:, :2].T) - np.hypot(*seen[inside, :2].T))
    plain = further <= _GROSS * float(np.median(further)) + 1e-6
    mount = hand_eye(own[plain], seen[inside][plain])
    if mount is not None and abs(float(wrap(mount[2]))) > _TURNED_RAD:
        seen = compose(compose(np.broadcast_to(mount, seen.shape), seen), inverse(mount))
        where = f"{mount[0]:.3f} m, {mount[1]:.3f} m, {np.degrees(mount[2]):.1f} deg"
        said.append(f"its sensor's pose on the robot is estimated as {where}; removed")
    miss = seen[inside] - own
    away, turned = np.hypot(miss[:, 0], miss[:, 1]), np.abs(wrap(miss[:, 2]))
    gross = inside[(away > _GROSS * np.median(away) + 1e-6) | (turned > _GROSS * np.median(turned) + 1e-6)]
    return _OnRobot(motions._replace(xyt=seen), frozenset(gross.tolist()), said)


def _columns(header: Sequence[str], place: str) -> list[int]:
    """Return the columns of the two times, of the motion (3) and of its covariance (6), if it has one."""
    names = [re.sub(r"[^a-z0-9_]", "", cell.strip().lower()) for cell in header]
    where = {name: i for i, name in enumerate(names)}
    times = next(((where[a], where[b]) for a, b in _TIMES if a in where and b in where), None)
    yaw = next((where[name] for name in _YAWS if name in where), None)
    if times is None or yaw is None or "dx" not in where or "dy" not in where:
        raise RecordingError(f"{place}: its first line names {', '.join(header)}; it takes t0,t1,dx,dy,dyaw")
    known = [name for name in _COVARIANCE if name in where]
    if known and len(known) < len(_COVARIANCE):
        missing = ", ".join(name for name in _COVARIANCE if name not in where)
        raise RecordingError(f"{place}: a covariance without {missing}; give all of {','.join(_COVARIANCE)}, or none")
    return [*times, where["dx"], where["dy"], yaw, *(where[name] for name in known)]
