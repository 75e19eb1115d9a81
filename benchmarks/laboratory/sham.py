"""The sham arm: a wrong effect, fitted and added on purpose, must not lower the error of another drive."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from hidden import ten_second_error

from odomcorrupt.effects import registry
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit

if TYPE_CHECKING:
    from laboratory.cases import Case
    from odomcorrupt.study.io.recording import Recording

__all__ = ["sham"]

SHAMS = (
    "accel_slip", "gyro_bias", "lever_arm", "mount_yaw", "scale_drift", "side_slip", "speed_scale", "turn_asymmetry",
    "unequal_wheels", "wheel_scale", "wheelbase",
)  # fmt: skip


def sham(case: Case, recording: Recording, judged: Recording) -> dict[str, Any]:
    """Return the effect added to a fault-free robot, and the ratio of another drive's 10 s errors after and before."""
    name = SHAMS[int(np.random.default_rng((52, case.number)).integers(len(SHAMS)))]
    added = fit([recording], [registry()[name]()], approach=choose_approach([recording]))
    return {"effect": name, "ratio": ten_second_error([judged], added.effects) / ten_second_error([judged])}
