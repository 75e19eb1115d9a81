"""Splitting of odometry and truth into independent recordings, without parts of the truth that cannot be compared."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import wrap
from odomcorrupt.study.io.jumps import reach_of, stretches
from odomcorrupt.study.io.plausibility import SHORTEST_S
from odomcorrupt.study.io.raw_trajectory import CLOCK_S
from odomcorrupt.study.io.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.study.io.raw_trajectory import Samples

GAP_S = 0.5  # s; shortest gap of the odometry
GAP_STEPS = 5.0  # shortest gap in median intervals; both have to be exceeded
_RESTART_S = 1.0  # s; shortest gap across which the motions of odometry and truth are compared
_APART_M, _APART, _APART_RAD = 0.5, 0.2, 0.5
"""Difference of the displacements across a gap, m and as a part of the larger one, or of the turns, rad, that shows
that the odometry was not integrated there: more than wrong wheels and late stamps cause."""
_MIN_SPEED = np.array([0.02, 0.05])  # m/s and rad/s; a faster robot should change the truth
MIN_PART_S = 15.0  # shortest part of a truth whose parts have frames of their own: of a laser, or of relative motions
MIN_HEADED_S, _MIN_UNHEADED_S = 25.0, 50.0
"""Shortest stretches, with and without headings, with enough intervals for two halves; used if longer ones exist."""


def without_frozen(odometry: Samples, truth: Samples) -> Samples:
    """Return the truth without poses repeated while the robot moved, as from a tracker that lost its target."""
    t_s, own = truth.seconds_since(int(odometry.stamps_ns[0])), odometry.t_s
    yaw = np.nan_to_num(truth.yaw_rad)
    repeated = np.concatenate(([False], (np.diff(truth.xyz, axis=0) == 0.0).all(axis=1) & (np.diff(yaw) == 0.0)))
    if not repeated.any():
        return truth
    poses = np.concatenate((odometry.xyz[:, :2], np.unwrap(odometry.yaw_rad)[:, None]), axis=1)
    # Average over 0.25 s on each side, because odometry comes in ticks.
    before, after = (np.stack([np.interp(t_s + d, own, p) for p in poses.T], axis=1) for d in (-0.25, 0.25))
    speed = np.stack((np.linalg.norm((after - before)[:, :2], axis=1), np.abs((after - before)[:, 2])), axis=1) / 0.5
    frozen = repeated & (speed > _MIN_SPEED).any(axis=1)
    if not frozen.any():
        return truth
    return truth.only(~frozen, f"{np.sum(frozen)} poses that repeat the one before while the robot moves left out")


def without_gaps(odometry: Samples, truth: Samples) -> Samples:
    """Return the truth without poses inside gaps of the odometry, which cannot be compared."""
    steps = np.diff(odometry.t_s)
    gaps = np.flatnonzero(steps > max(GAP_S, GAP_STEPS * float(np.median(steps))))
    if not len(gaps):
        return truth
    left = np.searchsorted(odometry.stamps_ns, truth.stamps_ns, side="right") - 1
    inside = np.isin(left, gaps) & (odometry.stamps_ns[np.maximum(left, 0)] < truth.stamps_ns)
    longest = f"{steps[gaps].max():.1f} s"
    found = f"{len(gaps)} gaps, the longest of {longest}" if len(gaps) > 1 else f"a gap of {longest}"
    note = f"{odometry.name}: {found}; {np.sum(inside)} poses of the truth inside left out"
    return replace(truth.only(~inside), notes=(*truth.notes, note))


def independent_parts(name: str, odometry: Samples, truth: Samples, track_m: float | None) -> list[Recording]:
    """Return a recording for each sufficiently long stretch common to odometry and truth.

    track_m : distance between the wheels; None if it is not known

    Raises
    ------
    RecordingError
        If there is no such stretch.
    """
    pieces = []
    notes = [*odometry.notes, *truth.notes]
    for path, what in ((odometry, ("reset", "resets")), (truth, ("jump that lasts", "jumps that last"))):
        cut = stretches(path, reach_of(odometry, path))
        if cut.outliers:
            notes.append(f"{path.name}: {cut.outliers} outliers (jumps there and back) left out")
        if len(cut.rows) > 1:
            where = ", ".join(_jump(odometry, path, a[-1], b[0]) for a, b in pairwise(cut.rows[:7]))
            notes.append(f"{path.name}: {len(cut.rows) - 1} {what[len(cut.rows) > 2]} ({where})")
        rows = list(cut.rows)
        if path is odometry:
            rows, restarts = _without_restarts(odometry, truth, rows)
            notes += restarts
        pieces.append([path.only(own) for own in rows])
    both = [(one, other) for one in pieces[0] for other in pieces[1]]
    moved = [(one, other) for one, other in both if one.shared_s(other) >= SHORTEST_S and _moves(one)]
    least_s = MIN_HEADED_S if truth.headed else _MIN_UNHEADED_S
    moved = [(one, other) for one, other in moved if one.shared_s(other) >= least_s] or moved
    if not moved:
        longest_s = max(one.shared_s(other) for one, other in both)
        raise RecordingError(
            f"{name}: jumps leave no stretch of {SHORTEST_S:g} s in which the robot moves (the longest lasts "
            f"{max(longest_s, 0.0):.1f} s); {'; '.join(notes)}"
        )
    if len(both) > 1:
        used = sum(one.shared_s(other) for one, other in moved)
        notes.append(f"{len(moved)} independent stretches used, {used:.0f} s of {odometry.shared_s(truth):.0f} s")
    origin_ns, several = int(moved[0][0].stamps_ns[0]), len(moved) > 1
    if several:  # parts separated by resets still share one clock
        origin_ns, moved = int(odometry.stamps_ns[0]), [_with_margins(*pair) for pair in moved]
    return [
        Recording(
            name=f"{name} part {i + 1}" if several else name,
            odometry=one.trajectory(),
            truth=other.trajectory(),
            origin_ns=origin_ns,
            track_m=track_m,
            notes=tuple(notes) if i == 0 else (),
            clock=f"{name} from {origin_ns}" if several else "",
            geodetic_origin=truth.geodetic_origin,
        )
        for i, (one, other) in enumerate(moved)
    ]


def _without_restarts(
    odometry: Samples, truth: Samples, rows: Sequence[NDArray[np.int64]]
) -> tuple[list[NDArray[np.int64]], list[str]]:
    """Return stretches of the odometry, cut at gaps in which it missed the robot's motion, and a note on each gap.

    A driver that restarts continues from its last pose, wherever the robot is by then.
    """
    parts, notes = [], []
    at_s = truth.seconds_since(int(odometry.stamps_ns[0]))
    for own in rows:
        t_s = odometry.t_s[own]
        cuts = []
        for i in np.flatnonzero(np.diff(t_s) > _RESTART_S):
            before, after = np.searchsorted(at_s, t_s[i], side="right") - 1, np.searchsorted(at_s, t_s[i + 1])
            if before < 0 or after == len(at_s) or at_s[after] - at_s[before] > t_s[i + 1] - t_s[i] + _RESTART_S:
                continue
            moved = [
                (float(np.linalg.norm(np.diff(p.xyz[[a, b], :2], axis=0))), np.diff(p.yaw_rad[[a, b]])[0])
                for p, a, b in ((odometry, own[i], own[i + 1]), (truth, before, after))
            ]
            (own_m, own_rad), (real_m, real_rad) = moved
            turned = abs(float(wrap(np.asarray(np.nan_to_num(real_rad - own_rad)))))
            if abs(own_m - real_m) < _APART_M + _APART * max(own_m, real_m) and turned < _APART_RAD:
                continue
            cuts.append(i + 1)
            notes.append(
                f"{odometry.name}: restarted after a gap of {t_s[i + 1] - t_s[i]:.1f} s at {t_s[i]:.1f} s, in which it "
                f"moved {own_m:.2f} m and the truth {real_m:.2f} m"
            )
        parts += np.split(own, cuts)
    return parts, notes


def _with_margins(odometry: Samples, truth: Samples) -> tuple[Samples, Samples]:
    """Return the odometry up to the end of the truth, and the truth in its time, plus a margin for clock offsets."""
    margin = round(CLOCK_S * 1e9)
    first, last = odometry.stamps_ns[0] - margin, odometry.stamps_ns[-1] + margin
    inside = (truth.stamps_ns >= first) & (truth.stamps_ns <= last)
    return odometry.only(odometry.stamps_ns <= truth.stamps_ns[-1] + margin), truth.only(inside)


def _moves(path: Samples) -> bool:
    extent = float(np.linalg.norm(np.ptp(path.xyz[:, :2], axis=0)))
    return extent > 0.1 or float(np.ptp(np.unwrap(path.yaw_rad))) > 0.2


def _jump(odometry: Samples, path: Samples, last: int, first: int) -> str:
    at_s = float(path.stamps_ns[first] - odometry.stamps_ns[0]) * 1e-9
    gone = float(np.linalg.norm(path.xyz[first, :2] - path.xyz[last, :2]))
    turn = path.yaw_rad[first] - path.yaw_rad[last]
    turned = f" and {abs(np.degrees(wrap(np.asarray(turn)))):.0f} deg" if np.isfinite(turn) else ""
    return f"{gone:.2f} m{turned} at {at_s:.1f} s"
