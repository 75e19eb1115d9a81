"""Model files: motion models as editable TOML (schema 1 of docs/model-file.md), and effects written as text.

Reading executes no code and opens no other file.
"""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, Any, NamedTuple

from odomcorrupt.drive_types import DRIVE_TYPES
from odomcorrupt.effects import effect_at, effect_from_values, effect_named, effect_of, registry
from odomcorrupt.effects.effect import amplitudes, choices, parameters
from odomcorrupt.errors import EffectError, ModelError
from odomcorrupt.input_files import TOML_BYTES, parse_toml, read_input
from odomcorrupt.model.correlation import Correlation
from odomcorrupt.model.motion_model import MotionModel, Noise, Origin, Setup, Step, TruthNoise, parse_alpha
from odomcorrupt.model.noise_laws import Coefficients

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from odomcorrupt.effects.effect import Effect


_PERCENT = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*%\s*\Z")


class WrittenEffect(NamedTuple):
    """A parsed effect, with the values that were assumed for parameters not given.

    assumed : typical sizes that were used, as in "curvature 0.005 1/m"; "" if sizes were given
    """

    effect: Effect
    assumed: str


def parse_effect(text: str) -> WrittenEffect:
    """Return the effect written as NAME or NAME:key=value,key=value; NAME is in the library or is module.Class.

    Values are numbers, percentages for parameters without unit (1%), or angles (5deg). If no amplitude is given, the
    typical one is used.

    Raises
    ------
    EffectError
        If the name or a parameter is unknown, or a value is invalid.
    """
    name, _, rest = text.partition(":")
    name = name.strip()
    if "=" in name:
        known, _, value = name.partition("=")
        key = parameters(effect_named(known))[0].name
        raise EffectError(f"effect {text}: parameters follow a colon and a name; write {known}:{key}={value}")
    kind = effect_at(name) if "." in name else effect_named(name)
    words = choices(kind)
    units = {p.name: p.unit for p in parameters(kind)}
    values: dict[str, float | str] = {}
    for part in rest.split(",") if rest else ():
        key, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals:
            raise EffectError(f"effect {text}: {part!r} is not key=number; write as in wheel_scale:e=0.01")
        values[key] = value if key in words else _value_of(text, part, value, units.get(key, ""))
    typical = {p.name: p.typical for p in amplitudes(kind)}
    if typical.keys().isdisjoint(values):
        assumed = ", ".join(f"{p.name} {p.typical:g} {p.unit}".strip() for p in amplitudes(kind))
        return WrittenEffect(effect_of(kind, {**typical, **values}), assumed)
    return WrittenEffect(effect_of(kind, values), "")


def _value_of(text: str, part: str, value: str, unit: str) -> float:
    percent = _PERCENT.match(value)
    if percent is not None:
        if unit:
            raise EffectError(
                f"effect {text}: {part!r} is a share, but the parameter has the unit {unit}; write a number"
            )
        return float(percent[1]) / 100.0
    try:
        return parse_alpha(value)
    except ModelError:
        raise EffectError(f"effect {text}: {part!r} is not key=number; write as in wheel_scale:e=0.01") from None


SCHEMA = 1
_MOST_EFFECTS = 64
"""Largest number of effects in a file; no fit has more, and each acts on every message."""
_COEFFICIENTS = {
    "rot_rot": "rad per sqrt(rad)",
    "rot_trans": "rad per sqrt(m)",
    "trans_trans": "m per sqrt(m)",
    "trans_rot": "m per sqrt(rad)",
    "across_trans": "m per sqrt(m)",
    "end_trans": "of the law velocity",
    "end_rot": "of the law velocity",
    "white_v": "m/s",
    "white_omega": "rad/s",
    "rot_time": "rad per sqrt(s)",
}
_REQUIRED = ("rot_rot", "rot_trans", "trans_trans", "trans_rot")
_TRUTH = {"truth_xy": "xy_m", "truth_yaw": "yaw_rad", "truth_wander": "random_walk"}
_ORIGIN = {"latitude": "latitude_deg", "longitude": "longitude_deg", "altitude": "altitude_m"}
_SPREAD = re.compile(r"\s*(\S+)\s*(?:\+-|±)\s*(\S+)\s*")


def read_model(path: Path) -> MotionModel:
    """Return the model in a file; a ModelError describes the first fault in one line."""
    text = read_model_text(path)
    try:
        return parse_model(text)
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from error


