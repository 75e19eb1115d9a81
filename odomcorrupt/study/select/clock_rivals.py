"""Comparison of a clock offset with effects that are equal to it to first order."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.study.estimate import gauss_newton
from odomcorrupt.study.estimate.heading_source import sees_travel
from odomcorrupt.study.io.clock import Clock
from odomcorrupt.study.io.encoders import tick_of
from odomcorrupt.study.select.candidates import Candidate, library_candidates, tried, with_shape_refined
from odomcorrupt.study.select.decisions import penalty
from odomcorrupt.study.select.elimination import drop_term
from odomcorrupt.study.select.score import project_out, score_terms
from odomcorrupt.study.terms.term import LibraryTerm

if TYPE_CHECKING:
    from collections.abc import Container, Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.estimate.clocks import Clocks
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.io.recording import Recording
    from odomcorrupt.study.select.decisions import Decisions
    from odomcorrupt.study.select.dependence import Dependence

CLOCK_LIKE_EFFECTS = ("accel_slip", "backlash")
"""Names of wheel effects at changes of speed, which resemble a clock offset."""

_AMBIGUOUS_S = 0.02
"""Largest clock offset that these effects can imitate, seconds."""
_LEAST_S = 0.04
"""Least offset of the odometry's clock at which a lag is tested, seconds: motors and filters lag by 50 ms and more."""
_CLEAR = -100.0
"""Difference, nats, that neither penalties nor the few samples of the truth at the ends of a drive can reverse."""
_HOPELESS, _BESIDE_NATS = -300.0, 30.0
"""Difference, nats, that refined shapes cannot reverse either; gain of a lag beside a clock over either alone, which
other errors at changes of speed, not yet in the model, do not reach."""
_LAGS, _MISFIT = ("channel_lag", "motor_lag", "steering_lag"), 0.2
"""Names of lags; largest offset, as a fraction of a time constant, that may be a lag's misfit (as `_MISFIT_GAIN`)."""


class ClockRival(NamedTuple):
    """A model without the clock offsets of another one, or with offsets that the other one lacks.

    more_nats : its log likelihood minus that of the other model, nats
    candidates : library effects in place of the clock, the included one first; empty if none was included
    """

    fit: Fit
    more_nats: float
    candidates: Sequence[Candidate] = ()


def lag_in_place(fit: Fit, decisions: Decisions, *, first: bool = False) -> ClockRival | None:
    """Return a fit with a lag in place of, or beside, the offset of the odometry's clock; None if not applicable.

    A lag is a delay to first order, so a clock offset, which is estimated before all effects, absorbs it. If the
    odometry leads, it may integrate commands, which motors follow with a lag; if it is late, it may be filtered. A
    filter of all speeds is not tested before all effects (`first`), because filters with two time constants resemble
    it; by the later test these are explained by a clock and the lag of one speed. Odometry of whole ticks integrates no
    commands, and a lag gains beside it because it smooths the ticks.
    """
    late_s = [clock.offset_s for clock in fit.problem.clocks]
    motors = max(late_s) < 0.0
    tau_s = min(map(abs, late_s)) if motors or min(late_s) > 0.0 else 0.0
    recordings = fit.problem.recordings
    if not np.any(fit.free_clocks) or tau_s < _LEAST_S or not _shows_lags(recordings):
        return None
    if motors and any(tick_of(r) is not None for r in recordings):
        return None
    late = registry()["motor_lag"]() if motors else effect_from_values("channel_lag", {"channel": "all"})
    if late.name in fit.by_name or (first and not motors):
        return None
    term = LibraryTerm.of(late, fit.problem.motions)
    without = _at_clock(fit, fit.effects)
    (score,) = score_terms(without, [term], decisions, family=1)
    with_it = without.refit([*without.effects, term.effect([tau_s])], weights_of=without)
    candidate = tried(without, with_it, score, decisions)
    beside = _lag_beside_clock(fit, term.effect([0.5 * tau_s]), decisions)
    beside = beside._replace(candidates=(candidate,))
    clearly_more_nats = beside.more_nats - _BESIDE_NATS
    if candidate.refused:
        return beside if clearly_more_nats > 0.0 else None
    other = with_it.refit()
    if other.log_likelihood - fit.log_likelihood > _HOPELESS:
        other = _refined(other, fit, decisions)
    alone = ClockRival(other, more_nats(other, fit, clear=_CLEAR), (candidate,))
    return beside if clearly_more_nats > max(alone.more_nats, 0.0) else alone


