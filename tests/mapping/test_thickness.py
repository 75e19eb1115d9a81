import numpy as np
import pytest

from odomcorrupt.mapping.scan_map import (
    MIN_NEIGHBOURS,
    WINDOW_M,
    added_thickness,
    distance_to_surface,
    wall_thickness,
)


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.2])
@pytest.mark.parametrize("sd", [0.01, 0.05])
def test_straight_wall_has_the_thickness_it_was_made_with(angle, sd):
    rng = np.random.default_rng(1)
    along, across = rng.uniform(-10, 10, 20_000), rng.normal(scale=sd, size=20_000)
    points = np.column_stack((along * np.cos(angle), along * np.sin(angle)))
    points += across[:, None] * [-np.sin(angle), np.cos(angle)]
    assert wall_thickness(points + np.array([300.0, -40.0])) == pytest.approx(sd, rel=0.05)


def test_it_is_the_mean_plane_variance_written_as_a_loop():
    rng = np.random.default_rng(2)
    points = rng.uniform(0, 3, (400, 2))
    half, smallest = round(WINDOW_M / 2 / 0.02), []
    # whole cells, as the windows are
    shift = np.floor((points - (points.min(axis=0) - 0.04)) / 0.02)
    for i in range(len(points)):
        near = (np.abs(shift - shift[i]) <= half).all(axis=1)
        if near.sum() >= MIN_NEIGHBOURS:
            smallest.append(np.linalg.eigvalsh(np.cov(points[near].T, bias=True))[0])
    assert wall_thickness(points) == pytest.approx(np.sqrt(np.mean(smallest)), rel=1e-9)


def test_doubled_wall_is_half_the_gap_thick():
    x = np.linspace(0, 20, 5000)
    walls = np.concatenate([np.column_stack((x, np.full_like(x, y))) for y in (0.0, 0.2)])
    assert wall_thickness(walls) == pytest.approx(0.1, rel=0.02)


def test_lonely_points_have_no_thickness():
    assert np.isnan(wall_thickness(np.array([[0.0, 0.0], [100.0, 0.0]])))


def test_noise_adds_what_it_adds_whatever_was_there():
    clean = np.array([0.03, 0.04, 0.05])
    np.testing.assert_allclose(added_thickness(clean, np.hypot(clean, 0.02)), 0.02)
    assert added_thickness(clean, clean / 2).tolist() == [0.0, 0.0, 0.0]


def test_hits_are_measured_across_the_clean_wall_and_grow_with_the_drive():
    """Walls shifted and turned as a whole keep their thickness; hits off the clean walls show it."""
    rng = np.random.default_rng(4)
    x = rng.uniform(0.0, 10.0, 4000)
    clean = np.concatenate(
        (np.column_stack((x, np.full(4000, 2.0))), np.column_stack((np.full(4000, 12.0), rng.uniform(-5.0, 0.0, 4000))))
    ) + rng.normal(scale=0.01, size=(8000, 2))
    moved = clean + np.array([0.3, 0.4])
    off = distance_to_surface(clean, moved)
    known = np.isfinite(off)
    assert known.mean() > 0.9
    np.testing.assert_allclose(off[:4000][known[:4000]], 0.4, atol=0.02)
    np.testing.assert_allclose(off[4000:][known[4000:]], 0.3, atol=0.02)
    assert wall_thickness(moved) == pytest.approx(wall_thickness(clean), rel=1e-3)
    blob = rng.normal(scale=0.2, size=(4000, 2))
    assert np.isfinite(distance_to_surface(blob, blob + 1.0)).mean() < 0.2
