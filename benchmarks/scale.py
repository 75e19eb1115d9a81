"""How far it goes: `python benchmarks/scale.py`, a table of memory, time and whether what comes out is right.

Wants 25 GB of disk for a bag of 10 GB and its output (`--gigabytes` for less); the pipe is `benchmarks/pipe.py`.
"""

import argparse
import shlex
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "hostile"))

from longbags import LONG, ODOMETRY, START_NS, STEP_NS, Template
from smallbags import Office, definition

from odomcorrupt.bags.open import open_reader


def bag(path: Path, odometry: int, *, payload: int = 0, topics: int = 0) -> None:
    """Write an MCAP: odometry at 50 Hz on a circle, each followed by so many bytes of an image; and other topics."""
    office = Office(2)
    template = Template()
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
            stamp = START_NS + i * STEP_NS
            writer.add_message(odom, stamp + 10**6, template.rows(i, 1)[1], stamp)
            if payload:
                writer.add_message(blobs[0], stamp + 2 * 10**6, image, stamp)
        for i in range(topics):
            writer.add_message(blobs[i], START_NS + i * 10_000, b"\0\1\0\0" + bytes(60), START_NS)
        writer.finish()


_WATCH = """
import os, sys
child = os.posix_spawn(sys.argv[2], sys.argv[2:], os.environ)
_, status, usage = os.wait4(child, 0)
with open(sys.argv[1], "w") as out:
    print(os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime, usage.ru_maxrss, file=out)
"""
"""A small process that begins the one to measure: a process counts what its parent had resident, too."""


def measured(source: Path, target: Path, *, pipe: bool = False) -> tuple[int, float, float, float]:
    """Corrupt a bag; return exit code, wall and CPU seconds, and largest resident memory in MB.

    pipe : whether the bag comes and goes through pipes, pumped by `cat`
    """
    begun = time.monotonic()
    names = ["-", "-", "--odom-topic", "/odom"] if pipe else [str(source), str(target)]
    words = [sys.executable, "-m", "odomcorrupt", *names, "--alpha", *["0.05", "0.02", "0.05", "0.01"], "--seed", "7"]
    noted = target.with_suffix(".noted")
    words = [sys.executable, "-I", "-S", "-c", _WATCH, str(noted), *words]
    if pipe:
        words = ["sh", "-c", f"cat {shlex.quote(str(source))} | {shlex.join(words)} | cat > {shlex.quote(str(target))}"]
    said = subprocess.run(words, stderr=subprocess.PIPE, check=False).stderr.decode()
    code, cpu, memory = noted.read_text().split()
    if int(code):
        print(f"  {said.strip()}", file=sys.stderr)
    return int(code), time.monotonic() - begun, float(cpu), int(memory) * 1.024e-3


def right(source: Path, target: Path) -> str:
    """Compare tables: all messages there, in their order, with their log times, lengths and topics."""
    sums = []
    for path in (source, target):
        count = check = 0
        with open_reader(path) as reader:
            for block in reader.blocks():
                table = block.table
                rank = np.zeros(1 + max(reader.channels), dtype=np.int64)
                rank[sorted(reader.channels, key=lambda number: reader.channels[number].topic)] = range(
                    len(reader.channels)
                )
                place = np.arange(count, count + len(table)) % 1009 + 1
                row = table["log_ns"] % 1_000_003 + 7 * table["length"] + 13 * rank[table["channel"]]
                check += int((place * row).sum())
                count += len(table)
        sums.append((count, check))
    return f"all {sums[0][0]} messages" if sums[0] == sums[1] else f"WRONG: {sums}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--gigabytes", type=float, default=10.0)
    parser.add_argument("--messages", type=int, default=10_000_000)
    parser.add_argument("--only", default="", help="cases whose name has this")
    parser.add_argument("--room", type=Path)
    given = parser.parse_args()
    n, tenth = given.messages, given.messages // 10
    images = int(given.gigabytes * 1e9 / 900_800)
    cases = {
        "no message": (".mcap", partial(bag, odometry=0)),
        "one message": (".mcap", partial(bag, odometry=1)),
        "10 000 topics": (".mcap", partial(bag, odometry=1000, topics=10_000)),
        **{
            f"{count:.0e} odometry messages, {kind}": (suffix, partial(LONG[suffix], count=count))
            for count in (tenth, n)
            for kind, suffix in (("MCAP", ".mcap"), ("ROS 1", ".bag"), ("sqlite3", ".db3"))
        },
        f"{given.gigabytes:g} GB": (".mcap", partial(bag, odometry=images, payload=900_000)),
    }
    print("| bag | MB | exit code | wall s | CPU s | memory MB | out |\n|---|---|---|---|---|---|---|")
    for name, (suffix, write) in cases.items():
        if given.only not in name:
            continue
        with tempfile.TemporaryDirectory(dir=given.room) as room:
            source, target = Path(room) / f"in{suffix}", Path(room) / f"out{suffix}"
            write(source)
            ways = (False, True) if "odometry" in name else (False,)
            for pipe in ways:
                code, wall, cpu, memory = measured(source, target, pipe=pipe)
                out = "none" if code else right(source, target)
                size = source.stat().st_size / 1e6
                said = f"{name}{', pipe' if pipe else ''}"
                print(f"| {said} | {size:.3g} | {code} | {wall:.1f} | {cpu:.1f} | {memory:.0f} | {out} |", flush=True)
                target.unlink(missing_ok=True)


if __name__ == "__main__":
    main()
