"""The examples and the notebook run, and print what they show."""

import json
import re
import shlex
import shutil
from functools import cache
from pathlib import Path

import click
import pytest

import odomcorrupt as oc
from odomcorrupt.batching.sinks import format_tum
from odomcorrupt.cli import cli, run
from odomcorrupt.model.model_file import parse_model
from odomcorrupt.model.motion_model import parse_alpha
from odomcorrupt.model.presets import PRESETS
from odomcorrupt.scoring.gate import parse_rule

ROOT = Path(__file__).parents[2]
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
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


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
        for page in PAGES
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


PAGE = ROOT / "docs" / "notebook.ipynb"
NOTEBOOK = json.loads(PAGE.read_text(encoding="utf8"))


def without_digits(text: str) -> str:
    """Return a text without its last digits, which differ from machine to machine: numbers keep two figures."""
    return re.sub(r"\d+\.\d+", lambda number: f"{float(number[0]):.2g}", text)


def test_stored_outputs_are_small_complete_and_free_of_the_machine():
    text = PAGE.read_text(encoding="utf8")
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

    stored = [without_digits(text) for text in texts(nbformat.read(PAGE, as_version=4))]
    assert [without_digits(text) for text in texts(execute())] == stored
    assert any("wheelbase" in text for text in stored)
