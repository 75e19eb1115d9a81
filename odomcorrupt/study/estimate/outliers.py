"""Outlier events: stretches that a robust fit flags as larger than noise, and whether they are wheel slips.

Heavy-tailed noise is tested by whether innovations are sums of Student's t draws, and of which degrees of freedom.

The noise law draws once per increment. An interval sums many draws, so its tails are lighter than those of one draw.
The density of the sum is the Fourier transform of the characteristic function of t (Hurst 1995; see Kotz and Nadarajah
2004, Multivariate t Distributions, section 2.3), raised to the power of the number of draws.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import gammaln, kve
from scipy.stats import chi2, wilcoxon

from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.effects.effect import parameters
from odomcorrupt.effects.wheels import rims_of
from odomcorrupt.geometry.se2 import rotate
from odomcorrupt.study.estimate.config import INTERVAL_S
from odomcorrupt.study.estimate.noise_likelihood import ODD
from odomcorrupt.study.estimate.whitener import interval_covariance
from odomcorrupt.study.io.motion_windows import weighted_median

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit

_FEWEST = 6
_LEVEL = 0.02
"""Significance level of the test that events lose distance; met by six of six."""
_PLAINLY_ODD, _MOST_SINGLE = 12.0, 5
"""Minimum size of a single event, see `Event.plain`, and maximum number of single events in a study."""
_SAME_EVENT = 4
"""Maximum index distance of flagged intervals that belong to one event."""
_EXCURSION_S, _CANCELS = 45.0, 0.4
"""Maximum duration of an excursion of the truth, and maximum remainder after its return, as a fraction of its size."""
_TURNS, _SEVERAL = 0.7, 0.25
"""Ratio of turn times track to distance lost (2 if one wheel slips, 0 for both); share of slips that decides."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """A stretch in which odometry and truth suddenly diverge.

    start_s, end_s : times since the recording's origin, seconds
    along_m, yaw_rad : odometry minus truth, forwards and counter-clockwise
    slip : fraction of the distance that was lost, positive if the truth falls behind; of the wheel that lost more if
        the track is known
    turn_rad : turn of the odometry during the event, counter-clockwise
    lasting : whether the difference remains; after a jump of the truth it disappears again
    across_m : odometry minus truth, to the left
    place_xy : position of the truth at the start, m
    plain : size of the difference in usual residuals of one interval
    """

    recording: str
    start_s: float
    end_s: float
    along_m: float
    yaw_rad: float
    slip: float = 0.0
    turn_rad: float
    across_m: float
    place_xy: tuple[float, float]
    plain: float
    lasting: bool = True


def events(fit: Fit) -> list[Event]:
    """Return in order of time the stretches that a robust fit flags, neighbouring intervals merged."""
    found = _events_of(fit, np.flatnonzero(fit.noise.weights > 1.0))
    return sorted(found, key=lambda event: (event.recording, event.start_s))


def single_events(fit: Fit) -> list[Event]:
    """Return single events that are not noise: a push, a lift, a bump; an empty list if there are too many.

    The fit down-weights them by their size.
    """
    flagged, run = _standing_out(fit), fit.problem.run
    parted = (np.diff(flagged) > _SAME_EVENT) | (np.diff(run[flagged]) != 0)
    groups = np.split(flagged, np.flatnonzero(parted) + 1) if len(flagged) else []
    # a push also contains intervals that are not flagged
    whole = [np.arange(group[0], group[-1] + 1) for group in groups]
    found = [event for event in _described(fit, whole) if event.lasting and event.plain > _PLAINLY_ODD]
    if not any(recording.positioned for recording in fit.problem.recordings):
        found = [replace(event, along_m=0.0, across_m=0.0) for event in found]
    found.sort(key=lambda event: (event.recording, event.start_s))
    return found if len(found) <= _MOST_SINGLE else []


def odd_steps(fit: Fit) -> list[Event]:
    """Return outlier stretches: those flagged by the robust fit, or by a robust scale if they were too many for it.

    In the latter case the fit has no weights and its noise includes the outliers, so the scale is the median of all
    intervals.
    """
    return _events_of(fit, _standing_out(fit))


def _standing_out(fit: Fit) -> NDArray[np.int64]:
    if (fit.noise.weights > 1.0).any():
        return np.flatnonzero(fit.noise.weights > 1.0)
    innovations = fit.noise.innovations.reshape(-1, 3)[:, : 3 if fit.problem.headings else 2]
    usual = 1.4826 * np.median(np.abs(innovations), axis=0) + 1e-12
    return np.flatnonzero(np.sum((innovations / usual) ** 2, axis=1) > chi2.isf(ODD, innovations.shape[1]))


def usual_residual(fit: Fit) -> Array:
    """Return the robust scale (3,) of an interval's residual; infinite for travel if the truth is a gyro alone."""
    usual: Array = 1.4826 * np.median(np.abs(fit.problem.intervals.residual), axis=0) + 1e-12
    if not any(recording.positioned for recording in fit.problem.recordings):
        usual[:2] = np.inf
    return usual


