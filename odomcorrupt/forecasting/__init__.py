"""Forecast of a model's drift on a bag, from many runs over its clean path; no bag is written."""
