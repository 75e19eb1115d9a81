"""The noisy path of a stretch, from clean poses in time order, batch by batch.

Noise is accumulated from the previous noisy pose with the noisy heading. The state is the error, noisy minus clean,
not the noisy pose itself: without noise it is zero to the last bit. Every cumulative sum includes the value carried
over from the batch before, and normals are drawn row by row, so any division into batches gives the same bits.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from odomcorrupt.corruption.covariance import (
    RANDOM_SUMS,
    SUMS,
    NoiseSteps,
    RandomEffectCovariance,
    pose_covariance,
    sum_terms,
)
from odomcorrupt.corruption.inverse import Drive, EffectInverse, Slowed, SystematicEffects
from odomcorrupt.errors import ModelError
from odomcorrupt.geometry.se2 import Increments, between, rotated, wrap
from odomcorrupt.model.noise_laws import Variances, variances
from odomcorrupt.rng import stream

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import MotionModel, Noise, Step


class StepGrowth(NamedTuple):
    """Progress of a path within its step: metres and radians since its start, now and at the start of the step."""

    gone_m: float = 0.0
    gone_rad: float = 0.0
    began_m: float = 0.0
    began_rad: float = 0.0


class GrownVariances(NamedTuple):
    """Variances of n increments, and the progress after them."""

    variances: Variances
    growth: StepGrowth


def noise_variances(noise: Noise, steps: Increments, dt_s: Array, growth: StepGrowth) -> GrownVariances:
    """Return the noise variances (n,) of rot1, trans, across and rot2 of n increments, and the state after them.

    With a step, an increment's variance is the growth of the law's variance since the step's start. The law is
    evaluated at the metres and radians since then, the turn halved between rot1 and rot2, so growth is never
    negative; a step ends exactly at its distance or angle, if need be inside an increment. The same increments give
    the same bits for any division into calls.

    noise : law, coefficients and step
    steps : n increments with the effects applied, metres and radians
    dt_s : (n,) their lengths, seconds
    growth : state of the present step, as returned by the call before
    """
    grown = GrownVariances(variances(noise.law, noise.coefficients, steps), growth)
    if noise.step is not None and len(steps):
        grown = _within_steps(noise, noise.step, steps, growth)
    k = noise.coefficients
    if k.white_v or k.white_omega or k.rot_time:
        v, turn = grown.variances, ((k.white_omega * dt_s) ** 2 + k.rot_time**2 * dt_s) / 2.0
        v = Variances(v.rot1 + turn, v.trans + (k.white_v * dt_s) ** 2, v.across, v.rot2 + turn)
        grown = GrownVariances(v, grown.growth)
    return grown


def _within_steps(noise: Noise, step: Step, steps: Increments, growth: StepGrowth) -> GrownVariances:
    gone_m = np.cumsum(np.concatenate(([growth.gone_m], np.hypot(steps.ds_m, steps.dl_m))))
    gone_rad = np.cumsum(np.concatenate(([growth.gone_rad], np.abs(steps.dtheta_rad))))
    increment, at_m, at_rad = _ends(step, growth, gone_m, gone_rad).T

    # every increment is divided at the ends of steps inside it
    n = len(steps)
    owner = np.concatenate((increment, np.arange(n)))
    order = np.lexsort((np.concatenate((np.zeros(len(increment)), np.ones(n))), owner))
    upto_m = np.concatenate((at_m, gone_m[1:]))[order]
    upto_rad = np.concatenate((at_rad, gone_rad[1:]))[order]
    is_end = order < len(increment)
    step_of: NDArray[np.int64] = np.cumsum(is_end) - is_end
    began_m = np.concatenate(([growth.began_m], at_m))[step_of]
    began_rad = np.concatenate(([growth.began_rad], at_rad))[step_of]
    from_m = np.concatenate(([growth.gone_m], upto_m[:-1]))
    from_rad = np.concatenate(([growth.gone_rad], upto_rad[:-1]))
    after = _law_at(noise, upto_m - began_m, upto_rad - began_rad)
    before = _law_at(noise, from_m - began_m, from_rad - began_rad)

    first_piece = np.flatnonzero(np.diff(owner[order], prepend=-1))
    pairs = zip(after, before, strict=True)
    total = Variances(*(np.add.reduceat(np.maximum(late - early, 0.0), first_piece) for late, early in pairs))
    last = (float(at_m[-1]), float(at_rad[-1])) if len(at_m) else growth[2:]
    return GrownVariances(total, StepGrowth(float(gone_m[-1]), float(gone_rad[-1]), *last))


def _law_at(noise: Noise, gone_m: Array, gone_rad: Array) -> Variances:
    half = np.maximum(gone_rad, 0.0) / 2.0
    return noise.law.rule(noise.coefficients, half, np.maximum(gone_m, 0.0), half)


def _ends(step: Step, growth: StepGrowth, gone_m: Array, gone_rad: Array) -> Array:
    """Return the ends of k steps: index of the increment of each, metres and radians since the path's start (k, 3)."""
    found: list[tuple[int, float, float]] = []
    began_m, began_rad = growth.began_m, growth.began_rad
    most = (gone_m[-1] - began_m) / step.distance_m + (gone_rad[-1] - began_rad) / step.angle_rad
    # largest number of steps in one block; a kilometre of the shortest ones
    if most > 1e6:
        raise ModelError(f"step: {step}; a part of the path has {most:.3g} of them; give a longer one")
    while began_m + step.distance_m <= gone_m[-1] or began_rad + step.angle_rad <= gone_rad[-1]:
        far, turned = began_m + step.distance_m, began_rad + step.angle_rad
        i = min(int(np.searchsorted(gone_m, far)), int(np.searchsorted(gone_rad, turned))) - 1
        began_m, began_rad = _meet(far, turned, gone_m[i : i + 2], gone_rad[i : i + 2])
        found.append((i, began_m, began_rad))
    return np.array(found, dtype=float).reshape(-1, 3)