def _lag_beside_clock(fit: Fit, lag: Effect, decisions: Decisions) -> ClockRival:
    """Return a fit with a lag beside the clock offset, which has absorbed it; its gain is less its penalty.

    An offset within the odometry's period belongs to the lag: a lag of discrete steps and one of continuous motion with
    the same mean delay differ by half a period.
    """
    half = [replace(clock, offset_s=0.5 * clock.offset_s) for clock in fit.problem.clocks]
    other = _refined(fit.refit([*fit.effects, lag], clocks=half), fit, decisions)
    if _within_period(other):
        return ClockRival(other, -np.inf)
    paid = penalty(LibraryTerm.of(lag, fit.problem.motions), len(fit.problem.intervals), decisions)
    return ClockRival(other, more_nats(other, fit, clear=_CLEAR) - paid)


def cancelled_lag(fit: Fit, gain: float, decisions: Decisions) -> ClockRival | None:
    """Return a fit with a lag and the clock offset that hid it, together far likelier than any effect; None if none.

    A late clock cancels a lag of the motors, and an early one a filter of the odometry, to first order. They leave
    errors where accelerations change, which an effect that fits badly may explain in part.

    gain : that of the best effect, nats
    """
    recordings, motions, early = fit.problem.recordings, fit.problem.motions, fit.problem.clocks
    offset_s, has_lag = max(abs(clock.offset_s) for clock in early), any(name in fit.by_name for name in _LAGS)
    if offset_s >= _LEAST_S or has_lag or not _shows_lags(recordings):
        return None
    lags = [(effect_from_values("channel_lag", {"channel": "all", "by": "filter"}), -1.0)]
    if not any(tick_of(r) is not None for r in recordings):
        lags.append((registry()["motor_lag"](), 1.0))
    rest, whiten = project_out(fit), fit.noise.whitener.whiten
    shifts = [] if np.any(fit.free_clocks) else [fit.problem.columns(registry()["time_offset"]())]
    for lag, sign in lags:
        term = LibraryTerm.of(lag, motions)
        trial = term.effect([_LEAST_S])
        columns = np.concatenate([fit.problem.replacement(lag, trial), *shifts], axis=2)
        if rest.gain(whiten(columns)) <= gain + _BESIDE_NATS:
            continue
        late = [replace(clock, offset_s=clock.offset_s + sign * _LEAST_S) for clock in early]
        free = [(True, rate) for _, rate in fit.free_clocks]
        other = _refined(fit.refit([*fit.effects, trial], clocks=late, free_clocks=free), fit, decisions)
        if _within_period(other):
            continue
        paid = penalty(term, len(fit.problem.intervals), decisions) + _clock_penalty(other) - _clock_penalty(fit)
        nats = more_nats(other, fit, clear=_CLEAR) - paid
        if nats > gain + _BESIDE_NATS:
            (score,) = score_terms(fit, [term], decisions, family=1)
            candidate = Candidate(score=score, fit=other, fitted=other.by_name[lag.name], gain=nats)
            return ClockRival(other, nats, (candidate,))
    return None


def _shows_lags(recordings: Sequence[Recording]) -> bool:
    """Return whether an offset of the clocks may be a sign of a lag: a laser has a clock of its own."""
    return sees_travel(recordings) and not any(r.matched for r in recordings)


def _within_period(fit: Fit) -> bool:
    """Return whether a clock offset is within the odometry's period, and so may belong to a lag."""
    period_s = max(float(np.median(np.diff(r.odometry_s))) for r in fit.problem.recordings)
    return min(abs(clock.offset_s) for clock in fit.problem.clocks) < period_s


def _refined(other: Fit, fit: Fit, decisions: Decisions) -> Fit:
    """Return another fit with the shapes of the effects of `fit` refined: these have absorbed a part of its misfit."""
    return _reshaped(other, [e.name for e in fit.effects if e.name in registry()], decisions)


def clock_beside_lag(fit: Fit, given: Container[str], decisions: Decisions) -> ClockRival | None:
    """Return a fit with a clock offset beside a lag, which the model lacks; None if not applicable.

    A clock is estimated before all effects, and is left out where it delays one speed and a lag delays the other. The
    library then finds a lag of each, of which one is the clock; the fit has the clock in its place. A filter of all
    speeds has absorbed a clock; the fit has both.

    given : names of effects that were in the model from the beginning
    """
    recordings = fit.problem.recordings
    delay = fit.by_name.get("channel_lag")
    if delay is None or delay.name in given or np.any(fit.free_clocks) or not _shows_lags(recordings):
        return None
    others = [e for e in fit.effects if e.name in _LAGS and e is not delay]
    late_s = 0.0
    effects = list(fit.effects)
    if others:
        (tau,) = amplitudes(delay)
        late_s = getattr(delay, tau.name)
        effects = [_slower(e, late_s) if e in others else e for e in effects if e is not delay]
    elif (delay.channel, delay.by) != ("all", "filter"):  # type: ignore[attr-defined]
        return None
    count = len(fit.free_clocks)
    other = fit.refit(effects, clocks=(Clock(late_s),) * count, free_clocks=((True, False),) * count)
    other = _reshaped(other, [e.name for e in others], decisions)
    paid = 0.0 if others else _clock_penalty(other)
    return ClockRival(other, more_nats(other, fit, clear=_CLEAR) - paid)


