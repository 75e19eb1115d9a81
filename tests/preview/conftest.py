"""Bags made in memory are shared with the tests of corruption, wherever a run of tests begins."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "corruption"))