def _meet(far: float, turned: float, span_m: Array, span_rad: Array) -> tuple[float, float]:
    """Return metres and radians at which an increment first reaches the step's distance or angle."""
    length, turn = float(span_m[1] - span_m[0]), float(span_rad[1] - span_rad[0])
    by_m = (far - float(span_m[0])) / length if far <= span_m[1] else np.inf
    by_rad = (turned - float(span_rad[0])) / turn if turned <= span_rad[1] else np.inf
    if by_m <= by_rad:
        return far, float(span_rad[0]) + by_m * turn
    return float(span_m[0]) + by_rad * length, turned


JUMP_SPEED = 20.0
"""A clean pose that moves faster than this, m/s, was set and not driven: no noise is drawn across it."""

JUMP_MIN_S = 0.05
"""Stamps may bunch: an increment counts as at least this long, seconds, when it is asked whether it is a jump."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PathSamples:
    """Samples of a path at n stamps, clean and noisy.

    stamps_ns : (n,) header stamps
    clean_xyt : (n, 3) metres, radians; headings as they came
    error_xyt : (n, 3) noisy minus clean, in odom axes
    sums : (SUMS, n) running sums for covariances, see `covariance`; more rows where effects are random
    origin_xy : (2,) origin of these sums, metres
    travelled_m : (n,) clean distance since the start of the path, metres, without jumps
    jumps : number of these increments that are jumps
    sideways_m : lateral travel of these increments, metres
    slowed : part of these increments that learned effects have no inverse for
    """

    stamps_ns: NDArray[np.int64]
    clean_xyt: Array
    error_xyt: Array
    sums: Array
    origin_xy: Array
    travelled_m: Array
    jumps: int
    sideways_m: float
    slowed: Slowed = field(default_factory=Slowed)

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def at(self, i: int) -> PathSamples:
        """Return a copy of one of them."""
        one = slice(i, i + 1)
        return PathSamples(
            self.stamps_ns[one].copy(), self.clean_xyt[one].copy(), self.error_xyt[one].copy(),
            self.sums[:, one].copy(), self.origin_xy, self.travelled_m[one].copy(), jumps=0, sideways_m=0.0,
        )  # fmt: skip

    @property
    def correction_xyt(self) -> Array:
        """Correction C (n, 3): noisy pose composed with the inverse of the clean pose, metres and radians."""
        turn, x, y = self.error_xyt[:, 2].copy(), self.clean_xyt[:, 0], self.clean_xyt[:, 1]
        less, s = _cos_less_one(turn), np.sin(turn)
        shift_x = self.error_xyt[:, 0] - (less * x - s * y)
        shift_y = self.error_xyt[:, 1] - (s * x + less * y)
        return np.stack((shift_x, shift_y, turn)).T


class PathSource(Protocol):
    """Source of corrupted paths: clean poses in time order, batch by batch, to clean and noisy samples."""

    def restart(self) -> None:
        """Begin a new path."""

    def feed(self, stamps_ns: NDArray[np.int64], clean_xyt: Array) -> PathSamples:
        """Return clean and noisy samples at the next n stamps, from clean poses (n, 3)."""


class NoisyPath:
    """Noisy path of one run; after a restart of time a new path continues the same random streams.

    normals : function of n that returns the noise's standard normals (n, 4) instead of the run's own stream: of rot1,
        trans, across, rot2
    covariance : whether the samples carry the sums that covariances follow from, which takes 40 % of the time
    systematic : the model's systematic effects, shared with other runs of the same drive
    """

    def __init__(
        self, model: MotionModel, seed: int, run: int = 0, *, normals: Callable[[int], Array] | None = None,
        covariance: bool = True, systematic: SystematicEffects | None = None,
    ) -> None:  # fmt: skip
        self._noise, self._law = model.noise, model.noise.law
        self._covariance = covariance
        self._rng, self._given = stream(seed, run, "noise"), normals
        self._effects = EffectInverse(model, seed, run, systematic)
        self._random_covariance = RandomEffectCovariance()
        self.restart()

    def restart(self) -> None:
        """Begin a new path, whose first pose is unchanged."""
        self._effects.restart()
        self._random_covariance.restart()
        self._growth = StepGrowth()
        self._last: tuple[int, Array] | None = None
        self._first_ns = 0
        self._error = np.zeros(3)
        self._sums = np.zeros((SUMS + (RANDOM_SUMS if self._effects.random else 0), 1))
        self._travelled_m = 0.0
        self._origin = np.zeros(2)

    def feed(self, stamps_ns: NDArray[np.int64], clean_xyt: Array) -> PathSamples:
        """Return clean and noisy samples at the next n stamps.

        stamps_ns : (n,) ascending, and not before the last one fed
        clean_xyt : (n, 3) clean poses, metres and radians, finite
        """
        n = len(stamps_ns)
        if n and self._last is None:
            self._first_ns, self._origin = int(stamps_ns[0]), clean_xyt[0, :2].copy()
            self._last = (int(stamps_ns[0]), clean_xyt[0])
        if n == 0 or self._last is None:
            nothing, none = np.zeros((0, 3)), np.zeros(0)
            return PathSamples(
                stamps_ns, clean_xyt, nothing, self._sums[:, :0], self._origin, none, jumps=0, sideways_m=0.0
            )
        before_ns, before_xyt = self._last
        poses: Array = np.concatenate((before_xyt[None], clean_xyt))
        dt_s = np.diff(stamps_ns, prepend=before_ns) * np.float64(1e-9)
        world_x, world_y = np.diff(poses[:, 0]), np.diff(poses[:, 1])
        length = np.hypot(world_x, world_y)
        jump = length > JUMP_SPEED * np.maximum(dt_s, JUMP_MIN_S)

        # a jump is no motion: no turn, no travel, and the correction of the odom frame is held
        turn = np.where(jump, 0.0, wrap(np.diff(poses[:, 2])))
        middle = poses[:-1, 2] + turn / 2.0
        steps = Increments(*rotated(np.where(jump, 0.0, world_x), np.where(jump, 0.0, world_y), -middle), turn)
        t_s = (stamps_ns - self._first_ns) * np.float64(1e-9)
        driven_s = np.where(jump, 0.0, dt_s)
        added = self._effects.error(Drive(steps, driven_s, t_s, poses[:-1]))
        driven = Increments(steps.ds_m + added[:, 0], steps.dl_m + added[:, 1], turn + added[:, 2])
        grown = noise_variances(self._noise, driven, driven_s, self._growth)
        v = grown.variances
        normals = self._effects.drawn(self._rng.standard_normal((n, 4)) if self._given is None else self._given(n))
        draws = normals * np.sqrt(np.stack((v.rot1, v.trans, v.across, v.rot2), axis=1))

        rot1, rot2 = draws[:, 0], draws[:, 3]
        heading = np.cumsum(np.concatenate((self._error[2:], rot1 + added[:, 2] + rot2)))
        # the translation happens after rot1, at the middle of what the effects turn
        swing = heading[:-1] + (rot1 / 2.0 if self._law.arc else rot1) + added[:, 2] / 2.0
        bearing, shift = None, (draws[:, 1], draws[:, 2])
        if self._law.along_travel:
            bearing = np.arctan2(driven.dl_m, driven.ds_m)
            shift = rotated(*shift, bearing)
        along, across = added[:, 0] + shift[0], added[:, 1] + shift[1]
        less, s = _cos_less_one(swing), np.sin(swing)
        travel = middle + swing
        ct, st = np.cos(travel), np.sin(travel)
        x = self._error[0:1], less * world_x - s * world_y + (ct * along - st * across)
        y = self._error[1:2], s * world_x + less * world_y + (st * along + ct * across)
        error = np.stack((np.cumsum(np.concatenate(x)), np.cumsum(np.concatenate(y)), heading)).T

        sums = np.broadcast_to(self._sums, (len(self._sums), n + 1))
        if self._covariance:
            noisy = poses.T[:2] + error.T[:2] - self._origin[:, None]
            stepped = NoiseSteps(v, noisy[:, :-1], noisy[:, 1:], travel, bearing, arc=self._law.arc)
            sums = np.concatenate((self._sums, self._sum_terms(stepped, driven_s)), axis=1)
            np.cumsum(sums, axis=1, out=sums)
        travelled = np.cumsum(np.concatenate(([self._travelled_m], np.where(jump, 0.0, length))))

        self._last = (int(stamps_ns[-1]), clean_xyt[-1].copy())
        self._error, self._sums, self._growth = error[-1], sums[:, -1:], grown.growth
        self._travelled_m = float(travelled[-1])
        return PathSamples(
            stamps_ns, clean_xyt, error[1:], sums[:, 1:], self._origin, travelled[1:],
            int(np.count_nonzero(jump)), float(np.abs(steps.dl_m).sum()), self._effects.slowed,
        )  # fmt: skip

    def _sum_terms(self, stepped: NoiseSteps, driven_s: Array) -> Array:
        """Return the terms that n intervals add to the running sums, of the noise and of random effects."""
        terms = sum_terms(stepped)
        if not self._effects.random:
            return terms
        middle_xy = (stepped.start_xy + stepped.end_xy) / 2.0
        grown = self._random_covariance.grow(self._effects.gains, driven_s, middle_xy, stepped.travel_rad)
        terms[9:15] += grown.step
        return np.concatenate((terms, grown.path))


def _cos_less_one(angle_rad: Array) -> Array:
    """Return cos(angle) - 1 without cancellation, exactly zero at zero."""
    half = np.sin(angle_rad / 2.0)
    return -2.0 * half * half


LEG_M = 10.0
"""Length of a leg, metres: the drift of its end pose relative to its start pose is reported."""

MARKS_M = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0)
"""Distances at which the drift of many runs is reported, besides the end, metres."""


class Drift(NamedTuple):
    """Position (m) and heading (rad) errors of a run, expected (standard deviation of the noise) and drawn.

    The leg values are root mean squares over legs of `LEG_M`; None for a shorter path. `slowed_s` and `slowed_to` are
    the sum and the least of `Slowed`; None if there is no such motion.
    """

    distance_m: float
    duration_s: float
    messages: int
    jumps: int
    sideways_m: float
    end_expected_m: float
    end_expected_rad: float
    end_drawn_m: float
    end_drawn_rad: float
    leg_expected_m: float | None
    leg_expected_rad: float | None
    leg_drawn_m: float | None
    leg_drawn_rad: float | None
    slowed_s: float | None = None
    slowed_to: float | None = None

    @property
    def rate_hz(self) -> float | None:
        """Mean message rate, Hz; None for fewer than two messages or no duration."""
        return (self.messages - 1) / self.duration_s if self.duration_s > 0.0 and self.messages > 1 else None


class PathWatcher(Protocol):
    """Callback that receives the noisy path, part by part."""

    def restart(self) -> None:
        """Begin a new stretch: the stamps have jumped back."""

    def add(self, samples: PathSamples) -> None:
        """Process the next part of the path."""


class DriftMeter:
    """Drift of a path that arrives in parts; after a restart of time the end values are those of the last stretch."""

    def __init__(self) -> None:
        self._messages = self._jumps = 0
        self._sideways_m = 0.0
        self._slowed = Slowed()
        self._distance_m = self._duration_s = 0.0
        self._legs: list[list[float]] = []
        # each a single sample
        self._start: PathSamples | None = None
        self._mark: PathSamples | None = None
        self._end: PathSamples | None = None

    def restart(self) -> None:
        """End the current stretch."""
        if self._start is not None and self._end is not None:
            self._distance_m += float(self._end.travelled_m[0])
            self._duration_s += int(self._end.stamps_ns[0] - self._start.stamps_ns[0]) * 1e-9
        self._start = self._mark = None

    def add(self, samples: PathSamples) -> None:
        """Process the next part of the path."""
        if not len(samples):
            return
        self._messages += len(samples)
        self._jumps += samples.jumps
        self._sideways_m += samples.sideways_m
        self._slowed = Slowed(
            self._slowed.duration_s + samples.slowed.duration_s, min(self._slowed.to, samples.slowed.to)
        )
        if self._start is None or self._mark is None:
            self._start = self._mark = samples.at(0)
        ends: list[int] = []
        end_m = float(self._mark.travelled_m[0]) + LEG_M
        while samples.travelled_m[-1] >= end_m:
            ends.append(int(np.searchsorted(samples.travelled_m, end_m)))
            end_m = float(samples.travelled_m[ends[-1]]) + LEG_M
        if ends:
            self._legs += _legs(self._mark, samples, ends).tolist()
            self._mark = samples.at(ends[-1])
        self._end = samples.at(len(samples) - 1)

    def result(self) -> Drift | None:
        """Return the drift so far; None where there was no odometry."""
        if self._end is None:
            return None
        self.restart()
        end = self._end
        noisy_xy = end.clean_xyt[:, :2] + end.error_xyt[:, :2] - end.origin_xy
        expected_m, expected_rad = _expected(end.sums, noisy_xy.T)
        legs = [float(x) for x in np.sqrt(np.mean(np.square(self._legs), axis=0))] if self._legs else [None] * 4
        return Drift(
            self._distance_m, self._duration_s, self._messages, self._jumps, self._sideways_m,
            float(expected_m[0]), float(expected_rad[0]),
            float(np.hypot(*end.error_xyt[0, :2])), abs(float(end.error_xyt[0, 2])), *legs,
            *(self._slowed if self._slowed.duration_s else (None, None)),
        )  # fmt: skip


def _expected(grown: Array, noisy_xy: Array) -> tuple[Array, Array]:
    """Return expected errors, metres and radians (n,), of increments of the sums (SUMS or more, n) at ends (2, n)."""
    covariance = pose_covariance(grown[:SUMS], noisy_xy)  # random effects are correlated between legs
    position, yaw = covariance[:, 0, 0] + covariance[:, 1, 1], covariance[:, 2, 2]
    return np.sqrt(np.maximum(position, 0.0)), np.sqrt(np.maximum(yaw, 0.0))


def _legs(start: PathSamples, samples: PathSamples, ends: list[int]) -> Array:
    """Return expected and drawn errors of legs, metres and radians (n, 4); each begins where the one before it ends."""
    clean = np.concatenate((start.clean_xyt, samples.clean_xyt[ends]))
    error = np.concatenate((start.error_xyt, samples.error_xyt[ends]))
    sums = np.concatenate((start.sums, samples.sums[:, ends]), axis=1)
    noisy = clean + error
    off = between(noisy[:-1], noisy[1:]) - between(clean[:-1], clean[1:])
    expected = _expected(np.diff(sums, axis=1), (noisy[1:, :2] - samples.origin_xy).T)
    return np.stack((*expected, np.hypot(off[:, 0], off[:, 1]), np.diff(error[:, 2])), axis=1)
