"""Where recordings come from: bags, TF, TUM and CSV files, made clean, and checked before anybody believes them."""

from odomcorrupt.study.sources.today import read_recording

__all__ = ["read_recording"]
