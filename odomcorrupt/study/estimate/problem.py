"""The regression problem: recordings with a model's effects and clocks removed, and columns for parameter changes.

Effects are undone exactly (increments are corrected and composed again, stamps shifted), never to first order. The
residual is then linear in small changes of the parameters, and each parameter has one column.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects import registry
from odomcorrupt.effects.compensation import corrected_twist, error_of, followed
from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.geometry.motion import motion_of
from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.study.estimate.intervals import Intervals, intervals_of, join
from odomcorrupt.study.estimate.regressors import MotionSmoother, drives_sideways
from odomcorrupt.study.io.clock import Clock, aligned, clock_leaders
from odomcorrupt.study.io.first_look import factors_of
from odomcorrupt.study.io.headings import with_recomputed_headings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect, Motion, Parameter
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.config import Approach
    from odomcorrupt.study.estimate.regressors import Side
    from odomcorrupt.study.io.recording import Recording

_TRUE_MOTION = ("acceleration", "x", "y", "theta", "distance")
"""Fields of the motion that effects read from the true motion; speeds they read from the odometry."""


def undo(recording: Recording, effects: Sequence[Effect], *, smoother: MotionSmoother | None = None) -> Recording:
    """Return the recording with the effects removed from its odometry: u = u' + f(u'), composed from the same start.

    Speeds are those of the increments. Fields of the true motion that some effects read (accelerations, places) come
    from the smooth motion of the odometry (of `smoother`, if given) and from the recorded truth.
    """
    if not effects:
        return recording
    left = recording
    gains = (1.0, 1.0) if {f.name for f in factors_of([recording])} & {e.name for e in effects} else recording.gains
    reading = any(effect.reads_truth for effect in effects)
    if reading and smoother is None:
        smoother = MotionSmoother([recording], "odometry")
    if smoother is not None:
        motion = raw = smoother.raw
    else:
        motion = raw = motion_of(recording.odometry_s, recording.odometry.xyt, track_m=recording.track_m)
    # a force accelerates the body, not the wheels: a second pass takes accelerations from the corrected odometry
    for again in range(2 if reading else 1):
        if smoother is not None and reading:
            smooth = smoother.motion(left) if again else smoother.recorded
            motion = replace(raw, **{name: getattr(smooth, name) for name in _TRUE_MOTION})
        robots = [e for e in effects if e.kind != "setup"]
        twist = corrected_twist([e for e in robots if not e.reads_truth], motion)
        for effect in robots:
            if effect.reads_truth and effect.kind != "noise":
                twist += error_of(effect, motion)
        twist = followed([e for e in effects if _follows(e)], motion, twist)
        xyt = accumulate(recording.odometry.xyt[0], Increments.of_rows(twist * motion.dt_s[:, None]))
        left = replace(recording, odometry=Trajectory(recording.odometry.stamps_ns, xyt), gains=gains)
    return left


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """Recordings, effects and clocks of a model, and the intervals of the corrected recordings.

    smoothers : per run, its recordings (several if its truth jumped) on the truth's clock, and its smooth motion
    left : per recording, the recording with the effects removed; empty if effects were changed to first order only
    intervals : the K intervals of all recordings
    run : (K,) index of the recording of each interval
    motions : per run, the motion from which regressors are computed (one entry per odometry interval)
    """

    recordings: tuple[Recording, ...]
    effects: tuple[Effect, ...]
    clocks: tuple[Clock, ...]
    approach: Approach
    smoothers: tuple[MotionSmoother, ...]
    left: tuple[Recording, ...]
    intervals: Intervals
    run: Array
    motions: tuple[Motion, ...]

    @property
    def headings(self) -> bool:
        """Whether the truth of every recording has measured headings."""
        return all(r.headed for r in self.recordings)

    @property
    def steps(self) -> Increments:
        """Increments of all runs for the noise law, smoothed so that noise is not counted as motion."""
        parts = [np.stack((m.v, m.vy, m.omega)) * m.dt_s for m in self.motions]
        ds, dl, dtheta = np.concatenate(parts, axis=1)
        sideways = dl if drives_sideways(self.motions) else np.zeros_like(dl)
        return Increments(np.ascontiguousarray(ds), sideways, np.ascontiguousarray(dtheta))

    def at(self, effects: Sequence[Effect], clocks: Sequence[Clock] | None = None) -> Problem:
        """Return the problem of the same recordings with other effects and clocks (default: the same clocks)."""
        same = self.clocks if clocks is None else clocks
        return pose_problem(self.recordings, effects, same, approach=self.approach, before=self)

    def columns(self, effect: Effect) -> Array:
        """Return the derivatives (K, 3, p) of the residuals by the p amplitudes of an effect."""
        after = [e for e in self.effects if _follows(e) and not (_follows(effect) and e.name <= effect.name)]
        blocks = []
        for p in amplitudes(effect):
            shown = [followed(after, m, _slope(effect, p, m)).T * -m.dt_s for m in self.motions]
            blocks.append(self.intervals.column(np.concatenate(shown, axis=1).T))
        # an expression of constants has no amplitudes
        return by_column(np.stack(blocks)) if blocks else np.zeros((len(self.intervals), 3, 0))

    def explained(self, effect: Effect) -> Array:
        """Return the part (K, 3) of the residuals that an effect at its present values explains, to first order."""
        return self.columns(effect) @ np.array([getattr(effect, p.name) for p in amplitudes(effect)])

    def clock_columns(self) -> Array:
        """Return columns (K, 3, 2 R) of offset and rate of R recordings' clocks; a shared clock is the first one's."""
        kinds = registry()
        both = np.concatenate([self.columns(kinds[name]()) for name in ("time_offset", "clock_skew")], axis=2)
        clock = np.array(clock_leaders(self.recordings))[self.run]
        runs = [both * (clock == r)[:, None, None] for r in range(len(self.recordings))]
        return np.concatenate(runs, axis=2)


def by_column(columns: Array) -> Array:
    """Return columns (c, K, 3) as a view (K, 3, c), in which each column stays contiguous, as whitening needs."""
    return columns.transpose(1, 2, 0)


def pose_problem(
    recordings: Sequence[Recording],
    effects: Sequence[Effect] = (),
    clocks: Sequence[Clock] | None = None,
    *,
    approach: Approach,
    before: Problem | None = None,
) -> Problem:
    """Return the regression problem of recordings with effects and clocks removed.

    before : an earlier problem whose unchanged parts are reused
    """
    recordings, effects = tuple(recordings), tuple(effects)
    clocks = tuple(clocks) if clocks is not None else (Clock(),) * len(recordings)
    smoothers = _smoothers(recordings, clocks, approach.side, before)
    same_data = before is not None and before.left and smoothers == before.smoothers
    if before is not None and same_data and (effects, approach) == (before.effects, before.approach):
        return before
    seen = [smoother.recorded for smoother in smoothers]
    if approach.side == "truth":
        seen = [_robots(motion, [e for e in effects if _follows(e)]) for motion in seen]
        # effects read the speeds that the odometry reports
        gains = [smoother.recording.gains for smoother in smoothers]
        seen = [replace(m, v=m.v / g, vy=m.vy / g, omega=m.omega / h) for m, (g, h) in zip(seen, gains, strict=True)]
    reading = approach.side != "odometry" and any(effect.reads_truth for effect in effects)
    smooth = [MotionSmoother(one.stretches, "odometry", one) if reading else one for one in smoothers]
    whole = [undo(one.recording, effects, smoother=one) for one in smooth]
    runs = _runs(recordings, clocks)
    known: dict[int, Recording] = {}
    for run, smoother, undone in zip(runs, smoothers, whole, strict=True):
        for i, stretch in zip(run, smoother.stretches, strict=True):
            cut = undone.odometry.only(slice(len(stretch.odometry)))
            one = stretch if undone is smoother.recording else replace(stretch, odometry=cut)
            known[i] = with_recomputed_headings(one)
    left = [known[i] for i in range(len(recordings))]
    intervals = [intervals_of(recording, approach.spacing_s) for recording in left]
    if approach.side == "odometry" and effects:
        # speeds of the recorded odometry, accelerations of the corrected one
        again = zip(seen, smoothers, whole, strict=True)
        seen = [replace(motion, acceleration=smoother.motion(now).acceleration) for motion, smoother, now in again]
    first = np.cumsum([0, *(len(motion) for motion in seen)])
    before_run = {i: int(n) for run, n in zip(runs, first, strict=False) for i in run}
    return Problem(
        recordings=recordings,
        effects=effects,
        clocks=clocks,
        approach=approach,
        smoothers=smoothers,
        left=tuple(left),
        intervals=join(intervals, [before_run[i] for i in range(len(recordings))]),
        run=np.repeat(np.arange(len(intervals)), [len(n) for n in intervals]),
        motions=tuple(seen),
    )


def _smoothers(
    recordings: tuple[Recording, ...], clocks: tuple[Clock, ...], side: Side, before: Problem | None
) -> tuple[MotionSmoother, ...]:
    """Return each run on the truth's clock with its smooth motion, reused from an earlier problem with equal clocks."""
    known: dict[tuple[int, ...], tuple[Clock, MotionSmoother]] = {}
    if before is not None and before.approach.side == side:
        for run, smoother in zip(_runs(before.recordings, before.clocks), before.smoothers, strict=False):
            known[tuple(id(before.recordings[i]) for i in run)] = before.clocks[run[0]], smoother
    smoothers = []
    for run in _runs(recordings, clocks):
        clock, like = known.get(tuple(id(recordings[i]) for i in run), (None, None))
        if like is None or clock != clocks[run[0]]:
            like = MotionSmoother([aligned(recordings[i], clocks[run[0]]) for i in run], side, like)
        smoothers.append(like)
    return tuple(smoothers)


