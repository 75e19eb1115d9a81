"""Satellite fixes: metres of published lengths, float episodes, outages, and one origin for several recordings."""

import numpy as np
import pytest
from sourcebags import both
from sourcedrive import Rows, odometry, samples, truth

import odomcorrupt as oc
from odomcorrupt.geometry.se2 import compose
from odomcorrupt.model.motion_model import Origin
from odomcorrupt.study.io.fixes import east_north_up, frame_of, resolved, without_float_episodes


@pytest.mark.parametrize(
    ("latitude", "north_m", "east_m"),
    [
        # length of a degree of latitude and longitude on WGS 84, National Geospatial-Intelligence Agency tables
        (0.0, 110_574.3, 111_319.5),
        (30.0, 110_852.4, 96_486.3),
        (45.0, 111_131.7, 78_846.8),
        (60.0, 111_412.2, 55_800.0),
    ],
)
def test_small_steps_have_the_published_length_of_a_degree(latitude, north_m, east_m):
    small = 1e-3
    fixes = np.array([[latitude, 8.0, 0.0], [latitude + small, 8.0, 0.0], [latitude, 8.0 + small, 0.0]])
    plane = east_north_up(fixes)
    assert plane[1, 1] / small == pytest.approx(north_m, rel=2e-5)
    assert plane[2, 0] / small == pytest.approx(east_m, rel=2e-5)
    assert abs(plane[1, 0]) < 1e-6
    assert abs(plane[2, 1]) < 1e-2


def test_the_poles_are_as_far_from_the_centre_as_wgs84_says():
    pole = east_north_up(np.array([[0.0, 0.0, 0.0], [90.0, 0.0, 0.0]]))[1]
    np.testing.assert_allclose(pole, [0.0, 6_356_752.314245, -6_378_137.0], atol=1e-5)


def test_height_is_up_and_a_missing_one_does_no_harm():
    plane = east_north_up(np.array([[50.0, 8.0, 100.0], [50.0, 8.0, 130.0]]))
    np.testing.assert_allclose(plane[1], [0.0, 0.0, 30.0], atol=1e-6)
    assert np.isfinite(east_north_up(np.array([[50.0, 8.0, np.nan], [50.1, 8.0, np.nan]]))).all()


def test_frames_of_two_origins_agree_on_where_a_fix_lies():
    fixes = np.array([[48.1, 11.5, 520.0], [48.1031, 11.5064, 525.0], [48.1002, 11.5011, 519.0]])
    other = np.array([48.1043, 11.4946, 500.0])
    both = east_north_up(np.concatenate((other[None], fixes)))[1:]
    here, there = Origin(*fixes[0]), Origin(*other)
    moved = compose(frame_of(here, there), np.column_stack((east_north_up(fixes)[:, :2], [0] * 3)))
    np.testing.assert_allclose(moved[:, :2], both[:, :2], atol=2e-3)
    back = compose(frame_of(there, here), frame_of(here, there))
    np.testing.assert_allclose(back, 0.0, atol=2e-3)


NORTH_M, EAST_M = 111_194.0, 74_625.0
"""A degree of latitude, and of longitude at 48 degrees, by the published lengths."""
TIMES = np.arange(0.0, 100.0, 0.2)


def lla(xyz, latitude=48.0, longitude=8.0):
    return np.column_stack((latitude + xyz[:, 1] / NORTH_M, longitude + xyz[:, 0] / EAST_M, 500.0 + 0.0 * xyz[:, 0]))


def fixes(status, sigma_m, seconds=TIMES):
    place = lla(np.column_stack((seconds, 0.3 * seconds)))
    several = [np.broadcast_to(x, len(seconds)) for x in (status, sigma_m)]
    fixed = samples(seconds, place, np.full(len(seconds), np.nan), name="/fix", variance_m2=2.0 * several[1] ** 2)
    return fixed, several[0].astype(np.int8)


def between(*spans):
    return np.any([(first <= TIMES) & (last > TIMES) for first, last in spans], axis=0)


