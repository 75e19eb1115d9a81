"""Blocks in, blocks out: the only room that knows bag formats."""
