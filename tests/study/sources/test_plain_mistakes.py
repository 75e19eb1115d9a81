"""Plain mistakes of wiring, units, signs and axes are named first, with their size, and the study goes on without them.

Breaks where a row of the table is not found, hides another one, or is found in a drive without mistakes.
"""

from dataclasses import replace

import numpy as np
import pytest
from sourcebags import topic, write
from sourcedrive import odometry, truth

from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import Increments, accumulate, increments
from odomcorrupt.report.brief import mistakes_first
from odomcorrupt.study.io import Source, read_runs
from odomcorrupt.study.io.first_look import Look, Witness, factors_of, first_look, mistakes_alone
from odomcorrupt.study.io.raw_trajectory import Samples
from odomcorrupt.study.io.recording import Mistake
from odomcorrupt.summary import Line, Summary

NONE = np.zeros(0)
HZ = 50.0


def driven(seed=1, seconds=120.0, *, reverse=True, left_only=False):
    """Return the motions (n, 3) of a drive with straights, curves, turns on the spot and reverse."""
    rng = np.random.default_rng(seed)
    rows = []
    while len(rows) < seconds * HZ:
        v, w = rng.uniform(0.15, 0.4), rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 0.8)
        w = abs(w) if left_only else w
        kind = rng.choice([(v, 0.0, 0.0), (v, 0.0, w), (0.0, 0.0, w), (-v if reverse else v, 0.0, 0.0)])
        rows += [kind] * int(rng.uniform(1.5, 4.0) * HZ)
    smooth = np.ones(20) / 20.0
    rates = np.column_stack([np.convolve(x, smooth, mode="same") for x in np.array(rows).T])
    return rates / HZ


def path(rows, name="/odom", *, headed=True, every=1, noise=0.0):
    """Return a trajectory of motions (n, 3)."""
    xyt = accumulate(np.zeros(3), Increments.of_rows(rows))[::every]
    xyt = xyt + noise * np.random.default_rng(7).standard_normal(xyt.shape)
    stamps = (1_700_000_000 * 10**9 + np.arange(len(rows) + 1) * int(1e9 / HZ))[::every]
    yaw = xyt[:, 2] if headed else np.full(len(xyt), np.nan)
    xyz = np.column_stack((xyt[:, :2], 0.0 * yaw if headed else 0.0 * xyt[:, 0]))
    return Samples(name, name, "", stamps, xyz, yaw, NONE.astype(np.int64), NONE)


def real(rows, *, headed=True):
    return path(rows, "/truth", headed=headed, every=2, noise=1e-3)


def names(found):
    return [one.name for one in found.mistakes]


def rims(rows, left, right):
    """Return motions whose wheels, on a track of 0.2 m, are functions of the true ones."""
    arm = 0.1 * rows[:, 2]
    one, other = left(rows[:, 0] - arm), right(rows[:, 0] + arm)
    return np.column_stack(((one + other) / 2.0, 0.0 * one, (other - one) / 0.2))


FACTORS = (0.01, 0.1, 0.303, 2.5, 10.0, 57.3, 100.0)


@pytest.mark.parametrize("headed", [True, False])
@pytest.mark.parametrize("factor", FACTORS)
@pytest.mark.parametrize(
    ("scaled", "name"),
    [((1, 1, 1), "wheel radius"), ((0, 0, 1), "wheel separation"), ((1, 1, 0), "travel")],
    ids=["both", "turn", "travel"],
)
def test_a_factor_is_named_and_found(scaled, name, factor, headed):
    rows = driven()
    ratio = np.where(scaled, factor, 1.0)
    found = first_look(Look((path(rows * ratio), real(rows, headed=headed))))
    assert names(found) == [name]
    assert np.allclose(found.gains, 1.0 / ratio[[0, 2]], rtol=0.02)


SIGNS = {
    "left and right exchanged": (1, -1, -1),
    "forward is -x": (-1, -1, 1),
    "both wheels negated": (-1, -1, -1),
}


