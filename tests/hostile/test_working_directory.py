"""The working directory, and models and maps of strangers, run no code and open or set only what they may."""

import importlib
import os
import subprocess
import sys

import click
import pytest
from texts import MODEL, PGM, YAML

from odomcorrupt.cli import run
from odomcorrupt.commands._options import Setting
from odomcorrupt.commands._standard import command_names
from odomcorrupt.errors import MapError, OdomCorruptError
from odomcorrupt.mapping.occupancy_grid import read_map
from odomcorrupt.model.model_file import read_model
from recordings import FIXTURES

OFFICE = str(FIXTURES / "office.mcap")
MARK = "open({!r}, 'w').close()\n"
COMMANDS = {name: importlib.import_module(module).command for name, module in command_names().items()}
SETTINGS = {
    "add", "alpha", "law", "twist-noise", "step", "preset", "effect", "track", "seed", "odom-topic", "odom",
    "odom-frame", "base-frame", "map-pose", "robot-radius", "truth", "truth-shift", "scan", "laser-scale-accuracy",
    "imu", "gyro-scale-accuracy", "joints", "drive-type", "laser-pose", "max-yaw-rate", "estimate",
    "scan-noise", "scan-keep", "scan-every",
}  # fmt: skip


def options():
    """Yield (command, long name without dashes, option) of all options that a file could name."""
    for name, command in COMMANDS.items():
        for option in command.params:
            if isinstance(option, click.Option) and option.expose_value:
                yield from ((name, word[2:], option) for word in option.opts if word.startswith("--"))


REFUSED = [(name, word) for name, word, option in options() if not isinstance(option, Setting)]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "evil.py").write_text(MARK.format("RAN"))
    return tmp_path


def test_the_options_that_a_found_file_may_set_are_these():
    assert {word for _, word, option in options() if isinstance(option, Setting)} == SETTINGS
    for _, _, option in options():
        assert not (isinstance(option, Setting) and (option.is_flag or isinstance(option.type, click.Path)))


@pytest.mark.parametrize("table", ["", "[{}]\n"], ids=["top level", "own table"])
def test_any_other_option_in_a_found_file_is_an_error_that_names_the_key_and_the_way_out(folder, invoke, table):
    assert len(REFUSED) > 200
    for name, word in REFUSED:
        (folder / "odomcorrupt.toml").write_text(f"{table.format(name)}{word.replace('-', '_')} = 1\n")
        # without its arguments, the command would fail later
        said = invoke([name, "x"], 2).err
        assert word.replace("-", "_") in said
        assert "--config odomcorrupt.toml" in said
        assert said.count("\n") == 1


def test_a_file_given_by_hand_sets_any_option(folder):
    (folder / "mine.toml").write_text("force = true\nthreads = 1\n")
    (folder / "old.mcap").write_bytes(b"old")
    assert run([OFFICE, "old.mcap", "-q", "--seed", "1", "--config", "mine.toml"]) == 0
    assert (folder / "old.mcap").read_bytes() != b"old"


@pytest.mark.parametrize("given", [[], ["--config", "odomcorrupt.toml"]], ids=["found", "by hand"])
@pytest.mark.parametrize(
    "words",
    [
        [OFFICE, "out.mcap"], ["preview", OFFICE], ["batch", OFFICE, "runs", "--runs", "2"],
        ["correct", OFFICE, "out.mcap"], ["sample", OFFICE], ["density"], ["map", OFFICE],
    ],
    ids=lambda words: words[0].rpartition("/")[2],
)  # fmt: skip
def test_no_file_of_defaults_names_code(folder, invoke, words, given):
    (folder / "odomcorrupt.toml").write_text('effect = ["wheel_scale:e=0.01", "evil.Wobble:k=1"]\n')
    assert "evil.Wobble:k=1: names code" in invoke([*words, *given], 2).err
    assert sorted(path.name for path in folder.iterdir()) == ["evil.py", "odomcorrupt.toml"]


def test_effects_of_the_library_may_be_set(folder, capsys):
    (folder / "odomcorrupt.toml").write_text('effect = ["wheel_scale:e=0.01"]\n')
    assert run([OFFICE, "out.mcap", "-q", "--seed", "1"]) == 0
    # said although quiet: whoever stands in the folder may not know of the file
    assert capsys.readouterr().err == "defaults from odomcorrupt.toml: effects\n"


def replaced_modules(folder):
    """Write a folder that replaces modules and announces a plug-in, each of which leaves a file when it runs."""
    for name in ("click", "numpy", "typing", "signal", "rosbags", "multiprocessing", "concurrent", "lz4", "sitecustom"):
        (folder / f"{name}.py").write_text(MARK.format(f"RAN {name}"))
    info = folder / "evil-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: evil\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[odomcorrupt.effects]\nevil = evil:Wobble\n")