def read_model_text(path: Path) -> str:
    """Return the text of a model file, unparsed."""
    try:
        return read_input(path, TOML_BYTES, "model file", ModelError).decode()
    except UnicodeDecodeError as error:
        raise ModelError(f"{path}: not a text file, so not a model file") from error


def parse_model(text: str) -> MotionModel:
    """Return the model written in TOML text."""
    try:
        table = parse_toml(text)
    except ValueError as error:
        raise ModelError(f"not valid TOML ({error})") from error
    _only(table, ("schema", "noise", "effect", "robot", "setup", "source", "fit"), "the file")
    if table.get("schema") != SCHEMA:
        raise ModelError(f"schema: {table.get('schema')!r}; this version reads schema = {SCHEMA}")
    errors: dict[str, float] = {}
    noise = _noise(_table(table, "noise"), errors)
    effects = _effects(table.get("effect", []), errors)
    fit = _table(table, "fit")
    _only(fit, ("correlation",), "[fit]")
    correlation = Correlation.from_table(_table(fit, "correlation"), dict(errors))
    robot = _table(table, "robot")
    _only(robot, ("track", "wheel_radius"), "[robot]")
    track = _number(robot["track"], "robot.track")[0] if "track" in robot else None
    if track is not None and not 0.0 < track < 100.0:
        raise ModelError(f"robot.track: {track}; it must be the distance between the wheels in metres, more than zero")
    return MotionModel(
        noise, effects, track, _setup(_table(table, "setup"), errors), errors, _source(_table(table, "source")),
        correlation,
    )  # fmt: skip


def _noise(table: Mapping[str, Any], errors: dict[str, float]) -> Noise:
    _only(table, ("law", "step", *_COEFFICIENTS), "[noise]")
    values = {}
    for name in _COEFFICIENTS:
        if name not in table and name in _REQUIRED:
            raise ModelError(f"[noise]: {name} is missing; write 0 where there is none")
        values[name] = _measured(table.get(name, 0.0), name, errors)
    step = table.get("step", "message")
    return Noise(str(table.get("law", "diffusion")), Coefficients(**values), Step.parse(str(step)))


def _effects(items: Any, errors: dict[str, float]) -> tuple[Effect, ...]:
    if not isinstance(items, list) or not all(isinstance(item, dict) for item in items):
        raise ModelError("effect: it must be a list of tables; write [[effect]]")
    if len(items) > _MOST_EFFECTS:
        raise ModelError(f"effect: there are {len(items)}; {_MOST_EFFECTS} at most")
    return tuple(_effect(item, errors) for item in items)


def _effect(item: Mapping[str, Any], errors: dict[str, float]) -> Effect:
    name = item.get("name")
    if not isinstance(name, str):
        raise ModelError('[[effect]]: it has no name; write name = "wheelbase" or another one')
    kinds = registry()
    if "expression" in item:
        return _user_effect(name, item, errors)
    units = {p.name: p.unit for p in parameters(kinds[name])} if name in kinds else {}
    words = choices(kinds[name]) if name in kinds else {}
    values = {
        key: str(value) if key in words else _measured(value, f"{name}.{key}", errors, units.get(key))
        for key, value in item.items()
        if key != "name"
    }
    return effect_from_values(name, values)


def _user_effect(name: str, item: Mapping[str, Any], errors: dict[str, float]) -> Effect:
    from odomcorrupt.effects.expression import user_effect  # noqa: PLC0415 - corruption by noise alone needs no effect

    text = item["expression"]
    if name in registry():
        raise ModelError(f"[[effect]] {name}: the library has an effect of that name; give the expression another one")
    if not isinstance(text, str):
        raise ModelError(f'[[effect]] {name}: expression: {text!r}; write text, as in "yaw += k * v"')
    words = {"heading": str(item["heading"])} if "heading" in item else {}
    numbers = {key: value for key, value in item.items() if key not in ("name", "expression", *words)}
    values = {key: _measured(value, f"{name}.{key}", errors) for key, value in numbers.items()}
    units = {key: str(value.get("unit", "")) for key, value in numbers.items() if isinstance(value, dict)}
    return user_effect(name, text, values, units, words)


