"""Planted causes: a known effect is added to the odometry of real recordings, and must be recovered.

The effect is applied by the package's own corruption, without noise, to the increments of the recorded odometry.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from laboratory.answer import plain_answer
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.effects import effect_from_values
from odomcorrupt.effects.effect import parameters
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.motion_model import MotionModel, Noise
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.io import Source, read_runs
from odomcorrupt.study.select.selection import learn

if TYPE_CHECKING:
    from pathlib import Path

    from laboratory.cases import Case
    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.io.recording import Recording

__all__ = ["SIZES", "plant", "planted"]

ROBOTS = (
    ("optiodom_diff_free_030120210001_run1", 0.2), ("polimi_mecanum_bag1", None),
    ("optiodom_tricyc_free_140120211508_run1", None),
)  # fmt: skip
"""Recordings, and the robot's track width or None."""
SIZES = {
    "wheel_scale": {"e": 0.02},
    "unequal_wheels": {"curvature": 0.03},
    "gyro_bias": {"bias": 0.01},
    "wheelbase": {"e": 0.04},
}


def plant(recording: Recording, effect: Effect) -> Recording:
    """Return the recording with an effect added to its odometry."""
    model = MotionModel(
        Noise("diffusion", Coefficients(0.0, 0.0, 0.0, 0.0)), effects=(effect,), track_m=recording.track_m
    )
    odometry = recording.odometry
    samples = NoisyPath(model, 0).feed(odometry.stamps_ns, odometry.xyt)
    return replace(recording, odometry=Trajectory(odometry.stamps_ns, odometry.xyt + samples.error_xyt))


def planted(case: Case, folder: Path) -> dict[str, Any]:
    """Return the results learned from a recording with and without a planted effect."""
    name, track_m = ROBOTS[case.number // 4 % len(ROBOTS)]
    file = folder / f"{name}.mcap"
    if not file.exists():
        return {"absent": name}
    sign = (-1.0) ** case.number
    sizes = {key: sign * value for key, value in SIZES[case.causes[0]].items()}
    recording = read_runs(Source(file, track_m=track_m))[0]
    with_it = plant(recording, effect_from_values(case.causes[0], sizes))
    if not np.isfinite(with_it.odometry.xyt).all():
        raise ValueError(f"{name}: planting {case.causes[0]} gives no numbers")
    plain, planted = learn([recording]), learn([with_it])
    # fit the same effects to the original recording: differences need the same model on both sides
    same = fit(
        [recording],
        planted.fit.effects,
        clocks=plain.clocks.clocks,
        free_clocks=plain.clocks.free,
        approach=planted.fit.problem.approach,
        random=planted.fit.random,
    )
    beside = {e.name: {p.name: getattr(e, p.name) for p in parameters(e)} for e in same.effects}
    return {
        "recording": name,
        "planted": sizes,
        "plain": plain_answer(plain),
        "answer": plain_answer(planted),
        "beside": beside,
    }
