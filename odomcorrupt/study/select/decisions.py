"""Thresholds of the model selection: inclusion, replacement and removal of terms, with the reason for each.

A user may choose other values: `odomcorrupt.learn(..., decisions=replace(DECISIONS, level=0.05))`. Numerical settings
(steps of a search, guards) are constants of the modules that use them.

Values named `..._nats` are natural-log units. A gain is a difference of log likelihoods minus the penalty of the term
(`penalty`). "Benchmark" means the simulated drives with known causes of `benchmarks/laboratory`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects import registry

if TYPE_CHECKING:
    from odomcorrupt.study.terms.term import Term


@dataclass(frozen=True, slots=True, kw_only=True)
class PriorOdds:
    """Prior weights in the reported probability of an effect; the formula is in `confidence`.

    elsewhere : prior odds of a cause that is not in the library
    unexplained : odds against an effect, per unexplained gain in units of the effect's own gain
    correlated : the same for the gain of correlated noise; smaller, because such noise may exist beside the effect
    """

    elsewhere: float = 0.005
    unexplained: float = 1.0
    correlated: float = 0.2


@dataclass(frozen=True, slots=True, kw_only=True)
class Practical:
    """Practical significance: a part of a model below these limits is reported as present but negligible.

    share : least relative growth of the 10 s error if the part is left out
    far_share : the same for the error over 50 m of path; larger, because a drive has few such windows
    per_m : least displacement of the odometry by the part, metres per metre of path: 0.1 mm, which is 0.01 %. Nominal
        radii and tracks are known to a few tenths of a per cent, calibrated ones to some hundredths
    """

    share: float = 0.02
    far_share: float = 0.1
    per_m: float = 1e-4


@dataclass(frozen=True, slots=True, kw_only=True)
class Decisions:
    """Prior odds and thresholds of one selection.

    term_nats, clock_nats, basis_nats : gain on left-out data at which a term, a clock, and a basis function (in
        addition) break even: minus the logarithm of their prior odds, beside those of `penalty`
    clear_errors : least gain of a term in standard errors over folds
    far_clock_s : shift of stamps by a clock's offset, or its rate over a recording, from which on the clock is free in
        any case: its errors are not linear, and no other term has them
    max_correlated, max_dependences : largest number of kinds of correlated noise and of basis functions in a model

    level : probability of an effect's score on data without one, by the larger p of two tests (under the noise model,
        and cluster-robust), from which on it is reported as evidence
    testable_errors : an effect is testable if half of its physical range exceeds this many standard errors; the
        benchmark detects effects from about 4 to 5 standard errors on

    alternative_nats : effects within this gain of the best one are alternatives that the data do not separate; 3 nats
        are odds of 20 to 1
    rival_nats : a dependence is listed beside a name that gains at most this much more
    replacement_nats : gain from which on an effect of an impossible sign, or a function of the time of a single drive,
        is reported
    reshape_nats : gain in log likelihood of a refit that a refined shape requires
    common, rare_nats : effects that nearly every robot has, and the lower prior log probability of all others (2 nats
        are 7 to 1): nominal radii and tracks are never exact (Borenstein & Feng 1996), gyros have bias and scale
        errors, steerings have zero and ratio errors
    commanded, commanded_nats : effects of odometry computed from commands or from incomplete encoder counts, and their
        additional prior penalty (6 nats are 400 to 1): most odometry comes from encoders
    unusual_nats : additional gain required of a gyro as the source of the heading of a basis function
    unusual_shape_nats : the same for each word-valued parameter that is not the usual one, such as a gyro as the
        source of the heading
    related_nats, related_share : rectangles are tried if a disc has this gain and this fraction of the largest gain

    drop_nats : log likelihood that a model may lose with a random process that is dropped
    correlated_nats : gain required of correlated noise; on clean data the largest gain was 3.4
    mean_reverting_nats : gain required of a mean-reverting bias; errors of a SLAM truth are correlated over seconds
        and gain 20
    map_nats : additional gain required of a varying gain of travel if the truth depends on a map: its distortions vary
        over the drive, too
    counted_nats : gain assigned to lost increments and ticks, which are counted in the odometry

    heterogeneity_level : probability of reporting any difference between recordings of an unchanged robot
    prior : weights in the reported probabilities
    practical : limits of practical significance
    """

    term_nats: float = 4.0
    clock_nats: float = 2.0
    basis_nats: float = 3.0
    clear_errors: float = 1.5
    far_clock_s: float = 0.025
    max_correlated: int = 2
    max_dependences: int = 2
    level: float = 0.01
    testable_errors: float = 4.2
    alternative_nats: float = 3.0
    rival_nats: float = 6.0
    replacement_nats: float = 8.0
    reshape_nats: float = 0.1
    common: tuple[str, ...] = (
        "wheel_scale",
        "unequal_wheels",
        "wheelbase",
        "gyro_bias",
        "gyro_scale",
        "steering_offset",
        "steering_scale",
    )
    rare_nats: float = 2.0
    commanded: tuple[str, ...] = ("dead_band", "truncated_velocity", "truncated_counts", "counts_lost")
    commanded_nats: float = 6.0
    unusual_nats: float = 4.0
    unusual_shape_nats: float = 2.0
    related_nats: float = 30.0
    related_share: float = 0.5
    drop_nats: float = 3.3
    correlated_nats: float = 6.0
    mean_reverting_nats: float = 25.0
    map_nats: float = 20.0
    counted_nats: float = 100.0
    heterogeneity_level: float = 1e-3
    prior: PriorOdds = field(default_factory=PriorOdds)
    practical: Practical = field(default_factory=Practical)


DECISIONS = Decisions()


def penalty(term: Term, count: int, decisions: Decisions) -> float:
    """Return the penalty of a term on `count` intervals: the log-likelihood gain at which it breaks even, nats.

    It is the sum of log(count) / 2 for each fitted number (Schwarz 1978), the logarithm of the size of the family that
    the term was selected from, and the prior penalties of rare, commanded and gyro-heading causes.
    """
    unusual = decisions.unusual_nats if term.unusual else 0.0
    rare = decisions.rare_nats if term.name in registry() and term.name not in decisions.common else 0.0
    rare += decisions.commanded_nats if term.name in decisions.commanded else 0.0
    return 0.5 * term.charged * float(np.log(count)) + float(np.log(term.trials)) + unusual + rare
