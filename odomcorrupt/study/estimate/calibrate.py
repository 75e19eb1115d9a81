"""Fit of a robot's model to recordings: the computation behind `odomcorrupt fit`.

Correlation of the parameters: the errors of mean parameters (effects) and of variance parameters (noise) are
independent to first order: the information matrix of a Gaussian likelihood has no block between the two. So there are
two blocks. That of the effects comes from the normal equations, with clocks and mountings free. That of the noise comes
from the average information on the logarithms of the coefficients, with the noise of the truth free.

Profile-likelihood confidence intervals of the noise coefficients.

Coefficients are positive and their likelihoods are skewed, so a standard error alone would be wrong. The interval is
the range in which the profile likelihood is within 1.92 nats of its maximum (95 %); it may begin at zero.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2

from odomcorrupt.effects import effect_from_values
from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.errors import EffectError
from odomcorrupt.model.correlation import Correlation
from odomcorrupt.model.motion_model import MotionModel, Noise, Setup
from odomcorrupt.model.noise_laws import LAWS
from odomcorrupt.study.estimate.clocks import Clocks, clock_rivals, find_clocks, find_setup, levelled, mounting_of
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.correlation_length import with_correlation_lengths
from odomcorrupt.study.estimate.drive_type import drive_type_of
from odomcorrupt.study.estimate.gauss_newton import Fit, fit
from odomcorrupt.study.estimate.noise_likelihood import HIGHEST, LOWEST, NAMES, NoiseLikelihood, pseudo_inverse
from odomcorrupt.study.estimate.random_process import without_process
from odomcorrupt.study.estimate.robust_errors import with_robust_errors
from odomcorrupt.study.estimate.windows import ten_second_error
from odomcorrupt.study.io.encoders import restore_lost
from odomcorrupt.study.io.first_look import factors_of
from odomcorrupt.study.io.recording import content_of, shared_frame

if TYPE_CHECKING:
    from collections.abc import Container, Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.intervals import Intervals
    from odomcorrupt.study.io.recording import Recording


_DROP = float(chi2.ppf(0.95, 1)) / 2.0


@dataclass(frozen=True, slots=True)
class Interval:
    """A coefficient with its 95 % interval; `low` is 0 if the data are compatible with no such noise."""

    name: str
    value: float
    low: float
    high: float

    @property
    def identifiable(self) -> bool:
        """Whether the drive bounds the coefficient from above."""
        return self.high < HIGHEST

    @property
    def standard_error(self) -> float:
        """Symmetric standard error equivalent to the interval; from its lower side if the upper one is unbounded."""
        return (self.value - self.low) / 1.96 if not isfinite(self.high) else (self.high - self.low) / (2.0 * 1.96)


def coefficient_intervals(fitted: Fit, columns: Array) -> list[Interval]:
    """Return the interval of each coefficient of the noise law, in the order of `NAMES`; columns are those of the fit.

    A coefficient that the drive does not excite (noise of turns without any turn) has no upper bound.
    """
    problem, noise = fitted.problem, fitted.noise

    def over(intervals: Intervals) -> NoiseLikelihood:
        return NoiseLikelihood(intervals, fitted.components, columns, noise.weights, headings=problem.headings)

    likelihood, free = over(problem.intervals), noise.free
    # with a localisation as the truth, noise was fitted with a prior: compare with that fit
    alone = any(r.localised for r in problem.recordings)
    if fitted.random:  # otherwise their contribution would be fitted as noise of each step
        likelihood = over(without_process(likelihood.evaluate(free), problem, columns, fitted.random))
        free, alone = likelihood.maximise(free).free, True
    top = likelihood.posterior(likelihood.evaluate(free)) if alone else fitted.log_likelihood
    found = []
    for position, index in enumerate(fitted.components.active):
        value = float(getattr(noise.coefficients, NAMES[index]))
        low, high = (_edge(likelihood, free, position, direction, top) for direction in (-1.0, 1.0))
        found.append(Interval(NAMES[index], value, min(low, value), max(high, value)))
    found += [Interval(NAMES[index], 0.0, 0.0, float("inf")) for index in fitted.components.unseen]
    return sorted(found, key=lambda interval: NAMES.index(interval.name))


def _edge(likelihood: NoiseLikelihood, start: Array, position: int, direction: float, top: float) -> float:
    """Return the value at which the profile has dropped by the quantile: doubling steps, then interpolation."""
    free, best = start.copy(), float(start[position])
    inside, inside_drop = max(best, np.log(1e-4)) if direction > 0 else best, 0.0
    step = 0.1
    while True:  # to a bound of the coefficient at most
        outside = inside + direction * step
        if outside <= np.log(LOWEST):
            return 0.0
        if outside >= np.log(HIGHEST):
            return float("inf")
        free[position] = outside
        profiled = likelihood.maximise(free, fixed=position)
        drop = top - likelihood.posterior(profiled)
        if drop >= _DROP:
            # a parabola in the logarithm between the two points
            share = (np.sqrt(_DROP) - np.sqrt(max(inside_drop, 0.0))) / (np.sqrt(drop) - np.sqrt(max(inside_drop, 0.0)))
            return float(np.exp(inside + share * (outside - inside)))
        free, inside, inside_drop = profiled.free, outside, drop
        step *= 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotFit:
    """A robot's model with the fit and the clocks from which it was made.

    intervals : the noise coefficients with their 95 % confidence intervals
    ten_second_error_m : RMS position error after 10 s on the fitted recordings: a description, not a test
    """

    model: MotionModel
    fit: Fit
    clocks: Clocks
    intervals: tuple[Interval, ...]
    ten_second_error_m: float

    @property
    def noise_at_most(self) -> list[Interval]:
        """Coefficients with an upper bound only, because the truth of every recording is a localisation."""
        localised = all(r.localised for r in self.fit.problem.recordings)
        return [i for i in self.intervals if localised and i.identifiable]

    @property
    def information_nats(self) -> float:
        """Log likelihood minus half the log of the number of intervals per noise coefficient (Schwarz criterion)."""
        intervals = len(self.fit.problem.intervals)
        return self.fit.log_likelihood - 0.5 * len(self.fit.components.active) * float(np.log(intervals))


def effects_to_fit(start: MotionModel | None, add: Sequence[str]) -> list[Effect]:
    """Return the effects to fit: those of a start model at their values, and the added ones at their identity."""
    effects = [*start.effects, *start.setup.effects] if start is not None else []
    for name in add:
        if any(effect.name == name for effect in effects):
            raise EffectError(f"--add {name}: the start model has it already; leave it out")
        effect = effect_from_values(name, {})
        if effect.clock:
            raise EffectError(f"--add {name}: clocks are part of every fit already; leave it out")
        if effect.kind == "noise":
            raise EffectError(f"--add {name}: a random effect cannot be fitted from recordings by this command")
        effects.append(effect)
    return effects


def fit_robot(
    recordings: Sequence[Recording],
    effects: Sequence[Effect],
    *,
    law_name: str,
    start: MotionModel | None = None,
    clocks: Clocks | None = None,
    shaped: Container[str] = (),
) -> RobotFit:
    """Return the fit of clocks and set-up (unless clocks are given), effects and noise to recordings of one robot.

    Random effects are not fitted: random coefficients are part of the covariance; detectable encoder faults are undone.

    effects : effects to fit; their values are the starting point
    law_name : noise law, a key of `LAWS`
    start : model whose step and track are kept
    clocks : known clocks; by default they are estimated, and so are lever arm and mounting yaw
    shaped : names of effects whose shapes were searched in the same recordings
    """
    recordings = [restore_lost(recording, effects) for recording in recordings]
    approach = choose_approach(recordings, law_name)
    recordings = with_correlation_lengths(recordings, approach)
    start_noise = None
    effects = [*effects, *mounting_of(recordings, effects)]
    if clocks is None:
        clocks = find_clocks(recordings, approach, clock_rivals(recordings))
        named = {effect.name for effect in effects}
        effects += [one for one in factors_of(recordings) if one.name not in named]
        effects = [*effects, *find_setup(recordings, effects, clocks, approach)]
        start_noise = clocks.noise
    recordings = levelled(recordings, clocks)
    fitted = fit(
        recordings, effects, clocks=clocks.clocks, free_clocks=clocks.free, approach=approach, start=start_noise
    )
    fitted = with_robust_errors(fitted, shaped)
    columns = fitted.design_matrix
    intervals = coefficient_intervals(fitted, columns)
    errors = {interval.name: interval.standard_error for interval in intervals if interval.value > 0.0}
    error = ten_second_error(fitted)
    model = model_of(fitted, [e for e in effects if e.kind == "noise"])
    own = {f"{effect.name}.{p.name}" for effect in model.effects for p in amplitudes(effect)}
    model = replace(
        model,
        noise=replace(model.noise, step=start.noise.step if start is not None else None),
        track_m=model.track_m if model.track_m is not None or start is None else start.track_m,
        standard_errors=errors | dict(model.standard_errors),
        correlation=fit_correlation(fitted, columns, own | errors.keys()),
        source=dict(model.source) | {"ten_second_error_on_the_fitted_data_m": error},
    )
    robot = RobotFit(model=model, fit=fitted, clocks=clocks, intervals=tuple(intervals), ten_second_error_m=error)
    most = ", ".join(f"{i.name} {i.high:.2g}" for i in robot.noise_at_most)
    if not most:
        return robot
    noise = f"errors of the localisation cannot be separated from it; at most (95 %): {most}"
    return replace(robot, model=replace(model, source=dict(model.source) | {"noise": noise}))


def fit_every_law(
    recordings: Sequence[Recording], effects: Sequence[Effect], *, start: MotionModel | None = None
) -> dict[str, RobotFit]:
    """Return a fit with each noise law by name, with the same effects, clocks and set-up; most likely first.

    A law that depends on the step length is applied to the odometry's own steps. Parameters are those of `fit_robot`.
    """
    first, *others = (name for name, law in LAWS.items() if law.fitted)
    results = {first: fit_robot(recordings, effects, law_name=first, start=start)}
    same = [*results[first].fit.effects, *(e for e in effects if e.kind == "noise")]
    for name in others:
        results[name] = fit_robot(recordings, same, law_name=name, start=start, clocks=results[first].clocks)
    return dict(sorted(results.items(), key=lambda item: item[1].information_nats, reverse=True))


def model_of(fitted: Fit, random: Sequence[Effect] = ()) -> MotionModel:
    """Return the model file's content for a fit; random effects are added unchanged."""
    names = [f"{effect.name}.{p.name}" for effect in fitted.effects for p in amplitudes(effect)]
    problem = fitted.problem
    drive = drive_type_of(problem.recordings)
    clocks = zip(problem.recordings, problem.clocks, strict=True)
    topics = {r.odometry_topic for r in problem.recordings} - {""}
    return MotionModel(
        noise=Noise(problem.approach.law_name, fitted.noise.coefficients),
        effects=(*(e for e in fitted.effects if e.kind != "setup"), *random),
        track_m=problem.recordings[0].track_m,
        setup=Setup(
            effects=tuple(e for e in fitted.effects if e.kind == "setup"),
            truth=fitted.noise.truth,
            clocks={r.name: (c.offset_s, c.rate) for r, c in clocks},
            drive_type=drive.name if drive.known else "",
            pose_corrections=any(r.pose_corrections for r in problem.recordings),
            origin=next((r.geodetic_origin for r in problem.recordings if r.geodetic_origin is not None), None),
        ),
        standard_errors=dict(zip(names, map(float, fitted.standard_errors), strict=True)),
        source={
            "recordings": [r.name for r in problem.recordings],
            "fitted": [content_of(r) for r in problem.recordings],
            **({"odometry": topics.pop()} if len(topics) == 1 else {}),
            **({"frame": frame} if (frame := shared_frame(problem.recordings)) else {}),
            "regressors": problem.approach.side,
            "log_likelihood_nats": fitted.log_likelihood,
        },
    )


def fit_correlation(fitted: Fit, columns: Array, known: Container[str]) -> Correlation:
    """Return the correlations between the parameters for which a model file has standard errors.

    columns : (K, 3, q) design matrix of the fit, see `Fit.design_matrix`
    known : names of the standard errors that the file keeps
    """
    names = [f"{effect.name}.{p.name}" for effect in fitted.effects for p in amplitudes(effect)]
    active, noise = fitted.components.active, fitted.noise
    positions = [i for i in range(len(active)) if noise.free[i] > np.log(LOWEST) + 1.0]
    noise_names = [NAMES[active[i]] for i in positions]
    likelihood = NoiseLikelihood(
        fitted.problem.intervals, fitted.components, columns, noise.weights, headings=fitted.problem.headings
    )
    free = np.array([*positions, *range(len(active), len(noise.free))])
    _, information = likelihood.derivatives(likelihood.evaluate(noise.free), free)
    count = len(noise_names)
    whole = np.zeros((count + len(names),) * 2)
    whole[:count, :count] = pseudo_inverse(information)[:count, :count]
    whole[count:, count:] = noise.theta_covariance[: len(names), : len(names)]
    every = Correlation.of_covariance([*noise_names, *names], whole)
    return every.among([name for name in every.names if name in known])
