import json
import math

import numpy as np
import pytest

from odomcorrupt.cli import run
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.errors import ModelError
from odomcorrupt.model.motion_model import MotionModel, Noise, Step
from odomcorrupt.model.noise_laws import Coefficients, law_named
from odomcorrupt.sampling.convert import convert, drift_of

STEP = Step(0.25, 0.2)
QUADRATIC = Noise("quadratic", Coefficients(0.1, 0.05, 0.04, 0.02), STEP)


def spread(noise, poses, runs=600):
    """Standard deviations of heading and of travel at the end of a drive corrupted at 50 Hz, travel by itself."""
    stamps = np.arange(len(poses)) * 20_000_000
    ends = np.array([NoisyPath(MotionModel(noise), 4, k).feed(stamps, poses).error_xyt[-1] for k in range(runs)])
    return ends.std(axis=0)


def straight(n=401):
    poses = np.zeros((n, 3))
    poses[:, 0] = np.linspace(0, 5, n)
    return poses


def turning(n=401):
    poses = np.zeros((n, 3))
    poses[:, 2] = np.linspace(0, 4, n)
    return poses


@pytest.mark.slow
@pytest.mark.parametrize("target", ["diffusion", "linear"])
def test_converted_law_drifts_the_same_in_simulation(target):
    step = None if target == "diffusion" else Step(0.5, 0.1)
    other = convert(QUADRATIC, law_named(target), step)
    for poses, columns in ((straight(), (0, 2)), (turning(), (2,))):
        ours, theirs = spread(other, poses), spread(QUADRATIC, poses)
        for column in columns:
            assert ours[column] == pytest.approx(theirs[column], rel=0.09)


def test_quadratic_of_amcl_in_diffusion_by_hand():
    found = convert(QUADRATIC, law_named("diffusion"), None).coefficients
    assert found.rot_rot == pytest.approx(math.sqrt(0.1 * 0.2 / 2))
    assert found.rot_trans == pytest.approx(math.sqrt(2 * 0.05 * 0.25))
    assert found.trans_trans == pytest.approx(math.sqrt(0.04 * 0.25))
    assert found.trans_rot == pytest.approx(math.sqrt(0.02 * 0.2 / 2))


@pytest.mark.parametrize("law", ["diffusion", "linear", "quadratic", "velocity", "omni"])
def test_there_and_back_is_where_it_began(law):
    other = convert(QUADRATIC, law_named(law), Step(0.1, 0.3))
    back = convert(other, law_named("quadratic"), STEP)
    for name in ("rot_rot", "rot_trans", "trans_trans", "trans_rot"):
        assert getattr(back.coefficients, name) == pytest.approx(getattr(QUADRATIC.coefficients, name))
    assert drift_of(other).rot_rot == pytest.approx(drift_of(QUADRATIC).rot_rot)


def test_what_has_no_place_in_the_other_law_is_reported():
    sideways = Noise("diffusion", Coefficients(0.1, 0.1, 0.1, 0.1, across_trans=0.02))
    with pytest.raises(ModelError, match="across_trans"):
        convert(sideways, law_named("quadratic"), STEP)
    assert convert(sideways, law_named("omni"), STEP).coefficients.across_trans > 0


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["1", "1", "1", "1", "--from", "quadratic", "--to", "diffusion"], "--step"),
        (["1", "1", "1", "1", "--from", "diffusion", "--to", "linear"], "--to-step"),
        (["1", "1", "1", "--from", "diffusion", "--to", "linear"], "3 numbers"),
        (["1", "1", "1", "x", "--from", "diffusion", "--to", "linear"], "'x'"),
        (["1", "1", "1", "1", "--from", "cubic", "--to", "linear"], "cubic"),
    ],
)
def test_wrong_usage_is_reported_in_one_line(arguments, word, capsys):
    assert run(["convert-alpha", *arguments]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert word in lines[0]


def test_command_prints_what_to_type_next(capsys):
    arguments = ["convert-alpha", "0.1", "0.05", "0.04", "0.02", "--from", "quadratic", "--step", "0.25m"]
    assert run([*arguments, "--to", "diffusion"]) == 0
    said = capsys.readouterr().out.replace(" \\\n", " ").split()
    assert " ".join(said).endswith("next odomcorrupt in.bag out.bag --law diffusion --alpha 0.1 0.158114 0.1 0.0447214")
    assert run([*arguments, "--to", "diffusion", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["to"]["coefficients"]["rot_rot"] == pytest.approx(0.1)
