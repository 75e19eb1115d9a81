"""What recovery could not read of a damaged bag, in sentences."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.messages import READABLE, undecodable

if TYPE_CHECKING:
    from collections.abc import Container, Mapping

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import Block, Channel
    from odomcorrupt.errors import BagError

_ADVICE = re.compile(r"[;,]? *(?:try )?--recover\b.*\Z", re.DOTALL)


def loss_of(error: BagError) -> str:
    """Return an error's message without its advice to use --recover."""
    return _ADVICE.sub("", error.message)


def with_readable(only: Container[int] | None, channels: Mapping[int, Channel]) -> Container[int] | None:
    """Return the ids of required channels, with those whose messages can be decoded here."""
    if only is None:
        return None
    return {number for number, channel in channels.items() if number in only or channel.msgtype in READABLE}


class Undecodable:
    """Messages of a pass that are whole records and cannot be decoded, counted by topic.

    Whatever reads their topic would end at them, so that they are left out.
    """

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}
        self._reasons: dict[str, str] = {}

    def find(self, block: Block, channels: Mapping[int, Channel]) -> NDArray[np.bool_]:
        """Return and count the messages (n,) of a block that cannot be decoded."""
        found = np.zeros(len(block.table), dtype=bool)
        for channel in (channels[number] for number in sorted(block.present())):
            failed = undecodable(block, channel)
            if failed:
                found[list(failed)] = True
                self._counts[channel.topic] = self._counts.get(channel.topic, 0) + len(failed)
                self._reasons.setdefault(
                    channel.topic, loss_of(next(iter(failed.values()))).removeprefix(f"{channel.topic}: ")
                )
        return found

    def losses(self, name: str) -> list[str]:
        """Return one sentence for each topic of the bag of this name."""
        return [
            f"{name}: {count} of the messages of {topic} cannot be decoded: left out (the first: {first})"
            for (topic, count), first in zip(self._counts.items(), self._reasons.values(), strict=True)
        ]
