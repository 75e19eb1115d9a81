"""Docstrings of the public names say what goes in and what comes out."""

import inspect
import math
import re
import sys
from pathlib import Path

import pytest

import odomcorrupt
from odomcorrupt.api.bag_options import BagOptions
from odomcorrupt.api.findings import Findings
from odomcorrupt.api.result import Result
from odomcorrupt.errors import ModelError
from odomcorrupt.model.model_file import format_model, parse_model
from odomcorrupt.model.motion_model import Origin

PUBLIC = [name for name in odomcorrupt.__all__ if name != "__version__"]


def functions():
    """Return the public functions and methods by name, without those that `Result` describes."""
    described = set(vars(Result))
    for home in (*(getattr(odomcorrupt, name) for name in PUBLIC), Result, Findings):
        if inspect.isfunction(home):
            yield home.__name__, home
            continue
        for name, member in vars(home).items():
            plain = getattr(member, "__func__", member)
            if inspect.isfunction(plain) and not name.startswith("_") and (home is Result or name not in described):
                yield f"{home.__name__}.{name}", plain


FUNCTIONS = dict(functions())


@pytest.mark.parametrize("name", FUNCTIONS)
def test_docstrings_name_every_parameter_and_what_is_returned(name):
    text, signature = inspect.getdoc(FUNCTIONS[name]), inspect.signature(FUNCTIONS[name])
    taken = [one for one in signature.parameters.values() if one.name not in ("self", "cls")]
    named = {
        word for line in re.findall(r"^([*\w, ]+)(?: :|$)", text, re.MULTILINE) for word in re.findall(r"\w+", line)
    }
    assert [one.name for one in taken if one.name not in named] == []
    plain = "return " in text.splitlines()[0].lower() and ("." in name or not taken)  # enough for a method
    assert plain or signature.return_annotation in ("None", None) or "Returns\n-------" in text


def test_the_site_shows_compact_lines_of_docstrings_as_a_section():
    pytest.importorskip("griffe", reason='griffe reads docstrings; pip install ".[docs]" installs it')
    sys.path.append(str(Path(__file__).parents[2] / "docs"))
    from compact_docstrings import in_sections

    text = in_sections(inspect.getdoc(BagOptions), "Attributes")
    assert "Attributes\n----------\nodom_topic\n    odometry topic" in text
    named = {word for line in re.findall(r"^(\w[\w, ]*)$", text, re.MULTILINE) for word in line.split(", ")}
    assert set(BagOptions.__annotations__) <= named
    plain = inspect.getdoc(odomcorrupt.Model)
    assert in_sections(plain, "Parameters") == plain


ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "api.md").read_text()
BLOCKS = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


def plain(text):
    """Return a text without its numbers, whose last digits differ from machine to machine."""
    return re.sub(r"[-+]?\d[\d.e+-]*|\s+", " ", text)


@pytest.mark.slow
def test_every_example_of_the_page_runs(tmp_path, monkeypatch, capsys):
    (tmp_path / "fixtures").symlink_to(ROOT / "fixtures")
    monkeypatch.chdir(tmp_path)
    names = {}
    for block in BLOCKS:
        exec(compile(block, "docs/api.md", "exec"), names)  # noqa: S102 - the page is ours
    said = capsys.readouterr().out
    (printed,) = re.findall(r"^```text\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    assert plain(printed) in plain(said)
    shown, own = (re.findall(r"[\d.]+", text) for text in (printed, said[said.index("MISSING") :]))
    assert [*map(float, own[: len(shown)])] == pytest.approx([*map(float, shown)], rel=0.1)
    for name in ("noisy.mcap", "slipping.mcap", "robot.toml", "errors.png", "corrected.mcap", "secret.mcap"):
        assert (tmp_path / name).stat().st_size > 0
    assert len(repr(names["result"])) < 200
    assert len(repr(names["base"])) < 200


MODEL_PAGE = (Path(__file__).parents[2] / "docs" / "model-file.md").read_text(encoding="utf8")
(MODEL_EXAMPLE,) = re.findall(r"```toml\n(.*?)```", MODEL_PAGE, re.DOTALL)


def test_the_example_is_read():
    model = parse_model(MODEL_EXAMPLE)
    noise = model.noise.coefficients
    assert noise.rot_trans == pytest.approx(math.radians(0.2))
    assert noise.trans_rot == pytest.approx(0.0009)
    assert [effect.name for effect in model.effects] == ["wheelbase", "bumps", "flat_tyre"]
    assert model.track_m == pytest.approx(0.423)
    assert model.setup.origin == Origin(48.1, 11.5, 520.0)
    assert parse_model(format_model(model)).setup.origin == model.setup.origin


@pytest.mark.parametrize(
    ("origin", "complaint"),
    [
        ("{ latitude = 48.1 }", "longitude is missing"),
        ("{ latitude = 95, longitude = 1 }", "in degrees"),
        ("3", "table"),
    ],
)
def test_an_origin_that_is_no_place_is_refused(origin, complaint):
    with pytest.raises(ModelError, match=complaint):
        parse_model(re.sub(r"origin = \{.*?\}", f"origin = {origin}", MODEL_EXAMPLE))


def test_every_coefficient_of_the_example_is_in_the_table():
    table = set(re.findall(r"^\| `(\w+)` \|", MODEL_PAGE, re.MULTILINE))
    assert table == set(re.findall(r"^(\w+_(?:rot|trans|time)) = ", MODEL_EXAMPLE, re.MULTILINE))
