"""Reading of odometry and truth from a bag in one pass."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.messages import gather, gather_stamps_ns, gather_status, locate
from odomcorrupt.bags.open import open_reader
from odomcorrupt.corruption.odometry_source import ENCODINGS, ODOMETRY, plain
from odomcorrupt.corruption.pose_faults import W_FIRST, ComponentOrder, lacks_w
from odomcorrupt.errors import RecordingError, TopicError
from odomcorrupt.study.io.fixes import resolved
from odomcorrupt.study.io.raw_trajectory import Samples
from odomcorrupt.study.io.se3 import headings
from odomcorrupt.study.io.tf import EdgeReader
from odomcorrupt.study.io.topic_selection import TRANSFORM, choose, named, parse_address

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import Block, Channel
    from odomcorrupt.bags.messages import Layout
    from odomcorrupt.study.io.topic_selection import Address, Role

_MAX_M2 = 1e12


def read_bag(path: Path, place: str, wanted: Mapping[Role, str | None]) -> dict[Role, Samples]:
    """Return the requested trajectories of a bag, as recorded.

    place : name of the bag in messages
    wanted : topics or TF edges; None selects the only topic that fits the role

    Raises
    ------
    TopicError
        If a topic or frame is missing, or if several topics fit; the message lists them.
    """
    addresses = {role: parse_address(name) if name is not None else None for role, name in wanted.items()}
    with open_reader(path) as reader:
        channels = [c for c in reader.channels.values() if c.encoding in ENCODINGS]
        if not channels:
            other = sorted({c.encoding for c in reader.channels.values()})
            said = f"messages in {', '.join(other)} alone" if other else "no topics"
            raise TopicError(f"{place}: holds {said}; ROS messages (cdr or ros1) can be read")
        _require_two(channels, addresses, place)
        readers: dict[Role, EdgeReader | _PoseReader] = {}
        taken = [plain(a.topic) for a in addresses.values() if a is not None and not a.frames]
        for role, address in addresses.items():
            if address is not None:
                chosen = named(channels, address, place, role)
            else:
                chosen = choose(channels, place, role, {c.topic for c in channels if plain(c.topic) in taken})
                taken.append(plain(chosen[0].topic))
            if address is not None and address.frames:
                readers[role] = EdgeReader(path, place, address, chosen, channels)
            else:
                readers[role] = _PoseReader(place, chosen)
        for block in reader.blocks():
            for one in readers.values():
                for channel in one.channels:
                    for layout in locate(block, channel):
                        one.take(block, layout)
    return {role: one.samples() for role, one in readers.items()}


def _require_two(channels: list[Channel], addresses: Mapping[Role, Address | None], place: str) -> None:
    """Refuse a truth that is the odometry itself."""
    truth, odometry = addresses.get("truth"), addresses.get("odometry")
    if truth is None or truth.frames or "odometry" not in addresses:
        return
    named = {plain(c.topic) for c in channels if c.msgtype == ODOMETRY} if odometry is None else {plain(odometry.topic)}
    if named == {plain(truth.topic)} and not (odometry and odometry.frames):
        raise TopicError(f"{place}: --truth {truth.topic} is the odometry itself, and a topic cannot be its own truth")


class _PoseReader:
    """Collector of one topic's poses, block by block."""

    def __init__(self, place: str, channels: list[Channel]) -> None:
        self.place = f"{place}: {channels[0].topic}"
        self.channels = channels
        self.frames: dict[tuple[str, str], int] = {}
        self.parts: list[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]] = []
        self.order = ComponentOrder()
        self.no_w = 0

    def take(self, block: Block, layout: Layout) -> None:
        """Append the poses of messages of a block."""
        item = layout.items[0]
        names = (item.frame_id, item.child_frame_id)
        self.frames[names] = self.frames.get(names, 0) + len(layout.rows)
        values = np.full((len(layout.rows), 6), np.nan)
        values[:, :3] = gather(block, layout, item, "lla" if "lla" in item.fields else "position")
        if "orientation" in item.fields:
            quat_xyzw = gather(block, layout, item, "orientation")
            self.order.take(values[:, :3], quat_xyzw)
            self.no_w += lacks_w(quat_xyzw)
            values[:, 3] = headings(quat_xyzw)
        if "pose_covariance" in item.fields:
            covariance = gather(block, layout, item, "pose_covariance")
            values[:, 4] = covariance[:, [0, 7]].clip(-_MAX_M2, _MAX_M2).sum(axis=1)
        if "covariance" in item.fields:  # of a satellite fix; 0 if the receiver reports none
            covariance = gather(block, layout, item, "covariance")
            values[:, 4] = covariance[:, [0, 4]].clip(0.0, _MAX_M2).sum(axis=1)
            values[:, 5] = gather_status(block, layout, item)
        logs_ns = block.table["log_ns"][layout.rows].astype(np.int64)
        self.parts.append((gather_stamps_ns(block, layout, item), logs_ns, values))

    def samples(self) -> Samples:
        """Return the poses in order of arrival."""
        topic = self.channels[0].topic
        children = sorted({child for _, child in self.frames})
        if len(children) > 1 and self.channels[0].msgtype == TRANSFORM:
            edges = ", ".join(f"{topic}:{plain(f)}.{plain(c)}" for f, c in sorted(self.frames))
            raise TopicError(f"{self.place} holds transforms of {len(children)} frames; name one of {edges}")
        if self.order.w_first:
            raise RecordingError(f"{self.place}: {W_FIRST}")
        empty = (np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 6)))
        stamps, logs, values = (np.concatenate(part) for part in zip(empty, *self.parts, strict=True))
        # A block's layouts are read one after the other: restore the order of arrival.
        arrived = np.argsort(logs, kind="stable")
        stamps, logs, values = stamps[arrived], logs[arrived], values[arrived]
        notes = []
        if len(self.frames) > 1 and len(children) == 1:
            named_frames = ", ".join(repr(f) for f, _ in sorted(self.frames))
            notes.append(f"{topic}: frames {named_frames} mixed; taken as one")
        frame, child = max(self.frames, key=lambda names: self.frames[names]) if self.frames else ("", "")
        found = Samples(
            self.place,
            topic,
            plain(frame),
            stamps,
            values[:, :3],
            values[:, 3],
            logs,
            values[:, 4],
            tuple(notes),
            child=plain(child),
            estimated=self.channels[0].msgtype.endswith("/Odometry"),
            no_w=self.no_w > len(stamps) / 2,
        )
        if self.channels[0].msgtype.endswith("NavSatFix"):
            found = resolved(found, values[:, 5].astype(np.int8))
        return found if np.isfinite(found.variance_m2).all() else replace(found, variance_m2=np.zeros(0))
