"""A motion model: a noise law with its coefficients, and the systematic effects of one robot."""

from __future__ import annotations

import math
import re
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING

from odomcorrupt.errors import ModelError
from odomcorrupt.model.correlation import Correlation
from odomcorrupt.model.noise_laws import Coefficients, law_named

if TYPE_CHECKING:
    from collections.abc import Mapping

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.model.noise_laws import Law

_QUANTITY = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(deg|rad)?\s*(/\s*(?:m|rad))?\s*\Z")


_NUMBER = r"[\d.eE+-]+"
UPDATE_MIN_D_M, UPDATE_MIN_A_RAD = 0.25, 0.2
"""Defaults of nav2's amcl, for a step given by a distance or an angle only."""


def parse_alpha(text: str) -> float:
    """Return a coefficient from text such as "0.05", "5deg" (after one radian) or "10deg/m" (after one metre)."""
    match = _QUANTITY.match(text)
    if match is None:
        raise ModelError(f"coefficient: {text!r}; write a number, or an angle as in 5deg or 10deg/m")
    value = float(match[1])
    return math.radians(value) if match[2] == "deg" else value


_SHORTEST_STEP = 1e-3
"""Metres and radians: below the resolution of odometry, and the time that a law takes grows with its steps."""


@dataclass(frozen=True, slots=True)
class Step:
    """Length of path over which a per-step law is applied: it ends at a distance or an angle, whichever comes first."""

    distance_m: float
    angle_rad: float

    def __post_init__(self) -> None:
        if not (self.distance_m >= _SHORTEST_STEP and self.angle_rad >= _SHORTEST_STEP):
            raise ModelError(f"step: {self}; both its distance and its angle must be {_SHORTEST_STEP:g} or more")

    def __str__(self) -> str:
        return f"{self.distance_m:g}m,{self.angle_rad:g}rad"

    @classmethod
    def parse(cls, text: str) -> Step | None:
        """Return the step written as "0.25m,0.2rad" (deg is accepted), or None for "message".

        If only one of the two is given, the other is nav2's default: update_min_d 0.25 m, update_min_a 0.2 rad.
        """
        if text == "message":
            return None
        match = re.fullmatch(rf"\s*(?:({_NUMBER})\s*m)?\s*(,)?\s*(?:({_NUMBER})\s*(rad|deg))?\s*", text)
        if match is None or bool(match[1] and match[3]) != bool(match[2]) or not (match[1] or match[3]):
            raise ModelError(f"step: {text!r}; write message, or a distance and an angle as in 0.25m,0.2rad")
        distance_m = parse_alpha(match[1]) if match[1] else UPDATE_MIN_D_M
        return cls(distance_m, parse_alpha(match[3] + match[4]) if match[3] else UPDATE_MIN_A_RAD)


@dataclass(frozen=True, slots=True)
class Noise:
    """A noise law with its coefficients and, for per-step laws, the step of its application (None: each message)."""

    law_name: str
    coefficients: Coefficients
    step: Step | None = None

    def __post_init__(self) -> None:
        if not self.law.per_step and self.step is not None:
            raise ModelError(f"step: {self.step}; the law {self.law_name} is the same at every step: leave --step out")

    @property
    def law(self) -> Law:
        """The noise law."""
        return law_named(self.law_name)

    @property
    def law_per_message(self) -> bool:
        """Whether the law acts once per message."""
        acts = any(getattr(self.coefficients, name) for name in self.law.alphas)
        return self.law.per_step and self.step is None and acts

    @property
    def per_message(self) -> bool:
        """Whether the law or white noise acts once per message, so that the drift depends on the message rate."""
        return self.law_per_message or self.coefficients.white_v > 0.0 or self.coefficients.white_omega > 0.0

    @property
    def numbers(self) -> list[tuple[str, float]]:
        """Names and values of the first four coefficients, and of others that are not zero."""
        values = asdict(self.coefficients)
        return [(name, value) for i, (name, value) in enumerate(values.items()) if i < 4 or value]

    @property
    def words(self) -> str:
        """The law and its coefficients, with their alpha convention."""
        numbers = ", ".join(f"{name} {value:.4g}" for name, value in self.numbers)
        step = f", once per {self.step}" if self.step is not None else ""
        return f"law {self.law_name} ({self.law.meaning}{step}): {numbers}"


