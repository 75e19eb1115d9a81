"""13.5: an effect that improves single steps but increases the drift is refused, unless the next one corrects it."""

import pytest
from hidden import as_recording

from odomcorrupt.simulation import simulate
from odomcorrupt.study.select.selection import learn

MIXED = {"mount_yaw": {"yaw": -0.02}, "unequal_wheels": {"curvature": -0.01}}


@pytest.mark.slow
def test_two_causes_that_make_up_for_each_other_on_the_path_are_both_named():
    # breaks where the gate looks at one cause alone: a turned marker hides a bend, and alone nearly doubles the error
    run = simulate(9102, tuple(MIXED), duration_s=300.0, route="loops", parameters=MIXED)
    learned = learn([as_recording(run)])
    first = learned.rounds[0].candidates[0]
    assert first.score.effect.name == "mount_yaw"
    assert first.rmse[1] > first.rmse[0]
    assert set(learned.added) == set(MIXED)
    assert learned.error_m < 0.6 * first.rmse[0]
