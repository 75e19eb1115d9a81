"""The runs of a batch: a job for each input and point of a sweep, its command, and the parameters drawn for a run."""

from __future__ import annotations

import math
import re
import shlex
from dataclasses import dataclass, field, fields, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from odomcorrupt.bags.open import open_reader
from odomcorrupt.corruption.run import Container
from odomcorrupt.corruption.transform import Options
from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.effects.effect import check_bounds, choices, parameters
from odomcorrupt.errors import BatchError, BatchOptionError, EffectError, ModelError
from odomcorrupt.extras import require
from odomcorrupt.input_files import parse_toml
from odomcorrupt.model.correlation import Correlation
from odomcorrupt.model.model_file import format_model, parse_model, read_model, read_model_text
from odomcorrupt.model.motion_model import parse_alpha
from odomcorrupt.rng import stream

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.mapping.conditioned import MapCondition
    from odomcorrupt.model.motion_model import MotionModel


TRIES = 1000
"""Maximum number of draws until a value is within its bounds: the distribution is a truncated normal."""


@dataclass(frozen=True, slots=True)
class Spread:
    """Standard deviation of a drawn parameter, of an effect (index from 0) or of the noise (None)."""

    effect: int | None
    parameter: str
    deviation: float

    def owner(self, model: MotionModel) -> Any:
        """Return what has the parameter: coefficients of the noise, or an effect."""
        return model.noise.coefficients if self.effect is None else model.effects[self.effect]

    def name(self, model: MotionModel) -> str:
        """Return the parameter's key in `standard_errors`."""
        return self.parameter if self.effect is None else f"{self.owner(model).name}.{self.parameter}"


def spreads_of(model: MotionModel, only: Collection[str] | None) -> tuple[Spread, ...]:
    """Return the distributions of all parameters with a standard error, or of those of them named in `only`.

    Names are the keys of `standard_errors`, such as "rot_trans" and "wheel_scale.e".
    """

    def deviation(name: str) -> float:
        error = model.standard_errors.get(name, 0.0) if only is None or name in only else 0.0
        if not math.isfinite(error):
            raise ModelError(f"{name}: standard error {error:g}; to draw robots, give a finite one")
        return error

    noise = [Spread(None, f.name, deviation(f.name)) for f in fields(model.noise.coefficients)]
    effects = [
        Spread(number, p.name, deviation(f"{effect.name}.{p.name}"))
        for number, effect in enumerate(model.effects)
        for p in parameters(effect)
    ]
    return tuple(spread for spread in noise + effects if spread.deviation > 0.0)


def stated_spreads(path: Path) -> frozenset[str]:
    """Return the names of the parameters written as "0.004 +- 0.001" in a model file.

    The standard errors of a fit are stored elsewhere in the file, and drawn only on request.
    """
    table = parse_toml(read_model_text(path))
    stated = {name for name, value in table.get("noise", {}).items() if _is_spread(value)}
    for item in table.get("effect", []):
        stated |= {f"{item.get('name')}.{name}" for name, value in item.items() if _is_spread(value)}
    return frozenset(stated)


def _is_spread(value: Any) -> bool:
    return isinstance(value, str) and ("+-" in value or "±" in value)


def draw_robot(model: MotionModel, spreads: tuple[Spread, ...], seed: int, run: int) -> MotionModel:
    """Return the model of a run: drawn parameters, rounded to the precision of its file, and no standard errors.

    Every parameter has a random stream of its own, so a further distribution changes no parameter that it is not
    correlated with. Correlated parameters are drawn jointly; where one is out of bounds, all of them are drawn again.

    model : means, and correlations of their errors
    spreads : standard deviations of the parameters to draw
    seed, run : seed of all draws, and number of the run
    """
    named = {spread.name(model): spread for spread in spreads}
    known = model.correlation.among(named)
    groups = known.groups()
    tied = {name for group in groups for name in group}
    robot = model
    for names in [*groups, *((name,) for name in named if name not in tied)]:
        factor = known.among(names).factor() if len(names) > 1 else [[1.0]]
        robot = _drawn(robot, [named[name] for name in names], factor, seed, run)
    robot = replace(robot, standard_errors={}, correlation=Correlation())
    # the file has nine digits: a single run made from it must have the same bytes
    return parse_model(format_model(robot))


def drawn_values(robot: MotionModel, spreads: tuple[Spread, ...]) -> dict[str, float]:
    """Return the drawn parameters of a model, by the keys of `standard_errors`."""
    return {one.name(robot): float(getattr(one.owner(robot), one.parameter)) for one in spreads}


def _drawn(
    model: MotionModel, spreads: Sequence[Spread], factor: Sequence[Sequence[float]], seed: int, run: int
) -> MotionModel:
    """Return a model with parameters drawn from a normal distribution with Cholesky factor (n, n)."""
    names = [spread.name(model) for spread in spreads]
    streams = [
        stream(seed, run, f"robot {name}", 0 if spread.effect is None else spread.effect)
        for name, spread in zip(names, spreads, strict=True)
    ]
    means = [float(getattr(spread.owner(model), spread.parameter)) for spread in spreads]
    for _ in range(TRIES):
        normals = [float(rng.standard_normal()) for rng in streams]
        drawn = model
        for spread, mean, row in zip(spreads, means, factor, strict=True):
            error = math.fsum(weight * normal for weight, normal in zip(row, normals, strict=True))
            changed = _with(drawn, spread, mean + spread.deviation * error)
            if changed is None:
                break
            drawn = changed
        else:
            return drawn
    said = ", ".join(f"{n} {m:g} +- {s.deviation:g}" for n, m, s in zip(names, means, spreads, strict=True))
    raise ModelError(f"{said}: draws are hardly ever within bounds; give another mean or a smaller spread")


