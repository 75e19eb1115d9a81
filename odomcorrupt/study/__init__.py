"""The study half: recordings, fit, compare, diagnose."""
