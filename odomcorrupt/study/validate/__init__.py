"""Validation: whether a model explains recordings, where it does not, and held-out errors."""
