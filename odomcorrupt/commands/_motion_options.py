"""Options that say which motion to draw, with which noise; shared by `sample` and `density`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.commands._model import MODEL_OPTIONS, choose_model, model_options
from odomcorrupt.commands._poses import POSE

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from odomcorrupt.api.model import Model

__all__ = ["ARTICLE_CODE", "MODEL_OPTIONS", "ChosenMove", "choose_move", "choose_noise", "move_options"]

ARTICLE_CODE = "article-code"


@dataclass(frozen=True, slots=True)
class ChosenNoise:
    """A model, and whether the article's listing is imitated."""

    model: Model
    article_code: bool


@dataclass(frozen=True, slots=True)
class ChosenMove:
    """A motion (poses before and after it, metres and radians) with its noise, and how many samples to draw."""

    noise: ChosenNoise
    start_xyt: tuple[float, ...]
    end_xyt: tuple[float, ...]
    count: int


def move_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of `choose_move`."""
    for option in (
        click.option("-n", "--samples", "count", type=click.IntRange(2, 10_000_000), help="[default: the example's]"),
        click.option("--end", type=POSE, help="Odometry after the motion, as in 0.2,0.35,10deg."),
        click.option("--start", type=POSE, help="Odometry before the motion, as in 0,0,30deg."),
        click.option(
            "--example",
            metavar="NAME",
            help="Motion and noise: article, or the lecture's balanced, translation-heavy, rotation-heavy. "
            "[default: article]",
        ),
        model_options,
    ):
        command = option(command)
    return command


def choose_noise(given: Mapping[str, Any], example: str | None) -> ChosenNoise:
    """Return the noise the options describe; with no numbers at all, that of an example.

    `--law article-code` is the article's law with its listing's mistake.
    """
    from odomcorrupt.api.model import Model
    from odomcorrupt.model.motion_model import MotionModel
    from odomcorrupt.sampling.samples import DEFAULT_EXAMPLE, example_named

    options: dict[str, Any] = {name: given.get(name) for name in MODEL_OPTIONS}
    article_code = options["law"] == ARTICLE_CODE
    if article_code:
        options["law"] = "linear" if options["alpha"] else None
    numbers = [name for name in ("alpha", "preset", "effects", "model", "twist_noise") if options[name]]
    if numbers and example is not None:
        raise click.UsageError(f"--example {example} brings its own noise; leave out the other numbers")
    if numbers or options["law"]:
        chosen = choose_model(**options)
        return ChosenNoise(chosen, article_code)
    chosen_example = example_named(example or DEFAULT_EXAMPLE)
    noise = chosen_example.noise
    if options["step"] is not None:
        from dataclasses import replace

        from odomcorrupt.model.motion_model import Step

        noise = replace(noise, step=Step.parse(options["step"]))
    return ChosenNoise(Model.of(MotionModel(noise), chosen_example.source), article_code)


def choose_move(given: Mapping[str, Any]) -> ChosenMove:
    """Return the motion and the noise that the options describe."""
    import numpy as np

    from odomcorrupt.errors import ModelError
    from odomcorrupt.geometry.se2 import between, compose
    from odomcorrupt.sampling.samples import DEFAULT_EXAMPLE, example_named

    try:
        example = example_named(given["example"] or DEFAULT_EXAMPLE)
        noise = choose_noise(given, given["example"])
    except ModelError as error:
        raise click.UsageError(str(error)) from error
    if noise.model.effects:
        raise click.UsageError("effects act along a drive, one motion has no time: name a bag, or leave --effect out")
    first, last = np.array(example.start_xyt), np.array(example.end_xyt)
    if given["end"] is not None:
        # a motion of the user's own begins at the origin unless it says otherwise
        first, last = np.zeros(3), np.array(given["end"])
    start = first if given["start"] is None else np.array(given["start"])
    # with a start alone, the example's motion is made from there
    end = last if given["end"] is not None else compose(start, between(first, last))
    return ChosenMove(noise, tuple(start.tolist()), tuple(end.tolist()), given["count"] or example.count)
