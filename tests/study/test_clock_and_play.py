"""Play of gears on an unknown track: the track is found at the size of the play, and no clock offset remains."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hidden import as_recording, scanned

from odomcorrupt.effects import effect_from_values
from odomcorrupt.geometry.increments import Increments, accumulate, increments
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.first_contact import unexplained_events
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.outliers import single_events
from odomcorrupt.study.io.clock import Clock, aligned
from odomcorrupt.study.select.candidates import with_shape_refined
from odomcorrupt.study.select.clock_rivals import without_clock
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.elimination import drop_term
from odomcorrupt.study.select.score import score_terms
from odomcorrupt.study.terms.term import LibraryTerm

TRAVEL_M = 0.012
PLAY_M = 0.05
"""Large enough for a single crossing to be an event."""


@pytest.fixture(scope="module")
def run():
    return simulate(7, "backlash", duration_s=240.0, parameters={"travel": TRAVEL_M})


def fitted(recording, track_m, *, clocked):
    play = effect_from_values("backlash", {"travel": TRAVEL_M, "track": track_m})
    approach = choose_approach([recording])
    return fit([recording], [play], clocks=[Clock()], free_clocks=[(clocked, False)], approach=approach)


def test_an_unknown_track_is_found_at_the_size_of_the_play(run):
    start = fitted(as_recording(run, track=False), 0.7 * run.track_m, clocked=True)
    (play,) = start.effects
    (score,) = score_terms(drop_term(start, play), [LibraryTerm.of(play, start.problem.motions)], DECISIONS)
    (found,) = with_shape_refined(start, score, DECISIONS)[0].effects
    assert found.track == pytest.approx(run.track_m, rel=0.05)
    assert found.travel == pytest.approx(TRAVEL_M, rel=0.05)


@pytest.mark.parametrize("late_s", [0.0, 0.02])
def test_a_clock_is_dropped_if_it_gains_nothing_beside_play(run, late_s):
    recording = aligned(as_recording(run), Clock(-late_s)) if late_s else as_recording(run)
    clocked = fitted(recording, run.track_m, clocked=True)
    other = without_clock(clocked, given=())
    assert (other is None) == bool(late_s)
    assert other is None or not np.any(other.free_clocks)
    assert without_clock(clocked, given={"backlash"}) is None


def test_the_clock_of_a_laser_stays_beside_play(run):
    assert without_clock(fitted(scanned(as_recording(run)), run.track_m, clocked=True), given=()) is None


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
