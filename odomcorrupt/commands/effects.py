"""odomcorrupt effects: descriptions of the causes of odometry errors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.commands._standard import Console, standard_options
from odomcorrupt.report.json.numbers import picked
from odomcorrupt.summary import Line, Summary, command_line

if TYPE_CHECKING:
    from collections.abc import Mapping

    from odomcorrupt.effects.effect import Effect, Parameter


@click.command("effects", short_help="List the physical effects, or explain one.")
@click.argument("name", required=False)
@standard_options
def command(name: str | None, *, console: Console) -> None:
    """List the physical effects that make odometry depart from the truth, or explain one of them.

    --effect NAME:parameter=value adds an effect to a bag, diagnose tests for it, and correct removes it.

    \b
    An effect of your own is an expression in a model file, a rate added to truth minus odometry:
      [[effect]]
      name = "my_bumps"
      expression = "yaw += k * v * abs(omega)"
      k = 0.01
    channels    along, across (m/s), yaw (rad/s); several statements with ; between
    wheels      left, right, wheels (m/s of the rim): v, a, x and y are then the wheel's own
    variables   v, vy, omega, a, alpha, t, x, y, theta, distance, pi, and your parameters
    functions   sin cos tan exp log sqrt tanh abs sign atan2 hypot min max where(a > b, yes, no)
    """  # noqa: D301 - click wants a real backspace
    from odomcorrupt.effects import effect_named, registry

    if name is not None:
        kind = effect_named(name)
        console.print(_brief_page(kind), _page(kind), _facts(kind))
        return
    kinds = registry()
    effects = [{"name": n, "kind": k.kind, "summary": k.summary} for n, k in kinds.items()]
    width = max(map(len, kinds))
    rows = [f"{n:<{width}}  {k.kind:<6}  {k.summary}" for n, k in kinds.items()]
    console.print(_brief(kinds), "\n".join([*rows, _LEGEND]), {"schema": 2, "effects": effects})


_LEGEND = """
effect: systematic; setup: of the measurement, not of the robot; noise: random
odomcorrupt effects NAME explains one"""
_FAMILIES = {"effect": "SYSTEMATIC", "setup": "setup", "event": "event", "noise": "random"}
"""Labels of the kinds of effects, in order of listing."""


def _brief(kinds: Mapping[str, type[Effect]]) -> Summary:
    """Return the names by kind."""
    names = {label: ", ".join(n for n, one in kinds.items() if one.kind == kind) for kind, label in _FAMILIES.items()}
    lines = [Line(label, text) for label, text in names.items()]
    return Summary((*lines, command_line("odomcorrupt effects NAME, or -v for all in words")), most=20)


def _brief_page(kind: type[Effect]) -> Summary:
    """Return an effect's description, its parameters, and a command that applies it to a bag."""
    from odomcorrupt.effects.effect import choices, parameters

    lines = [Line(kind.name, f"{kind.summary} ({kind.kind})", "good")]
    own = parameters(kind)
    lines += [Line(p.name, f"{p.meaning}; typically {p.typical:g} {p.unit}".rstrip()) for p in own]
    lines += [Line(word, " or ".join(options)) for word, options in choices(kind).items()]
    if kind.aliased_with is not None:
        lines.append(Line("alias", f"{kind.aliased_with}: no recording of poses separates them"))
    if kind.about is not None:
        lines += [Line("adds", kind.about.equation), Line("source", kind.about.source)]
    return Summary((*lines, command_line(_example(kind))))


def _example(kind: type[Effect]) -> str:
    """Return a command that applies an effect of typical size to a bag."""
    from odomcorrupt.effects.effect import amplitudes

    values = ",".join(f"{p.name}={p.typical:g}" for p in amplitudes(kind))
    return f"odomcorrupt in.bag out.bag --effect {kind.name}:{values}"


def _facts(kind: type[Effect]) -> dict[str, Any]:
    from odomcorrupt.effects.effect import choices, parameters

    about = kind.about
    return {
        "schema": 2,
        **picked(kind, "name", "kind", "summary"),
        "equation": about.equation if about else None,
        "parameters": [
            picked(p, "name", "meaning", "unit", "low", "high", "typical")
            | {"default": p.identity, "role": "amplitude" if p.amplitude else "shape"}
            for p in parameters(kind)
        ],
        "words": {word: list(options) for word, options in choices(kind).items()},
        "typical": about.typical if about else None,
        "source": about.source if about else None,
        "confused_with": list(about.confused_with) if about else [],
        "twin_of": kind.aliased_with,
        "drive": about.drive if about else None,
        "drive_types": sorted(kind.drives) if kind.drives is not None else None,
        **picked(kind, "needs_gyro", "needs_track", "needs_sideways"),
    }  # fmt: skip


def _page(kind: type[Effect]) -> str:
    from odomcorrupt.effects.effect import choices, parameters

    own = parameters(kind)
    lines = [f"{kind.name} ({kind.kind}): {kind.summary}", ""]
    if kind.about is not None:
        lines += [f"truth minus odometry:  {kind.about.equation}", ""]
    lines.append("parameters")
    lines += [f"  {p.name:<12} {p.meaning}; {_range(p)}" for p in own]
    lines += [f"  {word:<12} {' or '.join(options)}" for word, options in choices(kind).items()]
    if kind.needs_track:
        own_track = ", or its parameter track" if any(p.name == "track" for p in own) else ""
        lines.append(f"  needs the distance between the wheels: --track, or [robot] track in a model file{own_track}")
    if kind.drives is not None:
        lines.append(f"  for the drive types {', '.join(sorted(kind.drives))}")
    if kind.needs_sideways:
        lines.append("  for robots that can drive sideways, on mecanum or other omnidirectional wheels")
    if kind.about is not None:
        lines += ["", f"typical        {kind.about.typical}", f"source         {kind.about.source}"]
        lines += [f"confused with  {', '.join(kind.about.confused_with)}", f"shown by       {kind.about.drive}"]
    if kind.aliased_with is not None:
        lines.append(f"alias          {kind.aliased_with}: the same motion; no recording of poses can separate them")
    return "\n".join([*lines, "", _example(kind)])


def _range(p: Parameter) -> str:
    unit = f" {p.unit}" if p.unit else ""
    shape = "" if p.amplitude else f"; {p.identity:g}{unit} if not given"
    return f"typically {p.typical:g}{unit}, from {p.low:g} to {p.high:g}{shape}"