@pytest.mark.parametrize("path", [None, ":/nowhere", "/nowhere:"], ids=["unset", "begins empty", "ends empty"])
def test_modules_of_the_folder_replace_none_of_the_program(folder, path):
    replaced_modules(folder)
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    environment |= {} if path is None else {"PYTHONPATH": path}
    start = [sys.executable, "-m", "odomcorrupt"]
    if path is not None:  # only what is imported after the start of Python is ours to protect
        (folder / "typing.py").unlink()
        (folder / "signal.py").unlink()
    for words in (
        ["effects"],
        f"batch {OFFICE} runs --runs 4 --jobs 2 --seed 1 --output trajectories --effect wheel_scale".split(),
    ):
        done = subprocess.run([*start, *words], capture_output=True, text=True, check=False, env=environment)
        assert done.returncode == 0, done.stderr
    assert list(folder.glob("RAN*")) == []


def test_a_matplotlibrc_of_the_folder_changes_no_picture(folder):
    words = ["preview", OFFICE, "--runs", "3", "--seed", "1", "-o", "fan.png", "--overwrite"]
    pictures = []
    for text in ("", "font.size: 30\ntext.usetex: True\nfigure.facecolor: red\n"):
        (folder / "matplotlibrc").write_text(text)
        subprocess.run([sys.executable, "-m", "odomcorrupt", *words], capture_output=True, check=True, timeout=60)
        pictures.append((folder / "fan.png").read_bytes())
    assert pictures[0] == pictures[1]


WATCHED = (
    "open", "exec", "subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "socket.connect", "ctypes.dlopen",
)  # fmt: skip
SEEN: list[tuple[str, str]] | None = None


def _hook(event, args):
    if SEEN is not None and event in WATCHED:
        SEEN.append((event, str(args[0]) if args else ""))


sys.addaudithook(_hook)


@pytest.fixture
def watched():
    """Return what is opened and run from here on."""
    global SEEN  # noqa: PLW0603 - a hook cannot be taken away again
    SEEN = []
    yield SEEN
    SEEN = None


EXPRESSIONS = (
    "yaw += __import__('os').system('id')", "yaw += open('/etc/passwd')", "yaw += (1).__class__.__mro__",
    "yaw += exec('1')", "yaw += [x for x in (1,)]", "yaw += (lambda: 1)()", "yaw += v.__class__", "import os",
    "yaw += 9 ** 9 ** 9 ** 9", "yaw += " + "(" * 300 + "v" + ")" * 300, "yaw += f'{v}'", "yaw := v",
    "yaw += v if v else v()",
)  # fmt: skip


@pytest.mark.parametrize("expression", EXPRESSIONS)
def test_no_expression_runs_code(expression, tmp_path, watched):
    path = tmp_path / "robot.toml"
    text = MODEL.decode().replace("yaw += k * v * abs(omega)", expression)
    path.write_bytes(text.encode())
    (tmp_path / "sound.toml").write_bytes(MODEL)
    read_model(tmp_path / "sound.toml")  # imports what it needs
    watched.clear()
    with pytest.raises(OdomCorruptError):
        read_model(path)
    # where text is no Python at all, the interpreter looks for a line of it in a file of this name
    assert set(watched) <= {("open", str(path)), ("open", "<unknown>")}


def test_what_a_model_names_is_not_opened(tmp_path, watched):
    path = tmp_path / "robot.toml"
    path.write_bytes(MODEL.replace(b'recordings = ["run.mcap"]', b'recordings = ["/etc/passwd", "../run.mcap"]'))
    read_model(path)
    watched.clear()
    read_model(path)
    assert set(watched) == {("open", str(path))}


@pytest.mark.parametrize("image", ["/etc/passwd", "../secret.pgm", "inner/../../secret.pgm", "link.pgm", "/dev/zero"])
def test_a_map_opens_no_image_outside_of_its_directory(image, tmp_path, watched):
    (tmp_path / "map" / "inner").mkdir(parents=True)
    (tmp_path / "secret.pgm").write_bytes(PGM)
    (tmp_path / "map" / "link.pgm").symlink_to(tmp_path / "secret.pgm")
    path = tmp_path / "map" / "map.yaml"
    path.write_bytes(YAML.replace(b"map.pgm", image.encode()))
    watched.clear()
    with pytest.raises(MapError, match="outside of the map's directory"):
        read_map(path)
    assert set(watched) == {("open", str(path))}


def test_an_image_below_the_maps_directory_is_read(tmp_path):
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / "room.pgm").write_bytes(PGM)
    (tmp_path / "map.yaml").write_bytes(YAML.replace(b"map.pgm", b"images/room.pgm"))
    assert read_map(tmp_path / "map.yaml").cells.shape == (30, 40)
