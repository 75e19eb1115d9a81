"""Other people's readers on what we write: `python tests/hostile/foreign.py`, a table of format, compression, layout.

Every reader that is installed opens every output it has a format for, counts messages by topic and decodes the first
odometry pose; both must be what was written. Readers that are not there are named. ROS 1 is Debian's python3-rosbag
(`rosbag play` also wants python3-roslaunch and python3-rostopic), the JavaScript ones are found by NODE_PATH.
"""

# ruff: noqa: T201 - a script that prints, and runs what it is for

import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).parent))

from smallbags import Small, make_small_bags

from odomcorrupt.bags.messages import gather, locate
from odomcorrupt.bags.open import open_reader

PROGRAMS = Path(__file__).parent / "readers"
DEBIAN = "/usr/bin/python3"
TYPED = ("--alpha", "0.05", "0.02", "0.05", "0.01", "--seed", "7")


class Output(NamedTuple):
    """A bag that we wrote: what it is, where, its storage ("ros1", "mcap", "sqlite3"), and whether in a directory."""

    name: str
    path: Path
    kind: str
    directory: bool = False


class Reader(NamedTuple):
    """A program of other people: how it is called, and which outputs it has a format for."""

    name: str
    words: tuple[str, ...]
    kinds: tuple[str, ...]
    directories: tuple[bool, ...] = (False, True)
    ros: tuple[int, ...] = (1, 2)


READERS = (
    Reader("Debian rosbag", (DEBIAN, str(PROGRAMS / "debian_rosbag.py")), ("ros1",)),
    Reader("rosbag check", (DEBIAN, str(PROGRAMS / "rosbag_check.py")), ("ros1",)),
    Reader("@foxglove/rosbag", ("node", str(PROGRAMS / "foxglove_rosbag.cjs")), ("ros1",)),
    Reader("@mcap/core", ("node", str(PROGRAMS / "mcap_core.cjs")), ("mcap",), (False,)),
    Reader("mcap", (sys.executable, str(PROGRAMS / "mcap_python.py")), ("mcap",), (False,)),
    Reader("rosbags", (sys.executable, str(PROGRAMS / "rosbags_any.py")), ("ros1", "mcap", "sqlite3"), ros=(2,)),
    Reader("evo", (sys.executable, str(PROGRAMS / "evo_read.py")), ("ros1", "mcap", "sqlite3"), ros=(2,)),
    Reader("sqlite3 integrity", (sys.executable, str(PROGRAMS / "sqlite_check.py")), ("sqlite3",)),
)


def ours(*words: str) -> None:
    subprocess.run([sys.executable, "-m", "odomcorrupt", *words], check=True, capture_output=True)


def write_outputs(room: Path) -> list[Output]:
    """Write every format in every compression and layout."""
    (room / "in").mkdir()
    (room / "out").mkdir()
    bags = make_small_bags(room / "in")
    outputs = []
    own = room / "in" / "debian.bag"
    if not missing(READERS[0]):
        words = [DEBIAN, str(PROGRAMS / "debian_write.py"), str(bags["ros1 lz4"].path), str(own)]
        subprocess.run(words, check=True, capture_output=True)
        bags["ros1 lz4"] = Small(own, 0)

    def add(name: str, source: str, target: str, kind: str, *more: str, directory: bool = False) -> None:
        path = room / "out" / target
        ours(str(bags[source].path), str(path), *TYPED, *more)
        outputs.append(Output(name, path, kind, directory))

    for codec in ("none", "lz4", "bz2"):
        add(f"ROS 1 {codec}", "ros1 lz4", f"{codec}.bag", "ros1", "--compression", codec)
    for codec in ("none", "lz4", "zstd"):
        add(f"MCAP {codec}", "mcap zstd", f"{codec}.mcap", "mcap", "--compression", codec)
        add(f"MCAP {codec}, of a ROS 1 bag", "ros1 lz4", f"ros1-{codec}.mcap", "mcap", "--compression", codec, "--ros",
            "1")  # fmt: skip
        add(f"MCAP {codec}, split, directory", "mcap directory", f"dir-{codec}", "mcap", "--compression", codec,
            directory=True)  # fmt: skip
    add("MCAP without chunks", "mcap unchunked", "unchunked.mcap", "mcap")
    add("MCAP of a sqlite3", "sqlite3 file", "sqlite3.mcap", "mcap")
    add("sqlite3 file", "sqlite3 file", "alone.db3", "sqlite3")
    add("sqlite3 directory", "sqlite3 directory", "sqlite3", "sqlite3", directory=True)
    for name, source, suffix, kind in (("ROS 1", "ros1 lz4", ".bag", "ros1"), ("MCAP", "mcap zstd", ".mcap", "mcap")):
        directory = room / "out" / f"batch-{kind}"
        ours("batch", str(bags[source].path), str(directory), "--runs", "1", "--layout", "split", *TYPED)
        (made,) = directory.glob(f"run_*{suffix}")
        outputs.append(Output(f"{name}, batch --layout split", made, kind))
    return outputs