def _with(model: MotionModel, spread: Spread, value: float) -> MotionModel | None:
    """Return a model with one parameter changed; None where the value is out of bounds."""
    if spread.effect is None:
        if not value >= 0.0:
            return None
        coefficients = replace(model.noise.coefficients, **{spread.parameter: value})
        return replace(model, noise=replace(model.noise, coefficients=coefficients))
    effects = list(model.effects)
    effect: Effect = replace(effects[spread.effect], **{spread.parameter: value})  # type: ignore[type-var]  # every effect is a dataclass
    try:
        check_bounds(effect)
    except EffectError:
        return None
    effects[spread.effect] = effect
    return replace(model, effects=tuple(effects))


def fleet_model(robots: Mapping[str, MotionModel]) -> MotionModel:
    """Return a model with the mean parameters of the robots, and their between-robot deviation as standard errors.

    The variance between robots is the sample variance less the mean squared standard error of the fits, at least 0
    (the moment estimator of a random-effects model: DerSimonian & Laird, Controlled Clinical Trials 7(3), 1986).
    Parameters are treated as independent: a handful of robots does not determine their correlation. A robot without
    an effect counts with the effect's identity value; shapes, such as time constants, are averaged over the robots
    that have the effect.

    robots : models by file name, two or more

    Raises
    ------
    ModelError
        If there are fewer than two, or their noise laws, steps or an effect's options differ.
    """
    if len(robots) < 2:
        raise ModelError(f"a fleet: {len(robots)} robots; a spread between robots takes two or more model files")
    models = list(robots.values())
    _require_same([(name, f"{m.noise.law_name}, step {m.noise.step}") for name, m in robots.items()], "noise laws")
    errors: dict[str, float] = {}
    coefficients = {}
    for one in fields(models[0].noise.coefficients):
        values = [getattr(m.noise.coefficients, one.name) for m in models]
        coefficients[one.name], errors[one.name] = _spread(values, [m.standard_errors for m in models], one.name)
    effects = [_effect(name, robots, errors) for name in _effect_names(models)]
    tracks = [m.track_m for m in models if m.track_m is not None]
    known = {name: error for name, error in errors.items() if error > 0.0}
    noise = replace(models[0].noise, coefficients=replace(models[0].noise.coefficients, **coefficients))
    fleet = replace(
        models[0], noise=noise, effects=tuple(effects), track_m=sum(tracks) / len(tracks) if tracks else None,
        standard_errors=known, correlation=Correlation(), source={"fleet": ", ".join(robots)},
        setup=type(models[0].setup)(),
    )  # fmt: skip
    return parse_model(format_model(fleet))


def _require_same(facts: Sequence[tuple[str, str]], what: str) -> None:
    if len({fact for _, fact in facts}) > 1:
        facts_text = "; ".join(f"{name}: {fact}" for name, fact in facts)
        raise ModelError(f"a fleet: its robots have different {what} ({facts_text}); fit them with the same")


def _effect_names(models: Sequence[MotionModel]) -> list[str]:
    for model in models:
        own = [effect.name for effect in model.effects]
        if len(set(own)) < len(own):
            twice = next(name for name in own if own.count(name) > 1)
            raise ModelError(f"a fleet: a robot has {twice} twice; the two cannot be matched between robots")
    return list(dict.fromkeys(effect.name for model in models for effect in model.effects))


def _effect(name: str, robots: Mapping[str, MotionModel], errors: dict[str, float]) -> Effect:
    """Return an effect at the mean of the robots; the deviations between robots are added to `errors`."""
    own = {robot: e for robot, model in robots.items() for e in model.effects if e.name == name}
    have = list(own.values())
    _require_same(
        [(robot, str({w: getattr(e, w) for w in choices(e)})) for robot, e in own.items()], f"words of {name}"
    )
    if len({type(e) for e in have}) > 1:
        raise ModelError(f"a fleet: {name} is not the same expression in {', '.join(own)}; rename one")
    values = {}
    for p in parameters(have[0]):
        members = [(getattr(e, p.name), robots[robot].standard_errors) for robot, e in own.items()]
        if p.amplitude:
            members += [(p.identity, {})] * (len(robots) - len(have))
        key = f"{name}.{p.name}"
        if len(members) < 2:
            values[p.name] = members[0][0]
            continue
        values[p.name], errors[key] = _spread([m[0] for m in members], [m[1] for m in members], key)
    return replace(have[0], **values)  # type: ignore[type-var]  # every effect is a dataclass


def _spread(values: Sequence[float], errors: Sequence[Mapping[str, float]], name: str) -> tuple[float, float]:
    """Return a parameter's mean and its standard deviation between robots."""
    n = len(values)
    mean = math.fsum(values) / n
    sample = math.fsum((value - mean) ** 2 for value in values) / (n - 1)
    fits = math.fsum(one.get(name, 0.0) ** 2 for one in errors) / n
    return mean, math.sqrt(max(sample - fits, 0.0))


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
