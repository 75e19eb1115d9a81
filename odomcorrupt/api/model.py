"""A motion model with its file, its noise, other programs' coefficients, and its numbers as parameters of others."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from odomcorrupt.api.result import Result
from odomcorrupt.corruption.inverse import SystematicEffects
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.corruption.summary import model_brief, model_words
from odomcorrupt.effects.effect import Effect, parameters
from odomcorrupt.errors import ModelError
from odomcorrupt.model import motion_model
from odomcorrupt.model.model_file import format_model, parse_effect, read_model
from odomcorrupt.model.motion_model import MotionModel, Step, parse_alpha
from odomcorrupt.model.noise_laws import law_named
from odomcorrupt.model.presets import PRESETS, preset_named
from odomcorrupt.result_files import write_new
from odomcorrupt.sampling.convert import convert, drift_of, drift_words, flags_of
from odomcorrupt.summary import Line, Summary, command_line

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from odomcorrupt.export import Snippet, Turn
    from odomcorrupt.model.noise_laws import Law

    EffectsLike = str | Effect | Sequence[str | Effect]


@dataclass(frozen=True, slots=True, kw_only=True)
class Noise:
    """Noise of a motion model, in the notation of its source.

    Alphas of different laws are not interchangeable: under `diffusion` each is the standard deviation after one metre
    or one radian, under `linear` (MRPT) that of one step over its motion, under `quadratic` (nav2's amcl) the variance
    over the squared motion.

    alpha : rot_rot, rot_trans, trans_trans, trans_rot (alpha1 to alpha4), and further ones if the law has more; metres
        and radians. Strings may be angles: "5deg" (after one radian) or "10deg/m" (after one metre)
    law : diffusion, linear, quadratic, velocity or omni
    step : step of path to which a stepwise law is applied, as in "0.25m,0.2rad"; by default once per message
    twist_noise : (float, float) white noise on every twist, m/s and rad/s

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
        straight, turn = drift_words(self.after)
        new, old = (f"{model_brief(MotionModel(one), '')}; {one.law.meaning}" for one in (self.after, self.before))
        lines = [Line("CONVERTED", new, "good", full=self.after.words), Line("from", old, full=self.before.words)]
        lines.append(Line("10 m", f"{straight} (1 sigma, both laws)"))
        lines.append(Line("360 deg", f"on the spot: {turn} (1 sigma, both laws)"))
        return Summary((*lines, command_line(f"odomcorrupt in.bag out.bag {flags_of(self.after)}")))

    def _values(self) -> dict[str, Any]:
        before, after = (
            {"law": noise.law_name, "step": noise.step and str(noise.step), "coefficients": asdict(noise.coefficients)}
            for noise in (self.before, self.after)
        )
        return {"from": before, "to": after, "variance_growth": asdict(drift_of(self.after))}

    def rows(self) -> list[dict[str, Any]]:
        """Return law, step and coefficients: one row before, one after."""
        values = self._values()
        return [side | side.pop("coefficients") for side in (values["from"], values["to"])]


def convert_alpha(noise: Noise, law: str, *, step: str | None = None) -> Conversion:
    """Return the alphas of another law with which the odometry drifts the same, straight on and in turns.

    noise : alphas, their law and, if it is applied once per step, its step
    law : law to convert to
    step : step of the other law, as in "0.25m,0.2rad", if it is applied once per step; by default that of `noise`

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
    before, other = noise.as_motion_noise(), law_named(law)
    wanted = noise.step if step is None else step
    per_step = Step.parse(wanted) if other.per_step and wanted is not None else None
    return Conversion(before, convert(before, other, per_step))


class Model:
    """A robot's motion model: noise, systematic effects, and the measurement set-up estimated by a fit.

    Parameters
    ----------
    noise : Noise, optional
        None for no noise at all.
    effects : str, Effect, or sequence of these
        Systematic errors, as in "unequal_wheels:curvature=0.005" or "wheelbase:e=1%"; a name alone gets its typical
        size.
    track_m : float, optional
        Nominal distance between the wheels, metres; effects of single wheels need it.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> oc.Model(oc.Noise(alpha=(0.05, 0.02, 0.05, 0.01)), effects=["wheelbase:e=1%"])
    <Model: law diffusion, rot_rot 0.05 rot_trans 0.02 trans_trans 0.05 trans_rot 0.01; effects wheelbase (e 0.01)>
    """

    __slots__ = ("motion_model", "origin")

    motion_model: MotionModel
    """The underlying motion model."""
    origin: str
    """Source of the numbers, in words; "" if given by the user."""

    def __init__(self, noise: Noise | None = None, *, effects: EffectsLike = (), track_m: float | None = None) -> None:
        self.motion_model = motion_model.MotionModel((noise or Noise()).as_motion_noise(), track_m=track_m)
        self.origin = ""
        added = self.with_effects(effects)
        self.motion_model, self.origin = added.motion_model, added.origin

    @classmethod
    def of(cls, motion_model: MotionModel, origin: str = "") -> Model:
        """Return the model of this interface for a motion model of the library.

        motion_model : noise law and effects
        origin : source of the numbers in words, for summaries
        """
        model = cls.__new__(cls)
        model.motion_model, model.origin = motion_model, origin
        return model

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Model:
        """Return the model in a file, as written by `fit`, `learn` and `presets`.

        path : model file, TOML

        Raises
        ------
        ModelError
            If the file is not a valid model; the message states the fault.
        """
        return cls.of(read_model(Path(fspath(path))), f"of {fspath(path)}")

    @classmethod
    def preset(cls, name: str = "typical") -> Model:
        """Return a ready-made robot, or noise, by the name of its preset.

        name : preset, as `typical` or `turtlebot3-burger`; `list_presets` has them all

        Returns
        -------
        Model
            Noise; of a robot also effects of zero with a range, which `batch` draws for each run.

        Raises
        ------
        ModelError
            If there is no such preset.
        """
        preset = preset_named(name)
        return cls.of(preset.model, f"{'mean of ' * bool(preset.spread)}preset {preset.name}: {preset.source}")

    def save(self, path: str | PathLike[str], *, overwrite: bool = False) -> Path:
        """Write the model as human-readable TOML; return the path.

        path : file to write
        overwrite : whether an existing file is replaced

        Raises
        ------
        OdomCorruptError
            If the file exists and `overwrite` is false.
        """
        return write_new(path, self.toml().encode(), overwrite=overwrite)

    def toml(self) -> str:
        """Return the text of the model file, as `save` writes it."""
        return format_model(self.motion_model)

    def with_effects(self, effects: EffectsLike) -> Model:
        """Return this model with effects added.

        effects : each as text, as in "unequal_wheels:curvature=0.005", or as an effect of the library

        Returns
        -------
        Model
            A new model; this one is unchanged.

        Raises
        ------
        EffectError
            If there is no such effect, or it has no such parameter.
        """
        if not effects:
            return self
        found, assumed = [], []
        for given in (effects,) if isinstance(effects, str | Effect) else effects:
            if isinstance(given, str):
                written = parse_effect(given)
                found.append(written.effect)
                assumed += [f"{written.effect.name} at its typical size, {written.assumed}"] if written.assumed else []
            else:
                found.append(given)
        robot = replace(self.motion_model, effects=(*self.motion_model.effects, *found))
        return Model.of(robot, "; ".join(part for part in (self.origin, *assumed) if part))

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Systematic and random effects, in the model's order."""
        return self.motion_model.effects

    @property
    def parameters(self) -> dict[str, float]:
        """All parameters by name: non-zero coefficients, then "effect.parameter"."""
        noise = self.motion_model.noise
        numbers = asdict(noise.coefficients)
        own = {f"{e.name}.{p.name}": getattr(e, p.name) for e in self.effects for p in parameters(e)}
        return {name: value for name, value in numbers.items() if value or name in noise.law.alphas} | own

    @property
    def standard_errors(self) -> dict[str, float]:
        """Standard errors of the fitted parameters, by the same names."""
        return dict(self.motion_model.standard_errors)

    def corrupt_path(
        self, t_s: ArrayLike, xy_yaw: ArrayLike, *, seed: int, runs: int = 1, first_run: int = 0
    ) -> NDArray[Any]:
        """Return noisy odometry of a path, identical to the corruption of a bag with these stamps.

        t_s : (n,) times, seconds, ascending
        xy_yaw : (n, 3) clean poses: x and y in metres, heading in radians (wrapped or not)
        seed : seed of all random draws: the same seed and run give the same path as `corrupt` and the command line
        runs, first_run : number of runs, and the number of the first one

        Returns
        -------
        ndarray, shape (runs, n, 3)
            Noisy poses, metres and radians; headings are continuous if the given ones are.

        Raises
        ------
        ModelError
            If the arrays are not a valid path.

        Examples
        --------
        >>> import numpy as np, odomcorrupt as oc
        >>> t = np.arange(0.0, 10.0, 0.1)
        >>> model = oc.Model(oc.Noise(alpha=(0.05, 0.02, 0.05, 0.01)))
        >>> model.corrupt_path(t, np.column_stack((0.3 * t, 0 * t, 0 * t)), seed=3, runs=50).shape
        (50, 100, 3)
        """
        times, poses = np.asarray(t_s, dtype=np.float64), np.asarray(xy_yaw, dtype=np.float64)
        if times.ndim != 1 or poses.shape != (len(times), 3):
            raise ModelError(f"a path: times {times.shape} and poses {poses.shape}; give shapes (n,) and (n, 3)")
        if not (np.isfinite(times).all() and np.isfinite(poses).all()):
            raise ModelError("a path: not all of its times and poses are finite numbers")
        if not (np.diff(times) > 0.0).all():
            raise ModelError("a path: its times do not increase; sort them and drop duplicates first")
        if runs < 1:
            raise ModelError(f"runs: {runs}; draw one or more")
        stamps_ns = np.rint(times * 1e9).astype(np.int64)
        noisy, systematic = np.empty((runs, *poses.shape)), SystematicEffects(self.motion_model)
        for i in range(runs):
            path = NoisyPath(self.motion_model, seed, first_run + i, covariance=False, systematic=systematic)
            noisy[i] = poses + path.feed(stamps_ns, poses).error_xyt
        return noisy

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Model) and self.motion_model == other.motion_model

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        words = model_words(self.motion_model, self.origin)
        return f"<Model: {words[0].lower()}{words[1:]}>"

    def _repr_html_(self) -> str:
        errors = self.standard_errors
        numbers = [
            Line(name, f"{value:.4g}" + (f" +- {errors[name]:.2g}" if name in errors else ""))
            for name, value in self.parameters.items()
        ]
        return Summary((Line("law", self.motion_model.noise.law_name), *numbers)).html()


