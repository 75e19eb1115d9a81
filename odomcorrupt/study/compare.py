"""Compare models with measurements: what they expect, what was measured, where they fail, which one is best.

A model is judged on recordings it was not fitted on. Where a recording was fitted, it is cut in two and the model is
fitted again on one half and judged on the other, both ways. Clocks belong to a recording, not to a robot: they are
estimated on each one, the same for every model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2

from odomcorrupt.model import TruthNoise
from odomcorrupt.study.approach import choose_approach
from odomcorrupt.study.clock import aligned
from odomcorrupt.study.failures import Failure, failures
from odomcorrupt.study.fit import fit
from odomcorrupt.study.headings import UNKNOWN_RAD
from odomcorrupt.study.likelihood import whitener
from odomcorrupt.study.nodes import join
from odomcorrupt.study.problem import pose_problem, undo
from odomcorrupt.study.search import Clocks, find_clocks
from odomcorrupt.study.trajectory import Trajectory
from odomcorrupt.study.windows import WindowErrors, distance_windows, rmse, time_windows, window_errors

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from odomcorrupt.model import MotionModel
    from odomcorrupt.pose import Array
    from odomcorrupt.study.approach import Approach
    from odomcorrupt.study.trajectory import Recording

__all__ = ["Comparison", "Horizon", "Judgement", "compare"]

HORIZONS_M = (1.0, 5.0, 10.0, 50.0)
CURVE_M = (0.5, 1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0, 50.0, 70.0, 100.0)
_FEWEST = 3


@dataclass(frozen=True, slots=True)
class Horizon:
    """Errors over one length of path, windows not overlapping.

    measured, expected : (3,) root mean square along, across (m) and yaw (rad)
    position_measured, position_expected : root mean square of the position error, m
    nees : mean normalised squared error per degree of freedom, 1 where the model is right
    nees_bounds : where 95 % of such means lie by chance
    coverage : (3,) part of the errors inside the model's 90 % interval
    """

    distance_m: float
    windows: int
    measured: Array
    expected: Array
    position_measured: float
    position_expected: float
    nees: float
    nees_bounds: tuple[float, float]
    coverage: Array


@dataclass(frozen=True, slots=True)
class Judgement:
    """One model against the recordings.

    refitted : whether it had been fitted on them, so that it was refitted on halves to be judged on the others
    ten_second_error_m : root mean square position error after 10 s
    nats_per_m : log likelihood per metre driven; nats_error its standard error over blocks
    horizons : for the table; curve : more of them, for the picture
    """

    name: str
    refitted: bool
    ten_second_error_m: float
    nats_per_m: float
    horizons: tuple[Horizon, ...]
    curve: tuple[Horizon, ...]
    failures: tuple[Failure, ...]


@dataclass(frozen=True, slots=True)
class Comparison:
    """Models side by side, and the odometry as it came and with its clock set right, as 10 s errors in metres."""

    recordings: tuple[str, ...]
    clocks: Clocks
    raw_error_m: float
    clock_error_m: float
    judgements: tuple[Judgement, ...]


def compare(recordings: Sequence[Recording], models: Mapping[str, MotionModel]) -> Comparison:
    """Judge models (by name) on recordings."""
    approach = choose_approach(recordings)
    found = find_clocks(recordings, approach)
    on_time = [aligned(r, c) for r, c in zip(recordings, found.clocks, strict=True)]
    return Comparison(
        recordings=tuple(r.name for r in recordings),
        clocks=found,
        raw_error_m=_ten_seconds(recordings),
        clock_error_m=_ten_seconds(on_time),
        judgements=tuple(_judge(name, model, on_time, approach) for name, model in models.items()),
    )


def _judge(name: str, model: MotionModel, recordings: Sequence[Recording], approach: Approach) -> Judgement:
    fitted_on = model.source.get("recordings", [])
    known = fitted_on if isinstance(fitted_on, list) else []
    parts: list[tuple[Recording, MotionModel]] = []
    for recording in recordings:
        if recording.name in known:
            first, second = _halves(recording)
            parts += [(first, _refit(model, second, approach)), (second, _refit(model, first, approach))]
        else:
            parts.append((recording, model))
    pieces = [_Judged(recording, own, approach) for recording, own in parts]
    metres = sum(p.metres for p in pieces)
    return Judgement(
        name=name,
        refitted=any(r.name in known for r in recordings),
        ten_second_error_m=_ten_seconds([p.left for p in pieces]),
        nats_per_m=sum(p.log_likelihood for p in pieces) / metres,
        horizons=_horizons(pieces, HORIZONS_M),
        curve=_horizons(pieces, CURVE_M),
        failures=tuple(f for p in pieces[:1] for f in p.failures()) if len(pieces) == 1 else _common(pieces),
    )


class _Judged:
    """One stretch of a recording under one model."""

    def __init__(self, recording: Recording, model: MotionModel, approach: Approach) -> None:
        effects = (*model.effects, *model.setup.effects)
        self.model, self.truth = model, model.setup.truth or TruthNoise()
        flat = self.truth
        if recording.heading_error_rad is not None:
            flat = replace(self.truth, yaw_rad=UNKNOWN_RAD)
            self.truth = replace(self.truth, yaw_rad=recording.heading_error_rad)
        self.problem = pose_problem([recording], effects, approach=approach)
        self.left = undo(recording, effects)
        nodes = self.problem.nodes
        q = nodes.covariance(model.noise.law, model.noise.coefficients, self.problem.steps)
        self.whitener = whitener(nodes, q, flat)
        self.log_likelihood = self.whitener.log_likelihood(self.whitener.whiten(nodes.residual))
        self.metres = float(nodes.distance_m.sum())

    def failures(self) -> list[Failure]:
        return failures(self.problem, self.whitener)

    def windows(self, distance_m: float) -> WindowErrors | None:
        windows = distance_windows(self.left, distance_m)
        if not len(windows):
            return None
        return window_errors(windows, self.model.noise, self.truth, self.problem.steps)


def _horizons(pieces: Sequence[_Judged], distances_m: Sequence[float]) -> tuple[Horizon, ...]:
    horizons = []
    for distance in distances_m:
        parts = [w for p in pieces if (w := p.windows(distance)) is not None]
        if sum(len(w.error) for w in parts) < _FEWEST:
            continue
        both = WindowErrors(np.concatenate([w.error for w in parts]), np.concatenate([w.covariance for w in parts]))
        n = len(both.error)
        bounds = chi2.ppf([0.025, 0.975], 3 * n) / (3 * n)
        measured, expected = both.measured, both.expected
        horizons.append(
            Horizon(
                distance_m=distance,
                windows=n,
                measured=measured,
                expected=expected,
                position_measured=float(np.hypot(*measured[:2])),
                position_expected=float(np.hypot(*expected[:2])),
                nees=float(both.nees.mean() / 3.0),
                nees_bounds=(float(bounds[0]), float(bounds[1])),
                coverage=both.coverage(1.6449),
            )
        )
    return tuple(horizons)


def _common(pieces: Sequence[_Judged]) -> tuple[Failure, ...]:
    """Return what fails on the longest stretch: sentences about one drive, not a blend of several."""
    longest = max(pieces, key=lambda p: p.metres)
    return tuple(longest.failures())


def _halves(recording: Recording) -> tuple[Recording, Recording]:
    """Cut a recording in the middle of its truth."""
    truth, middle = recording.truth, len(recording.truth) // 2
    first = Trajectory(truth.stamps_ns[:middle], truth.xyt[:middle])
    second = Trajectory(truth.stamps_ns[middle:], truth.xyt[middle:])
    return replace(recording, truth=first), replace(recording, truth=second)


def _refit(model: MotionModel, recording: Recording, approach: Approach) -> MotionModel:
    """Return the model with its numbers estimated on this recording alone, its effects the same."""
    effects = (*model.effects, *model.setup.effects)
    again = fit([recording], effects, approach=replace(approach, law_name=model.noise.law_name))
    count = len(model.effects)
    return replace(
        model,
        noise=replace(model.noise, coefficients=again.noise.coefficients),
        effects=again.effects[:count],
        setup=replace(model.setup, effects=again.effects[count:], truth=again.noise.truth),
    )


def _ten_seconds(recordings: Sequence[Recording]) -> float:
    windows = [time_windows(recording) for recording in recordings]
    whole = [w for w in windows if len(w)]
    return rmse(join(whole, [0] * len(whole))) if whole else float("nan")
