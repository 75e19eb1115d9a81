"""Play of gears on an unknown track: the track is found at the size of the play, and no clock offset remains."""

from __future__ import annotations

import numpy as np
import pytest
from hidden import as_recording

from odomcorrupt.effects import effect_from_values
from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.io.clock import Clock, aligned
from odomcorrupt.study.select.candidates import with_shape_refined
from odomcorrupt.study.select.clock_rivals import without_clock
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.elimination import drop_term
from odomcorrupt.study.select.score import score_terms
from odomcorrupt.study.terms.term import LibraryTerm

TRAVEL_M = 0.012


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
