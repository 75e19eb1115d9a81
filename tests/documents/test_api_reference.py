"""Docstrings of the public names say what goes in and what comes out."""

import inspect
import re
import sys
from pathlib import Path

import pytest

import odomcorrupt
from odomcorrupt.api.bag_options import BagOptions
from odomcorrupt.api.findings import Findings
from odomcorrupt.api.result import Result

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
