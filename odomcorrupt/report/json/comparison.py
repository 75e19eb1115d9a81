"""A comparison as JSON: schema 2, described in docs/json.md. Lengths in metres, angles in radians; unknown is null."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from odomcorrupt.report.json.numbers import finite, picked
from odomcorrupt.report.text.comparison import SIGNS, evaluation_sentence, sentence

if TYPE_CHECKING:
    from collections.abc import Iterable

    from odomcorrupt.study.validate.calibration import Horizon
    from odomcorrupt.study.validate.compare import Comparison, ModelEvaluation
    from odomcorrupt.study.validate.lack_of_fit import Failure
    from odomcorrupt.study.validate.trajectory_error import TrajectoryError

SCHEMA = 2


def comparison_json(comparison: Comparison) -> dict[str, Any]:
    """Return a comparison as plain values."""
    return finite(
        {
            "schema": SCHEMA,
            "signs": SIGNS,
            "recordings": list(comparison.recordings),
            "clocks": [
                {"recording": name, "offset_s": clock.offset_s, "skew": clock.rate}
                for name, clock in zip(comparison.recordings, comparison.clocks.clocks, strict=True)
            ],
            "raw_ten_second_error_m": comparison.raw_error_m,
            "aligned_ten_second_error_m": comparison.clock_error_m,
            "aligned_trajectory": _trajectory(comparison.clock_trajectory),
            "models": [_evaluation(j) for j in comparison.evaluations],
        }
    )


def _evaluation(j: ModelEvaluation) -> dict[str, Any]:
    return {
        "name": j.name,
        "held_out": j.judged_on,
        "ten_second_error_m": j.ten_second_error_m,
        "nats_per_m": j.nats.per_m,
        "nats_per_m_error": j.nats.error,
        "gain_over_first_nats_per_m": j.nats.gain_per_m,
        "gain_error": j.nats.gain_error,
        "blocks": j.nats.blocks,
        "verdict": {
            **picked(j.verdict, "rejected", "fails", "misfit", "level"),
            "checks": [{"question": test.question, "p": test.p} for test in j.verdict.checks],
            "threshold": j.verdict.threshold,
            "sentence": evaluation_sentence(j),
        },
        "horizons": [_horizon(h) for h in j.horizons],
        "pit": {
            name: {"p": pit.p, "inside_95": pit.inside, **picked(pit, "at", "difference", "low", "high")}
            for name, pit in j.pits.items()
        },
        "whiteness": {
            name: {"p": w.p, "ljung_box": w.statistic, "correlation": w.correlation}
            for name, w in j.whiteness.items()
        },
        "trajectory": _trajectory(j.trajectory),
        "fails": [_failure(f) for f in j.failures],
        "notes": list(j.notes),
    }  # fmt: skip


def _failure(f: Failure) -> dict[str, Any]:
    return {
        **picked(f, "kind", "channel", "where"),
        "unit": ("rad" if f.channel == "yaw" else "m") + (f"/{f.per}" if f.per else ""),
        **picked(f, "measured", "expected", "amount"),
        "p": math.exp(f.log_p),
        "log_p": f.log_p,
        "besides_the_ones_before": f.besides,
        "recording": f.recording or None,
        "span_s": None if f.span_s is None else list(f.span_s),
        "place": None if f.place is None else dict(zip(("x_m", "y_m", "radius_m"), f.place, strict=True)),
        "sentence": sentence(f),
    }


def _horizon(h: Horizon) -> dict[str, Any]:
    return {
        "distance_m": h.distance_m,
        "windows": h.windows,
        "measured": _channels(h.measured),
        "expected": _channels(h.expected),
        "bias": _channels(h.bias),
        "excess_p": _by_name(h.excess_p),
        "position_measured_m": h.position_measured,
        "position_expected_m": h.position_expected,
        "nees_per_dof": h.nees,
        "nees_95": h.nees_bounds,
        "nees_p": h.nees_p,
        "coverage_50": _by_name(h.coverage_50),
        "coverage_90": _by_name(h.coverage_90),
        "crps": _channels(h.crps),
    }


def _trajectory(e: TrajectoryError) -> dict[str, Any]:
    return {
        "ate_rmse_m": e.ate_m,
        "ate_origin_rmse_m": e.ate_origin_m,
        "rpe_1m_rmse_m": e.rpe_m,
        "rpe_1m_rmse_rad": e.rpe_rad,
    }


def _channels(values: Iterable[float]) -> dict[str, float]:
    return dict(zip(("along_m", "across_m", "yaw_rad"), values, strict=True))


def _by_name(values: Iterable[float]) -> dict[str, float]:
    return dict(zip(("along", "across", "yaw"), values, strict=True))
