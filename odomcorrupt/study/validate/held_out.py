"""Held-out tests of each part of a learned model; parts that make predictions clearly worse are dropped.

Each effect, dependence and random gain is removed in turn, the others are refitted, and both models are evaluated on
the same windows and intervals of other recordings of the robot. Differences are paired, so that difficult data count
against neither. Without other recordings, the evidence of the selection on left-out folds is the only measure.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import FitError
from odomcorrupt.study.estimate.calibrate import model_of
from odomcorrupt.study.estimate.random_process import CORRELATED_NOISE, part_name
from odomcorrupt.study.estimate.robust_errors import with_robust_errors
from odomcorrupt.study.estimate.windows import drift_of, ten_second_error
from odomcorrupt.study.io.clock import aligned
from odomcorrupt.study.io.recording import shared_frame
from odomcorrupt.study.validate.compare import clocks_beside
from odomcorrupt.study.validate.evaluation import block_differences, evaluate_stretch

if TYPE_CHECKING:
    from collections.abc import Container, Mapping, Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.io.recording import Recording
    from odomcorrupt.study.select.candidates import Dependence
    from odomcorrupt.study.select.result import Learned
    from odomcorrupt.study.validate.evaluation import Evaluation

_SIGNIFICANT = 2.0
"""Standard errors beyond which a paired difference counts as significant."""
_WORSE = {"factor": 1.02, "plain": 1.15, "errors": _SIGNIFICANT}
"""Thresholds at which a 10 s error counts as larger, see `Drift.worse_than`."""
_MIN_BLOCKS = 6
"""Fewest blocks of 15 s for a significance test of the likelihood."""


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Held-out test of one part of a model.

    nats, error : gain of held-out log likelihood from the part, and its standard error from blocks of the drive
    ten_second_error_m : without the part, and with it
    drift_nats : gain of log likelihood of the errors over 10 s windows, planar and normal with free variances
    failure : reason why the part was dropped; "" if it was kept
    """

    name: str
    nats: float
    error: float
    ten_second_error_m: tuple[float, float]
    drift_nats: float
    failure: str

    @property
    def remark(self) -> str:
        """A sentence on why the part was dropped."""
        return f"{self.name} was found, but is not in the model: {self.failure}"


def drop_unsupported_parts(learned: Learned, others: Sequence[Recording]) -> tuple[Learned, tuple[HeldOut, ...]]:
    """Return the learned model without parts that fail on held-out data, and the test of each part.

    Effects of places have no meaning on others in frames of their own (maps of a laser): these are not tested.

    others : recordings of the same robot not used in the selection
    """
    fitted, said = learned.fit, list[HeldOut]()
    clocks = clocks_beside(others, fitted.problem.approach, model_of(fitted)).clocks
    on_time = [aligned(r, c) for r, c in zip(others, clocks, strict=True)]
    placed = shared_frame([*fitted.problem.recordings, *others]) is not None
    while parts := [(part,) for part in _parts(fitted) if placed or not part.reads_places]:
        # Also test all parts jointly: each may compensate another's error while all of them are worse than none.
        together = [tuple(part for (part,) in parts)] if len(parts) > 1 else []
        found = _test(fitted, [*parts, *together], on_time)
        worst = max((one for one in found if one[1].failure), key=lambda one: -one[1].nats, default=None)
        if worst is None:
            each = [(own, one) for own, one in found if len(own) == 1]
            # A part may show in single intervals or in the drift over seconds: take the larger gain.
            gained = {one.name: (max(one.nats, one.drift_nats), one.error) for _, one in each}
            learned = replace(learned, held_out=gained)
            said += [one for _, one in each]
            break
        said.append(worst[1])
        fitted = _without(fitted, worst[0])
    if fitted is learned.fit:
        return learned, tuple(said)
    left_out = {one.name: one.failure for one in said if one.failure}
    return _limited_to(learned, fitted, left_out), tuple(said)


def without_parts(learned: Learned, reasons: Mapping[str, str]) -> Learned:
    """Return the learned model without some parts, the others refitted.

    reasons : why each part is left out, by its name
    """
    parts = [part for part in _parts(learned.fit) if not reasons.keys().isdisjoint((part.name, part_name(part)))]
    noise = tuple(gain for gain in learned.noise if gain.effect.name not in reasons)
    return _limited_to(replace(learned, noise=noise), _without(learned.fit, parts), reasons)