def _runs(recordings: Sequence[Recording], clocks: Sequence[Clock]) -> list[list[int]]:
    """Return lists of recordings that are stretches of one run: each has the run's odometry from its beginning."""
    runs: list[list[int]] = []
    for i, recording in enumerate(recordings):
        own = (run for run in runs if clocks[run[0]] == clocks[i] and _one_run(recordings[run[0]], recording))
        run = next(own, None)
        if run is None:
            runs.append([i])
        else:
            run.append(i)
    return runs


def _one_run(one: Recording, other: Recording) -> bool:
    """Return whether two recordings have the odometry of the same run from its beginning."""
    if not one.clock or (one.clock, one.origin_ns, one.track_m) != (other.clock, other.origin_ns, other.track_m):
        return False
    if one.odometry is other.odometry:
        return True
    shared = min(len(one.odometry), len(other.odometry))
    a, b = one.odometry, other.odometry
    return np.array_equal(a.stamps_ns[:shared], b.stamps_ns[:shared]) and np.array_equal(a.xyt[:shared], b.xyt[:shared])


def _robots(motion: Motion, setup: Sequence[Effect]) -> Motion:
    """Return the motion of the robot from that of the tracked point, which is a linear function of it."""
    if not setup or not len(motion):
        return motion
    still = np.zeros((len(motion), 3))
    back = np.linalg.inv([followed(setup, motion, still + unit)[0] for unit in np.eye(3)])
    v, vy, omega = np.ascontiguousarray((motion.twist @ back).T)
    return replace(motion, v=v, vy=vy, omega=omega, acceleration=motion.acceleration @ back)


def _follows(effect: Effect) -> bool:
    """Return whether an effect is a mounting of the truth's tracked point (a set-up effect other than a clock)."""
    return effect.kind == "setup" and not effect.clock


def _slope(effect: Effect, p: Parameter, motion: Motion) -> Array:
    """Return the derivative (n, 3) of f with respect to one parameter."""
    more = replace(effect, **{p.name: getattr(effect, p.name) + p.step})  # type: ignore[type-var]
    if effect.odd and not effect.acts:
        return error_of(more, motion) / p.step
    less = replace(effect, **{p.name: getattr(effect, p.name) - p.step})  # type: ignore[type-var]
    return (error_of(more, motion) - error_of(less, motion)) / (2.0 * p.step)
