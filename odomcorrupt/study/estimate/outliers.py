"""Events: single stretches that a robust fit would not take for noise, and whether they are slips of the wheels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import binomtest, chi2, wilcoxon

from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.effects.effect import parameters
from odomcorrupt.effects.wheels import rims_of
from odomcorrupt.geometry.se2 import between, compose, rotate, wrap
from odomcorrupt.study.estimate.problem import undo
from odomcorrupt.study.io.clock import aligned
from odomcorrupt.study.io.headings import with_recomputed_headings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit

__all__ = ["Event", "during", "events", "odd_steps", "set_apart", "single_events", "slip_bursts"]

_FEWEST = 6
_LEVEL = 0.02
"""Chance that so many ordinary steps that are large by chance would all lose distance: six of six is less."""
_LEVEL_ALONE, _NEARLY_ALL = 0.05, 0.9
"""The same chance for ranks, where events carry so much of the squared error that they are slips or tails."""
_OTHERWISE, _MOST_SLIP = 2.0, 0.75
"""Factor by which bursts of the usual length have to lose too little or too much for another; and the largest slip."""
_ODD = 2e-4
"""Chance of an ordinary step that stands out."""
_HARDLY = 100.0
"""How much wider the noise of what is set apart may be."""
_PLAINLY_ODD, _MOST_SINGLE = 12.0, 5
"""How far a single event stands out at least, see `Event.plain`, and how many there may be in a study."""
_SAME_EVENT = 4
"""Intervals that stand out belong to one event where they are no farther apart than so many."""
_LASTS = 0.5
_EXCURSION_S, _CANCELS = 45.0, 0.4
"""How long an excursion of the truth may last; and what may be left of it once it is back, in parts of its size."""
_TURNS, _SEVERAL = 0.7, 0.25
"""Turn times track over what was lost along, 2 for one wheel and 0 for both; part of the slips that say so."""
_PLAIN = 2.0
"""How much more one wheel has lost than the other where it is plain which one slipped."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """A stretch in which odometry and truth part at once.

    start_s, end_s : since the recording's origin
    along_m, yaw_rad : by how much odometry goes farther (forwards) and turns more to the left than the truth
    slip : the part of the distance that was lost, positive where the truth falls behind; of the wheel that lost more,
        where the track is known; 0 where it is not known
    turn_rad : how far the odometry turned meanwhile, to the left
    lasting : whether odometry and truth stay apart; where the truth alone jumped, they come together again
    across_m : by how much odometry goes more to the left than the truth
    place_xy : where the truth is when it begins, m
    plain : how far odometry and truth part, in usual residuals of one interval
    """

    recording: str
    start_s: float
    end_s: float
    along_m: float
    yaw_rad: float
    slip: float
    turn_rad: float
    lasting: bool
    across_m: float
    place_xy: tuple[float, float]
    plain: float


def events(fit: Fit) -> list[Event]:
    """Return the stretches that a robust fit flagged in order of time, neighbours taken together."""
    return _events_of(fit, np.flatnonzero(fit.noise.weights > 1.0))


def single_events(fit: Fit) -> list[Event]:
    """Return what happened once and is no noise: a push, a lift, a bump; nothing where there are many of the kind.

    They are left out of the fit, which weighs them less the farther they stand out. Who lifts a robot often hides it
    from the truth as well, so gaps of the truth are looked at, too.
    """
    flagged, run = _standing_out(fit), fit.problem.run
    parted = (np.diff(flagged) > _SAME_EVENT) | (np.diff(run[flagged]) != 0)
    groups = np.split(flagged, np.flatnonzero(parted) + 1) if len(flagged) else []
    # between two moments of a push are others that stand out less
    whole = [np.arange(group[0], group[-1] + 1) for group in groups]
    found = [event for event in _described(fit, whole) if event.lasting]
    found = [event for event in (*found, *_across_gaps(fit)) if event.plain > _PLAINLY_ODD]
    if not any(recording.positioned for recording in fit.problem.recordings):
        found = [replace(event, along_m=0.0, across_m=0.0) for event in found]
    found.sort(key=lambda event: (event.recording, event.start_s))
    apart_s = _SAME_EVENT * fit.problem.approach.spacing_s
    joined: list[Event] = []
    for event in found:
        last = joined[-1] if joined else None
        if last is not None and last.recording == event.recording and event.start_s - last.end_s < apart_s:
            joined[-1] = _joined(last, event)
        else:
            joined.append(event)
    return joined if len(joined) <= _MOST_SINGLE else []


def _joined(first: Event, second: Event) -> Event:
    """Return an event and the one that follows it at once, such as what a gap of the truth hides, as one."""
    turned = np.asarray(first.turn_rad - first.yaw_rad)
    along_m, across_m = rotate(np.array([second.along_m, second.across_m]), turned).tolist()
    return replace(
        first,
        end_s=max(first.end_s, second.end_s),
        along_m=first.along_m + along_m,
        across_m=first.across_m + across_m,
        yaw_rad=first.yaw_rad + second.yaw_rad,
        turn_rad=first.turn_rad + second.turn_rad,
        plain=max(first.plain, second.plain),
    )


def _across_gaps(fit: Fit) -> list[Event]:
    """Return every gap of the truth as an event: how far odometry and truth part from its one end to the other."""
    problem, nodes, found, usual = fit.problem, fit.problem.nodes, [], _usual(fit)
    for r, (recording, clock) in enumerate(zip(problem.recordings, problem.clocks, strict=True)):
        own = np.flatnonzero(problem.run == r)
        gaps = own[1:][~nodes.linked[own[1:]]]
        if not len(gaps):
            continue
        left = with_recomputed_headings(undo(aligned(recording, clock), problem.effects))
        begin, end = nodes.end_s[gaps - 1], nodes.start_s[gaps]
        truth_xyt = compose(nodes.truth_xyt[gaps - 1], nodes.truth_step[gaps - 1])
        true = between(truth_xyt, nodes.truth_xyt[gaps])
        said = between(left.odometry.at(begin, left.origin_ns), left.odometry.at(end, left.origin_ns))
        apart = np.column_stack((rotate(said[:, :2] - true[:, :2], -true[:, 2]), wrap(said[:, 2] - true[:, 2])))
        # noise grows with the root of time, and that of the heading swings the way since the gap began
        spread = usual * np.sqrt(np.maximum((end - begin) / problem.approach.spacing_s, 1.0))[:, None]
        spread[:, :2] += (spread[:, 2] * np.hypot(said[:, 0], said[:, 1]))[:, None]
        plain = np.linalg.norm((apart / spread)[:, : 3 if problem.headings else 2], axis=1)
        found += [
            Event(
                recording=recording.name,
                start_s=float(begin[i]),
                end_s=float(end[i]),
                along_m=float(apart[i, 0]),
                across_m=float(apart[i, 1]),
                yaw_rad=float(apart[i, 2]),
                slip=0.0,
                turn_rad=float(said[i, 2]),
                lasting=True,
                place_xy=(float(truth_xyt[i, 0]), float(truth_xyt[i, 1])),
                plain=float(plain[i]),
            )
            for i in range(len(gaps))
        ]
    return found


def odd_steps(fit: Fit) -> list[Event]:
    """Return the stretches that stand out: the flagged ones, or where they were too many to set apart, the same ones.

    The fit is plain then and its noise is as wide as they are, so most of the others say what is usual. What happened
    once says nothing of noise, see `single_events`.
    """
    flagged = _standing_out(fit)
    return _events_of(fit, flagged[~during(fit, single_events(fit))[flagged]])


def set_apart(fit: Fit) -> Array:
    """Return the weights (K,) of a fit in which the stretches that stand out hardly count."""
    weights = np.ones(len(fit.problem.nodes))
    weights[_standing_out(fit)] = _HARDLY
    return weights


def _standing_out(fit: Fit) -> NDArray[np.int64]:
    if (fit.noise.weights > 1.0).any():
        return np.flatnonzero(fit.noise.weights > 1.0)
    innovations = fit.noise.innovations.reshape(-1, 3)[:, : 3 if fit.problem.headings else 2]
    usual = 1.4826 * np.median(np.abs(innovations), axis=0) + 1e-12
    return np.flatnonzero(np.sum((innovations / usual) ** 2, axis=1) > chi2.isf(_ODD, innovations.shape[1]))


def _usual(fit: Fit) -> Array:
    """Return the usual residual (3,) of an interval; infinite for travel where no truth measured it (gyros alone)."""
    usual: Array = 1.4826 * np.median(np.abs(fit.problem.nodes.residual), axis=0) + 1e-12
    if not any(recording.positioned for recording in fit.problem.recordings):
        usual[:2] = np.inf
    return usual


def _events_of(fit: Fit, flagged: NDArray[np.int64]) -> list[Event]:
    return _described(fit, np.split(flagged, np.flatnonzero(np.diff(flagged) > 1) + 1) if len(flagged) else [])


def _described(fit: Fit, groups: Sequence[NDArray[np.int64]]) -> list[Event]:
    problem, nodes = fit.problem, fit.problem.nodes
    flagged = np.concatenate(groups) if len(groups) else np.zeros(0, dtype=np.int64)
    usual = _usual(fit)
    found = []
    for group in groups:
        step, heading = nodes.odometry_step[group], nodes.truth_xyt[group, 2] + nodes.truth_step[group, 2]
        # in the frame of its beginning: while a robot turns, what is off ahead comes back from the side
        residual = nodes.residual[group].copy()
        residual[:, :2] = rotate(residual[:, :2], heading - heading[0])
        apart = np.linalg.norm(residual.sum(axis=0) / usual)
        most = float(np.linalg.norm(residual / usual, axis=1).max())
        found.append(
            Event(
                recording=problem.recordings[int(problem.run[group[0]])].name,
                start_s=float(nodes.start_s[group[0]]),
                end_s=float(nodes.end_s[group[-1]]),
                along_m=float(residual[:, 0].sum()),
                yaw_rad=float(residual[:, 2].sum()),
                slip=_slip(
                    residual.sum(axis=0), step.sum(axis=0), problem.recordings[int(problem.run[group[0]])].track_m
                ),
                turn_rad=float(step[:, 2].sum()),
                across_m=float(residual[:, 1].sum()),
                place_xy=(float(nodes.truth_xyt[group[0], 0]), float(nodes.truth_xyt[group[0], 1])),
                plain=float(apart),
                lasting=bool(apart > _LASTS * most) and not _comes_back(fit, group, flagged, usual),
            )
        )
    return found


def _comes_back(fit: Fit, group: NDArray[np.int64], flagged: NDArray[np.int64], usual: Array) -> bool:
    """Tell whether a stretch that stands out is one side of an excursion of the truth: the way out, or the way back.

    A localisation that loses its way, or fixes that are floating, come back to where they were some time later (or
    have just done so). Odometry that was pushed away stays there.
    """
    nodes, run = fit.problem.nodes, fit.problem.run
    heading = nodes.truth_xyt[:, 2] + nodes.truth_step[:, 2]
    world = nodes.residual.copy()
    world[:, :2] = rotate(nodes.residual[:, :2], heading)
    middle, own = float(nodes.start_s[group].mean()), world[group].sum(axis=0)
    reach = np.array([max(usual[:2]), max(usual[:2]), usual[2]])
    size = float(np.linalg.norm(own / reach))
    others = np.setdiff1d(flagged, group)
    near = others[(run[others] == run[group[0]]) & (np.abs(nodes.start_s[others] - middle) < _EXCURSION_S)]
    for some in np.split(near, np.flatnonzero(np.diff(near) > 1) + 1):
        back = world[some].sum(axis=0)
        largest = max(size, float(np.linalg.norm(back / reach)))
        if len(some) and float(np.linalg.norm((own + back) / reach)) < _CANCELS * largest:
            return True
    return False


def _slip(lost: Array, path: Array, track_m: float | None) -> float:
    """Return the part of its distance that a wheel lost, from what odometry moved and turned too far, and in all."""
    if track_m is None:
        return _part(float(lost[0]), float(path[0]))
    lost_by, gone = rims_of(lost[0], lost[2], track_m), rims_of(path[0], path[2], track_m)
    more, less = sorted((0, 1), key=lambda wheel: -abs(lost_by[wheel]))
    against_each_other = gone.right * gone.left < 0.0
    if against_each_other and abs(lost_by[more]) < _PLAIN * abs(lost_by[less]):
        return 0.0
    return _part(float(lost_by[more]), float(gone[more]))


def _part(lost: float, path: float) -> float:
    return lost / path if abs(path) > 1e-3 else 0.0


def slip_bursts(fit: Fit) -> Effect | None:
    """Return bursts of slip where the events are slips: the truth falls behind in nearly all of them.

    Outliers of the truth and tails of the noise are on both sides. Where the events are nearly all of the error, the
    large ones say it (signed ranks: Wilcoxon 1945, Biometrics Bulletin 1), whatever the small ones beside them do. A
    burst lasts as long as it takes to lose what was lost.
    """
    lasting = [event for event in odd_steps(fit) if event.lasting and event.slip != 0.0]
    slips = np.array([event.slip for event in lasting])
    if len(slips) < _FEWEST:
        return None
    behind = int(np.sum(slips > 0.0))
    track_m = fit.problem.recordings[0].track_m
    lost_m = np.array([_lost(event, track_m) for event in lasting])
    if binomtest(behind, len(slips), 0.5, alternative="greater").pvalue > _LEVEL and not (
        _is_the_error(fit, lasting) and wilcoxon(lost_m * np.sign(slips), alternative="greater").pvalue < _LEVEL_ALONE
    ):
        return None
    nodes = fit.problem.nodes
    seconds = float(np.sum(nodes.end_s - nodes.start_s))
    spacing = fit.problem.approach.spacing_s
    # a burst is shorter than the stretch it was found in: its slip there is spread over all of it
    duration = 0.5 * spacing
    slip = float(np.median(slips[slips > 0.0])) * spacing / duration
    # a stretch in which the truth rested or reversed asks for more than a burst can lose
    bounds = {p.name: (p.low, p.high) for p in parameters(registry()["slip_burst"])}
    slip = float(np.clip(slip, *bounds["slip"]))
    rims = _rims(nodes.truth_step[:, 0], nodes.truth_step[:, 2], track_m)
    usual_mps = float(np.sqrt(np.sum(rims**2) / (2.0 * spacing * seconds)))
    asked = float(np.sqrt(np.mean(lost_m**2))) / max(usual_mps * duration, 1e-9)
    if asked > _OTHERWISE * _times_lost(slip):
        duration *= asked / _times_lost(slip)
    elif asked * _OTHERWISE < _times_lost(slip):
        slips_at = np.linspace(0.0, slip, 200)[1:]
        slip = float(np.interp(asked, [_times_lost(one) for one in slips_at], slips_at))
    seen = {"rate": len(slips) / seconds, "slip": slip, "duration": duration}
    sized: dict[str, float | str] = {name: float(np.clip(v, *bounds[name])) for name, v in seen.items()}
    words = _words([event for event in lasting if event.slip > 0.0], track_m)
    return effect_from_values("slip_burst", sized | words)


def _times_lost(slip: float) -> float:
    """Return how far a wheel spins beside what it rolls meanwhile, RMS over bursts spread evenly about a mean slip."""
    spread = min(slip, _MOST_SLIP - slip)
    low, high = slip - spread, slip + spread
    if high - low < 1e-6:
        return slip / (1.0 - slip)
    longer = np.log((1.0 - low) / (1.0 - high)) / (high - low)
    return float(np.sqrt(1.0 / ((1.0 - low) * (1.0 - high)) - 2.0 * longer + 1.0))


def _rims(along: Array, turn: Array, track_m: float | None) -> Array:
    """Return (2, n): what the right wheel and the left one travel; the robot itself where the track is not known."""
    return np.stack(rims_of(along, turn, track_m or 0.0))


def _lost(event: Event, track_m: float | None) -> float:
    """Return the distance (m, positive) by which odometry and truth part in an event, of the wheel that parts more."""
    return float(np.abs(_rims(np.array([event.along_m]), np.array([event.yaw_rad]), track_m)).max())


def _is_the_error(fit: Fit, stretches: Sequence[Event]) -> bool:
    """Tell whether stretches that stand out are nearly all of the squared error of a fit."""
    inside = during(fit, stretches)
    square = np.sum((fit.problem.nodes.residual / _usual(fit)) ** 2, axis=1)
    return bool(square[inside].sum() > _NEARLY_ALL * square.sum())


def during(fit: Fit, stretches: Sequence[Event]) -> NDArray[np.bool_]:
    """Return which intervals (K,) of a fit lie within some stretches."""
    nodes, run = fit.problem.nodes, fit.problem.run
    inside = np.zeros(len(nodes), dtype=bool)
    for r, recording in enumerate(fit.problem.recordings):
        for event in stretches:
            if event.recording == recording.name:
                inside |= (run == r) & (nodes.start_s >= event.start_s) & (nodes.end_s <= event.end_s)
    return inside


def _words(slips: Sequence[Event], track_m: float | None) -> dict[str, str]:
    """Return which wheels slip, and whether they turn the odometry: one of them alone does, or both in a turn."""
    yaw, along, turn, slip = (
        np.array([getattr(e, n) for e in slips]) for n in ("yaw_rad", "along_m", "turn_rad", "slip")
    )
    single = np.zeros(len(slips)) if track_m is None else np.abs(yaw) * track_m > _TURNS * np.abs(along)
    sides = "any" if np.mean(single) > _SEVERAL else "both"
    shared = np.abs(slip * turn).sum()
    by_gyro = sides == "both" and shared > 0.0 and np.abs(yaw).sum() < _SEVERAL * shared
    return {"sides": sides, "heading": "gyro" if by_gyro else "wheels"}
