"""Reading of recordings from bags, TF, TUM and CSV files, with cleaning and plausibility checks."""

from odomcorrupt.study.io.reader import read_runs
from odomcorrupt.study.io.source import Source

__all__ = ["Source", "read_runs"]