ModelLike = Model | Noise | str | PathLike[str]
"""A model, noise alone, a model file (.toml), or the name of a preset."""


def as_model(given: ModelLike | MotionModel | None) -> Model:
    """Return the model for any accepted form; None gives the preset `typical`.

    Raises
    ------
    ModelError
        If a string names neither a model file nor a preset, or if it is no model at all.
    """
    if isinstance(given, Model):
        return given
    if isinstance(given, Noise):
        return Model(given)
    if given is None:
        return Model.preset()
    if isinstance(given, str | PathLike):
        name = fspath(given)
        if name in PRESETS:
            return Model.preset(name)
        if not name.endswith(".toml") and not Path(name).exists():
            raise ModelError(f"{name}: no model file and no preset; presets are {', '.join(PRESETS)}")
        return Model.load(name)
    if not isinstance(given, MotionModel):
        raise ModelError(f"model: {given!r}; give a Model, a Noise, a model file, or the name of a preset")
    return Model.of(given)


Target = Literal["ros2_control", "nav2", "robot_localization", "gazebo"]


@dataclass(frozen=True, slots=True, repr=False)
class Export(Result):
    """Parameters of another program.

    name, to : name of the model, and the program
    result : complete result: YAML, comments, values by name, effects that the program cannot represent
    """

    name: str
    to: Target
    result: Snippet

    def summary(self) -> Summary:
        """Return the values, and the effects that cannot be represented."""
        from odomcorrupt.export import number

        left = self.result.left_out
        lines = [Line("EXPORTED", f"{self.name} for {self.to}", "warning" if left else "good")]
        if left:
            lines.append(Line("left out", f"{', '.join(left)}: comments in the file say why", "warning"))
        values = {name: number(value) for name, value in self.result.values.items()}
        shown = [f"{name} {value}" for name, value in values.items()]
        if self.to == "robot_localization":
            shown = [f"twist covariance diagonal {', '.join(values.values())}"]
        lines.append(Line("values", ", ".join(shown)))
        return Summary(tuple(lines))

    def details(self) -> str:
        """Return the YAML, with assumptions and effects left out as comments."""
        return self.result.text

    def _values(self) -> dict[str, Any]:
        return {"to": self.to, "yaml": self.result.text}

    def rows(self) -> list[dict[str, Any]]:
        """Return names and values of the parameters."""
        return [{"parameter": name, "value": value} for name, value in self.result.values.items()]

    def save(self, path: str | PathLike[str], *, overwrite: bool = False) -> Path:
        """Write the YAML; return the path.

        path : file to write
        overwrite : whether an existing file is replaced

        Raises
        ------
        OdomCorruptError
            If the file exists and `overwrite` is false.
        """
        return write_new(path, f"{self.result.text}\n".encode(), overwrite=overwrite)


