"""Copy of a bag with another path: odometry poses, and the TF edges that repeat them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.messages import gather, gather_stamps_ns, locate, scatter
from odomcorrupt.bags.open import open_reader, open_writer
from odomcorrupt.corruption.se2_on_se3 import SpatialPoses, from_left, from_right
from odomcorrupt.corruption.targets import ODOMETRY, TRANSFORMS, Frames, plain, side_of
from odomcorrupt.geometry.se2 import compose, interpolate, inverse

if TYPE_CHECKING:
    from pathlib import Path

    from odomcorrupt.bags.block import Block
    from odomcorrupt.bags.messages import Item, Layout
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.trajectories.reader import Drive

__all__ = ["Rewritten", "rewrite_path"]


@dataclass(frozen=True, slots=True)
class Rewritten:
    """Numbers of moved odometry messages and transforms."""

    messages: int
    transforms: int


def rewrite_path(
    source: Path, target: Path, drive: Drive, xyt: Array, provenance: dict[str, str], *, overwrite: bool = False
) -> Rewritten:
    """Copy a bag with odometry poses replaced by xyt (n, 3), m and rad; return the numbers of moved messages.

    TF edges of the odom frame are moved accordingly, at their own stamps. z, roll and pitch, and all other bytes, are
    kept.
    """
    correction = compose(xyt, inverse(drive.xyt))
    frames = Frames(plain(drive.frame_id), plain(drive.child_frame_id) or None)
    messages = transforms = 0
    with open_reader(source) as reader, open_writer(target, reader, overwrite=overwrite) as writer:
        odometry = {c.id for c in reader.channels.values() if c.msgtype == ODOMETRY and c.topic == drive.topic}
        channels = [c for c in reader.channels.values() if c.id in odometry or c.msgtype in TRANSFORMS]
        for block in reader.blocks():
            for channel in channels:
                for layout in locate(block, channel):
                    for item in layout.items:
                        own = channel.id in odometry
                        side = "left" if own else side_of(item.frame_id, item.child_frame_id, frames)
                        if side is None:
                            continue
                        at = _at(block, layout, item, drive, correction)
                        _move(block, layout, item, at, right=side == "right")
                        messages += len(layout.rows) * own
                        transforms += len(layout.rows) * (not own)
            writer.write(block)
        writer.provenance("odomcorrupt", provenance)
    return Rewritten(messages, transforms)


def _at(block: Block, layout: Layout, item: Item, drive: Drive, correction_xyt: Array) -> Array:
    """Return the correction (m, 3) at the messages' stamps, constant before and after the drive."""
    stamps = gather_stamps_ns(block, layout, item)
    stamps = np.where(stamps == 0, block.table["log_ns"][layout.rows], stamps)
    inside = np.clip(stamps, drive.stamps_ns[0], drive.stamps_ns[-1])
    left = np.minimum(np.searchsorted(drive.stamps_ns, inside, side="right") - 1, len(drive) - 2)
    span = drive.stamps_ns[left + 1] - drive.stamps_ns[left]
    return interpolate(correction_xyt[left], correction_xyt[left + 1], (inside - drive.stamps_ns[left]) / span)


def _move(block: Block, layout: Layout, item: Item, correction_xyt: Array, *, right: bool) -> None:
    poses = SpatialPoses(gather(block, layout, item, "position"), gather(block, layout, item, "orientation"))
    moved = (from_right if right else from_left)(correction_xyt, poses)
    scatter(block, layout, item, "position", moved.position)
    scatter(block, layout, item, "orientation", moved.quat_xyzw)
