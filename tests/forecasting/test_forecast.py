"""What a bag is like and what would move, and what a model will do to a drive, before it is done."""

import json

import numpy as np
import pytest
from bagged import IMU, ODOM, OTHER, TF, TRUTH, MemoryBag, blocks_of, odometry, robot, transforms, twists
from drives import model, office, silent
from test_run import FIXTURES

from odomcorrupt.api.model import Model
from odomcorrupt.api.preview import Preview
from odomcorrupt.bags.block import Channel
from odomcorrupt.cli import run
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.corruption.transform import Options
from odomcorrupt.effects import effect_from_values
from odomcorrupt.errors import TopicError
from odomcorrupt.forecasting import CleanDrive, forecast, read_clean_drive
from odomcorrupt.geometry.se2 import compose, inverse
from odomcorrupt.inspection import CovarianceCheck, scan_bag, summarise, summary_text

T, POSES = office(10.0, 40.0)
DRIVE = CleanDrive("/odom", T, POSES)


def outlook_of(chosen, seed=1, runs=2, drive=DRIVE, first=0):
    paths = (NoisyPath(chosen, seed, run) for run in range(first, first + runs))
    return forecast(drive, chosen, paths, first_run=first)


def preview_of(chosen, **options):
    return Preview(outlook_of(chosen, **options), Model.of(chosen), 1)


def bag(messages):
    return MemoryBag(blocks_of(messages), {c.id: c for c in (ODOM, TF, IMU)})


def test_the_clean_drive_is_the_longest_stretch():
    t, poses = office(20.0, 8.0)
    short = [(ODOM, int(s), odometry(s, p)) for s, p in zip(t[:40], poses[:40], strict=True)]
    later = [(c, log + 10**10, data) for c, log, data in robot(t, poses)]
    drive = read_clean_drive(bag(short + later), model(), Options())
    assert drive.name == "/odom"
    assert np.array_equal(drive.stamps_ns, t)
    assert drive.xyt == pytest.approx(poses)


def test_without_odometry_there_is_no_forecast():
    with pytest.raises(TopicError):
        read_clean_drive(MemoryBag([], {IMU.id: IMU}, name="x"), model(), Options())


def test_rows_are_the_moments_of_its_runs():
    outlook = outlook_of(model(), 1, 50)
    errors = np.array([NoisyPath(model(), 1, k).feed(T, POSES).error_xyt[-1] for k in range(50)])
    end = outlook.rows[-1]
    assert outlook.noisy_xy[1][-1] - outlook.clean_xy[-1] == pytest.approx(errors[1, :2])
    assert end.after_m == pytest.approx(outlook.distance_m)
    assert end.position_rms_m == pytest.approx(np.sqrt(np.mean(errors[:, :2] ** 2) * 2))
    assert end.heading_rms_rad == pytest.approx(np.sqrt(np.mean(errors[:, 2] ** 2)))
    assert np.mean(np.hypot(errors[:, 0], errors[:, 1]) <= end.position_90_m) == pytest.approx(0.9, abs=0.021)
    assert [row.after_m for row in outlook.rows[:-1]] == [1.0, 2.0, 5.0, 10.0]


@pytest.mark.parametrize(
    ("chosen", "depends"),
    [(model(), False), (model("linear"), True), (model("linear", step="0.25m,0.2rad"), False), (model("omni"), True)],
)
def test_it_says_whether_the_message_rate_matters(chosen, depends):
    shown = preview_of(chosen)
    assert shown.to_dict()["depends_on_rate"] == depends
    assert ("noise depends on the message rate" in shown.details()) == depends


def test_half_the_rate_makes_a_linear_law_drift_by_the_square_root_of_two():
    assert outlook_of(model("linear")).half_rate_heading == pytest.approx(np.sqrt(2), rel=0.05)


def test_jitter_of_the_recording_is_not_blamed_on_the_law():
    rng = np.random.default_rng(3)
    shaken = CleanDrive("/odom", T, POSES + np.array([0.0, 0.0, 0.01]) * rng.standard_normal(POSES.shape))
    shown = preview_of(model(), drive=shaken)
    text = shown.details()
    assert "The noise does not depend on the message rate. This recording does: jitter between messages" in text
    assert f"heading {shown.result.half_rate_heading:.3g} times as uncertain" in text
    assert not shown.to_dict()["depends_on_rate"]


