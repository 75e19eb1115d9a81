"""A gate on the rise of an error: runs of two versions are paired by seed, so that few runs suffice.

If nothing has changed, the two numbers of a pair are exchangeable, and the log ratios are symmetric about 0. Two tests
use that, each at half the error rate. The first is Wilcoxon's signed-rank test of all log ratios, exact up to 200
pairs. It detects a rise common to all runs (a factor) with the power of a t test, and is robust to outliers. The
second swaps pairs at random and compares the statistic named in the rule: it detects a rise in only the worst runs.
A detected rise must also be estimated as more than half of the forbidden one, so that a thousand runs do not turn
1 % into a failure. Runs without a result are counted, not tested: their errors are infinite, so that a statistic that
becomes infinite is a rise; and no run may crash that did not, unless a rule on "lost" allows it.

Sources: Wilcoxon, Biometrics Bulletin 1(6), 1945; Hodges & Lehmann, Ann. Math. Stat. 34, 1963; permutation tests:
Fisher, The Design of Experiments, 1935. Rates of errors of both kinds: `benchmarks/gate.py`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from math import degrees, erfc, exp, inf, isfinite, log, sqrt
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from odomcorrupt.scoring.errors import ScoreError
from odomcorrupt.scoring.run import quantile

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from odomcorrupt.geometry.se2 import Array

    _Pair = tuple[Mapping[str, Any], Mapping[str, Any]]
    """Scores of one run as JSON: in the baseline and now."""

FALSE_RED = 0.01
"""Largest probability that a rule fails an unchanged version."""

LEAST_PAIRS = 8
"""Smallest number of pairs with which an outcome can be as rare as half of `FALSE_RED`, i.e. the gate can fail."""

_SWAPS = 1_999
_WORST = 5
"""Largest number of runs that a failed rule on an error names; a rule on lost runs names all."""
_SEED = 20_250_101
"""Seed of the random swaps, fixed so that verdicts are reproducible."""

_METRICS = {
    "ate": "ate_m", "ate_rad": "ate_rad", "max": "max_m", "rpe": "rpe_m", "rpe_rad": "rpe_rad",
    "error_10s": "error_10s_m", "end": "end_m", "nees": "nees",
}  # fmt: skip
STATISTICS: dict[str, Callable[[Array], Array]] = {
    "mean": lambda values: np.mean(values, axis=-1),
    "median": lambda values: quantile(values, 0.5),
    "p90": lambda values: quantile(values, 0.9),
    "p95": lambda values: quantile(values, 0.95),
    "max": lambda values: np.max(values, axis=-1),
}
_RULE = re.compile(r"\s*([a-z0-9_]+?)\s*(\+|>)\s*((?:\d+\.?\d*|\.\d+)(?:e-?\d+)?)\s*(%?)\s*\Z")


@dataclass(frozen=True, slots=True)
class Rule:
    """Condition under which the gate fails.

    metric : a name of `score.run.METRICS`, or "lost": failed runs
    statistic : "mean", "median", "p90", "p95" or "max" over runs; "" for "lost"
    kind : "rise": against a baseline, by `amount` (0.2 is 20 %); "above": more than `amount`, without a baseline
    percent : whether `amount` is a fraction; of "lost", a fraction of the runs instead of their number
    """

    text: str
    metric: str
    statistic: str
    kind: Literal["rise", "above"]
    amount: float
    percent: bool = False


CRASHES = Rule("crashes", "lost", "", "rise", 0.0)
"""Rule of every gate with a baseline: no run is without a complete output that had one."""


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
    """Outcome of one rule.

    sentence : the outcome in one sentence
    comparison : the comparison if runs were paired
    runs : if it failed, the runs that made it fail, a phrase each: name, seed, file, from what to what
    """

    rule: str
    failed: bool
    sentence: str
    comparison: Comparison | None = None
    runs: tuple[str, ...] = ()


def parse_rule(text: str) -> Rule:
    """Return a rule written as "ate_p90 +20%", "lost +1", "lost +5%", "rpe_median > 0.1" or "lost > 5%".

    Raises
    ------
    ScoreError
        If it is not a rule.
    """
    match = _RULE.match(text.lower())
    way_out = 'write it as "ate_p90 +20%", "lost +1" or "ate_median > 0.3"'
    if match is None:
        raise ScoreError(f"rule {text!r}: is not understood; {way_out}")
    name, sign, number, percent = match.groups()
    amount = float(number) / (100.0 if percent else 1.0)
    kind: Literal["rise", "above"] = "rise" if sign == "+" else "above"
    if name == "lost":
        return Rule(text, "lost", "", kind, amount, bool(percent))
    if kind == "rise" and not (percent and amount > 0.0):
        raise ScoreError(f"rule {text!r}: a rise is a percentage of more than 0; {way_out}")
    metric, _, statistic = name.rpartition("_")
    if statistic not in STATISTICS or (name in _METRICS and metric not in _METRICS):
        metric, statistic = name, "median"
    if metric not in _METRICS:
        names = ", ".join([*_METRICS, "lost"])
        raise ScoreError(f"rule {text!r}: no metric {name}; there are {names}, with _mean, _median, _p90, _p95 or _max")
    return Rule(text, _METRICS[metric], statistic, kind, amount)


def compare_paired(old: Array, new: Array, *, rise: float = 0.2, statistic: str = "median") -> Comparison:
    """Return the factor by which an error has changed between two versions, and whether that is a forbidden rise.

    old, new : (n,) errors of the same runs, at least 0; infinite for a run without a result
    rise : rise to detect: 0.2 is 20 %
    statistic : "mean", "median", "p90", "p95" or "max" over runs

    Raises
    ------
    ScoreError
        If there are fewer than `LEAST_PAIRS` pairs, or a number is below zero or unknown.
    """
    if len(old) != len(new) or len(old) < LEAST_PAIRS:
        raise ScoreError(
            f"{min(len(old), len(new))} runs in common with the baseline; a gate takes {LEAST_PAIRS} or more: make as "
            f'many of both versions (batch --runs {LEAST_PAIRS}), or give a bound, as in "ate_p90 > 0.3"'
        )
    both = np.array([old, new], dtype=float)
    if not (both >= 0.0).all():
        raise ScoreError("errors of two versions: each must be a number of at least 0")
    # errors of zero and of infinity are replaced by ones below and above any measured error
    logs = np.log(np.clip(both, 1e-12, 1e12))
    d = logs[1] - logs[0]
    centre, low, high = _hodges_lehmann(d)
    own = STATISTICS[statistic]
    before, after = (float(own(values)) for values in np.exp(logs))
    of_statistic = log(after) - log(before)
    # a statistic over runs that no longer exists is no matter of chance
    gone = bool(np.isfinite(own(both[0])) and not np.isfinite(own(both[1])))
    half = log(1.0 + rise) / 2.0
    p_all = _signed_rank(d)
    p_own = _swap_test(np.exp(logs), own, of_statistic) if of_statistic > 0.0 else 1.0
    shared = p_all <= FALSE_RED / 2.0 and centre > half and of_statistic > 0.0
    tail = p_own <= FALSE_RED / 2.0 and of_statistic > half
    error = (high - low) / (2.0 * 1.96)
    found = max(half + 1.645 * error, (2.576 + 1.645) * error)
    return Comparison(
        len(d), exp(centre), exp(low), exp(high), exp(of_statistic), min(1.0, 2.0 * min(p_all, p_own)),
        exp(found) - 1.0, rise=bool(shared or tail or gone),
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
    if n > 200:
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


def typical_of(results: Sequence[Mapping[str, Any]]) -> Mapping[str, Any]:
    """Return the baseline of a version that was scored repeatedly: of each run the median of its errors, and their MAD.

    results : scores as JSON of the same runs; of its states a run gets the one in the middle, from good to bad
    """
    for other in results[1:]:
        _require_alike(other, results[0])
    every = [_by_pair(one) for one in results]
    runs = []
    for key in every[0]:
        repeats = sorted((one[key] for one in every if key in one), key=lambda run: (not run["scored"], run["failed"]))
        errors = {name: np.array([_error(run, name) for run in repeats], dtype=float) for name in _METRICS.values()}
        metrics = {name: float(np.median(values)) for name, values in errors.items() if not np.isnan(values).any()}
        mad = {name: float(np.median(np.abs(errors[name] - m))) for name, m in metrics.items() if isfinite(m)}
        runs.append({**repeats[len(repeats) // 2], "metrics": metrics, "mad": mad})
    return {**results[0], "runs": runs}


def check(
    report: Mapping[str, Any], rules: Sequence[str], baseline: Mapping[str, Any] | Sequence[Mapping[str, Any]] = ()
) -> list[Verdict]:
    """Return a verdict for each rule, and one on crashes if there are any that no rule allows.

    report : scores as JSON (from `report.score.score_json` or `odomcorrupt score --json`)
    baseline : that of an earlier version, or several of it, see `typical_of`
    rules : in the syntax of `parse_rule`

    Raises
    ------
    ScoreError
        If a rule is invalid, a rise has no baseline, or the two were scored differently or have no run in common.
    """
    parsed = [parse_rule(text) for text in rules]
    own = _by_pair(report)
    pairs: list[_Pair] = []
    if baseline:
        earlier = typical_of([baseline] if isinstance(baseline, Mapping) else baseline)
        before = _by_pair(earlier)
        _require_alike(report, earlier)
        pairs = [(before[key], own[key]) for key in own if key in before]
        if not pairs:
            raise ScoreError("the baseline has no run in common with these (same name and seed); use its --seed")
    verdicts = [_verdict(rule, own, pairs) for rule in parsed]
    if parsed and report.get("identical"):
        said = "identical: FAILED. The estimates are identical in all runs: your localisation was not run again"
        verdicts.append(Verdict("identical", failed=True, sentence=said))
    # a crash fails every gate, unless a rule says how many are allowed
    if not any(rule.metric == "lost" for rule in parsed):
        crashes = [(old, new) for old, new in pairs if old["scored"]]
        verdicts += [one for one in [_lost(CRASHES, crashes)] if one.failed]
    return verdicts


def _require_alike(report: Mapping[str, Any], baseline: Mapping[str, Any]) -> None:
    """Refuse a baseline whose errors have another meaning, or that is of other bags."""
    for key, option in {"estimate": "--estimate", "align": "--align", "limits": "limits of failures"}.items():
        own, other = report.get(key), baseline.get(key, report.get(key))
        if own != other:
            raise ScoreError(f"{option}: {own}, but {other} in the baseline; score both with the same options")
    before = {one["batch"]: one for one in baseline.get("inputs", ())}
    for one in report.get("inputs", ()):
        for kind, value in before.get(one["batch"], {}).items():
            if one[kind] != value:
                raise ScoreError(
                    f"{one['batch'] or 'batch'}: the hash of its {kind} is {one[kind]}, but {value} in the baseline; "
                    "make the batch of the same bag and model, or save a new baseline"
                )


def _verdict(rule: Rule, runs: Mapping[Any, Mapping[str, Any]], pairs: Sequence[_Pair]) -> Verdict:
    if rule.kind == "above":
        return _above(rule, runs)
    if not pairs:
        raise ScoreError(f"rule {rule.text!r}: a rise is measured against an earlier result; name it with --baseline")
    if rule.metric == "lost":
        return _lost(rule, pairs)
    both = [(_error(old, rule.metric), _error(new, rule.metric)) for old, new in pairs]
    known = [i for i, pair in enumerate(both) if None not in pair]
    values = np.array([both[i] for i in known], dtype=float).reshape(-1, 2).T
    try:
        found = compare_paired(*values, rise=rule.amount, statistic=rule.statistic)
    except ScoreError as error:  # too few pairs: the scores and the reports for CI are there nevertheless
        return Verdict(rule.text, failed=True, sentence=f"{_outcome(rule, failed=True)} {error}")
    said = paired_sentence(found, rule.metric, rule.statistic, old=values[0], new=values[1], rise=rule.amount)
    sentence = f"{_outcome(rule, failed=found.rise)} {said}"
    scatter = [old["mad"][rule.metric] for old, _ in pairs if rule.metric in old.get("mad", ())]
    if any(scatter):
        sentence += f"; repeats of the baseline differ by {quantity(rule.metric, float(np.median(scatter)))} (MAD)"
    if without := len(pairs) - len(known):
        sentence += f"; {without} pairs without {rule.metric} left out"
    if not found.rise and found.detectable > rule.amount:
        sentence += f"; with this scatter {found.pairs} pairs reliably show +{100.0 * found.detectable:.0f} % only"
    order = [known[i] for i in worst_of(*values)] if found.rise else []
    named = [_named(*pairs[i], *(quantity(rule.metric, value or 0.0) for value in both[i])) for i in order]
    return Verdict(rule.text, found.rise, sentence, found, tuple(named))


def paired_sentence(found: Comparison, metric: str, statistic: str, old: Array, new: Array, *, rise: float) -> str:
    """Return a comparison in words: statistic before and after with unit, limit, change of a typical run, and why."""
    before, after = (quantity(metric, float(STATISTICS[statistic](values))) for values in (old, new))
    shown = (found.statistic_ratio, found.ratio, found.low, found.high)
    changes = [f"{100.0 * (ratio - 1.0):+.1f} %" if ratio < 1e6 else "infinite" for ratio in shown]
    limit, above = f"+{100.0 * rise:.3g} %", found.statistic_ratio > 1.0 + rise
    why = "below the limit, but one of these rises is significant and above half of it"
    why = why if found.rise else "above the limit, but not significant (level 1 %)"
    return (
        f"{statistic} of {metric.removesuffix('_m')}: {before} -> {after} ({changes[0]}, limit {limit}); a typical run "
        f"{changes[1]} (95 % interval {changes[2]} to {changes[3]}), {found.pairs} pairs, p {found.p:.2g}"
        f"{'' if above is found.rise else f'; {why}'}"
    )


def quantity(metric: str, value: float) -> str:
    """Return a value of a metric with its unit: metres, degrees, percent or none; "-" if it is unknown."""
    if not isfinite(value):
        return "infinite" if value > 0.0 else "-"
    if metric == "inside_95":
        return f"{100.0 * value:.3g} %"
    if metric.endswith("_rad"):
        return f"{degrees(value):.3g} deg"
    return f"{value:.3g} m" if metric.endswith("_m") else f"{value:.3g}"


def worst_of(old: Array, new: Array) -> list[int]:
    """Return the indices of the runs that rose most, the worst first, at most `_WORST`."""
    rise = np.log(np.clip(new, 1e-12, 1e12)) - np.log(np.clip(old, 1e-12, 1e12))
    return [int(i) for i in np.argsort(-rise, kind="stable")[:_WORST] if rise[i] > 0.0]


def _named(old: Mapping[str, Any], new: Mapping[str, Any], before: str, after: str) -> str:
    # the way out, after a semicolon, is the same for all runs
    reason = f" ({new['reason'].partition(';')[0]})" if not new["scored"] and new.get("reason") else ""
    file = new.get("source") or old.get("source") or "no file"
    return f"{new['name']}, seed {new['seed']}, {file}: {before} -> {after}{reason}"


def _error(run: Mapping[str, Any], metric: str) -> float | None:
    """Return a metric of a run: infinite for an error without a complete output, None if it is unknown."""
    value: float | None = run["metrics"].get(metric)
    return value if run["scored"] else None if metric == "nees" else inf


def _outcome(rule: Rule, *, failed: bool) -> str:
    return f"{rule.text}: {'FAILED' if failed else 'passed'}."


def _by_pair(report: Mapping[str, Any]) -> dict[tuple[str, int], Mapping[str, Any]]:
    needed = {"name", "seed", "metrics", "scored", "failed"}
    with suppress(KeyError, TypeError, AttributeError):
        runs = {(run["name"], run["seed"]): run for run in report["runs"] if needed <= run.keys()}
        if len(runs) == len(report["runs"]):
            return runs
    raise ScoreError("the baseline is not a result of score; make one with odomcorrupt score ... --save")


def _above(rule: Rule, runs: Mapping[Any, Mapping[str, Any]]) -> Verdict:
    lost = [run for run in runs.values() if run["failed"]]
    if rule.metric == "lost":
        value = len(lost) / (len(runs) if rule.percent else 1)
        failed = value > rule.amount
        names = tuple(f"{run['name']}, seed {run['seed']}, {run.get('source')}: {run.get('status')}" for run in lost)
        said = f"{_outcome(rule, failed=failed)} {len(lost)} of {len(runs)} runs failed"
        return Verdict(rule.text, failed, said, runs=names if failed else ())
    errors = [(error, run) for run in runs.values() if (error := _error(run, rule.metric)) is not None]
    if not errors:
        raise ScoreError(f"rule {rule.text!r}: no run has {rule.metric}")
    value = float(STATISTICS[rule.statistic](np.array([error for error, _ in errors])))
    failed = value > rule.amount
    worst = sorted(errors, key=lambda one: -one[0])[:_WORST] if failed else []
    named = [f"{r['name']}, seed {r['seed']}, {r.get('source')}: {quantity(rule.metric, v)}" for v, r in worst]
    shown = f"{quantity(rule.metric, value)} (limit {quantity(rule.metric, rule.amount)})"
    said = f"{rule.statistic} of {rule.metric.removesuffix('_m')}: {shown}, {len(errors)} runs"
    return Verdict(rule.text, failed, f"{_outcome(rule, failed=failed)} {said}", runs=tuple(named))


def _lost(rule: Rule, pairs: Sequence[_Pair]) -> Verdict:
    """Return whether more runs fail, or have no complete output, than the rule allows: both are counted."""
    crashed = [new["scored"] < old["scored"] for old, new in pairs]
    before, after = (sum(pair[i]["failed"] for pair in pairs) for i in (0, 1))
    allowed = rule.amount * (len(pairs) if rule.percent else 1)
    more = sum(crashed) if rule is CRASHES else max(sum(crashed), after - before)
    failed = more > allowed + 1e-9
    sentence = (
        f"{_outcome(rule, failed=failed)} Failed runs of {len(pairs)}: {before} -> {after}, "
        f"{sum(crashed)} of them newly without a complete output ({allowed:g} allowed)"
    )
    named = [
        _named(old, new, *(run.get("status") or ("failed" if run["failed"] else "ok") for run in (old, new)))
        for (old, new), crash in zip(pairs, crashed, strict=True)
        if failed and (crash or new["failed"] > old["failed"])
    ]
    return Verdict(rule.text, failed, sentence, runs=tuple(named))
