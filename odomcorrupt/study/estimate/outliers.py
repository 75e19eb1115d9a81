"""Events: single stretches that a robust fit would not take for noise, and whether they are slips of the wheels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import binomtest, chi2

from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.effects.effect import parameters
from odomcorrupt.effects.wheels import rims_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit

__all__ = ["Event", "events", "set_apart", "slip_bursts"]

_FEWEST = 6
_LEVEL = 0.02
"""Chance that so many ordinary steps that are large by chance would all lose distance: six of six is less."""
_ODD = 2e-4
"""Chance of an ordinary step that stands out."""
_HARDLY = 100.0
"""How much wider the noise of what is set apart may be."""
_LASTS = 0.5
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
    """

    recording: str
    start_s: float
    end_s: float
    along_m: float
    yaw_rad: float
    slip: float
    turn_rad: float
    lasting: bool


def events(fit: Fit) -> list[Event]:
    """Return the stretches that a robust fit flagged in order of time, neighbours taken together."""
    return _events_of(fit, np.flatnonzero(fit.noise.weights > 1.0))


def odd_steps(fit: Fit) -> list[Event]:
    """Return the stretches that stand out: the flagged ones, or where they were too many to set apart, the same ones.

    The fit is plain then and its noise is as wide as they are, so most of the others say what is usual.
    """
    return _events_of(fit, _standing_out(fit))


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


def _events_of(fit: Fit, flagged: NDArray[np.int64]) -> list[Event]:
    problem, nodes = fit.problem, fit.problem.nodes
    groups = np.split(flagged, np.flatnonzero(np.diff(flagged) > 1) + 1) if len(flagged) else []
    usual = 1.4826 * np.median(np.abs(nodes.residual), axis=0) + 1e-12
    found = []
    for group in groups:
        residual, step = nodes.residual[group], nodes.odometry_step[group]
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
                lasting=bool(apart > _LASTS * most),
            )
        )
    return found


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

    Outliers of the truth and tails of the noise are on both sides.
    """
    lasting = [event for event in odd_steps(fit) if event.lasting and event.slip != 0.0]
    slips = np.array([event.slip for event in lasting])
    if len(slips) < _FEWEST:
        return None
    behind = int(np.sum(slips > 0.0))
    if binomtest(behind, len(slips), 0.5, alternative="greater").pvalue > _LEVEL:
        return None
    nodes = fit.problem.nodes
    seconds = float(np.sum(nodes.end_s - nodes.start_s))
    spacing = fit.problem.approach.spacing_s
    # a burst is shorter than the stretch it was found in: its slip there is spread over all of it
    duration = 0.5 * spacing
    slip = float(np.median(slips[slips > 0.0])) * spacing / duration
    seen = {"rate": len(slips) / seconds, "slip": slip, "duration": duration}
    # a stretch in which the truth stood still or went back asks for more than a burst can lose
    bounds = {p.name: (p.low, p.high) for p in parameters(registry()["slip_burst"])}
    sized: dict[str, float | str] = {name: float(np.clip(v, *bounds[name])) for name, v in seen.items()}
    words = _words([event for event in lasting if event.slip > 0.0], fit.problem.recordings[0].track_m)
    return effect_from_values("slip_burst", sized | words)


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
