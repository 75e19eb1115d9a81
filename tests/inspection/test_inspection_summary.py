"""What a bag is like, and what would move."""

import json

import numpy as np
import pytest
from bagged import IMU, ODOM, OTHER, TF, TRUTH, MemoryBag, blocks_of, odometry, robot, transforms, twists
from drives import office

from odomcorrupt.bags.block import Channel
from odomcorrupt.cli import run
from odomcorrupt.errors import TopicError
from odomcorrupt.geometry.se2 import compose, inverse
from odomcorrupt.inspection import CovarianceCheck, scan_bag, summarise, summary_text

DRIVE = office(20.0, 20.0)
STATIC = Channel(6, "/tf_static", TF.msgtype, "cdr")
CHANNELS = {c.id: c for c in (ODOM, TF, IMU, OTHER, TRUTH, STATIC)}


def look(messages, **asked):
    options = {"odom_topic": None, "odom_frame": None, "base_frame": None} | asked
    return summarise(scan_bag(MemoryBag(blocks_of(messages), CHANNELS)), **options)


def alone(t, poses, **options):
    return [(ODOM, int(s), odometry(s, p, w, **options)) for s, p, w in zip(t, poses, twists(t, poses), strict=True)]


def test_a_sound_bag_has_its_topics_edges_and_drive_reported_and_no_oddities():
    values = look(robot(*DRIVE))
    assert (values["odometry_source"], values["odom_frame"], values["base_frame"]) == ("/odom", "odom", "base_link")
    assert {t["topic"]: t["messages"] for t in values["topics"]} == {"/imu": 401, "/odom": 401, "/tf": 401}
    assert {f"{e['parent']} -> {e['child']}": e["moved"] for e in values["edges"]} == {
        "odom -> base_link": True, "map -> odom": False, "base_link -> laser": False,
    }  # fmt: skip
    (odom,) = values["odometry"]
    assert odom["moved"]
    assert odom["distance_m"] == pytest.approx(8 * 0.6 + 4 * 0.5 + 3 * 0.3, rel=0.02)
    assert odom["reverse_m"] == pytest.approx(0.9, rel=0.05)
    assert odom["standing_s"] == pytest.approx(2.0, abs=0.11)
    assert odom["rate_hz"] == pytest.approx(20.0)
    assert odom["sideways_m"] < 0.01
    assert odom["tf_differs_m"] < 1e-9
    assert [sentence for sentence in odom["oddities"] if "covariance" not in sentence] == []
    assert values["still_true"] == ["/imu"]
    (remark,) = values["remarks"]
    assert remark.startswith("recorded localisation stays, and")
    assert "--exclude-topic /tf:map.odom" in remark


def test_odometry_and_tf_that_differ_are_found_in_both_directions():
    t, poses = DRIVE
    off = compose(poses, np.array([0.3, 0.0, 0.0]))
    for edge in (lambda p: ("odom", "base_link", p), lambda p: ("base_link", "odom", inverse(p))):
        messages = alone(t, poses) + [(TF, int(s), transforms((s, *edge(p)))) for s, p in zip(t, off, strict=True)]
        (odom,) = look(messages)["odometry"]
        assert odom["tf_differs_m"] == pytest.approx(0.3, abs=1e-6)


def test_twists_in_the_odom_frame_zero_twists_and_wrong_ones_are_noticed():
    t, poses = DRIVE
    rates = np.vstack((np.zeros(3), np.diff(poses, axis=0) / np.diff(t)[:, None] * 1e9))
    for made, sentence in ((rates, "odom frame"), (rates * 0, "all zero while"), (twists(t, poses) * 3, "do not fit")):
        messages = [(ODOM, int(s), odometry(s, p, w)) for s, p, w in zip(t, poses, made, strict=True)]
        (odom,) = look(messages)["odometry"]
        assert any(sentence in said for said in odom["oddities"])


@pytest.mark.parametrize(
    ("broken", "said"),
    [(1e300, "do not fit"), (-1e300, "do not fit"), (np.inf, "1 twists are not"), (np.nan, "1 twists are not")],
)
def test_a_damaged_twist_is_reported_and_overflows_nothing(broken, said):
    t, poses = DRIVE
    made = twists(t, poses)
    made[100] = broken
    (odom,) = look([(ODOM, int(s), odometry(s, p, w)) for s, p, w in zip(t, poses, made, strict=True)])["odometry"]
    (sentence,) = [sentence for sentence in odom["oddities"] if "twists" in sentence]
    assert said in sentence


def test_one_twist_that_is_no_number_does_not_hide_that_the_others_do_not_fit():
    t, poses = DRIVE
    made = twists(t, poses) * 3
    made[100, 2] = np.nan
    (odom,) = look([(ODOM, int(s), odometry(s, p, w)) for s, p, w in zip(t, poses, made, strict=True)])["odometry"]
    assert sum("twists" in sentence for sentence in odom["oddities"]) == 2


def test_restarts_swaps_jumps_zero_stamps_and_broken_poses_are_counted():
    t, poses = DRIVE
    poses = poses.copy()
    poses[200:, 0] += 40.0
    poses[50, 1] = np.nan
    stamps = t.copy()
    stamps[120] += 100 * 10**9
    messages = [(c, int(log), data) for log, (c, _, data) in zip(t, alone(stamps, poses), strict=True)]
    messages[20], messages[22] = messages[22], messages[20]
    later = [(c, log + 30 * 10**9, data) for c, log, data in messages]
    (odom,) = look(messages + later)["odometry"]
    assert (odom["restarts"], odom["jumps"]) == (1, 2)
    assert odom["swapped"] == 4
    assert {"2 poses are not numbers", "2 stamps lie far ahead of their neighbours'"} <= set(odom["oddities"])
    assert odom["duration_s"] < 60.0
    (odom,) = look([(ODOM, int(s), odometry(0, p)) for s, p in zip(*DRIVE, strict=True)])["odometry"]
    assert "401 of 401 stamps are zero: log times are used instead" in odom["oddities"]


