"""Estimation: residuals between intervals, their likelihood, and the fit of a model to them."""
