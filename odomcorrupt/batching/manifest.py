"""What a batch keeps of itself: what it was begun with, which runs are made, and the manifest.

A run's record is on the disk before its file appears under its name, so a file under its name is whole and told of,
whenever a batch was killed. A record without its file counts for nothing.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import socket
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import odomcorrupt
from odomcorrupt.bags.output import Output
from odomcorrupt.errors import OdomCorruptError
from odomcorrupt.model.model_file import format_model

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from pathlib import Path

    from odomcorrupt.batching.job import Job

__all__ = [
    "BatchError",
    "begin",
    "fingerprint_of",
    "note",
    "read_beginning",
    "read_records",
    "sweep_leftovers",
    "write_manifest",
    "write_whole",
]

BEGINNING = "batch.json"
MANIFEST = "manifest.jsonl"
PARTS = ".parts"
ROBOTS = "robots"

_LEFT = re.compile(r"\.(?:(?:run_)?(?P<run>\d{6,})\b)?.*\.(?P<pid>\d{1,9})\.[0-9a-f]{8}\.partial(?:-.*)?")
"""A file half written, or what sqlite3 has beside it, see `bags.output.beside`."""

_WORDS = {
    "input": "another input",
    "model": "another model",
    "robots": "other distributions",
    "seed": "another seed",
    "output": "another --output or --layout",
    "options": "other options",
    "version": "another version of odomcorrupt",
}


class BatchError(OdomCorruptError):
    """A batch cannot be begun, gone on with or read."""


def fingerprint_of(source: Path) -> str:
    """Return a hash of every byte of a bag."""
    digest = hashlib.blake2b(digest_size=16)
    files = sorted(file for file in source.iterdir() if file.is_file()) if source.is_dir() else [source]
    try:
        for file in files:
            digest.update(file.name.encode() if source.is_dir() else b"")
            with file.open("rb") as stream:
                while piece := stream.read(1 << 20):
                    digest.update(piece)
    except OSError as error:
        raise BatchError(f"{source}: cannot be read: {error.strerror}") from error
    return digest.hexdigest()


def _beginning(job: Job, fingerprint: str) -> dict[str, Any]:
    map_words = [] if job.condition is None else [*job.condition.provenance().values()]
    return {
        "version": odomcorrupt.__version__,
        "input": {"path": job.shown_source, "hash": fingerprint},
        "model": {"text": format_model(job.model), "hash": hashlib.sha256(repr(job.model).encode()).hexdigest()[:32]},
        "robots": [[spread.effect, spread.parameter, spread.deviation] for spread in job.spreads],
        "seed": job.seed,
        "output": [job.output, "split" if job.split else "as it was"],
        "options": [repr(job.options), repr(job.container), *map_words],
    }


def read_beginning(directory: Path) -> dict[str, Any]:
    """Return what a batch was begun with; BatchError where there is none."""
    try:
        table: dict[str, Any] = json.loads((directory / BEGINNING).read_text(encoding="utf8"))
    except (OSError, ValueError) as error:
        raise BatchError(f"{directory}: holds no batch ({BEGINNING} cannot be read); make one with batch") from error
    return table


def begin(job: Job, fingerprint: str) -> None:
    """Begin a batch in its directory, or go on with the one that is there.

    Raises
    ------
    BatchError
        Where that one was begun with something else, or the directory holds other things.

    """
    now = _beginning(job, fingerprint)
    if (job.directory / BEGINNING).exists():
        then = read_beginning(job.directory)
        changed = [words for key, words in _WORDS.items() if _compared(then, key) != _compared(now, key)]
        if changed:
            raise BatchError(
                f"{job.shown_directory}: was begun with {' and '.join(changed)}; give what it was begun with (see "
                f"{BEGINNING}), or name another directory"
            )
    elif job.directory.exists() and any(not _left_of_a_beginning(file) for file in job.directory.iterdir()):
        raise BatchError(f"{job.shown_directory}: holds files, but no batch; name another directory")
    (job.directory / PARTS).mkdir(parents=True, exist_ok=True)
    write_whole(job.directory / BEGINNING, (json.dumps(now, indent=2) + "\n").encode())
    write_whole(job.directory / "model.toml", job.model_text.encode())


def _left_of_a_beginning(path: Path) -> bool:
    """Whether a file is what a batch leaves that is killed before it has begun."""
    return path.name == PARTS or _LEFT.fullmatch(path.name) is not None


def _compared(table: Mapping[str, Any], key: str) -> Any:
    value = table.get(key)
    return value.get("hash") if isinstance(value, dict) else value


def write_whole(path: Path, data: bytes) -> None:
    """Write a small file beside its name, and rename it."""
    output = Output(path)
    output.open()
    try:
        output.write(data)
        output.commit()
    finally:
        output.discard()


def note(job: Job, records: Iterable[Mapping[str, Any]]) -> None:
    """Put the records of runs on the disk, in a file of this process alone."""
    lines = "".join(json.dumps(record) + "\n" for record in records).encode()
    path = job.directory / PARTS / f"{socket.gethostname()}-{os.getpid()}.jsonl"
    with path.open("ab", buffering=0) as stream:
        # a line that a kill cut short must not swallow the next one
        stream.write(b"\n" + lines if stream.tell() else lines)
        os.fsync(stream.fileno())


def read_records(job_directory: Path) -> dict[int, dict[str, Any]]:
    """Return the records of the runs whose files are there, by run."""
    records: dict[int, dict[str, Any]] = {}
    parts = sorted((job_directory / PARTS).glob("*.jsonl"))
    for part in [job_directory / MANIFEST, *parts]:
        if part.exists():
            for line in part.read_bytes().splitlines():
                with suppress(ValueError):
                    record = json.loads(line)
                    records[record["run"]] = record
    return {run: record for run, record in sorted(records.items()) if (job_directory / record["file"]).exists()}


def write_manifest(directory: Path) -> int:
    """Put all records into the manifest, in the order of runs; return how many there are.

    Shards may end at the same time: whoever wrote last looks once more whether it knew all parts.
    """
    while True:
        seen = _parts(directory)
        records = read_records(directory)
        write_whole(directory / MANIFEST, "".join(json.dumps(one) + "\n" for one in records.values()).encode())
        if _parts(directory) == seen:
            return len(records)


def _parts(directory: Path) -> list[tuple[str, int]]:
    return sorted((part.name, part.stat().st_size) for part in (directory / PARTS).glob("*.jsonl"))


def sweep_leftovers(job: Job, ours: Callable[[int | None], bool]) -> None:
    """Remove what killed processes of this machine had half written, of runs that are made by now, too.

    ours : whether a run is one of ours; None asks for what belongs to no run
    """
    for room in (job.directory, job.directory / ROBOTS):
        for left in room.glob(".*.partial*"):
            found = _LEFT.fullmatch(left.name)
            if found is None or _alive(int(found["pid"])):
                continue
            if ours(None if found["run"] is None else int(found["run"])):
                if left.is_dir():
                    shutil.rmtree(left)
                else:
                    left.unlink(missing_ok=True)


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
