"""The price list changes what it names and nothing else, and finds the fewest changes that change a row."""

import ast
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))
price_list = pytest.importorskip("price_list")

SOURCE = """
_LEVEL, _COUNT = 0.01, 5
GRID = (0.5, 2.0)
class Limits:
    share: float = 0.985
    def far(self):
        return self.share
def is_odd(value):
    return value % 2 == 1
"""


def changed(*changes):
    """Return the names of the source with some changes made."""
    made = price_list._Changed([price_list.Change(f"a:{target}", how) for target, how in changes])
    tree, names = made.module(ast.parse(SOURCE)), {}
    exec(compile(tree, "a", "exec"), names)  # noqa: S102 - the source above
    return names


@pytest.mark.parametrize("value", [1e-4, 0.3, 0.97, 0.985, 1.02, 1.15, 3.0, 40.0, -2.5])
def test_a_number_lies_between_its_half_and_its_double_and_both_are_on_its_side_of_one(value):
    half, double = (price_list.scaled(value, double=double) for double in (False, True))
    assert min(half, double) < value < max(half, double)
    assert (half < 1.0) == (double < 1.0) == (value < 1.0)
    assert price_list.scaled(half, double=True) == pytest.approx(value)


@pytest.mark.parametrize("count", [1, 2, 3, 60])
def test_a_whole_number_stays_whole_and_above_zero(count):
    others = [price_list.scaled(count, double=double) for double in (False, True)]
    assert all(isinstance(other, int) and other > 0 for other in others)


def test_only_what_is_named_is_changed():
    names = changed(("_COUNT", "* 2"), ("Limits.share", "/ 2"), ("is_odd", "= None"), ("GRID", "* 2"))
    assert (names["_LEVEL"], names["_COUNT"], names["GRID"]) == (0.01, 10, (1.0, 4.0))
    assert names["Limits"]().far() == pytest.approx(0.9925)
    assert names["is_odd"](3) is None


def test_a_name_that_is_not_there_is_an_error():
    with pytest.raises(KeyError, match="no such name: gone"):
        changed(("gone", "* 2"))


def test_every_rule_and_every_number_of_the_study_is_there():
    targets = [*price_list.RULES, *price_list.numbers("study/estimate")]
    assert len(set(targets)) == len(targets)
    modules = {}
    for target in targets:
        module, _, name = target.partition(":")
        modules.setdefault(module, []).append(name)
    root = price_list.ROOT / "odomcorrupt"
    for module, names in modules.items():
        tree = ast.parse((root / f"{module.replace('.', '/')}.py").read_text(encoding="utf-8"))
        how = [price_list.Change(f"{module}:{name}", price_list.RULES.get(f"{module}:{name}", "* 2")) for name in names]
        price_list._Changed(how).module(tree)  # raises for a name that is gone


class Rows(price_list.PriceList):
    """Rows of which some change if all changes of a set are made together."""

    def __init__(self, sets, names):
        self.sets, self.names, self.asked = sets, names, 0

    def rows(self, changes, names):
        for name in names:
            self.asked += 1
            row = {key: [] for key in ("names", "noise", "dependences", "sure", "sure_wrong")}
            yield name, row | {"error": 1.0 + sum(own <= set(changes) for own in self.sets.get(name, ()))}


def test_the_fewest_changes_that_change_a_row_are_found_and_the_others_are_free(capsys):
    all_changes = [price_list.Change(f"a:N{i}", "* 2") for i in range(64)]
    one, two, three = all_changes[7], all_changes[20], all_changes[50]
    rows = Rows({"x": [{one}], "z": [{two, three}]}, ["w", "x", "y", "z"])
    free = rows.priced(all_changes)
    assert set(all_changes) - set(free) == {one, two, three}
    said = capsys.readouterr().out
    assert f"{one}: 1 row(s)" in said
    assert f"{two} AND {three}" in said
    assert rows.asked < 64
