"""Price list: what each rule and each named number of the study changes on a fixed set of drives.

    python benchmarks/price_list.py rows CACHE [DRIVES...]                 # the rows of this tree, and a summary
    python benchmarks/price_list.py rows CACHE --against TREE [DRIVES...]  # and where they differ from another tree's
    python benchmarks/price_list.py rules CACHE [DRIVES...]                # each rule switched off
    python benchmarks/price_list.py numbers CACHE [--in study/select] [DRIVES...]   # each number halved, and doubled

A row holds the names that `learn` found, the first one, the noise, sure names that are wrong, and the 10 s error of
another drive of the same robot. A rule or number is worth what it changes: one that changes no row is deleted, one that
changes one drive is distrusted, and no rule is added that is not in `RULES` with the rows that it changes.

There are too many numbers to try each on every drive. All of them are changed together; where a row changes, bisection
on that drive finds the fewest of them that change it (QuickXplain: Junker, AAAI 2004). These are priced on all drives,
and the search goes on with the others, so that at last all that are left change no row together.

Changes are made in the source when a module is imported, in a process of its own, so that they act wherever the name is
used. Drives are named `arm:count` (`controls:20`), those of `DRIVES` by default. Rows are kept in CACHE with a hash of
the tree, and a search that was cut goes on where it stopped. Needs the study and test extras.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import hashlib
import importlib.abc
import importlib.machinery
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from functools import cache
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from types import CodeType, ModuleType

HERE = Path(__file__).parent
ROOT = HERE.parent
REAL = ROOT.parent / "shared" / "data" / "real"
DRIVES = {
    "mixtures": 14, "noisy_mixtures": 4, "outside": 4, "single": 48, "noise": 4, "real": 5, "ordinary": 8, "laser": 2,
    "rtk": 4, "controls": 12,
}  # fmt: skip
"""Number of drives of each arm, those first on which most rules act: the laboratory's of its last frozen run, the first
of the ordinary and the laser run, and recordings of real robots."""
RECORDED = {
    "optiodom_diff_free_030120210001_run1": 0.2, "optiodom_tricyc_free_140120211508_run1": None,
    "polimi_mecanum_bag1": None, "optiodom_diff_square_231220200029_run1": 0.2, "mrclam6_robot1": None,
    "plaza1": None, "tuc_lecture_hall": None,
}  # fmt: skip
"""Recordings of real robots, and the nominal track, m."""
SURE = 0.9
"""Confidence from which a name counts as certain."""
SAME = 0.005
"""Relative difference of two errors that counts as none."""
ENOUGH = 3
"""Number of changed rows after which a rule or number is known to be worth something, and is not priced further."""
RULES = {
    "study.estimate.clocks:_of_stamps": "False",
    "study.estimate.correlation_length:with_correlation_lengths": "list(recordings)",
    "study.estimate.truth_bias:with_bias_walks": "list(recordings)",
    "study.estimate.outliers:_comes_back": "False",
    "study.estimate.outliers:single_events": "[]",
    "study.estimate.outliers:slip_bursts": "None",
    "study.estimate.robust_errors:with_robust_errors": "fitted",
    "study.estimate.outliers:heavy_tails": "None",
    "study.io.encoders:restore_lost": "recording",
    "study.select.confidence:_may_be_dead_band": "False",
    "study.select.dictionary:_patch_of": "[]",
    "study.select.random_effects:_in_both_halves": "True",
    "study.select.selection:_Selection._compare_clock_with_lag": "None",
    "study.select.selection:_Selection._compare_with_process": "None",
    "study.select.selection:_Selection._contradicts_physics": "False",
    "study.select.selection:_Selection._drop_misfits": "None",
}
"""Rules of single kinds of drives, each `module:function` with the expression that it returns if it is switched off."""


class Change(NamedTuple):
    """A change of the source: the value that a function returns, or a factor on a number.

    target : `module:name` or `module:Class.name`, the module without the package's name
    how : "= expression" for a function, "* 2" or "/ 2" for a number
    """

    target: str
    how: str

    @property
    def module(self) -> str:
        """Full name of the module."""
        return f"odomcorrupt.{self.target.partition(':')[0]}"

    def __str__(self) -> str:
        return f"{self.target} {self.how}"


# --- changes of the source -------------------------------------------------------------------------------------------


class _Changed(ast.NodeTransformer):
    """Transformer that makes the changes of one module; KeyError for a name that the module does not have."""

    def __init__(self, changes: Sequence[Change]) -> None:
        self._left = {change.target.partition(":")[2]: change.how for change in changes}
        self._inside = ""

    def module(self, tree: ast.Module) -> ast.Module:
        """Return the tree with all changes made."""
        changed = self.visit(tree)
        if self._left:
            raise KeyError(f"no such name: {', '.join(self._left)}")
        return ast.fix_missing_locations(changed)

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        """Visit a class, whose names are those of its fields and methods."""
        before, self._inside = self._inside, f"{self._inside}{node.name}."
        node.body = [self.visit(one) for one in node.body]
        self._inside = before
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        """Replace the body of a function that is switched off."""
        how = self._left.pop(f"{self._inside}{node.name}", None)
        if how is not None:
            node.body = [ast.Return(ast.parse(how.removeprefix("= "), mode="eval").body)]
        return node

    def visit_Assign(self, node: ast.Assign) -> ast.AST:
        """Change numbers on the right of an assignment."""
        names = _assigned(node)
        values = node.value.elts if isinstance(node.value, ast.Tuple) and len(names) > 1 else [node.value] * len(names)
        changed = [self._number(name, value) for name, value in zip(names, values, strict=False)]
        if len(names) > 1 and isinstance(node.value, ast.Tuple):
            node.value.elts = changed
        elif len(names) == 1:
            (node.value,) = changed
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        """Change the default of a field."""
        if isinstance(node.target, ast.Name) and node.value is not None:
            node.value = self._number(node.target.id, node.value)
        return node

    def _number(self, name: str, value: ast.expr) -> ast.expr:
        how = self._left.pop(f"{self._inside}{name}", None)
        return value if how is None else _Scaled(double=how == "* 2").visit(value)


class _Scaled(ast.NodeTransformer):
    """Transformer that doubles or halves every number of an expression, see `scaled`."""

    def __init__(self, *, double: bool) -> None:
        self._double = double

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        """Scale a number."""
        if type(node.value) in (int, float):
            return ast.Constant(scaled(node.value, double=self._double))
        return node

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        """Leave indices as they are."""
        node.value = self.visit(node.value)
        return node


def scaled(value: float, *, double: bool) -> float:
    """Return a number doubled or halved: a share above one half and a factor near one by their distance from one.

    Whole numbers stay whole and do not become zero.
    """
    if isinstance(value, int):
        return 2 * value if double else max(value // 2, min(value, 1))
    factor = 2.0 if double else 0.5
    return 1.0 + factor * (value - 1.0) if 0.5 < value < 1.5 and value != 1.0 else factor * value


def _assigned(node: ast.Assign) -> list[str]:
    (target,) = node.targets[:1]
    targets = target.elts if isinstance(target, ast.Tuple) else [target]
    return [one.id if isinstance(one, ast.Name) else "" for one in targets]


class _Finder(importlib.abc.MetaPathFinder):
    """Finder of the modules of the package that are changed."""

    def __init__(self, changes: Sequence[Change]) -> None:
        self._of = {module: [c for c in changes if c.module == module] for module in {c.module for c in changes}}

    def find_spec(self, name: str, path: Any, target: ModuleType | None = None) -> Any:  # noqa: ARG002 - the protocol
        """Return the usual spec with a loader that changes the source; None for any other module."""
        if name not in self._of or (spec := importlib.machinery.PathFinder.find_spec(name, path)) is None:
            return None
        spec.loader = _Loader(name, str(spec.origin), self._of[name])
        return spec


class _Loader(importlib.machinery.SourceFileLoader):
    def __init__(self, name: str, path: str, changes: Sequence[Change]) -> None:
        super().__init__(name, path)
        self._changes = changes

    def get_code(self, fullname: str) -> CodeType | None:
        """Return the code of the changed source; nothing is cached."""
        path = self.get_filename(fullname)
        tree = _Changed(self._changes).module(ast.parse(self.get_data(path), path))
        return compile(tree, path, "exec", dont_inherit=True)


def numbers(below: str) -> list[str]:
    """Return all named numbers of the modules below a folder, as targets: constants in capitals, and fields."""
    found = []
    for path in sorted((ROOT / "odomcorrupt" / below).rglob("*.py")):
        module = ".".join(path.relative_to(ROOT / "odomcorrupt").with_suffix("").parts)
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for scope, inside in [(tree, ""), *((n, f"{n.name}.") for n in tree.body if isinstance(n, ast.ClassDef))]:
            for node in scope.body:  # type: ignore[attr-defined]
                found += [f"{module}:{inside}{name}" for name in _numbers_of(node, field=bool(inside))]
    return found


def _numbers_of(node: ast.stmt, *, field: bool) -> Iterator[str]:
    if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.value is not None:
        names, values = [node.target.id], [node.value]
    elif isinstance(node, ast.Assign):
        names = _assigned(node)
        values = node.value.elts if isinstance(node.value, ast.Tuple) and len(names) > 1 else [node.value]
        field = False
    else:
        return
    for name, value in zip(names, values, strict=False):
        if (field or name.lstrip("_").isupper()) and any(map(_is_number, ast.walk(value))):
            yield name


def _is_number(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and type(node.value) in (int, float) and node.value not in (0, 1, 2)


# --- drives and rows, in a process of its own ------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Drive:
    """Recordings to learn from, the causes, and pairs of recordings to judge with (with and without the fault)."""

    recordings: Sequence[Any]
    causes: tuple[str, ...]
    judged: Sequence[Any] = ()
    floor: Sequence[Any] = ()


def drive(name: str) -> Drive:
    """Return a drive by its arm and number."""
    arm, _, number = name.partition("/")
    if arm == "real":
        return _real(*list(RECORDED.items())[int(number)])
    if arm == "ordinary":
        return _ordinary(int(number))
    if arm == "laser":
        return _laser(int(number))
    from hidden import as_recording  # noqa: PLC0415 - a process imports the study after it has been changed
    from laboratory.cases import cases  # noqa: PLC0415
    from laboratory.drives import judges, learning_run  # noqa: PLC0415

    (case,) = (one for one in cases() if one.key == name)
    judged, floor = judges(case)
    return Drive([as_recording(learning_run(case))], case.causes, [judged], [floor])


def _real(name: str, track_m: float | None) -> Drive:
    from odomcorrupt.study.io import Source, read_runs  # noqa: PLC0415 - as above

    return Drive(read_runs(Source(REAL / f"{name}.mcap", track_m=track_m)), ())


def _ordinary(number: int) -> Drive:
    from ordinary.ask import write_case  # noqa: PLC0415 - as above
    from ordinary.cases import cases  # noqa: PLC0415

    from odomcorrupt.study.io import Source, read_runs  # noqa: PLC0415

    case = [one for one in cases() if one.cause][number]
    with tempfile.TemporaryDirectory() as folder:
        _, _, options = write_case(case, Path(folder))
        chosen = dict(zip(options[::2], options[1::2], strict=True))
        track_m = float(chosen["--track"]) if "--track" in chosen else None
        learned, judged = (
            read_runs(Source(Path(folder) / f"{kind}.mcap", chosen["--odom"], chosen["--truth"], track_m=track_m))
            for kind in ("learned", "judged")
        )
    return Drive(learned, (case.cause,), judged)


def _laser(number: int) -> Drive:
    from laser.cases import laser_cases, world_of  # noqa: PLC0415 - as above
    from laser.drives import drive as driven  # noqa: PLC0415
    from laser.drives import laser_recordings  # noqa: PLC0415

    from odomcorrupt.simulation.faults import SIZES  # noqa: PLC0415

    case = [one for one in laser_cases() if one.arm == "single"][number]
    seen = driven(
        case.seed, list(case.causes), world_of(case), duration_s=case.duration_s, size=SIZES.get(case.size, 1.0),
        route=case.route, yaw_from=case.yaw_from, drive_type=case.drive_type,
    )  # fmt: skip
    return Drive(laser_recordings(seen)[0], case.causes)


def row_of(one: Drive) -> dict[str, Any]:
    """Return the row of a drive: plain values that are compared between trees."""
    from hidden import ten_second_error  # noqa: PLC0415 - as above
    from laboratory.answer import plain_answer  # noqa: PLC0415
    from laboratory.cases import same_class  # noqa: PLC0415

    from odomcorrupt.study.select.selection import learn  # noqa: PLC0415

    learned = learn(one.recordings)
    answer = plain_answer(learned)
    causes = {same_class(cause) for cause in one.causes}
    added = answer["added"]
    sure = {step["added"] for step in answer["looks"] if step.get("confidence", 0.0) >= SURE}
    row: dict[str, Any] = {
        "names": [*answer["clocks"], *added],
        "noise": sorted(name for name, _ in answer["noise"]),
        "dependences": ["/".join(pair) for pair in answer["laws"]],
        "open": "/".join(answer["unknown"][0][:2]) if answer["unknown"] else "",
        "causes": sorted(causes),
        "sure": [name for name in added if name in sure],
        "sure_wrong": [name for name in added if name in sure and same_class(name) not in causes],
        "error": learned.error_m,
    }
    if one.judged:
        effects = [e for e in learned.fit.effects if e.kind != "setup"] if not one.floor else learned.fit.effects
        row["error"] = ten_second_error(one.judged, effects, learned.fit.problem.clocks[0])
    if one.floor:
        row["error"] /= ten_second_error(one.floor)
    return row


def evaluate(changes: Sequence[Change], names: Sequence[str]) -> None:
    """Print the row of each drive as a line of JSON, with changes of the source."""
    if changes:
        sys.meta_path.insert(0, _Finder(changes))
    sys.path[:0] = [str(HERE), str(ROOT), *(str(ROOT / "tests" / part) for part in ("", "study", "study/sources"))]
    for name in names:
        try:
            with contextlib.redirect_stdout(sys.stderr):
                row = row_of(drive(name))
        except Exception as error:  # noqa: BLE001 - a change that breaks a drive changes its row
            row = {"failed": f"{type(error).__name__}: {error}"}
        print(json.dumps({"drive": name, "row": row}), flush=True)


# --- the list --------------------------------------------------------------------------------------------------------


def differs(row: dict[str, Any], base: dict[str, Any]) -> str:
    """Return what differs between two rows of a drive, in words; "" if nothing."""
    if "failed" in row or "failed" in base:
        return "" if "failed" in row and "failed" in base else str(row.get("failed", "no longer fails"))
    said = [
        f"{key} {', '.join(base[key]) or '-'} -> {', '.join(row[key]) or '-'}"
        for key in ("names", "noise", "dependences", "sure", "sure_wrong") if row[key] != base[key]
    ]  # fmt: skip
    if abs(row["error"] - base["error"]) > SAME * base["error"]:
        said.append(f"error {base['error']:.4g} -> {row['error']:.4g}")
    return "; ".join(said)


class PriceList:
    """Rows of drives under changes of the source, each computed once.

    folder : the cache, outside of the tree
    names : drives, those first on which most changes act
    """

    def __init__(self, folder: Path, names: Sequence[str]) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.names = list(names)
        self._file, self.tree = folder / "rows.jsonl", tree_hash()
        self._known: dict[tuple[str, str], dict[str, Any]] = {}
        for stored in self._stored():
            if stored["tree"] == self.tree:
                self._known[stored["changes"], stored["drive"]] = stored["row"]

    def _stored(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self._file.read_text().splitlines()] if self._file.exists() else []

    def of_tree(self, tree: str) -> dict[str, dict[str, Any]]:
        """Return the stored rows of another tree without changes, by drive."""
        return {s["drive"]: s["row"] for s in self._stored() if s["tree"].startswith(tree) and not s["changes"]}

    def rows(self, changes: Sequence[Change], names: Sequence[str]) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield the names and rows of drives; the process ends when no more are taken."""
        key = "; ".join(sorted(map(str, changes)))
        missing = [name for name in names if (key, name) not in self._known]
        fresh = self._computed(key, changes, missing) if missing else iter(())
        for name in names:
            while (key, name) not in self._known:
                next(fresh)
            yield name, self._known[key, name]

    def _computed(self, key: str, changes: Sequence[Change], names: Sequence[str]) -> Iterator[str]:
        words = [sys.executable, __file__, "evaluate", json.dumps(changes), *names]
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=environment) as process:
            try:
                for name, line in zip(names, process.stdout or (), strict=True):
                    row = json.loads(line)["row"]
                    self._known[key, name] = row
                    with self._file.open("a") as file:
                        file.write(json.dumps({"tree": self.tree, "changes": key, "drive": name, "row": row}) + "\n")
                    yield name
            finally:
                process.kill()

    @cache  # noqa: B019 - one list a run
    def base(self, name: str) -> dict[str, Any]:
        """Return the row of a drive without changes."""
        ((_, row),) = self.rows((), [name])
        return row

    def changed(self, changes: Sequence[Change], names: Sequence[str] | None = None) -> Iterator[tuple[str, str]]:
        """Yield the drives whose rows change, and how."""
        for name, row in self.rows(changes, self.names if names is None else names):
            if said := differs(row, self.base(name)):
                yield name, said

    def culprits(self, group: Sequence[Change], name: str, fixed: Sequence[Change] = ()) -> list[Change]:
        """Return the fewest changes of a group that change the row of a drive beside the fixed ones."""
        if fixed and any(self.changed(fixed, [name])):
            return []
        if len(group) == 1:
            return list(group)
        first, second = group[: len(group) // 2], group[len(group) // 2 :]
        needed = self.culprits(first, name, (*fixed, *second))
        return [*needed, *self.culprits(second, name, (*fixed, *needed))]

    def priced(self, group: Sequence[Change]) -> list[Change]:
        """Print what each change of a group changes; return those that change nothing together."""
        left, names = list(group), list(self.names)
        while left and (found := next(self.changed(left, names), None)):
            name, _ = found
            names = names[names.index(name) :]  # those before do not change with fewer changes
            blamed = self.culprits(left, name)
            left = [one for one in left if one not in blamed]
            rows = list(islice(self.changed(blamed), ENOUGH))
            told(f"{' AND '.join(map(str, blamed))}: {len(rows)} row(s){' or more' * (len(rows) == ENOUGH)}")
            for where, said in rows:
                told(f"    {where}: {said}")
        told(f"no row: {', '.join(map(str, left)) or 'none'}")
        return left


def tree_hash() -> str:
    """Return a hash of the sources of the package."""
    digest = hashlib.sha256()
    for path in sorted((ROOT / "odomcorrupt").rglob("*.py")):
        digest.update(str(path.relative_to(ROOT)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:12]


def summary(rows: dict[str, dict[str, Any]]) -> Iterator[str]:
    """Yield a line for each arm: names and errors of its drives."""
    from statistics import median, quantiles  # noqa: PLC0415 - needed here alone

    sys.path[:0] = [str(HERE)]
    from laboratory.cases import same_class  # noqa: PLC0415 - after the path

    for arm in dict.fromkeys(name.partition("/")[0] for name in rows):
        own = [row for name, row in rows.items() if name.startswith(f"{arm}/") and "failed" not in row]
        first = sum(bool(r["names"]) and same_class(r["names"][0]) in r["causes"] for r in own)
        some = sum(any(same_class(n) in r["causes"] for n in r["names"]) for r in own)
        all_ = sum(set(r["causes"]) <= {same_class(n) for n in r["names"]} for r in own)
        more = sum(same_class(n) not in r["causes"] for r in own for n in r["names"])
        errors = sorted(r["error"] for r in own) or [0.0]
        far = quantiles(errors, n=10)[-1] if len(errors) > 1 else errors[0]
        named, sure = (sum(bool(row[key]) for row in own) for key in ("names", "sure_wrong"))
        yield (
            f"{arm}: {len(own)} drives, {named} with names, first right {first}, one right {some}, all {all_}, "
            f"extras {more}, sure wrong {sure}, error {median(errors):.3f}, {far:.3f}"
        )


def main() -> None:
    """Run one of the tasks above."""
    if sys.argv[1:2] == ["evaluate"]:
        evaluate([Change(*one) for one in json.loads(sys.argv[2])], sys.argv[3:])
        return
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("task", choices=("rows", "rules", "numbers"))
    parser.add_argument("cache", type=Path)
    parser.add_argument("drives", nargs="*", metavar="ARM:COUNT")
    parser.add_argument("--against", metavar="TREE", help="hash of another tree, as this prints it")
    parser.add_argument("--in", dest="below", default="study", help="folder of the package with the numbers")
    parser.add_argument("--except", dest="known", nargs="*", default=(), help="targets that are left as they are")
    chosen = parser.parse_args()
    wanted = dict(one.split(":") for one in chosen.drives) or DRIVES
    prices = PriceList(chosen.cache, [f"{arm}/{i}" for arm, count in wanted.items() for i in range(int(count))])
    told(f"tree {prices.tree}, {len(prices.names)} drives")
    if chosen.task == "rows":
        _rows(prices, chosen.against)
    elif chosen.task == "rules":
        prices.priced([Change(target, f"= {value}") for target, value in RULES.items()])
    else:
        free = [target for target in numbers(chosen.below) if target not in chosen.known]
        for how in ("/ 2", "* 2"):
            prices.priced([Change(target, how) for target in free])


def _rows(prices: PriceList, against: str | None) -> None:
    rows = dict(prices.rows((), prices.names))
    for line in summary(rows):
        told(line)
    other = prices.of_tree(against) if against else {}
    for name, row in rows.items():
        if name in other and (said := differs(row, other[name])):
            told(f"{name} ({', '.join(row.get('causes', ())) or 'control'}): {said}")


def told(line: str) -> None:
    """Print a line at once, because the list takes hours."""
    print(line, flush=True)


if __name__ == "__main__":
    main()