@pytest.mark.parametrize(
    ("status", "sigma_m"),
    [
        (np.where(between((20, 40), (70, 81)), 0, 2), 0.0),
        (2, np.where(between((20, 40), (70, 81)), 0.3, 0.014)),
        (-2, np.where(between((20, 40), (70, 81)), 0.15, 0.014)),
        (np.where(between((20, 40)), 0, 2), np.where(between((20, 40), (70, 81)), 0.3, 0.014)),
    ],
    ids=["status alone", "covariance alone", "status unknown", "both, in part"],
)
def test_float_episodes_are_left_out_and_said_in_one_line(status, sigma_m):
    found = resolved(*fixes(status, sigma_m))
    np.testing.assert_allclose(found.t_s, TIMES[~between((20, 40), (70, 81))])
    assert found.notes[0].startswith("/fix: 2 float episodes, 31 s, left out (155 of 500 fixes")


def test_an_episode_lasts_until_the_receiver_is_as_sure_again_as_it_is_when_fixed():
    settling = np.where(between((20, 60)), np.maximum(0.4 * np.exp(-(TIMES - 20.0) / 12.0), 0.04), 0.014)
    found = resolved(*fixes(2, settling))
    np.testing.assert_allclose(found.t_s, TIMES[~between((20, 60))])


def test_geometry_that_is_poor_for_a_while_is_no_episode():
    assert len(resolved(*fixes(2, np.where(between((20, 60)), 0.04, 0.014)))) == len(TIMES)


def test_a_moment_of_fixes_between_two_float_episodes_is_not_trusted():
    found = resolved(*fixes(np.where(between((20, 40), (41.5, 50)), 0, 2), 0.0))
    np.testing.assert_allclose(found.t_s, TIMES[~between((20, 50))])
    assert found.notes[0].startswith("/fix: 1 float episode, 30 s,")


@pytest.mark.parametrize(
    ("status", "sigma_m"),
    [(0, 0.0), (2, 0.014), (0, 1.2), (2, 0.012 + 0.03 * (TIMES > 50.0)), (np.where(between((0, 90)), 0, 2), 0.0)],
    ids=["a receiver that says nothing", "fixed", "single", "more than one geometry", "fixed for a tenth of the time"],
)
def test_of_fixes_that_are_alike_none_is_left_out(status, sigma_m):
    assert len(resolved(*fixes(status, sigma_m))) == len(TIMES)


def test_a_truth_that_mostly_floats_is_used_and_said_to_be_coarse():
    found = resolved(*fixes(np.where(between((0, 20)), 2, 2), np.where(between((0, 20)), 0.014, 0.3)))
    assert len(found) == len(TIMES)
    assert "only 20% of its fixes are as good as the best" in found.notes[0]


def test_messages_without_a_fix_are_left_out_and_outages_are_counted():
    silent, lost = between((30, 44)), between((60, 66))
    every, status = fixes(np.where(lost, -1, 2), 0.014)
    found = resolved(every.only(~silent), status[~silent])
    assert found.notes[:2] == ("/fix: 30 messages without a fix left out", "/fix: 2 outages, 20 s without any fix")
    assert len(found) == np.sum(~silent & ~lost)


@pytest.mark.parametrize("by", ["variance", "status"])
def test_a_recording_with_float_episodes_has_a_truth_without_them(read, by):
    moved, real = odometry(), truth()
    place = lla(real.xyz)
    floating = (np.arange(len(place)) > 300) & (np.arange(len(place)) < 500)
    place[floating, 0] += 0.4 / NORTH_M
    claims = {by: np.where(floating, 0.18, 4e-4) if by == "variance" else 2 - 2 * floating}
    given = Rows(real.stamps_ns, place, real.yaw)
    (run,) = read(moved, given, truth="/fix", kind="NavSatFix", seen=claims, asked={"truth": "/fix"})
    assert any("/fix: 1 float episode, 6 s, left out (199 of 990 fixes" in note for note in run.notes)
    assert not np.isin(run.truth.stamps_ns, real.stamps_ns[floating]).any()


def two_runs(tmp_path):
    """Bags of two drives over the same ground, the second begun elsewhere; the first fix of each is its own origin."""
    real = truth(40.0)
    late = real.only(slice(330, None))
    for name, rows in (("first", real), ("second", late)):
        seen = rows.having(xyz=lla(rows.xyz))
        both(tmp_path / f"{name}.mcap", odometry(40.0), seen, truth="/fix", kind="NavSatFix")
    return tmp_path / "first.mcap", tmp_path / "second.mcap", late


