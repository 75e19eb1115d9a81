"""`correct` on bags, and what it does to arrays: effects undone, biases read at rest, and steps of a filter."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
from bagged import rows_of

from evo_oracle import as_evo, evo_metrics
from odomcorrupt.api.corruption import correct
from odomcorrupt.cli import run
from odomcorrupt.correction.run import CorrectedPath, corrected_samples
from odomcorrupt.correction.undo import ClockInverse, pose_corrections, true_stamps, undo_effects
from odomcorrupt.corruption.covariance import pose_covariance
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.effects.effect import parameters
from odomcorrupt.effects.expression import user_effect
from odomcorrupt.effects.gains import WheelScale
from odomcorrupt.effects.heading_sensors import GyroBias
from odomcorrupt.effects.random_processes import GyroBiasWalk
from odomcorrupt.errors import BagError, EffectError
from odomcorrupt.geometry.se2 import Increments, accumulate, compose, increments, inverse, wrap
from odomcorrupt.model.model_file import format_model, parse_model
from odomcorrupt.model.motion_model import MotionModel, Noise, Setup
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.simulation import simulate, write_mcap
from recordings import FIXTURES, OFFICE
from test_refusals import ROBOT as NOISE

EDGE = ("odom", "base_link")
BAGS = ["office.bag", "office.mcap", "office_ros2"]
EFFECTS = ["unequal_wheels:curvature=0.02", "gyro_bias:bias=0.004", "accel_slip:k=0.03", "slope:creep=0.02"]


def flags(effects):
    return [word for effect in effects for word in ("--effect", effect)]


def differ(ours, theirs):
    off = ours - theirs
    off[:, 2] = wrap(off[:, 2])
    return np.abs(off).max()


def there_and_back(folder, given, *more, back=None, name="office.mcap"):
    """Return a bag, the same one corrupted by what is given and more, and that one corrected by `back` or the same."""
    source, wrong, right = FIXTURES / name, folder / f"w_{name}", folder / f"r_{name}"
    assert run([str(source), str(wrong), *given, *more]) == 0
    assert run(["correct", "-v", str(wrong), str(right), *(given if back is None else back)]) == 0
    return source, wrong, right


@pytest.fixture(scope="module", params=BAGS)
def trio(request, tmp_path_factory):
    return there_and_back(tmp_path_factory.mktemp("trio"), flags(EFFECTS), name=request.param)


def test_poses_and_twists_come_back_and_covariances_stay_where_the_model_has_no_noise(trio):
    was, wrong, right = (rows_of(path, "/odom") for path in trio)
    assert differ(wrong.xyt, was.xyt) > 0.1
    assert differ(right.xyt, was.xyt) < 1e-6
    assert np.array_equal(right.stamps_ns, was.stamps_ns)
    assert np.abs(wrong.twist - was.twist).max() > 0.003
    np.testing.assert_allclose(right.twist, was.twist, atol=1e-6)
    assert np.array_equal(was.pose_covariance, right.pose_covariance)


def test_transforms_agree_with_the_odometry(trio):
    was, wrong, right = (rows_of(path, "/tf", EDGE) for path in trio)
    assert differ(wrong.xyt, was.xyt) > 0.1
    assert differ(right.xyt, was.xyt) < 1e-6
    odometry = rows_of(trio[2], "/odom")
    shared, ours, theirs = np.intersect1d(odometry.stamps_ns, right.stamps_ns, return_indices=True)
    assert len(shared) > 10
    assert differ(odometry.xyt[ours], right.xyt[theirs]) < 1e-9


@pytest.mark.parametrize(("effect", "said"), [("", "set-up lever_arm ("), ("wheel_scale", "; not lever_arm (")])
def test_a_lever_arm_is_said_to_be_no_part_of_the_odometry(tmp_path, effect, said, invoke):
    arm = '[[setup.effect]]\nname = "lever_arm"\nx = 0.25\ny = 0.0\n'
    own = f'[[effect]]\nname = "{effect}"\ne = 0.02\n' if effect else ""
    (tmp_path / "robot.toml").write_text(f"{NOISE}\n{own}[setup]\n{arm}")
    words = ["correct", OFFICE, tmp_path / "right.mcap", "--model", tmp_path / "robot.toml", "--force"]
    assert f"{said}the truth's tracked point)" in " ".join(invoke(words).err.split())
    assert "tracked point" not in invoke([*words, "--effect", "lever_arm:x=0.25"]).err


@pytest.mark.parametrize("choice", ["model", "keep"])
def test_covariances_are_the_noise_that_remains_or_stay(tmp_path, choice, invoke):
    (tmp_path / "robot.toml").write_text(f'{NOISE}\n[[effect]]\nname = "wheel_scale"\ne = 0.02\n')
    words = ["correct", OFFICE, tmp_path / "out.mcap", "--covariance", choice]
    said = invoke([*words, "-v", "--model", tmp_path / "robot.toml"]).err
    was, now = (rows_of(path, "/odom") for path in (OFFICE, tmp_path / "out.mcap"))
    same = np.array_equal(was.pose_covariance, now.pose_covariance)
    assert same == (choice == "keep")
    if choice == "model":
        heading = now.pose_covariance[:, 35]
        assert heading[0] < 1e-8
        assert (np.diff(heading) >= 0.0).all()
        assert "remains    noise: " in said


def test_clocks_given_as_effects_are_put_right(tmp_path):
    effects = ["time_offset:offset=0.25", "clock_skew:rate=0.0001", "wheel_scale:e=0.02"]
    source, wrong, right = there_and_back(tmp_path, flags(effects))
    was, off, back = (rows_of(path, "/odom") for path in (source, wrong, right))
    assert (off.stamps_ns - was.stamps_ns).min() >= 250_000_000
    assert np.abs(back.stamps_ns - was.stamps_ns).max() <= 1
    assert differ(back.xyt, was.xyt) < 1e-6
    edge = rows_of(right, "/tf", EDGE)
    assert np.abs(edge.stamps_ns - rows_of(source, "/tf", EDGE).stamps_ns).max() <= 1


def test_what_cannot_be_undone_is_said_and_setup_is_left_alone(tmp_path, invoke):
    (tmp_path / "robot.toml").write_text(
        f'{NOISE}\n[[effect]]\nname = "wheel_scale"\ne = 0.02\n[[effect]]\nname = "gauss_markov"\nsigma = 0.02\n'
        '[[effect]]\nname = "quantization"\nstep = 0.001\n[setup]\ntruth_xy = 0.001\n[[setup.effect]]\n'
        'name = "lever_arm"\nx = 0.5\ny = 0.0\n[robot]\ntrack = 0.4\n'
    )
    out = [tmp_path / "with.mcap", tmp_path / "plain.mcap"]
    said = invoke(["correct", "-v", OFFICE, out[0], "--model", tmp_path / "robot.toml"]).err
    assert "taken out  wheel_scale (e 0.02)" in said
    assert "gauss_markov: its random course was not recorded" in said
    assert "quantization: travel below the encoder's resolution" in said
    assert "[setup]" in said
    assert "lever_arm" in said
    invoke(["correct", "-v", OFFICE, out[1], "--effect", "wheel_scale:e=0.02"])
    assert np.array_equal(rows_of(out[0], "/odom").xyt, rows_of(out[1], "/odom").xyt)
    invoke(["correct", "-v", OFFICE, tmp_path / "arm.mcap", "--effect", "lever_arm:x=0.5,y=0"])
    assert differ(rows_of(tmp_path / "arm.mcap", "/odom").xyt, rows_of(OFFICE, "/odom").xyt) > 0.1


def test_steps_of_a_filter_are_taken_out_of_poses_and_not_of_twists(tmp_path, capsys):
    steps = [f"push:along=0.01,across={side},yaw=0.01,time={at},duration=0.02" for at, side in ((9, 0.02), (30, -0.02))]
    model = tmp_path / "robot.toml"
    model.write_text(f"{NOISE}\n[setup]\npose_corrections = true\n")
    trio = there_and_back(tmp_path, flags(steps), "--twist", "keep", back=["--model", str(model)])
    assert "taken out  a filter's steps towards poses" in capsys.readouterr().err
    was, off, back = map(rows_of, trio)
    assert differ(off.xyt, was.xyt) > 0.05
    assert differ(back.xyt, was.xyt) < 0.01
    np.testing.assert_allclose(back.twist, was.twist, atol=0.05)


@pytest.mark.parametrize("wheel", ["both", "left"])
@pytest.mark.parametrize("twist", ["model", "keep"])
def test_lost_increments_come_back_where_the_odometry_shows_them(tmp_path, twist, wheel, capsys):
    # breaks where what is seen in the log counts as chance, or where a twist that lost nothing gets the motion twice
    losses = ["--effect", f"lost_increments:fraction=0.05,wheel={wheel}", "--track", "0.4"]
    was, off, back = map(rows_of, there_and_back(tmp_path, losses, "--seed", "3", "--twist", twist))
    assert "taken out  lost_increments" in capsys.readouterr().err
    assert differ(back.xyt, was.xyt) < 0.1 * differ(off.xyt, was.xyt)
    assert np.mean(np.abs(back.twist - was.twist).max(axis=1) > 0.05) < 0.01


def test_a_truth_that_was_kept_in_the_frame_of_the_odometry_stays(tmp_path):
    effect = ["--effect", "wheelbase:e=0.05"]
    source, _, right = there_and_back(tmp_path, effect, "--keep-truth", "/truth", back=[*effect, "--odom", "/odom"])
    was = rows_of(source, "/odom")
    assert np.array_equal(rows_of(right, "/truth").xyt, was.xyt)
    assert differ(rows_of(right, "/odom").xyt, was.xyt) < 1e-6


def test_effects_of_single_wheels_take_the_track_from_the_command_line(tmp_path, invoke):
    wrong, right = tmp_path / "wrong.mcap", tmp_path / "right.mcap"
    play = ["--effect", "backlash:travel=0.02"]
    invoke([OFFICE, wrong, *play, "--track", "0.4"])
    assert "give it in metres with --track" in invoke(["correct", "-v", wrong, right, *play], 1).err
    invoke(["correct", "-v", wrong, right, *play, "--track", "0.4"])
    was, off, back = (rows_of(path, "/odom").xyt for path in (OFFICE, wrong, right))
    assert differ(back, was) < 0.2 * differ(off, was)


def test_effects_of_places_ask_where_the_drive_began(tmp_path, invoke):
    effect, start = ["--effect", "slope:creep=0.02"], rows_of(OFFICE, "/odom").xyt[0]
    said = invoke(["correct", "-v", OFFICE, tmp_path / "silent.mcap", *effect]).err
    assert "slope: taken out at places and headings of the frame odom, taken to be" in said
    same, turned = ("--start", ",".join(map(str, start))), ("--start", "0,0,180deg")
    for name, option in (("same", same), ("turned", turned)):
        assert "--start" not in invoke(["correct", "-v", OFFICE, tmp_path / f"{name}.mcap", *effect, *option]).err
    silent, same_path, other = (rows_of(tmp_path / f"{n}.mcap", "/odom").xyt for n in ("silent", "same", "turned"))
    assert differ(same_path, silent) < 1e-9
    assert differ(other, silent) > 0.05


def test_learned_effects_of_places_are_not_taken_out_before_their_frame_is_given(tmp_path, invoke):
    model, out = tmp_path / "robot.toml", tmp_path / "out.mcap"
    slope = '\n[[effect]]\nname = "slope"\ncreep = 0.02\n\n[source]\nrecordings = ["run.mcap"]\n'
    model.write_text(NOISE + slope)
    words = ["correct", OFFICE, out, "--model", model]
    assert "slope: depends on position or heading in the frame of the truth" in invoke(words, 2).err
    assert not out.exists()
    assert "--start" not in invoke([*words, "--start", "odom"]).err
    with pytest.raises(EffectError, match="give the pose at which this odometry begins"):
        correct(OFFICE, tmp_path / "other.mcap", model=model)
    assert invoke([OFFICE, tmp_path / "noisy.mcap", "--model", model]).err.splitlines()[1].startswith("places  ")


@pytest.mark.parametrize("learned_from", ["/odom", "/wheels", "/gone"])
def test_of_several_odometry_topics_the_one_that_was_learned_from_is_taken(tmp_path, invoke, learned_from):
    two, model = tmp_path / "two.mcap", tmp_path / "robot.toml"
    invoke([OFFICE, two, "--effect", "wheel_scale:e=0.01", "--seed", "1", "--keep-truth", "/wheels"])
    model.write_text(NOISE + f'\n[[effect]]\nname = "wheel_scale"\ne = 0.01\n\n[source]\nodometry = "{learned_from}"\n')
    gone = learned_from == "/gone"
    said = " ".join(invoke(["correct", two, tmp_path / "out.mcap", "--model", model], int(gone)).err.split())
    if gone:
        assert "2 nav_msgs/Odometry topics" in said
    else:
        other = {"/odom": "/wheels", "/wheels": "/odom"}[learned_from]
        assert f"(the topic that the model was learned from; not {other})" in said


def test_noise_that_loses_the_place_is_said_of_effects_that_act_at_places(tmp_path, invoke):
    patch = ["--effect", "region_slip:slip=0.05,x=1,y=1,radius=2", "--start", "0,0,0"]
    model = tmp_path / "robot.toml"
    model.write_text(NOISE)
    for noise, said in ((["--model", model], True), ([], False)):
        words = ["correct", OFFICE, tmp_path / "out.mcap", "--overwrite", *noise, *patch]
        assert ("taken out in the wrong place" in invoke([*words, "-v"]).err) is said
        assert any(row.startswith("places  ") for row in invoke(words).err.splitlines()) is said


@pytest.mark.parametrize("options", [[], ["--effect", "gauss_markov:sigma=0.02"]])
def test_with_nothing_to_undo_the_bag_is_copied_and_that_is_said(tmp_path, options, invoke):
    target = tmp_path / "out.mcap"
    said = invoke(["correct", "-v", OFFICE, target, *options]).err
    assert target.read_bytes() == OFFICE.read_bytes()
    assert said.startswith("UNCHANGED ")
    assert ("gauss_markov" in said) == bool(options)


@pytest.mark.parametrize(("offset", "said"), [("0.015145", True), ("0.0004", False)])
def test_a_learned_time_offset_stays_and_the_way_out_is_named(tmp_path, invoke, offset, said):
    model = tmp_path / "late.toml"
    model.write_text(f'{NOISE}[[setup.clock]]\nrecording = "a.mcap"\ntime_offset = {offset}\nclock_skew = 0.0\n')
    text = " ".join(invoke(["correct", OFFICE, tmp_path / "out.mcap", "--model", model]).err.split())
    assert ("--effect time_offset:offset=0.01515" in text) is said
    # who asks for it gets it, and is not told again
    asked = ["--model", model, "--effect", "time_offset:offset=0.015"]
    assert "stays" not in invoke(["correct", OFFICE, tmp_path / "asked.mcap", *asked]).err


def test_a_pipe_can_be_written(tmp_path, capfdbinary):
    effect = ["--effect", "wheel_scale:e=0.01"]
    assert run(["correct", "-v", str(OFFICE), "-", *effect]) == 0
    piped = tmp_path / "piped.mcap"
    piped.write_bytes(capfdbinary.readouterr().out)
    assert run(["correct", "-v", str(OFFICE), str(tmp_path / "file.mcap"), *effect]) == 0
    assert np.array_equal(rows_of(piped, "/odom").xyt, rows_of(tmp_path / "file.mcap", "/odom").xyt)


def test_the_model_is_kept_in_the_output(trio):
    right = trio[2]
    if right.suffix == ".bag":
        pytest.skip("a ROS 1 bag has no place for it that is not a topic")
    files = [right] if right.is_file() else list(right.iterdir())
    assert any(b"odomcorrupt_correct" in file.read_bytes() for file in files)


ROBOT = 41


def recorded(path, seed, cause, route):
    with path.open("wb") as file:
        write_mcap(simulate(seed, cause, duration_s=240.0, robot_seed=ROBOT, route=route), file)
    return path


def evo_errors(bag):
    """Return evo's APE (m), and its RPE over 5 m (m, degrees), of /odom against the truth at its stamps."""
    metrics = evo_metrics()
    from evo.core.units import Unit

    odometry, truth = rows_of(bag, "/odom"), rows_of(bag, "/ground_truth")
    since, unwrapped = truth.stamps_ns[0], np.unwrap(truth.xyt[:, 2])
    inside = (odometry.stamps_ns >= since) & (odometry.stamps_ns <= truth.stamps_ns[-1])
    at = odometry.stamps_ns[inside] - since
    columns = (truth.xyt[:, 0], truth.xyt[:, 1], unwrapped)
    seen = np.column_stack([np.interp(at, truth.stamps_ns - since, column) for column in columns])
    reference, estimate = as_evo(seen), as_evo(odometry.xyt[inside])
    found = []
    aligned = deepcopy(estimate)
    aligned.align(reference)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((reference, aligned))
    found.append(ape.get_statistic(metrics.StatisticsType.rmse))
    for relation in (metrics.PoseRelation.translation_part, metrics.PoseRelation.rotation_angle_deg):
        rpe = metrics.RPE(relation, delta=5.0, delta_unit=Unit.meters)
        rpe.process_data((reference, estimate))
        found.append(rpe.get_statistic(metrics.StatisticsType.rmse))
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize("cause", ["unequal_wheels", "wheelbase", ("side_slip", "unequal_wheels"), "slope"])
def test_the_error_falls_on_a_drive_that_was_not_fitted(tmp_path, cause):
    evo_metrics()
    fitted = recorded(tmp_path / "fitted.mcap", 1, cause, "office")
    other = recorded(tmp_path / "other.mcap", 2, cause, "loops")
    model, corrected = tmp_path / "robot.toml", tmp_path / "corrected.mcap"
    assert run(["learn", str(fitted), "-o", str(model)]) == 0
    began = ",".join(map(str, rows_of(other, "/ground_truth").xyt[0]))
    assert run(["correct", "-v", str(other), str(corrected), "--model", str(model), "--start", began]) == 0
    before, after = evo_errors(other), evo_errors(corrected)
    bends = cause != "slope"  # a slope shifts the robot and leaves its heading alone
    assert (after[:2] < 0.6 * before[:2]).all()
    assert after[2] < (0.6 if bends else 1.2) * before[2]


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
    trio = there_and_back(tmp_path, ["--effect", effect, "--track", "0.4"])
    assert ("--start" in capsys.readouterr().err) == effect.startswith("region_slip")
    was, off, back = (rows_of(path).xyt[:, :2] for path in trio)
    assert np.abs(off - was).max() > 1e-3
    assert np.abs(back - was).max() < 1e-6