def expected(output: Output) -> dict[str, object]:
    """Return what a reader must see: counts by topic, and the first odometry position."""
    counts: Counter[str] = Counter()
    first: tuple[int, list[float]] | None = None
    with open_reader(output.path) as reader:
        for block in reader.blocks():
            for number in block.table["channel"].tolist():
                counts[reader.channels[number].topic] += 1
            for channel in reader.channels.values():
                if channel.topic == "/odom":
                    for layout in locate(block, channel):
                        log_ns = int(block.table["log_ns"][layout.rows[0]])
                        if first is None or log_ns < first[0]:
                            first = log_ns, gather(block, layout, layout.items[0], "position")[0].tolist()
    return {"counts": dict(counts), "first": first[1] if first else None}


def opens(reader: Reader, output: Output) -> bool | None:
    """Tell whether a reader has a format for an output."""
    in_mcap = 1 if output.kind == "ros1" or "of a ROS 1 bag" in output.name else 2
    if reader.name == "evo" and not output.directory and output.kind != "ros1":
        return False  # evo opens directories
    fits = output.kind in reader.kinds and output.directory in reader.directories
    return fits and (output.kind == "ros1" or in_mcap in reader.ros)


def missing(reader: Reader) -> str:
    """Return why a reader cannot be asked, nothing where it can."""
    if shutil.which(reader.words[0]) is None:
        return f"no {reader.words[0]}"
    done = subprocess.run([*reader.words, "--there"], capture_output=True, check=False, env=environment())
    return "" if done.returncode == 0 else "not installed"


def environment() -> dict[str, str]:
    """Return the environment, with node modules beside the checkout."""
    beside = Path(__file__).parents[3] / "node" / "node_modules"
    paths = [os.environ.get("NODE_PATH", ""), str(beside) if beside.exists() else ""]
    return os.environ | {"NODE_PATH": os.pathsep.join(filter(None, paths)), "MPLBACKEND": "Agg"}


def asked(reader: Reader, output: Output) -> str:
    """Return what is wrong with what a reader sees, nothing where it sees all."""
    done = subprocess.run(
        [*reader.words, str(output.path)], capture_output=True, check=False, env=environment(), timeout=120
    )
    if done.returncode != 0:
        return f"fails: {done.stderr.decode().strip().splitlines()[-1:]}"
    seen, wanted = json.loads(done.stdout.decode().strip().splitlines()[-1]), expected(output)
    wrong = [
        f"{key} {seen[key]} for {wanted[key]}"
        for key in ("counts", "first")
        if key in seen and seen[key] != wanted[key]
    ]
    if "odometry" in seen and seen["odometry"] != wanted["counts"]["/odom"]:  # type: ignore[index]
        wrong.append(f"{seen['odometry']} poses")
    return "; ".join(wrong)


def heard(bag: Path, *listeners: list[str], beside: list[str] | None = None) -> list[Any] | None:
    """Play a bag to a real roscore; return what `readers/listener.py` says with each words, None without ROS.

    beside : words of a program that runs meanwhile
    """
    words = [DEBIAN, "-c", "import nav_msgs, rosbag, roslaunch, rosmaster, rospy, rostopic, tf2_ros"]
    if shutil.which(DEBIAN) is None or subprocess.run(words, capture_output=True, check=False).returncode:
        return None
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port = one.getsockname()[1]
    with tempfile.TemporaryDirectory() as home:
        env = os.environ | {
            "ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_HOSTNAME": "127.0.0.1", "ROS_HOME": home,
            "PATH": f"/usr/bin:{os.environ['PATH']}",
        }  # fmt: skip
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": env}
        core = subprocess.Popen(["/usr/bin/rosmaster", "--core", "-p", str(port)], **quiet)  # type: ignore[call-overload]
        try:
            time.sleep(2)
            other = subprocess.Popen(beside or ["true"], env=env)
            command = [DEBIAN, str(PROGRAMS / "listener.py")]
            nodes = [subprocess.Popen([*command, *words], stdout=subprocess.PIPE, env=env) for words in listeners]
            time.sleep(2)
            subprocess.run(["/usr/bin/rosbag", "play", "-q", "-d", "2", str(bag)], check=True, **quiet)  # type: ignore[call-overload]
            return [json.loads(node.communicate(timeout=30)[0]) for node in nodes]
        finally:
            for process in (other, core):
                process.terminate()
                process.wait()


def played(output: Output) -> str:
    """Play a bag to a real roscore; return what is wrong with what a subscriber hears, nothing where it hears all."""
    said, wanted = heard(output.path, []), expected(output)["counts"]["/odom"]  # type: ignore[index]
    if said is None:
        return "not installed"
    return "" if said[0]["count"] == wanted else f"{said[0]['count']} of {wanted} odometry messages heard"


def main() -> int:
    wrong = 0
    with tempfile.TemporaryDirectory() as room:
        outputs = write_outputs(Path(room))
        there = {reader.name: missing(reader) for reader in READERS}
        print("| output | " + " | ".join(reader.name for reader in READERS) + " | rosbag play |")
        print("|---" * (len(READERS) + 2) + "|")
        for output in outputs:
            cells = []
            for reader in READERS:
                said = there[reader.name] if opens(reader, output) else "-"
                if not said:
                    said = asked(reader, output) or "yes"
                    wrong += said != "yes"
                cells.append(said)
            said = (played(output) or "yes") if output.kind == "ros1" else "-"
            wrong += said not in ("yes", "-", "not installed")
            print(f"| {output.name} | " + " | ".join([*cells, said]) + " |", flush=True)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