def test_sideways_motion_points_to_the_omni_law():
    t, _ = DRIVE
    poses = np.column_stack((np.zeros(len(t)), np.linspace(0, 5, len(t)), np.zeros(len(t))))
    assert "moves sideways (5 m): --law omni" in summary_text(look(alone(t, poses)))


def test_what_needs_a_choice_is_remarked():
    several = [*robot(*DRIVE), *((TRUTH, int(s), odometry(s, p)) for s, p in zip(*DRIVE, strict=True))]
    assert "several nav_msgs/Odometry topics" in look(several)["remarks"][0]
    assert look(several, odom_topic="truth")["odometry_source"] == "/truth"
    with pytest.raises(TopicError, match="/odom, /truth is"):
        look(several, odom_topic="/imu")
    in_map = look(alone(*DRIVE, frame="map"))
    assert "'map'" in in_map["remarks"][0]
    assert not in_map["odometry"][0]["moved"]
    assert look(alone(*DRIVE, frame="map"), odom_frame="map")["odometry"][0]["moved"]
    static = [(STATIC, int(DRIVE[0][0]), transforms((DRIVE[0][0], "odom", "base_link", (0, 0, 0))))]
    assert "cannot follow a drift" in look(static + alone(*DRIVE))["remarks"][0]
    assert "TF alone can be corrupted" in look(static)["remarks"][0]


@pytest.mark.parametrize("turned", [False, True])
def test_transforms_alone_are_described_where_their_frames_are_named(turned):
    t, poses = DRIVE
    edge = (lambda p: ("base_link", "odom", inverse(p))) if turned else (lambda p: ("odom", "base_link", p))
    messages = [(TF, int(s), transforms((0, *edge(p)))) for s, p in zip(t, poses, strict=True)]
    values = look(messages, odom_frame="/odom", base_frame="base_link", odom_topic="/tf")
    (drive,) = values["odometry"]
    assert values["odometry_source"] == drive["topic"] == "TF odom -> base_link"
    assert drive["distance_m"] == pytest.approx(8 * 0.6 + 4 * 0.5 + 3 * 0.3, rel=0.02)
    assert drive["reverse_m"] == pytest.approx(0.9, rel=0.05)
    assert drive["oddities"] == ["401 of 401 stamps are zero: log times are used instead"]
    assert values["remarks"] == ["no nav_msgs/Odometry topic: TF is the odometry"]
    assert "no transform between odom and wheel" in look(messages, odom_frame="odom", base_frame="wheel")["remarks"][0]


def test_a_robot_that_never_reverses_has_gone_no_way_backwards_of_either_sign():
    t, _ = DRIVE
    straight = np.column_stack((np.linspace(0.0, 5.0, len(t)), np.zeros(len(t)), np.zeros(len(t))))
    assert "(0.00 m of it backwards)" in summary_text(look(alone(t, straight)))


@pytest.mark.parametrize(
    ("make", "said"),
    [(lambda c: c * 0, "are all zero"),
    (lambda c: c, "never change"),
    (lambda c: c * np.linspace(1, 2, 5)[:, None], None),
    (lambda c: c * 1e9, 'mean "unknown" (up to 1e+07)'),
    (lambda c: -c, "are negative or not numbers"),
    (lambda c: c * np.nan, "are negative or not numbers"),
    (lambda c: c + np.eye(36)[1], "are not symmetric, or not positive")],
)  # fmt: skip
def test_odd_covariances_are_named(make, said):
    watch = CovarianceCheck()
    covariances = make(np.tile((0.01 * np.eye(6)).ravel(), (5, 1)))
    watch.take(covariances[:2])
    watch.take(covariances[2:])
    assert watch.oddity(never_changes=True) == said


def test_the_command_prints_text_or_values(capsys, tmp_path):
    from test_run import FIXTURES

    office_bag = str(FIXTURES / "office.mcap")
    assert run(["info", "-v", office_bag]) == 0
    text = capsys.readouterr().out
    assert "/odom (odom -> base_link, 50 Hz): the odometry to corrupt" in text
    assert "static edges that stay" in text
    assert run(["info", office_bag, "--json"]) == 0
    wheels = [f"/tf base_link -> wheel_{side}_link" for side in ("left", "right")]
    assert json.loads(capsys.readouterr().out)["still_true"] == ["/imu", *wheels]
    assert run(["info", str(tmp_path / "none.bag")]) == 1
    assert capsys.readouterr().err.count("\n") == 1


def test_two_publishers_of_one_topic_are_said_and_a_shuttle_or_a_dithering_encoder_is_not():
    t, poses = DRIVE
    beside = compose(np.array([0.3, 0.1, 0.09]), poses)
    both = np.stack((poses, beside), axis=1).reshape(-1, 3)
    stamps = np.stack((t, t + 21_000_000), axis=1).ravel()
    parked = np.tile(poses[:1], (len(t), 1))
    parked[1::2, 0] += 0.002
    shuttle = np.column_stack((np.sin(np.arange(len(t)) / 8.0), np.zeros((len(t), 2))))
    for stamped, path, alternate in ((stamps, both, True), (t, poses, False), (t, parked, False), (t, shuttle, False)):
        values = look([(ODOM, int(s), odometry(s, p)) for s, p in zip(stamped, path, strict=True)])
        said = [sentence for sentence in values["odometry"][0]["oddities"] if "two publishers" in sentence]
        assert bool(said) == alternate, said
        assert "inches" not in str(values)
