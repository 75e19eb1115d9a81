"""Predefined models with their numbers, honest ranges and sources: robots by name, qualities, and noise alone.

Geometry is that of data sheets and drivers. Noise and ranges are, where nothing else is stated, those that `learn`
found on recordings of other robots of the same kind (docs/real_robots.md): no recording of the named robot itself was
available. A range is one standard deviation of what robots of the kind differ by; `batch` draws a robot for each run.
`benchmarks/fit_presets.py` refits the noise of the recorded robots.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from typing import TYPE_CHECKING

from odomcorrupt.errors import ModelError
from odomcorrupt.model.motion_model import MotionModel, Noise, Setup
from odomcorrupt.model.noise_laws import Coefficients

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

DEFAULT = "typical"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Preset:
    """A named model and its source.

    spread : standard deviations among robots, by "effect.parameter" or name of a coefficient; the effects have no bias
    track_m, drive_type : of the robot, if it is one
    marks : parts of names of topics, types and frames that give the robot away
    """

    name: str
    noise: Noise
    source: str
    spread: Mapping[str, float] = field(default_factory=dict)
    track_m: float | None = None
    drive_type: str = ""
    marks: tuple[str, ...] = ()

    @property
    def model(self) -> MotionModel:
        """The model: noise, and effects of zero whose spread `batch` draws."""
        from odomcorrupt.effects import effect_from_values  # noqa: PLC0415 - noise alone needs no effect

        names = (key.partition(".") for key in self.spread)
        effects = tuple(effect_from_values(name, {parameter: 0.0}) for name, dot, parameter in names if dot)
        return MotionModel(
            self.noise, effects, self.track_m, Setup(drive_type=self.drive_type), dict(self.spread),
            {"preset": self.name, "from": self.source},
        )  # fmt: skip


_KINDS = {
    "differential": (
        (0.0037, 0.0036, 0.0022, 0.0005, 0.0014),
        {"wheelbase.e": 0.01, "wheel_scale.e": 0.005, "unequal_wheels.curvature": 0.003},
        "learned on a differential drive under motion capture (OptiOdom): 1 % of the track, 0.2 % of the radius",
    ),
    "skid": (
        (0.03, 0.0036, 0.0022, 0.005, 0.005), {"wheelbase.e": 0.05, "wheel_scale.e": 0.01, "icr_shift.x": 0.02},
        "range of the effective track: ROSbot's driver has 1.30 and 1.36; other ranges, noise of turns: our judgement",
    ),
    "car": (
        (0.01, 0.0097, 0.0059, 0.0032, 0.002),
        {"steering_offset.curvature": 0.05, "steering_scale.e": 0.04, "wheel_scale.e": 0.01},
        "learned on a tricycle under motion capture (OptiOdom), which bends by 7 deg/m and turns 4 % wide",
    ),
    "omni": (
        (0.068, 0.0, 0.012, 0.034, 0.0078), {"wheel_scale.e": 0.05, "sideways_scale.e": 0.05, "wheelbase.e": 0.05},
        "noise learned on a mecanum base (Politecnico di Milano); ranges: 1.05 and 0.95 in ROSbot XL's driver",
    ),
}  # fmt: skip
"""By kind of drive: coefficients of the law diffusion, standard deviations of the effects, and their source."""


def _robot(
    name: str, kind: str, track_m: float | None, source: str, marks: tuple[str, ...] = (), factor: float = 1.0
) -> Preset:
    """Return a robot with a multiple of the noise and the ranges of its kind.

    Noise varies by 40 % among robots, about as much as from drive to drive. Numbers have the digits of a model file.
    """
    numbers, ranges, learned = _KINDS[kind]
    noise = Coefficients(*(float(f"{factor * value:.6g}") for value in numbers))
    varies = {f.name: 0.4 * value for f in fields(noise) if (value := getattr(noise, f.name))}
    spread = {
        key: float(f"{value:.3g}") for key, value in ({k: factor * v for k, v in ranges.items()} | varies).items()
    }
    return Preset(name, Noise("diffusion", noise), f"{source}; {learned}", spread, track_m, kind, marks)


PRESETS: Mapping[str, Preset] = {
    preset.name: preset
    for preset in (
        Preset(
            DEFAULT,
            Noise("diffusion", Coefficients(0.05, 0.02, 0.05, 0.01)),
            "our judgement of an indoor wheeled robot: about 3.6 deg of heading and 0.16 m along after 10 m straight",
        ),
        _robot("turtlebot3-burger", "differential", 0.160, "track 0.160 m (ROBOTIS e-Manual)",
               ("turtlebot3", "tb3", "sensor_state")),
        _robot("turtlebot3-waffle", "differential", 0.287, "track 0.287 m (ROBOTIS e-Manual)", ("waffle",)),
        _robot("turtlebot4", "differential", 0.233, "iRobot Create 3: track 0.233 m (create3_sim, control.yaml)",
               ("irobot_create", "turtlebot4", "create3", "hazard_detection", "ir_intensity")),
        _robot("husky", "skid", 1.070, "Clearpath Husky A200: track 0.5708 m times 1.875 (its driver)",
               ("husky",)),
        _robot("jackal", "skid", 0.563, "Clearpath Jackal: track 0.37559 m times 1.5 (its driver)",
               ("jackal",)),
        _robot("rosbot", "skid", 0.253, "Husarion ROSbot: track 0.186 m times 1.36 (its driver)",
               ("rosbot",)),
        _robot("mecanum", "omni", None, "a mecanum base", ("mecanum",)),
        _robot("ackermann", "car", None, "a car", ("ackermann", "vesc")),
        Preset(
            "tracked",
            Noise("diffusion", Coefficients(0.05, 0.0032, 0.005, 0.01, 0.005)),
            "a tracked robot: 0.42 m after 40.5 m with learned centres of rotation (Pentzer et al. 2014, J. Field "
            "Robotics); its ranges are our judgement",
            {"wheelbase.e": 0.1, "wheel_scale.e": 0.03, "icr_shift.x": 0.05}, None, "skid", ("tracked", "flipper"),
        ),
        _robot("good", "differential", None, "a good differential drive"),
        _robot("worn", "differential", None, "3 times the noise and range of a good differential drive", factor=3.0),
        _robot("bad", "differential", None, "8 times the noise and range of a good differential drive", factor=8.0),
        Preset(
            "article",
            Noise("linear", Coefficients(0.05, math.radians(10.0), 0.05, 0.01)),
            "Adding noise to odometry data published by the Gazebo simulator (2018); per message",
        ),
        Preset(
            "optitrack-diff-drive",
            Noise("diffusion", Coefficients(0.0084, 0.0068, 0.0023, 0.00089, 0.0015)),
            "fitted to seven runs of a small differential drive under OptiTrack (OptiOdom, Sousa et al. 2022)",
        ),
        Preset(
            "optitrack-tricycle",
            Noise("diffusion", Coefficients(0.026, 0.028, 0.0063, 0.003, 0.0021)),
            "fitted to two runs of a tricycle under OptiTrack (OptiOdom, Sousa et al. 2022)",
        ),
        Preset(
            "mrclam-create",
            Noise("diffusion", Coefficients(0.094, 0.023, 0.014, 0.026, 0.0045)),
            "fitted to three runs of iRobot Creates; odometry is their commands (UTIAS MRCLAM 6, Leung et al. 2011)",
        ),
    )
}  # fmt: skip


def preset_named(name: str) -> Preset:
    """Return the preset with a given name; a ModelError lists the available names."""
    if name not in PRESETS:
        near = [f"did you mean {one}? " for one in get_close_matches(name.lower(), PRESETS, 1, 0.51)]
        raise ModelError(f"no preset is called {name!r}; {''.join(near)}there are {', '.join(PRESETS)}")
    return PRESETS[name]


def suggested(names: Iterable[str]) -> str:
    """Return the preset of the robot that names of topics, types and frames give away; "" for none or several."""
    text = "\n".join(names).lower()
    found = [preset.name for preset in PRESETS.values() if any(mark in text for mark in preset.marks)]
    # a waffle is a TurtleBot3 as well
    return found[-1] if len({name.partition("-")[0] for name in found}) == 1 else ""
