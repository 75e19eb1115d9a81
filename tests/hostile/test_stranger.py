"""A stranger's model file or map runs no code and opens no file that it was not given."""

import sys

import pytest
from texts import MODEL, PGM, YAML

from odomcorrupt.errors import MapError, OdomCorruptError
from odomcorrupt.mapping.occupancy_grid import read_map
from odomcorrupt.model.model_file import read_model

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
