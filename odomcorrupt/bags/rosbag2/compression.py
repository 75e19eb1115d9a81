"""ROS 2 bags compressed with zstd: whole files (.db3.zstd, .mcap.zstd), or each message by itself."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import zstandard

from odomcorrupt.bags.block import Block, Framing
from odomcorrupt.bags.codecs import Packed, zstd_pieces
from odomcorrupt.bags.convert.rewritten import RewrittenReader, Rule
from odomcorrupt.bags.record_reader import Undecodable, with_readable
from odomcorrupt.bags.source import Budget, Source
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Container, Iterator, Sequence
    from contextlib import ExitStack

    from odomcorrupt.bags.block import BagReader, Channel

Mode = Literal["none", "file", "message"]
"""What of a ROS 2 bag is compressed: nothing, its files, or each message; chunks of an MCAP are another matter."""

SUFFIXES = (".zstd", ".zst")
"""Of compressed files; rosbag2 writes the first."""

_DEFAULT_LEVEL = 3
"""That of zstd, and of rosbag2."""


def unpacked_files(files: Sequence[Path], stack: ExitStack, losses: list[str], *, recover: bool = False) -> list[Path]:
    """Return decompressed copies of files in a temporary directory, which the stack removes.

    losses : with recovery, for what could not be decompressed, one sentence for each file
    """
    budget = Budget()
    try:
        directory = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="odomcorrupt")))
        copies = [directory / (file.stem if file.suffix.lower() in SUFFIXES else file.name) for file in files]
        for file, copy in zip(files, copies, strict=True):
            try:
                _unpack(file, copy, budget)
            except (zstandard.ZstdError, EOFError) as error:
                why = "it is truncated" if isinstance(error, EOFError) else error
                sentence = f"{file}: zstd cannot decompress it: {why}"
                if not recover:
                    raise BagError(f"{sentence}; --recover saves the intact part") from error
                losses.append(sentence)
    except BagError:
        raise
    except OSError as error:
        raise BagError(
            f"{error.filename or files[0]}: cannot be decompressed into {tempfile.gettempdir()}: {error.strerror}; "
            "TMPDIR names another directory"
        ) from error
    return copies


def _unpack(file: Path, target: Path, budget: Budget) -> None:
    with Source.of_file(file) as source, target.open("wb") as out:
        packed = Packed(source, source.size or 0, "compressed file")
        budget.require(0, packed.left, str(file))
        for piece in zstd_pieces(packed):
            budget.take(len(piece), str(file))
            out.write(piece)


class UnpackedMessages(RewrittenReader):
    """A file of a bag, or a bag, whose messages are compressed one by one, read as if they were not."""

    def __init__(self, reader: BagReader, *, recover: bool = False) -> None:
        super().__init__(reader, reader.kind, recover=recover)
        self._budget = Budget()

    def blocks(self, only: Container[int] | None = None) -> Iterator[Block]:
        """Yield the blocks with their messages decompressed."""
        self._budget = Budget()
        if not self._recover:
            yield from super().blocks(only)
            return
        undecodable = Undecodable()
        for block in super().blocks(with_readable(only, self.channels)):
            left_out = undecodable.find(block, self.channels)
            self.count -= int(np.count_nonzero(left_out))
            block.table = block.table[~left_out]
            yield block
        self._lost += undecodable.losses(self.name)

    def __exit__(self, *error: object) -> None:
        """Close the file."""
        self.reader.__exit__(*error)

    def rule(self, channel: Channel) -> Rule:
        """Return the channel, whose messages are decompressed."""
        what = f"{self.name}: a message on {channel.topic}"
        return Rule(channel, self.reader.definition(channel), lambda data: _decompress(data, what, self._budget))


def _decompress(data: memoryview, what: str, budget: Budget) -> bytes:
    """Return a decompressed message, within the budget of its bag."""
    try:
        size = zstandard.frame_content_size(data)
        if size < 0:
            raise BagError(f"{what}: does not state its size, as every compressed message must; the bag is damaged")
        budget.require(size, len(data), what)
        budget.take(size, what)
        out: bytes = zstandard.ZstdDecompressor().decompress(data)
    except (zstandard.ZstdError, MemoryError, ValueError) as error:
        raise BagError(f"{what}: zstd cannot decompress it: {error}; --recover saves the intact part") from error
    return out


def compressed_block(block: Block, level: int | None) -> Block:
    """Return a block with each of its messages compressed."""
    compressor = zstandard.ZstdCompressor(level=_DEFAULT_LEVEL if level is None else level)
    view = block.data.data
    spans = zip(block.table["offset"].tolist(), block.table["length"].tolist(), strict=True)
    pieces = [compressor.compress(view[offset : offset + length]) for offset, length in spans]
    table = block.table.copy()
    table["length"] = [len(piece) for piece in pieces]
    ends = np.cumsum(table["length"])
    table["offset"] = ends - table["length"]
    rows = np.searchsorted(block.table["offset"], block.ends)
    moved = tuple(sorted({int(end) for end in np.concatenate(([0], ends))[rows].tolist() if end}))
    data = np.frombuffer(bytearray().join(pieces), dtype=np.uint8)
    added = [one._replace(data=compressor.compress(one.data)) for one in block.added]
    return Block(data, table, Framing(block.raw.codec), added, moved)


def compress_file(path: Path, level: int | None) -> Path:
    """Compress a file, remove it, and return the compressed one."""
    packed = path.with_name(path.name + SUFFIXES[0])
    compressor = zstandard.ZstdCompressor(level=_DEFAULT_LEVEL if level is None else level)
    try:
        with path.open("rb") as source, packed.open("xb") as target:
            compressor.copy_stream(source, target, size=path.stat().st_size)
        path.unlink()
    except OSError as error:
        raise BagError(f"{packed}: cannot be written: {error.strerror}") from error
    return packed
