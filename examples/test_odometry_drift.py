"""A test of a localisation in CI: its errors over 20 corrupted bags, against those of the version before."""

from pathlib import Path

import numpy as np
from localise import Field, localise, map_of, read_scans

from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.motion_model import Noise
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.scoring.run import read_estimate

OFFICE = Path("fixtures/office.mcap")
ALPHAS = Noise("quadratic", Coefficients(0.1, 0.1, 0.1, 0.1))


def test_localisation_survives_typical_drift(corrupted_bags, error_gate):
    """Localise each run, and hold the errors against the baseline."""
    scans, field, errors = read_scans(OFFICE, "base_link"), Field(map_of(OFFICE, "/odom")), {}
    for bag in corrupted_bags(OFFICE, "typical", runs=20, seed=7):
        path = read_estimate(bag.path, "/odom").trajectory
        stamps, xyt = localise(path, scans, field, path.xyt[0], ALPHAS, count=200, seed=bag.run)
        estimate = Trajectory(stamps, np.column_stack((xyt[:, :2], np.unwrap(xyt[:, 2]))))
        errors[bag.name] = bag.errors(estimate, align="none").metrics()["ate_m"]
    error_gate(errors, rise=0.2, most=0.5)