def test_a_robot_that_strafes_is_warned_of_a_law_that_does_not_know_it():
    aside = CleanDrive("/odom", T, np.column_stack((0.0 * T, np.linspace(0.0, 5.0, len(T)), 0.0 * T)))
    shown = preview_of(model("linear"), drive=aside)
    assert "The robot moves sideways (5 m of 5 m), which the law linear does not model" in shown.details()
    assert shown.to_dict()["warnings"]
    assert not preview_of(model("omni"), drive=aside).to_dict()["warnings"]


def test_effects_are_reported_as_the_constant_part():
    chosen = silent([effect_from_values("wheel_scale", {"e": 0.01})])
    shown = preview_of(chosen)
    assert shown.result.rows[-1].position_mean_m == pytest.approx(shown.result.rows[-1].position_rms_m)
    assert "of it constant" in shown.details()
    assert "of it constant" not in preview_of(model()).details()


def test_the_command_prints_a_table_or_values_and_draws(invoke, tmp_path):
    office_bag, picture = str(FIXTURES / "office.mcap"), tmp_path / "fan.svg"
    captured = invoke(["preview", "-v", office_bag, "--runs", "3", "--alpha", "0.1", "0", "0", "0", "-o", picture])
    assert "over /odom: 25.05 m in 59.98 s at 50 Hz\nmodel    Law diffusion, rot_rot 0.1 " in captured.out
    assert picture.read_bytes().startswith(b"<?xml")
    corruption = "--seed 4 --run 3 --keep-truth /x --twist keep --compression lz4 --keep-localisation"
    assert "runs 3 to 5 of seed 4" in invoke(["preview", "-v", office_bag, "--runs", "3", *corruption.split()]).out
    values = json.loads(invoke(["preview", office_bag, "--runs", "3", "--run", "3", "--json"]).out)
    assert (values["runs"], values["first_run"]) == (3, 3)
    assert b"message rate" not in picture.read_bytes()
    rated = tmp_path / "rated.svg"
    assert run(["preview", "-v", office_bag, "--runs", "3", "--preset", "article", "-o", str(rated)]) == 0
    assert b"at 50 Hz; the noise depends on the message rate" in rated.read_bytes()
    assert run(["preview", office_bag, "-o", str(tmp_path / "fan.gif")]) == 2
    assert "exists already" in invoke(["preview", office_bag, "-o", picture], 1).err
    captured = invoke(["preview", office_bag, "-o", tmp_path / "nowhere" / "fan.png"], 1)
    assert (captured.out, "nowhere does not exist; create it first" in captured.err) == ("", True)


@pytest.mark.parametrize("command", ["info", "preview"])
def test_damaged_bags_are_read_on_request_and_what_is_lost_is_said(invoke, tmp_path, command):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes((FIXTURES / "office.mcap").read_bytes()[:200_000])
    assert "--recover saves the intact part" in invoke([command, cut], 1).err
    captured = invoke([command, cut, "--recover"], 3)
    assert "Lost: " in captured.err
    assert "/odom" in captured.out


DRIVEN = office(20.0, 20.0)
STATIC = Channel(6, "/tf_static", TF.msgtype, "cdr")
CHANNELS = {c.id: c for c in (ODOM, TF, IMU, OTHER, TRUTH, STATIC)}


def look(messages, **asked):
    options = {"odom_topic": None, "odom_frame": None, "base_frame": None} | asked
    return summarise(scan_bag(MemoryBag(blocks_of(messages), CHANNELS)), **options)


def alone(t, poses, **options):
    return [(ODOM, int(s), odometry(s, p, w, **options)) for s, p, w in zip(t, poses, twists(t, poses), strict=True)]


