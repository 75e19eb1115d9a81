"""Bag corruption: odometry -> noisy path -> correction C(t) of the odom frame -> patched messages."""
