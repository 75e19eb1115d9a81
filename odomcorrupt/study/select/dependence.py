"""Dependences of the residual on one regressor that no library effect explains, as curves and as terms.

A basis function of one or two coefficients has more power than a curve of eight, and can be in a model. The curve over
the regressor (speed, yaw rate, ...) is reported: the error per metre, radian turned, or second, as a few hat functions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.expression import CHANNELS
from odomcorrupt.study.estimate.drive_type import is_holonomic
from odomcorrupt.study.estimate.problem import by_column
from odomcorrupt.study.io.recording import shared_frame
from odomcorrupt.study.select.candidates import score_terms
from odomcorrupt.study.select.score import project_out
from odomcorrupt.study.terms.channels import MOVES
from odomcorrupt.study.terms.splines import curve_regressors

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.dictionary import Dictionary
    from odomcorrupt.study.select.score import Score
    from odomcorrupt.study.terms.term import BasisTerm

_LEAST = 0.01
"""Fraction of the motion that a hat function of a curve has to cover."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Dependence:
    """An error of one channel that depends on one regressor.

    centres : (m,) values of the regressor, or (m, 2) places
    curve, curve_error : (m,) truth minus odometry per `per` at the centres (m/m, rad/m, rad/rad, rad/s), and its error
    nats : gain in log likelihood minus the penalty
    term, score : the basis function with the largest gain and its action, and its score test
    instead_of : names of the included effects that it may replace; empty if none

    Equality is identity of objects.
    """

    centres: Array
    curve: Array
    curve_error: Array
    nats: float
    term: BasisTerm
    score: Score
    instead_of: tuple[str, ...] = ()

    @property
    def channel(self) -> str:
        """Channel of the error."""
        return self.term.action.channel

    @property
    def regressor(self) -> str:
        """Regressor that the error depends on."""
        return self.term.function.regressor

    @property
    def per(self) -> str:
        """Unit of motion to which the error refers: "m" driven, "rad" turned, or "s"."""
        return self.term.action.per

    @property
    def expression(self) -> str:
        """An effect of that shape, for the user to edit."""
        return self.term.expression(self.score.estimate.tolist())

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
    def place(self) -> str:
        """Location of the error in words, as in "within 2 m of (1.0, -0.5)"; "" if it is not confined to a place."""
        return self.term.function.place


def dependence_of(fit: Fit, term: BasisTerm, nats: float, dictionary: Dictionary) -> Dependence:
    """Return a basis function as a dependence, with the curve of its regressor and channel, scored beside a fit.

    fit : a model without the function
    nats : its gain minus its cost
    """
    (score,) = score_terms(fit, [term], dictionary)
    one = np.zeros(1), score.estimate[:1], score.standard_error[:1]
    centres, values, errors = _curve(fit, term, score.inflation) or one
    return Dependence(centres=centres, curve=values, curve_error=errors, nats=nats, term=term, score=score)


def _curve(fit: Fit, term: BasisTerm, inflation: float) -> tuple[Array, Array, Array] | None:
    """Return centres, coefficients and errors of the hats that describe a dependence; None with fewer than two."""
    motions, recordings = fit.problem.motions, fit.problem.recordings
    amount = np.concatenate(
        [
            {"m": np.hypot(m.v, m.vy), "rad": MOVES["omega"](m), "s": np.ones(len(m))}[term.action.per] * m.dt_s
            for m in motions
        ]
    )
    regressors = curve_regressors(
        motions, placed=shared_frame(recordings) is not None, sideways=is_holonomic(recordings, motions)
    )
    if term.function.regressor not in regressors:
        return None
    regressor = regressors[term.function.regressor]
    parts = [regressor(motion) for motion in motions]
    hats = np.concatenate([values for values, _ in parts])
    used = np.abs(hats * amount[:, None]).sum(axis=0) > _LEAST * np.abs(amount).sum()
    if used.sum() < 2:
        return None
    unit = np.eye(3)[CHANNELS.index(term.action.channel)]
    columns = [fit.problem.intervals.column(np.outer(-hat * amount, unit)) for hat in hats.T[used]]
    rest = project_out(fit)
    white = rest.of(fit.noise.whitener.whiten(by_column(np.stack(columns))))
    covariance = np.linalg.pinv(white.T @ white, hermitian=True)
    errors = np.sqrt(np.diag(covariance) * inflation)
    return parts[0][1][used], covariance @ (white.T @ rest.residual), errors
