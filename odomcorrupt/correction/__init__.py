"""Correction of the systematic errors in measured odometry."""
