"""Result of a fit as plain text."""

from __future__ import annotations

from math import degrees
from typing import TYPE_CHECKING

from odomcorrupt.report.text.numbers import clock_lines, effects_with_errors, numbers_text, words_text
from odomcorrupt.study.estimate.outliers import Event, events

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from odomcorrupt.study.estimate.calibrate import RobotFit
    from odomcorrupt.study.estimate.confidence_intervals import Interval

__all__ = ["fit_text", "laws_table"]

_MOST_EVENTS = 8


def fit_text(result: RobotFit, *, clocks: bool = True) -> str:
    """Return the result of a fit; without clocks if these are reported separately."""
    truth = result.fit.noise.truth
    names = [r.name for r in result.fit.problem.recordings]
    lines = [f"law {result.fit.problem.approach.law_name}, coefficients with 95 % intervals:"]
    lines += [_interval_line(result, interval) for interval in result.intervals]
    lines += [
        f"  {effect.name}{words_text(effect)}: {', '.join(numbers_text(effect, errors))}"
        for effect, errors in effects_with_errors(result.fit)
    ]
    lines += clock_lines(names, result.clocks) if clocks else []
    wander = f", wandering {truth.random_walk * 1e3:.2g} mm per sqrt(s)" if truth.random_walk else ""
    heading = f"{degrees(truth.yaw_rad):.2g} deg" if result.fit.problem.headings else "no headings"
    lines.append(f"the truth's own noise: {truth.xy_m * 1e3:.2g} mm, {heading}{wander}")
    lines += _event_lines(events(result.fit))
    lines.append(f"position error after 10 s on the fitted data: {result.ten_second_error_m * 1e3:.1f} mm")
    return "\n".join(lines)


def _interval_line(result: RobotFit, interval: Interval) -> str:
    name, value = interval.name, interval.value
    scale, unit = (degrees(1.0), "deg") if name.startswith("rot_") else (1e3, "mm")
    ends = f"[{interval.low:.2g}, {interval.high:.2g}]"
    if not interval.identifiable:
        return f"  {name:<13}{'-':<10} {ends:<22}  not identifiable from this drive"
    human = "as the law has it"
    if result.fit.problem.approach.law_name == "diffusion":
        human = f"= {value * scale:.3g} {unit} after one {'metre' if name.endswith('_trans') else 'radian'}"
    return f"  {name:<13}{value:<10.4g} {ends:<22}  {human}"


def _event_lines(found: Sequence[Event]) -> list[str]:
    """Return the downweighted segments, the largest first, with the time since the recording's first odometry."""
    if not found:
        return []
    total = sum(event.end_s - event.start_s for event in found)
    lines = [f"{len(found)} stretches ({total:.1f} s) are outliers with reduced weight; the largest:"]
    largest = sorted(found, key=lambda e: abs(e.along_m) + abs(e.yaw_rad), reverse=True)[:_MOST_EVENTS]
    lines += [
        f"  {e.recording} {e.start_s:8.1f} to {e.end_s:.1f} s: odometry {e.along_m * 1e3:+.0f} mm ahead of the truth, "
        f"{degrees(e.yaw_rad):+.2f} deg"
        for e in sorted(largest, key=lambda e: (e.recording, e.start_s))
    ]
    return lines


def laws_table(results: Mapping[str, RobotFit]) -> str:
    """Return all laws side by side, the likeliest first; each coefficient costs half the logarithm of the data."""
    best = next(iter(results.values())).information_nats
    lines = [f"{'law':<12}{'nats behind the best':>22}{'coefficients':>14}   depends on the step"]
    for name, result in results.items():
        behind = best - result.information_nats
        step = "yes" if result.fit.problem.approach.law.per_step else "no"
        lines.append(f"{name:<12}{behind:>22.1f}{len(result.fit.components.active):>14}   {step}")
    return "\n".join(lines)
