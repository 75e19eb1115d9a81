"""A gate on the rise of an error: runs of two versions are paired by seed, so that few runs suffice.

If nothing has changed, the two numbers of a pair are exchangeable, and the log ratios are symmetric about 0. Two tests
use that, each at half the error rate. The first is Wilcoxon's signed-rank test of all log ratios, exact up to 200
pairs. It detects a rise common to all runs (a factor) with the power of a t test, and is robust to outliers. The
second swaps pairs at random and compares the statistic named in the rule: it detects a rise in only the worst runs.
A detected rise must also be estimated as more than half of the forbidden one, so that a thousand runs do not turn
1 % into a failure.

Sources: Wilcoxon, Biometrics Bulletin 1(6), 1945; Hodges & Lehmann, Ann. Math. Stat. 34, 1963; permutation tests:
Fisher, The Design of Experiments, 1935. Rates of errors of both kinds: `benchmarks/gate.py`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import comb, erfc, exp, log, sqrt
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from odomcorrupt.scoring.errors import ScoreError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from odomcorrupt.geometry.se2 import Array

FALSE_RED = 0.01
"""Largest probability that a rule fails an unchanged version."""

LEAST_PAIRS = 8
"""Smallest number of pairs with which an outcome can be as rare as half of `FALSE_RED`, i.e. the gate can fail."""

_EXACT = 200
_SWAPS = 1_999
_SEED = 20_250_101
"""Seed of the random swaps, fixed so that verdicts are reproducible."""

_METRICS = {
    "ate": "ate_m", "ate_rad": "ate_rad", "max": "max_m", "rpe": "rpe_m", "rpe_rad": "rpe_rad",
    "error_10s": "error_10s_m", "end": "end_m", "nees": "nees",
}  # fmt: skip
STATISTICS: dict[str, Callable[[Array], Array]] = {
    "mean": lambda values: np.mean(values, axis=-1),
    "median": lambda values: np.median(values, axis=-1),
    "p90": lambda values: np.quantile(values, 0.9, axis=-1),
    "p95": lambda values: np.quantile(values, 0.95, axis=-1),
    "max": lambda values: np.max(values, axis=-1),
}
_RULE = re.compile(r"\s*([a-z0-9_]+?)\s*(\+|>)\s*([0-9.]+(?:e-?[0-9]+)?)\s*(%?)\s*\Z")


@dataclass(frozen=True, slots=True)
class Rule:
    """Condition under which the gate fails.

    metric : a name of `score.run.METRICS`, or "lost": the fraction of failed runs
    statistic : "mean", "median", "p90", "p95" or "max" over runs; "" for "lost"
    kind : "rise": against a baseline, by `amount` (0.2 is 20 %; for "lost" 0.05 is 5 of 100 runs more);
        "above": more than `amount`, regardless of a baseline
    """

    text: str
    metric: str
    statistic: str
    kind: Literal["rise", "above"]
    amount: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """Paired comparison of two versions.

    pairs : number of pairs
    ratio, low, high : new over old for a typical run (Hodges-Lehmann), with its 95 % interval
    statistic_ratio : new over old for the requested statistic
    p : probability of this rise or more if nothing has changed; the smaller of both tests' p, doubled
    detectable : smallest rise detected in 95 of 100 cases with the same number and scatter of pairs; 0.2 is 20 %
    """

    pairs: int
    ratio: float
    low: float
    high: float
    statistic_ratio: float
    p: float
    detectable: float
    rise: bool


@dataclass(frozen=True, slots=True)
class Verdict:
    """Outcome of one rule: whether it failed, a sentence, and the comparison if runs were paired."""

    rule: str
    failed: bool
    sentence: str
    comparison: Comparison | None = None


def parse_rule(text: str) -> Rule:
    """Return a rule written as "ate_p90 +20%", "lost +5%", "rpe_median > 0.1" or "lost > 5%".

    Raises
    ------
    ScoreError
        If it is not a rule.
    """
    match = _RULE.match(text)
    way_out = 'write it as "ate_p90 +20%", "lost +5%" or "ate_median > 0.3"'
    if match is None:
        raise ScoreError(f"rule {text!r}: is not understood; {way_out}")
    name, sign, number, percent = match.groups()
    try:
        amount = float(number) / (100.0 if percent else 1.0)
    except ValueError as error:
        raise ScoreError(f"rule {text!r}: {number} is not a number; {way_out}") from error
    kind: Literal["rise", "above"] = "rise" if sign == "+" else "above"
    if kind == "rise" and not (percent and amount > 0.0):
        raise ScoreError(f"rule {text!r}: a rise is a percentage of more than 0; {way_out}")
    if name == "lost":
        return Rule(text, "lost", "", kind, amount)
    metric, _, statistic = name.rpartition("_")
    if statistic not in STATISTICS or (name in _METRICS and metric not in _METRICS):
        metric, statistic = name, "median"
    if metric not in _METRICS:
        names = ", ".join([*_METRICS, "lost"])
        raise ScoreError(f"rule {text!r}: no metric {name}; there are {names}, with _mean, _median, _p90, _p95 or _max")
    return Rule(text, _METRICS[metric], statistic, kind, amount)


def compare_paired(old: Array, new: Array, *, rise: float = 0.2, statistic: str = "median") -> Comparison:
    """Return the factor by which an error has changed between two versions, and whether that is a forbidden rise.

    old, new : (n,) errors of the same runs, above zero
    rise : rise to detect: 0.2 is 20 %
    statistic : "mean", "median", "p90", "p95" or "max" over runs

    Raises
    ------
    ScoreError
        If there are fewer than `LEAST_PAIRS` pairs, or a number is not above zero.
    """
    if len(old) != len(new) or len(old) < LEAST_PAIRS:
        raise ScoreError(
            f"{min(len(old), len(new))} runs in common with the baseline; a gate takes {LEAST_PAIRS} or more"
        )
    both = np.array([old, new], dtype=float)
    if not (np.isfinite(both).all() and (both >= 0.0).all()):
        raise ScoreError("errors of two versions: each must be a finite number of at least 0")
    # an error of zero is replaced by one below any measured error
    logs = np.log(np.maximum(both, 1e-12))
    d = logs[1] - logs[0]
    centre, low, high = _hodges_lehmann(d)
    own = STATISTICS[statistic]
    of_statistic = float(np.log(own(np.maximum(both[1], 1e-12))) - np.log(own(np.maximum(both[0], 1e-12))))
    half = log(1.0 + rise) / 2.0
    p_all = _signed_rank(d)
    p_own = _swap_test(np.exp(logs), own, of_statistic) if of_statistic > 0.0 else 1.0
    shared = p_all <= FALSE_RED / 2.0 and centre > half and of_statistic > 0.0
    tail = p_own <= FALSE_RED / 2.0 and of_statistic > half
    error = (high - low) / (2.0 * 1.96)
    found = max(half + 1.645 * error, (2.576 + 1.645) * error)
    return Comparison(
        len(d), exp(centre), exp(low), exp(high), exp(of_statistic), min(1.0, 2.0 * min(p_all, p_own)),
        exp(found) - 1.0, rise=bool(shared or tail),
    )  # fmt: skip


def _hodges_lehmann(d: Array) -> tuple[float, float, float]:
    """Return the median of pairwise means of d (n,), and its 95 % interval from the same means (normal theory)."""
    n = len(d)
    i, j = np.triu_indices(n)
    means = np.sort((d[i] + d[j]) / 2.0)
    half = 1.96 * np.sqrt(n * (n + 1) * (2 * n + 1) / 24.0)
    k = max(int(np.floor(n * (n + 1) / 4.0 - half)), 0)
    return float(np.median(means)), float(means[k]), float(means[len(means) - 1 - k])


def _signed_rank(d: Array) -> float:
    """Return the one-sided p of Wilcoxon's signed-rank test that d (n,) is above 0; zeros are dropped."""
    d = d[d != 0.0]
    n = len(d)
    if n == 0:
        return 1.0
    _, inverse, counts = np.unique(np.abs(d), return_inverse=True, return_counts=True)
    # mean ranks of ties, doubled to be integers
    doubled = (2 * np.cumsum(counts) - counts + 1)[inverse]
    observed = int(doubled[d > 0.0].sum())
    if n > _EXACT:
        deviation = np.sqrt(np.sum(doubled.astype(float) ** 2)) / 2.0
        return erfc((observed - doubled.sum() / 2.0 - 1.0) / deviation / sqrt(2.0)) / 2.0
    # number of sign patterns with each sum of positive ranks, as probabilities
    part = np.zeros(int(doubled.sum()) + 1)
    part[0] = 1.0
    for rank in doubled.tolist():
        shifted = np.zeros_like(part)
        shifted[rank:] = part[: len(part) - rank]
        part = (part + shifted) / 2.0
    return float(min(1.0, part[observed:].sum()))


