"""Expected information of a drive about its cause, computed from its design alone, before anything is learned.

The residuals of the same drive with and without the fault, both without encoder ticks and truth noise, differ only by
the contribution of the fault. Half the squared norm of that difference, whitened with the noise of the fault-free
drive, is the expected log-likelihood gain (nats) of the true cause; the norm itself is the size of the fault in
standard errors. Its part orthogonal to another effect's column separates the cause from that effect.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from hidden import as_recording

from laboratory.cases import same_class
from laboratory.drives import noiseless_pair, quiet_run
from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.intervals import GAP_S, intervals_between, pick_interval_ends

if TYPE_CHECKING:
    from laboratory.cases import Case
    from odomcorrupt.study.io.recording import Recording

__all__ = ["EXCITED_NATS", "expected_information"]

EXCITED_NATS = 8.0
"""Expected gain beyond the penalty, nats, from which a cause is excited; it is separable if it gains as much beyond
every other effect: then chance alone names another one first in 2 % of drives."""


def expected_information(case: Case, truth_scale: float = 0.0) -> dict[str, float | str | bool]:
    """Return expected nats (minus the penalty), size in standard errors, the nearest rival and nats beyond it.

    truth_scale : standard deviation of the scale error of the truth's travel, part of the noise; dimensionless
    """
    flawless = as_recording(quiet_run(case))
    base = fit([flawless], approach=choose_approach([flawless]))
    flawed, clean = (as_recording(run) for run in noiseless_pair(case))
    shift = _residual(flawed, clean, base.problem.approach.spacing_s) - _residual(
        clean, clean, base.problem.approach.spacing_s
    )
    # with a clock offset, odometry and truth do not overlap at the ends of the drive
    shift[:2], shift[-2:] = 0.0, 0.0
    unit = base.noise.whitener.whiten(base.problem.columns(effect_from_values("wheel_scale", {"heading": "gyro"})))[
        :, 0
    ]
    # with a covariance of 1 + s^2 u u' the part along u shrinks
    square = float(unit @ unit)
    along = (1.0 - 1.0 / np.sqrt(1.0 + truth_scale**2 * square)) / square

    def whitened(columns: np.ndarray) -> np.ndarray:
        white = base.noise.whitener.whiten(columns)
        return white - along * np.multiply.outer(unit, unit @ white)

    white = whitened(shift)
    total = 0.5 * float(white @ white)
    own = {same_class(cause) for cause in case.causes}
    nearest, apart = "", total
    for name, kind in registry().items():
        family = kind.scan(base.problem.motions)
        if kind.kind == "noise" or kind.needs_sideways or len(family) != 1 or same_class(name) in own:
            continue
        column = whitened(base.problem.columns(family[0]))
        left = white - column @ np.linalg.lstsq(column, white, rcond=None)[0]
        if 0.5 * float(left @ left) < apart:
            nearest, apart = name, 0.5 * float(left @ left)
    price = 0.5 * float(np.log(len(shift)))
    return {
        "nats": total - price,
        "standard_errors": float(np.sqrt(2.0 * total)),
        "rival": nearest,
        "apart_nats": apart,
        "excited": total - price >= EXCITED_NATS,
        "separable": apart >= EXCITED_NATS,
    }


def _residual(recording: Recording, like: Recording, spacing_s: float) -> np.ndarray:
    """Return the residuals (K, 3) over the same truth samples as those of `like`."""
    odo_s, truth_s = like.odometry_s, like.truth.seconds_since(like.origin_ns)
    picked = pick_interval_ends(truth_s, odo_s[0], odo_s[-1], spacing_s)
    kept = np.flatnonzero(np.diff(truth_s[picked]) < GAP_S * spacing_s)
    return intervals_between(replace(recording, origin_ns=like.origin_ns), picked, kept).residual.copy()
