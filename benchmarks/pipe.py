"""How much memory a long pipe takes: a camera's MCAP made on the fly, corrupted, thrown away.

    python benchmarks/pipe.py --gigabytes 10

    this script, as producer  |  odomcorrupt - - --odom-topic /odom  |  /dev/null

Prints the largest resident memory of `odomcorrupt` and its CPU seconds; the goal is at most 150 MB at any length.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys

from bag_messages import TOPICS, made, typestore
from mcap.writer import CompressionType, Writer

GOAL_MB = 150


class Counted:
    """A pipe that knows how much went into it: the mcap library asks."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self.position = 0

    def write(self, data: bytes) -> int:
        """Write all of it."""
        view = memoryview(data)
        while view:
            view = view[os.write(self._descriptor, view) :]
        self.position += len(data)
        return len(data)

    def tell(self) -> int:
        """Return the number of bytes written."""
        return self.position

    def flush(self) -> None:
        """Have nothing held back."""


def produce(size: int, codec: str) -> None:
    """Write an MCAP of about that many bytes to stdout."""
    store, sink = typestore(2), Counted(sys.stdout.fileno())
    writer = Writer(sink, compression=CompressionType[codec.upper()])  # type: ignore[arg-type]
    writer.start(profile="ros2", library="benchmark")
    channels = {}
    for topic, (msgtype, _) in TOPICS.items():
        text = store.generate_msgdef(msgtype, ros_version=2)[0]
        channels[topic] = writer.register_channel(
            topic, "cdr", writer.register_schema(msgtype, "ros2msg", text.encode())
        )
    for log_ns, topic, data in made(2, tuple(TOPICS), None):
        writer.add_message(channels[topic], log_ns, data, log_ns)
        if sink.position > size:
            break
    writer.finish()


def main() -> None:
    """Be the producer, or start one and measure its consumer."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--gigabytes", type=float, default=2.0)
    parser.add_argument("--codec", choices=("none", "lz4", "zstd"), default="none")
    parser.add_argument("--produce", action="store_true", help="write the stream to stdout, and measure nothing")
    given = parser.parse_args()
    if given.produce:
        produce(int(given.gigabytes * 1e9), given.codec)
        return
    made_by = [sys.executable, __file__, "--produce", "--gigabytes", str(given.gigabytes), "--codec", given.codec]
    producer = subprocess.Popen(made_by, stdout=subprocess.PIPE)
    ours = [sys.executable, "-m", "odomcorrupt", "-", "-", "--odom-topic", "/odom", "--seed", "1"]
    consumer = subprocess.Popen(ours, stdin=producer.stdout, stdout=subprocess.DEVNULL)
    if producer.stdout is not None:
        producer.stdout.close()
    _, status, usage = os.wait4(consumer.pid, 0)
    consumer.returncode = os.waitstatus_to_exitcode(status)
    producer.wait()
    if consumer.returncode or producer.returncode:
        sys.exit("the pipe broke")
    peak = usage.ru_maxrss / 1000 * 1.024
    print(
        f"{given.gigabytes:g} GB of {given.codec} on a pipe: {peak:.0f} MB at most (goal {GOAL_MB}), "
        f"{usage.ru_utime + usage.ru_stime:.1f} CPU s"
    )


if __name__ == "__main__":
    main()
