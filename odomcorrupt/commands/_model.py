"""Options of the motion model (coefficients, presets, effects, files), of a motion to sample, and of a map."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from odomcorrupt.commands._options import (
    EFFECTS,
    FILE,
    TRACK,
    Decorator,
    Setting,
    added,
    completing,
    number,
    pose,
    setting,
    typed_effects,
    usage_errors,
    valued,
)
from odomcorrupt.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from odomcorrupt.api.bag_options import BagOptions
    from odomcorrupt.api.model import Model
    from odomcorrupt.mapping.conditioned import MapCondition


_FEWEST, _MOST = 4, 6
"""Smallest and largest number of coefficients of any law."""

_NUMBER = re.compile(r"-?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?(deg|rad)?(/(m|rad))?\Z")

effect_option = setting(
    "--effect", "--add", "effects", multiple=True, callback=typed_effects, metavar="NAME:KEY=VALUE,...",
    shell_complete=EFFECTS, help="Systematic error (repeatable).",
)  # fmt: skip
track_option = setting(
    "--track", type=TRACK, metavar="M",
    help="Distance between the wheels, for effects of single wheels. [default: the model's]",
)  # fmt: skip


def _model_options(default: str) -> Decorator:
    """Return a decorator that adds the options of `choose_model`; `default` is the noise without any of them."""
    return added(
        setting(
            "--alpha", metavar="A1 A2 A3 A4",
            help="rot_rot rot_trans trans_trans trans_rot: noise in the first, caused by the second. Under diffusion, "
            "the standard deviation after 1 rad or 1 m (0.05, 5deg, 10deg/m); other laws differ (velocity: also in the "
            "order), and amcl's alphas are --law quadratic. [omni: 4 or 5 numbers, velocity: 4 to 6]",
        ),
        setting(
            "--law", metavar="NAME", shell_complete=completing("model.noise_laws", "LAWS"),
            help="Noise law of A1...: diffusion, linear, quadratic, velocity, omni, article-code. [default: diffusion]",
        ),
        setting(
            "--twist-noise", nargs=2, type=float, metavar="V W", help="White noise on every twist, m/s and rad/s."
        ),
        setting(
            "--step", metavar="STEP",
            help="Apply a step-dependent law once per distance or angle, as in 0.25m,0.2rad. [default: message]",
        ),
        setting(
            "--preset", metavar="NAME", shell_complete=completing("model.presets", "PRESETS"),
            help="Ready-made robot or noise, as turtlebot3-burger; odomcorrupt presets lists them. "
            f"[default: {default}]",
        ),
        effect_option,
        click.option("--model", type=FILE, help="Motion model, as `fit` writes it."),
        track_option,
    )  # fmt: skip


model_options = _model_options("typical, if no noise, effect or model is given")
"""Adds the options of `choose_model`."""


class AlphaCommand(click.Command):
    """Command whose --alpha takes all the numbers that follow it, because laws differ in their number."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Join the numbers after --alpha into one value."""
        joined: list[str] = []
        rest = list(args)
        while rest:
            joined.append(rest.pop(0))
            if joined[-1] == "--":
                break
            if joined[-1] == "--alpha":
                count = next(
                    (i for i, word in enumerate(rest[:_MOST]) if not _NUMBER.match(word)), min(len(rest), _MOST)
                )
                if rest and "," in rest[0]:
                    count = 1
                elif count < min(_FEWEST, len(rest)):
                    said = f"--alpha: {count} numbers, then {rest[count]!r}; every law takes {_FEWEST} numbers or more"
                    raise click.UsageError(said, ctx)
                joined.append(" ".join(rest[:count]))
                del rest[:count]
        return super().parse_args(ctx, joined + rest)


