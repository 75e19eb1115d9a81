"""Every number that decides what is included, kept, replaced or dropped, each with its reason.

Numbers that are part of a computation (steps of a search, numeric guards) stay where they are used; these are the ones
that another judgement might set otherwise. `learn(..., decisions=replace(DECISIONS, level=0.05))` does.

Unless said otherwise gains are in nats: differences of log likelihood, less a penalty of half the logarithm of the
number of intervals for each number that is fitted, and the logarithm of the size of the family it was selected from.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects import registry

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.study.terms.term import Term

__all__ = ["DECISIONS", "Decisions", "Practical", "PriorOdds", "error_shares", "penalty"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PriorOdds:
    """What enters the reported probability of an effect besides the fits themselves, see `confidence`.

    temper : how much a nat counts; below 1 if the noise model were too narrow. The laboratory's reliability curve
        lies on the diagonal at 1
    elsewhere : odds against any name however plain: causes that the library does not have
    unexplained : what is left in the end, in parts of what the effect explains, counts as much as odds against it
    correlated : the same of correlated noise, which may well be there besides
    dependence_nats : by how many nats a basis function is the likelier a priori. Of 90 effects of the laboratory's
        third and fourth runs that gained 2 to 6 nats more than the best basis function would, 81 were right and 9
        wrong, 8 of these for causes that no library has
    """

    temper: float = 1.0
    elsewhere: float = 0.005
    unexplained: float = 1.0
    correlated: float = 0.2
    dependence_nats: float = 1.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Practical:
    """What matters in practice; smaller things are reported as there, and as negligible.

    share : part by which the 10 s error has to grow without a part of the model
    far_share : the same over 50 m of path, of which a drive has few windows
    per_m : what has to be moved per metre of path, m: a tenth of a millimetre, which is 0.01 %. Nominal radii and
        tracks are known to a few tenths of a per cent, and calibration leaves some hundredths
    """

    share: float = 0.02
    far_share: float = 0.1
    per_m: float = 1e-4


@dataclass(frozen=True, slots=True, kw_only=True)
class Decisions:
    """The decisions of the selection.

    max_effects, max_correlated, max_dependences : how many effects of the library, kinds of correlated noise and basis
        functions are included at most; mixtures of more than three causes were never separable in ten minutes

    level : probability of including any effect of the library on data without one, by the worse of two tests (under
        the noise model, and robust to it). In 200 controls of the laboratory one effect was included
    shortlist : how many candidates are refitted in a step, and how many dependences
    shortlist_share : part of the leader's evidence below which a refit would not change the order
    testable_errors : an effect is testable if this many standard errors fit into half of what is physically possible:
        a threshold of about 4 to 5 standard errors is what the laboratory detects
    max_share : largest part of the robot's own motion that a basis function may explain: what moves by itself is no
        error of moving
    drift_factor, drift_plain, drift_errors : an inclusion must not raise the 10 s position error of the fitted data by
        more than the first factor, unless windows compared one by one show less than so many standard errors of it;
        by more than the second factor never. An effect that the drift hardly depends on moves it by about a hundredth

    alternative_nats : effects within so much of the best one are alternatives, which the data do not separate: odds
        of 20 to 1
    replacement_nats : by how much a basis function has to explain more than an effect of the library to be included
        instead: a known cause is the likelier a priori
    copy_share : part of what an effect explains of which a basis function that explains more than this part is a copy
        of it and no replacement; causes of their own shared at most 0.96
    form_share : part of the best form's gain that other forms of a dependence need to be fitted beside it
    reshape_nats : what a refined shape has to gain in the likelihood of a refit
    common, rare_nats : causes that every robot has a little of, and by how many nats the others are the less likely a
        priori: nominal radii and tracks are never exact (Borenstein & Feng 1996), gyros have a bias and a scale, and a
        steering its zero and its ratio; seven to one
    commanded, commanded_nats : causes of odometry that is computed from commands or from counts that get lost, and by
        how many nats these are the less likely a priori on top: most odometry is of encoders; four hundred to one
    unusual_nats : what a heading from a gyro has to explain on top where a whole model, or a basis function, says so
    unusual_shape_nats : the same in a shape search of one effect, before it is refitted
    known_gyro_nats : the same where a gyro's bias is in the model, so that there is a gyro
    related_nats, related_share : what a disc has to explain, and of what the best basis function explains, for
        rectangles to be worth their time

    drop_nats : an effect whose Wald statistic is less than twice this is dropped: 1 % for one number
    correlated_nats : what correlated noise has to gain; on clean data it gains 3.4 at most
    mean_reverting_nats : what a mean-reverting bias has to gain; truth by SLAM errs alike for seconds, and gains 20
    counted_nats : what lost increments and ticks are taken to gain: they are counted in the odometry, not inferred

    curve_nats, curve_of_turns_nats : what a curve without a basis function has to gain to be reported, and one of the
        yaw error over how the robot turns: tight steering (3 per second) answers to the noise within an interval, and
        bends such curves by 5 to 24 nats where nothing is wrong
    exact_nats : by how much a basis function must exceed its penalty in the screening to be scored exactly

    least_confidence : a name that is less likely right is left out, unless the held-out error grows without it
    heterogeneity_level : probability of reporting that recordings of one robot disagree about any parameter
    prior : of the reported probabilities
    practical : what matters
    """

    max_effects: int = 6
    max_correlated: int = 2
    max_dependences: int = 2
    level: float = 0.01
    shortlist: int = 4
    shortlist_share: float = 0.25
    testable_errors: float = 4.2
    max_share: float = 0.5
    drift_factor: float = 1.02
    drift_plain: float = 1.15
    drift_errors: float = 2.0
    alternative_nats: float = 3.0
    replacement_nats: float = 8.0
    copy_share: float = 0.985
    form_share: float = 0.7
    reshape_nats: float = 1.0
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
    commanded: tuple[str, ...] = ("dead_band", "truncated_velocity", "counts_lost")
    commanded_nats: float = 6.0
    unusual_nats: float = 4.0
    unusual_shape_nats: float = 2.0
    known_gyro_nats: float = -1.0
    related_nats: float = 30.0
    related_share: float = 0.5
    drop_nats: float = 3.3
    correlated_nats: float = 6.0
    mean_reverting_nats: float = 25.0
    counted_nats: float = 100.0
    curve_nats: float = 4.0
    curve_of_turns_nats: float = 25.0
    exact_nats: float = 3.0
    least_confidence: float = 0.1
    heterogeneity_level: float = 1e-3
    prior: PriorOdds = field(default_factory=PriorOdds)
    practical: Practical = field(default_factory=Practical)


DECISIONS = Decisions()


def penalty(term: Term, count: int, decisions: Decisions) -> float:
    """Return the nats that a term must gain on `count` intervals to be no worse than nothing.

    Half of the logarithm of the count for each number that is fitted (Schwarz 1978), the logarithm of the size of the
    family that it was selected from, and what is the less likely a priori.
    """
    unusual = decisions.unusual_nats if term.unusual else 0.0
    rare = _rare_nats(term.name, decisions)
    rare += decisions.commanded_nats if term.name in decisions.commanded else 0.0
    return 0.5 * term.charged * float(np.log(count)) + float(np.log(term.trials)) + unusual + rare


def error_shares(names: Sequence[str], decisions: Decisions) -> list[float]:
    """Return the share (n,) of the probability of any false inclusion that each of the terms tested together may take.

    In proportion to how likely each is a priori: weighted Bonferroni (Genovese, Roeder & Wasserman, Biometrika 93,
    2006). With equal shares every rare effect that joins the library makes the common ones harder to find.

    Parameters
    ----------
    names : names (n,) of the terms, the effects of a library that are separable from the model
    decisions : which effects are common, and how much the less likely the others are

    """
    weights = [float(np.exp(-_rare_nats(name, decisions))) for name in names]
    return [weight / sum(weights) for weight in weights]


def _rare_nats(name: str, decisions: Decisions) -> float:
    """Return by how many nats an effect of the library is the less likely a priori than a common one."""
    return decisions.rare_nats if name in registry() and name not in decisions.common else 0.0