def test_recordings_read_together_share_the_origin_of_the_first(tmp_path):
    first, second, late = two_runs(tmp_path)
    both, alone = oc.read_recordings([first, second]), oc.read_recordings(second)
    assert both[0].geodetic_origin == both[1].geodetic_origin != alone[0].geodetic_origin
    start = truth(40.0).xyz[0, :2]
    np.testing.assert_allclose(both[1].truth.xyt[0, :2], late.xyz[0, :2] - start, atol=0.01)
    np.testing.assert_allclose(alone[0].truth.xyt[0, :2], 0.0, atol=1e-9)


def test_the_origin_of_a_fit_is_kept_in_the_model_file(tmp_path):
    first, _, _ = two_runs(tmp_path)
    oc.fit(first).model.save(tmp_path / "robot.toml")
    origin = oc.Model.load(tmp_path / "robot.toml").motion_model.setup.origin
    assert (origin.latitude_deg, origin.longitude_deg) == pytest.approx(tuple(lla(truth(40.0).xyz)[0, :2]), abs=1e-9)


PATCH_MODEL = """
schema = 1
[noise]
rot_rot = 0.02
rot_trans = 0.01
trans_trans = 0.02
trans_rot = 0.0
[[effect]]
name = "region_slip"
slip = 0.3
x = {x}
y = {y}
radius = 4.0
[setup]
origin = {{ latitude = {latitude}, longitude = {longitude} }}
"""


def test_a_patch_learned_on_one_origin_holds_in_a_recording_with_another(tmp_path):
    t = np.arange(0.0, 90.0, 0.05)
    angle = 0.2 * t
    xyz = np.column_stack((8.0 * np.sin(angle), 8.0 * (1.0 - np.cos(angle)), 0.0 * t))
    patch, away = np.array([8.0, 8.0]), np.array([60.0, -45.0])
    inside = np.hypot(*(xyz[:, :2] - patch).T) < 4.0
    said = np.cumsum(0.2 * 0.05 / np.where(inside, 0.7, 1.0))
    steps = 8.0 * np.diff(said, prepend=0.0)[:, None] * np.column_stack((np.cos(said), np.sin(said)))
    stamps = (1.7e18 + t * 1e9).astype(np.int64)
    moved = Rows(stamps, np.column_stack((np.cumsum(steps, axis=0), 0.0 * t)), said)
    noise = 0.01 * np.random.default_rng(3).standard_normal((len(t), 3))
    here = Rows(stamps, lla(xyz + noise), angle)
    bag = both(tmp_path / "run.mcap", moved, here, truth="/fix", kind="NavSatFix")
    runs, errors = oc.read_recordings(bag), {}
    for name, offset in (("agrees", away), ("ignored", np.zeros(2))):
        x, y = patch + away
        latitude, longitude = 48.0 - offset[1] / NORTH_M, 8.0 - offset[0] / EAST_M
        (tmp_path / f"{name}.toml").write_text(PATCH_MODEL.format(x=x, y=y, latitude=latitude, longitude=longitude))
        compared = oc.compare(runs, tmp_path / f"{name}.toml").result
        errors[name] = compared.evaluations[0].ten_second_error_m / compared.clock_error_m
    assert errors["agrees"] < 0.3
    assert errors["ignored"] > 0.95


@pytest.mark.parametrize("headed", [False, True], ids=["positions", "a localisation"])
def test_positions_that_a_receiver_publishes_as_poses_lose_float_episodes_too(headed):
    sigma_m = np.where(between((20, 40), (70, 81)), 0.3, 0.014)
    yaw = np.zeros(len(TIMES)) if headed else np.full(len(TIMES), np.nan)
    xyz = np.column_stack((TIMES, TIMES, TIMES))
    poses = samples(TIMES, xyz, yaw, name="/gps_pose", frame="map", variance_m2=2.0 * sigma_m**2)
    left = without_float_episodes(poses)
    assert len(left) == (500 if headed else 345)
    assert headed or "2 float episodes, 31 s, left out" in left.notes[0]
