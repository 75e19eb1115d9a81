"""Descriptions of the physical effects, and of the ready-made noise models."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from odomcorrupt.api.result import Result
from odomcorrupt.effects import effect_named, registry
from odomcorrupt.effects.effect import amplitudes, choices, parameters
from odomcorrupt.model.presets import PRESETS
from odomcorrupt.report.plain import picked
from odomcorrupt.summary import Line, Summary, command_line

if TYPE_CHECKING:
    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.model.presets import Preset

_FAMILIES = {"effect": "SYSTEMATIC", "setup": "setup", "event": "event", "noise": "random"}
"""Labels of the kinds of effects, in order of listing."""
_LEGEND = """
effect: systematic; setup: of the measurement, not of the robot; noise: random
odomcorrupt effects NAME explains one"""


@dataclass(frozen=True, slots=True, repr=False)
class EffectList(Result):
    """The physical effects that make odometry depart from the truth.

    kinds : classes of the effects, by name
    """

    kinds: dict[str, type[Effect]]

    def summary(self) -> Summary:
        """Return the names by kind."""
        kinds = self.kinds.values()
        lines = [Line(label, ", ".join(k.name for k in kinds if k.kind == kind)) for kind, label in _FAMILIES.items()]
        return Summary((*lines, command_line("odomcorrupt effects NAME, or -v for all in words")), most=20)

    def details(self) -> str:
        """Return a table of names, kinds and meanings."""
        width = max(map(len, self.kinds))
        rows = [f"{n:<{width}}  {k.kind:<6}  {k.summary}" for n, k in self.kinds.items()]
        return "\n".join([*rows, _LEGEND])

    def _values(self) -> dict[str, Any]:
        return {"effects": self.rows()}

    def rows(self) -> list[dict[str, Any]]:
        """Return name, kind and meaning of every effect."""
        return [{"name": n, "kind": k.kind, "summary": k.summary} for n, k in self.kinds.items()]


@dataclass(frozen=True, slots=True, repr=False)
class EffectDescription(Result):
    """An effect: its equation, its parameters, its source, and what it can be confused with.

    kind : class of the effect
    """

    kind: type[Effect]

    def summary(self) -> Summary:
        """Return the meaning of the effect and of its parameters, and a command that applies it to a bag."""
        kind, own = self.kind, parameters(self.kind)
        lines = [Line(kind.name, f"{kind.summary} ({kind.kind})", "good")]
        for p in own:
            unit = f" {p.unit}" if p.unit else ""
            said = f"{p.meaning}; typically {p.typical:g}{unit}"
            shape = "" if p.amplitude else f"; {p.identity:g}{unit} if not given"
            lines.append(Line(p.name, said, full=f"{said}, from {p.low:g} to {p.high:g}{shape}"))
        lines += [Line(word, " or ".join(options)) for word, options in choices(kind).items()]
        if kind.aliased_with is not None:
            lines.append(Line("alias", f"{kind.aliased_with}: no recording of poses separates them"))
        if kind.about is not None:
            about, more = kind.about, {"typical": kind.about.typical, "shown by": kind.about.drive}
            more["confused with"] = ", ".join(about.confused_with)
            lines += [Line("adds", about.equation, full=f"{about.equation} (truth minus odometry)")]
            lines += [Line("source", about.source), *(Line(label, "", full=text) for label, text in more.items())]
        if kind.needs_track:
            track = ", or its parameter track" * any(p.name == "track" for p in own)
            needs = f"the distance between the wheels: --track, or [robot] track in a model file{track}"
            lines.append(Line("needs", "", full=needs))
        if kind.drives is not None:
            lines.append(Line("robots", "", full=f"of the drive types {', '.join(sorted(kind.drives))}"))
        if kind.needs_sideways:
            lines.append(Line("robots", "", full="that drive sideways, on mecanum or other omnidirectional wheels"))
        values = ",".join(f"{p.name}={p.typical:g}" for p in amplitudes(kind))
        return Summary((*lines, command_line(f"odomcorrupt in.bag out.bag --effect {kind.name}:{values}")))

    def _values(self) -> dict[str, Any]:
        kind, names = self.kind, ("equation", "typical", "source", "confused_with", "drive")
        return {
            **picked(kind, "name", "kind", "summary", "needs_gyro", "needs_track", "needs_sideways"),
            **(picked(kind.about, *names) if kind.about else dict.fromkeys(names) | {"confused_with": []}),
            "parameters": self.rows(),
            "words": choices(kind),
            "twin_of": kind.aliased_with,
            "drive_types": sorted(kind.drives) if kind.drives is not None else None,
        }

    def rows(self) -> list[dict[str, Any]]:
        """Return the parameters: meaning, unit, range, typical value, value if not given, and role."""
        return [
            picked(p, "name", "meaning", "unit", "low", "high", "typical")
            | {"default": p.identity, "role": "amplitude" if p.amplitude else "shape"}
            for p in parameters(self.kind)
        ]


@dataclass(frozen=True, slots=True, repr=False)
class PresetList(Result):
    """Ready-made models with law, numbers, ranges and source; `Model.preset` returns one of them."""

    presets: tuple[Preset, ...]

    def summary(self) -> Summary:
        """Return the names: robots, qualities of a differential drive, and noise without a range."""
        kinds: dict[str, list[str]] = {"robots": [], "qualities": [], "noise": []}
        for p in self.presets:
            kinds["noise" if not p.spread else "robots" if p.marks else "qualities"].append(p.name)
        count = f"{len(self.presets)} models; -v has their numbers, ranges and sources"
        lines = [Line("PRESETS", count), *(Line(kind, ", ".join(names)) for kind, names in kinds.items())]
        lines.append(Line("use", "odomcorrupt batch in.mcap runs/ --runs 40 --preset rosbot"))
        return Summary((*lines, command_line("odomcorrupt presets rosbot > robot.toml")))

    def details(self) -> str:
        """Return law, numbers, ranges and source of each."""
        lines = []
        for row in self._presets():
            ranges = row["ranges"]
            numbers = "  ".join(
                f"{key} {value:.4g}" + (f" +- {ranges[key]:.2g}" if key in ranges else "")
                for key, value in (row["coefficients"] | {k: 0.0 for k in ranges if "." in k}).items()
            )
            lines.append(f"{row['name']}\n  law {row['law']}: {numbers}\n  {row['source']}\n")
        use = "odomcorrupt INPUT OUTPUT --preset NAME uses it; odomcorrupt presets NAME > robot.toml writes a file"
        return "\n".join([*lines, use])

    def _values(self) -> dict[str, Any]:
        return {"presets": self._presets()}

    def rows(self) -> list[dict[str, Any]]:
        """Return the presets, with a column for every coefficient."""
        return [{**row, **row.pop("coefficients"), "ranges": len(row["ranges"])} for row in self._presets()]

    def _presets(self) -> list[dict[str, Any]]:
        """Return name, law, coefficients, ranges and source of each."""
        return [
            picked(p, "name", "track_m", "drive_type", "source", law="noise.law_name", ranges="spread")
            | {"coefficients": {k: v for k, v in numbers.items() if v or k in p.noise.law.alphas}}
            for p in self.presets
            for numbers in [asdict(p.noise.coefficients)]
        ]


def list_effects() -> EffectList:
    """Return the physical effects of the library: systematic, of the set-up, events and random ones.

    Returns
    -------
    EffectList
        `rows()` and `to_pandas()` have name, kind and meaning of each.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> [row["name"] for row in oc.list_effects().rows() if row["kind"] == "event"]
    ['latency', 'odometry_stop', 'push', 'slip_event']
    """
    return EffectList(dict(registry()))


def describe_effect(name: str) -> EffectDescription:
    """Return equation, parameters, typical size and source of an effect, and what it can be confused with.

    name : name of the effect, as in `list_effects`

    Returns
    -------
    EffectDescription
        `rows()` and `to_pandas()` have the parameters.

    Raises
    ------
    EffectError
        If there is no such effect.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> oc.describe_effect("gyro_scale").to_dict()["twin_of"]
    'wheelbase'
    """
    return EffectDescription(effect_named(name))


def list_presets() -> PresetList:
    """Return the ready-made models with law, numbers, ranges and source.

    Returns
    -------
    PresetList
        `rows()` and `to_pandas()` have one row for each; `Model.preset(name)` returns one as a model.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> [row["name"] for row in oc.list_presets().rows()][:2]
    ['typical', 'turtlebot3-burger']
    """
    return PresetList(tuple(PRESETS.values()))
