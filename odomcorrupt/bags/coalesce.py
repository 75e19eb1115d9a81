"""Joins chunks that are adjacent in memory into larger blocks, which NumPy processes faster."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.block import TABLE, Block, Framing

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

_ENOUGH_MESSAGES = 20_000
"""More at once would save no more time."""


def joined(blocks: Iterable[Block]) -> Iterator[Block]:
    """Yield blocks, with adjacent small chunks of the same framing joined."""
    run = _Run()
    for block in blocks:
        if run.blocks and not run.goes_on_with(block):
            yield run.block()
            run = _Run()
        run.add(block)
    if run.blocks:
        yield run.block()


@dataclass(slots=True, eq=False, repr=False)
class _Run:
    blocks: list[Block] = field(default_factory=list)
    messages: int = 0
    end: int = 0

    def add(self, block: Block) -> None:
        self.blocks.append(block)
        self.messages += len(block.table)
        self.end = _address(block) + block.data.size

    def goes_on_with(self, block: Block) -> bool:
        last = self.blocks[-1]
        return (
            not (last.ends or block.ends)
            and self.messages + len(block.table) <= _ENOUGH_MESSAGES
            and _address(block) == self.end
            and block.data.base is last.data.base
            and isinstance(block.data.base, np.ndarray)
            and isinstance(last.raw, Framing)
            and last.raw.goes_on_with(block.raw)
        )

    def block(self) -> Block:
        first = self.blocks[0]
        whole = first.data.base
        if len(self.blocks) == 1 or not isinstance(whole, np.ndarray):
            return first
        ends = np.cumsum([block.data.size for block in self.blocks]).tolist()
        begins = [0, *ends[:-1]]
        at = _address(first) - _address_of(whole)
        # as plain bytes: NumPy is slow at concatenating structured arrays
        table = np.concatenate([block.table.view(np.uint8) for block in self.blocks]).view(TABLE)
        table["offset"] += np.repeat(begins, [len(block.table) for block in self.blocks])
        raw = first.raw.joined([block.raw for block in self.blocks[1:]], begins[1:])
        places = tuple(place for block in self.blocks for place in block.places)
        places = places if len(places) == len(ends) else ()
        return Block(whole[at : at + ends[-1]], table, raw, ends=tuple(ends), places=places)


def _address(block: Block) -> int:
    return _address_of(block.data)


def _address_of(data: np.ndarray[tuple[int], np.dtype[np.uint8]]) -> int:
    return int(data.__array_interface__["data"][0])
