"""Experiment design: what the data do not determine, and which drive would."""
