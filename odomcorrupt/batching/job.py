"""The runs of a batch: a job for each input and each point of a sweep, its files, and the command of a single run."""

from __future__ import annotations

import math
import re
import shlex
from dataclasses import dataclass, field, fields, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from odomcorrupt.bags.open import open_reader
from odomcorrupt.batching.parameter_draws import Spread, draw_robot, spreads_of, stated_spreads
from odomcorrupt.corruption.run import Container
from odomcorrupt.corruption.transform import Options
from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.effects.effect import check_bounds, parameters
from odomcorrupt.errors import BatchError, BatchOptionError, ModelError
from odomcorrupt.extras import require
from odomcorrupt.model.model_file import format_model, parse_model, read_model, read_model_text
from odomcorrupt.model.motion_model import parse_alpha

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from odomcorrupt.mapping.conditioned import MapCondition
    from odomcorrupt.model.motion_model import MotionModel


_MOST_POINTS = 1 << 14


@dataclass(frozen=True, slots=True)
class Range:
    """Range of a parameter; `log`: with even coverage of its logarithm."""

    name: str
    low: float
    high: float
    log: bool

    def at(self, part: float) -> str:
        """Return the value at a fraction of the range, 0 to 1, with four digits."""
        if self.log:
            return f"{self.low * (self.high / self.low) ** part:.4g}"
        return f"{self.low + part * (self.high - self.low):.4g}"


def parse_range(text: str) -> Range | None:
    """Return a range written as "alpha-scale=0.25..4:log" or "wheel_scale.e=-0.02..0.02"; None where it is a list.

    Raises
    ------
    ModelError
        If its ends are not finite, not ascending, or not positive for `log`.
    """
    match = re.fullmatch(r"\s*([^=]+?)\s*=\s*([^,]+?)\.\.([^,:]+?)(:log)?\s*", text)
    if match is None:
        return None
    low, high, log = parse_alpha(match[2]), parse_alpha(match[3]), match[4] is not None
    if not (math.isfinite(low) and math.isfinite(high) and low < high) or (log and not low > 0.0):
        raise ModelError(f"--sweep {text}: a range goes from the lower value to the higher one, above 0 with :log")
    return Range(match[1], low, high, log)


def sobol_points(ranges: Sequence[Range], count: int) -> list[list[tuple[str, str]]]:
    """Return names and values of `count` points that cover the product of all ranges evenly.

    The points are the first ones of a Sobol sequence, without scrambling and each in the middle of its cell: the same
    for every seed and machine. Powers of two cover best.
    Source: Sobol, USSR Comput. Math. Math. Phys. 7(4), 1967; Joe & Kuo, SIAM J. Sci. Comput. 30, 2008.

    Raises
    ------
    ModelError
        If the count is out of bounds.
    """
    if not 1 <= count <= _MOST_POINTS:
        raise ModelError(f"--points {count}: must be 1 to {_MOST_POINTS}")
    require("scipy")
    from scipy.stats import qmc  # noqa: PLC0415 - slow to import, and an extra

    exponent = max(math.ceil(math.log2(count)), 0)
    parts: Any = qmc.Sobol(len(ranges), scramble=False).random_base2(exponent)[:count] + 0.5 / 2**exponent
    return [[(one.name, one.at(float(part))) for one, part in zip(ranges, row, strict=True)] for row in parts]


@dataclass(frozen=True, slots=True)
class Variant:
    """A model of a sweep, and the directory of its runs, "" without a sweep."""

    name: str
    model: MotionModel