def choose_model(given: Mapping[str, Any]) -> Model:
    """Return the model that the options describe; without noise, effect or model, the preset `typical`.

    Raises
    ------
    click.UsageError
        If options contradict each other or one is invalid.
    ModelError
        If the model file is invalid.
    """
    from odomcorrupt.api.model import Model

    context = click.get_current_context(silent=True)
    names = ("alpha", "preset", "model")
    # those typed, in preference to defaults from a file
    typed = [n for n in names if context and context.get_parameter_source(n) is ParameterSource.COMMANDLINE]
    brings = {name: given.get(name) for name in typed or names}
    alpha, law, track, model = brings.get("alpha"), given.get("law"), given.get("track"), brings.get("model")
    noisy = [f"--{name}" for name, value in brings.items() if value]
    if len(noisy) > 1 and noisy != ["--alpha", "--model"]:
        raise click.UsageError(f"{' and '.join(noisy)} both define noise; give one of them")
    if law is not None and alpha is None:
        raise click.UsageError(f"--law {law}: what coefficients mean depends on the law, so give them with --alpha")
    base = None if model is None else Model.load(model)
    try:
        chosen = base or Model()
        # effects or twist noise alone come without the default preset
        alone = given.get("effects") or given.get("twist_noise")
        if alpha is None and base is None and (brings.get("preset") is not None or not alone):
            chosen = Model.preset(brings.get("preset") or "typical")
        chosen = _with_noise(chosen, alpha, law, given.get("step"), given.get("twist_noise"))
        if track is not None:
            chosen = Model.of(replace(chosen.motion_model, track_m=track), chosen.origin)
        ctx = click.get_current_context()
        if not ctx.params.get("quiet") and not ctx.meta.setdefault("odomcorrupt.hinted", ()):
            ctx.meta["odomcorrupt.hinted"] = given.get("effects") or ()
            _hint_at_percent(ctx.meta["odomcorrupt.hinted"])
        return chosen.with_effects(given.get("effects") or ())
    except ModelError as error:
        said = str(error)
        raise click.UsageError(f"--{said}" if said.startswith("effect ") else said) from error


def _hint_at_percent(effects: Iterable[str]) -> None:
    """Print a hint, once a command, for a fraction that is so large that a percentage was probably meant."""
    from odomcorrupt.effects.effect import amplitudes
    from odomcorrupt.model.model_file import parse_effect

    for effect in (parse_effect(text).effect for text in effects):
        for p in amplitudes(effect):
            value = getattr(effect, p.name)
            if not p.unit and abs(value) > max(0.5, 20.0 * p.typical):
                usual = f"robots have about {100.0 * p.typical:g} %; write {p.name}={value:g}% for {value:g} %"
                click.echo(f"{effect.name}: {p.name}={value:g} is {100.0 * value:g} %; {usual}", err=True)


def _with_noise(
    model: Model, alpha: str | None, law: str | None, step: str | None, twist_noise: tuple[float, float] | None
) -> Model:
    """Return a model with what is given of its noise; for commas in alpha, raise an error with the correct spelling."""
    from odomcorrupt.api.model import Model, Noise
    from odomcorrupt.model.motion_model import Step

    noise, origin = model.motion_model.noise, model.origin
    if alpha is not None:
        words = [word for word in re.split(r"[\s,]+", alpha) if word]
        if "," in alpha and all(_NUMBER.match(word) for word in words):
            raise click.UsageError(f"--alpha {alpha}: put spaces between the numbers: --alpha {' '.join(words)}")
        noise, origin = Noise(alpha=alpha.split(), law=law or noise.law_name).as_motion_noise(), ""
    if twist_noise is not None:
        white_v, white_omega = twist_noise
        noise = replace(noise, coefficients=replace(noise.coefficients, white_v=white_v, white_omega=white_omega))
    if step is not None:
        noise = replace(noise, step=Step.parse(step))
    return Model.of(replace(model.motion_model, noise=noise), origin)


move_options = added(
    _model_options("the noise of --example; along a bag typical"),
    click.option(
        "--example", metavar="NAME",
        help="Motion, and noise if no option states any: article, or the lecture's balanced, translation-heavy, "
        "rotation-heavy. "
        "[default: article]",
    ),
    click.option("--start", type=pose, help="Odometry before the motion, as in 0,0,30deg."),
    click.option("--end", type=pose, help="Odometry after the motion, as in 0.2,0.35,10deg."),
    click.option("-n", "--samples", "count", type=click.IntRange(2, 10_000_000), help="[default: the example's]"),
)  # fmt: skip
"""Adds the options of `choose_move`."""


def _choose_noise(given: Mapping[str, Any], example: str | None) -> Model:
    """Return the noise of the options; without any numbers, that of an example.

    `--law article-code` alone selects the example's noise, sampled as in the article's listing.
    """
    from odomcorrupt.api.model import Model
    from odomcorrupt.model.motion_model import MotionModel
    from odomcorrupt.sampling.samples import DEFAULT_EXAMPLE, example_named

    listing = given["law"] == "article-code"
    numbers = [name for name in ("alpha", "preset", "effects", "model", "twist_noise") if given[name]]
    if numbers and example is not None:
        raise click.UsageError(f"--example {example} has its own noise; leave out the other numbers")
    if numbers or (given["law"] and not listing):
        return choose_model(given)
    chosen_example = example_named(example or DEFAULT_EXAMPLE)
    noise = replace(chosen_example.noise, law_name="article-code") if listing else chosen_example.noise
    with usage_errors(ModelError):
        return _with_noise(Model.of(MotionModel(noise), chosen_example.source), None, None, given["step"], None)


