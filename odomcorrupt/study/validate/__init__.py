"""Validation of models: goodness of fit, lack of fit, and held-out errors."""
