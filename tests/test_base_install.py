"""Imports: what works without the libraries of the study, and the order of packages."""

import ast
import re
import subprocess
import sys
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

from recordings import ROOT
from test_refusals import ROBOT as NOISE

OFFICE = str(ROOT / "fixtures" / "office.mcap")
BARE = """
import sys
for library in ("scipy", "matplotlib", "pandas"):
    sys.modules[library] = None
from odomcorrupt.cli import run
print([run(words.split()) for words in sys.argv[1:]])
"""
COMMANDS = (
    f"{OFFICE} out.mcap --effect gyro_dead_band --effect slip_burst --seed 1",
    f"{OFFICE} modelled.mcap --model robot.toml --seed 1 -q",
    f"batch {OFFICE} runs --runs 2 --model robot.toml -q",
    f"correct {OFFICE} corrected.mcap --model robot.toml -q",
    "export robot.toml --to ros2_control -q",
    "effects wheelbase -q",
    f"preview {OFFICE} --model robot.toml --runs 2 -q",
)


def test_bags_are_corrupted_with_effects(tmp_path):
    (tmp_path / "robot.toml").write_text(NOISE + '[[effect]]\nname = "wheelbase"\ne = 0.02\n')
    words, environment = [sys.executable, "-c", BARE, *COMMANDS], {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.stdout.splitlines()[-1:] == [str([0] * len(COMMANDS))], done.stderr
    assert "Traceback" not in done.stderr


def test_python_names_it_too(tmp_path):
    code = """
import sys
sys.modules["scipy"] = None
import odomcorrupt as oc
for call in (lambda: oc.score("runs"), lambda: oc.simulate(), lambda: oc.fit("a.mcap")):
    try:
        call()
    except oc.OdomCorruptError as error:
        print(error)
"""
    environment = {"PYTHONPATH": str(ROOT)}
    said = subprocess.check_output([sys.executable, "-c", code], cwd=tmp_path, env=environment, text=True)
    assert said.count("scipy is not installed; the study needs it") == 3


ENTRIES = ("odomcorrupt", "odomcorrupt.__main__", "odomcorrupt.cli")
"""Entry modules, which may import all packages; the names of the interface are imported lazily."""


def rows() -> list[list[str]]:
    table = (ROOT / "docs" / "architecture.md").read_text(encoding="utf8").split("|---|---|")[1]
    cells = (line.split("|")[1] for line in table.splitlines() if line.startswith("|"))
    return [[name.strip("/").removesuffix(".py") for name in re.findall(r"`([^`]+)`", cell)] for cell in cells]


def package_of(module: str) -> str:
    """Return the package of a module as the table names it; single modules have their own name."""
    parts = module.split(".")[1:]
    return "/".join(parts[:2]) if parts[:1] == ["study"] else (parts or ["odomcorrupt"])[0]


@cache
def trees() -> dict[Path, ast.Module]:
    """Return the syntax trees of the package's files, by their paths."""
    files = (ROOT / "odomcorrupt").rglob("*.py")
    return {file.relative_to(ROOT): ast.parse(file.read_text(encoding="utf8")) for file in files}


def imports() -> set[tuple[str, str]]:
    """Return importing and imported module of all imports, also those for type checkers."""
    found, modules = set(), trees()
    folders = {path.parent for path in modules}
    for path, tree in modules.items():
        own = ".".join(path.with_suffix("").parts).removesuffix(".__init__")
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "odomcorrupt":
                for name in node.names:
                    inner = f"{node.module}.{name.name}"
                    place = Path(inner.replace(".", "/"))
                    is_module = place.with_suffix(".py") in modules or place in folders
                    found.add((own, inner if is_module else str(node.module)))
    return {(own, used) for own, used in found if own not in ENTRIES}


def test_every_package_is_in_the_table():
    listed = {name for row in rows() for name in row}
    packages = {path.parent.name for path in (ROOT / "odomcorrupt").glob("*/__init__.py")} - {"study"}
    stages = {f"study/{path.parent.name}" for path in (ROOT / "odomcorrupt" / "study").glob("*/__init__.py")}
    assert packages | stages <= listed


def test_a_package_imports_only_packages_above_it_in_the_table():
    order = {name: i for i, row in enumerate(rows()) for name in row}
    found = {(own, used) for own, used in imports() if package_of(own) != package_of(used)}
    assert len(found) > 500
    places = {module: order.get(package_of(module), 0) for module in set().union(*found)}
    assert [(own, used) for own, used in found if places[used] >= max(places[own], 1)] == []


def test_no_modules_import_each_other():
    graph: dict[str, set[str]] = {}
    for own, used in imports():
        graph.setdefault(own, set()).add(used)
    TopologicalSorter(graph).prepare()


def test_a_module_assigns_each_of_its_names_once():
    # a second value silently replaces the first one, also for the functions above it
    twice = []
    for file, tree in trees().items():
        targets = [t for node in tree.body for t in getattr(node, "targets", ())]
        names = [part.id for target in targets for part in ast.walk(target) if isinstance(part, ast.Name)]
        twice += [f"{file}: {name}" for name in set(names) if names.count(name) > 1]
    assert twice == []
