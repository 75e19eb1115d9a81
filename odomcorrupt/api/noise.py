"""Noise of a motion model, in the notation of its source, and its conversion from one law to another."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from odomcorrupt.api.result import Result
from odomcorrupt.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.model import motion_model
    from odomcorrupt.model.noise_laws import Law
    from odomcorrupt.summary import Summary


@dataclass(frozen=True, slots=True, kw_only=True)
class Noise:
    """Noise of a motion model, in the notation of its source.

    Alphas of different laws are not interchangeable: under `diffusion` each is the standard deviation after one metre
    or one radian, under `linear` (MRPT) that of one step over its motion, under `quadratic` (nav2's amcl) the variance
    over the squared motion.

    Parameters
    ----------
    alpha : sequence of float or str
        rot_rot, rot_trans, trans_trans, trans_rot (alpha1 to alpha4), and further ones if the law has more; metres and
        radians. Strings may be angles: "5deg" (after one radian) or "10deg/m" (after one metre).
    law : str
        diffusion, linear, quadratic, velocity or omni.
    step : str, optional
        Step of path to which a stepwise law is applied, as in "0.25m,0.2rad"; by default once per message.
    twist_noise : (float, float), optional
        White noise on every twist, m/s and rad/s.

    Raises
    ------
    ModelError
        If there is no such law, or a number is invalid in it.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> oc.Noise(alpha=(0.05, "2deg/m", 0.05, 0.01)).law
    'diffusion'
    """

    alpha: Sequence[float | str] = (0.0, 0.0, 0.0, 0.0)
    law: str = "diffusion"
    step: str | None = None
    twist_noise: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        self.as_motion_noise()

    def as_motion_noise(self) -> motion_model.Noise:
        """Return the law, its coefficients in radians and metres, and the step of its application.

        Raises
        ------
        ModelError
            If there is no such law, or a number is invalid in it.
        """
        from odomcorrupt.model import motion_model
        from odomcorrupt.model.noise_laws import law_named

        law = law_named(self.law)
        names = law.alphas + ("",) * len(self.alpha)
        values = [_coefficient(value, name, law) for value, name in zip(self.alpha, names, strict=False)]
        coefficients = law.coefficients(values)
        if self.twist_noise is not None:
            white_v, white_omega = self.twist_noise
            coefficients = replace(coefficients, white_v=white_v, white_omega=white_omega)
        step = None if self.step is None else motion_model.Step.parse(self.step)
        return motion_model.Noise(law.name, coefficients, step)


def _coefficient(value: float | str, name: str, law: Law) -> float:
    """Return a coefficient; angles are valid for coefficients of rotation only, per the metre or radian they state."""
    from odomcorrupt.model.motion_model import parse_alpha

    if not isinstance(value, str):
        return float(value)
    number = parse_alpha(value)
    unit = next((unit for unit in ("deg", "rad") if unit in value.split("/", maxsplit=1)[0]), None)
    after = value.partition("/")[2]
    cause = "m" if name.endswith("_trans") else "rad"
    if unit is not None and law.degree == 1:
        raise ModelError(f"{name}: {value}; alphas of the law {law.name} scale variances, write them without a unit")
    if unit is not None and name and not name.startswith("rot_"):
        raise ModelError(f"{name}: {value} is an angle, but this coefficient is in metres; write a number")
    if after and name and after != cause:
        raise ModelError(f"{name}: {value}; this coefficient is per {cause}, not per {after}")
    return number


@dataclass(frozen=True, slots=True, repr=False)
class Conversion(Result):
    """Noise of one law, and that of another law with the same drift on straight drives and on turns.

    before, after : noise as given, and as converted
    """

    before: motion_model.Noise
    after: motion_model.Noise

    def summary(self) -> Summary:
        """Return the coefficients of the other law, the drift of both, and how to use them."""
        from odomcorrupt.sampling.convert import conversion_brief

        return conversion_brief(self.before, self.after)

    def details(self) -> str:
        """Return both laws in words, their drift, and the options that select the other law."""
        from odomcorrupt.sampling.convert import conversion_text

        return conversion_text(self.before, self.after)

    def to_dict(self) -> dict[str, Any]:
        """Return both laws, and the growth of the variances per metre and per radian."""
        from odomcorrupt.sampling.convert import conversion_json

        return conversion_json(self.before, self.after)

    def rows(self) -> list[dict[str, Any]]:
        """Return law, step and coefficients: one row before, one after."""
        values = self.to_dict()
        sides = (values["from"], values["to"])
        return [{"law": side["law"], "step": side["step"], **side["coefficients"]} for side in sides]


def convert_alpha(noise: Noise, law: str, *, step: str | None = None) -> Conversion:
    """Return the alphas of another law with which the odometry drifts the same, straight on and in turns.

    Parameters
    ----------
    noise : Noise
        Alphas, their law and, if it is applied once per step, its step.
    law : str
        Law to convert to.
    step : str, optional
        Step of the other law, as in "0.25m,0.2rad", if it is applied once per step; by default that of `noise`.

    Returns
    -------
    Conversion
        `after` has the coefficients.

    Raises
    ------
    ModelError
        If there is no such law, a step is missing, or the other law cannot give this drift.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> amcl = oc.Noise(alpha=(0.2, 0.2, 0.2, 0.2), law="quadratic", step="0.25m")
    >>> round(oc.convert_alpha(amcl, "diffusion").after.coefficients.trans_trans, 4)
    0.2236
    """
    from odomcorrupt.model.motion_model import Step
    from odomcorrupt.model.noise_laws import law_named
    from odomcorrupt.sampling.convert import convert

    before, other = noise.as_motion_noise(), law_named(law)
    wanted = noise.step if step is None else step
    per_step = Step.parse(wanted) if other.per_step and wanted is not None else None
    return Conversion(before, convert(before, other, per_step))