@pytest.mark.parametrize("name", SIGNS)
@pytest.mark.parametrize("factor", [1.0, 0.1, 10.0])
def test_signs_are_undone_and_factors_beside_them_found(name, factor):
    rows = driven()
    found = first_look(Look((path(rows * SIGNS[name] * factor), real(rows))))
    assert names(found) == [name, "wheel radius"][: 1 + (factor != 1.0)]
    assert found.gains[0] == pytest.approx(1.0 / factor, rel=0.02)
    again = first_look(Look((found.odometry, found.truth)))
    assert not again.mistakes


@pytest.mark.parametrize("headed", [True, False])
def test_a_mirrored_truth_is_one_of_two_and_a_gyro_decides(headed):
    rows = driven()
    odometry, flipped = path(rows), real(rows * [1, -1, -1], headed=headed)
    found = first_look(Look((odometry, flipped)))
    assert names(found) == ["left and right exchanged"]
    assert "these data do not show" in found.mistakes[0].said
    gyro = Witness("/imu", odometry.stamps_ns, odometry.yaw_rad, independent=True)
    found = first_look(Look((odometry, flipped), lambda: [gyro]))
    assert "so /truth is wrong" in found.mistakes[0].said
    assert np.array_equal(found.odometry.xyz, odometry.xyz)


@pytest.mark.parametrize(("side", "words"), [((-1.0, 1.0), "left"), ((1.0, -1.0), "right")])
def test_a_reversed_encoder_exchanges_travel_and_turn(side, words):
    rows = driven()
    wrong = rims(rows, lambda u: side[0] * u, lambda u: side[1] * u)
    found = first_look(Look((path(wrong), real(rows))))
    assert names(found) == ["one encoder reversed"]
    assert f"the {words} wheel" in found.mistakes[0].causes
    back = increments(found.odometry.trajectory().xyt).rows
    assert np.corrcoef(back[:, 0], rows[:, 0])[0, 1] > 0.99
    assert np.corrcoef(back[:, 2], rows[:, 2])[0, 1] > 0.99


def test_encoders_without_direction_are_refused():
    rows = driven()
    with pytest.raises(RecordingError, match="/odom never drives in reverse, the truth does in"):
        first_look(Look((path(rims(rows, np.abs, np.abs)), real(rows))))


@pytest.mark.parametrize("bits", [8, 12, 16])
def test_overflows_are_counted_and_taken_out(bits):
    rows, tick = driven(), 0.4 / 2**bits

    def counted(u):
        counts = np.floor(np.cumsum(u) / tick)
        return np.diff((counts + 2 ** (bits - 1)) % 2**bits, prepend=2 ** (bits - 1)) * tick

    found = first_look(Look((path(rims(rows, counted, counted)), real(rows))))
    assert names(found) == ["overflow"]
    assert f"a counter of {bits} bits" in found.mistakes[0].causes
    step = increments(found.odometry.trajectory().xyt).ds_m
    assert np.abs(step).max() < 0.02


@pytest.mark.parametrize("at", [0, 1], ids=["odometry", "truth"])
@pytest.mark.parametrize("factor", [180.0 / np.pi, -180.0 / np.pi, np.pi / 180.0])
def test_headings_in_another_unit(factor, at):
    rows = driven()
    pair = [path(rows), real(rows)]
    pair[at] = replace(pair[at], yaw_rad=pair[at].yaw_rad * factor)
    found = first_look(Look((pair[0], pair[1])))
    assert names(found) == ["unit of headings"]
    assert not first_look(Look((found.odometry, found.truth))).mistakes


@pytest.mark.parametrize("at", [0, 1], ids=["odometry", "truth"])
@pytest.mark.parametrize("what", ["xyz", "yaw_rad"])
def test_headings_against_their_own_path(at, what):
    """Breaks where what is mirrored to mend one trajectory contradicts the other one."""
    rows = driven()
    pair = [path(rows), real(rows)]
    wrong = pair[at].xyz * [1.0, -1.0, 1.0] if what == "xyz" else -pair[at].yaw_rad
    pair[at] = replace(pair[at], **{what: wrong})
    found = first_look(Look((pair[0], pair[1])))
    assert names(found) == ["mirrored headings"]
    assert not first_look(Look((found.odometry, found.truth))).mistakes


