"""Periodic errors: screening for errors that repeat with each revolution of a wheel, as of an eccentric one.

Waves over the distance rolled by a wheel are tested in the heading at all wavelengths at once. The score of each step
is binned over distance, and one Fourier transform gives the score of every wave (Lomb's periodogram on a grid).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import find_peaks

from odomcorrupt.effects.gears import FlatSpot
from odomcorrupt.effects.wheels import TRACKS_M
from odomcorrupt.study.estimate.drive_type import drive_type_of
from odomcorrupt.study.select.evidence import project_out
from odomcorrupt.study.terms.term import LibraryTerm

if TYPE_CHECKING:
    from collections.abc import Callable

    from odomcorrupt.effects.effect import Motion
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit

LONGEST_M, SHORTEST_M = 4.0, 0.15  # wavelengths that are tested, m
_LARGEST_TURN_M = 2.5
"""Largest circumference of a wheel that is tested, m: a radius of 0.4 m."""
_GRID_M = 0.02  # bin of the distance, m
_TRIED = 3  # wavelengths scored exactly for each distance


def flat_spots(fit: Fit) -> list[tuple[LibraryTerm, ...]]:
    """Return flat spots of either wheel at the likeliest circumferences and phases, as a family; none for a car.

    If the track is unknown, every track in `TRACKS_M` is tried, because the distance rolled depends on it.
    """
    problem = fit.problem
    if not problem.headings or drive_type_of(problem.recordings).steered:
        return []
    rest, whiten = project_out(fit), fit.noise.whitener.whiten
    intervals = problem.intervals
    # score (n,) of each step for an error of the heading proportional to its travel
    moved = np.concatenate([m.v * m.dt_s for m in problem.motions])
    interval = np.repeat(np.arange(len(intervals)), np.diff(np.append(intervals.first, len(intervals.source))))
    pull = fit.noise.whitener.pulled(rest.residual)[interval]
    score = np.einsum("in,ni->n", intervals.carried(-moved[:, None] * (0.0, 0.0, 1.0)), pull)
    own = problem.motions[0].track_m
    found: list[tuple[float, FlatSpot]] = []
    for track_m in TRACKS_M if own is None else (own,):
        for wheel, side in (("right", 0.5 * track_m), ("left", -0.5 * track_m)):
            for turn_m in _likeliest(fit, score, lambda m, side=side: m.rolled(side)[1:]):  # type: ignore[misc]
                if turn_m > _LARGEST_TURN_M:
                    continue
                spot = FlatSpot(circumference=turn_m, wheel=wheel, form="eccentric", track=0.0 if own else track_m)
                pair = [spot, replace(spot, phase=0.5 * np.pi)]
                columns = whiten(np.concatenate([problem.columns(one) for one in pair], axis=2))
                part = np.linalg.lstsq(rest.of(columns), rest.residual, rcond=None)[0]
                phase = float(np.arctan2(part[1], part[0]))
                found.append((rest.gain(columns), replace(spot, phase=phase)))
    found.sort(key=lambda one: one[0], reverse=True)
    distance_m = sum(float(np.abs(m.v * m.dt_s).sum()) for m in problem.motions)
    trials = max(int(2.0 * distance_m / SHORTEST_M), 1)
    forms = [replace(spot, form=form) for _, spot in found[:_TRIED] for form in ("eccentric", "flat")]
    return [tuple(LibraryTerm(spot, trials * len(forms)) for spot in forms)] if forms else []


def _likeliest(fit: Fit, score: Array, distance: Callable[[Motion], Array]) -> list[float]:
    """Return the wavelengths, m, with the largest scores, for information spread evenly over the distance.

    score : (n,) score of each step for an error of the heading proportional to its travel
    """
    intervals, motions = fit.problem.intervals, fit.problem.motions
    distance_m = np.concatenate([distance(m) for m in motions])
    run = np.repeat(np.arange(len(motions)), [len(m) for m in motions])[intervals.source]
    # zero-padded by four, because peaks fall between the bins of the plain transform
    size = 1 << int(np.ceil(np.log2(4.0 * (np.ptp(distance_m) / _GRID_M + 2.0))))
    power = np.zeros(size // 2 + 1, dtype=np.complex128)
    for r in range(len(motions)):
        mine = run == r
        place = ((distance_m[intervals.source[mine]] - distance_m.min()) / _GRID_M).astype(np.int64)
        power += np.fft.rfft(np.bincount(place, score[mine], size))
    strength = np.abs(power) ** 2
    per_m = np.fft.rfftfreq(size, _GRID_M)
    inside = np.flatnonzero((per_m >= 1.0 / LONGEST_M) & (per_m <= 1.0 / SHORTEST_M))
    # longer waves turn the robot further and have larger scores: divide by the smoothed spectrum
    level = uniform_filter1d(strength[inside], len(inside) // 10 + 1, mode="nearest")
    ratio = np.pad(strength[inside] / np.maximum(level, 1e-300), 1)
    peaks = find_peaks(ratio, distance=9)[0]
    return (1.0 / per_m[inside[peaks[np.argsort(-ratio[peaks])[:_TRIED]] - 1]]).tolist()