def _limited_to(learned: Learned, fitted: Fit, left_out: Mapping[str, str]) -> Learned:
    """Return the learned model with a fit that has fewer parts.

    left_out : why the others are left out, by their names
    """
    kept = {effect.name for effect in (*fitted.effects, *fitted.random)}
    fitted = with_robust_errors(fitted, kept)
    laws = tuple(one for one in learned.laws if one.name in kept)
    random = {part_name(effect) for effect in fitted.random}
    noise = tuple(
        gain for gain in learned.noise if gain.effect.name not in CORRELATED_NOISE or part_name(gain.effect) in random
    )
    unknown = _beside(learned.unknown, laws, kept)
    learned = replace(learned, laws=laws, noise=noise, unknown=unknown)
    left_out = {**learned.left_out, **left_out}
    return replace(learned, fit=fitted, error_m=ten_second_error(fitted), left_out=left_out)


def _beside(unknown: Sequence[Dependence], laws: Sequence[Dependence], kept: Container[str]) -> tuple[Dependence, ...]:
    """Return dependences without the names of dropped effects that they may replace.

    Those that may replace nothing any more are left out if the model has a dependence of that name. The others stay the
    same objects, because those in the model are recognised by identity.

    laws : dependences in the model
    kept : names of its effects
    """
    named = {law.name for law in laws}
    found: list[Dependence] = []
    for one in unknown:
        names = tuple(name for name in one.instead_of if name in kept)
        if names == one.instead_of:
            found.append(one)
        elif names or one.name not in named:
            found.append(replace(one, instead_of=names))
    return tuple(found)


def _parts(fitted: Fit) -> list[Effect]:
    return [*(effect for effect in fitted.effects if effect.kind != "setup"), *fitted.random]


def _without(fitted: Fit, parts: Sequence[Effect]) -> Fit:
    kinds = fitted.effects, fitted.random
    effects, random = ([e for e in own if not any(e is part for part in parts)] for own in kinds)
    return fitted.refit(effects, random=random)


def _test(
    fitted: Fit, groups: Sequence[tuple[Effect, ...]], others: Sequence[Recording]
) -> list[tuple[tuple[Effect, ...], HeldOut]]:
    """Return the held-out test of each group of parts on other recordings; an empty list if no refit is possible."""

    def judged(one: Fit) -> list[Evaluation]:
        model = model_of(one, one.random)
        return [evaluate_stretch(r, model, fitted.problem.approach) for r in others]

    try:
        whole = judged(fitted)
        return [(group, _verdict(group, whole, judged(_without(fitted, group)))) for group in groups]
    except FitError:
        return []


def _verdict(parts: Sequence[Effect], whole: Sequence[Evaluation], without: Sequence[Evaluation]) -> HeldOut:
    with_it, base = (drift_of([piece.left for piece in pieces]) for pieces in (whole, without))
    # A random part is tested with its noise level; other parts are not, because the level differs between days.
    gains = block_differences(whole, without, sized=not any(part.name in CORRELATED_NOISE for part in parts))
    nats = float(gains.sum())
    error = float(np.std(gains, ddof=1) * np.sqrt(len(gains))) if len(gains) > 1 else float("inf")
    windows = float(np.mean([len(each) for each in with_it.squared]))  # phases share their data and count as one
    farther = with_it.worse_than(base, **_WORSE)
    unlikelier = len(gains) >= _MIN_BLOCKS and nats < -_SIGNIFICANT * error
    closer = base.worse_than(with_it, **_WORSE)
    failure = ""
    if farther:
        failure = (
            f"on held-out data the 10 s error is {1e3 * with_it.rmse:.1f} mm with it, {1e3 * base.rmse:.1f} mm without"
        )
    elif unlikelier and not closer:
        failure = f"on held-out data the model is {-nats:.0f} nats less likely with it"
    return HeldOut(
        name=" with ".join(map(part_name, parts)),
        nats=nats,
        error=error,
        ten_second_error_m=(base.rmse, with_it.rmse),
        drift_nats=2.0 * windows * np.log(base.rmse / with_it.rmse) if base.rmse > 0.0 < with_it.rmse else 0.0,
        failure=failure,
    )
