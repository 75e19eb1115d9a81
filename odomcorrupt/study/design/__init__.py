"""Experiment design: parameters that the data do not determine, and drives that would determine them."""
