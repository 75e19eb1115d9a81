"""Where the numbers lie in a message: nothing else of it is ever looked at.

Layouts depend on the strings before the numbers, so a layout is valid for one set of structural bytes (lengths,
strings, counts, CDR header) and is looked up by them, never by the message's length alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from numpy.typing import NDArray

    from odomcorrupt.bags.block import Block, Channel

__all__ = ["Item", "Layout", "gather", "gather_stamps_ns", "locate", "scatter", "scatter_stamps_ns"]


@dataclass(frozen=True, slots=True)
class Item:
    """One stamped thing in a message: the Odometry itself, or one transform of a TFMessage.

    frame_id, child_frame_id : as written in the message ("" where the type has none), leading slashes kept
    stamp : offset of the stamp (two 32-bit words, seconds and nanoseconds) from the message's start, bytes
    fields : name to (offset from the message's start in bytes, count of float64): "position" 3, "orientation" 4
        (xyzw), "pose_covariance" 36, "twist" 6, "twist_covariance" 36; in Odometry and TF, orientation follows
        position directly
    """

    frame_id: str
    child_frame_id: str
    stamp: int
    fields: Mapping[str, tuple[int, int]]


@dataclass(frozen=True, slots=True)
class Layout:
    """Messages of one channel in one block that share a layout.

    rows : (n,) indices into the block's table, ascending
    starts : (n,) offsets of the messages in the block's data, bytes
    items : one for an Odometry or pose, one per transform for a TFMessage
    big_endian : whether numbers are stored big-endian (CDR only)
    """

    rows: NDArray[np.int64]
    starts: NDArray[np.int64]
    items: tuple[Item, ...]
    big_endian: bool = False


def locate(block: Block, channel: Channel) -> list[Layout]:
    """Return the layouts of all messages of a channel in a block.

    Raises
    ------
    BagError
        Where a message is shorter than its own strings and numbers say.

    """
    raise NotImplementedError


def gather(block: Block, layout: Layout, item: Item, field: str) -> NDArray[np.float64]:
    """Return a copy (n, count) of a field of all messages of a layout."""
    raise NotImplementedError


def scatter(block: Block, layout: Layout, item: Item, field: str, values: NDArray[np.float64]) -> None:
    """Write a field (n, count) of all messages of a layout into the block's data, in place."""
    raise NotImplementedError


def gather_stamps_ns(block: Block, layout: Layout, item: Item) -> NDArray[np.int64]:
    """Return the header stamps (n,) in nanoseconds since 1970."""
    raise NotImplementedError


def scatter_stamps_ns(block: Block, layout: Layout, item: Item, stamps_ns: NDArray[np.int64]) -> None:
    """Write the header stamps (n,)."""
    raise NotImplementedError
