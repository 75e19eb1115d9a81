"""Recordings with a hidden cause, from the wheel-level simulation, as the study reads them."""

import numpy as np

from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.study.estimate.problem import undo
from odomcorrupt.study.estimate.windows import joint_rmse, time_windows
from odomcorrupt.study.io.clock import Clock, aligned
from odomcorrupt.study.io.recording import Recording
from odomcorrupt.study.select.candidates import dependence_of, score_terms, tested_candidates
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.dictionary import Dictionary


def as_recording(run, name="run", *, track=True):
    """Return a simulated run as a recording."""

    def trajectory(stamps, xyt):
        unwrapped = xyt.copy()
        unwrapped[:, 2] = np.unwrap(unwrapped[:, 2])
        return Trajectory(stamps, unwrapped)

    return Recording(
        name,
        trajectory(run.odom_stamps_ns, run.odom_xyt),
        trajectory(run.truth_stamps_ns, run.truth_xyt),
        int(run.odom_stamps_ns[0]),
        run.track_m if track else None,
    )


def ten_second_error(runs, effects=(), clock: Clock = Clock()) -> float:  # noqa: B008 - a frozen value
    """RMS position error at the end of non-overlapping 10 s windows, each started at the truth pose, in metres."""
    parts = [time_windows(undo(aligned(run, clock), effects)) for run in runs]
    return joint_rmse(parts)


def library_candidates(fitted):
    """Return the tests of all library effects beside a fit, the most significant first."""
    dictionary = Dictionary(DECISIONS)
    dictionary.extend(fitted)
    return tested_candidates(fitted, dictionary.library.values(), dictionary)


def basis_dependences(fitted):
    """Return the significant basis functions on the residual of a fit as dependences, the largest gain first."""
    dictionary = Dictionary(DECISIONS)
    dictionary.extend(fitted)
    scores = score_terms(fitted, list(dictionary.basis.values()), Dictionary(DECISIONS))
    clear = sorted((one for one in scores if one.nats > 0.0), key=lambda one: -one.nats)
    return [dependence_of(fitted, one.term, one.nats, Dictionary(DECISIONS)) for one in clear]
