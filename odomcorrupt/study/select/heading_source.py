"""Where the odometry's heading comes from: one answer for a robot, however many effects it has."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from odomcorrupt.effects.effect import choices
from odomcorrupt.study.select.shape_search import UNUSUAL_NATS

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.estimate.gauss_newton import Fit

__all__ = ["with_one_heading"]

_ALIKE_NATS = 1.0


def with_one_heading(fitted: Fit, given: set[str], again: Callable[[Sequence[Effect]], Fit]) -> Fit:
    """Return the fit whose effects agree on the source of the heading: the wheels, unless a gyro explains plainly more.

    One effect by itself may say "gyro" where two of the wheels' only make up for each other in the heading. Where a
    gyro's bias is believed there is a gyro, and it need not explain more: what wheels do to the heading and what a
    gyro's scale does may be one and the same.

    Parameters
    ----------
    fitted : the fit that may say both
    given : names of effects whose words a user has chosen
    again : fits other effects to the same recordings

    """
    open_to_both = [e for e in fitted.effects if "heading" in choices(e) and e.name not in given]
    words = {getattr(e, "heading", "") for e in open_to_both}
    biased = any(e.name == "gyro_bias" for e in fitted.effects)
    if not words or ("gyro" not in words and not biased):
        return fitted
    found: dict[str, Fit] = {}
    for word in ("wheels", "gyro"):
        said = [replace(e, heading=word) if e in open_to_both else e for e in fitted.effects]  # type: ignore[type-var]
        found[word] = fitted if words == {word} else again(said)
    price = -_ALIKE_NATS if biased else UNUSUAL_NATS
    better = found["gyro"].log_likelihood > found["wheels"].log_likelihood + price
    return found["gyro" if better else "wheels"]
