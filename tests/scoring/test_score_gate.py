"""The gate on a rise of errors, and the statistics over runs."""

import numpy as np
import pytest

from odomcorrupt.scoring.errors import ScoreError
from odomcorrupt.scoring.gate import _signed_rank, check, compare_paired, parse_rule, typical_of
from odomcorrupt.scoring.run import breakdown, growth, sections, summarise


def pair(rng, rise, scatter=0.2, n=40):
    level = 0.5 * rng.standard_normal(n)
    old, new = np.exp(level + scatter / np.sqrt(2.0) * rng.standard_normal((2, n)))
    return old, new * (1.0 + rise)


@pytest.mark.parametrize("statistic", ["median", "p90"])
def test_20_percent_is_found_in_95_of_100_trials_and_1_of_100_is_falsely_red(statistic):
    """benchmarks/gate.py counts a thousand trials and other scatters."""
    rng = np.random.default_rng(1)
    found = sum(compare_paired(*pair(rng, 0.2), statistic=statistic).rise for _ in range(100))
    false = sum(compare_paired(*pair(rng, 0.0), statistic=statistic).rise for _ in range(100))
    assert found >= 93
    assert false <= 3


def test_a_thousand_runs_do_not_turn_a_rise_of_5_percent_red():
    found = compare_paired(*pair(np.random.default_rng(9), 0.05, n=1000), rise=0.2)
    assert not found.rise
    assert found.p < 1e-3
    assert found.low < 1.05 < found.high


def test_a_rise_of_the_worst_runs_alone_is_found_by_their_quantile():
    old, new = pair(np.random.default_rng(3), 0.0, 0.05, 100)
    new = np.where(old >= np.quantile(old, 0.8), 2.0 * new, new)
    assert compare_paired(old, new, statistic="p90").rise
    assert not compare_paired(old, new, statistic="median").rise


def test_one_pair_of_results_has_one_verdict_and_equal_results_are_no_rise():
    old, new = pair(np.random.default_rng(4), 0.1)
    assert compare_paired(old, new, statistic="p90") == compare_paired(old, new, statistic="p90")
    found = compare_paired(old, old)
    assert (found.rise, found.ratio, found.p) == (False, 1.0, 1.0)


@pytest.mark.parametrize("n", [12, 60, 300])
def test_the_signed_rank_test_is_scipys(n):
    stats = pytest.importorskip("scipy.stats")
    d = np.random.default_rng(n).normal(0.15, 1.0, n)
    method = "exact" if n < 200 else "approx"
    expected = stats.wilcoxon(d, alternative="greater", method=method, correction=n >= 200).pvalue
    assert _signed_rank(d) == pytest.approx(expected, rel=2e-3)


def result(values, failed=(), seed=7, missing=()):
    return {
        "runs": [
            {"name": f"run_{i:06d}", "seed": seed, "metrics": {"ate_m": None if i in missing else float(v)},
             "scored": i not in missing, "failed": i in failed or i in missing, "source": f"run_{i:06d}.tum"}
            for i, v in enumerate(values)
        ]
    }  # fmt: skip


def test_a_failed_rule_names_statistic_unit_and_the_worst_runs():
    old, new = pair(np.random.default_rng(6), 0.5)
    (verdict,) = check(result(new), ["ate_p90 +20%"], result(old))
    worst = int(np.argmax(new / old))
    assert verdict.failed
    assert verdict.sentence.startswith("ate_p90 +20%: FAILED. p90 of ate: ")
    assert f"{np.quantile(old, 0.9):.3g} m -> {np.quantile(new, 0.9):.3g} m (" in verdict.sentence
    assert ", limit +20 %); a typical run" in verdict.sentence
    assert "40 pairs" in verdict.sentence
    assert verdict.runs[0] == f"run_{worst:06d}, seed 7, run_{worst:06d}.tum: {old[worst]:.3g} m -> {new[worst]:.3g} m"


@pytest.mark.parametrize(
    ("rules", "crashes", "failing"),
    [(["ate_median +20%"], 1, ["crashes"]), (["ate_median +20%", "lost +1"], 1, []),
    (["ate_median +20%", "lost +1"], 2, ["lost +1"]), (["ate_p90 +20%", "lost +5%"], 1, []),
    (["ate_p90 +20%", "lost +10%"], 2, ["ate_p90 +20%"]), (["ate_p90 +20%", "lost +50%"], 4, ["ate_p90 +20%"]),
    (["ate_p90 +20%", "lost +0"], 1, ["lost +0"]), (["ate_p90 +20%", "lost +5%"], 5, ["ate_p90 +20%", "lost +5%"])],
)  # fmt: skip
def test_a_crash_fails_unless_a_rule_allows_it_and_counts_as_an_infinite_error(rules, crashes, failing):
    old, _ = pair(np.random.default_rng(2), 0.0, n=20)
    verdicts = check(result(old, missing=range(crashes)), rules, result(old))
    assert [one.rule for one in verdicts if one.failed] == failing
    for one in verdicts:
        if one.failed and "lost" in one.rule:
            assert one.runs == tuple(f"run_{i:06d}, seed 7, run_{i:06d}.tum: ok -> failed" for i in range(crashes))
    # crashes that the baseline had, too, are none of this version
    again = check(result(old, missing=range(crashes)), rules, result(old, missing=range(crashes)))
    assert not any(one.failed for one in again)


