"""Reading the sweeps of a laser from a bag: LaserScan, or a horizontal slice of a PointCloud2."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.open import open_reader
from odomcorrupt.errors import RecordingError, TopicError
from odomcorrupt.laser.sweep import MOST_RETURNS, Sweep, Sweeps
from odomcorrupt.mapping.frames import FrameTree
from odomcorrupt.mapping.messages import CLOUD, SCAN, ScanMessage, read_cloud, read_scan

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, Channel
    from odomcorrupt.mapping.frames import Mount
    from odomcorrupt.mapping.messages import CloudMessage

_FARTHEST_M = 200.0
_SLICE_RAD = np.radians(2.0)
_FLAT_M = 0.01
_EDGE = 0.995
"""Fraction of the maximum range above which a range means no return: drivers write the maximum or just below it."""
_COMMON = 0.03
_LEAST_SWEEPS = 20
_LEAST_RETURNS = 20
_BODY_M, _BODY_SPREAD_M, _BODY_SHARE = 1.0, 0.01, 0.9


def only_scan_topic(reader: BagReader) -> str | None:
    """Return the only LaserScan topic of a bag, None if there is none or more than one."""
    topics = {c.topic for c in reader.channels.values() if c.msgtype == SCAN}
    return topics.pop() if len(topics) == 1 else None


def read_sweeps(path: Path, place: str, topic: str | None, base_frame: str) -> Sweeps:
    """Return all sweeps of a topic, without invalid ranges and returns from the robot itself.

    Parameters
    ----------
    path : a bag
    place : name of the bag for messages
    topic : LaserScan or PointCloud2; None takes the only LaserScan, or the only PointCloud2 if there is no LaserScan
    base_frame : the robot's frame, for the laser's mounting from TF

    Raises
    ------
    TopicError
        If there is no such topic, or the choice is ambiguous.
    RecordingError
        If there are too few sweeps or returns to match.
    """
    tree = FrameTree()
    rows: list[tuple[ScanMessage | CloudMessage, int]] = []
    with open_reader(path) as reader:
        channels = _choose(reader.channels.values(), topic, place)
        read = read_scan if channels[0].msgtype == SCAN else read_cloud
        for block in reader.blocks():
            tree.take(block, reader.channels.values())
            for channel in channels:
                for row in block.table[block.table["channel"] == channel.id]:
                    data = block.data[row["offset"] : row["offset"] + row["length"]].tobytes()
                    rows.append((read(data, channel.topic, channel.encoding), int(row["log_ns"])))
    name = channels[0].topic
    where = f"{place}: {name}"
    if len(rows) < _LEAST_SWEEPS:
        raise RecordingError(f"{where} holds {len(rows)} sweeps; scan matching needs many more than {_LEAST_SWEEPS}")
    rows, notes = _ordered(rows, name)
    frame = rows[0][0].frame_id
    mount = _mount(tree, base_frame, frame)
    if mount is None:
        notes.append(f"{name}: TF does not contain the pose of {frame!r} on the robot; estimated from the motion")
    sweeps, view, more = _sweeps(rows, name)
    usual = float(np.median([len(s) for s in sweeps]))
    if usual < _LEAST_RETURNS:
        raise RecordingError(
            f"{where}: {usual:.0f} returns in a typical sweep ({'; '.join(more) or 'the others have no return'}); scan "
            f"matching needs {_LEAST_RETURNS} or more that are not the robot itself: name another topic with --scan"
        )
    logs = np.array([log for _, log in rows], dtype=np.int64)
    first = rows[0][0]
    by_scan_time = isinstance(first, ScanMessage) and not _has_increment(first) and _time_step_s(first) > 0.0
    return Sweeps(where, name, frame, sweeps, view, logs, mount, (*notes, *more), by_scan_time)


def _choose(channels: Iterable[Channel], topic: str | None, place: str) -> list[Channel]:
    every = list(channels)
    lasers = [c for c in every if c.msgtype in (SCAN, CLOUD)]
    found = ", ".join(sorted({f"{c.topic} ({c.msgtype.rpartition('/')[2]})" for c in lasers})) or "none"
    if topic is not None:
        chosen = [c for c in lasers if c.topic.lstrip("/") == topic.lstrip("/")]
        if not chosen:
            raise TopicError(f"{place}: no LaserScan or PointCloud2 on {topic} (found {found}); name one with --scan")
        return chosen
    for kind in (SCAN, CLOUD):
        topics = sorted({c.topic for c in lasers if c.msgtype == kind})
        if len(topics) > 1:
            raise TopicError(f"{place}: several lasers: {', '.join(topics)}. Name one with --scan.")
        if topics:
            return [c for c in lasers if c.topic == topics[0]]
    there = ", ".join(sorted({c.topic for c in every})) or "no topic at all"
    raise TopicError(f"{place}: no LaserScan or PointCloud2 topic (found {there})")


def _ordered(
    rows: list[tuple[ScanMessage | CloudMessage, int]], name: str
) -> tuple[list[tuple[ScanMessage | CloudMessage, int]], list[str]]:
    """Return the messages in order of their stamps, and notes on messages left out and on the stamps."""
    notes = []
    stamps = np.array([m.stamp_ns for m, _ in rows])
    logs = np.array([log for _, log in rows])
    if not stamps.any():
        stamps = logs
        notes.append(f"{name}: no stamps in the messages, log times used: they include delays of arrival")
    elif np.ptp(stamps - logs) < 1 and np.any(np.diff(np.sort(logs)) > 0) and len(np.unique(stamps % 1000)) > 500:
        notes.append(f"{name}: apparently stamped on arrival; delays of arrival count as noise")
    _, index = np.unique(stamps, return_index=True)
    if len(index) < len(rows):
        notes.append(f"{name}: {len(rows) - len(index)} sweeps with duplicate stamps left out")
    kept = [(replace(rows[i][0], stamp_ns=int(stamps[i])), rows[i][1]) for i in index]
    return kept, notes


def _mount(tree: FrameTree, base: str, laser: str) -> Mount | None:
    try:
        return tree.mount(base, laser, "")
    except TopicError:
        return None


def _sweeps(
    rows: list[tuple[ScanMessage | CloudMessage, int]], name: str
) -> tuple[tuple[Sweep, ...], float, list[str]]:
    first = rows[0][0]
    if not isinstance(first, ScanMessage):
        sweeps = tuple(_slice(message) for message, _ in rows)  # type: ignore[arg-type]
        return sweeps, _view_of(sweeps), [f"{name}: a horizontal slice of its points"]
    scans: list[ScanMessage] = [m for m, _ in rows]  # type: ignore[misc]
    notes = []
    farthest = _no_return_m(scans)
    body = _own_body(scans, farthest)
    if body is not None:
        notes.append(f"{name}: {np.count_nonzero(body)} of {len(body)} bearings see the robot itself: left out")
    view = abs(first.angle_step) * (len(first.ranges_m) - 1)
    return tuple(_returns(scan, farthest, body) for scan in scans), float(view), notes


def _no_return_m(scans: list[ScanMessage]) -> float:
    """Return the range above which there is no return, m: the stated maximum, or a largest range that is too common."""
    stated = scans[0].range_max_m
    largest = stated if np.isfinite(stated) and stated > scans[0].range_min_m else _FARTHEST_M
    sample = np.concatenate([s.ranges_m for s in scans[:: max(1, len(scans) // 200)]])
    sample = sample[np.isfinite(sample) & (sample > 0.0) & (sample < largest)]
    if len(sample):
        top = float(sample.max())
        if np.mean(sample > top - 1e-3) > _COMMON:
            return top - 1e-3
    return min(_EDGE * largest, _FARTHEST_M)


def _own_body(scans: list[ScanMessage], farthest: float) -> NDArray[np.bool_] | None:
    """Return a mask of bearings with a constant near range although the robot moved (its own body); None if none."""
    count = len(scans[0].ranges_m)
    chosen = [s.ranges_m for s in scans[:: max(1, len(scans) // 300)] if len(s.ranges_m) == count]
    table = np.stack(chosen)
    valid = np.isfinite(table) & (table > 0.0) & (table < farthest)
    filled = np.where(valid, table, np.nan)
    with np.errstate(all="ignore"):
        middle = np.nanmedian(np.where(valid.any(axis=0), filled, 0.0), axis=0)
        spread = np.nanmedian(np.where(valid.any(axis=0), np.abs(filled - middle), 1.0), axis=0)
    own = (middle < _BODY_M) & (spread < _BODY_SPREAD_M) & (valid.mean(axis=0) > _BODY_SHARE)
    others = valid.any(axis=0) & ~own
    # for a robot at rest, all ranges are constant
    moved = others.any() and float(np.nanmedian(spread[others])) > _BODY_SPREAD_M
    return own if own.any() and (moved or not others.any()) else None


def _returns(scan: ScanMessage, farthest: float, body: NDArray[np.bool_] | None) -> Sweep:
    ranges = scan.ranges_m
    with np.errstate(invalid="ignore"):
        good = (ranges > 0.0) & (ranges >= scan.range_min_m) & (ranges < farthest)
    if body is not None and len(body) == len(good):
        good &= ~body
    hit = np.flatnonzero(good)
    if len(hit) > MOST_RETURNS:
        hit = hit[np.linspace(0, len(hit) - 1, MOST_RETURNS).round().astype(np.int64)]
    angle = scan.angle_min + scan.angle_step * hit
    xy = ranges[hit, None] * np.stack((np.cos(angle), np.sin(angle)), axis=1)
    step = _time_step_s(scan)
    return Sweep(scan.stamp_ns, xy.astype(np.float32), (hit * step).astype(np.float32))


def _has_increment(scan: ScanMessage) -> bool:
    return scan.time_step_s != 0.0 and bool(np.isfinite(scan.time_step_s))


def _time_step_s(scan: ScanMessage) -> float:
    """Return the time between two bearings, s: the time_increment, or from scan_time, or 0 if unknown."""
    if _has_increment(scan):
        # some drivers write the duration of a sweep as time_increment
        return scan.time_step_s if abs(scan.time_step_s) * len(scan.ranges_m) < 1.0 else 0.0
    if 0.0 < scan.scan_time_s < 1.0:
        return scan.scan_time_s * abs(scan.angle_step) / (2.0 * np.pi)
    return 0.0


def _slice(cloud: CloudMessage) -> Sweep:
    """Return a sweep with the nearest point at each bearing in the horizontal plane of the laser."""
    xyz, after = cloud.xyz, cloud.after_s
    good = np.isfinite(xyz).all(axis=1)
    xyz, after = xyz[good], after[good]
    radius = np.hypot(xyz[:, 0], xyz[:, 1])
    planar = len(xyz) > 0 and np.ptp(xyz[:, 2]) < _FLAT_M
    near = (radius > 0.05) & (radius < _FARTHEST_M)
    level = near & (planar | (np.abs(np.arctan2(xyz[:, 2], radius)) < _SLICE_RAD))
    xyz, after, radius = xyz[level], after[level], radius[level]
    cell = np.floor((np.arctan2(xyz[:, 1], xyz[:, 0]) + np.pi) * (MOST_RETURNS / (2.0 * np.pi))).astype(np.int64)
    order = np.lexsort((radius, cell))
    _, first = np.unique(cell[order], return_index=True)
    chosen = order[first]
    return Sweep(cloud.stamp_ns, xyz[chosen, :2].astype(np.float32), after[chosen].astype(np.float32))


def _view_of(sweeps: tuple[Sweep, ...]) -> float:
    """Return the field of view of sweeps, rad: a full turn minus the largest sector without any return."""
    some = sweeps[:: max(1, len(sweeps) // 50)]
    bearing = np.sort(np.concatenate([np.arctan2(s.xy[:, 1], s.xy[:, 0]) for s in some if len(s)] or [np.zeros(1)]))
    gaps = np.diff(np.concatenate((bearing, bearing[:1] + 2.0 * np.pi)))
    return float(2.0 * np.pi - gaps.max())