def _swap_test(both: Array, statistic: Callable[[Array], Array], observed: float) -> float:
    """Return the one-sided p of a statistic's log ratio among those of pairs (2, n) swapped at random."""
    n = both.shape[1]
    rng = np.random.default_rng(_SEED)
    beyond = 1
    for begin in range(0, _SWAPS, 1_000):
        swap = rng.random((min(1_000, _SWAPS - begin), n)) < 0.5
        old, new = np.where(swap, both[1], both[0]), np.where(swap, both[0], both[1])
        ratio = np.log(statistic(new)) - np.log(statistic(old))
        beyond += int(np.count_nonzero(ratio >= observed - 1e-12))
    return beyond / (_SWAPS + 1)


def check(report: Mapping[str, Any], rules: Sequence[str], baseline: Mapping[str, Any] | None = None) -> list[Verdict]:
    """Return a verdict for each rule.

    report, baseline : scores as JSON (from `report.json.score.score_json` or `odomcorrupt score --json`)
    rules : in the syntax of `parse_rule`

    Raises
    ------
    ScoreError
        If a rule is invalid, a rise has no baseline, the two were scored differently, or they have too few runs with
        equal seeds.
    """
    if baseline is not None:
        _require_alike(report, baseline)
    return [_verdict(parse_rule(text), report, baseline) for text in rules]


