"""The documents: their commands, examples, tables, figures and notebook are those of the program, and run."""

import ast
import inspect
import json
import math
import os
import pydoc
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from dataclasses import fields
from functools import cache
from importlib.util import find_spec
from math import cos, sin
from pathlib import Path
from types import SimpleNamespace as Names
from unittest import TestCase

import click
import make_mistakes
import make_tutorial_laser
import numpy as np
import pytest
import yaml
from effects_page import library, on_page_markdown
from make_real_robots import overview
from make_tutorial import IMAGES, PAGE, play, sessions
from matplotlib.image import imread

import odomcorrupt
import odomcorrupt as oc
from odomcorrupt.api.bag_options import BagOptions
from odomcorrupt.api.findings import Findings
from odomcorrupt.api.result import Result
from odomcorrupt.batching.sinks import format_tum
from odomcorrupt.cli import cli, run
from odomcorrupt.effects import ground, registry, steering
from odomcorrupt.effects.wheels import TRACKS_M
from odomcorrupt.errors import ModelError
from odomcorrupt.model.model_file import format_model, parse_model
from odomcorrupt.model.motion_model import Origin, parse_alpha
from odomcorrupt.model.presets import PRESETS
from odomcorrupt.scoring.gate import parse_rule
from odomcorrupt.study.design.advise import FOUND
from odomcorrupt.study.design.drives import ENOUGH_NATS
from odomcorrupt.study.design.plan import MANOEUVRES
from odomcorrupt.study.estimate import config
from odomcorrupt.study.estimate.robust_errors import BLOCK_S
from odomcorrupt.study.select.contribution import FAR_M
from odomcorrupt.study.select.decisions import DECISIONS as D
from odomcorrupt.study.validate import round_trip
from odomcorrupt.study.validate.goodness_of_fit import PRACTICAL_FACTOR
from recordings import OFFICE, ROOT

DOCS = ROOT / "docs"
PAGES = sorted([*ROOT.glob("*.md"), *DOCS.rglob("*.md")])


def test_the_readme_is_at_most_a_hundred_lines_long():
    assert len((ROOT / "README.md").read_text(encoding="utf8").splitlines()) <= 100


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_relative_link_leads_to_a_file(page):
    links = re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text(encoding="utf8"))
    missing = [link for link in links if "://" not in link and not (page.parent / link).exists()]
    assert not missing


@pytest.mark.parametrize("page", ["glossary.md", "architecture.md"])
def test_every_module_and_room_that_is_named_exists(page):
    text = (DOCS / page).read_text(encoding="utf8")
    named = re.findall(r"`([a-z_]+(?:/[a-z_]+)*(?:/|\.py))`", text)
    assert len(named) > 10
    assert [name for name in named if not (ROOT / "odomcorrupt" / name).exists()] == []


@pytest.mark.parametrize("page", sorted(DOCS.rglob("*.md")), ids=lambda page: page.name)
def test_no_page_is_a_diary(page):
    months = "January|February|March|April|May|June|July|August|September|October|November|December"
    text = page.read_text(encoding="utf8")
    assert re.findall(rf"\b\d{{1,2}} (?:{months})\b(?! \d{{4}})|[Oo]n the page before", text) == []


