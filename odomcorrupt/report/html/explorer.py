"""Interactive part of a report: path, residuals and errors as JSON for a small script inside the page.

The script (`explorer.js`) draws with SVG, loads nothing, and leaves the static content unchanged.
"""

from __future__ import annotations

import json
from base64 import b64encode
from dataclasses import dataclass
from hashlib import sha256
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from odomcorrupt.errors import EffectError
from odomcorrupt.geometry.se2 import between, compose
from odomcorrupt.report.html.page import resource
from odomcorrupt.report.plots.comparison import rms_interval
from odomcorrupt.report.text.comparison import MOST, sentence
from odomcorrupt.study.estimate.problem import undo
from odomcorrupt.study.validate.calibration import HORIZONS_M
from odomcorrupt.study.validate.error_rates import CHANNELS, interval_motion
from odomcorrupt.study.validate.lack_of_fit import all_patterns
from odomcorrupt.study.validate.predictive_check import replay

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.validate.compare import Comparison, ModelEvaluation
    from odomcorrupt.study.validate.evaluation import Evaluation
    from odomcorrupt.study.validate.lack_of_fit import Failure

_MOST_PIECES = 8
"""Number of segments that can be selected, the longest ones."""
_POINTS = 7000
"""Total number of points, of all segments under all models; keeps the page below 3 MB."""
_RUNS, _RUN_POINTS, _RUN_STRETCHES = 20, 200, 8
"""Runs of a model drawn around the truth, points per run, and number of pairs of model and segment with runs."""


def explorer(comparison: Comparison) -> str:
    """Return the section of the page: an empty frame, its data and its script."""
    content = json.dumps(_content(comparison), allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return (
        '<h2>Explore</h2><noscript><p class="quiet">With JavaScript enabled, path, residuals and errors can be '
        "explored here; the text and figures below do not need it.</p></noscript>"
        '<div id="explorer" hidden></div>'
        f'<script type="application/json" id="explorer-data">{content}</script>'
        f"<script>{resource('explorer.js')}</script>"
    )


def script_hash() -> str:
    """Return the hash of the script, by which the page's content security policy admits it."""
    return f"sha256-{b64encode(sha256(resource('explorer.js').encode()).digest()).decode()}"


def failure_items(evaluation: ModelEvaluation, number: int) -> str:
    """Return a model's lacks of fit as a list; the script highlights each of them on path and residuals."""
    items = (
        f'<li data-look="{number},{i}">{escape(sentence(failure))}</li>'
        for i, failure in enumerate(evaluation.failures[:MOST])
    )
    return f"<ol>{''.join(items)}</ol>"


@dataclass(frozen=True, slots=True)
class _Stretch:
    """One segment, and the intervals (k,) of it that are drawn.

    number : index among the pieces of an evaluation
    reference : evaluation under the first model, the source of times, truth and odometry
    start : (k,) index of the first interval that each drawn point represents
    """

    number: int
    reference: Evaluation
    start: NDArray[np.int64]

    @property
    def times_s(self) -> Array:
        intervals = self.reference.problem.intervals
        return intervals.start_s[self.start]

    @property
    def truth_xyt(self) -> Array:
        return self.reference.problem.intervals.truth_xyt[self.start]


def _content(comparison: Comparison) -> dict[str, Any]:
    stretches = _stretches(comparison)
    lengths = sorted({h.distance_m for j in comparison.evaluations for h in j.horizons})
    with_runs = _RUN_STRETCHES // len(comparison.evaluations) or 1
    return {
        "lengths": lengths,
        "pieces": [_stretch(stretch, comparison) for stretch in stretches],
        "models": [_model(evaluation, stretches, with_runs) for evaluation in comparison.evaluations],
    }


def _stretches(comparison: Comparison) -> list[_Stretch]:
    """Return the longest segments, in descending order, each with as many points as fit in the page."""
    pieces = comparison.evaluations[0].pieces
    longest = sorted(range(len(pieces)), key=lambda i: -float(pieces[i].interval_metres.sum()))[:_MOST_PIECES]
    most = max(_POINTS // (len(longest) * (1 + len(comparison.evaluations))), 50)
    found = []
    for number in longest:
        count = len(pieces[number].problem.intervals)
        start = np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.int64))
        found.append(_Stretch(number, pieces[number], start))
    return found


def _stretch(stretch: _Stretch, comparison: Comparison) -> dict[str, Any]:
    """Return times, truth and odometry of a segment, with the odometry aligned to the truth at the first pose."""
    piece, start = stretch.reference, stretch.start
    motion = interval_motion(piece.problem)
    driven = np.concatenate(([0.0], np.cumsum(piece.interval_metres)[:-1]))
    linked = piece.problem.intervals.linked
    breaks = [i for i in range(1, len(start)) if not linked[start[i - 1] + 1 : start[i] + 1].all()]
    recorded = undo(piece.recording, piece.model.setup.effects).odometry
    return {
        "name": piece.recording.name if len(comparison.recordings) > 1 else f"from {stretch.times_s[0]:.0f} s",
        "length_m": round(float(piece.interval_metres.sum())),
        "t": _rounded(stretch.times_s, 2),
        "d": _rounded(driven[start], 2),
        "v": _rounded(motion.v[start], 3),
        "w": _rounded(motion.omega[start], 4),
        "gaps": breaks,
        "truth": _poses(stretch.truth_xyt),
        "measured": _poses(_in_truth(stretch, recorded.at(stretch.times_s, piece.recording.origin_ns))),
    }