def _require_alike(report: Mapping[str, Any], baseline: Mapping[str, Any]) -> None:
    """Refuse a baseline whose errors have another meaning."""
    options = {"align": "--align", "count_missing": "--count-missing", "limits": "limits of failures"}
    for key, option in options.items():
        own, other = report.get(key), baseline.get(key) if "runs" in baseline else report.get(key)
        if own != other:
            raise ScoreError(f"{option}: {own}, but {other} in the baseline; score both with the same options")


def _verdict(rule: Rule, report: Mapping[str, Any], baseline: Mapping[str, Any] | None) -> Verdict:
    own = _by_pair(report)
    if rule.kind == "above":
        return _above(rule, own)
    if baseline is None:
        raise ScoreError(f"rule {rule.text!r}: a rise is measured against an earlier result; name it with --baseline")
    before = _by_pair(baseline)
    keys = [key for key in own if key in before]
    if not keys:
        raise ScoreError(
            "the baseline has no run in common with these (same name and seed); use the seed it was made with"
        )
    if rule.metric == "lost":
        return _lost(rule, [(before[k], own[k]) for k in keys])
    pairs = [(before[k]["metrics"].get(rule.metric), own[k]["metrics"].get(rule.metric)) for k in keys]
    usable = [
        pair for k, pair in zip(keys, pairs, strict=True)
        if None not in pair and before[k]["scored"] and own[k]["scored"]
    ]  # fmt: skip
    old, new = np.array([p[0] for p in usable], dtype=float), np.array([p[1] for p in usable], dtype=float)
    found = compare_paired(old, new, rise=rule.amount, statistic=rule.statistic)
    left = len(keys) - len(usable)
    beside = f"; {left} pairs left out, without a complete output in one of the two" if left else ""
    change = f"{rule.metric} {rule.statistic} changed by {100.0 * (found.statistic_ratio - 1.0):+.1f} %"
    sentence = (
        f"{rule.text}: {'FAILED' if found.rise else 'passed'}. {change}; a typical run by "
        f"{100.0 * (found.ratio - 1.0):+.1f} % (95 % interval {100.0 * (found.low - 1.0):+.1f} to "
        f"{100.0 * (found.high - 1.0):+.1f} %), {found.pairs} pairs, p {found.p:.2g}{beside}"
    )
    if not found.rise and found.detectable > rule.amount:
        least = f"{100.0 * found.detectable:.0f} %"
        sentence += f"; with so few pairs that scatter so much only a rise of {least} is found reliably"
    return Verdict(rule.text, found.rise, sentence, found)


def _by_pair(report: Mapping[str, Any]) -> dict[tuple[str, int], Mapping[str, Any]]:
    needed = {"name", "seed", "metrics", "scored", "counted", "failed"}
    try:
        runs = {(run["name"], run["seed"]): run for run in report["runs"] if needed <= run.keys()}
        whole = len(runs) == len(report["runs"])
    except (KeyError, TypeError, AttributeError):
        whole = False
    if not whole:
        raise ScoreError("the baseline is not a result of score; make one with odomcorrupt score ... --save")
    return runs


def _above(rule: Rule, runs: Mapping[Any, Mapping[str, Any]]) -> Verdict:
    if rule.metric == "lost":
        counted = [run for run in runs.values() if run["counted"]]
        value = sum(run["failed"] for run in counted) / max(len(counted), 1)
    else:
        values = [run["metrics"].get(rule.metric) for run in runs.values() if run["scored"]]
        known = np.array([v for v in values if v is not None], dtype=float)
        if not len(known):
            raise ScoreError(f"rule {rule.text!r}: no run has {rule.metric}")
        value = float(STATISTICS[rule.statistic](known))
    failed = value > rule.amount
    return Verdict(rule.text, failed, f"{rule.text}: {'FAILED' if failed else 'passed'}. It is {value:.4g}")


def _lost(rule: Rule, pairs: Sequence[tuple[Mapping[str, Any], Mapping[str, Any]]]) -> Verdict:
    """Return whether more runs fail than before: the exact sign test of discordant runs (McNemar, 1947)."""
    counted = [(old, new) for old, new in pairs if old["counted"] and new["counted"]]
    worse = sum(new["failed"] and not old["failed"] for old, new in counted)
    better = sum(old["failed"] and not new["failed"] for old, new in counted)
    n = worse + better
    p = sum(comb(n, k) for k in range(worse, n + 1)) / 2**n
    change = (worse - better) / max(len(counted), 1)
    failed = p <= FALSE_RED and change > rule.amount / 2.0
    sentence = (
        f"{rule.text}: {'FAILED' if failed else 'passed'}. Of {len(counted)} paired runs {worse} fail that did not, "
        f"{better} no longer fail ({100.0 * change:+.1f} % of runs), p {p:.2g}"
    )
    return Verdict(rule.text, failed, sentence)