def test_every_page_is_in_the_navigation_of_the_site():
    listed = set(re.findall(r"[\w/-]+\.(?:md|ipynb)", (ROOT / "mkdocs.yml").read_text(encoding="utf8")))
    assert {str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md")} <= listed


def test_the_python_reference_has_every_public_name():
    page = (DOCS / "api-reference.md").read_text(encoding="utf8")
    listed = re.findall(r"^::: (\S+)$", page, re.MULTILINE)
    public = {f"odomcorrupt.{name}" for name in odomcorrupt.__all__ if name != "__version__"}
    assert public <= set(listed)
    assert len(listed) == len(set(listed))
    # locate imports, and a public name may also be that of a folder that an earlier version left behind
    assert [name for name in listed if name not in public and pydoc.locate(name) is None] == []


def test_every_picture_is_shown_and_has_a_script_that_makes_it():
    texts = {page: page.read_text(encoding="utf8") for page in PAGES}
    shown = {name for text in texts.values() for name in re.findall(r"\]\((?:docs/|\.\./)?images/([\w.-]+)", text)}
    scripts = {path: path.read_text(encoding="utf8") for path in DOCS.glob("make_*.py")}
    images = {path.name for path in (DOCS / "images").iterdir()}
    assert shown == images
    assert [name for name in sorted(images) if not any(_makes(text, name) for text in scripts.values())] == []


def _makes(script: str, name: str) -> bool:
    """Return whether a script writes a picture of that name, or names of that beginning."""
    folder, _, rest = name.partition("_")
    return f'"{name}"' in script or (bool(rest) and f'f"{folder}_{{' in script)


def test_the_page_is_the_table():
    """Breaks where a row is changed and `python docs/make_mistakes.py` is not run."""
    assert make_mistakes.PAGE.read_text(encoding="utf8") == make_mistakes.page()


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
    from compact_docstrings import in_sections

    text = in_sections(inspect.getdoc(BagOptions), "Attributes")
    assert "Attributes\n----------\nodom_topic\n    odometry topic" in text
    named = {word for line in re.findall(r"^(\w[\w, ]*)$", text, re.MULTILINE) for word in line.split(", ")}
    assert set(BagOptions.__annotations__) <= named
    plain = inspect.getdoc(odomcorrupt.Model)
    assert in_sections(plain, "Parameters") == plain


API_PAGE = (DOCS / "api.md").read_text()
BLOCKS = re.findall(r"^```python\n(.*?)^```", API_PAGE, re.MULTILINE | re.DOTALL)


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
    (printed,) = re.findall(r"^```text\n(.*?)^```", API_PAGE, re.MULTILINE | re.DOTALL)
    assert plain(printed) in plain(said)
    shown, own = (re.findall(r"[\d.]+", text) for text in (printed, said[said.index("MISSING") :]))
    assert [*map(float, own[: len(shown)])] == pytest.approx([*map(float, shown)], rel=0.1)
    for name in ("noisy.mcap", "slipping.mcap", "robot.toml", "errors.png", "corrected.mcap", "secret.mcap"):
        assert (tmp_path / name).stat().st_size > 0
    assert len(repr(names["result"])) < 200
    assert len(repr(names["base"])) < 200


MODEL_PAGE = (DOCS / "model-file.md").read_text(encoding="utf8")
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


EFFECTS_PAGE = (DOCS / "effects.md").read_text(encoding="utf8")


def test_the_site_has_every_effect_before_the_definition():
    rows = re.findall(r"^\| `(\w+)` \|", library(), re.MULTILINE)
    assert sorted(rows) == sorted(registry())
    whole = on_page_markdown(EFFECTS_PAGE, page=Names(file=Names(src_uri="effects.md")))
    assert whole.index("## The library") < whole.index("## Definition")


def test_effects_with_a_heading_source_and_random_ones_are_those_of_the_code():
    part = EFFECTS_PAGE.split("## Where the heading comes from", 1)[1].split("therefore have a parameter", 1)[0]
    assert set(re.findall(r"`(\w+)`", part)) == {
        name for name, kind in registry().items() if any(field.name == "heading" for field in fields(kind))
    }
    part = EFFECTS_PAGE.split("## Randomness", 1)[1].split("Each states", 1)[0]
    assert set(re.findall(r"`(\w+)`", part)) == {name for name, kind in registry().items() if kind.kind == "noise"}
    part = EFFECTS_PAGE.split("## Events", 1)[1].split("An effect of your own", 1)[0]
    events = set(re.findall(r"^\| `(\w+)` \|", part, re.MULTILINE))
    assert events == {name for name, kind in registry().items() if kind.kind == "event"}


def test_every_exact_alias_is_stated():
    part = EFFECTS_PAGE.split("Some effects are exact aliases", 1)[1].split("No recording", 1)[0]
    for name, kind in registry().items():
        if kind.aliased_with is not None:
            assert f"`{name}` of `{kind.aliased_with}`" in part


def test_the_table_of_scans_has_the_values_of_the_code():
    rows = dict(
        re.findall(r"^\| ((?:`\w+`(?:, )?)+) \| (.+) \|$", EFFECTS_PAGE.split("## Amplitudes", 1)[1], re.MULTILINE)
    )
    kinds = registry()
    assert f"{len(kinds['slope'].scan(()))} directions" in rows["`slope`"]
    ways = [100.0 * effect.way for effect in kinds["castor_kick"].scan(())]
    assert f"{ways[0]:g}, {ways[1]:g} and {ways[2]:g} cm" in rows["`castor_kick`"]
    taus = [effect.tau for effect in kinds["complementary_filter"].scan(())]
    assert "{:g}, {:g}, {:g} and {:g} s".format(*taus) in rows["`complementary_filter`"]
    none, *taus = (effect.time_constant for effect in kinds["hard_iron"].scan(()))
    assert none == 0.0
    assert "{:g}, {:g} and {:g} s".format(*taus) in rows["`hard_iron`"]
    assert f"{TRACKS_M[0]:g} to {TRACKS_M[-1]:g} m" in rows["`backlash`, `accel_slip`"]
    degrees = [round(math.degrees(math.atan(tangent))) for tangent in (*steering._STEEP, *steering._STEEPER)]
    row = rows["`steering_scale`, `steering_offset`, `steering_play`"]
    assert f"takes {degrees[0]} or {degrees[1]} degrees" in row
    assert f"{degrees[2]} or {degrees[3]} degrees" in row
    assert f"{100 * ground._LEAST_SHARE:g} to {100 * ground._MOST_SHARE:g} % of the path" in rows["`region_slip`"]
    assert f"{ground._MOST_DISCS} at most" in rows["`region_slip`"]


NOISE = "schema = 1\n[noise]\nlaw = 'diffusion'\nrot_rot = 0.1\nrot_trans = 0.05\ntrans_trans = 0.1\ntrans_rot = 0\n"
LOCALISER = """
import shutil, sys
from pathlib import Path
import numpy as np
from odomcorrupt.batching.sinks import format_tum, read_tum
import odomcorrupt as oc
runs, estimates = map(Path, sys.argv[1:])
estimates.mkdir(exist_ok=True)
clean = read_tum(runs / "clean.tum")
for bag in sorted(runs.glob("run_*.mcap"))[len(list(Path().glob("crash"))):]:
    own = oc.read_estimate(bag, "/odom").trajectory
    (estimates / f"{bag.stem}.tum").write_bytes(format_tum(clean.stamps_ns, clean.xyt + 0.1 * (own.xyt - clean.xyt)))
"""


def test_the_workflow_passes_and_fails_as_its_steps_run_in_a_shell(tmp_path):
    workflow = yaml.safe_load((DOCS / "how-to" / "drift.yml").read_text())
    assert set(workflow) == {"name", True, "permissions", "env", "jobs"}  # YAML 1.1 reads `on` as true
    (job,) = workflow["jobs"].values()
    schema = ["check_jsonschema", "--builtin-schema", "vendor.github-workflows", DOCS / "how-to" / "drift.yml"]
    assert find_spec(schema[0]) is None or not subprocess.run([sys.executable, "-m", *schema], check=False).returncode
    steps = [step["run"].replace("/ground_truth", "/odom") for step in job["steps"] if "run" in step]
    shutil.copy(OFFICE, tmp_path / "drive.mcap")
    (tmp_path / "robot.toml").write_text(NOISE)
    (tmp_path / "localise.py").write_text(LOCALISER)
    (tmp_path / "localise_all.sh").write_text(f'#!/bin/sh\n{sys.executable} localise.py "$@"\n')
    (tmp_path / "localise_all.sh").chmod(0o755)
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    env = {**os.environ, "PATH": path, "RUNS": "8", "GITHUB_STEP_SUMMARY": "summary.md"}

    def shell(step):
        words = ["bash", "-e", "-o", "pipefail", "-c", step]  # as GitHub runs it
        return subprocess.run(words, cwd=tmp_path, env=env, capture_output=True, text=True, check=False)

    _, batch, localise, gate = steps
    base = re.sub(r"--baseline .*", "--save last.json", gate, flags=re.DOTALL)
    for step in (batch, localise, base, gate):
        done = shell(step)
        assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("PASSED")
    (tmp_path / "crash").touch()
    shutil.rmtree(tmp_path / "estimates")
    (tmp_path / "summary.md").write_text("")
    assert shell(localise).returncode == 0
    failed = shell(gate)
    assert failed.returncode == 1
    assert failed.stdout.startswith("FAILED")
    assert "run_000000, seed 7" in failed.stdout
    for file in ("summary.md", "drift.xml"):
        assert "run" in (tmp_path / file).read_text()
        assert "missing" in (tmp_path / file).read_text()


def test_the_test_of_replay_testing_judges_messages_of_a_recording(tmp_path, monkeypatch):
    """The names of replay_testing are those of its version 0.0.4; a stand-in calls the test as its runner does."""
    text = (DOCS / "how-to" / "replay_testing.md").read_text().replace('"/ground_truth"', '"/odom"')
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").mkdir()
    shutil.copy(OFFICE, tmp_path / "runs" / "run_000000.mcap")
    given = oc.read_estimate(OFFICE, "/odom").trajectory

    def messages(reader, topics):
        assert topics == ["/amcl_pose"]
        for stamp, (x, y, t) in zip(given.stamps_ns.tolist(), (given.xyt + reader).tolist(), strict=True):
            header = Names(stamp=Names(sec=stamp // 10**9, nanosec=stamp % 10**9))
            pose = Names(position=Names(x=x, y=y, z=0.0), orientation=Names(x=0.0, y=0.0, z=sin(t / 2), w=cos(t / 2)))
            yield "/amcl_pose", Names(header=header, pose=Names(pose=pose)), stamp

    decorators = Names(
        LocalFixture=lambda path: path, read_messages=messages, analyze=lambda cls: type("A", (cls, TestCase), {}),
        fixtures=Names(parameterize=lambda found: lambda cls: cls if found else None),
        run=Names(default=lambda: lambda cls: cls),
    )  # fmt: skip
    others = {"launch": Names(LaunchDescription=list), "launch_ros": Names(), "launch_ros.actions": Names(Node=dict)}
    for name, module in ({"replay_testing": decorators} | others).items():
        monkeypatch.setitem(sys.modules, name, module)
    space = {}
    exec(code, space)  # noqa: S102 - our own page
    assert space["Fixtures"].required_input_topics == ["/odom", "/scan", "/tf"]
    for offset_m, fine in ((0.1, True), (0.5, False)):
        test = space["Analyze"]("test_the_robot_is_found")
        test.reader = np.array([offset_m, 0.0, 0.0])
        assert test.run().wasSuccessful() is fine


JSON_PAGE = (DOCS / "json.md").read_text(encoding="utf8")


def keys_of(values):
    """Return the names of all keys, of lists of objects too."""
    if isinstance(values, dict):
        return set(values).union(*(keys_of(value) for value in values.values()))
    return set().union(*(keys_of(value) for value in values)) if isinstance(values, list) else set()


@pytest.mark.parametrize(("command", "more"), [("info", ()), ("preview", ("--runs", "2"))])
def test_the_page_names_the_keys(command, more, invoke):
    section = JSON_PAGE.split(f"## `{command} --json`", 1)[1].split("\n## ", 1)[0]
    table = [line for line in section.splitlines() if line.startswith("| `")]
    first = [re.findall(r"`([^`]+)`", line.split("|")[1]) for line in table]
    topics = re.findall(r"`(\w+)`", next((line for line in table if line.startswith("| `topics[]`")), ""))
    edges = re.findall(r"`(\w+)`", next((line for line in table if line.startswith("| `edges[]`")), ""))
    named = {code.split(".")[-1].removesuffix("[]") for codes in first for code in codes} | {*topics, *edges}
    values = json.loads(invoke([command, OFFICE, "--json", *more]).out)
    assert values["schema"] == 2
    assert keys_of(values) - {"schema"} == named


def printed(words, capsys):
    assert run([*words, "--json"]) == 0
    return json.loads("".join(capsys.readouterr()).split("\nwrote ", 1)[0])


def unnamed(values, heading):
    """Return the keys that a section of the page does not name; those below them that are names of topics stay out."""
    section = JSON_PAGE.split(f"## {heading}", 1)[1].split("\n## ", 1)[0]
    words = set(re.findall(r"`([^`]+)`", section))
    named = {part for word in words for part in re.split(r"\W+", word)}
    return {key for key in keys_of(values) if key not in named and key != "schema"}


COEFFICIENTS = {"rot_rot", "rot_trans", "trans_trans", "trans_rot", "across_trans"}


def test_the_page_names_the_keys_of_a_comparison(tmp_path, capsys):
    model = tmp_path / "typical.toml"
    run(["presets", "typical"])
    model.write_text(capsys.readouterr().out)
    values = printed(["compare", str(ROOT / "fixtures" / "mystery_other.mcap"), str(model)], capsys)
    assert unnamed(values, "`compare --json`") == set()


def test_the_page_names_the_keys_of_a_fit(tmp_path, capsys):
    words = ["fit", str(ROOT / "fixtures" / "mystery_other.mcap"), "-o", str(tmp_path / "robot.toml")]
    values = printed(words, capsys)
    assert unnamed(values, "`fit --json`") <= COEFFICIENTS


def test_the_page_names_the_keys_of_commands_that_write(tmp_path, capsys):
    values = printed([str(OFFICE), str(tmp_path / "noisy.mcap"), "--seed", "1"], capsys)
    heading = "Corruption, `correct`, `batch`"
    assert unnamed(values, heading) <= COEFFICIENTS | {"/odom", "odom -> base_link"}
    words = ["batch", str(OFFICE), str(tmp_path / "runs"), "--runs", "2", "--seed", "1", "--output", "trajectories"]
    assert unnamed(printed(words, capsys), heading) == set()
    words = ["simulate", str(tmp_path / "run.mcap"), "--seed", "1", "--duration", "30"]
    assert unnamed(printed(words, capsys), "Other commands") == set()


BENCHMARKS = ROOT / "benchmarks"
RUNS = BENCHMARKS / "laboratory" / "results"


@pytest.mark.parametrize(
    ("script", "words", "page"),
    [
        ("hidden_effects.py", ["summary", RUNS / "twentythird.jsonl", "--page"], "hidden_effects.md"),
        ("ordinary.py", ["page", BENCHMARKS / "ordinary" / "results" / "tenth.jsonl", "-o"], "ordinary.md"),
        ("optiodom.py", [BENCHMARKS / "optiodom.json", "--page"], "optiodom.md"),
    ],
)
def test_the_page_is_what_its_script_writes(script, words, page, tmp_path, monkeypatch):
    written = tmp_path / page
    monkeypatch.setattr(sys, "path", [str(BENCHMARKS), *sys.path])
    monkeypatch.setattr(sys, "argv", [script, *map(str, words), str(written)])
    runpy.run_path(str(BENCHMARKS / script), run_name="__main__")
    assert written.read_text(encoding="utf8") == (DOCS / page).read_text(encoding="utf8")


COMMANDS = re.findall(r"```sh\n(.*?)\n```", (DOCS / "pipelines.md").read_text(encoding="utf8"), re.DOTALL)


@pytest.fixture
def shell(tmp_path):
    """Run a command where the fixtures are and `odomcorrupt` is this one."""
    work = tmp_path / "work"
    work.mkdir()
    (work / "fixtures").symlink_to(ROOT / "fixtures")
    (tmp_path / "odomcorrupt").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m odomcorrupt "$@"\n')
    (tmp_path / "odomcorrupt").chmod(0o755)
    environment = os.environ | {"PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}

    def call(command):
        done = subprocess.run(["bash", "-c", command], cwd=work, env=environment, capture_output=True, check=False)
        return done.returncode, done.stderr.decode(), work

    return call


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    target = tmp_path_factory.mktemp("file") / "noisy.mcap"
    assert run([str(OFFICE), str(target), "--seed", "7"]) == 0
    return target.read_bytes()


def command(word):
    (found,) = [one for one in COMMANDS if word in one]
    return found


def test_cat_gives_the_bytes_that_a_file_has(shell, expected):
    code, said, work = shell(command("cat "))
    assert (code, said[:7]) == (0, "MOVED  ")
    assert (work / "noisy.mcap").read_bytes() == expected


@pytest.mark.skipif(shutil.which("zstd") is None, reason="no zstd installed")
def test_zstd_on_both_sides(shell, expected):
    code, _, work = shell(f"set -o pipefail; {command('zstd ')}")
    assert code == 0
    packed = subprocess.run(["zstd", "-dc", work / "noisy.mcap.zst"], capture_output=True, check=True)
    assert packed.stdout == expected


def test_a_consumer_that_closes_early_gets_no_complaint(shell, expected):
    code, said, work = shell(command("beginning.bin"))
    assert (code, said) == (0, "")
    assert (work / "beginning.bin").read_bytes() == expected[:1000]


def test_a_producer_that_dies_is_one_line_and_leaves_nothing(shell):
    code, said, work = shell(command("truncated.mcap"))
    assert code == 1
    assert said.startswith("odomcorrupt: stdin: ")
    assert said.count("\n") == 1
    assert [path.name for path in work.iterdir()] == ["fixtures"]


def test_the_line_for_shell_completion_defines_one(shell):
    page = (DOCS / "completion.md").read_text(encoding="utf8")
    code, said, _ = shell(re.findall(r"`(eval .*bash_source.*)`", page)[0] + " && complete -p odomcorrupt")
    assert (code, said) == (0, "")
    assert len(COMMANDS) == 4


ROBOTS_PAGE = (DOCS / "real_robots.md").read_text(encoding="utf8")


def texts(script: str) -> dict[str, str]:
    """Return the module's constants that are text, by name."""
    return {
        node.targets[0].id: node.value.value
        for node in ast.parse((DOCS / script).read_text(encoding="utf8")).body
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
    }


@pytest.mark.parametrize(
    ("script", "names"),
    [("independent_look.py", {"COMPARISON", "VERDICT"}), ("make_real_robots.py", {"INTRODUCTION", "COMMANDS"})],
)
def test_the_page_has_the_sentences_of_its_script(script, names):
    found = texts(script)
    assert names <= set(found)
    for name in names:
        assert found[name].strip() in ROBOTS_PAGE, name


def test_the_first_table_is_that_of_the_sections():
    lines = overview(ROBOTS_PAGE)
    assert len(lines) == 2 + 7
    assert "\n".join(lines) in ROBOTS_PAGE


TEXT = " ".join((DOCS / "study.md").read_text(encoding="utf8").split())
WORDS = {2: "two", 13: "thirteen"}


@pytest.mark.parametrize(
    "phrase",
    [
        f"**Intervals** are {config.INTERVAL_S:g} s long; {config._COARSE_INTERVAL_S:g} s if the truth",
        f"noisier than {config._COARSE_TRUTH_M * 1e3:g} mm; {config._BLIND_INTERVAL_S:g} s for positions only",
        f"each of every tenth segment of {BLOCK_S:g} s", f"A term costs {D.term_nats:g} nats,",
        f"plus {D.rare_nats:g} nats if it is none of",
        f"cost {D.commanded_nats:g} nats more, each word that is not the usual one {D.unusual_shape_nats:g} nats",
        f"a basis function {D.basis_nats:g} nats. A clock costs {D.clock_nats:g} nats",
        f"off by more than {1e3 * D.far_clock_s:g} ms", f"at least {D.clear_errors:g} standard errors over folds",
        f"evidence is at most {D.rival_nats:g} nats smaller",
        f"gains {D.correlated_nats:g} nats after its penalty beside", f"has to gain {D.mean_reverting_nats:g} nats",
        f"at most {WORDS[D.max_dependences]} in all",
        f"10 s error would grow by less than {100 * D.practical.share:g} %",
        f"error over {FAR_M:g} m of path by less than {100 * D.practical.far_share:g} %",
        f"or it moves less than {1e3 * D.practical.per_m:g} mm per metre",
        f"are {PRACTICAL_FACTOR:g} times larger or smaller than predicted",
        f"({round_trip.RUNS} runs if it has random effects", f"{WORDS[len(MANOEUVRES)]} manoeuvres",
        f"would give less than {ENOUGH_NATS:g} nats", f"Detection limits are {FOUND:g} standard errors",
    ],
)  # fmt: skip
def test_the_page_states_the_thresholds_of_the_code(phrase):
    assert phrase in TEXT


def words(line: str) -> str:
    """Return a line without its numbers, bars and gaps: the last digits differ from machine to machine."""
    return re.sub(r"(?:[-+]?\d[\d.e+-]*|#+|\s+)+", " ", line).strip()


def test_every_picture_of_the_page_is_there():
    pictures = re.findall(r"\]\((images/[^)]+)\)", PAGE.read_text(encoding="utf8"))
    assert len(pictures) == 4
    assert all((PAGE.parent / picture).stat().st_size > 10_000 for picture in pictures)


@pytest.mark.slow
def test_the_tutorial_runs_and_says_what_it_shows(tmp_path):
    for command, shown in sessions():
        answer = play(command, tmp_path)
        said = [words(line) for line in answer.splitlines()]
        for line in shown:
            assert any(words(line) in one for one in said), f"$ {command}\nshould say: {line}"
    # the last word of the page: one effect is left
    assert ", or " not in answer
    for name in ("rejected", "falls", "fan"):
        paths = IMAGES / f"tutorial_{name}.png", tmp_path / f"{name}.png"
        stored, drawn = (imread(path)[..., :3].mean(axis=2) for path in paths)  # grey values
        assert stored.shape == drawn.shape, f"tutorial_{name}.png is stale: run docs/make_tutorial.py"
        # last digits move lines by a pixel; another legend or another curve changes more
        assert np.mean(np.abs(stored - drawn) > 0.15) < 0.01, f"tutorial_{name}.png is stale: run docs/make_tutorial.py"


@pytest.mark.slow
def test_the_laser_tutorial_runs_and_says_what_it_shows(tmp_path):
    page = PAGE.with_name("tutorial-laser.md").read_text(encoding="utf8")
    make_tutorial_laser.write_bags(tmp_path)
    first, *others = re.findall(r"(?m)^(odomcorrupt .*)$", page)
    lines = ["set -e", first, f"{first} -v --force", "cp fixtures/office.mcap .", *others]
    said = play("\n".join(lines), tmp_path)
    assert all((tmp_path / name).exists() for name in ("falls.png", "map.yaml", "corrected.mcap", "noisy.mcap"))
    for line in "".join(re.findall(r"```text\n(.*?)```", page, re.DOTALL)).splitlines():
        assert "more line" in line or words(line) in words(said), line


FIXTURES = ROOT / "fixtures"
BAGS = {"in.bag": "office.bag", "sim.bag": "office.bag", "in.mcap": "office.mcap", "sim.mcap": "office.mcap",
        "run.mcap": "mystery.mcap", "other.mcap": "mystery_other.mcap"}  # fmt: skip
STUDIED = ("truths.md", "mistakes.md")
"""Pages on which drive.mcap and in.mcap are recordings with a truth."""
OWN_TESTS = ("tutorial.md", "tutorial-laser.md", "pipelines.md", "api.md")
FOREIGN = ("replay_testing.md", "pytest.md", "lambkin.md", "cluster.md")
"""Pages that have a test of their own, and pages whose Python is run by another program."""
LACKING = ("--scan ", "--returns", "--method laser", "/fix", "/tf:map.base", "--dask")
"""Parts of commands for recordings or computers that are not here: only their options are read."""
IMU = "{gyroscope_noise_density: 1e-3, accelerometer_noise_density: 1e-2, gyroscope_random_walk: 1e-4, \
accelerometer_random_walk: 1e-3, update_rate: 100.0}"
SHOWN = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def examples(page):
    """Yield language and text of the examples of a page in their order; commands one by one, in a line."""
    pattern = r"(?m)^```(\w+)\n((?:.*\n)*?)```$|^((?:    odomcorrupt .*\n(?:    .*\n)*))"
    for language, text, indented in re.findall(pattern, page.read_text(encoding="utf8")):
        if language in ("python", "toml"):
            yield language, text
        if language in ("sh", "console", "yaml") or indented:
            folded = re.sub(r" \\\n\s+", " ", text or indented)
            folded = re.sub(r"\n\s+(--)", r" \1", re.sub(r">-?\n\s+", "", folded))  # a folded text of YAML
            yield from (("sh", line) for line in re.findall(r"(?m)^\s*(?:\$ |- )?odomcorrupt (.*)$", folded))


def understood(line):
    """Read the options of a command without running it."""
    name, *words = shlex.split(line, comments=True)
    command = cli.get_command(click.Context(cli), name)
    if command is None:
        name, words = "corrupt", [name, *words]
        command = cli.get_command(click.Context(cli), name)
    context = command.make_context(name, words, parent=click.Context(cli, **cli.context_settings))
    for rule in context.params.get("rules") or ():
        parse_rule(rule)


def localise(bag_too):
    """Write estimates beside runs as TUM, or as bags with /amcl_pose."""
    shutil.rmtree("estimates", ignore_errors=True)
    Path("estimates").mkdir()
    for bag in sorted(Path("runs").glob("run_*.mcap")):
        own = oc.read_estimate(bag, "/odom").trajectory
        Path("estimates", f"{bag.stem}.tum").write_bytes(format_tum(own.stamps_ns, own.xyt))
        if bag_too:
            Path("estimates", f"{bag.stem}.tum").unlink()
            words = [str(bag), f"estimates/{bag.name}", "-q", "--preset", "typical", "--rename", "/odom=/amcl_pose"]
            assert run(words) == 0


def takes_long(page):
    study = re.compile(r"(learn|fit|compare) (?!.*(--scan|--returns|/fix|/tf:map))")
    return any(study.match(text) for _, text in examples(page))


@cache
def with_truth():
    """Write in.mcap with its odometry as the truth too, as drive.mcap; return its bytes."""
    assert run(["in.mcap", "drive.mcap", "-q", "--alpha", "0", "0", "0", "0", "--keep-truth", "/ground_truth"]) == 0
    return Path("drive.mcap").read_bytes()


def prepare(page):
    """Write the bags and files that the commands of a page name."""
    studied = {"drive.mcap": "mystery.mcap", "in.mcap": "mystery_other.mcap"} if page.name in STUDIED else {}
    for name, fixture in (BAGS | studied).items():
        shutil.copy(FIXTURES / fixture, name)
    if not studied:
        Path("drive.mcap").write_bytes(with_truth())
    Path("damaged.mcap").write_bytes(Path("in.mcap").read_bytes()[:200_000])
    Path("imu.yaml").write_text(IMU)
    if not re.search(r"(-o|>) robot.toml", page.read_text(encoding="utf8")):
        oc.Model.preset("turtlebot3-burger").save("robot.toml")


def paste(line, capsys):
    """Run a command, of fewer runs; into a file, if it says so."""
    words, _, target = line.split("  #")[0].partition(" > ")
    words = re.sub(r"--(runs|points) \d+", r"--\1 8", re.sub(r"--exclude-topic (/tf:|/amcl)\S+", "", words))
    if words.startswith("score"):
        localise("--estimate" in words)
    code = run(shlex.split(words))
    said = capsys.readouterr()
    assert code == 3 * ("--recover" in words), said.err
    if target:
        Path(target).write_text(said.out)


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=[pytest.mark.slow] * takes_long(page), id=page.stem)
        for page in SHOWN
        if page.name not in OWN_TESTS and list(examples(page))
    ],
)
def test_the_examples_of_the_page_run(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    prepare(page)
    names = {}
    for language, text in examples(page):
        if language == "sh":
            line = text.replace("$((SLURM_ARRAY_TASK_ID + 1))", "1")
            if any(part in line for part in LACKING):
                understood(line)
            else:
                paste(line, capsys)
        elif language == "toml":
            Path("odomcorrupt.toml").write_text(text) if page.stem == "configuration" else parse_model(text)
        elif page.name not in FOREIGN:
            exec(compile(text, page.name, "exec"), names)  # noqa: S102 - our own page


def test_every_option_number_and_preset_of_the_text_on_corruption_is_understood():
    page = (ROOT / "docs" / "corrupt.md").read_text(encoding="utf8").split("## How the correction works", 1)[0]
    prose = re.sub(r"```.*?```", "", page, flags=re.DOTALL)
    code = re.findall(r"`([^`]+)`", prose)
    assert {name for name in PRESETS if f"`{name}`" in prose or f"--preset {name}`" in prose} == set(PRESETS)
    known = {name for option in cli.get_command(click.Context(cli), "corrupt").params for name in option.opts}
    known |= {"--json"}
    named = {word for one in code for word in re.findall(r"--[a-z-]+", one)}
    assert named >= {"--law", "--step", "--effect", "--model", "--run", "--preset", "--covariance", "--twist"}
    assert named <= known
    degrees = [one for one in code if re.fullmatch(r"\d+deg(/m)?", one)]
    assert [parse_alpha(one) for one in degrees] == pytest.approx([0.0872664626, 0.174532925])


NOTEBOOK_PAGE = ROOT / "docs" / "notebook.ipynb"
NOTEBOOK = json.loads(NOTEBOOK_PAGE.read_text(encoding="utf8"))


def without_digits(text: str) -> str:
    """Return a text without its last digits, which differ from machine to machine: numbers keep two figures."""
    return re.sub(r"\d+\.\d+", lambda number: f"{float(number[0]):.2g}", text)


def test_stored_outputs_are_small_complete_and_free_of_the_machine():
    text = NOTEBOOK_PAGE.read_text(encoding="utf8")
    assert len(text) < 120_000
    assert str(ROOT) not in text
    assert "/tmp" not in text  # noqa: S108 - looked for, not written to
    cells = [cell for cell in NOTEBOOK["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    assert sum("image/png" in output.get("data", {}) for cell in cells for output in cell["outputs"]) == 2


@pytest.mark.slow
def test_the_notebook_runs_and_prints_what_is_stored():
    pytest.importorskip("ipykernel", reason='no Jupyter kernel; pip install ".[docs]" installs one')
    nbformat = pytest.importorskip("nbformat", reason='nbformat reads notebooks; pip install ".[docs]" installs it')
    pytest.importorskip("nbclient", reason='nbclient executes notebooks; pip install ".[docs]" installs it')
    from make_notebook import execute, texts

    stored = [without_digits(text) for text in texts(nbformat.read(NOTEBOOK_PAGE, as_version=4))]
    assert [without_digits(text) for text in texts(execute())] == stored
    assert any("wheelbase" in text for text in stored)