def test_a_sound_bag_has_its_topics_edges_and_drive_reported_and_no_oddities():
    values = look(robot(*DRIVEN))
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
    t, poses = DRIVEN
    off = compose(poses, np.array([0.3, 0.0, 0.0]))
    for edge in (lambda p: ("odom", "base_link", p), lambda p: ("base_link", "odom", inverse(p))):
        messages = alone(t, poses) + [(TF, int(s), transforms((s, *edge(p)))) for s, p in zip(t, off, strict=True)]
        (odom,) = look(messages)["odometry"]
        assert odom["tf_differs_m"] == pytest.approx(0.3, abs=1e-6)


def test_twists_in_the_odom_frame_zero_twists_and_wrong_ones_are_noticed():
    t, poses = DRIVEN
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
    t, poses = DRIVEN
    made = twists(t, poses)
    made[100] = broken
    (odom,) = look([(ODOM, int(s), odometry(s, p, w)) for s, p, w in zip(t, poses, made, strict=True)])["odometry"]
    (sentence,) = [sentence for sentence in odom["oddities"] if "twists" in sentence]
    assert said in sentence


def test_one_twist_that_is_no_number_does_not_hide_that_the_others_do_not_fit():
    t, poses = DRIVEN
    made = twists(t, poses) * 3
    made[100, 2] = np.nan
    (odom,) = look([(ODOM, int(s), odometry(s, p, w)) for s, p, w in zip(t, poses, made, strict=True)])["odometry"]
    assert sum("twists" in sentence for sentence in odom["oddities"]) == 2


def test_restarts_swaps_jumps_zero_stamps_and_broken_poses_are_counted():
    t, poses = DRIVEN
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
    (odom,) = look([(ODOM, int(s), odometry(0, p)) for s, p in zip(*DRIVEN, strict=True)])["odometry"]
    assert "401 of 401 stamps are zero: log times are used instead" in odom["oddities"]


def test_sideways_motion_points_to_the_omni_law():
    t, _ = DRIVEN
    poses = np.column_stack((np.zeros(len(t)), np.linspace(0, 5, len(t)), np.zeros(len(t))))
    assert "moves sideways (5 m): --law omni" in summary_text(look(alone(t, poses)))


def test_what_needs_a_choice_is_remarked():
    several = [*robot(*DRIVEN), *((TRUTH, int(s), odometry(s, p)) for s, p in zip(*DRIVEN, strict=True))]
    assert "several nav_msgs/Odometry topics" in look(several)["remarks"][0]
    assert look(several, odom_topic="truth")["odometry_source"] == "/truth"
    with pytest.raises(TopicError, match="/odom, /truth is"):
        look(several, odom_topic="/imu")
    in_map = look(alone(*DRIVEN, frame="map"))
    assert "'map'" in in_map["remarks"][0]
    assert not in_map["odometry"][0]["moved"]
    assert look(alone(*DRIVEN, frame="map"), odom_frame="map")["odometry"][0]["moved"]
    static = [(STATIC, int(DRIVEN[0][0]), transforms((DRIVEN[0][0], "odom", "base_link", (0, 0, 0))))]
    assert "cannot follow a drift" in look(static + alone(*DRIVEN))["remarks"][0]
    assert "TF alone can be corrupted" in look(static)["remarks"][0]


@pytest.mark.parametrize("turned", [False, True])
def test_transforms_alone_are_described_where_their_frames_are_named(turned):
    t, poses = DRIVEN
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
    t, _ = DRIVEN
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


def test_the_command_prints_text_or_values(capsys, invoke, tmp_path):
    office_bag = str(FIXTURES / "office.mcap")
    text = invoke(["info", "-v", office_bag]).out
    assert "/odom (odom -> base_link, 50 Hz): the odometry to corrupt" in text
    assert "static edges that stay" in text
    assert run(["info", office_bag, "--json"]) == 0
    wheels = [f"/tf base_link -> wheel_{side}_link" for side in ("left", "right")]
    assert json.loads(capsys.readouterr().out)["still_true"] == ["/imu", *wheels]
    assert invoke(["info", tmp_path / "none.bag"], 1).err.count("\n") == 1


def test_two_publishers_of_one_topic_are_said_and_a_shuttle_or_a_dithering_encoder_is_not():
    t, poses = DRIVEN
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
