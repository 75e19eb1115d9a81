"""Events: single stretches that a robust fit would not take for noise, and whether they are slips of the wheels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import binomtest

from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.effects.effect import parameters

if TYPE_CHECKING:
    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.fitting.gauss_newton import Fit

__all__ = ["Event", "events", "slip_bursts"]

_FEWEST = 6
_LEVEL = 1e-3


@dataclass(frozen=True, slots=True)
class Event:
    """A stretch in which odometry and truth part at once.

    start_s, end_s : since the recording's origin
    along_m, yaw_rad : by how much odometry goes farther (forwards) and turns more to the left than the truth
    slip : the part of the way that was lost, positive where the truth falls behind
    """

    recording: str
    start_s: float
    end_s: float
    along_m: float
    yaw_rad: float
    slip: float


def events(fit: Fit) -> list[Event]:
    """Return the flagged stretches in order of time, neighbours taken together."""
    problem, nodes = fit.problem, fit.problem.nodes
    flagged = np.flatnonzero(fit.noise.weights > 1.0)
    groups = np.split(flagged, np.flatnonzero(np.diff(flagged) > 1) + 1) if len(flagged) else []
    found = []
    for group in groups:
        along = float(nodes.residual[group, 0].sum())
        way = float(nodes.odometry_step[group, 0].sum())
        found.append(
            Event(
                recording=problem.recordings[int(problem.run[group[0]])].name,
                start_s=float(nodes.start_s[group[0]]),
                end_s=float(nodes.end_s[group[-1]]),
                along_m=along,
                yaw_rad=float(nodes.residual[group, 2].sum()),
                slip=along / way if abs(way) > 1e-3 else 0.0,
            )
        )
    return found


def slip_bursts(fit: Fit) -> Effect | None:
    """Return bursts of slip where the events are slips: the truth falls behind in nearly all of them.

    Outliers of the truth and tails of the noise go either way.
    """
    slips = np.array([event.slip for event in events(fit) if event.slip != 0.0])
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
    return effect_from_values("slip_burst", {name: float(np.clip(v, *bounds[name])) for name, v in seen.items()})
