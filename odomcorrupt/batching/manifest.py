"""State of a batch on disk: its configuration, the records of its runs, and the manifest.

A run is written in a hidden folder. Its record, with size and checksum, is on disk before its file is renamed to its
final name, so every file with a final name is complete and recorded, even if a batch was killed. A record without
such a file is ignored.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import re
import socket
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, NamedTuple

import xxhash

import odomcorrupt
from odomcorrupt.bags.checksum import crc32
from odomcorrupt.bags.open import is_pattern
from odomcorrupt.bags.output import sweep
from odomcorrupt.errors import BagError, BatchError
from odomcorrupt.input_files import read_input
from odomcorrupt.model.model_file import format_model
from odomcorrupt.result_files import write_file
from odomcorrupt.rng import draw_seed

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

    from odomcorrupt.batching.job import Job

BEGINNING = "batch.json"
MANIFEST = "manifest.jsonl"
PARTS = ".parts"
ROBOTS = "robots"

_PIECE_BYTES = 1 << 18
_TEXTS = (("input", "path"), ("input", "hash"), ("model", "text"), ("model", "hash"))

_WORDS = {
    "input": "another input",
    "model": "another model",
    "robots": "other distributions",
    "seed": "another seed",
    "output": "another --output, --layout or --to",
    "options": "other options",
    "version": "another version of odomcorrupt",
}


def fingerprint_of(source: Path) -> str:
    """Return a hash of all bytes of a bag, and of its files' names if it has several."""
    digest = xxhash.xxh3_128()  # against mistakes, not against malice; BLAKE2 took a sixth of a batch of overlays
    try:
        for file in (one for one in _files(source) if one == source or one.is_file()):
            digest.update(file.name.encode() if file != source else b"")
            with file.open("rb") as stream:
                while piece := stream.read(1 << 20):
                    digest.update(piece)
    except OSError as error:
        raise BatchError(f"{source}: cannot be read: {error.strerror}") from error
    return digest.hexdigest()


def _beginning(job: Job, fingerprint: str) -> dict[str, Any]:
    batch, layout = job.batch, "split" if job.batch.split else "as it was"
    map_words = [] if batch.condition is None else [*batch.condition.provenance().values()]
    return {
        "version": odomcorrupt.__version__,
        "input": {"path": job.shown_source, "hash": fingerprint},
        "model": {"text": format_model(job.model), "hash": hashlib.sha256(repr(job.model).encode()).hexdigest()[:32]},
        "robots": [[spread.effect, spread.parameter, spread.deviation] for spread in job.spreads],
        "seed": batch.seed,
        "output": [batch.output, layout, *([] if batch.to is None else [batch.to])],
        "options": [repr(batch.options), repr(batch.container), *map_words, *batch.also],
    }


def read_beginning(directory: Path) -> dict[str, Any]:
    """Return a batch's configuration (batch.json); BatchError where it is missing or invalid."""
    path = directory / BEGINNING
    try:
        table = _parsed(_read(path))
        _require(isinstance(table, dict) and type(table["seed"]) is int and table["seed"] >= 0)
        _require(all(isinstance(table[key], str) for key in ("version",)) and isinstance(table["robots"], list))
        _require(all(isinstance(table[one][key], str) for one, key in _TEXTS))
        _require(all(len(spread) == 3 for spread in table["robots"]))
    except FileNotFoundError as error:
        points = (f"name one of its points, as {found.parent}" for found in sorted(directory.glob(f"*/{BEGINNING}")))
        raise BatchError(f"{directory}: holds no batch ({BEGINNING}); {next(points, 'make one with batch')}") from error
    except OSError as error:
        raise BatchError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise BatchError(f"{path}: is not as batch writes it; restore it, or name another directory") from error
    return table


def seed_of(directory: Path) -> int:
    """Return the seed of the batch in a directory, or a new one."""
    there = next(iter(sorted(directory.rglob(BEGINNING))), None)
    return draw_seed() if there is None else int(read_beginning(there.parent)["seed"])


def _require(true: bool) -> None:  # noqa: FBT001 - a condition, as of assert
    if not true:
        raise ValueError


def _read(path: Path) -> bytes:
    """Return the bytes of a file of a batch; ValueError where it is no regular file, or too large."""
    path.stat()  # raises FileNotFoundError where there is none
    # largest manifest that is read; one of a million runs is smaller
    return read_input(path, 1 << 30, "file of a batch", ValueError)


def _parsed(text: bytes) -> Any:
    """Return the value of a JSON text; ValueError where it is invalid, or nested too deeply."""
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error


def begin(job: Job, fingerprint: str) -> None:
    """Start a batch in its directory, or continue the one that is there.

    Raises
    ------
    BatchError
        If that one has another configuration, or the directory holds other files.
    """
    now = _beginning(job, fingerprint)
    if not (job.directory / BEGINNING).exists():
        there = {file.name for file in job.directory.iterdir()} if job.directory.exists() else set[str]()
        # beside what is left of a batch that was killed before it had started
        if not all(name == PARTS or (name.startswith(".") and name.endswith(".partial")) for name in there):
            raise BatchError(f"{job.shown_directory}: holds files, but no batch; name another directory")
        # a second process finds the file of the first
        with suppress(BagError):
            _make_room(job)
            write_file(job.directory / BEGINNING, (json.dumps(now, indent=2) + "\n").encode(), overwrite=False)
    then = read_beginning(job.directory)
    changed = [words for key, words in _WORDS.items() if _compared(then, key) != _compared(now, key)]
    if changed:
        raise BatchError(
            f"{job.shown_directory}: was begun with {' and '.join(changed)}; give what it was begun with (see "
            f"{BEGINNING}), or name another directory"
        )
    _make_room(job)
    write_file(job.directory / "model.toml", job.model_text.encode())