SILENT = Noise("diffusion", Coefficients(0.0, 0.0, 0.0, 0.0))
LOSSY = ("truncated_velocity", "truncated_counts")
"""What integers cut off is lost: correction adds its mean."""
SYSTEMATIC = [
    name
    for name, kind in registry().items()
    if kind.kind not in {"noise", "event"} and not kind.clock and name not in LOSSY
]
AMPLE = {"region_slip": {"slip": 0.05, "x": 3.0, "y": 0.0, "radius": 1.5}}


def drive(seconds=40.0, rate_hz=50.0, *, sideways=False):
    """A drive with straights, bends both ways, a stop, a turn on the spot and a reverse: stamps and poses."""
    t = np.arange(round(seconds * rate_hz) + 1) / rate_hz
    v = np.interp(t % 20.0, [0, 1, 8, 9, 13, 14, 17, 18, 20], [0, 0.6, 0.6, 0, 0, 0.5, 0.5, -0.3, 0])
    w = np.interp(t % 13.0, [0, 3, 4, 6, 8, 9, 13], [0, 0, 0.5, 0.1, -0.6, 0.2, 0])
    steps = np.stack((v, 0.2 * np.sin(t) * sideways, w))[:, :-1] / rate_hz
    return 10**11 + (t * 1e9).astype(np.int64), accumulate(np.array([2.0, -1.0, 0.4]), Increments(*steps))