@dataclass(frozen=True, slots=True)
class TruthNoise:
    """Noise of the truth: white per sample (m, rad), and random walk (m per sqrt(s))."""

    xy_m: float = 0.003
    yaw_rad: float = 0.003
    random_walk: float = 0.0


@dataclass(frozen=True, slots=True)
class Origin:
    """Geodetic origin of the frame of satellite fixes; there x points east and y north."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float = 0.0

    def __post_init__(self) -> None:
        if not (abs(self.latitude_deg) <= 90.0 and abs(self.longitude_deg) <= 360.0 and abs(self.altitude_m) < 1e6):
            raise ModelError(f"origin: {self}; write latitude and longitude in degrees and the height in metres")

    def __str__(self) -> str:
        return f"latitude {self.latitude_deg:.7f}, longitude {self.longitude_deg:.7f}"


@dataclass(frozen=True, slots=True)
class Setup:
    """Properties of the measurement and not of the robot; corruption and correction ignore them.

    effects : lever arm and mounting yaw of the truth
    drive_type : steering of the robot's wheels, see `drive_types`; "" if not given
    clocks : by recording, offset (s) and rate of the odometry's clock; informative only, every run has its own
    origin : geodetic origin of the truth's frame, for satellite fixes; places of effects are metres east and north
    pose_corrections : whether a filter steps towards poses that it is given; the model is of the odometry between these
        steps, and correction takes them out
    """

    effects: tuple[Effect, ...] = ()
    truth: TruthNoise | None = None
    clocks: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    origin: Origin | None = None
    drive_type: str = ""
    pose_corrections: bool = False


@dataclass(frozen=True, slots=True)
class MotionModel:
    """Noise and effects of one robot.

    standard_errors : by "effect.parameter" or name of a coefficient, one standard error, if the model was fitted
    correlation : correlations of these errors, for the parameters that it names
    source : origin of the values: "recordings" lists the fitted files, "fitted" what identifies their content,
        "odometry" is their topic, "frame" the frame of their truth if it is that of one run only
    """

    noise: Noise
    effects: tuple[Effect, ...] = ()
    track_m: float | None = None
    setup: Setup = field(default_factory=Setup)
    standard_errors: Mapping[str, float] = field(default_factory=dict)
    source: Mapping[str, str | float | list[str]] = field(default_factory=dict)
    correlation: Correlation = field(default_factory=Correlation)

    @property
    def odometry_topic(self) -> str | None:
        """Topic of the odometry that the model was learned from, if recorded."""
        topic = self.source.get("odometry")
        return topic if isinstance(topic, str) else None

    @property
    def placed(self) -> tuple[Effect, ...]:
        """Effects that depend on places or headings in the frame of the truth that the model was learned from."""
        learned = bool(self.source.get("recordings"))
        return tuple(effect for effect in self.effects if learned and effect.reads_places and effect.acts)

    def in_frame(self, frame: str) -> MotionModel:
        """Return the model without learned effects of places if they were learned in another frame of a truth."""
        if self.source.get("frame", "") == frame or not self.placed:
            return self
        return replace(self, effects=tuple(effect for effect in self.effects if effect not in self.placed))

    @property
    def identity(self) -> MotionModel:
        """Model without noise and effects, of the odometry that this one was learned from."""
        return replace(NOISE_FREE, source=self.source)


NOISE_FREE = MotionModel(Noise("diffusion", Coefficients(0.0, 0.0, 0.0, 0.0)))
"""Model without noise and effects."""
