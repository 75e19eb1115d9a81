"""A model against recordings it has not seen: calibration, drift, where it fails, the ladder."""
