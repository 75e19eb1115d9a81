"""Numbers over runs: intervals cover, the break-down point is found, growth has the right power."""

import numpy as np
import pytest

from odomcorrupt.scoring.statistics import breakdown, growth, sections, summarise

D5, SLOPE = 0.05, 3.0


def runs_of(rng, n):
    """Return drifts (n,) and losses (n,) of a localiser that breaks down at `D5`."""
    drift = np.exp(rng.uniform(np.log(0.01), np.log(0.5), n))
    p = 1.0 / (1.0 + np.exp(-(np.log(0.05 / 0.95) + SLOPE * np.log(drift / D5))))
    return drift, rng.random(n) < p


@pytest.mark.parametrize("q", ["median", "p90"])
def test_intervals_of_quantiles_cover_with_95_percent(q):
    rng = np.random.default_rng(1)
    true = {"median": 0.0, "p90": 1.2816}[q]
    found = [getattr(summarise(rng.standard_normal(60)), q) for _ in range(400)]
    assert np.mean([f.low <= true <= f.high for f in found]) > 0.93


def test_runs_without_the_number_do_not_count():
    found = summarise(np.array([1.0, np.nan, 3.0]))
    assert (found.n, found.mean, found.max) == (2, 2.0, 3.0)
    assert summarise(np.array([np.nan])).n == 0


@pytest.mark.slow
def test_the_breakdown_point_is_found_and_its_interval_covers():
    rng = np.random.default_rng(2)
    found = [breakdown(*runs_of(rng, 100)) for _ in range(40)]
    assert np.median([f.drift for f in found]) == pytest.approx(D5, rel=0.15)
    assert np.mean([f.low <= D5 <= f.high for f in found]) >= 0.88


def test_runs_that_part_cleanly_have_the_point_between_them():
    drift = np.geomspace(0.01, 0.5, 40)
    found = breakdown(drift, drift > 0.1)
    assert 0.06 < found.drift < 0.12
    assert found.low < found.drift < found.high


def test_the_breakdown_point_is_not_extrapolated_beyond_the_drifts_of_the_runs():
    drift = np.geomspace(0.01, 0.1, 60)
    none, every = breakdown(drift, np.zeros(60, bool)), breakdown(drift, np.ones(60, bool))
    assert (none.drift, none.high) == (np.inf, np.inf)
    assert 0.0 < none.low <= drift[-1]
    assert (every.drift, every.low, every.width) == (0.0, 0.0, None)
    assert drift[0] <= every.high < 0.05
    # fewer than 5 % fail at every drift, or more
    few, many = breakdown(drift, np.arange(60) == 30), breakdown(drift, np.arange(60) % 10 == 0)
    assert (few.drift, few.high, few.width) == (np.inf, np.inf, None)
    assert (many.drift, many.low, many.width) == (0.0, 0.0, None)
    assert breakdown(drift[:4], drift[:4] > 0.0).drift is None


def test_growth_has_the_power_it_was_made_with():
    rng = np.random.default_rng(4)
    drift = rng.uniform(0.01, 0.3, 100)
    found = growth(drift, 2.0 * drift**1.5 * np.exp(0.1 * rng.standard_normal(100)))
    assert found.low < 1.5 < found.high
    assert found.high - found.low < 0.2
    assert growth(drift[:5], drift[:5]) is None


def test_sections_tell_where_errors_and_losses_are():
    clean = np.linspace(0.0, 20.0, 201)
    error = np.where((clean > 10.0) & (clean < 12.0), 1.0, 0.1)
    found = sections([(clean, error)] * 4, clean, np.column_stack((clean, clean)), [10.5, 11.5, 20.0])
    worst = max(found, key=lambda s: s.median_m)
    assert 10.0 <= worst.from_m < 12.0
    assert worst.xy_m[0] == pytest.approx((worst.from_m + worst.to_m) / 2.0, abs=0.1)
    assert sum(s.failures for s in found) == 3
