"""Laser scans as a source of truth: scan matching, keyframe SLAM, and the robot's trajectory with its information."""
