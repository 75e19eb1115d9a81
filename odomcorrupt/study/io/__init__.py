"""Where recordings come from: bags, TF, TUM and CSV files, made clean, and checked before anybody believes them."""

from odomcorrupt.study.io.reader import Source, read_runs

__all__ = ["Source", "read_runs"]
