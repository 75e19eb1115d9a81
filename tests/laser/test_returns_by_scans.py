"""Drives that end where they began: the end measured by matching the last scans with the first."""

import numpy as np
import pytest
import raycaster

from odomcorrupt.cli import run
from odomcorrupt.geometry.se2 import between
from odomcorrupt.study.io.laser_truth import end_seen

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("mount", [(0.1, 0.0, 0.0), (-0.05, 0.12, np.pi / 2)], ids=["ahead", "turned"])
def test_where_a_drive_ended_is_seen_by_its_scans(tmp_path, mount):
    _, poses, _, _ = raycaster.there_and_back(*raycaster.path()[2:])
    real = between(poses[0], poses[-1])
    assert np.hypot(*real[:2]) > 0.15
    bag = raycaster.drive(tmp_path / "run.mcap", mount=mount, stated=mount, returns=True, off=1.05)
    found = end_seen(bag, "run", None, "/scan")
    assert found == pytest.approx(real, abs=0.01)


def test_a_drive_that_ends_elsewhere_is_refused_in_one_line(tmp_path, capsys):
    bag = raycaster.drive(tmp_path / "run.mcap", stated=(0.1, 0.0, 0.0))
    assert run(["fit", str(bag), "--returns", "--scan", "/scan"]) == 1
    said = capsys.readouterr().err.strip()
    assert "--end" in said
    assert run(["fit", str(bag), "--end", "1,0,0", "--scan", "/scan"]) == 2
