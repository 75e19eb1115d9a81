"""A million damaged inputs for the readers, in one process: `python tests/hostile/reader_fuzz.py --cases 1000000`.

No command starts and nearly no file is written: the damage goes to the readers through memory, and to the functions
that they are made of. What is asked goes beyond the project's own error in one line:

- the messages that are read without complaint are read by `--recover`, too;
- an index of messages that is accepted gives the table of the messages that lie there;
- numbers that are read from messages and written back leave all bytes as they were;
- records that were read, written and read again are the same.

A case is a kind and a number: `--only KIND --case N` tries one again.
"""

from __future__ import annotations

import bz2
import io
import re
import sys
from collections import Counter
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import lz4.frame
import numpy as np
import zstandard

sys.path.insert(0, str(Path(__file__).parent))

from fuzz import script
from mutations import _ANYWHERE, mutated
from smallbags import Small, make_small_bags
from trials import FoundError, guarded

from odomcorrupt.bags.block import TABLE, Block, Channel
from odomcorrupt.bags.chunk import Chunk
from odomcorrupt.bags.codecs import Packed, beginning, decompress
from odomcorrupt.bags.mcap import chunk as of_mcap
from odomcorrupt.bags.mcap.chunk import ChannelRecord, SchemaRecord
from odomcorrupt.bags.mcap.reader import read_summary
from odomcorrupt.bags.messages import READABLE, gather, gather_stamps_ns, locate, scatter, scatter_stamps_ns
from odomcorrupt.bags.open import open_reader
from odomcorrupt.bags.ros1 import chunk as of_ros1
from odomcorrupt.bags.source import BufferPool, Source
from odomcorrupt.errors import OdomCorruptError

if TYPE_CHECKING:
    from collections.abc import Callable

Rng = np.random.Generator

CPU_S = 10.0


class Inputs:
    """What is damaged: small bags, and the chunks, records and messages in them."""

    def __init__(self, room: Path) -> None:
        bags: dict[str, Small] = make_small_bags(room, 0.15)
        self.bags = {kind: small.path.read_bytes() for kind, small in bags.items() if small.path.is_file()}
        self.database = self.bags.pop("sqlite3 file")
        self.packed: list[tuple[str, bytes, int]] = []
        self.contents: dict[str, list[tuple[bytes, list[bytes]]]] = {"mcap": [], "ros1": []}
        self.messages: list[tuple[Channel, list[bytes]]] = []
        self.schemas: list[bytes] = []
        self.channels: list[bytes] = []
        for kind, data in self.bags.items():
            self._take(kind, data)

    def _take(self, kind: str, data: bytes) -> None:
        by_channel: dict[int, list[bytes]] = {}
        with open_reader(None, io.BytesIO(data)) as reader:
            parts = list(reader._parts(reader._source))
            chunks = [part for part in parts if isinstance(part, Chunk)]
            self.contents[kind[:4]] += [(one.data.tobytes(), [index for _, index in one.indexes]) for one in chunks]
        with open_reader(None, io.BytesIO(data)) as reader:
            for block in reader.blocks():
                for number, _, offset, length in block.table.tolist():
                    by_channel.setdefault(number, []).append(block.data[offset : offset + length].tobytes())
            for number, found in by_channel.items():
                if reader.channels[number].msgtype in READABLE:
                    self.messages.append((reader.channels[number], found))
            if kind.startswith("mcap"):
                self.schemas += [one.pack()[9:] for one in reader.schemas.values()]
                self.channels += [one.raw.pack()[9:] for one in reader.channels.values()]


