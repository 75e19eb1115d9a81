"""Error rates of the gate of `odomcorrupt score`: how often it is red where nothing changed, and where a rise is real.

    python benchmarks/gate.py --trials 1000

Errors of 40 runs are log-normal over runs (deviation 0.5 of the logarithm) and scatter about that from version to
version, with heavy tails in every second row; a rise multiplies the errors of all runs, or of the worst fifth alone.
"""

from __future__ import annotations

import argparse

import numpy as np

from odomcorrupt.scoring.gate import compare_paired

RUNS = 40
BETWEEN = 0.5


def trial(
    rng: np.random.Generator, scatter: float, rise: float, *, tails: bool, worst_only: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Return old and new errors (RUNS,) of one pair of versions."""
    level = BETWEEN * rng.standard_normal(RUNS)
    # each version scatters about the level of the run; the difference of two has the deviation `scatter`
    draw = rng.standard_t(3.0, (2, RUNS)) / np.sqrt(3.0) if tails else rng.standard_normal((2, RUNS))
    old, new = np.exp(level + scatter / np.sqrt(2.0) * draw)
    grown = level >= np.quantile(level, 0.8) if worst_only else np.ones(RUNS, dtype=bool)
    return old, np.where(grown, new * (1.0 + rise), new)


def red(
    trials: int, scatter: float, rise: float, statistic: str, *, tails: bool = False, worst_only: bool = False
) -> float:
    """Return the part of trials in which a rule of +20 % is red."""
    rng = np.random.default_rng(25)
    count = sum(
        compare_paired(
            *trial(rng, scatter, rise, tails=tails, worst_only=worst_only), rise=0.2, statistic=statistic
        ).rise
        for _ in range(trials)
    )
    return count / trials


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=1000)
    trials = parser.parse_args().trials
    print(f"{RUNS} runs, {trials} trials; part that is red")
    print("scatter of log ratio  tails  statistic  unchanged  +20 % all   +5 % all  worst fifth x2")
    for scatter in (0.05, 0.1, 0.2, 0.25, 0.3, 0.4):
        for tails in (False, True):
            for statistic in ("median", "p90"):
                row = [
                    red(trials, scatter, rise, statistic, tails=tails, worst_only=worst)
                    for rise, worst in ((0.0, False), (0.2, False), (0.05, False), (1.0, True))
                ]
                print(
                    f"{scatter:20.2f}  {'t3' if tails else 'normal':>6} {statistic:>9}"
                    f" {row[0]:10.3f} {row[1]:10.3f} {row[2]:10.3f} {row[3]:15.3f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