def choose_move(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return model, motion and number of samples of the options, as arguments of `sample`."""
    import numpy as np

    from odomcorrupt.geometry.se2 import between, compose
    from odomcorrupt.sampling.samples import DEFAULT_EXAMPLE, example_named

    with usage_errors(ModelError):
        example = example_named(given["example"] or DEFAULT_EXAMPLE)
    model = _choose_noise(given, given["example"])
    if model.effects:
        raise click.UsageError(
            "effects act over time, and a single motion has no duration: name a bag, or leave --effect out"
        )
    # a motion given by --end begins at the origin, that of an example where it does, unless --start is given
    begin = example.start_xyt if given["end"] is None else (0.0, 0.0, 0.0)
    start = np.array(begin if given["start"] is None else given["start"])
    motion = between(np.array(example.start_xyt), np.array(example.end_xyt))
    end = compose(start, motion) if given["end"] is None else np.array(given["end"])
    return {"model": model, "start_xyt": start, "end_xyt": end, "count": given["count"] or example.count}


map_options = added(
    click.option("--map", "map_", metavar="MAP", help="Draw free poses only: a map's .yaml, or a topic of the bag."),
    setting(
        "--map-pose", type=pose, help="Pose of the odom frame in the map. [default: TF of the bag; without a bag 0,0,0]"
    ),
    valued(
        "--robot-radius", "radius", kind=number("metres", 0.0, 100.0), default=0.2, text="Radius of the robot, metres.",
        cls=Setting,
    ),
    valued(
        "--map-check", "check", among=["endpoint", "path"],
        text="Cells that must be free: at the end of each motion, or along it.",
    ),
    valued("--unknown", among=["blocked", "free"], text="Treat unknown cells of the map as blocked or as free."),
    valued("--max-tries", "tries", kind=click.IntRange(1, 1_000_000), default=100, text="Draws per motion."),
)  # fmt: skip
"""Adds the options of `choose_condition`."""


def choose_condition(
    given: Mapping[str, Any], bag: Path | None, odom_frame: str, *, recover: bool = False
) -> MapCondition | None:
    """Return the map condition of the options, None if they name no map."""
    name = given["map_"]
    if name is None:
        context = click.get_current_context()
        for option in context.command.params:
            of_map = option.name in ("map_pose", "radius", "check", "unknown", "tries") and option.name in given
            if of_map and context.get_parameter_source(option.name or "") is ParameterSource.COMMANDLINE:
                raise click.UsageError(f"{option.opts[0]}: needs a map; name it with --map")
        return None
    from odomcorrupt.mapping.conditioned import is_map_file, read_condition

    if bag is None and not is_map_file(name):
        raise click.UsageError(f"--map {name}: without a bag a map is a .yaml file")
    asked = {key: given[key] for key in ("map_pose", "unknown", "check", "tries")}
    return read_condition(name, bag=bag, odom_frame=odom_frame, radius_m=given["radius"], recover=recover, **asked)


def choose_condition_of_run(
    given: Mapping[str, Any], source: Path | None, options: BagOptions, model: Model
) -> MapCondition | None:
    """Return the map condition for the corruption of a bag, None if no map is named; a source of None is a pipe.

    Raises
    ------
    click.UsageError
        If a pipe would have to be read twice, or --keep-localisation leaves no noise for the map to constrain.
    MapError
        If the map cannot be read, or the pose of odom in it is unknown.
    """
    name = given["map_"]
    if name is None:
        return choose_condition(given, source, "")
    from odomcorrupt.api.bag_options import split_options
    from odomcorrupt.mapping.conditioned import is_map_file, read_odom_frame

    moved, _ = split_options(options)
    if moved.keep_localisation:
        raise click.UsageError(
            "--map and --keep-localisation: with map -> base kept true the drift does not move the robot in the map; "
            "leave out one"
        )
    if source is None and (given["map_pose"] is None or not is_map_file(name)):
        raise click.UsageError(
            f"--map {name}: INPUT is a pipe and read once; name a map's .yaml, and give the pose of odom in it with "
            "--map-pose"
        )
    frame = ""
    if source is not None and given["map_pose"] is None:
        frame = read_odom_frame(source, moved, model.motion_model.odometry_topic, recover=given["recover"])
    return choose_condition(given, source, frame, recover=given["recover"])
