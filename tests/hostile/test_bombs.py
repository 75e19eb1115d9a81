"""Small bags, models and maps that would cost gigabytes or minutes: one line, in bounded memory and time."""

import bz2
import io
import os
import sqlite3
import struct
import subprocess
import sys
import time
from contextlib import closing, redirect_stderr, redirect_stdout
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard

from odomcorrupt.bags.codecs import Packed, beginning
from odomcorrupt.bags.open import open_reader
from odomcorrupt.bags.source import VARIABLE, Budget, Source, limited, size_of
from odomcorrupt.cli import cli, run
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.errors import BagError, ModelError
from odomcorrupt.model.motion_model import MotionModel, Noise, Step
from odomcorrupt.model.noise_laws import Coefficients
from recordings import FIXTURES

MB = 1 << 20
MAGIC = b"\x89MCAP0\r\n"


def packed(opcode, *parts):
    return struct.pack("<BQ", opcode, sum(map(len, parts))) + b"".join(parts)


def string(text):
    return struct.pack("<I", len(text)) + text.encode()


def mcap_of(chunks, codec="zstd"):
    """Return an MCAP whose chunks hold these bytes, and say so."""
    pack = {"zstd": zstandard.compress, "lz4": lz4.frame.compress}[codec]
    out = [MAGIC, packed(1, string("ros2"), string("tests"))]
    for data in chunks:
        small = pack(data)
        head = struct.pack("<QQQI", 0, 0, len(data), 0) + string(codec) + struct.pack("<Q", len(small))
        out.append(packed(6, head, small))
    return b"".join([*out, packed(15, bytes(4)), packed(2, bytes(20)), MAGIC])


def fields(**values):
    return b"".join(struct.pack("<I", len(k) + 1 + len(v)) + k.encode() + b"=" + v for k, v in values.items())


def written(header, data):
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


HEAD = fields(conn=bytes(4), op=b"\x02", time=bytes(8))
CONNECTION = written(fields(conn=bytes(4), op=b"\x07", topic=b"/a"), fields(topic=b"/a", type=b"a/B", md5sum=b"*"))


def ros1_of(chunks):
    """Return a ROS 1 bag whose chunks hold these bytes, packed with bz2."""

    body = b""
    for data in chunks:
        header = fields(compression=b"bz2", op=b"\x05", size=struct.pack("<I", len(data)))
        body += written(header, bz2.compress(data))
    begin = b"#ROSBAG V2.0\n"
    for _ in range(2):
        at = struct.pack("<Q", len(begin) + len(body))
        head = fields(chunk_count=bytes(4), conn_count=bytes(4), index_pos=at, op=b"\x03")
        begin = b"#ROSBAG V2.0\n" + written(head, b" " * 100)
    return begin + body


def message(size):
    """Return a channel and a message of zeros: whole records."""
    channel = packed(4, struct.pack("<HH", 1, 0), string("/zeros"), string("json"), struct.pack("<I", 0))
    return channel + packed(5, struct.pack("<HIQQ", 1, 0, 1, 1), bytes(size))


def read(path, recover):
    with open_reader(path, recover=recover) as reader:
        for _ in reader.blocks():
            pass
        return reader.losses


BOMBS = {
    "one mcap chunk": lambda: mcap_of([message(12 * MB)]),
    "repeated mcap chunks": lambda: mcap_of([message(MB)] * 12),
    "repeated lz4 chunks": lambda: mcap_of([message(3 * MB)] * 8, "lz4"),
    "one bz2 chunk": lambda: ros1_of([bytes(12 * MB)]),
    "repeated bz2 chunks": lambda: ros1_of([CONNECTION + written(HEAD, bytes(2 * MB))] * 8),
}


@pytest.mark.parametrize("recover", [False, True])
@pytest.mark.parametrize("name", BOMBS)
def test_what_unpacks_to_more_than_its_budget_is_a_line(name, recover, tmp_path, monkeypatch):
    monkeypatch.setenv(VARIABLE, "8MB" if "lz4" not in name else "2MB")
    monkeypatch.setattr("odomcorrupt.bags.source._TIMES", 100)
    path = tmp_path / ("in.bag" if "bz2" in name else "in.mcap")
    path.write_bytes(BOMBS[name]())
    if recover:
        assert any("--max-unpacked" in loss for loss in read(path, recover))
        return
    with pytest.raises(BagError, match="ODOMCORRUPT_MAX_UNPACKED=1GiB allows it") as caught:
        read(path, recover)
    assert "\n" not in str(caught.value)


