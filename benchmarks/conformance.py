"""The public conformance suite of MCAP: each file is read and rewritten, and compared by the mcap library.

    python benchmarks/conformance.py FOLDER

FOLDER is `tests/conformance/data` of a checkout of foxglove/mcap with its large files (git lfs pull), or what its
`yarn workspace @foxglove/mcap-conformance generate-inputs --data-dir FOLDER` writes. Of every file header, schemas,
channels, messages (with times and sequence numbers), attachments and metadata must be the same after a pass through
reader and writer, in the same order, and what is counted must be what is there. The exit code is 1 if one differs.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from pathlib import Path

from mcap.data_stream import RecordBuilder
from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

from odomcorrupt.bags.open import open_reader, open_writer

CONTENT = (Header, Schema, Channel, Message, Attachment, Metadata)


def content(path: Path) -> list[bytes]:
    """Return the records of a file's data, serialised by the mcap library, without those of its summary."""
    found: list[bytes] = []
    with path.open("rb") as stream:
        for record in StreamReader(stream, validate_crcs=True).records:
            if type(record).__name__ == "DataEnd":
                break
            if isinstance(record, CONTENT):
                builder = RecordBuilder()
                record.write(builder)
                found.append(builder.end())
    return found


def differences(path: Path, target: Path) -> list[str]:
    """Return what differs after a pass through reader and writer."""
    read: Counter[str] = Counter()
    with open_reader(path) as reader, open_writer(target, reader) as writer:
        for block in reader.blocks():
            read.update(reader.channels[number].topic for number in block.table["channel"].tolist())
            writer.write(block)
        losses = list(reader.losses)
    before, after = content(path), content(target)
    wrong = [f"lost: {one}" for one in losses]
    with path.open("rb") as stream:
        records = list(StreamReader(stream).records)
    topics = {one.id: one.topic for one in records if isinstance(one, Channel)}
    if read != Counter(topics[one.channel_id] for one in records if isinstance(one, Message)):
        wrong.append(f"{read.total()} messages read")
    if before != after:
        wrong.append(f"{len(before)} records became {len(after)}, or others")
    return wrong


def main() -> int:
    """Compare all files of a folder, and print how many are the same."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    files = sorted(parser.parse_args().folder.rglob("*.mcap"))
    good = same = 0
    with tempfile.TemporaryDirectory() as room:
        for path in files:
            target = Path(room) / path.name
            try:
                wrong = differences(path, target)
            except Exception as error:  # noqa: BLE001 - one bad file must not hide the others
                wrong = [f"{type(error).__name__}: {error}"]
            for one in wrong:
                print(f"{path.name}: {one}")
            good += not wrong
            same += not wrong and path.read_bytes() == target.read_bytes()
    print(f"{good} of {len(files)} files have the same records, {same} the same bytes")
    return int(good < len(files) or not files)


if __name__ == "__main__":
    sys.exit(main())
