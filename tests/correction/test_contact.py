"""Effects of single wheels are taken out as whole bags are corrected, whatever it is that slips."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bag_contents import rows_of

from odomcorrupt.cli import run

OFFICE = Path(__file__).parent.parent.parent / "fixtures" / "office.mcap"


@pytest.mark.parametrize(
    "effect",
    [
        "accel_slip:k=0.04,contact=axle",
        "accel_slip:k=0.04,contact=wheels",
        "region_slip:slip=0.05,x=1,y=1,radius=1,contact=wheels",
    ],
)
def test_what_single_wheels_do_is_put_in_and_taken_out(tmp_path, effect, capsys):
    # breaks where it is found out whether an effect asks for places by showing it something that is no motion
    wrong, right = tmp_path / "wrong.mcap", tmp_path / "right.mcap"
    given = ["--effect", effect, "--track", "0.4"]
    assert run([str(OFFICE), str(wrong), *given]) == 0
    assert run(["correct", "-v", str(wrong), str(right), *given]) == 0
    assert ("--start" in capsys.readouterr().err) == effect.startswith("region_slip")
    was, off, back = (rows_of(path, "/odom").xyt[:, :2] for path in (OFFICE, wrong, right))
    assert np.abs(off - was).max() > 1e-3
    assert np.abs(back - was).max() < 1e-6
