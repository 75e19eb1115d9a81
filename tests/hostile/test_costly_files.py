"""Models and maps that would cost minutes or gigabytes are refused before the work, in one short line."""

import time
from pathlib import Path

import numpy as np
import pytest

from odomcorrupt.cli import run
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.errors import ModelError
from odomcorrupt.model.motion_model import MotionModel, Noise, Step
from odomcorrupt.model.noise_laws import Coefficients

OFFICE = str(Path(__file__).parents[2] / "fixtures" / "office.mcap")
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


@pytest.fixture(autouse=True)
def at_once(_imported, tmp_path, monkeypatch, capsys):
    """Run in an empty folder, and require one line on stderr and three seconds of computing time at most."""
    monkeypatch.chdir(tmp_path)
    capsys.readouterr()
    begun = time.process_time()
    yield
    assert time.process_time() - begun < 3.0


@pytest.mark.parametrize("name", MODELS)
def test_a_model_is_refused_at_once(name, capsys):
    Path("m.toml").write_text(MODELS[name])
    assert run([OFFICE, "out.mcap", "--model", "m.toml"]) == 1
    said = capsys.readouterr().err
    assert said.startswith("odomcorrupt: m.toml: ")
    assert said.count("\n") == 1
    assert len(said) < 2500
    assert not Path("out.mcap").exists()


@pytest.mark.parametrize("name", MAPS)
def test_a_map_is_refused_at_once(name, capsys):
    yaml, image = MAPS[name]
    Path("m.yaml").write_text(yaml)
    with Path("p.pgm").open("wb") as file:
        file.write(image)
        if len(image) < 1000 and b"#" not in image:
            columns, rows = map(int, image.split()[1:3])
            file.truncate(len(image) + rows * columns)  # a hole, not on the disk
    assert run([OFFICE, "out.mcap", "--map", "m.yaml", "--map-pose", "0,0,0", "--seed", "1", "-q"]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert len(said) < 2500
    assert not Path("out.mcap").exists()


def test_a_path_of_millions_of_steps_is_an_error():
    noise = Noise("quadratic", Coefficients(0.1, 0.1, 0.1, 0.1), Step(0.001, 0.2))
    path = NoisyPath(MotionModel(noise), 1, 0, covariance=False)
    seconds = np.arange(4000)
    poses = np.column_stack((1.5 * seconds, 0 * seconds, 0 * seconds)).astype(float)
    with pytest.raises(ModelError, match="has 6e\\+06 of them; give a longer one"):
        path.feed(seconds * 1_000_000_000, poses)