def test_the_allowance_can_be_lifted_and_a_wrong_one_is_reported(tmp_path, monkeypatch):
    path = tmp_path / "in.mcap"
    path.write_bytes(mcap_of([message(3 * MB)] * 3))
    monkeypatch.setenv(VARIABLE, "1MB")
    with pytest.raises(BagError, match="ODOMCORRUPT_MAX_UNPACKED"):
        read(path, recover=False)
    with limited(100 * MB):
        assert read(path, recover=False) == []
    assert os.environ[VARIABLE] == "1MB"
    for text in ("much", "inf", "nan", "", "0GiB", "-1GiB", "4", "1e3GiB"):
        monkeypatch.setenv(VARIABLE, text)
        with pytest.raises(BagError, match="write one such as 4GiB"):
            read(path, recover=False)


@pytest.mark.parametrize(
    ("text", "size"), [("4GiB", 4 << 30), ("1.5 gb", 3 << 29), ("2M", 2 << 20), ("7B", 7), ("1kib", 1024)]
)
def test_sizes_are_written_as_usual(text, size):
    assert size_of(text) == size


def test_every_command_that_reads_bags_takes_the_option_and_a_file_of_defaults_may_have_it(tmp_path, monkeypatch):
    monkeypatch.setattr("odomcorrupt.bags.source._DEFAULT", (1 << 30, 8 * MB))
    path = tmp_path / "in.mcap"
    path.write_bytes(mcap_of([message(20 * MB)]))
    monkeypatch.chdir(tmp_path)
    reading = [name for name in cli.list_commands(None) if "--max-unpacked" in options_of(name)]
    assert reading == [
        "assemble", "batch", "compare", "correct", "corrupt", "diagnose", "fit", "info", "integrate", "learn", "map",
        "preview", "sample", "score",
    ]  # fmt: skip
    assert "--max-unpacked 1GiB allows it" in said("info", "in.mcap")
    assert "no nav_msgs/Odometry" in said("info", "in.mcap", "--max-unpacked", "1GiB")
    (tmp_path / "mine.toml").write_text('max-unpacked = "200MB"\n')
    assert "no nav_msgs/Odometry" in said("info", "in.mcap", "--config", "mine.toml")
    assert "write one such as 4GiB" in said("info", "in.mcap", "--max-unpacked", "4")
    assert VARIABLE not in os.environ


def options_of(name):
    return [word for option in cli.get_command(None, name).params for word in option.opts]


def said(*words):
    err, out = io.StringIO(), io.StringIO()
    with redirect_stderr(err), redirect_stdout(out):
        run(words)
    return out.getvalue() + err.getvalue()