def variants(model: MotionModel, sweeps: Sequence[str], points: int = 0) -> list[Variant]:
    """Return the models of all combinations of sweeps, each NAME=VALUE,VALUE or a range NAME=LOW..HIGH.

    NAME is alpha-scale (factor on all noise), model (files), a coefficient, or EFFECT.PARAMETER; an effect that the
    model lacks is added. The product of all ranges is sampled at `points` points of a Sobol sequence.

    Raises
    ------
    ModelError
        If a name is unknown, or a value is invalid.
    """
    axes = []
    ranges = [one for text in sweeps if (one := parse_range(text)) is not None]
    if bool(ranges) != bool(points):
        raise ModelError("--sweep NAME=LOW..HIGH and --points N go together; give both or neither")
    for text in sweeps:
        if parse_range(text) is not None:
            continue
        name, equals, rest = text.partition("=")
        values = [value.strip() for value in rest.split(",")]
        if not equals or not all(values) or len(set(values)) < len(values):
            raise ModelError(f"--sweep {text}: write a name and different values, as in alpha-scale=0.5,1,2")
        axes.append([(name.strip(), value) for value in values])
    # models first: the other sweeps change them
    axes.sort(key=lambda axis: axis[0][0] != "model")
    found = []
    covered = sobol_points(ranges, points) if ranges else [[]]
    for point in ((*one, *more) for one in product(*axes) for more in covered):
        chosen = model
        for name, value in point:
            chosen = _changed(chosen, name, value)
        label = ",".join(f"{name}={Path(value).stem if name == 'model' else value}" for name, value in point)
        found.append(Variant(label.replace("/", "_"), parse_model(format_model(chosen)) if point else chosen))
    names = [one.name for one in found]
    if len(set(names)) < len(names):
        raise ModelError(f"--sweep: two of {', '.join(names)} have the same name; give the files different ones")
    return found


def _changed(model: MotionModel, name: str, value: str) -> MotionModel:
    if name == "model":
        return read_model(Path(value))
    number = parse_alpha(value)
    k = model.noise.coefficients
    known = [field.name for field in fields(k)]
    if name == "alpha-scale":
        if number < 0.0:
            raise ModelError(f"--sweep alpha-scale: {value}; it must not be below 0")
        # coefficients that scale a variance grow fourfold to double the noise
        squared = model.noise.law.alphas if model.noise.law.degree == 1 else ()
        factors = {one: number**2 if one in squared else number for one in known}
        errors = {key: error * factors.get(key, 1.0) for key, error in model.standard_errors.items()}
        scaled = replace(k, **{one: getattr(k, one) * factors[one] for one in known})
        return replace(model, noise=replace(model.noise, coefficients=scaled), standard_errors=errors)
    if name in known:
        return replace(model, noise=replace(model.noise, coefficients=replace(k, **{name: number})))
    effect, _, parameter = name.partition(".")
    effects = list(model.effects)
    for i, one in enumerate(effects):
        if one.name == effect and parameter in {p.name for p in parameters(one)}:
            effects[i] = replace(one, **{parameter: number})  # type: ignore[type-var]  # every effect is a dataclass
            check_bounds(effects[i])
            return replace(model, effects=tuple(effects))
    if parameter and effect in registry() and parameter in {p.name for p in parameters(registry()[effect])}:
        return replace(model, effects=(*effects, effect_from_values(effect, {parameter: number})))
    own = [f"{one.name}.{p.name}" for one in effects for p in parameters(one)]
    raise ModelError(f"--sweep {name}: is not known; there are alpha-scale, model, {', '.join([*known, *own])}")