class ReaderFuzz:
    """Tries cases, each from a seed of its own.

    kinds : of cases; counts : how many of each were tried, and what came of them
    """

    def __init__(self, room: Path, seed: int) -> None:
        self.seed = seed
        (room / "bags").mkdir()
        self.inputs = Inputs(room / "bags")
        self._database = room / "in.db3"
        self._pieces = list(self.inputs.bags.values())
        self.trials: dict[str, Callable[[Rng], str]] = {
            **{f"bag {kind}": self._bag_of(data) for kind, data in self.inputs.bags.items()},
            "chunk of mcap": partial(self._contents, "mcap"), "chunk of ros1": partial(self._contents, "ros1"),
            "codec": self._codec, "message": self._message, "record": self._record, "summary": self._summary,
            "sqlite3": self._sqlite3,
        }  # fmt: skip
        self.kinds = list(self.trials)
        self.counts: Counter[str] = Counter()

    def case(self, kind: str, number: int) -> None:
        rng = np.random.default_rng([self.seed, self.kinds.index(kind), number])
        try:
            with guarded(CPU_S):
                outcome = self.trials[kind](rng)
        except OdomCorruptError as error:
            if not str(error) or "\n" in str(error):
                raise FoundError(f"an error without a clear line: {error!r}") from error
            outcome = "refused"
        except Exception as error:
            raise FoundError(f"{type(error).__name__}: {error}") from error
        self.counts[f"{kind}: {outcome}"] += 1

    def _other(self, rng: Rng) -> bytes:
        return self._pieces[int(rng.integers(len(self._pieces)))]

    def _harmed(self, data: bytes, rng: Rng) -> bytes:
        """Return bytes that have no structure of their own damaged."""
        way = list(_ANYWHERE)[int(rng.integers(len(_ANYWHERE)))]
        return _ANYWHERE[way](data, self._other(rng), rng)

    def _bag_of(self, data: bytes) -> Callable[[Rng], str]:
        def trial(rng: Rng) -> str:
            harmed = data
            for _ in range(1 + int(rng.random() < 0.2)):
                with suppress(Exception):  # the tool that knows the formats gives up on what has no structure
                    harmed = mutated(harmed, self._other(rng), rng)[1]
            try:
                plain = _read(harmed, recover=False)
            except OdomCorruptError as error:
                if "\n" in str(error):
                    raise FoundError(f"an error without a clear line: {error!r}") from error
                plain = None
            try:
                saved = _read(harmed, recover=True)
            except OdomCorruptError as error:
                if "--recover" in error.message:
                    raise FoundError(f"advises what was given: {error}") from error
                saved = None
            # behind the index of a ROS 1 bag recovery may find more; what cannot be decoded is counted, and left out
            if plain is not None and (saved is None or saved[0] + _undecodable(saved[2]) < plain[0]):
                raise FoundError(f"read without complaint: {plain}; recovered: {saved}")
            return "read" if plain is not None else "refused" if saved is None else "recovered"

        return trial

    def _contents(self, kind: str, rng: Rng) -> str:
        data, indexes = self._chunk(self.inputs.contents[kind], rng)
        module, others = {"mcap": (of_mcap, "others"), "ros1": (of_ros1, "connections")}[kind]
        records = np.frombuffer(data, np.uint8)
        parts = (Chunk("chunk", "none", records, [(0, index) for index in some]) for some in (indexes, []))
        got, walked = (module.read_contents(part, records) for part in parts)
        if got.table.tolist() != walked.table.tolist() or getattr(got, others) != getattr(walked, others):
            raise FoundError("the index gives another table than the records")
        _require_within(got.table, len(data))
        return "read"

    def _chunk(self, chunks: list[tuple[bytes, list[bytes]]], rng: Rng) -> tuple[bytes, list[bytes]]:
        data, indexes = chunks[int(rng.integers(len(chunks)))]
        if rng.random() < 0.7:
            data = self._harmed(data, rng)
        if indexes and rng.random() < 0.5:
            at = int(rng.integers(len(indexes)))
            indexes = [*indexes[:at], self._harmed(indexes[at], rng), *indexes[at + 1 :]]
        return data, indexes

    def _codec(self, rng: Rng) -> str:
        codec = ("zstd", "lz4", "bz2")[int(rng.integers(3))]
        if not self.inputs.packed:
            self._pack()
        choice = [one for one in self.inputs.packed if one[0] == codec]
        _, data, size = choice[int(rng.integers(len(choice)))]
        harmed = self._harmed(data, rng)[: 1 << 16]
        if rng.random() < 0.3:
            size = int(2 ** rng.uniform(0, 34))
        begun = b"".join(
            beginning(
                codec, Packed(Source(io.BytesIO(harmed), ""), len(harmed), "chunk"), Source(io.BytesIO(), "").budget
            )
        )
        try:
            out = decompress(codec, memoryview(harmed), size, "chunk", BufferPool())
        except OdomCorruptError:
            return "refused"
        if out.size != size or (codec != "lz4" and begun != out.tobytes()):
            raise FoundError("its beginning is another one")
        return "read"

    def _pack(self) -> None:
        for data, _ in self.inputs.contents["mcap"][:6]:
            self.inputs.packed.append(("zstd", zstandard.compress(data), len(data)))
            self.inputs.packed.append(("lz4", lz4.frame.compress(data, content_checksum=True), len(data)))
            self.inputs.packed.append(("bz2", bz2.compress(data[:2000]), len(data[:2000])))

    def _message(self, rng: Rng) -> str:
        channel, found = self.inputs.messages[int(rng.integers(len(self.inputs.messages)))]
        messages = [found[0], self._harmed(found[-1], rng)[:4096], found[-1]]
        lengths = np.array([len(one) for one in messages])
        table = np.zeros(3, dtype=TABLE)
        table["channel"], table["length"], table["offset"] = channel.id, lengths, np.cumsum(lengths) - lengths
        block = Block(np.frombuffer(bytearray(b"".join(messages)), dtype=np.uint8), table)
        before = block.data.tobytes()
        layouts = locate(block, channel)
        if sorted(row for layout in layouts for row in layout.rows.tolist()) != [0, 1, 2]:
            raise FoundError("a message without a layout, or with two")
        for layout in layouts:
            for item in layout.items:
                for field in item.fields:
                    scatter(block, layout, item, field, gather(block, layout, item, field))
        # a bit may make a signalling NaN quiet
        if np.any((np.frombuffer(before, dtype=np.uint8) ^ block.data) & ~np.uint8(0x08)):
            raise FoundError("numbers that were read and written back are other ones")
        for layout in layouts:
            for item in layout.items:
                # nanoseconds beyond a second are written as seconds: the same time, in other bytes
                stamps_ns = gather_stamps_ns(block, layout, item)
                with suppress(OdomCorruptError):
                    scatter_stamps_ns(block, layout, item, stamps_ns)
                if gather_stamps_ns(block, layout, item).tolist() != stamps_ns.tolist():
                    raise FoundError("stamps that were read and written back are other ones")
        return "read"

    def _record(self, rng: Rng) -> str:
        kind, choice = (
            (SchemaRecord, self.inputs.schemas) if rng.random() < 0.4 else (ChannelRecord, self.inputs.channels)
        )
        data = self._harmed(choice[int(rng.integers(len(choice)))], rng)
        one = kind.parse(data, "record")  # type: ignore[attr-defined]
        if kind.parse(one.pack()[9:], "record") != one:  # type: ignore[attr-defined]
            raise FoundError("written and read again it is another record")
        return "read"

    def _summary(self, rng: Rng) -> str:
        kinds = [kind for kind in self.inputs.bags if kind.startswith("mcap")]
        data = self.inputs.bags[kinds[int(rng.integers(len(kinds)))]]
        at = len(data) - int(2 ** rng.uniform(3, 12))
        data = data[:at] + self._harmed(data[at:], rng)
        source = Source(io.BytesIO(data), "in.mcap")
        source.size = len(data)
        read_summary(source, len(data))
        return "read"

    def _sqlite3(self, rng: Rng) -> str:
        self._database.write_bytes(mutated(self.inputs.database, self._other(rng), rng)[1])
        with open_reader(self._database, recover=bool(rng.random() < 0.3)) as reader:
            for _ in reader.blocks():
                pass
        return "read"


def _require_within(table: np.ndarray, size: int) -> None:
    if table.size and (table["offset"].min() < 0 or (table["offset"] + table["length"]).max() > size):
        raise FoundError("a message reaches beyond its chunk")


def _read(data: bytes, *, recover: bool) -> tuple[int, int, list[str]]:
    """Return how many messages are read, how many bytes of them, and what is lost."""
    stream = io.BytesIO(data)
    stream.seekable = lambda: False  # type: ignore[method-assign]
    count = size = 0
    with open_reader(None, stream, recover=recover) as reader:
        for block in reader.blocks():
            count += len(block.table)
            size += int(block.table["length"].sum())
            _require_within(block.table, block.data.size)
        return count, size, list(reader.losses)


def _undecodable(losses: list[str]) -> int:
    """Return how many messages are said to be left out, since they cannot be decoded."""
    return sum(
        int(count)
        for count in re.findall(r": (\d+) of the messages of .* cannot be decoded: left out", "\n".join(losses))
    )


if __name__ == "__main__":
    sys.exit(script(__doc__, ReaderFuzz))