def _setup(table: Mapping[str, Any], errors: dict[str, float]) -> Setup:
    _only(table, ("drive_type", "pose_corrections", *_TRUTH, "origin", "effect", "clock"), "[setup]")
    drive_type = table.get("drive_type", "")
    if drive_type and drive_type not in DRIVE_TYPES:
        raise ModelError(f"setup.drive_type: {drive_type!r}; write {', '.join(DRIVE_TYPES[:-1])} or {DRIVE_TYPES[-1]}")
    pose_corrections = table.get("pose_corrections", False)
    if not isinstance(pose_corrections, bool):
        raise ModelError(f"setup.pose_corrections: {pose_corrections!r}; write true or false")
    known = {field: _number(table[key], key)[0] for key, field in _TRUTH.items() if key in table}
    if any(value < 0.0 for value in known.values()):
        raise ModelError("[setup]: noise of the truth below zero")
    clocks = {}
    items = table.get("clock", [])
    if not isinstance(items, list) or not all(isinstance(item, dict) for item in items):
        raise ModelError("setup.clock: it must be a list of tables; write [[setup.clock]]")
    for item in items:
        _only(item, ("recording", "time_offset", "clock_skew"), "[[setup.clock]]")
        clocks[str(item.get("recording", ""))] = (
            _number(item.get("time_offset", 0.0), "time_offset")[0],
            _number(item.get("clock_skew", 0.0), "clock_skew")[0],
        )
    truth = TruthNoise(**known) if known else None
    origin = _origin(_table(table, "origin"))
    return Setup(_effects(table.get("effect", []), errors), truth, clocks, origin, drive_type, pose_corrections)


def _origin(table: Mapping[str, Any]) -> Origin | None:
    _only(table, _ORIGIN, "setup.origin")
    if not table:
        return None
    for key in ("latitude", "longitude"):
        if key not in table:
            raise ModelError(f"setup.origin: {key} is missing; write degrees")
    return Origin(**{_ORIGIN[key]: _number(value, f"setup.origin.{key}")[0] for key, value in table.items()})


def _source(table: Mapping[str, Any]) -> Mapping[str, str | float | list[str]]:
    plain: dict[str, str | float | list[str]] = {}
    for key, value in table.items():
        texts = isinstance(value, list) and all(isinstance(item, str) for item in value)
        if texts or isinstance(value, (str, int, float)):
            plain[key] = value
        else:
            raise ModelError(f"source.{key}: write text, a number or a list of texts")
    return plain


def _measured(value: Any, key: str, errors: dict[str, float], unit: str | None = None) -> float:
    """Return a value; its standard error, if given, is stored in `errors`."""
    if isinstance(value, dict):
        _only(value, ("value", "standard_error", "unit"), key)
        if "value" not in value:
            raise ModelError(f"{key}: no value in it; write {{ value = 0.01, standard_error = 0.001 }}")
        if unit is not None and value.get("unit", unit) != unit:
            raise ModelError(f"{key}: unit {value['unit']!r}; it is given in {unit or 'no unit'}")
        if "standard_error" in value:
            errors[key] = _number(value["standard_error"], f"{key}.standard_error")[0]
        value = value["value"]
    number, spread = _number(value, key)
    if spread is not None:
        errors[key] = spread
    return number


def _number(value: Any, key: str) -> tuple[float, float | None]:
    """Return a number and its standard error or None, from 0.01, "5deg" or "0.004 +- 0.001"."""
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) > 1 << 62:
        raise ModelError(f"{key}: an integer of {value.bit_length()} bits; write a number that a robot can have")
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return float(value), None
    if isinstance(value, str):
        match = _SPREAD.fullmatch(value)
        try:
            return (parse_alpha(match[1]), abs(parse_alpha(match[2]))) if match else (parse_alpha(value), None)
        except ModelError:
            pass
    raise ModelError(f'{key}: {value!r}; write a number, an angle as in "5deg", or a spread as in "0.004 +- 0.001"')


