"""Imports between packages point one way, as in the table of docs/architecture.md; names are assigned once."""

import ast
import re
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[1]
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