def model(*effects, noise=SILENT):
    return MotionModel(noise, effects, track_m=0.4)


def usual(name):
    kind = registry()[name]
    values = AMPLE.get(name) or {p.name: p.typical for p in parameters(kind) if p.amplitude}
    return effect_from_values(name, values)


def undone(chosen, stamps_ns, clean):
    """Return how far corruption moved the poses, and how far correction leaves them from where they were."""
    wrong = clean + NoisyPath(chosen, 1).feed(stamps_ns, clean).error_xyt
    back = wrong + corrected_samples(chosen, stamps_ns, wrong, first_ns=int(stamps_ns[0])).error_xyt
    return np.abs(wrong - clean).max(), np.abs(back - clean).max()


def test_rounded_stamps_do_not_make_a_law_of_the_acceleration_flicker():
    stamps_ns, measured = drive(rate_hz=29.4)
    law = user_effect("soft", "left += v * (k * where(a * sign(v) > -0.25, 1, 0))", {"k": -0.02})
    exact, rounded = (
        corrected_samples(model(law), at_ns, measured, first_ns=int(at_ns[0])).error_xyt
        for at_ns in (stamps_ns, stamps_ns // 10_000_000 * 10_000_000)
    )
    assert np.abs(exact).max() > 0.2
    assert np.abs(rounded - exact).max() < 0.02 * np.abs(exact).max()


@pytest.mark.parametrize("when", ["abs(a) > 0.3", "-a * sign(v) > 0.3"])
def test_noise_of_the_odometry_does_not_switch_an_effect_with_a_threshold(when):
    stamps_ns, clean = drive()
    slips = model(user_effect("slips", f"right += v * (k * where({when}, 1, 0))", {"k": -0.06}))
    wrong = clean + NoisyPath(slips, 1).feed(stamps_ns, clean).error_xyt
    noisy = wrong + np.random.default_rng(2).uniform(-2.5e-4, 2.5e-4, wrong.shape)
    back = noisy + corrected_samples(slips, stamps_ns, noisy, first_ns=int(stamps_ns[0])).error_xyt
    assert np.abs(wrong - clean).max() > 0.1
    assert np.abs(back - clean).max() < 0.1 * np.abs(wrong - clean).max()


@pytest.mark.parametrize("name", SYSTEMATIC)
def test_every_systematic_effect_is_taken_out_exactly(name):
    moved, left = undone(model(usual(name)), *drive(sideways=registry()[name].needs_sideways))
    assert moved > 1e-3
    assert left < 1e-9


@pytest.mark.parametrize("name", LOSSY)
def test_of_speeds_that_shake_and_were_cut_down_the_mean_comes_back(name):
    stamps_ns, clean = drive()
    rows = np.random.default_rng(2).normal(increments(clean).rows, (4e-4, 0.0, 1e-3))
    clean = accumulate(clean[0], Increments.of_rows(rows))
    moved, left = undone(model(usual(name)), stamps_ns, clean)
    assert left < 0.3 * moved


NAMES = ("unequal_wheels", "gyro_bias", "accel_slip", "slope", "region_slip", "backlash", "lever_arm", "mount_yaw")
MIXTURE = tuple(map(usual, NAMES))


def test_a_mixture_is_taken_out_across_a_jump_of_the_pose_and_messages_with_the_same_stamp():
    stamps_ns, clean = drive()
    stamps_ns[200] = stamps_ns[199]
    clean[900:] += [5.0, -2.0, 0.0]
    moved, left = undone(model(*MIXTURE), stamps_ns, clean)
    assert moved > 0.1
    assert left < 1e-9
    taken_out = undo_effects(MIXTURE, (stamps_ns - stamps_ns[0]) * 1e-9, clean, 0.4)
    assert taken_out.jump.nonzero()[0].tolist() == [899]


def test_places_are_those_of_the_frame_that_effects_read():
    stamps_ns, clean = drive()
    chosen = model(usual("slope"), usual("region_slip"))
    t_s = (stamps_ns - stamps_ns[0]) * 1e-9
    wrong = clean + NoisyPath(chosen, 1).feed(stamps_ns, clean).error_xyt
    frame = np.array([7.0, -3.0, 2.0])  # of odometry that begins elsewhere and looks elsewhere
    moved = compose(inverse(frame), wrong)
    back = compose(frame, moved + undo_effects(chosen.effects, t_s, moved, 0.4, frame_xyt=frame).error_xyt)
    assert np.abs(back - clean).max() < 1e-9
    unaware = compose(frame, moved + undo_effects(chosen.effects, t_s, moved, 0.4).error_xyt)
    assert np.abs(unaware - clean).max() > 0.02


def test_effects_that_ask_for_places_are_known():
    asking = {name for name in SYSTEMATIC if usual(name).reads_places}
    assert asking == {"slope", "region_slip", "hard_iron"}
    assert user_effect("bend", "yaw += k * sin(theta)", {"k": 0.01}).reads_places
    assert not user_effect("skid", "along += k * a", {"k": 0.01}).reads_places


def test_random_effects_are_passed_by_to_the_bit():
    stamps_ns, clean = drive(10.0)
    samples = corrected_samples(model(usual("gauss_markov"), usual("quantization")), stamps_ns, clean, first_ns=0)
    assert not samples.error_xyt.any()


@pytest.mark.parametrize("rate", [0.0, 1e-4, -0.1, 0.1])
def test_clocks_are_put_right_to_the_nanosecond(rate):
    clocks = (effect_from_values("time_offset", {"offset": -0.3}), effect_from_values("clock_skew", {"rate": rate}))
    was_ns, _ = drive()
    t_s = (was_ns - was_ns[0]) * 1e-9
    wrong_ns = was_ns + np.rint(sum(clock.stamp_shift_s(t_s) for clock in clocks) * 1e9).astype(np.int64)
    assert np.abs(true_stamps(clocks, wrong_ns, int(wrong_ns[0])) - was_ns).max() <= 1
    assert not ClockInverse((replace(clocks[0], offset=0.0),)).acts


def test_covariances_are_those_of_the_noise_along_the_corrected_path():
    noise = Noise("diffusion", Coefficients(0.05, 0.03, 0.05, 0.02))
    stamps_ns, clean = drive()
    effects = (usual("unequal_wheels"), usual("wheelbase"))
    wrong = clean + NoisyPath(model(*effects), 1).feed(stamps_ns, clean).error_xyt
    samples = corrected_samples(model(*effects, noise=noise), stamps_ns, wrong, first_ns=int(stamps_ns[0]))
    ends = np.array([NoisyPath(model(noise=noise), seed).feed(stamps_ns, clean).error_xyt[-1] for seed in range(250)])
    corrected = (wrong + samples.error_xyt)[-1:, :2] - samples.origin_xy
    forecast = pose_covariance(samples.sums[:, -1:], corrected.T)[0]
    np.testing.assert_allclose(np.diag(forecast), ends.var(axis=0), rtol=0.25)


def test_another_odometry_in_the_second_pass_is_refused():
    stamps_ns, clean = drive(5.0)
    path = CorrectedPath([corrected_samples(model(usual("wheel_scale")), stamps_ns, clean, first_ns=0)])
    assert len(path.feed(stamps_ns[:10], clean[:10])) == 10
    with pytest.raises(BagError, match="changed while"):
        path.feed(stamps_ns[11:], clean[11:])


HZ = 50.0
LEG_S = 20.0
"""A leg is driven for all but its last 3 s, in which the robot stands."""


def resting(*, rests=True, slow_turn=False):
    """Return times (n,) and twists (n - 1, 2) of arcs with rests between them."""
    t_s = np.arange(round(600.0 * HZ) + 1) / HZ
    phase, leg = t_s[:-1] % LEG_S, (t_s[:-1] // LEG_S).astype(int)
    moves = (phase < LEG_S - 3.0) | (not rests)
    v = np.where(moves, 0.5, 0.0)
    omega = np.where(moves, 0.3 * np.cos(leg), 0.0)
    if slow_turn:
        omega = np.where(~moves & (leg == 14), 0.03, omega)
    return t_s, np.column_stack((v, omega))


def path(t_s, twist):
    steps = twist * np.diff(t_s)[:, None]
    return accumulate(np.zeros(3), Increments(steps[:, 0].copy(), np.zeros(len(steps)), steps[:, 1].copy()))


def walked(t_s, density, tau, seed=4):
    """Return a bias (n - 1,) that walks from .004 rad/s, with white noise of a gyro."""
    rng = np.random.default_rng(seed)
    keep = np.exp(-1.0 / HZ / tau) if tau else 1.0
    kick = density * np.sqrt(0.5 * tau * (1.0 - keep**2) if tau else 1.0 / HZ)
    bias = [0.004]
    for draw in rng.standard_normal(len(t_s) - 2):
        bias.append(keep * bias[-1] + kick * draw)
    return np.array(bias) + 1e-4 * np.sqrt(HZ) * rng.standard_normal(len(bias))


def heading_errors(effects, t_s, twist, bias):
    """Return the largest error of heading (rad) of the odometry, and after correction."""
    true = path(t_s, twist)
    odometry = path(t_s, twist + np.column_stack((np.zeros_like(bias), bias)))
    error = undo_effects(effects, t_s, odometry, 0.4).error_xyt
    return np.abs(odometry - true)[:, 2].max(), np.abs(odometry + error - true)[:, 2].max()


@pytest.mark.parametrize("tau", [0.0, 200.0])
def test_rests_show_the_bias(tau):
    t_s, twist = resting()
    walk = GyroBiasWalk(density=1e-4, tau=tau)
    before, after = heading_errors([walk], t_s, twist, walked(t_s, walk.density, tau))
    assert after < 0.05 * before


def test_a_constant_bias_in_the_model_is_removed_once():
    t_s, twist = resting()
    walk = GyroBiasWalk(density=1e-4)
    bias = walked(t_s, walk.density, 0.0)
    _, alone = heading_errors([walk], t_s, twist, bias)
    _, both = heading_errors([walk, GyroBias(bias=0.004)], t_s, twist, bias)
    assert both == pytest.approx(alone, rel=0.05)


def test_a_slow_turn_on_the_spot_is_no_bias():
    t_s, twist = resting(slow_turn=True)
    walk = GyroBiasWalk(density=1e-4)
    _, after = heading_errors([walk], t_s, twist, walked(t_s, walk.density, 0.0))
    assert after < 0.02  # it turns by 0.09


@pytest.mark.parametrize(("effects", "rests"), [([GyroBiasWalk(density=1e-4)], False), ([WheelScale(e=0.0)], True)])
def test_nothing_is_removed_without_rests_or_without_the_effect(effects, rests):
    t_s, twist = resting(rests=rests)
    before, after = heading_errors(effects, t_s, twist, walked(t_s, 1e-4, 0.0))
    assert after == before


def test_wheels_that_show_no_bias_at_rest_are_not_corrected():
    t_s, twist = resting()
    bias = np.where(twist[:, 0] == 0.0, 0.0, walked(t_s, 1e-4, 0.0))
    before, after = heading_errors([GyroBiasWalk(density=1e-4)], t_s, twist, bias)
    assert after == pytest.approx(before, rel=1e-9)


STEPPED = MotionModel(SILENT, setup=Setup(pose_corrections=True))


def stepped(xyt, every=50, scatter=(0.006, 0.006, 0.002)):
    """Return poses (n, 3) with a step added at every so many of them, and the rows of the steps."""
    at = np.arange(every, len(xyt) - 1, every)
    steps = increments(xyt)
    for column, sigma in zip((steps.ds_m, steps.dl_m, steps.dtheta_rad), scatter, strict=True):
        column[at - 1] += np.random.default_rng(3).choice([-1.0, 1.0], len(at)) * sigma
    return accumulate(xyt[0], steps), at


@pytest.mark.parametrize("sideways", [False, True])
def test_free_odometry_has_no_steps(sideways):
    stamps_ns, xyt = drive(sideways=sideways)
    found = pose_corrections(stamps_ns * 1e-9, xyt)
    assert found.steps == 0
    assert not found.error_xyt.any()


@pytest.mark.parametrize("sideways", [False, True])
def test_odometry_between_steps_is_found_again(sideways):
    stamps_ns, xyt = drive(sideways=sideways)
    measured, at = stepped(xyt)
    measured[:, 2] = wrap(measured[:, 2])  # as quaternions give it
    found = pose_corrections(stamps_ns * 1e-9, measured)
    assert found.steps == len(at)
    left = measured + found.error_xyt - xyt
    left[:, 2] = wrap(left[:, 2])
    assert np.abs(left).max() < 1e-3
    assert np.abs(measured - xyt)[:, :2].max() > 0.02


def test_a_reset_of_the_pose_stays():
    stamps_ns, xyt = drive()
    xyt[1000:, :2] += [3.0, -4.0]
    assert pose_corrections(stamps_ns * 1e-9, xyt).steps == 0


def test_a_model_of_what_lies_between_steps_takes_them_out_with_its_effects():
    stamps_ns, xyt = drive()
    measured, _ = stepped(xyt)
    model = replace(STEPPED, effects=(effect_from_values("wheel_scale", {"e": 0.02}),), track_m=0.4)
    first_ns = int(stamps_ns[0])

    def corrected(chosen, poses):
        return poses + corrected_samples(chosen, stamps_ns, poses, first_ns=first_ns).error_xyt

    free = corrected(replace(model, setup=Setup()), xyt)
    assert corrected(model, measured) == pytest.approx(free, abs=1e-3)
    assert np.abs(corrected(replace(model, setup=Setup()), measured) - free).max() > 0.02


def test_model_files_say_so():
    assert parse_model(format_model(STEPPED)).setup.pose_corrections
    assert "pose_corrections" not in format_model(replace(STEPPED, setup=Setup()))
