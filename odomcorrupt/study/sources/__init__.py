"""Where recordings come from: bags, TF, TUM and CSV files, made clean, and checked before anybody believes them."""

from odomcorrupt.study.sources.read import Source, read_runs

__all__ = ["Source", "read_runs"]
