"""Comparison of a clock offset with effects that are equal to it to first order."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.study.estimate import gauss_newton
from odomcorrupt.study.estimate.heading_source import sees_travel
from odomcorrupt.study.io.clock import Clock
from odomcorrupt.study.select.candidates import tried, with_shape_refined
from odomcorrupt.study.select.decisions import penalty
from odomcorrupt.study.select.elimination import drop_term
from odomcorrupt.study.select.score import score_terms
from odomcorrupt.study.terms.term import LibraryTerm

if TYPE_CHECKING:
    from collections.abc import Container, Sequence

    from odomcorrupt.study.estimate.clocks import Clocks
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.candidates import Candidate
    from odomcorrupt.study.select.decisions import Decisions
    from odomcorrupt.study.select.dependence import Dependence

CLOCK_LIKE_EFFECTS = ("accel_slip", "backlash")
"""Names of wheel effects at changes of speed, which resemble a clock offset."""

_LEAST_S = 0.04
"""Least offset of the odometry's clock at which a lag is tested, seconds: motors and filters lag by 50 ms and more."""
_LAGS, _MISFIT = ("channel_lag", "motor_lag", "steering_lag"), 0.2
"""Names of lags; largest offset, as a fraction of a time constant, that may be a lag's misfit (as `_MISFIT_GAIN`)."""


class InPlaceOfClock(NamedTuple):
    """An effect fitted in place of a clock offset.

    candidate : the effect, beside the model without a clock
    fit : the model with the effect and without the clock
    more_nats : log likelihood of that fit minus that of the model with the clock, nats
    """

    candidate: Candidate
    fit: Fit
    more_nats: float


def lag_in_place(fit: Fit, decisions: Decisions, *, first: bool = False) -> InPlaceOfClock | None:
    """Return a fit with a lag in place of the offset of the odometry's clock; None if not applicable.

    A lag is a delay to first order, so a clock offset, which is estimated before all effects, absorbs it. If the
    odometry leads, it may integrate commands, which motors follow with a lag; if it is late, it may be filtered. A
    filter of all speeds is not tested before all effects (`first`), because filters with two time constants resemble
    it; by the later test these are explained by a clock and the lag of one speed.
    """
    clocks = fit.problem.clocks
    late_s = [clock.offset_s for clock in clocks]
    motors = max(late_s) < 0.0
    tau_s = min(map(abs, late_s)) if motors or min(late_s) > 0.0 else 0.0
    have = {effect.name for effect in fit.effects}
    recordings = fit.problem.recordings
    # A laser has a separate clock, so an offset is no sign of a lag.
    tested = sees_travel(recordings) and not any(r.matched for r in recordings)
    if not np.any(fit.free_clocks) or tau_s < _LEAST_S or not tested:
        return None
    late = registry()["motor_lag"]() if motors else effect_from_values("channel_lag", {"channel": "all"})
    if late.name in have or (first and not motors):
        return None
    term = LibraryTerm.of(late, fit.problem.motions)
    without = fit.refit(clocks=(Clock(),) * len(clocks), free_clocks=((False, False),) * len(clocks))
    (score,) = score_terms(without, [term], decisions, family=1)
    with_it = without.refit([*without.effects, term.effect([tau_s])], weights_of=without)
    candidate = tried(without, with_it, score, decisions)
    if candidate.refused:
        return None
    other = with_it.refit()
    for name in (e.name for e in fit.effects if e.name in registry()):
        # shapes refined with the clock offset have absorbed a part of its misfit
        effect = next(e for e in other.effects if e.name == name)
        (score,) = score_terms(drop_term(other, effect), [LibraryTerm.of(effect, other.problem.motions)], decisions)
        other = with_shape_refined(other, score, decisions)[0]
    return InPlaceOfClock(candidate, other, more_nats(other, fit))


