"""Clocks of recordings: offset and rate of each, estimated before anything else."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2

from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.effects.wheels import brings_track
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.windows import phased_rmse
from odomcorrupt.study.io.clock import Clock, aligned, clock_leaders, coarse_clock
from odomcorrupt.study.terms.drive_type import drive_type_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.config import Approach
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.io.recording import Recording

__all__ = ["Clocks", "find_clocks"]

_CLOCK_LIMIT = float(np.sqrt(chi2.isf(1e-4, 1)))
_CLOCK_HARM = 1.15
"""A clock that makes the 10 s error larger than by chance is none, whatever the likelihood says."""
NUISANCE = ("wheel_scale", "wheelbase", "unequal_wheels", "lever_arm", "mount_yaw")
"""Free beside the clocks while these are estimated, and then forgotten."""
RIVALS = ("accel_slip", "backlash", "channel_lag")
"""What looks like a clock at starts and stops: a clock is kept only if it stays when these are free, too."""
_TRACKS_M = (0.2, 0.6)
"""Tracks on which play is tried beside a clock where the robot's is not known."""


@dataclass(frozen=True, slots=True)
class Clocks:
    """Clocks of R recordings, which of their two numbers are really there, and their standard errors (R, 2).

    noise, beside : noise and nuisance effects of the last fit: starting values for others, no result
    ambiguous_nats : what the offset of a clock gains that was left at zero because it is significant only without its
        rivals: what they are given then may as well be the clock's
    untested : rivals that could not be tried, for want of a track: a small offset may as well be theirs
    """

    clocks: tuple[Clock, ...]
    free: tuple[tuple[bool, bool], ...]
    errors: tuple[tuple[float, float], ...]
    noise: Array | None = None
    beside: tuple[Effect, ...] = ()
    ambiguous_nats: float = 0.0
    untested: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class _Found:
    """The clock of some runs, which of its numbers are real, and their errors; and the fit that it comes from."""

    clock: Clock
    free: tuple[bool, bool]
    errors: tuple[float, float]
    fit: Fit
    ambiguous_nats: float = 0.0


def find_clocks(recordings: Sequence[Recording], approach: Approach) -> Clocks:
    """Estimate each recording's clock by exact resampling, with the usual systematic effects free beside it.

    A number that is not significant is left at zero: aligning what was aligned only adds noise.
    """
    leaders = clock_leaders(recordings)
    together = {i: [r for r, leader in zip(recordings, leaders, strict=True) if leader == i] for i in set(leaders)}
    found = {i: _find_clock(runs, approach) for i, runs in together.items()}
    each = [found[leader] for leader in leaders]
    longest = max(found.values(), key=lambda f: len(f.fit.problem.nodes)).fit
    return Clocks(
        tuple(f.clock for f in each),
        tuple(f.free for f in each),
        tuple(f.errors for f in each),
        longest.noise.free,
        tuple(e for e in longest.onward.effects if e.name in NUISANCE),
        max(f.ambiguous_nats for f in each),
        tuple(n for n in RIVALS if _untested(registry()[n]) and any(r.track_m is None for r in recordings)),
    )


def _untested(kind: type[Effect]) -> bool:
    """Tell whether a rival cannot be tried without the track."""
    return kind.needs_track and not brings_track(kind)


def _rivals(*, wheels: bool, steered: bool) -> list[Effect]:
    """Return the rivals as they are tried: of wheels that slip, all that lies between two kinds of contact.

    They feel the body's acceleration and some of their own; a kind that does not fit would leave a clock the rest. On
    straights no track matters, and what a turn on the spot shows of play lies between that on two tracks.
    """
    kinds = [registry()[name] for name in RIVALS]
    if not wheels:
        anyhow: list[Effect] = [kind() for kind in kinds if not kind.needs_track]
        wheeled = [kind for kind in kinds if kind.needs_track and brings_track(kind) and not steered]
        on_tracks = [effect_from_values(kind.name, {"track": track}) for kind in wheeled for track in _TRACKS_M]
        return [*anyhow, *on_tracks, *([registry()["steering_lag"]()] if steered else [])]
    slips = [effect_from_values("accel_slip", {"contact": contact}) for contact in ("axle", "wheels")]
    return [*slips, *(kind() for kind in kinds if kind.name != "accel_slip")]


def _find_clock(runs: Sequence[Recording], approach: Approach) -> _Found:
    """Return the one clock of all, which of its numbers are real, and their errors: both, the offset alone, nothing."""
    kinds = registry()
    rivals = _rivals(wheels=runs[0].track_m is not None, steered=drive_type_of(runs).steered)
    nuisance: Sequence[Effect] = [kinds[name]() for name in NUISANCE]
    clock = coarse_clock(max(runs, key=lambda run: len(run.odometry)))
    noise, alone_nats = None, 0.0
    for free in ((True, True), (True, False)):
        clock = Clock(clock.offset_s, clock.rate if free[1] else 0.0)
        for beside in ((), rivals):
            best = fit(
                runs,
                (*nuisance, *beside),
                clocks=[clock] * len(runs),
                free_clocks=[free] * len(runs),
                approach=approach,
                start=noise,
                nearly=True,
            )
            noise = best.noise.free
            clock = best.onward.clocks[0]
            errors = (float(best.clock_errors[0, 0]), float(best.clock_errors[0, 1]))
            last, error = (clock.rate, errors[1]) if free[1] else (clock.offset_s, errors[0])
            if not abs(last) > _CLOCK_LIMIT * error > 0.0:
                break
            if not beside and not free[1]:
                alone_nats = 0.5 * (last / error) ** 2
            nuisance = best.onward.effects[: len(nuisance)]
        else:
            before, after = (phased_rmse([aligned(run, c) for run in runs]) for c in (Clock(), clock))
            if after < _CLOCK_HARM * before:
                return _Found(clock, free, errors, best)
    return _Found(Clock(), (False, False), (0.0, 0.0), best, alone_nats)