def _events_of(fit: Fit, flagged: NDArray[np.int64]) -> list[Event]:
    return _described(fit, np.split(flagged, np.flatnonzero(np.diff(flagged) > 1) + 1) if len(flagged) else [])


def _described(fit: Fit, groups: Sequence[NDArray[np.int64]]) -> list[Event]:
    problem, intervals = fit.problem, fit.problem.intervals
    flagged = np.concatenate(groups) if len(groups) else np.zeros(0, dtype=np.int64)
    usual = usual_residual(fit)
    found = []
    for group in groups:
        recording = problem.recordings[int(problem.run[group[0]])]
        step, heading = intervals.odometry_step[group], intervals.truth_xyt[group, 2] + intervals.truth_step[group, 2]
        # sum in the frame of the event's first interval, because the robot may turn
        residual = intervals.residual[group].copy()
        residual[:, :2] = rotate(residual[:, :2], heading - heading[0])
        apart = np.linalg.norm(residual.sum(axis=0) / usual)
        found.append(
            Event(
                recording=recording.name,
                start_s=float(intervals.start_s[group[0]]),
                end_s=float(intervals.end_s[group[-1]]),
                along_m=float(residual[:, 0].sum()),
                yaw_rad=float(residual[:, 2].sum()),
                slip=_slip(residual.sum(axis=0), step.sum(axis=0), recording.track_m),
                turn_rad=float(step[:, 2].sum()),
                across_m=float(residual[:, 1].sum()),
                place_xy=(float(intervals.truth_xyt[group[0], 0]), float(intervals.truth_xyt[group[0], 1])),
                plain=float(apart),
                lasting=not _comes_back(fit, group, flagged, usual),
            )
        )
    return found


def _comes_back(fit: Fit, group: NDArray[np.int64], flagged: NDArray[np.int64], usual: Array) -> bool:
    """Return whether an outlier stretch is the start or the end of an excursion of the truth.

    A lost localisation or floating RTK fixes return to the true position some time later. After a push, the difference
    to the odometry remains.
    """
    intervals, run = fit.problem.intervals, fit.problem.run
    heading = intervals.truth_xyt[:, 2] + intervals.truth_step[:, 2]
    world = intervals.residual.copy()
    world[:, :2] = rotate(intervals.residual[:, :2], heading)
    middle, own = float(intervals.start_s[group].mean()), world[group].sum(axis=0)
    reach = np.array([max(usual[:2]), max(usual[:2]), usual[2]])
    size = float(np.linalg.norm(own / reach))
    others = np.setdiff1d(flagged, group)
    near = others[(run[others] == run[group[0]]) & (np.abs(intervals.start_s[others] - middle) < _EXCURSION_S)]
    for some in np.split(near, np.flatnonzero(np.diff(near) > 1) + 1):
        back = world[some].sum(axis=0)
        largest = max(size, float(np.linalg.norm(back / reach)))
        if len(some) and float(np.linalg.norm((own + back) / reach)) < _CANCELS * largest:
            return True
    return False


def _slip(lost: Array, path: Array, track_m: float | None) -> float:
    """Return the fraction of distance lost, with a known track by the wheel that lost more."""
    lost_m, gone_m = float(lost[0]), float(path[0])
    if track_m is not None:
        both = zip(rims_of(lost[0], lost[2], track_m), rims_of(path[0], path[2], track_m), strict=True)
        lost_m, gone_m = max(((float(a), float(b)) for a, b in both), key=lambda wheel: abs(wheel[0]))
    return lost_m / gone_m if abs(gone_m) > 1e-3 else 0.0