def without_clock(fit: Fit, given: Container[str]) -> Fit | None:
    """Return a fit without clocks if they gain nothing beside a wheel effect that resembles them; else None.

    Clocks are estimated before all effects. Once the wheel effect is in the model, and its track has been refined, an
    offset may be superfluous, except that of a laser, which has a clock of its own.

    given : names of effects that were in the model from the beginning
    """
    like = [e for e in fit.effects if e.name in CLOCK_LIKE_EFFECTS and e.name not in given]
    if not like or not np.any(fit.free_clocks) or any(r.matched for r in fit.problem.recordings):
        return None
    count = len(fit.free_clocks)
    other = fit.refit(clocks=(Clock(),) * count, free_clocks=((False, False),) * count)
    return other if more_nats(other, fit) + _clock_penalty(fit) > 0.0 else None


def penalised_nats(here: Fit, there: Fit, included: Sequence[Dependence], decisions: Decisions) -> float:
    """Return the gain in log likelihood of `here` over `there`, each less the penalties of its effects and free clocks.

    In nats; likelihoods are compared as by `more_nats`.

    included : dependences that are in one of the models
    """
    forms = {one.name: one.best.score.penalty for one in included if one.best is not None}

    def penalties(fit: Fit) -> float:
        motions, count = fit.problem.motions, len(fit.problem.intervals)
        library = (penalty(LibraryTerm.of(e, motions), count, decisions) for e in fit.effects if e.name not in forms)
        return _clock_penalty(fit) + sum(library) + sum(forms[e.name] for e in fit.effects if e.name in forms)

    return more_nats(here, there) + penalties(there) - penalties(here)


def _clock_penalty(fit: Fit) -> float:
    return 0.5 * float(np.log(len(fit.problem.intervals)) * np.sum(fit.free_clocks))


def beside_lags(clocks: Clocks, fit: Fit) -> Clocks:
    """Return the clocks of a model; they get a rival if their offset may be the misfit of a lag in the model.

    No real lag is exactly of first order. The first-order model leaves a small delay, which resembles an offset.
    """
    lags_s = [abs(getattr(e, p.name)) for e in fit.effects if e.name in _LAGS for p in amplitudes(e)]
    offset_s = max(abs(clock.offset_s) for clock in fit.problem.clocks)
    misfit = (0.0,) if offset_s < _MISFIT * max(lags_s, default=0.0) else ()
    return replace(clocks, clocks=fit.problem.clocks, margins_nats=(*clocks.margins_nats, *misfit))


def more_nats(here: Fit, there: Fit) -> float:
    """Return the log likelihood of `here` minus that of `there`, nats: the smaller difference of both robust weights.

    Both are evaluated on the truth samples covered by the odometry under the clocks of both fits.
    """
    here, there = (_within(one, _common(here, there)) for one in (here, there))
    same = there.refit(weights_of=here)
    turned = here.refit(weights_of=there)
    return min(here.log_likelihood - same.log_likelihood, turned.log_likelihood - there.log_likelihood)


def _common(here: Fit, there: Fit) -> list[tuple[float, float]]:
    """Return the time span, s, of each recording that the odometry covers under the clocks of both fits."""
    ends = [[r.odometry_s[[0, -1]] for r in one.problem.left] for one in (here, there)]
    return [(max(a[0], b[0]), min(a[1], b[1])) for a, b in zip(*ends, strict=True)]


def _within(one: Fit, spans_s: list[tuple[float, float]]) -> Fit:
    """Return the fit repeated on the truth samples within the span of each recording."""
    recordings = []
    for recording, (first_s, last_s) in zip(one.problem.recordings, spans_s, strict=True):
        truth, truth_s = recording.truth, recording.truth.seconds_since(recording.origin_ns)
        rows = (truth_s >= first_s) & (truth_s <= last_s)
        known = truth.covariance[rows] if truth.covariance is not None else None
        part = Trajectory(truth.stamps_ns[rows], truth.xyt[rows], known, truth.relative)
        recordings.append(replace(recording, truth=part))
    return gauss_newton.fit(
        recordings,
        one.effects,
        clocks=one.problem.clocks,
        free_clocks=one.free_clocks,
        approach=one.problem.approach,
        start=one.noise.free,
        random=one.random,
    )
