"""A bag whose messages are rewritten one by one while it is read."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from odomcorrupt.bags.block import TABLE, Block, Channel, Framing, Kind, joined
from odomcorrupt.bags.record_reader import loss_of
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterator
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
    """

    def __init__(self, reader: BagReader, kind: Kind, *, recover: bool = False) -> None:
        self.kind: Kind = kind
        self.name = reader.name
        self.paths: list[Path] = reader.paths
        self.complete = reader.complete
        self.count = 0
        self.channels: Mapping[int, Channel] = _Channels(self)
        self.reader = reader
        self._recover = recover
        self._lost: list[str] = []
        self._rules: dict[int, Rule | None] = {}

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
        self.count = 0
        self._lost.clear()
        wanted = None if only is None else {one for one in self.reader.channels if self._target(one) in only}
        for block in joined(self.reader.blocks(wanted)):
            yield self._rewritten(block, wanted)

    def _target(self, number: int) -> int | None:
        rule = self.rule_of(number)
        return None if rule is None else rule.channel.id

    def _rewritten(self, block: Block, wanted: Container[int] | None) -> Block:
        if not len(block.table):
            return Block(block.data, block.table, block.raw)  # attachments and metadata of an MCAP
        view = block.data.data
        pieces: list[bytes | memoryview] = []
        rows: list[tuple[int, int, int, int]] = []
        ends: list[int] = []
        borders = list(block.ends[:-1])
        at = 0
        for number, log_ns, offset, length in block.table.tolist():
            while borders and offset >= borders[0]:
                borders.pop(0)
                ends.append(at)
            rule = self._rules[number] if number in self._rules else self.rule_of(number)
            if rule is None:
                continue
            piece: bytes | memoryview | None = view[offset : offset + length]
            if rule.rewrite is not None and (wanted is None or number in wanted):
                try:
                    piece = rule.rewrite(view[offset : offset + length])
                except BagError as error:
                    if not self._recover:
                        raise
                    self._lost.append(loss_of(error))
                    continue
            if piece is None:
                continue
            pieces.append(piece)
            rows.append((rule.channel.id, log_ns, at, len(piece)))
            at += len(piece)
        self.count += len(rows)
        data = np.frombuffer(bytearray().join(pieces), dtype=np.uint8)
        inner = tuple(sorted({end for end in ends if 0 < end < at}))
        table = np.array(rows, dtype=TABLE)
        return Block(data, table, Framing(block.raw.codec), ends=(*inner, at) if inner else ())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        """Do nothing: the other reader is closed by its own context."""


class _Channels(Mapping[int, Channel]):
    """The channels of a rewritten bag, which a pipe tells of while it is read."""

    def __init__(self, reader: RewrittenReader) -> None:
        self._of = reader

    def _ids(self) -> list[int]:
        rules = (self._of.rule_of(number) for number in self._of.reader.channels)
        return list(dict.fromkeys(rule.channel.id for rule in rules if rule is not None))

    def __getitem__(self, number: int) -> Channel:
        rule = self._of.rule_of(number) if number in self._of.reader.channels else None
        if rule is None or rule.channel.id != number:
            raise KeyError(number)
        return rule.channel

    def __iter__(self) -> Iterator[int]:
        return iter(self._ids())

    def __len__(self) -> int:
        return len(self._ids())
