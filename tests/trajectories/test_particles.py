import csv
import json
from pathlib import Path

import numpy as np
import pytest

import odomcorrupt as oc
from odomcorrupt.cli import run
from odomcorrupt.errors import RecordingError
from odomcorrupt.sampling.samples import places_along, sample_particles
from odomcorrupt.trajectories import Drive, read_drive

OFFICE = Path(__file__).parents[2] / "fixtures" / "office.mcap"
NOISE = oc.Noise(alpha=(0.05, 0.02, 0.05, 0.01))


def straight(length, n=500):
    xyt = np.zeros((n, 3))
    xyt[:, 0] = np.linspace(0, length, n)
    return Drive("/odom", "odom", "base", np.arange(n) * 10**8, xyt, np.zeros((n, 3)))


def test_run_of_the_cloud_is_the_path_that_corruption_writes(tmp_path):
    noisy = tmp_path / "noisy.mcap"
    arguments = ["--alpha", "0.05", "0.02", "0.05", "0.01", "--seed", "9"]
    assert run([str(OFFICE), str(noisy), *arguments, "--run", "3"]) == 0
    cloud = oc.sample_along(OFFICE, NOISE, seed=9, runs=4, every_m=7.0).result
    np.testing.assert_allclose(cloud.xyt[3, -1, :2], read_drive(noisy, None).xyt[-1, :2], atol=1e-9)


@pytest.mark.slow
def test_cloud_spreads_as_the_law_says():
    """On a straight drive: along by sqrt(distance), heading by sqrt(distance), across by distance^1.5."""
    drive = straight(16.0)
    cloud = sample_particles(drive, oc.Model(NOISE).motion_model, places_along(drive, 4.0), seed=1, runs=3000)
    np.testing.assert_allclose(cloud.distance_m, [4, 8, 12, 16], atol=0.05)
    spread = cloud.xyt.std(axis=0)
    d = cloud.distance_m
    np.testing.assert_allclose(spread[:, 2], 0.02 * np.sqrt(d), rtol=0.06)
    np.testing.assert_allclose(spread[:, 0], 0.05 * np.sqrt(d), rtol=0.06)
    np.testing.assert_allclose(spread[:, 1], 0.02 * np.sqrt(d**3 / 3), rtol=0.06)


def test_parked_robot_has_no_cloud():
    with pytest.raises(RecordingError, match="does not move"):
        places_along(straight(0.0), 1.0)


def test_last_place_is_the_end_and_no_place_is_near_it():
    drive = straight(10.1)
    np.testing.assert_allclose(drive.distance_m[places_along(drive, 5.0)], [5, 10.1], atol=0.05)


def test_command_writes_every_run(tmp_path):
    names = [tmp_path / f"cloud.{end}" for end in ("csv", "json", "png")]
    for name in names:
        assert run(["sample", str(OFFICE), "-n", "6", "--every", "10", "--seed", "1", "-o", str(name)]) == 0
    with names[0].open() as file:
        rows = list(csv.DictReader(file))
    places = json.loads(names[1].read_text())["places"]
    assert len(rows) == 6 * len(places)
    last = [float(row["x_m"]) for row in rows if float(row["distance_m"]) == places[-1]["distance_m"]]
    assert np.mean(last) == pytest.approx(places[-1]["mean_xyt"][0])


def test_motion_options_beside_a_bag_are_refused(capsys):
    assert run(["sample", str(OFFICE), "--end", "1,0,0"]) == 2
    assert "--end" in capsys.readouterr().err
