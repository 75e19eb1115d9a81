"""Errors of a localisation or SLAM under odometry noise, over the runs of a batch, and a gate for regressions."""
