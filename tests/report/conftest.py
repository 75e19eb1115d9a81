"""A simulated robot, two of its drives and two models of it: what the tests of reports compare."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from browser import CHROMIUM, browser

from odomcorrupt.effects import effect_from_values
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.model_file import format_model
from odomcorrupt.model.motion_model import MotionModel, Noise, Setup, TruthNoise
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.report.html import report_html
from odomcorrupt.simulation import simulate, write_mcap
from odomcorrupt.study.io.recording import Recording
from odomcorrupt.study.pipeline import diagnose_model
from odomcorrupt.study.validate.compare import compare

BASE = MotionModel(
    Noise("diffusion", Coefficients(0.004, 0.0085, 0.0012, 0.0014)), setup=Setup(truth=TruthNoise(0.002, 0.0035, 3e-6))
)
CURVATURE = -0.0133


class Case(NamedTuple):
    """A recording, its bag, and the files of the models; the second knows the cause."""

    recording: Recording
    bag: object
    base: object
    robot: object


def unwrapped(stamps, xyt):
    return Trajectory(stamps, np.column_stack((xyt[:, :2], np.unwrap(xyt[:, 2]))))


@pytest.fixture
def tab(tmp_path):
    """Return a page in a real browser; the test is skipped where there is none."""
    if not CHROMIUM.exists():
        pytest.skip(f"no {CHROMIUM} here: the page was not rendered")
    with browser(tmp_path) as page:
        yield page


@pytest.fixture(scope="session")
def case(tmp_path_factory):
    folder = tmp_path_factory.mktemp("compared")
    run = simulate(1003, "unequal_wheels", duration_s=120.0, robot_seed=3, parameters={"curvature": CURVATURE})
    write_mcap(run, folder / "drive.mcap")
    robot = replace(BASE, effects=(effect_from_values("unequal_wheels", {"curvature": CURVATURE}),))
    for name, model in (("base", BASE), ("robot", robot)):
        (folder / f"{name}.toml").write_text(format_model(model))
    truth = unwrapped(run.truth_stamps_ns, run.truth_xyt)
    recording = Recording(
        "drive.mcap", unwrapped(run.odom_stamps_ns, run.odom_xyt), truth, int(run.odom_stamps_ns[0]), run.track_m
    )
    return Case(recording, folder / "drive.mcap", folder / "base.toml", folder / "robot.toml")


@pytest.fixture
def base_model():
    return BASE


@pytest.fixture(scope="session")
def comparison(case):
    robot = replace(BASE, effects=(effect_from_values("unequal_wheels", {"curvature": CURVATURE}),))
    return compare([case.recording], {"base.toml": BASE, "robot.toml": robot})


@pytest.fixture(scope="session")
def page(comparison):
    return report_html(comparison)


@pytest.fixture(scope="session")
def diagnosed(case):
    """What a search finds in the drive: made once, because nothing here takes longer."""
    return diagnose_model([case.recording])
