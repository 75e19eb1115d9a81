"""The laser as the truth: real bags, where they are there, against what others measured on them."""

import json

import numpy as np
import pytest

from odomcorrupt.cli import run
from odomcorrupt.study.io import Source, read_runs
from recordings import RECORDINGS

LASER = RECORDINGS / "laser"

pytestmark = pytest.mark.recordings


@pytest.mark.slow
def test_a_bag_without_truth_is_learned_from_its_only_laser_and_says_so():
    (run,) = read_runs(Source(LASER / "cmu_wean_1.mcap"))
    assert any("no truth: the laser on /scan" in note for note in run.notes)
    assert run.truth.covariance.shape == (len(run.truth), 3, 3)
    assert run.truth_scale_error == 0.003
    assert np.linalg.eigvalsh(run.truth.covariance).min() > 0.0


@pytest.mark.slow
def test_the_map_of_a_real_rover_is_thinner_than_its_odometry_draws_it(tmp_path, capsys):
    out = tmp_path / "map.yaml"
    words = ["map", str(LASER / "mines_rover_exp1.mcap"), "--method", "laser", "--seed", "1", "-o", str(out), "--json"]
    assert run(words) == 0
    for end in (".yaml", ".pgm", ".tum", ".png"):
        assert out.with_suffix(end).stat().st_size > 0
    thickness = json.loads(capsys.readouterr().out)["thickness_m"]
    assert thickness["corrected by the laser"][-1] < thickness["odometry"][-1]