def _in_truth(stretch: _Stretch, poses: Array) -> Array:
    """Return poses (k, 3) of an odometry, aligned with the truth at the first pose."""
    return compose(stretch.truth_xyt[0], between(poses[0], poses))


def _model(evaluation: ModelEvaluation, stretches: list[_Stretch], with_runs: int) -> dict[str, Any]:
    return {
        "name": evaluation.name,
        "pieces": [
            _under_model(evaluation.pieces[stretch.number], stretch, runs=i < with_runs)
            for i, stretch in enumerate(stretches)
        ],
        "horizons": [
            {
                "length": h.distance_m, "windows": h.windows, "measured": h.position_measured,
                "expected": h.position_expected, "nees": h.nees, "low": low, "high": high,
            }
            for h in evaluation.horizons if h.distance_m in HORIZONS_M
            for low, high in [rms_interval(h.position_measured, h.windows)]
        ],
        "failures": [_failure(failure, evaluation, stretches) for failure in evaluation.failures[:MOST]],
    }  # fmt: skip


def _under_model(piece: Evaluation, stretch: _Stretch, *, runs: bool) -> dict[str, Any]:
    """Return odometry without the model's effects, residuals summed along the drive, and runs of the model."""
    intervals, times_s = piece.problem.intervals, stretch.times_s
    left = piece.left.odometry.at(times_s, piece.recording.origin_ns)
    until = np.searchsorted(intervals.end_s, times_s + 1e-6)
    summed = np.concatenate((np.zeros((1, 3)), np.cumsum(intervals.residual, axis=0)))[until]
    count = 3 if piece.headed else 2
    size = np.sqrt(np.mean(piece.innovations.reshape(-1, 3)[:, :count] ** 2, axis=1))
    first = np.minimum(until, len(size) - 1)
    # of the intervals that a point represents, the one with the largest residual
    ends = np.append(first[1:], len(size))
    worst = [float(size[a : max(b, a + 1)].max()) for a, b in zip(first, ends, strict=True)]
    yaw = _rounded(np.degrees(summed[:, 2]), 3) if piece.headed else [None] * len(times_s)
    return {
        "corrected": _poses(_in_truth(stretch, left)),
        "residuals": [_rounded(summed[:, 0], 4), _rounded(summed[:, 1], 4), yaw, _rounded(np.array(worst), 2)],
        "runs": _runs(piece) if runs else [],
    }


def _runs(piece: Evaluation) -> list[list[list[float]]]:
    try:
        paths = replay(piece, runs=_RUNS)
    except EffectError:  # effects that contradict the odometry of this drive have no runs
        return []
    kept = np.unique(np.linspace(0, len(paths.truth_xyt) - 1, _RUN_POINTS).astype(np.int64))
    return [[_rounded(run[kept, 0], 3), _rounded(run[kept, 1], 3)] for run in paths.runs_xyt]


def _failure(failure: Failure, evaluation: ModelEvaluation, stretches: list[_Stretch]) -> dict[str, Any]:
    """Return the extent of a lack of fit: spans (segment, first point, last point), or the path length of a drift."""
    spans = []
    for i, stretch in enumerate(stretches):
        piece = evaluation.pieces[stretch.number]
        if failure.recording in ("", piece.recording.name):
            spans += [[i, a, b] for a, b in _spans(_holds(failure, piece, stretch))]
    length = float(failure.where.split()[1]) if failure.kind == "drift" else None
    place = [round(value, 3) for value in failure.place] if failure.place is not None else None
    return {"channel": CHANNELS.index(failure.channel), "spans": spans, "place": place, "length": length}


def _holds(failure: Failure, piece: Evaluation, stretch: _Stretch) -> NDArray[np.bool_]:
    """Return the points (k,) of a segment with a lack of fit; a drift accumulates everywhere and is at none of them."""
    intervals = piece.problem.intervals
    if failure.kind == "drift":
        return np.zeros(len(stretch.start), dtype=np.bool_)
    if failure.span_s is not None:
        inside = (intervals.end_s > failure.span_s[0]) & (intervals.start_s < failure.span_s[1])
    elif failure.place is not None:
        x, y, radius = failure.place
        inside = np.hypot(intervals.truth_xyt[:, 0] - x, intervals.truth_xyt[:, 1] - y) < radius
    else:
        masks = [p.mask > 0.0 for p in all_patterns(interval_motion(piece.problem)) if p.where == failure.where]
        inside = masks[0] if masks else np.zeros(len(intervals), dtype=np.bool_)
    # a point represents all intervals until the next one
    owner = np.searchsorted(stretch.times_s, intervals.start_s + 1e-6) - 1
    found = np.zeros(len(stretch.start), dtype=np.bool_)
    found[np.clip(owner[inside], 0, len(found) - 1)] = True
    return found


def _spans(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the first and last index of every run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], mask.astype(np.int8), [0]))))
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _poses(xyt: Array) -> dict[str, list[float]]:
    return {"x": _rounded(xyt[:, 0], 3), "y": _rounded(xyt[:, 1], 3), "yaw": _rounded(xyt[:, 2], 4)}


def _rounded(values: Array, places: int) -> list[float]:
    return np.round(values, places).tolist()
