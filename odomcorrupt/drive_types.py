"""Drive types: how a robot's wheels steer it, and so which effects it can have."""

from __future__ import annotations

__all__ = ["AUTO", "DRIVE_TYPES", "PIVOTING", "STEERED"]

AUTO = "auto"
"""Guessed from the motion, see `study.terms.drive_type`."""
DRIVE_TYPES = ("differential", "skid", "car", "tricycle", "omni")
STEERED = frozenset({"car", "tricycle"})
"""A steering angle turns them: one travel and one angle make the odometry, and no two wheels are compared."""
PIVOTING = frozenset(DRIVE_TYPES) - STEERED
"""They turn on the spot: the difference of wheels turns them."""