def export_parameters(
    model: ModelLike,
    to: Target,
    *,
    track_m: float | None = None,
    wheelbase_m: float | None = None,
    wheel_radius_m: float | None = None,
    update_min_d: float = 0.25,
    update_min_a: float = 0.2,
    turn: Turn = "rolling",
    speed: float = 0.5,
    turn_rate: float = 0.5,
    rate: float = 50.0,
    controller: str | None = None,
) -> Export:
    """Return wheel multipliers, amcl's alphas, covariances for robot_localization, or a drive plugin of Gazebo.

    Multipliers come from wheel_scale, unequal_wheels and wheelbase; alphas and covariances from the noise law.

    model : model of the robot, noise, model file or preset
    to : "ros2_control", "nav2", "robot_localization" or "gazebo"
    track_m : nominal distance between left and right wheels, metres; by default that of the model
    wheelbase_m, wheel_radius_m : distance between the axles of an omni or steered base, and radius of the wheels,
        metres; for "gazebo", and for "ros2_control" unless the base has two wheels
    update_min_d, update_min_a : distance (m) and angle (rad) after which amcl updates its particles
    turn : turn on which amcl's noise is matched to the model's: "rolling" (along an arc) or on the "spot"
    speed, turn_rate, rate : speed (m/s) and turn rate (rad/s) at which the noise is evaluated, and rate of the
        odometry, Hz
    controller : name of the node in the YAML; by default that of the controller for this base

    Returns
    -------
    Export
        `details()` is the YAML, `rows()` and `to_pandas()` have its values.

    Raises
    ------
    ModelError
        If the model or a number is invalid, or the track is needed and not known.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> alphas = oc.export_parameters("typical", "nav2", update_min_d=0.2)
    >>> [(row["parameter"], round(row["value"], 5)) for row in alphas.rows()[:2]]
    [('alpha1', 0.025), ('alpha2', 0.001)]
    """
    from odomcorrupt import export

    robot = as_model(model).motion_model
    drive = export.Steady(speed, turn_rate, rate)
    base = export.Base(track_m, wheelbase_m, wheel_radius_m)
    node = controller or export.BASES[export.wheel_layout(robot)][0]
    snippets = {
        "nav2": lambda: export.amcl_snippet(robot, update_min_d, update_min_a, turn, drive),
        "robot_localization": lambda: export.twists_snippet(robot, drive, node),
        "ros2_control": lambda: export.wheels_snippet(robot, base, node),
        "gazebo": lambda: export.gazebo_snippet(robot, base),
    }
    if to not in snippets:
        raise ModelError(f"to: {to!r}; write one of {', '.join(snippets)}")
    return Export(Path(fspath(model)).name if isinstance(model, str | PathLike) else "model", to, snippets[to]())
