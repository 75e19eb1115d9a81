"""Hostile model files, maps and trajectories: damaged bytes, and numbers that no robot has."""

import re
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
from mutations import mutated
from trials import FoundError, command, judged

from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.errors import OdomCorruptError
from odomcorrupt.mapping.occupancy_grid import read_map
from odomcorrupt.model.model_file import format_model, parse_model, read_model
from odomcorrupt.study.io.text import is_text, read_text

MODEL = b"""# a robot
schema = 1

[noise]
law = "diffusion"
across_trans = 0.001
rot_rot = { value = 0.05, standard_error = 0.001, unit = "rad per sqrt(rad)" }
rot_trans = 0.02
trans_trans = "0.05 +- 0.01"
trans_rot = 0.01

[[effect]]
name = "unequal_wheels"
curvature = 0.005

[[effect]]
name = "drag"
expression = "yaw += k * v * abs(omega); along += -c * where(a > 0, a, 0) ** 2"
k = 0.01
c = { value = 0.02, unit = "s" }

[robot]
track = 0.34
wheel_radius = 0.076

[setup]
truth_xy = 0.001

[[setup.effect]]
name = "lever_arm"
x = 0.1
y = -0.02

[[setup.clock]]
recording = "run.mcap"
time_offset = 0.02

[source]
recordings = ["run.mcap"]
"""
YAML = b"""image: map.pgm
mode: trinary
resolution: 0.05
origin: [-1.0, -2.0, 0.1]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""
PGM = b"P5\n# a room\n40 30\n255\n" + bytes([254, 0, 205] * 400)
_STEPS = range(60)
CSV = b"time [s],x [m],y [m],yaw_deg\n" + b"".join(b"%.2f,%.3f,0.0,%.2f\n" % (0.1 * i, 0.01 * i, i) for i in _STEPS)
_POSES = [(0.1 * i, 0.01 * i, 0.001 * i) for i in _STEPS]
TUM = b"# stamp x y z qx qy qz qw\n" + b"".join(b"%.2f %.3f 0 0 0 0 %.3f 1\n" % pose for pose in _POSES)
TEXTS = {"model file": MODEL, "map .yaml": YAML, "map .pgm": PGM, "CSV": CSV, "TUM": TUM}
WORDS = (
    b"nan", b"inf", b"-inf", b"1e999", b"-1e308", b"1e308", b"1e-320", b"0", b"-1", b"1" * 400, b"9" * 4400,
    b"0x1p1023", b"true", b'"a"', b"[]", b"{}", b"[[1]]", b"''", b"1e18", b"-1e19", b"18446744073709551616",
    b"9**9**9", b"1979-05-27", b"__import__('os')", b"/etc/passwd", b"../../etc/passwd", b"/dev/zero",
    b"\xef\xbb\xbf", b"\0", b"\xff\xfe", b"(" * 300, b"0.004 +- 0.001", b"-0.0", b"1_000", b"\xd9\xa3",
    b"!!python/object:os.system", b"*a", b"&a",
)  # fmt: skip
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?|\"[^\"]*\"|[a-z_]+")
_VALUE = re.compile(rb"(?<=[=,: \[])-?\d+(?:\.\d+)?(?=[\s,}\]])")


class TextTrial:
    """Tries texts in a directory of its own."""

    def __init__(self, room: Path) -> None:
        self.room = Path(tempfile.mkdtemp(dir=room))
        self.outcomes: Counter[str] = Counter()

    def run(self, kind: str, rng: np.random.Generator) -> None:
        """Damage a text of a kind, read it, and use what was read."""
        data = TEXTS[kind]
        for _ in range(int(rng.integers(1, 4))):
            data = _worded(data, rng) if rng.random() < 0.6 else mutated(data, CSV + MODEL + PGM, rng)[1]
        self.use(kind, data, rng)

    def use(self, kind: str, data: bytes, rng: np.random.Generator) -> bool:
        """Read a text of a kind and use what was read; return whether it was refused."""
        if kind == "model file":
            got = judged(self._model, data, rng)
        elif kind.startswith("map"):
            got = judged(self._map, data, kind)
        else:
            got = judged(self._trajectory, data, rng)
        self.outcomes[f"{kind} {'refused' if isinstance(got, OdomCorruptError) else 'done'}"] += 1
        return isinstance(got, OdomCorruptError)

    def _model(self, data: bytes, rng: np.random.Generator) -> None:
        path = self.room / "robot.toml"
        path.write_bytes(data)
        model = read_model(path)
        again = parse_model(format_model(model))
        if format_model(again) != format_model(model):
            raise FoundError(f"written and read again it is another model: {model}")
        # what was accepted is driven by
        stamps = np.arange(40, dtype=np.int64) * 20_000_000
        xyt = np.cumsum(np.abs(rng.normal(0, 0.01, (40, 3))), axis=0)
        out = NoisyPath(model, 1).feed(stamps, xyt)
        if not np.isfinite(out.error_xyt).all():
            raise FoundError("a model that was accepted makes poses that are no numbers")

    def _map(self, data: bytes, kind: str) -> None:
        (self.room / "map.yaml").write_bytes(data if kind == "map .yaml" else YAML)
        (self.room / "map.pgm").write_bytes(PGM if kind == "map .yaml" else data)
        grid = read_map(self.room / "map.yaml")
        if grid.cells.shape != (30, 40) and kind == "map .yaml":
            raise FoundError("another image was read")

    def _trajectory(self, data: bytes, rng: np.random.Generator) -> None:
        path = self.room / "run.csv"
        path.write_bytes(data)
        if is_text(path):
            samples = read_text(path, path.name)
            if not len(samples.stamps_ns) == len(samples.xyz) == len(samples.yaw_rad):
                raise FoundError("columns of unequal length")
        if rng.random() < 0.05:
            (self.room / "truth.tum").write_bytes(TUM)
            command("fit", str(path), "--truth-bag", str(self.room / "truth.tum"))


def _worded(data: bytes, rng: np.random.Generator) -> bytes:
    """Put a word no robot has in the place of a number, a string or a name."""
    pattern = _VALUE if rng.random() < 0.7 else _NUMBER
    places = list(pattern.finditer(data[:20_000]))
    if not places:
        return data
    place = places[int(rng.integers(len(places)))]
    return data[: place.start()] + WORDS[int(rng.integers(len(WORDS)))] + data[place.end() :]