Output = Literal["full", "overlay", "trajectories"]
Format = Literal["bag", "mcap", "db3", "directory"]
_SUFFIXES: Mapping[Format, str] = {"bag": ".bag", "mcap": ".mcap", "db3": ".db3", "directory": ""}
"""Suffixes of the runs' names by format."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchSpec:
    """Configuration of a batch; the fields not named here are options of `odomcorrupt.api.batch.BatchOptions`.

    model, seed : model of all runs, and seed of all draws
    posterior : whether all parameters with a standard error are drawn, not only those that the file states as "a +- b"
    options, container : options of corruption, and of reading and writing
    split : whether changed messages are written in chunks of their own
    condition : map to which every run is constrained
    """

    model: MotionModel
    seed: int
    model_file: Path | None = None
    posterior: bool = False
    sweeps: tuple[str, ...] = ()
    points: int = 0
    options: Options = field(default_factory=Options)
    container: Container = field(default_factory=Container)
    output: Output = "full"
    split: bool = False
    condition: MapCondition | None = None
    to: Format | None = None
    also: tuple[str, ...] = ()
    model_words: tuple[str, ...] | None = None
    map_words: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name, value, kinds in (("output", self.output, Output), ("to", self.to or "bag", Format)):
            if value not in get_args(kinds):
                raise BatchError(f"{name}: {value}; give one of {', '.join(get_args(kinds))}")
        if self.output != "full":
            self._require_changed_messages_only()

    def _require_changed_messages_only(self) -> None:
        """Refuse options that need whole bags if only parts of them are written."""
        output = f"--output {self.output}"
        adding = (("--keep-truth", self.options.keep_truth), ("--tf correction", self.options.new_odom_frame))
        for flag in (flag for flag, value in adding if value):
            raise BatchOptionError(
                f"{flag}: adds messages, but {output} holds changed messages only; leave one of them out"
            )
        c = self.container
        whole = (("--to", self.to), ("--exclude-topic", c.exclude), ("--rename", c.rename), ("--ros", c.ros),
                 ("--storage", c.storage), ("--also", self.also), ("--layout split", self.split),
                 ("--scan-every", c.scan_every > 1))  # fmt: skip
        for flag in (flag for flag, value in whole if value):
            raise BatchOptionError(f"{flag}: is for whole bags, not for {output}; leave one of them out")


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """One directory of runs of a batch: those of one input with one variant of the model.

    source, directory : absolute paths, for workers on other machines
    model, spreads : variant of the batch's model, and the parameters drawn for each run
    model_text : content of the directory's model.toml
    model_words, option_words : command-line arguments of a single run: model (if not drawn), and all others
    shown_source, shown_directory : paths as typed
    """

    batch: BatchSpec
    source: Path
    directory: Path
    model: MotionModel
    spreads: tuple[Spread, ...]
    model_text: str
    model_words: tuple[str, ...]
    option_words: tuple[str, ...]
    shown_source: str
    shown_directory: str

    def model_of(self, run: int) -> MotionModel:
        """Return the model of a run: the common one, or one with the run's drawn parameters."""
        return draw_robot(self.model, self.spreads, self.batch.seed, run) if self.spreads else self.model

    def name_of(self, run: int) -> str:
        """Return the name of a run's file."""
        suffixes = {"overlay": ".mcap", "trajectories": ".tum"}
        return f"run_{run:06d}{suffixes.get(self.batch.output, self._bag_suffix)}"

    @property
    def _bag_suffix(self) -> str:
        """Suffix of a whole bag; a single compressed file is written as what is in it."""
        if self.batch.to is not None:
            return _SUFFIXES[self.batch.to]
        name = self.source.with_suffix("") if self.source.suffix in (".zstd", ".zst") else self.source
        if not self.source.is_dir():
            return name.suffix.rstrip("*")
        held = {one.suffix for one in self.source.iterdir()}  # parts of a recording of ROS 1
        return ".bag" if held & {".bag", ".active"} and not held & {".db3", ".mcap", ".yaml", ".zstd", ".zst"} else ""

    def path_of(self, run: int) -> Path:
        """Return the path of a run's file."""
        return self.directory / self.name_of(run)

    def robot_of(self, run: int) -> str:
        """Return the name of the file with a run's drawn model."""
        return f"robots/{run:06d}.toml"

    def command_of(self, run: int) -> str:
        """Return the shell command that makes this run alone, as a whole bag, from the batch's working directory."""
        name = self.name_of(run)
        if self.batch.output != "full":
            name = f"run_{run:06d}{self._bag_suffix}"
        words = ("--model", f"{self.shown_directory}/{self.robot_of(run)}") if self.spreads else self.model_words
        seed = ("--seed", str(self.batch.seed), "--run", str(run))
        return shlex.join(["odomcorrupt", self.shown_source, name, *words, *self.option_words, *seed])


@dataclass(frozen=True, slots=True)
class Task:
    """Runs of one job made in one pass over its input."""

    job: Job
    runs: tuple[int, ...]


