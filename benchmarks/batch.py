"""CPU, time and memory of batches: python benchmarks/batch.py [DIRECTORY FOR BAGS].

Twenty runs of a camera bag in every mode against twenty separate runs and twenty copies, and 1 to 1000 runs of a
small bag. CPU is user and system time of whole processes; memory the largest resident size of the process.
"""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer

import odomcorrupt

RUNS = 20
BASE = 1_700_000_000 * 10**9
ALPHA = ["--alpha", "0.05", "0.02", "0.05", "0.01", "--seed", "7"]


def odometry(stamp: int, x: float) -> bytes:
    """Return an Odometry in CDR."""
    head = b"\0\1\0\0" + struct.pack("<iI", stamp // 10**9, stamp % 10**9)
    head += struct.pack("<I", 5) + b"odom\0\0\0\0" + struct.pack("<I", 10) + b"base_link\0"
    return head + b"\0" * (4 - len(head)) + b"\0" * (-(len(head) - 4) % 8) + struct.pack(
        "<7d", x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0
    ) + b"\0" * 288 + struct.pack("<6d", 0.5, 0, 0, 0, 0, 0) + b"\0" * 288  # fmt: skip


def camera_bag(path: Path, seconds: int) -> None:
    """Write images at 30 Hz that do not compress, as JPEG, an IMU-sized topic at 200 Hz, and odometry at 50 Hz."""
    rng = np.random.default_rng(1)
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=1 << 20, compression=CompressionType.ZSTD)
        writer.start("ros2", "benchmark")
        ids = {}
        for topic, kind in (("/odom", "nav_msgs/msg/Odometry"), ("/camera", "sensor_msgs/msg/CompressedImage"),
                            ("/imu", "sensor_msgs/msg/Imu")):  # fmt: skip
            schema = writer.register_schema(kind, "ros2msg", b"")
            ids[topic] = writer.register_channel(topic, "cdr", schema)
        for tick in range(seconds * 600):
            t = BASE + tick * 10**9 // 600
            if tick % 12 == 0:
                writer.add_message(ids["/odom"], t, odometry(t, 0.5 * tick / 600), t)
            if tick % 20 == 0:
                writer.add_message(ids["/camera"], t, struct.pack("<Q", tick) + rng.bytes(75_000), t)
            if tick % 3 == 0:
                writer.add_message(ids["/imu"], t, struct.pack("<Q", tick) + rng.bytes(40) + b"\0" * 276, t)
        writer.finish()


def cost(words: list[str], cwd: Path) -> tuple[float, float, float]:
    """Run a command; return CPU seconds, wall seconds and its largest resident size in MB."""
    program = (
        "import resource, subprocess, sys, time; t = time.time(); subprocess.run(sys.argv[1:], check=True, "
        "stderr=subprocess.DEVNULL); r = resource.getrusage(resource.RUSAGE_CHILDREN); "
        "print(r.ru_utime + r.ru_stime, time.time() - t, r.ru_maxrss / 1024)"
    )
    env = os.environ | {"PYTHONPATH": str(Path(odomcorrupt.__file__).parent.parent)}
    done = subprocess.run(
        [sys.executable, "-c", program, *words], cwd=cwd, env=env, check=True, capture_output=True, text=True
    )
    cpu, wall, memory = map(float, done.stdout.split())
    return cpu, wall, memory


def size_of(directory: Path) -> float:
    """Return megabytes of the runs in a directory."""
    return sum(path.stat().st_size for path in directory.glob("run_*")) / 1e6


def main() -> None:
    """Measure and print."""
    own = [sys.executable, "-m", "odomcorrupt"]
    with tempfile.TemporaryDirectory(dir=sys.argv[1] if len(sys.argv) > 1 else None) as scratch:
        here = Path(scratch)
        camera_bag(here / "camera.mcap", 30)
        print(
            f"camera bag {(here / 'camera.mcap').stat().st_size / 1e6:.1f} MB, {RUNS} runs: CPU s, wall s, MB, peak MB"
        )
        one = [cost([*own, "camera.mcap", f"x{k}.mcap", *ALPHA, "--run", str(k)], here) for k in range(3)]
        separate = RUNS * sorted(one)[1][0]
        print(f"separate runs       {separate:7.2f}  (x {RUNS} of the median of 3)")
        copies = RUNS * cost(["cp", "camera.mcap", "copy.mcap"], here)[0]
        print(f"cp                  {copies:7.2f}")
        for name, more in (
            ("full", []),
            ("full, split", ["--layout", "split"]),
            ("overlay", ["--output", "overlay"]),
            ("trajectories", ["--output", "trajectories"]),
            ("full, 1 thread", ["--threads", "1"]),
            ("full, 2 processes", ["--jobs", "2", "--threads", "2"]),
        ):
            words = [*own, "batch", "camera.mcap", "runs", "--runs", str(RUNS), *ALPHA, *more]
            cpu, wall, memory = cost(words, here)
            print(
                f"{name:18}  {cpu:7.2f}  {cpu / separate:.3f} of separate  {wall:7.2f}  {size_of(here / 'runs'):8.1f}  "
                f"{memory:.0f}",
                flush=True,
            )
            shutil.rmtree(here / "runs")
        small = Path(__file__).parent.parent / "fixtures" / "office.mcap"
        print("small bag (office.mcap), full: runs, CPU s, wall s, peak MB")
        for runs in (1, 10, 100, 1000):
            cpu, wall, memory = cost([*own, "batch", str(small), "runs", "--runs", str(runs), *ALPHA], here)
            print(f"{runs:6} {cpu:8.2f} {wall:8.2f} {memory:6.0f}")
            shutil.rmtree(here / "runs")


if __name__ == "__main__":
    main()
