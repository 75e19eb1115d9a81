import math

import numpy as np
import pytest

from odomcorrupt.errors import ModelError
from odomcorrupt.trajectories import RULES, integrate, noisy_twists


def textbook(start, twist, t, rule):
    """One step after the other, with scalars."""
    poses = [tuple(start)]
    for (vx, vy, omega), before, after in zip(twist, t, t[1:], strict=False):
        x, y, theta = poses[-1]
        dt = after - before
        if rule == "exact" and omega:
            # the centre of the circle stays where it is
            turned = theta + omega * dt
            x += (vx * (math.sin(turned) - math.sin(theta)) + vy * (math.cos(turned) - math.cos(theta))) / omega
            y += (vx * (math.cos(theta) - math.cos(turned)) + vy * (math.sin(turned) - math.sin(theta))) / omega
        else:
            along = theta + (omega * dt / 2 if rule == "midpoint" else 0)
            x += dt * (vx * math.cos(along) - vy * math.sin(along))
            y += dt * (vx * math.sin(along) + vy * math.cos(along))
        poses.append((x, y, theta + omega * dt))
    return poses


@pytest.mark.parametrize("rule", RULES)
def test_rule_is_the_textbook_loop(rule):
    rng = np.random.default_rng(2)
    twist, t = rng.normal(size=(40, 3)), np.cumsum(rng.uniform(0, 0.5, 40))
    start = np.array([1.0, -2.0, 0.7])
    np.testing.assert_allclose(integrate(start, twist, t, rule), textbook(start, twist, t, rule), atol=1e-12)


def test_exact_closes_a_circle_in_any_number_of_steps():
    for n in (3, 7, 100):
        t = np.linspace(0, 2 * math.pi, n + 1)
        end = integrate(np.zeros(3), np.tile([1.0, 0.0, 1.0], (n + 1, 1)), t, "exact")[-1]
        np.testing.assert_allclose(end, [0, 0, 2 * math.pi], atol=1e-12)


def test_hold_says_which_interval_a_twist_is_for():
    twist, t = np.array([[1.0, 0, 0], [2.0, 0, 0], [4.0, 0, 0]]), np.array([0.0, 1.0, 2.0])
    assert integrate(np.zeros(3), twist, t, "exact", hold="next")[-1, 0] == 3.0
    assert integrate(np.zeros(3), twist, t, "exact", hold="previous")[-1, 0] == 6.0


def test_unknown_rule_is_named():
    with pytest.raises(ModelError, match="simpson"):
        integrate(np.zeros(3), np.zeros((2, 3)), np.arange(2.0), "simpson")


def test_noisy_run_does_not_depend_on_its_company():
    twist = np.zeros((30, 3))
    many = noisy_twists(twist, 0.2, 0.04, seed=3, runs=range(8))
    alone = noisy_twists(twist, 0.2, 0.04, seed=3, runs=range(5, 6))
    np.testing.assert_array_equal(many[5], alone[0])
    assert not np.array_equal(many[4], many[5])


def test_noise_on_twists_drifts_as_white_noise_does():
    """Heading after n steps: sd omega dt sqrt(n); along a straight drive: sd v dt sqrt(n)."""
    n, dt = 400, 0.01
    twists = noisy_twists(np.tile([1.0, 0, 0], (n + 1, 1)), 0.2, 0.04, seed=1, runs=range(2000))
    ends = integrate(np.zeros(3), twists, np.arange(n + 1) * dt, "exact")[:, -1]
    assert ends[:, 2].std() == pytest.approx(0.04 * dt * math.sqrt(n), rel=0.06)
    assert ends[:, 0].std() == pytest.approx(0.2 * dt * math.sqrt(n), rel=0.06)


def test_noise_must_be_a_number():
    with pytest.raises(ModelError, match="zero or more"):
        noisy_twists(np.zeros((2, 3)), -1.0, 0.0, seed=1, runs=range(1))