def slip_bursts(fit: Fit) -> Effect | None:
    """Return a slip_burst effect if the events are slips: the truth falls behind in nearly all of them; else None.

    Outliers of the truth and heavy tails of the noise have both signs: a signed-rank test, in which large events count
    more (Wilcoxon 1945, Biometrics Bulletin 1). Slip and length of a usual burst are medians weighted by lost distance.
    """
    lasting = [event for event in odd_steps(fit) if event.lasting and event.slip != 0.0]
    if len(lasting) < _FEWEST:
        return None
    track_m = fit.problem.recordings[0].track_m
    slips, long_s, along_m, yaw_rad = np.array(
        [(event.slip, event.end_s - event.start_s, event.along_m, event.yaw_rad) for event in lasting]
    ).T
    lost_m = np.abs(rims_of(along_m, yaw_rad, track_m or 0.0)).max(axis=0)
    if wilcoxon(lost_m * np.sign(slips), alternative="greater").pvalue > _LEVEL:
        return None
    intervals, spacing_s = fit.problem.intervals, fit.problem.approach.spacing_s
    behind = slips > 0.0
    slip, length_s = (weighted_median(values[behind], lost_m[behind]) for values in (slips, long_s))
    # intervals at both ends of a burst are in it in part
    duration = max(length_s - spacing_s, 0.5 * spacing_s)
    seconds = float(np.sum(intervals.end_s - intervals.start_s))
    seen = {"rate": int(behind.sum()) / seconds, "slip": slip * length_s / duration, "duration": duration}
    # a stretch in which the truth rested or reversed would need more slip than is possible
    bounds = {p.name: (p.low, p.high) for p in parameters(registry()["slip_burst"])}
    sized: dict[str, float | str] = {name: float(np.clip(v, *bounds[name])) for name, v in seen.items()}
    words = _words([event for event in lasting if event.slip > 0.0], track_m)
    return effect_from_values("slip_burst", sized | words)


def during(fit: Fit, stretches: Sequence[Event]) -> NDArray[np.bool_]:
    """Return a mask (K,) of the fit's intervals inside the given stretches."""
    intervals, run = fit.problem.intervals, fit.problem.run
    name = np.array([recording.name for recording in fit.problem.recordings])[run]
    first, last = intervals.start_s, intervals.end_s
    inside = [(name == e.recording) & (first >= e.start_s) & (last <= e.end_s) for e in stretches]
    return np.any([np.zeros(len(intervals), dtype=bool), *inside], axis=0)


def _words(slips: Sequence[Event], track_m: float | None) -> dict[str, str]:
    """Return the `sides` and `heading` parameters of slip_burst: which wheels slip, and what measures the heading."""
    yaw, along, turn, slip = np.array([(e.yaw_rad, e.along_m, e.turn_rad, e.slip) for e in slips]).T
    single = np.zeros(len(slips)) if track_m is None else np.abs(yaw) * track_m > _TURNS * np.abs(along)
    sides = "any" if np.mean(single) > _SEVERAL else "both"
    shared = np.abs(slip * turn).sum()
    by_gyro = sides == "both" and shared > 0.0 and np.abs(yaw).sum() < _SEVERAL * shared
    return {"sides": sides, "heading": "gyro" if by_gyro else "wheels"}


_MOSTLY = 0.5
_INVERSE_DOFS = np.linspace(0.05, 0.45, 17)
_WIDTHS = np.geomspace(0.3, 1.1, 27)
_NAMED_NATS = 10.0
_ARM_M = 0.2
"""Approximate distance of the wheels from the robot's centre, m: counts a turn on the spot as wheel travel."""
_STILL_M, _USUAL = 1e-3, 0.2
_RANGE, _SIZE = 120.0, 1 << 14


