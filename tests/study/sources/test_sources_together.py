"""The truth of another drive is refused in one line; a matching one is accepted, however bad its quality."""

from dataclasses import replace

import numpy as np
import pytest
from hidden import as_recording
from wandering import noisy_path, recording, wander

from odomcorrupt.cli import run as command
from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import compose
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.simulation import Segment, Tracker, simulate, write_mcap
from odomcorrupt.study.io.plausibility import check_together, cross_correlation
from odomcorrupt.study.io.raw_trajectory import Samples

NONE = np.zeros(0)


def samples(path, name="/odom", *, headed=True):
    xy, yaw = path.xyt[:, :2], path.xyt[:, 2]
    xyz = np.column_stack((xy, np.zeros(len(xy))))
    stamps = path.stamps_ns
    return Samples(name, name, "", stamps, xyz, yaw if headed else yaw * np.nan, NONE.astype(np.int64), NONE)


def check(odometry, truth, *, headed=True):
    """Check two trajectories over the time that they share, which they start together."""
    late = samples(truth, "/truth", headed=headed)
    late = late.stamped(late.stamps_ns - late.stamps_ns[0] + odometry.stamps_ns[0])
    end = min(odometry.stamps_ns[-1], late.stamps_ns[-1])
    here = samples(odometry)
    check_together(here.only(here.stamps_ns <= end), late.only(late.stamps_ns <= end))


@pytest.fixture(scope="module")
def drives():
    return [as_recording(simulate(seed, None, duration_s=240.0)) for seed in (41, 42, 43, 44)]


@pytest.mark.parametrize("headed", [True, False])
def test_the_truth_of_another_drive_is_refused(drives, headed):
    for one in drives:
        for other in drives:
            if one is other:
                check(one.odometry, other.truth, headed=headed)
            else:
                with pytest.raises(RecordingError, match="/truth: does not move as /odom does"):
                    check(one.odometry, other.truth, headed=headed)


def test_the_command_says_so_in_one_line(tmp_path, capsys):
    for seed in (41, 42):
        write_mcap(simulate(seed, None, duration_s=120.0), tmp_path / f"{seed}.mcap")
    mixed = ["fit", str(tmp_path / "41.mcap"), "--truth-bag", str(tmp_path / "42.mcap"), "--truth", "/ground_truth"]
    assert command([*mixed, "--odom", "/odom"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "/ground_truth: does not move as /odom does (speeds correlate by 0." in line
    assert line.endswith("name the truth of this run")


def test_a_truth_that_is_silent_for_a_minute_is_compared_where_it_is_seen(drives):
    # a straight line across the gap would be a speed of its own: an hour of RTK with long float episodes was refused
    drive = drives[0]
    truth = drive.truth
    seconds = (truth.stamps_ns - truth.stamps_ns[0]) * 1e-9
    part = [i for i, s in enumerate(seconds) if s < 40.0 or 100.0 < s < 130.0 or s > 190.0]
    check(drive.odometry, replace(truth, stamps_ns=truth.stamps_ns[part], xyt=truth.xyt[part]), headed=False)
    alike = cross_correlation(
        drive.odometry, replace(truth, stamps_ns=truth.stamps_ns[part], xyt=truth.xyt[part]), 10.0
    )
    assert alike.speed.max() > cross_correlation(drive.odometry, truth, 10.0).speed.max() - 0.02


ROUTES = {
    "straight": (Segment(0.4, 0.0, 60.0),),
    "circle": (Segment(0.4, 0.3, 60.0),),
    "crawl": (Segment(0.03, 0.0, 60.0),),
    "spin": (Segment(0.0, 0.5, 60.0),),
    "shuttle": "shuttle",
    "slalom": "slalom",
}
WORST = Tracker(rate_hz=5.0, noise_m=0.05, noise_rad=0.05, dropouts_per_min=4.0, dropout_mean_s=3.0, wander_m=0.05)


@pytest.mark.parametrize("headed", [True, False])
@pytest.mark.parametrize("route", ROUTES)
def test_dull_drives_with_a_bad_truth_are_accepted(route, headed):
    run = simulate(45, None, duration_s=60.0, route=ROUTES[route], truth=WORST, drive_type="skid")
    seen = as_recording(run)
    check(seen.odometry, seen.truth, headed=headed)


@pytest.mark.parametrize("headed", [True, False])
def test_odometry_that_is_hardly_any_is_accepted(headed):
    """Metres and radians off after a few metres: white noise of every step, and slip of a third."""
    steps = wander(46, 240.0)
    noisy = recording(steps, noisy_path(steps, Coefficients(0.5, 0.5, 0.3, 0.3), 46), seed=46)
    check(noisy.odometry, noisy.truth, headed=headed)


def test_another_frame_and_a_late_clock_are_no_other_drive(drives):
    truth = samples(drives[0].truth, "/truth")
    turned = compose(np.array([30.0, -7.0, 2.0]), drives[0].truth.xyt)
    moved = truth.only(slice(None)).stamped(truth.stamps_ns + 2_500_000_000)
    moved = samples(type(drives[0].truth)(moved.stamps_ns, turned), "/truth")
    check_together(samples(drives[0].odometry), moved)
