"""Where recordings come from: bags, TF, TUM and CSV files, cleaned and checked for plausibility."""

from odomcorrupt.study.io.reader import Source, read_runs

__all__ = ["Source", "read_runs"]