@pytest.mark.parametrize(("order", "plane"), [([1, 2, 0], "x-z"), ([2, 0, 1], "y-z")])
def test_another_plane(order, plane):
    rows = driven()
    seen = real(rows, headed=False)
    found = first_look(Look((path(rows), replace(seen, xyz=seen.xyz[:, order]))))
    assert names(found) == ["plane"]
    assert plane in found.mistakes[0].said


def test_an_attitude_about_another_axis_leaves_positions():
    rows = driven()
    seen = real(rows)
    tilted = replace(seen, yaw_rad=np.where(np.cos(seen.yaw_rad) > 0.0, 0.0, np.pi))
    found = first_look(Look((path(rows), tilted)))
    assert names(found) == ["headings of the truth"]
    assert not found.truth.headed


@pytest.mark.parametrize("metre", [100.0, 1000.0])
def test_a_unit_of_the_truth(metre):
    rows = driven()
    seen = real(rows)
    found = first_look(Look((path(rows), replace(seen, xyz=seen.xyz * metre))))
    assert names(found)[0] in ("unit of the truth", "speed")
    assert found.gains == (1.0, 1.0)
    assert not first_look(Look((found.odometry, found.truth))).mistakes


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("headed", [True, False])
@pytest.mark.parametrize("how", [{}, {"reverse": False}, {"left_only": True}], ids=["hand", "ahead", "left"])
def test_nothing_is_claimed_of_small_errors(seed, headed, how):
    rows = driven(seed, 60.0, **how)
    slip = 1.0 + 0.03 * np.random.default_rng(seed).standard_normal(rows.shape)
    found = first_look(Look((path(rows * slip * [1.06, 1.0, 0.9]), real(rows, headed=headed))))
    assert not found.mistakes
    assert found.gains == (1.0, 1.0)


def test_odometry_alone_shows_its_own_mistakes():
    rows = driven()
    good = path(rows)
    assert not mistakes_alone(good)
    (one,) = mistakes_alone(replace(good, yaw_rad=np.degrees(good.yaw_rad)))
    assert one.name == "unit of headings"


def test_quaternions_without_w_are_refused(tmp_path):
    moved = odometry(60.0)

    class Unset(type(moved)):
        @property
        def quat(self):
            return super().quat * [1.0, 1.0, 1.0, 0.0]

    bag = write(
        tmp_path / "run.mcap",
        topic("/odom", "Odometry", Unset(moved.stamps_ns, moved.xyz, moved.yaw)),
        topic("/truth", "PoseStamped", truth(60.0)),
    )
    with pytest.raises(RecordingError, match=r"run.mcap: /odom: its orientations are no unit quaternions \(w is 0"):
        read_runs(Source(bag))


@pytest.mark.parametrize(("gain", "effect"), [(1 / 2.5, "wheel_scale"), (100.0, "wheel_scale")])
def test_the_recording_keeps_its_odometry_and_has_the_factor_as_an_effect(tmp_path, gain, effect):
    moved, seen = odometry(60.0), truth(60.0)
    scaled = moved.having(xyz=moved.xyz / gain)
    bag = write(tmp_path / "run.mcap", topic("/odom", "Odometry", scaled), topic("/truth", "PoseStamped", seen))
    (run,) = read_runs(Source(bag))
    assert np.allclose(np.diff(run.odometry.xyt[:, :2], axis=0), np.diff(scaled.xyz[:, :2], axis=0), atol=1e-9)
    (factor,) = factors_of([run])
    assert factor.name == effect
    assert factor.e == pytest.approx(gain / 1.02 - 1.0, abs=0.05 * gain)
    assert "turns agree" in run.mistakes[0].said


def test_what_is_complete_but_for_a_mistake_is_not_called_complete():
    nothing = Summary((Line("COMPLETE", "no known effect explains more than chance"),))
    first = mistakes_first(nothing, [Mistake("wheel separation", "turns", "track", "change it")])
    assert [line.label for line in first.lines] == ["MISTAKE", "causes", "change", "otherwise"]
    assert mistakes_first(nothing, ()) == nothing
