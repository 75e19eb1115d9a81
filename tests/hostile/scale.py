"""How far it goes: `python tests/hostile/scale.py`, a table of memory, time and whether what comes out is right.

Wants 25 GB of disk for a bag of 10 GB and its output (`--gigabytes` for less); the pipe is `benchmarks/pipe.py`.
"""

# ruff: noqa: T201 - a script that prints, and runs what it is for

from __future__ import annotations

import argparse
import os
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

sys.path.insert(0, str(Path(__file__).parent))

from smallbags import Office, definition

from odomcorrupt.bags.open import open_reader

ODOMETRY = "nav_msgs/msg/Odometry"
START_NS = 1_700_000_000 * 10**9


def bag(path: Path, odometry: int, *, payload: int = 0, topics: int = 0) -> int:
    """Write an MCAP: odometry at 50 Hz on a circle, each followed by so many bytes of an image; return the messages."""
    office = Office(2)
    template = bytearray(office.odometry(START_NS, np.zeros(3), np.array([0.5, 0.125])))
    # stamp, then position and orientation behind the strings "odom" and "base_link"
    begin = template.index(b"base_link") + 10
    begin += (4 - begin) % 8
    image = np.random.default_rng(1).bytes(payload)
    with path.open("wb") as stream:
        codec = CompressionType.NONE if payload else CompressionType.ZSTD
        writer = McapWriter(stream, chunk_size=1 << 20, compression=codec)
        writer.start(profile="ros2", library="scale")
        schema = writer.register_schema(ODOMETRY, "ros2msg", definition(office, ODOMETRY)[0].encode())
        other = writer.register_schema("some_msgs/msg/Blob", "ros2msg", b"uint8[] data\n")
        odom = writer.register_channel("/odom", "cdr", schema)
        blobs = [writer.register_channel(f"/blob_{i}", "cdr", other) for i in range(max(topics, bool(payload)))]
        for i in range(odometry):
            t = i * 0.02
            stamp = START_NS + i * 20_000_000
            struct.pack_into("<iI", template, 4, *divmod(stamp, 10**9))
            angle = 0.125 * t
            struct.pack_into("<7d", template, begin, 4 * np.sin(angle), 4 - 4 * np.cos(angle), 0, 0, 0,
                             np.sin(angle / 2), np.cos(angle / 2))  # fmt: skip
            writer.add_message(odom, stamp + 10**6, bytes(template), stamp)
            if payload:
                writer.add_message(blobs[0], stamp + 2 * 10**6, image, stamp)
        for i in range(topics):
            writer.add_message(blobs[i], START_NS + i * 10_000, b"\0\1\0\0" + bytes(60), START_NS)
        writer.finish()
    return odometry + (odometry if payload else 0) + topics


def measured(source: Path, target: Path) -> tuple[int, float, float, float]:
    """Corrupt a bag; return exit code, wall and CPU seconds, and largest resident memory in MB."""
    begun = time.monotonic()
    words = [
        sys.executable,
        "-m",
        "odomcorrupt",
        str(source),
        str(target),
        "--alpha",
        *["0.05", "0.02", "0.05", "0.01"],
    ]
    process = subprocess.Popen([*words, "--seed", "7"], stderr=subprocess.PIPE)
    said = process.stderr.read().decode() if process.stderr else ""
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        print(f"  {said.strip()}")
    cpu = usage.ru_utime + usage.ru_stime
    return process.returncode, time.monotonic() - begun, cpu, usage.ru_maxrss / 1000 * 1.024


def right(source: Path, target: Path) -> str:
    """Compare tables: all messages there, in their order, with their log times and lengths."""
    sums = []
    for path in (source, target):
        count = check = 0
        with open_reader(path) as reader:
            for block in reader.blocks():
                table = block.table
                place = np.arange(count, count + len(table)) % 1009 + 1
                row = table["log_ns"] % 1_000_003 + 7 * table["length"] + 13 * table["channel"].astype(np.int64)
                check += int((place * row).sum())
                count += len(table)
        sums.append((count, check))
    return f"all {sums[0][0]} messages" if sums[0] == sums[1] else f"WRONG: {sums}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--gigabytes", type=float, default=10.0)
    parser.add_argument("--messages", type=int, default=10_000_000)
    parser.add_argument("--room", type=Path)
    given = parser.parse_args()
    cases = {
        "no message": (0, 0, 0),
        "one message": (1, 0, 0),
        "10 000 topics": (1000, 0, 10_000),
        f"{given.messages:.0e} odometry messages": (given.messages, 0, 0),
        f"{given.gigabytes:g} GB": (int(given.gigabytes * 1e9 / 900_800), 900_000, 0),
    }
    print("| bag | MB | exit code | wall s | CPU s | memory MB | out |\n|---|---|---|---|---|---|---|")
    for name, (odometry, payload, topics) in cases.items():
        with tempfile.TemporaryDirectory(dir=given.room) as room:
            source, target = Path(room) / "in.mcap", Path(room) / "out.mcap"
            bag(source, odometry, payload=payload, topics=topics)
            code, wall, cpu, memory = measured(source, target)
            out = right(source, target) if target.exists() else "none"
            size = source.stat().st_size / 1e6
            print(f"| {name} | {size:.3g} | {code} | {wall:.1f} | {cpu:.1f} | {memory:.0f} | {out} |", flush=True)


if __name__ == "__main__":
    main()
