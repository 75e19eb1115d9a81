"""Experiment design: what the data cannot tell, and which drive would."""
