"""Paths and metrics of evo, the oracle for errors of trajectories."""

import numpy as np
import pytest

ABSENT = "evo is not installed; it is the oracle here"


def evo_metrics():
    """Return evo's module of metrics, or skip the test."""
    return pytest.importorskip("evo.core.metrics", reason=ABSENT)


def as_evo(xyt, stamps_ns=None):
    """Return poses x, y, heading, shape (n, 3), as evo's path, or as its trajectory if they have stamps."""
    core, half, none = pytest.importorskip("evo.core.trajectory", reason=ABSENT), xyt[:, 2] / 2.0, np.zeros(len(xyt))
    poses = np.column_stack((xyt[:, :2], none)), np.column_stack((np.cos(half), none, none, np.sin(half)))
    return core.PosePath3D(*poses) if stamps_ns is None else core.PoseTrajectory3D(*poses, stamps_ns * 1e-9)
