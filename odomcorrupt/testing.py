"""Contract test for effects, including third-party ones: call `check_effect(MyEffect)` in a test.

It needs no other package; a violation raises `ContractError`, which names it.
"""

from __future__ import annotations

import copy
import dataclasses
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.effects.compensation import corrected_increments
from odomcorrupt.effects.effect import Motion, amplitudes, check_bounds, choices, parameters
from odomcorrupt.geometry.motion import motion_of
from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.model.motion_model import MotionModel, Noise
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.rng import stream

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.effects.effect import Effect, State
    from odomcorrupt.geometry.se2 import Array

TRACK_M = 0.4
_BACK_M = 1e-6
_SIGMAS = 6.0
"""Largest deviation of a sample moment from its expectation, in standard errors: never exceeded by chance."""


class ContractError(AssertionError):
    """An effect violates the contract of effects."""


class Drive(NamedTuple):
    """Stamps (n,), poses (n, 3), and motion of a clean drive, as reported by odometry without error."""

    stamps_ns: NDArray[np.int64]
    xyt: Array
    motion: Motion


def contract_drive(seconds: float = 30.0, rate_hz: float = 50.0, *, sideways: bool = False) -> Drive:
    """Return a test drive with stops, reverse, turns on the spot, headings beyond pi and a repeated stamp.

    sideways : whether the robot also moves sideways
    """
    t_s = np.arange(round(seconds * rate_hz) + 1) / rate_hz
    t_s += 0.2 / rate_hz * np.sin(7.0 * t_s)
    phase = t_s[:-1] % 15.0
    v = np.interp(phase, [0, 1, 4, 5, 6, 7, 9, 10, 12, 15], [0, 0.8, 0.8, 0, 0, -0.4, -0.4, 0, 0, 0])
    omega = np.interp(phase, [0, 2, 3, 4, 5, 10, 11, 12, 13, 15], [0, 0, 0.9, 0.9, 0, 0, 1.2, -1.2, 0, 0])
    vy = 0.3 * v * np.sin(t_s[:-1]) if sideways else np.zeros_like(v)
    dt = np.diff(t_s)
    steps = Increments(v * dt, vy * dt, omega * dt + np.where(np.arange(len(v)) % 1000 < 500, 0.0, 0.5 * dt))
    xyt = accumulate(np.array([0.3, -0.2, 3.0]), steps)
    repeated = np.sort(np.append(np.arange(len(t_s)), len(t_s) // 3))
    stamps_ns = 100 * 10**9 + np.round(t_s * 1e9).astype(np.int64)[repeated]
    return Drive(stamps_ns, xyt[repeated], motion_of((stamps_ns - stamps_ns[0]) * 1e-9, xyt[repeated], track_m=TRACK_M))


def check_effect(effect_class: type[Effect]) -> None:
    """Check that an effect fulfils the contract of `effects.effect.Effect`.

    Raises
    ------
    ContractError
        If it does not; the message names the violation.
    """
    _check_facts(effect_class)
    for sample in _samples(effect_class):
        _check_numbers(sample)
        _check_cuts(sample)
        _check_by_rows(sample)
        if sample.kind == "noise":
            _check_seeds(sample)
            _check_moments(sample)
            _check_restored(sample)
        else:
            motion = contract_drive(sideways=sample.needs_sideways).motion
            a, b = (sample.twist_error(motion, sample.start(stream(seed, 0, sample.name))).f for seed in (1, 2))
            _require(np.array_equal(a, b), sample, "draws, but its kind is not noise: runs share what is systematic")
            if not sample.clock:
                _check_round_trip(sample)
    _check_identity(effect_class())
    if effect_class.odd:
        _check_odd(effect_class())


def _require(promise: object, effect: Effect | type[Effect], what: str) -> None:
    if not promise:
        raise ContractError(f"effect {effect.name}: {what}")


def _samples(effect_class: type[Effect]) -> list[Effect]:
    """Return the effect at its typical values, with each of its options, and with negated amplitudes if allowed."""
    sizes = {p.name: p.typical if p.amplitude else p.identity for p in parameters(effect_class)}
    found = [effect_class(**sizes)]
    for word, options in choices(effect_class).items():
        found += [replace(found[0], **{word: option}) for option in options[1:]]  # type: ignore[type-var]
    negative = {p.name: -p.typical for p in amplitudes(effect_class) if p.low < 0.0}
    if negative:
        found.append(replace(found[0], **negative))  # type: ignore[type-var]
    return found


def _check_facts(effect_class: type[Effect]) -> None:
    _require(dataclasses.is_dataclass(effect_class), effect_class, "is not a dataclass")
    _require(effect_class.__dataclass_params__.frozen, effect_class, "is not frozen")  # type: ignore[attr-defined]
    _require(effect_class.kind in ("effect", "setup", "noise", "event"), effect_class, f"kind {effect_class.kind!r}")
    _require(effect_class.summary and "\n" not in effect_class.summary, effect_class, "needs a summary of one line")
    own = parameters(effect_class)
    _require(amplitudes(effect_class), effect_class, "has no amplitude: nothing that could be zero")
    declared = {p.name for p in own} | set(choices(effect_class))
    fields = {f.name for f in dataclasses.fields(effect_class)}  # type: ignore[arg-type]
    _require(fields == declared, effect_class, f"fields without unit and bounds: {', '.join(fields - declared)}")
    for p in own:
        _require(p.meaning, effect_class, f"{p.name} has no meaning")
        _require(p.low <= p.identity <= p.high, effect_class, f"{p.name}: its identity lies out of bounds")
        _require(p.low <= p.typical <= p.high, effect_class, f"{p.name}: its typical value lies out of bounds")
        _require(np.isfinite([p.low, p.high]).all(), effect_class, f"{p.name}: its bounds are not finite")
        _require(p.step > 0.0, effect_class, f"{p.name}: the step of a slope must be more than zero")
    check_bounds(effect_class())


def _check_identity(still: Effect) -> None:
    drive = contract_drive(sideways=still.needs_sideways)
    _require(not still.acts, still, "acts at its identity")
    f, _ = _error(still, drive.motion)
    _require(not f.any(), still, "f is not zero at its identity")
    steps = _steps(drive)
    recorded = still.recorded(steps, drive.motion.t_s, TRACK_M, still.start(stream(1, 0, still.name))).steps
    _require(np.array_equal(recorded, steps), still, "changes increments at its identity")
    normals = np.random.default_rng(1).standard_normal((50, 4))
    drawn = still.drawn(normals, still.start(stream(1, 0, still.name))).normals
    _require(np.array_equal(drawn, normals), still, "changes draws at its identity")


def _check_odd(still: Effect) -> None:
    motion = contract_drive(sideways=still.needs_sideways).motion
    for p in amplitudes(still):
        both = (replace(still, **{p.name: p.identity + step}) for step in (p.step, -p.step))  # type: ignore[type-var]
        up, down = (_error(effect, motion)[0] for effect in both)
        _require(np.array_equal(up, -down), still, f"f does not change sign with {p.name}: it is not odd")


def _check_numbers(effect: Effect) -> None:
    drive = contract_drive(sideways=effect.needs_sideways)
    motion = drive.motion
    before = copy.deepcopy(motion)
    state = effect.start(stream(1, 0, effect.name))
    kept = copy.deepcopy(state)
    f = effect.twist_error(motion, state).f
    _require(f.shape == (len(motion), 3), effect, f"f has the shape {f.shape}")
    _require(np.isfinite(f).all(), effect, "f is not finite at rest, in reverse or where dt is zero")
    _require(not np.shares_memory(f, motion.acceleration), effect, "f is a view of its input")
    for field in dataclasses.fields(Motion):
        same = np.array_equal(getattr(motion, field.name), getattr(before, field.name))
        _require(same, effect, f"changes {field.name} of the motion it is given")
    # states are immutable: continuing from a copy, or twice from the same state, gives the same
    for again in (kept, state):
        _require(np.array_equal(effect.twist_error(motion, again).f, f), effect, "changes the state it is given")
    _require(effect.acts, effect, "does not act at its typical size")
    elsewhere = replace(motion, x=motion.x + 3.0, y=motion.y - 2.0, theta=motion.theta + 1.0)
    there = effect.twist_error(elsewhere, state).f
    _require(np.array_equal(there, f) or effect.reads_places, effect, "depends on places; set reads_places")
    same = np.allclose(effect.plain().twist_error(motion, effect.plain().start(stream(1, 0, effect.name))).f, f)
    _require(same, effect, "does something else in plain words")


def _check_cuts(effect: Effect) -> None:
    drive = contract_drive(sideways=effect.needs_sideways)
    motion, steps = drive.motion, _steps(drive)
    normals = np.random.default_rng(2).standard_normal((len(steps), 4))
    f, _ = _error(effect, motion)
    recorded = effect.recorded(steps, motion.t_s, TRACK_M, effect.start(stream(1, 0, effect.name))).steps
    drawn = effect.drawn(normals, effect.start(stream(1, 0, effect.name))).normals
    for size in (1, 7, 250):
        states: list[State] = [effect.start(stream(1, 0, effect.name)) for _ in range(3)]
        parts: list[tuple[Array, Array, Array]] = []
        for i in range(0, len(motion), size):
            rows = slice(i, i + size)
            piece, states[0] = effect.twist_error(_rows(motion, rows), states[0])
            report, states[1] = effect.recorded(steps[rows], motion.t_s[rows], TRACK_M, states[1])
            draw, states[2] = effect.drawn(normals[rows], states[2])
            parts.append((piece, report, draw))
        first = effect.layer == "record"  # its f is only ever read over a whole motion
        for whole, pieces in list(zip((f, recorded, drawn), zip(*parts, strict=True), strict=True))[first:]:
            same = np.array_equal(np.concatenate(pieces), whole)
            _require(same, effect, f"differs where a motion is cut into pieces of {size}: carry it in the state")
    whole_path = _path([effect]).feed(drive.stamps_ns, drive.xyt).error_xyt
    path, blocks = _path([effect]), [slice(i, i + 41) for i in range(0, len(drive.xyt), 41)]
    cut = [path.feed(drive.stamps_ns[block], drive.xyt[block]).error_xyt for block in blocks]
    _require(np.array_equal(np.concatenate(cut), whole_path), effect, "a bag's corruption depends on its blocks")


def _check_by_rows(effect: Effect) -> None:
    motion = contract_drive(sideways=effect.needs_sideways).motion
    state = effect.start(stream(1, 0, effect.name))
    own = effect.by_rows(motion, state) if effect.layer == "motion" else None
    if own is not None:
        some = np.arange(0, len(motion), 3)
        same = np.array_equal(own.f(_rows(motion, some), some), effect.twist_error(motion, state).f[some])
        _require(same, effect, "f by single intervals differs from f of the whole motion")


def _check_seeds(effect: Effect) -> None:
    drive = contract_drive(sideways=effect.needs_sideways)
    errors = [_path([effect], seed, noise=0.02).feed(drive.stamps_ns, drive.xyt).error_xyt for seed in (1, 1, 2)]
    _require(np.array_equal(errors[0], errors[1]), effect, "the same seed gives different numbers")
    _require(not np.array_equal(errors[0], errors[2]), effect, "different seeds give the same numbers")


def _check_round_trip(effect: Effect) -> None:
    clean, odometry, back = _there_and_back(effect)
    _require(np.abs(odometry - clean).max() > 100.0 * _BACK_M or not effect.acts, effect, "corrupts nothing")
    off = float(np.abs(back - clean).max())
    near = off <= _BACK_M + effect.lost_m
    _require(near, effect, f"correcting what it corrupted is off by {off:.1e} m; is reads_truth set?")


def _there_and_back(effect: Effect) -> tuple[Array, Array, Array]:
    """Return a clean path (n, 3), its odometry under the effect, and that odometry corrected."""
    drive = contract_drive(sideways=effect.needs_sideways)
    odometry = drive.xyt + _path([effect]).feed(drive.stamps_ns, drive.xyt).error_xyt
    motion = motion_of((drive.stamps_ns - drive.stamps_ns[0]) * 1e-9, odometry, track_m=TRACK_M)
    return drive.xyt, odometry, accumulate(odometry[0], corrected_increments([effect], motion))


def _check_restored(effect: Effect) -> None:
    if not effect.restorable:
        return
    clean, odometry, back = _there_and_back(effect)
    before, after = (np.linalg.norm((path - clean)[:, :2], axis=1).max() for path in (odometry, back))
    # fraction of an effect's error that may remain after correction
    _require(after < 0.2 * before, effect, f"restorable, but of {before:.3g} m remain {after:.3g} m")


def _check_moments(effect: Effect) -> None:
    if effect.layer == "draws":
        normals = np.random.default_rng(3).standard_normal((20000, 4))
        drawn = effect.drawn(normals, effect.start(stream(1, 0, effect.name))).normals
        _compare(effect, drawn, np.zeros(4), np.ones(4))
        return
    # rare events are made frequent enough to be counted
    sizes = {p.name: min(20.0 * p.typical, 0.5 * p.high) for p in amplitudes(effect)}
    effect = replace(effect, **sizes)  # type: ignore[type-var]
    drive = contract_drive(6.0, 100.0)
    motion, steps = drive.motion, _steps(drive)
    moments = effect.moments(motion)
    if moments is None:
        raise ContractError(f"effect {effect.name}: draws, but states no moments")
    samples = []
    dt = motion.dt_s[:, None]
    for run in range(400):
        state = effect.start(stream(1, run, effect.name))
        f = effect.twist_error(motion, state).f
        lost = steps - effect.recorded(steps, motion.t_s, TRACK_M, state).steps
        samples.append(f + np.divide(lost, dt, out=np.zeros_like(lost), where=dt > 0.0))
    # a few rows far apart: neighbouring rows are correlated
    rows = np.linspace(5, len(motion) - 1, 24).astype(int)
    _compare(effect, np.array(samples)[:, rows], moments.mean[rows], moments.variance[rows])


def _compare(effect: Effect, samples: Array, mean: Array, variance: Array) -> None:
    """Require that samples (r, ...) have this mean and variance, within the error of their number and kurtosis."""
    count = len(samples)
    off = np.abs(samples.mean(axis=0) - mean)
    deviation = samples.std(axis=0)
    allowed = _SIGMAS * deviation / np.sqrt(count)
    # rare events: if few samples contain one, use the stated variance instead of the sample variance
    allowed = np.maximum(allowed, _SIGMAS * np.sqrt(np.nan_to_num(variance) / count)) + 1e-12
    _require((off <= allowed).all(), effect, "samples do not have the stated mean")
    square = (samples - mean) ** 2
    error = np.maximum(square.std(axis=0), np.nan_to_num(variance)) / np.sqrt(count)
    wrong = np.abs(square.mean(axis=0) - variance) > _SIGMAS * error + 0.02 * variance + 1e-15
    _require(not wrong[~np.isnan(variance)].any(), effect, "samples do not have the stated variance")


def _error(effect: Effect, motion: Motion) -> tuple[Array, State]:
    return effect.twist_error(motion, effect.start(stream(1, 0, effect.name)))


def _steps(drive: Drive) -> Array:
    m = drive.motion
    return m.twist * m.dt_s[:, None]


def _path(effects: Sequence[Effect], seed: int = 1, noise: float = 0.0) -> NoisyPath:
    law = Noise("diffusion", Coefficients(noise, noise, noise, noise))
    return NoisyPath(MotionModel(law, tuple(effects), TRACK_M), seed)


def _rows(motion: Motion, rows: slice | NDArray[np.intp]) -> Motion:
    values = {f.name: getattr(motion, f.name) for f in dataclasses.fields(Motion) if f.name != "track_m"}
    return replace(motion, **{name: value[rows] for name, value in values.items() if value is not None})
