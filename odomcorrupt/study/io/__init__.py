"""Where recordings come from: bags, TF, TUM and CSV files, cleaned and checked for plausibility."""

from odomcorrupt.study.io.reader import read_runs
from odomcorrupt.study.io.source import Source

__all__ = ["Source", "read_runs"]
