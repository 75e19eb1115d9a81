"""Fixtures and options. Nothing of odomcorrupt is imported before a test asks for it: pytest starts as fast as ever."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable

    from pytest_odomcorrupt.bags import CorruptedBag
    from pytest_odomcorrupt.gate import ErrorGate

__all__ = ["corrupted_bags", "error_gate", "pytest_addoption", "pytest_runtest_makereport"]

BASELINES = "odomcorrupt_baselines"
"""Directory beside a test file with the baselines of its tests: to be committed."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options."""
    group = parser.getgroup("odomcorrupt")
    group.addoption("--odomcorrupt-update", action="store_true", help="Replace the baselines of error_gate.")
    group.addoption("--odomcorrupt-cache", metavar="DIR", help="Where corrupted bags are kept. [pytest's cache]")


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> None:
    """Show an error of odomcorrupt, such as a missing topic, at the line of the test, without source of the library."""
    if call.excinfo is None or not {"corrupted_bags", "error_gate"} & {*getattr(item, "fixturenames", ())}:
        return
    if not any(kind.__name__ == "OdomCorruptError" for kind in call.excinfo.type.__mro__):
        return
    last = call.excinfo.tb
    while last.tb_next is not None:
        if last.tb_next.tb_frame.f_globals.get("__name__", "").startswith(("odomcorrupt.", "pytest_odomcorrupt.")):
            last.tb_next = None
        else:
            last = last.tb_next


@pytest.fixture(scope="session")
def corrupted_bags(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Callable[..., tuple[CorruptedBag, ...]]:
    """Return a function of a clean bag, a model, `runs` and `seed` that returns corrupted bags: `bags.corrupted`."""
    from pytest_odomcorrupt.bags import corrupted  # noqa: PLC0415 - not before a test asks

    given = request.config.getoption("odomcorrupt_cache")
    if given:
        where = Path(given)
    elif hasattr(request.config, "cache"):
        where = Path(request.config.cache.mkdir("odomcorrupt"))
    else:
        where = tmp_path_factory.mktemp("odomcorrupt")
    return partial(corrupted, cache=where)


@pytest.fixture
def error_gate(request: pytest.FixtureRequest) -> ErrorGate:
    """Return the gate of a test: its baseline lies in odomcorrupt_baselines beside the test's file."""
    from pytest_odomcorrupt.gate import ErrorGate  # noqa: PLC0415 - not before a test asks

    name = re.sub(r"[^\w.-]+", "_", f"{request.path.stem}.{request.node.name}")
    path = request.path.parent / BASELINES / f"{name}.json"
    return ErrorGate(path, update=bool(request.config.getoption("odomcorrupt_update")))