def _make_room(job: Job) -> None:
    try:
        (job.directory / PARTS).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BatchError(f"{job.directory / PARTS}: cannot be made a directory: {error.strerror}") from error


@contextmanager
def locked(job: Job, *, shared: bool) -> Iterator[None]:
    """Hold the lock of a batch while its runs are made.

    shared : whether other shards may work at the same time

    Raises
    ------
    BatchError
        If another process holds the lock.
    """
    with (job.directory / BEGINNING).open("rb") as stream:
        try:
            fcntl.flock(stream, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise BatchError(
                f"{job.shown_directory}: another batch is running in it; wait for it, share the work with --shard, or "
                "name another directory"
            ) from error
        except OSError:
            pass  # a file system without locks
        yield


def _compared(table: Mapping[str, Any], key: str) -> Any:
    value = table.get(key)
    return value.get("hash") if isinstance(value, dict) else value


class Content(NamedTuple):
    """Size of a run's file or directory in bytes, and its CRC-32."""

    size: int
    crc: int


def content_of(path: Path, known_crc: int | None = None) -> Content:
    """Return size and CRC-32 of a run's file, or of a directory's file names and contents; a known CRC saves a read."""
    if known_crc is not None:
        return Content(bytes_of(path), known_crc)
    crc, buffer = 0, memoryview(bytearray(_PIECE_BYTES))
    for file in _files(path):
        crc = crc32(file.name.encode(), crc) if file != path else crc
        with file.open("rb", buffering=0) as stream:
            while got := stream.readinto(buffer):
                crc = crc32(buffer[:got], crc)
    return Content(bytes_of(path), crc)


def _files(path: Path) -> list[Path]:
    if path.is_dir():
        return sorted(path.iterdir())
    return sorted(path.parent.glob(path.name)) if is_pattern(path) else [path]


def bytes_of(path: Path) -> int:
    """Return the size of a bag (file or directory), bytes."""
    return sum(file.stat().st_size for file in _files(path))


def note(job: Job, records: Iterable[Mapping[str, Any]]) -> None:
    """Append the records of runs to a file of this process alone, and flush it to disk."""
    lines = "".join(json.dumps(record) + "\n" for record in records).encode()
    path = job.directory / PARTS / f"{socket.gethostname()}-{os.getpid()}.jsonl"
    with path.open("ab", buffering=0) as stream:
        # an incomplete last line of a killed process must not merge with the next
        stream.write(b"\n" + lines if stream.tell() else lines)
        os.fsync(stream.fileno())


def read_records(directory: Path, *, verify: bool = False) -> dict[int, dict[str, Any]]:
    """Return the records, by run number, of the runs whose files exist with the recorded size.

    verify : whether their checksums must match, too
    """
    records: dict[int, dict[str, Any]] = {}
    try:
        for part in [directory / MANIFEST, *sorted((directory / PARTS).glob("*.jsonl"))]:
            if part.exists():
                for line in _read(part).splitlines():
                    # an incomplete or damaged line is ignored
                    with suppress(ValueError, KeyError, TypeError):
                        record = _parsed(line)
                        _require_record(record)
                        records[record["run"]] = record
    except (OSError, ValueError) as error:
        raise BatchError(f"{directory}: the results of its runs cannot be read ({error}); remove {part}") from error
    return {run: one for run, one in sorted(records.items()) if _is_as_noted(directory, one, verify=verify)}


def _require_record(record: Any) -> None:
    """Raise ValueError, KeyError or TypeError where a record is invalid, or names files other than its run's."""
    run, errors = record["run"], record["errors"]
    _require(type(run) is int and 0 <= run < 1 << 62)
    _require(re.fullmatch(rf"run_{run:06d}(\.\w+)?", record["file"]) is not None)
    _require(record.get("robot", f"{ROBOTS}/{run:06d}.toml") == f"{ROBOTS}/{run:06d}.toml")
    _require(all(type(record[key]) is int for key in ("size", "crc32", "seed")))
    _require(all(isinstance(loss, str) for loss in record.get("losses", [])))
    _require(all(len(mark) == 4 and all(isinstance(one, float | int) for one in mark) for mark in errors))


def _is_as_noted(directory: Path, record: Mapping[str, Any], *, verify: bool) -> bool:
    path = directory / record["file"]
    try:
        if path.is_symlink() or bytes_of(path) != record["size"]:
            return False
        return not verify or content_of(path).crc == record["crc32"]
    except OSError:
        return False


def write_manifest(directory: Path) -> int:
    """Write all records to the manifest in the order of runs; return their number.

    Shards may end at the same time: the records are read again if any part has changed meanwhile.
    """
    while True:
        seen = _parts(directory)
        records = read_records(directory)
        write_file(directory / MANIFEST, "".join(json.dumps(one) + "\n" for one in records.values()).encode())
        if _parts(directory) == seen:
            return len(records)


def _parts(directory: Path) -> list[tuple[str, int]]:
    return sorted((part.name, part.stat().st_size) for part in (directory / PARTS).glob("*.jsonl"))


def sweep_leftovers(job: Job, missing: Iterable[int]) -> None:
    """Remove incomplete files of killed processes of this machine, and links under the names of runs to be made."""
    for room in (job.directory, job.directory / ROBOTS):
        sweep(room)
    for run in missing:
        if job.path_of(run).is_symlink():
            job.path_of(run).unlink()