def plan(inputs: Sequence[Path], target: Path, spec: BatchSpec) -> list[Job]:
    """Return the jobs of a batch in the directory `target`, one for each input and each point of a sweep.

    inputs : bags
    target : directory of the batch
    spec : model, seed, sweeps, options and kind of output

    Raises
    ------
    BatchError
        If inputs would share a directory, or do not support the requested output.
    """
    _require_inputs(inputs, target, spec)
    stated = frozenset[str]() if spec.model_file is None else stated_spreads(spec.model_file)
    if "preset" in spec.model.source:
        stated |= spec.model.standard_errors.keys()
    also = [word for topic in spec.also for word in ("--also", topic)]
    jobs = []
    for source in inputs:
        if spec.split:
            _require_chunks(source, spec)
        for variant in variants(spec.model, spec.sweeps, spec.points):
            own = [re.sub(r"[][*?]", "", source.stem)] if len(inputs) > 1 else []
            parts = own + ([variant.name] if variant.name else [])
            directory = target.joinpath(*parts)
            by_file = ("--model", f"{directory}/model.toml")
            model, text = variant.model, format_model(variant.model)
            words: tuple[str, ...] = by_file
            if not variant.name and spec.model_file is not None:
                # the file as it is now: it may be edited later
                text, words = read_model_text(spec.model_file), (*by_file, *(spec.model_words or ()))
            elif not variant.name and spec.model_words is not None:
                words = spec.model_words
            elif not variant.name:
                # a single run reads the file, which has nine digits
                model = parse_model(text)
            jobs.append(
                Job(
                    batch=spec, source=source.absolute(), directory=directory.absolute(), model=model,
                    spreads=spreads_of(model, None if spec.posterior else stated), model_text=text, model_words=words,
                    option_words=(*_option_words(spec.options, spec.container), *spec.map_words, *also),
                    shown_source=str(source), shown_directory=str(directory),
                )
            )  # fmt: skip
    return jobs


def _require_inputs(inputs: Sequence[Path], target: Path, spec: BatchSpec) -> None:
    """Raise BatchError for inputs that would share a directory, or do not go with the configuration."""
    if spec.condition is not None and (len(inputs) > 1 or spec.also):
        raise BatchOptionError("--map: is for one drive; make a batch of each input, and of each robot without --also")
    stems = [source.stem for source in inputs]
    if len(set(stems)) < len(stems):
        twice = next(stem for stem in stems if stems.count(stem) > 1)
        raise BatchError(f"inputs: two of them are called {twice}, and would share a directory; rename one")
    if spec.posterior and not spec.model.standard_errors:
        raise BatchError("--robots posterior: the model has no standard errors; give the --model that a fit wrote")
    for source in inputs:
        if source.is_dir() and target.resolve().is_relative_to(source.resolve()):
            raise BatchError(f"{target}: lies in the input {source}, which stays as it is; name a directory elsewhere")


def _require_chunks(source: Path, spec: BatchSpec) -> None:
    """Raise BatchError for runs that do not have the chunks of the input, which alone can be split."""
    with open_reader(source, recover=spec.container.recover) as reader:
        if reader.kind == "sqlite3":
            raise BatchError(
                f"{source}: sqlite3 has no chunks for --layout split to divide, and is not recompressed; "
                "leave --layout out"
            )
        modes = {getattr(reader, "mode", "none"), spec.container.compression, "file" if spec.also else None}
    c = spec.container
    other = spec.to is not None or c.exclude or c.rename or c.scan_every > 1 or c.ros or c.storage
    if other or not modes.isdisjoint(("file", "message")):
        raise BatchError(
            f"{source}: --layout split needs the chunks of the input, and these runs are written in another way; leave "
            "--layout out"
        )


def _option_words(options: Options, container: Container) -> list[str]:
    """Return the command-line arguments for frames, topics and containers."""
    tf = "subtraction" if options.subtracted else "correction"
    values = (
        ("--odom-topic", options.odom_topic), ("--odom-frame", options.odom_frame),
        ("--base-frame", options.base_frame), ("--twist", "keep" if options.keep_twist else None),
        ("--covariance", "keep" if options.keep_covariance else None), ("--keep-truth", options.keep_truth),
        ("--tf", options.new_odom_frame and tf), ("--new-odom-frame", options.new_odom_frame),
        ("--scan-noise", options.scan_noise or None), ("--imu", options.imu and options.imu.file),
        ("--scan-keep", options.scan_keep if options.scan_keep < 1.0 else None),
        ("--scan-every", container.scan_every if container.scan_every > 1 else None),
        ("--compression", container.compression), ("--level", container.level), ("--ros", container.ros),
        ("--storage", container.storage), *(("--exclude-topic", topic) for topic in container.exclude),
        *(("--rename", words) for words in container.rename),
    )  # fmt: skip
    words = [word for flag, value in values if value is not None for word in (flag, str(value))]
    words += ["--keep-localisation"] * options.keep_localisation + ["--consistent"] * options.consistent
    return words + ["--recover"] * container.recover
