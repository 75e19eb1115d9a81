import re

import pytest

from odomcorrupt.cli import run


def test_density_is_printed_and_drawn(tmp_path, capsys):
    picture = tmp_path / "density.svg"
    assert run(["density", "-o", str(picture), "--seed", "1", "--at", "0.2,0.35,10deg"]) == 0
    out = capsys.readouterr().out
    integral = float(re.search(r"end poses: ([\d.]+)", out)[1])
    assert integral == pytest.approx(1.0, abs=1e-3)
    assert float(re.search(r"10 deg\): ([\d.]+)", out)[1]) > 100
    assert picture.read_bytes().startswith(b"<?xml")


def test_noise_without_a_density_is_wrong_usage(capsys):
    assert run(["density", "--alpha", "0", "0", "0.1", "0.1"]) == 2
    assert "rot1" in capsys.readouterr().err
