"""A robot's motion model: noise laws, coefficients, presets, and the model file."""