def _reshaped(fit: Fit, names: Sequence[str], decisions: Decisions) -> Fit:
    """Return a fit with the shapes of some of its library effects refined."""
    for name in names:
        effect = fit.by_name[name]
        (score,) = score_terms(drop_term(fit, effect), [LibraryTerm.of(effect, fit.problem.motions)], decisions)
        fit = with_shape_refined(fit, score, decisions)[0]
    return fit


def _slower(lag: Effect, seconds: float) -> Effect:
    """Return a lag with a larger time constant."""
    (tau,) = (p for p in amplitudes(lag) if p.unit == "s")
    return replace(lag, **{tau.name: min(getattr(lag, tau.name) + seconds, tau.high)})  # type: ignore[type-var]


def swapped(
    fit: Fit, late: set[str], included: Sequence[Dependence], given: Container[str], decisions: Decisions
) -> ClockRival | None:
    """Return a fit with a library effect in place of small clock offsets, or with offsets in place of wheel effects.

    None if the model has neither, or no dependence on the acceleration beside its clocks. Such a dependence may stand
    for an offset, too. The gain is that of `_penalised_nats`.

    late : names of dependences on the acceleration
    included : dependences in the model
    given : names of effects that were in the model from the beginning
    """
    candidates: Sequence[Candidate] = ()
    if np.any(fit.free_clocks):
        if not late or max(abs(clock.offset_s) for clock in fit.problem.clocks) >= _AMBIGUOUS_S:
            return None
        other = _at_clock(fit, [e for e in fit.effects if e.name not in late])
        tested = library_candidates(other, decisions)
        if tested and not tested[0].refused:
            candidates, best = tested, tested[0]
            if best.fit is not None:
                other = with_shape_refined(best.fit.refit(), best.score, decisions)[0]
    else:
        like = [*_clock_like(fit, given), *(e for e in fit.effects if e.name in late)]
        if not like:
            return None
        other = _at_clock(fit, [e for e in fit.effects if e not in like], offset_free=True)
    return ClockRival(other, _penalised_nats(other, fit, included, decisions), candidates)


def _clock_like(fit: Fit, given: Container[str]) -> list[Effect]:
    """Return the effects of a model that resemble a clock offset and were not in it from the beginning."""
    return [e for e in fit.effects if e.name in CLOCK_LIKE_EFFECTS and e.name not in given]


def _at_clock(fit: Fit, effects: Sequence[Effect], *, offset_free: bool = False) -> Fit:
    """Return a fit of other effects that begins with right clocks, whose offsets may be free."""
    count = len(fit.free_clocks)
    return fit.refit(effects, clocks=(Clock(),) * count, free_clocks=((offset_free, False),) * count)


def without_clock(fit: Fit, given: Container[str]) -> Fit | None:
    """Return a fit without clocks if they gain nothing beside a wheel effect that resembles them; else None.

    Clocks are estimated before all effects. Once the wheel effect is in the model, and its track has been refined, an
    offset may be superfluous, except that of a laser, which has a clock of its own.

    given : names of effects that were in the model from the beginning
    """
    clocked = np.any(fit.free_clocks) and not any(r.matched for r in fit.problem.recordings)
    if not clocked or not _clock_like(fit, given):
        return None
    other = _at_clock(fit, fit.effects)
    return other if more_nats(other, fit, clear=_CLEAR) + _clock_penalty(fit) > 0.0 else None


def _penalised_nats(here: Fit, there: Fit, included: Sequence[Dependence], decisions: Decisions) -> float:
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


def more_nats(here: Fit, there: Fit, *, clear: float = -np.inf) -> float:
    """Return the log likelihood of `here` minus that of `there`, nats: the smaller difference of both robust weights.

    Both are evaluated on the truth samples covered by the odometry under the clocks of both fits.

    clear : difference, nats, below which one with the same weights on all samples suffices
    """
    if np.isfinite(clear):
        difference = here.log_likelihood - there.refit(weights_of=here).log_likelihood
        if difference < clear:
            return difference
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
        inside = (recording.truth_s >= first_s) & (recording.truth_s <= last_s)
        recordings.append(replace(recording, truth=recording.truth.only(inside)))
    return gauss_newton.fit(
        recordings,
        one.effects,
        clocks=one.problem.clocks,
        free_clocks=one.free_clocks,
        approach=one.problem.approach,
        start=one.noise.free,
        random=one.random,
    )
