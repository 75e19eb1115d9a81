"""Drive types: wheel layouts of robots, which determine the possible effects."""

from __future__ import annotations

AUTO = "auto"
"""Inferred from the motion, see `study.estimate.drive_type`."""
DRIVE_TYPES = ("differential", "skid", "car", "tricycle", "omni")
STEERED = frozenset({"car", "tricycle"})
"""Drive types with a steering angle: the odometry is one travel and one angle, without a comparison of two wheels."""
PIVOTING = frozenset(DRIVE_TYPES) - STEERED
"""Drive types that turn on the spot, by the difference of their wheels."""
