"""Learning finds exactly the effects that corruption puts into a perfect simulation."""

from dataclasses import replace

import numpy as np
import pytest
from wandering import recording, wander

from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.effects import effect_from_values
from odomcorrupt.geometry.se2 import accumulate
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.motion_model import MotionModel, Noise
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.select.selection import learn

TRACK_M = 0.4
STRENGTHS = {
    "usual": Coefficients(0.0105, 0.0087, 0.0018, 0.0005),
    "typical": Coefficients(0.05, 0.02, 0.05, 0.01),
}


def corrupted(strength, effects=(), seed=10):
    """Return what a simulator without noise records: the truth exactly, and odometry corrupted by this program."""
    steps = wander(seed, 400.0)
    clean = recording(steps, accumulate(np.zeros(3), steps), truth_mm=0.0, truth_rad=0.0, seed=seed)
    stamps, xyt = clean.odometry.stamps_ns, clean.odometry.xyt
    model = MotionModel(Noise("diffusion", STRENGTHS[strength]), tuple(effects), TRACK_M)
    odometry = xyt + NoisyPath(model, seed).feed(stamps, xyt).error_xyt
    return replace(clean, odometry=Trajectory(stamps, odometry), track_m=TRACK_M)


@pytest.mark.parametrize(
    ("strength", "seed"), [pytest.param("usual", 10, marks=pytest.mark.slow), ("usual", 11), ("typical", 10)]
)
def test_noise_alone_is_noise_alone(strength, seed):
    # breaks where noise of the odometry is in the turns that an error is compared with: laws of it are then believed;
    # and where those who stand, whose error is nothing, make Gaussian noise look heavy-tailed
    learned = learn([corrupted(strength, seed=seed)])
    assert (learned.added, learned.laws, learned.unknown, learned.noise) == ((), (), (), ())
    k, put = learned.fit.noise.coefficients, STRENGTHS[strength]
    assert k.rot_trans == pytest.approx(put.rot_trans, rel=0.15)
    assert k.trans_trans == pytest.approx(put.trans_trans, rel=0.15)


@pytest.mark.slow
def test_an_effect_comes_back_with_its_size():
    learned = learn([corrupted("usual", [effect_from_values("wheelbase", {"e": -0.03})])])
    assert (learned.added, learned.unknown, learned.noise) == (("wheelbase",), (), ())
    assert learned.fit.effects[0].e == pytest.approx(-0.03, abs=0.005)


def test_noise_that_lives_in_the_odometry_leaves_the_driving_to_the_truth():
    assert choose_approach([corrupted("usual")]).side == "truth"
