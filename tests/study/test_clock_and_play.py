"""Play of gears: a first motion within the play is no event."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hidden import as_recording

from odomcorrupt.effects import effect_from_values
from odomcorrupt.geometry.increments import Increments, accumulate, increments
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.first_contact import unexplained_events
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.outliers import single_events

PLAY_M = 0.05
"""Large enough for a single crossing to be an event."""


def with_lost_motion(run, lost_m, begin):
    """Return the recording of a run whose motors turned by so much more than the wheels over ten intervals."""
    recording = as_recording(run)
    steps = increments(recording.odometry.xyt)
    more = steps.ds_m.copy()
    more[begin : begin + 10] += 0.1 * lost_m
    xyt = accumulate(recording.odometry.xyt[0], Increments(more, steps.dl_m, steps.dtheta_rad))
    return replace(recording, odometry=Trajectory(recording.odometry.stamps_ns, xyt))


@pytest.mark.parametrize(
    ("share", "late", "reported"),
    [(0.9, False, False), (2.0, False, True), (0.9, True, True)],
    ids=["less than the play", "more than the play", "after reversals"],
)
def test_a_first_motion_within_the_play_is_no_event(share, late, reported):
    """Where the gears are when a drive starts is unknown."""
    run = simulate(7, "backlash", duration_s=240.0, parameters={"travel": PLAY_M})
    moving = np.flatnonzero(np.abs(np.diff(run.odom_xyt[:, 0])) > 1e-3)
    recording = with_lost_motion(run, share * PLAY_M, int(moving[len(moving) // 2 if late else 0]))
    play = effect_from_values("backlash", {"travel": PLAY_M})
    made = fit([recording], [play], approach=choose_approach([recording]))
    assert single_events(made)
    assert bool(unexplained_events(made)) == reported
