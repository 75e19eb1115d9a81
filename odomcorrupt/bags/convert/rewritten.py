"""A bag whose messages are rewritten one by one, or left out, while it is read."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from odomcorrupt.bags.block import Block, Channel, Framing, Kind, with_ids
from odomcorrupt.bags.messages import SCAN
from odomcorrupt.bags.record_reader import loss_of
from odomcorrupt.errors import BagError, TopicError

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterator, Mapping
    from pathlib import Path

    from odomcorrupt.bags.block import BagReader, Definition


class Rule(NamedTuple):
    """What becomes of a channel.

    channel : the channel as it is read from here
    definition : its definition
    rewrite : function of a serialised message, which returns None for one to leave out; None leaves all alone
    """

    channel: Channel
    definition: Definition
    rewrite: Callable[[memoryview], bytes | memoryview | None] | None


class RewrittenReader:
    """Base class of readers that rewrite the messages of another one; see `BagReader`.

    kind : that of a plain bag of such messages
    scan_every : N, of each publisher's laser scans the first and every N-th one after it are read
    scans : number of scans read in the last pass by topic, if some are left out
    """

    def __init__(self, reader: BagReader, kind: Kind, *, recover: bool = False, scan_every: int = 1) -> None:
        self.kind: Kind = kind
        self.name = reader.name
        self.paths: list[Path] = reader.paths
        self.complete = reader.complete
        self.count = 0
        self.scans: Counter[str] = Counter()
        self.reader = reader
        self._recover = recover
        self._every = scan_every
        self._met: Counter[int] = Counter()
        self._lost: list[str] = []
        self._rules: dict[int, Rule | None] = {}
        self._channels: dict[int, Channel] = {}
        self._told = 0

    @property
    def channels(self) -> Mapping[int, Channel]:
        """The channels, of which a pipe tells while it is read."""
        if self._told < len(self.reader.channels):
            self._told = len(self.reader.channels)
            self._channels = {
                n: r.channel for n in self.reader.channels if (r := self.rule_of(n)) and r.channel.id == n
            }
        return self._channels

    def rule(self, channel: Channel) -> Rule | None:
        """Return what becomes of a channel of the other reader; None leaves it out."""
        raise NotImplementedError

    def rule_of(self, number: int) -> Rule | None:
        """Return the rule for a channel of the other reader, by its id."""
        if number not in self._rules:
            self._rules[number] = self.rule(self.reader.channels[number])
        return self._rules[number]

    @property
    def losses(self) -> list[str]:
        """Parts of a damaged bag, and messages, that could not be read, one sentence each."""
        return [*self.reader.losses, *self._lost]

    @property
    def part_read(self) -> float | None:
        """Part of the bag read in this pass, 0 to 1; None where unknown."""
        return getattr(self.reader, "part_read", None)

    def definition(self, channel: Channel) -> Definition:
        """Return the definition of a channel's type."""
        rule = self.rule_of(channel.id)
        assert rule is not None  # noqa: S101 - `channels` has none that is left out
        return rule.definition

    def blocks(self, only: Container[int] | None = None) -> Iterator[Block]:
        """Yield the blocks with their messages rewritten, those of channels outside `only` perhaps without data."""
        self.count, self._met, self.scans = 0, Counter(), Counter()
        self._lost.clear()
        wanted = None
        if only is not None:
            wanted = {n for n in self.reader.channels if (rule := self.rule_of(n)) and rule.channel.id in only}
        for block in self.reader.blocks(wanted):
            done = self._rewritten(block, wanted)
            self.count += len(done.table)
            if len(done.table) or not len(block.table):  # without messages: attachments and metadata of an MCAP
                yield done
        if self._every > 1 and all(channel.msgtype != SCAN for channel in self.channels.values()):
            raise TopicError(f"{self.name}: has no {SCAN}, of which --scan-every leaves some out; do without it")

    def _rewritten(self, block: Block, wanted: Container[int] | None) -> Block:
        rules = {number: rule for number in block.present() if (rule := self.rule_of(number)) is not None}
        kept = np.isin(block.table["channel"], list(rules))
        for number, rule in rules.items() if self._every > 1 else ():
            if rule.channel.msgtype == SCAN:
                own = np.flatnonzero(block.table["channel"] == number)
                kept[own] = (self._met[number] + np.arange(len(own))) % self._every == 0
                self._met[number] += len(own)
                self.scans[rule.channel.topic] += int(np.count_nonzero(kept[own]))
        rewrites = {n: rule.rewrite for n, rule in rules.items() if rule.rewrite and (wanted is None or n in wanted)}
        pieces: list[bytes | memoryview] = []
        view, cells = block.data.data, block.table.tolist() if rewrites else []
        for row in np.flatnonzero(kept).tolist() if rewrites else ():
            number, _, offset, length = cells[row]
            piece: bytes | memoryview | None = view[offset : offset + length]
            if number in rewrites:
                try:
                    piece = rewrites[number](view[offset : offset + length])
                except BagError as error:
                    if not self._recover:
                        raise
                    self._lost.append(loss_of(error))
                    piece = None
            if piece is None:
                kept[row] = False
            else:
                pieces.append(piece)
        table = with_ids(block.table[kept], lambda number: rules[number].channel.id)
        stops = np.concatenate(([0], np.cumsum(kept)))[np.searchsorted(block.table["offset"], block.ends)]
        if not rewrites:
            ends = [end for end, has in zip(block.ends, np.diff(stops, prepend=0).tolist(), strict=True) if has]
            return Block(block.data, table, block.raw.kept(block.raw.begins(block.table)[kept]), ends=tuple(ends))
        table["length"] = [len(piece) for piece in pieces]
        bounds = np.concatenate(([0], np.cumsum(table["length"])))
        table["offset"] = bounds[:-1]
        data = np.frombuffer(bytearray().join(pieces), dtype=np.uint8)
        return Block(data, table, Framing(block.raw.codec), ends=tuple(sorted(set(bounds[stops].tolist()) - {0})))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        """Do nothing: the other reader is closed by its own context."""