def test_a_verdict_that_the_limit_alone_does_not_explain_says_why_and_few_pairs_what_they_find():
    below, above = "below the limit, but one of these rises is", "above the limit, but not significant (level 1 %)"
    for seed, rise, why in ((3, 0.0, above), (1, 0.25, below)):
        old, new = pair(np.random.default_rng(seed), rise, n=20)
        (verdict,) = check(result(new), ["ate_p90 +20%"], result(old))
        assert (verdict.failed, why in verdict.sentence) == (rise > 0.0, True)
    old, new = pair(np.random.default_rng(8), 0.0, scatter=0.8, n=12)
    (verdict,) = check(result(new), ["ate_median +20%"], result(old))
    assert "; with this scatter 12 pairs reliably show +" in verdict.sentence


def test_losses_are_counted_not_tested():
    for n, rises in ((5, True), (4, False)):
        assert check(result(np.ones(40), failed=range(n)), ["lost +10%"], result(np.ones(40)))[0].failed is rises


def test_an_absolute_rule_needs_no_baseline():
    rules = ["ate_max > 0.5", "lost > 10%", "lost > 1"]
    low, part, count = check(result([0.1, 0.2, 0.3], failed={1}), rules)
    assert low.sentence == "ate_max > 0.5: passed. max of ate: 0.3 m (limit 0.5 m), 3 runs"
    assert (low.failed, part.failed, count.failed) == (False, True, False)
    assert check(result([0.1, 0.2, 0.3], missing={1}), ["ate_max > 0.5"])[0].failed


def test_identical_estimates_fail_every_gate():
    values = np.ones(10)
    verdicts = check(result(values) | {"identical": True}, ["ate_median > 3"])
    assert [one.rule for one in verdicts if one.failed] == ["identical"]
    assert "not run again" in verdicts[-1].sentence
    assert check(result(values) | {"identical": True}, []) == []


def test_a_baseline_of_other_bags_or_options_is_refused():
    values, batch = np.ones(10), {"inputs": [{"batch": "", "input": "a", "model": "b"}], "estimate": "/amcl_pose"}
    check(result(values) | batch, ["ate_p90 +20%"], result(values) | batch)
    for other in ({"inputs": [{"batch": "", "input": "a", "model": "c"}]}, {"estimate": "/pose"}):
        with pytest.raises(ScoreError, match="in the baseline; "):
            check(result(values) | batch, ["ate_p90 +20%"], result(values) | batch | other)


def test_repeated_baselines_are_the_median_of_each_run_and_their_scatter_is_said():
    old, new = pair(np.random.default_rng(3), 0.0, n=20)
    lost = [result(old * 1.1), result(old), result(old * 0.8, missing={0})]
    typical = typical_of(lost)["runs"]
    assert [run["metrics"]["ate_m"] for run in typical[1:]] == pytest.approx(old[1:])
    assert (typical[0]["scored"], typical[0]["metrics"]["ate_m"]) == (True, pytest.approx(1.1 * old[0]))
    assert [run["mad"]["ate_m"] for run in typical[1:]] == pytest.approx(0.1 * old[1:])
    (verdict,) = check(result(new), ["ate_median +20%"], lost)
    assert "; repeats of the baseline differ by 0." in verdict.sentence
    assert check(result(1.6 * old), ["ate_median +20%"], lost)[0].failed


@pytest.mark.parametrize(
    ("rule", "said"),
    [("ate_p90 20%", "not understood"), ("speed_p90 +20%", "no metric speed_p90"),
    ("ate_p90 +0%", "more than 0"), ("ate_p90 +0.2", "percentage")],
)  # fmt: skip
def test_a_rule_that_is_none_is_refused_with_an_example(rule, said):
    with pytest.raises(ScoreError, match=said):
        parse_rule(rule)


def test_what_cannot_be_compared_is_said():
    values = np.ones(40)
    with pytest.raises(ScoreError, match="name it with baseline"):
        check(result(values), ["ate_p90 +20%"])
    with pytest.raises(ScoreError, match="no run in common"):
        check(result(values), ["ate_p90 +20%"], result(values, seed=8))
    (verdict,) = check(result(values[:5]), ["ate_p90 +20%"], result(values))
    assert (verdict.failed, verdict.comparison, "takes 8 or more" in verdict.sentence) == (True, None, True)
    with pytest.raises(ScoreError, match="not a result of score"):
        check(result(values), ["ate_p90 +20%"], {"runs": 3})


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
