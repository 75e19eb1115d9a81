"""Dependences of the residual on one regressor that no library effect explains, as curves and as terms.

A basis function of one or two coefficients has more power than a curve of eight, and can be in a model. The curve over
the regressor (speed, yaw rate, ...) is reported: the error per metre, radian turned, or second, as a few hat functions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.expression import CHANNELS
from odomcorrupt.study.estimate.drive_type import is_holonomic
from odomcorrupt.study.estimate.problem import by_column
from odomcorrupt.study.io.recording import shared_frame
from odomcorrupt.study.select.score import score_columns, score_terms
from odomcorrupt.study.terms.channels import MOVES
from odomcorrupt.study.terms.splines import curve_regressors

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from odomcorrupt.geometry.motion import Motion
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.estimate.intervals import Intervals
    from odomcorrupt.study.select.decisions import Decisions
    from odomcorrupt.study.select.score import ColumnScore, Score
    from odomcorrupt.study.terms.term import BasisTerm


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Dependence:
    """An error of one channel that depends on one regressor.

    per : unit of motion to which the error refers: "m" driven, "rad" turned, or "s"
    centres : (m,) values of the regressor, or (m, 2) places
    curve, curve_error : (m,) truth minus odometry per `per` at the centres (m/m, rad/m, rad/rad, rad/s), and its error
    p : probability of such a dependence for any regressor if there is none
    nats : gain in log likelihood minus the penalty
    term, score : the basis function with the largest gain and its action, and its score test
    instead_of : names of the included effects that it may replace; empty if none

    Equality is identity of objects.
    """

    channel: str
    regressor: str
    per: str
    centres: Array
    curve: Array
    curve_error: Array
    p: float
    nats: float
    term: BasisTerm
    score: Score
    instead_of: tuple[str, ...] = ()

    @property
    def expression(self) -> str:
        """An effect of that shape, for the user to edit."""
        return self.term.expression(self.score.estimate.tolist())

    @property
    def follows_acceleration(self) -> bool:
        """Whether the regressor is an acceleration, as it is for errors of clocks and of effects that resemble them."""
        return self.regressor.endswith("acceleration")

    @property
    def name(self) -> str:
        """Name of its effect in a model."""
        return self.term.name

    @property
    def title(self) -> str:
        """Channel and regressor, as in "yaw over speed"."""
        return f"{self.channel} over {self.regressor}"

    @property
    def wheels(self) -> str:
        """Wheels with the error if the term acts on wheels: "left", "right" or "wheels"; else ""."""
        return self.term.action.target if self.term.action.by_wheel else ""

    @property
    def wavelength_m(self) -> float | None:
        """Period of an error that is periodic over the travelled distance, m; else None."""
        return self.term.function.wavelength_m or None

    @property
    def place(self) -> str:
        """Location of the error in words, as in "within 2 m of (1.0, -0.5)"; "" if it is not confined to a place."""
        return self.term.function.place


def dependence_of(fit: Fit, term: BasisTerm, nats: float, decisions: Decisions) -> Dependence:
    """Return a basis function as a dependence, with the curve of its regressor and channel, scored beside a fit.

    fit : a model without the function
    nats : its gain minus its cost
    """
    (score,) = score_terms(fit, [term], decisions, family=1)
    found = Dependence(
        channel=term.action.channel,
        regressor=term.function.regressor,
        per=term.action.per,
        centres=np.zeros(1),
        curve=score.estimate[:1],
        curve_error=score.standard_error[:1],
        p=score.p,
        nats=nats,
        term=term,
        score=score,
    )
    if term.function.wavelength_m:  # hats are too wide to resolve a wave
        where = np.linspace(0.0, term.function.wavelength_m, 13)
        angle = 2.0 * np.pi * where / term.function.wavelength_m
        unit = np.stack((np.cos(angle), np.sin(angle)), axis=1)
        error = np.sqrt(unit**2 @ score.standard_error**2)
        return replace(found, centres=where, curve=unit @ score.estimate, curve_error=error)
    curve = _curve(fit, found)
    if curve is None:  # the regressor hardly varies: the function alone
        return found
    centres, own = curve
    return replace(found, centres=centres, curve=own.estimate, curve_error=own.standard_error)


def _curve(fit: Fit, found: Dependence) -> tuple[Array, ColumnScore] | None:
    """Return the centres of the hats that describe a dependence, and their joint score; None with fewer than two."""
    motions, recordings = fit.problem.motions, fit.problem.recordings
    amount = np.concatenate(
        [
            {"m": np.hypot(m.v, m.vy), "rad": MOVES["omega"](m), "s": np.ones(len(m))}[found.per] * m.dt_s
            for m in motions
        ]
    )
    regressors = curve_regressors(
        motions, placed=shared_frame(recordings) is not None, sideways=is_holonomic(recordings, motions)
    )
    if found.regressor not in regressors:
        return None
    regressor = regressors[found.regressor]
    hats = _hats(regressor, motions)
    used = np.array([np.abs(hat * amount).sum() > 0.01 * np.abs(amount).sum() for hat in hats])
    if used.sum() < 2:
        return None
    (score,) = score_columns(fit, [_columns_of(fit.problem.intervals, hats, used, -amount, found.channel)])
    return regressor(motions[0])[1][used], score


def _columns_of(intervals: Intervals, hats: Array, used: NDArray[np.bool_], amount: Array, channel: str) -> Array:
    """Return columns (K, 3, m) of errors of a channel: the used hats (k, n) of a regressor times a motion (n,)."""
    columns = []
    errors = np.zeros((len(amount), 3))
    for i in np.flatnonzero(used):
        errors[:, CHANNELS.index(channel)] = hats[i] * amount
        columns.append(intervals.column(errors))
    return by_column(np.stack(columns))


def _hats(regressor: Callable[[Motion], tuple[Array, Array]], motions: Sequence[Motion]) -> Array:
    """Return the values (k, n) of a regressor's hats on all motions; without a copy on a single one."""
    parts = [regressor(motion)[0].T for motion in motions]
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)