def _table(table: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    value = table.get(key, {})
    if not isinstance(value, dict):
        raise ModelError(f"{key}: it must be a table; write [{key}]")
    return value


def _only(table: Mapping[str, Any], known: Iterable[str], where: str) -> None:
    for key in table:
        if key not in known:
            raise ModelError(f"{where}: unknown key {key!r}; known are {', '.join(known)}")


def format_model(model: MotionModel) -> str:
    """Return a model as TOML text; parsing it gives the same model to nine digits."""
    errors = model.standard_errors
    lines = [
        "# Motion model for odomcorrupt; it can be edited by hand.",
        f"schema = {SCHEMA}",
        "",
        "[noise]",
        f"law = {_text(model.noise.law_name)}",
    ]
    if model.noise.step is not None:
        lines.append(f"step = {_text(str(model.noise.step))}")
    diffusion = model.noise.law_name == "diffusion"
    for name, unit in _COEFFICIENTS.items():
        value = getattr(model.noise.coefficients, name)
        if name in _REQUIRED or value:
            lines.append(f"{name} = {_value(value, errors.get(name))}" + (f"  # {unit}" if diffusion else ""))
    for effect in model.effects:
        lines += ["", "[[effect]]", *_effect_lines(effect, errors)]
    if model.track_m is not None:
        lines += ["", "[robot]", f"track = {_figure(model.track_m)}  # m"]
    lines += _setup_lines(model.setup, errors)
    lines += model.correlation.among(_drawn(model)).lines()
    if model.source:
        lines += ["", "[source]"]
        for key, entry in model.source.items():
            lines.append(f"{key} = {_figure(entry) if isinstance(entry, (int, float)) else _text(entry)}")
    return "\n".join(lines) + "\n"


def _drawn(model: MotionModel) -> list[str]:
    """Return the noise and effect parameters that have a standard error, in the file's order."""
    names = [*_COEFFICIENTS, *(f"{effect.name}.{p.name}" for effect in model.effects for p in parameters(effect))]
    return [name for name in dict.fromkeys(names) if name in model.standard_errors]


def _setup_lines(setup: Setup, errors: Mapping[str, float]) -> list[str]:
    if setup == Setup():
        return []
    lines = ["", "# properties of the measurement, not of the robot: corruption ignores them", "[setup]"]
    if setup.drive_type:
        lines.append(f"drive_type = {_text(setup.drive_type)}")
    if setup.pose_corrections:
        lines.append(
            "pose_corrections = true  # learned without its filter's steps towards poses, which `correct` takes out"
        )
    if setup.truth is not None:
        units = {"truth_xy": "m", "truth_yaw": "rad", "truth_wander": "m per sqrt(s)"}
        lines += [f"{key} = {_figure(getattr(setup.truth, field))}  # {units[key]}" for key, field in _TRUTH.items()]
    if setup.origin is not None:
        place = ", ".join(f"{key} = {_figure(getattr(setup.origin, field), 12)}" for key, field in _ORIGIN.items())
        lines.append(f"origin = {{ {place} }}  # deg, deg, m: places of effects are metres east and north of it")
    for effect in setup.effects:
        lines += ["", "[[setup.effect]]", *_effect_lines(effect, errors)]
    for recording, (offset, rate) in setup.clocks.items():
        lines += ["", "[[setup.clock]]", f"recording = {_text(recording)}"]
        lines += [f"time_offset = {_figure(offset)}  # s", f"clock_skew = {_figure(rate)}"]
    return lines


def _effect_lines(effect: Effect, errors: Mapping[str, float]) -> list[str]:
    from odomcorrupt.effects.expression import UserEffect  # noqa: PLC0415 - as above

    lines = [f"name = {_text(effect.name)}  # {effect.summary}"]
    if isinstance(effect, UserEffect):
        lines.append(f"expression = {_text(effect.expression.text)}")
    lines += [f"{word} = {_text(getattr(effect, word))}" for word in choices(effect)]
    for p in parameters(effect):
        error = errors.get(f"{effect.name}.{p.name}")
        value, unit = getattr(effect, p.name), p.unit
        if isinstance(effect, UserEffect) and unit and error is None:  # the unit is stored nowhere else
            lines.append(f"{p.name} = {{ value = {_figure(value)}, unit = {_text(unit)} }}")
        else:
            lines.append(f"{p.name} = {_value(value, error, unit)}")
    return lines


def _value(value: float, error: float | None, unit: str = "") -> str:
    if error is None:
        return _figure(value)
    parts = [f"value = {_figure(value)}", f"standard_error = {_figure(error, 3)}"]
    if unit:
        parts.append(f"unit = {_text(unit)}")
    return f"{{ {', '.join(parts)} }}"


def _figure(value: float, digits: int = 9) -> str:
    """Return a TOML float (or integer) with a given number of significant digits."""
    if isinstance(value, int):
        return str(value)
    text = f"{value:.{digits}g}"
    return text if re.search(r"[.en]", text) else f"{text}.0"


def _text(value: str | list[str]) -> str:
    return json.dumps(value, ensure_ascii=True)
