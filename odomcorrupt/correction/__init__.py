"""Measured odometry with the systematic part of its errors taken out."""