def heavy_tails(fit: Fit) -> tuple[Effect, float] | None:
    """Return the heavy_tails effect and its log-likelihood gain over normal noise in nats, or None if not supported."""
    if fit.problem.approach.spacing_s > INTERVAL_S:  # a truth with errors of centimetres has heavy tails itself
        return None
    odd_ones = odd_steps(fit)
    lasting = sum(event.lasting for event in odd_ones)
    # if most outliers are reversed later, they are errors of the truth
    if not lasting or lasting < _MOSTLY * len(odd_ones):
        return None
    # a robot at rest has no noise: with a perfect truth, its zeros would make all moving intervals look heavy-tailed
    steps = fit.problem.intervals.odometry_step
    travel = np.hypot(steps[:, 0], steps[:, 1]) + _ARM_M * np.abs(steps[:, 2])
    usual = np.median(travel[travel > _STILL_M]) if (travel > _STILL_M).any() else np.inf
    driven = (travel > _USUAL * usual) & ~during(fit, single_events(fit))
    if not (channels := _of_odometry(fit, driven)):
        return None
    # undo the robust weights, which down-weighted the outliers
    odd = fit.noise.innovations.reshape(-1, 3) * np.sqrt(fit.noise.weights)[:, None]
    used = odd[driven][:, channels]
    draws = max(round(len(fit.problem.intervals.source) / len(fit.problem.intervals)), 1)
    nats = np.array([_likelihood(used, inverse_dof, draws) for inverse_dof in _INVERSE_DOFS])
    variance = used.var(axis=0)
    normal = -0.5 * len(used) * float(np.sum(np.log(2.0 * np.pi * variance) + 1.0))
    best = int(np.argmax(nats))
    gain = float(nats[best]) - normal - 0.5 * float(np.log(used.size))
    if gain < _NAMED_NATS:
        return None
    return effect_from_values("heavy_tails", {"inverse_dof": float(_INVERSE_DOFS[best])}), gain


def _of_odometry(fit: Fit, driven: NDArray[np.bool_]) -> list[int]:
    """Return the channels in which odometry has most of the noise; elsewhere tails may belong to the truth.

    Noise within the remainder of an effect (see `Effect.remainder`) is that remainder: it differs between speeds, so
    that all of it together has heavy tails. The noise across is that of the heading.
    """
    if not driven.any():
        return []
    intervals = fit.problem.intervals
    q = intervals.covariance(fit.problem.approach.law, fit.noise.coefficients, fit.problem.steps)
    own = np.einsum("kii->ki", q)
    usual = np.median((own / np.einsum("kii->ki", interval_covariance(intervals, q, fit.noise.truth)))[driven], axis=0)
    speed = np.sqrt(np.mean(own[driven] / (intervals.end_s - intervals.start_s)[driven, None] ** 2, axis=0))
    along, yaw = np.sum([(0.0, 0.0), *(effect.remainder for effect in fit.effects)], axis=0)
    explained = speed[[0, 2, 2]] <= (along, yaw, yaw)
    return [c for c in range(3 if fit.problem.headings else 2) if usual[c] > _MOSTLY and not explained[c]]


def _likelihood(values: Array, inverse_dof: float, draws: int) -> float:
    """Return the log likelihood of columns (K, c), each with its best-fitting width."""
    grid, density = log_density_of_sums(inverse_dof, draws)
    total = 0.0
    for column in values.T:
        widths = _WIDTHS * column.std()
        total += max(float(np.interp(column / w, grid, density).sum() - len(column) * np.log(w)) for w in widths)
    return total


def log_density_of_sums(inverse_dof: float, draws: int) -> tuple[Array, Array]:
    """Return a grid (n,) and the log density (n,) on it of a sum of `draws` Student's t draws, scaled to variance 1."""
    dof = 1.0 / inverse_dof
    step = 2.0 * _RANGE / _SIZE
    u = np.abs(2.0 * np.pi * np.fft.fftfreq(_SIZE, step)) * np.sqrt((dof - 2.0) / draws)
    inner = np.maximum(u, 1e-9)
    half = dof / 2.0
    # log of K_half(u) u^half / (Gamma(half) 2^(half - 1)), with the exponential taken out of K
    log_phi = np.log(kve(half, inner)) - inner + half * np.log(inner) - gammaln(half) - (half - 1.0) * np.log(2.0)
    density = np.fft.fftshift(np.real(np.fft.ifft(np.exp(draws * np.minimum(log_phi, 0.0))))) / step
    # far tail: below the rounding error of the transform, so limited from below
    places = np.asarray((np.arange(_SIZE) - _SIZE // 2) * step, dtype=np.float64)
    return places, np.log(np.maximum(density, 1e-12))