@pytest.mark.parametrize("codec", ["zstd", "bz2", "lz4"])
def test_the_beginning_of_a_cut_bomb_goes_as_far_as_the_budget(codec, monkeypatch):
    monkeypatch.setenv(VARIABLE, "8MB")
    pack = {"zstd": zstandard.compress, "bz2": bz2.compress, "lz4": lz4.frame.compress}[codec]
    whole = pack(bytes(24 * MB))

    def begun(data):
        return beginning(codec, Packed(Source(io.BytesIO(data), "bag"), len(data), "chunk"), Budget())

    for cut in (whole[: len(whole) // 2], whole[:-1], whole):
        assert sum(map(len, begun(cut))) <= 8 * MB + 1000 * len(cut)
    assert b"".join(begun(pack(bytes(range(256)) * 4096))) == bytes(range(256)) * 4096


ZEROS = {"zeros": b"\0" * 9, "private records": packed(0x80), "schemas": packed(0x7F)}


@pytest.mark.parametrize("recover", [False, True])
@pytest.mark.parametrize("name", ZEROS)
def test_a_chunk_of_a_million_empty_records_is_refused(name, recover, tmp_path, monkeypatch):
    for module in ("chunk", "reader"):
        monkeypatch.setattr(f"odomcorrupt.bags.mcap.{module}.MOST_RECORDS", 10_000)
    path = tmp_path / "in.mcap"
    path.write_bytes(mcap_of([ZEROS[name] * 200_000]))
    begun = time.process_time()
    if recover:
        assert read(path, recover)
    else:
        with pytest.raises(BagError, match="has opcode 0, or is one of more than"):
            read(path, recover)
    assert time.process_time() - begun < 5.0


def peak_mb(code, *words):
    """Return the memory that a program takes beyond what importing takes, MB."""
    program = (
        "import resource, sys; from odomcorrupt.bags.open import open_reader\nfrom pathlib import Path\n"
        "import odomcorrupt.bags.mcap.reader, odomcorrupt.bags.parts\n"
        "def peak(): return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024\nbefore = peak()\n"
        f"{code}\nprint(peak() - before)\n"
    )
    done = subprocess.run([sys.executable, "-c", program, *words], capture_output=True, text=True, check=True)
    return float(done.stdout.splitlines()[-1])


READ = """
with open_reader(Path(sys.argv[1])) as reader:
    for block in reader.blocks():
        pass
"""


@pytest.mark.slow
def test_a_large_chunk_is_in_memory_once(tmp_path, monkeypatch):
    path = tmp_path / "in.mcap"
    path.write_bytes(mcap_of([message(200 * MB)]))
    monkeypatch.setenv(VARIABLE, "1GiB")
    assert peak_mb(READ, str(path)) < 240


LARGE = {
    "zstd": (lambda: mcap_of([message(400 * MB)]), 70_000),
    "repeated zstd": (lambda: mcap_of([message(60 * MB)] * 7), 70_000),
    "bz2": (lambda: ros1_of([CONNECTION + written(HEAD, bytes(350 * MB))]), 1_000),
    "repeated bz2": (lambda: ros1_of([CONNECTION + written(HEAD, bytes(60 * MB))] * 4), 2_000),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "recover"), [("zstd", False), ("repeated zstd", True), ("bz2", True), ("repeated bz2", False)]
)
def test_a_few_kilobytes_never_take_300_megabytes(name, recover, tmp_path):
    make, size = LARGE[name]
    path = tmp_path / ("in.bag" if "bz2" in name else "in.mcap")
    path.write_bytes(make())
    assert path.stat().st_size < size
    words = [sys.executable, "-c", WHOLE, str(path), str(tmp_path / path.with_stem("out").name)]
    done = subprocess.run([*words, *["--recover"] * recover], capture_output=True, text=True, check=True)
    *lines, code, peak = done.stdout.splitlines()
    assert (int(code), lines) == (1, [])
    assert float(peak) < 300


WHOLE = r"""
import re, sys
from pathlib import Path
from odomcorrupt.cli import run
print(run([*sys.argv[1:], "--alpha", "0.1", "0.1", "0.1", "0.1", "--seed", "1"]))
# not what getrusage says: that includes the process this one was started by
print(int(re.search(r"VmHWM:\s*(\d+)", Path("/proc/self/status").read_text())[1]) / 1024)
"""


@pytest.mark.slow
def test_a_large_message_of_a_database_is_in_memory_once_or_not_at_all(tmp_path):
    path = tmp_path / "in.db3"
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("CREATE TABLE topics (id INTEGER PRIMARY KEY, name TEXT, type TEXT)")
        columns = "id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB"
        connection.execute(f"CREATE TABLE messages ({columns})")
        connection.execute("INSERT INTO topics VALUES (1, '/zeros', 'a/msg/B'), (2, '/other', 'a/msg/B')")
        connection.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (1, 1, zeroblob(?))", (200 * MB,))
        connection.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (2, 2, x'01')")
    assert peak_mb(READ, str(path)) < 240
    assert peak_mb(READ.replace("blocks()", "blocks({2})"), str(path)) < 40
    with open_reader(path) as reader:
        (block,) = reader.blocks({2})
        assert block.table["length"].tolist() == [0, 1]


OFFICE = str(FIXTURES / "office.mcap")
NOISE = "schema = 1\n[noise]\nrot_rot = 0\nrot_trans = 0\ntrans_trans = 0.1\ntrans_rot = 0\n"
LONG = "x" * 900_000


def effect(expression):
    return f'{NOISE}[[effect]]\nname = "u"\nk = 1\nexpression = "yaw += {expression}"\n'


MODELS = {
    "a key of 400 000 parts": ".".join("a" * 400_000) + " = 1\n" + NOISE,
    "a key of 100 000 quoted parts": "a = {" + '"b c".' * 100_000 + "d = 1}\n",
    "a table of 300 000 parts": "[" + ".".join("a" * 300_000) + "]\n",
    "brackets": "a = " + "[" * 500_000,
    "20 000 effects": NOISE + "[[effect]]\nname='slip_burst'\nrate=5.0\nslip=0.1\n" * 20_000,
    "10 000 expressions": NOISE
    + "".join(f"[[effect]]\nname='u{i}'\nexpression='yaw += k*v'\nk=0.1\n" for i in range(10_000)),
    "10 000 effects of the set-up": NOISE + "[[setup.effect]]\nname='clock_skew'\n" * 10_000,
    "steps of a nanometre": NOISE.replace("[noise]\n", '[noise]\nlaw = "quadratic"\nstep = "1e-9m"\n'),
    "steps of a nanoradian": NOISE.replace("[noise]\n", '[noise]\nlaw = "linear"\nstep = "1e-9rad"\n'),
    "nested signs": effect("~" * 900 + "v"), "nested attributes": effect("v" + ".a" * 480),
    "nested brackets": effect("(" * 450 + "v" + ")" * 450), "a power of powers": effect("k * v**9**9**9**9"),
    "a huge exponent": effect("k * v**-" + "9" * 900), "a long sum": effect("+".join(["k * v"] * 150)),
    "a long schema": f'schema = "{LONG}"\n', "a long name": f'{NOISE}[[effect]]\nname = "{LONG}"\n',
    "a long key": f"{NOISE}{LONG} = 1\n", "a long number": NOISE.replace("0.1", f'"{LONG}"'),
    "many signs": NOISE.replace("0.1", '"' + "1 +- " * 150_000 + '"'),
    "a large correlation": NOISE + f"[fit.correlation]\nparameters = ['a']\nmatrix = [{'[1],' * 100_000}]\n",
}  # fmt: skip

KEYS = "image: p.pgm\nresolution: {}\norigin: [-5, -5, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
SMALL = b"P5\n200 200\n255\n" + b"\xfe" * 40_000
MAPS = {
    "blanks in a name": ("image: x" + " " * 60_000 + "y\nresolution: 0.05\n", SMALL),
    "blanks before a comment": (KEYS.format(" " * 60_000 + "#") + "x", SMALL),
    "a resolution of nothing": (KEYS.format("1e-300"), SMALL),
    "a resolution of everything": (KEYS.format("1e300"), SMALL),
    "a resolution of many digits": (KEYS.format("1" * 60_000), SMALL),
    "an origin at the end of the world": (KEYS.format("0.05").replace("-5, -5", "1e300, 1e300"), SMALL),
    "an origin of many numbers": (KEYS.format("0.05").replace("-5, -5", "1," * 20_000), SMALL),
    "a header of many pixels": (KEYS.format("0.05"), b"P5\n999999999 999999999\n255\n" + b"\xfe" * 1000),
    "a file of many pixels": (KEYS.format("0.05"), b"P5\n90000 90000\n255\n"),
    "millimetres": (KEYS.format("0.001"), b"P5\n7000 7000\n255\n"),
    "comments": (KEYS.format("0.05"), b"P5\n" + b"#\n" * 2000 + b"200 200\n255\n"),
}


@pytest.fixture(scope="module")
def _imported():
    run(["info", OFFICE, "--json"])


@pytest.fixture
def at_once(_imported, tmp_path, monkeypatch, capsys):
    """Run in an empty folder, and require one line on stderr and three seconds of computing time at most."""
    monkeypatch.chdir(tmp_path)
    capsys.readouterr()
    begun = time.process_time()
    yield
    assert time.process_time() - begun < 3.0


@pytest.mark.usefixtures("at_once")
@pytest.mark.parametrize("name", MODELS)
def test_a_model_is_refused_at_once(name, invoke):
    Path("m.toml").write_text(MODELS[name])
    said = invoke([OFFICE, "out.mcap", "--model", "m.toml"], 1).err
    assert said.startswith("odomcorrupt: m.toml: ")
    assert said.count("\n") == 1
    assert len(said) < 2500
    assert not Path("out.mcap").exists()


@pytest.mark.usefixtures("at_once")
@pytest.mark.parametrize("name", MAPS)
def test_a_map_is_refused_at_once(name, invoke):
    yaml, image = MAPS[name]
    Path("m.yaml").write_text(yaml)
    with Path("p.pgm").open("wb") as file:
        file.write(image)
        if len(image) < 1000 and b"#" not in image:
            columns, rows = map(int, image.split()[1:3])
            file.truncate(len(image) + rows * columns)  # a hole, not on the disk
    said = invoke([OFFICE, "out.mcap", "--map", "m.yaml", "--map-pose", "0,0,0", "--seed", "1", "-q"], 1).err
    assert said.count("\n") == 1
    assert len(said) < 2500
    assert not Path("out.mcap").exists()


@pytest.mark.usefixtures("at_once")
def test_a_path_of_millions_of_steps_is_an_error():
    noise = Noise("quadratic", Coefficients(0.1, 0.1, 0.1, 0.1), Step(0.001, 0.2))
    path = NoisyPath(MotionModel(noise), 1, 0, covariance=False)
    seconds = np.arange(4000)
    poses = np.column_stack((1.5 * seconds, 0 * seconds, 0 * seconds)).astype(float)
    with pytest.raises(ModelError, match="has 6e\\+06 of them; give a longer one"):
        path.feed(seconds * 1_000_000_000, poses)
