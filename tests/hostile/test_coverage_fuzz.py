"""Half a minute of fuzzing guided by coverage; `coverage_fuzz.py` is the long run."""

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("coverage_fuzz.py")
KINDS = 19


@pytest.mark.slow
@pytest.mark.skipif(find_spec("atheris") is None, reason="atheris is not installed: pip install -e .[fuzz]")
def test_nothing_that_is_read_breaks_a_promise(tmp_path):
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "--seconds", "20", "--keep", str(tmp_path / "kept")],
        capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    assert done.returncode in (0, 1), done.stderr
    report = json.loads(done.stdout)
    assert report["found"] == []
    assert report["counts"]["tried"] > 100
    assert sum(name.startswith("tried: ") for name in report["counts"]) > KINDS // 2
    assert report["counts"]["rewritten, judged"] > 0
