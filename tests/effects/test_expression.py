"""Effects as expressions, of the registry, of another package and of the command line, and all that is refused."""

import dataclasses
import importlib.metadata
import json
import pickle
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
import test_contract  # noqa: F401 - whole before it is an entry point
from click.testing import CliRunner
from manoeuvres import motion

from odomcorrupt.bags.open import open_reader
from odomcorrupt.cli import cli, run
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.effects.compensation import error_of
from odomcorrupt.effects.effect import amplitudes, parameters
from odomcorrupt.effects.expression import parse_expression, user_effect
from odomcorrupt.errors import EffectError, ModelError
from odomcorrupt.inspection import scan_bag
from odomcorrupt.model.model_file import format_model, parse_model
from recordings import FIXTURES

HEAD = 'schema = 1\n[noise]\nlaw = "diffusion"\nrot_rot=0\nrot_trans = 0\ntrans_trans=0\ntrans_rot = 0\n[[effect]]\n'


def rates(text, **values):
    drive = motion(np.linspace(-0.5, 0.7, 50), np.linspace(-1.0, 1.0, 50))
    return drive, error_of(user_effect("mine", text, values), drive)


@pytest.mark.parametrize(
    ("text", "column", "expected"),
    [
        ("yaw += k * v * abs(omega)", 2, lambda m, k: k * m.v * np.abs(m.omega)),
        ("along += -k * abs(v) * a", 0, lambda m, k: -k * np.abs(m.steady_v) * m.a),
        ("across += k*alpha", 1, lambda m, k: k * m.alpha),
        ("along += k * v**2 / 2 - 3*k*v", 0, lambda m, k: k * m.v**2 / 2 - 3 * k * m.v),
        ("yaw += k * where(v < 0, 1, 2 * omega)", 2, lambda m, k: k * np.where(m.v < 0, 1.0, 2 * m.omega)),
        ("yaw += k * min(v, 0.2, omega)", 2, lambda m, k: k * np.minimum(np.minimum(m.v, 0.2), m.omega)),
        ("yaw += k * max(v, t)", 2, lambda m, k: k * np.maximum(m.v, m.t_s)),
        ("along += k * sqrt(abs(v)) * sign(v)", 0, lambda m, k: k * np.sqrt(np.abs(m.v)) * np.sign(m.v)),
        ("along += k * exp(-t) * tanh(x)", 0, lambda m, k: k * np.exp(-m.t_s) * np.tanh(m.x)),
        ("along += k*cos(theta - pi/4)*(y > 0.01)", 0, lambda m, k: k * np.cos(m.theta - np.pi / 4) * (m.y > 0.01)),
        ("yaw += k * sin(2 * pi * distance / 0.63)", 2, lambda m, k: k * np.sin(2 * np.pi * m.distance / 0.63)),
        ("along += k * hypot(v, vy) * +omega", 0, lambda m, k: k * np.abs(m.v) * m.omega),
        ("along += k * (2 + atan2(omega, 1)) ** -1", 0, lambda m, k: k / (2.0 + np.arctan2(m.omega, 1.0))),
    ],
)  # fmt: skip
def test_an_expression_means_what_it_says(text, column, expected):
    drive, f = rates(text, k=0.3)
    assert f[:, column] == pytest.approx(expected(drive, 0.3), abs=1e-15)
    assert not np.delete(f, column, axis=1).any()


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("yaw += k * v", "rad/m"), ("yaw += omega * (k * cos(theta))", ""),
        ("yaw += omega * (0.1 - k * alpha * sign(omega))", "s^2/rad"),
        ("wheels += v * (k * max(-a * sign(v) - 0.2, 0))", "s^2/m"),
        ("along += -k * where(a > 0, v ** 2, 0) / 3", "s/m"), ("left += v * k * hypot(x - 1, 2)", "1/m"),
        ("yaw += where(t > 5, k * exp(-t / 80), 0)", "rad/s"), ("across += k; yaw += k * v", "m/s"),
        ("yaw += k * sqrt(v)", ""), ("yaw += 2 ** 2 / (3 * 1) * (k - 1) * (v ** 1.5)", ""),
    ],
)  # fmt: skip
def test_an_amplitude_has_the_unit_of_what_stands_beside_it(text, unit):
    assert [p.unit for p in parameters(user_effect("mine", text, {"k": 0.3}))] == [unit]
    assert [p.unit for p in parameters(user_effect("mine", text, {"k": 0.3}, {"k": "furlong"}))] == ["furlong"]


def test_what_is_added_to_wheels_is_shown_the_wheels_own_motion():
    drive = motion(np.linspace(-0.5, 0.7, 50), np.linspace(-1.0, 1.0, 50), track=0.4, heading=0.3)
    right_v, left_v = drive.v + 0.2 * drive.omega, drive.v - 0.2 * drive.omega

    def f(text, **words):
        return error_of(user_effect("mine", text, {"k": 0.3}, words=words), drive)

    right, left, both = (f(f"{side} += k * v * abs(v)") for side in ("right", "left", "wheels"))
    assert right[:, 0] == pytest.approx(0.15 * right_v * np.abs(right_v))
    assert right[:, 2] == pytest.approx(0.3 * right_v * np.abs(right_v) / 0.4)
    assert left[:, 0] == pytest.approx(0.15 * left_v * np.abs(left_v))
    assert left[:, 2] == pytest.approx(-0.3 * left_v * np.abs(left_v) / 0.4)
    assert both == pytest.approx(right + left)
    assert not both[:, 1].any()
    # a wheel that makes way as the other does not speeds up by itself
    hurry = f("right += k * a")
    assert hurry[:, 0] == pytest.approx(0.15 * (drive.a + 0.2 * drive.alpha))
    # facing east, the right wheel lies to the south
    assert f("right += k * y")[:, 0] == pytest.approx(0.15 * (drive.y - 0.2 * np.cos(drive.theta)))
    assert f("left += k * x")[:, 0] == pytest.approx(0.15 * (drive.x - 0.2 * np.sin(drive.theta)))
    # a gyro does not notice
    assert f("wheels += k * v", heading="gyro") == pytest.approx(f("wheels += k * v") * [1.0, 1.0, 0.0])


def test_wheels_need_a_track_and_only_they_have_a_word_for_the_heading():
    bare = motion(np.linspace(-0.5, 0.7, 50), np.linspace(-1.0, 1.0, 50))
    with pytest.raises(EffectError, match="give it in metres with track_m"):
        error_of(user_effect("mine", "left += k * v", {"k": 0.1}), bare)
    with pytest.raises(EffectError, match="heading applies to statements that add to left, right, wheels"):
        user_effect("mine", "yaw += k * v", {"k": 0.1}, words={"heading": "gyro"})
    with pytest.raises(EffectError, match="write wheels or gyro"):
        user_effect("mine", "left += k * v", {"k": 0.1}, words={"heading": "compass"})


def test_an_effect_of_wheels_comes_back_from_a_model_file_and_from_a_pickle():
    text = HEAD + 'name = "flat"\nexpression = "left += k * v"\nheading = "gyro"\nk = 0.02\n[robot]\ntrack = 0.4\n'
    (effect,) = parse_model(text).effects
    assert effect.heading == "gyro"
    assert parse_model(format_model(parse_model(text))).effects == (effect,)
    assert pickle.loads(pickle.dumps(effect)) == effect  # noqa: S301 - our own


def test_statements_add_up():
    _, once = rates("yaw += k * v; along += c * omega; yaw += 2 * k * v", k=0.1, c=0.2)
    drive, lines = rates("\n  yaw += 3 * k * v\n  along += c * omega\n", k=0.1, c=0.2)
    assert once == pytest.approx(lines)
    assert once[:, 0] == pytest.approx(0.2 * drive.omega)


@pytest.mark.parametrize(
    ("text", "linear", "vanishes"),
    [
        ("yaw += k * v * sin(w * distance)", {"k"}, True), ("yaw += k * w * v", {"k"}, True),
        ("yaw += k * v + w * omega; along += -w * v", {"k", "w"}, True), ("yaw += (k + w) * v / 2", {"k", "w"}, True),
        ("yaw += v / k + w * v", {"w"}, False), ("yaw += k * v + 0.1 * abs(v) * w ** 2", {"k"}, False),
        ("yaw += where(v > w, k * v, 0 * k)", {"k"}, True), ("yaw += where(v > w, k * v, 1)", {"k"}, False),
    ],
)  # fmt: skip
def test_parameters_that_a_linear_fit_may_move_are_distinguished_from_shapes(text, linear, vanishes):
    names = tuple(n for n in ("k", "w") if n in text.replace("where", ""))
    parsed = parse_expression(text, names)
    assert parsed.linear == linear
    assert parsed.vanishes == vanishes
    effect = user_effect("mine", text, dict.fromkeys(names, 0.5))
    assert {p.name for p in amplitudes(effect)} == linear
    assert type(effect)().acts == (not vanishes)
    # its identity keeps the shapes
    assert all(getattr(type(effect)(), p.name) == (0.0 if p.amplitude else 0.5) for p in parameters(effect))


@pytest.mark.parametrize(
    "text",
    [
        "", ";", "yaw = v", "yaw -= v", "v += 1", "yaw += q", "yaw", "import os", "yaw += v.real", "yaw += v[0]",
        "yaw += (lambda: 1)()", "yaw += [1]", "yaw += 'a'", "yaw += f'{v}'", "yaw += __import__('os')",
        "yaw += sinn(v)", "yaw += sin(v, v)", "yaw += sin()", "yaw += min(v)", "yaw += sin(x=v)", "yaw += sin(*v)",
        "yaw += eval(v)",
        "yaw += v if v else 1", "yaw += v < 1 < 2", "yaw += v and t", "yaw += not v", "yaw += ~v", "yaw += v % 2",
        "yaw += v // 2", "yaw += v @ v", "yaw += True", "yaw += None", "yaw += 1j", "yaw += (yaw := 1)", "yaw += yaw",
        "yaw += v ** 9", "yaw += v ** -9", "yaw += v ** omega", "yaw += 9 ** 9 ** 9", "yaw += 1e999",
        "yaw += 1" + "0" * 400,
        "yaw += " + "(" * 300 + "v" + ")" * 300, "yaw += " + "-" * 300 + "v", "yaw += v" + "+v" * 150,
        "yaw += v" + " " * 1000,
        "yaw += v\x00", "async def f(): pass", "yaw += v; exec('1')",
    ],
)  # fmt: skip
def test_anything_else_is_refused_in_one_line(text):
    with pytest.raises(EffectError) as caught:
        parse_expression(text, ())
    assert "\n" not in str(caught.value).replace(repr(text), "")
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize(
    ("name", "text", "values", "complaint"),
    [
        ("Bumps", "yaw += k * v", {"k": 1.0}, "cannot be a name"),
        ("class", "yaw += k * v", {"k": 1.0}, "cannot be a name"),
        ("bumps", "yaw += sin * v", {"sin": 1.0}, "name of something else"),
        ("bumps", "yaw += v * t", {"t": 1.0}, "name of something else"),
        ("bumps", "yaw += k * v", {"k": 1.0, "j": 2.0}, "parameter j does nothing"),
        ("bumps", "yaw += k * v", {"k": float("nan")}, "must lie in"),
    ],
)
def test_names_and_values_are_checked(name, text, values, complaint):
    with pytest.raises(EffectError, match=complaint):
        user_effect(name, text, values)


def test_what_is_not_finite_is_reported_with_its_place():
    with pytest.raises(EffectError, match=r"not a finite number where v = 0, omega = 1.*where\(\)"):
        error_of(user_effect("mine", "yaw += k * omega / v", {"k": 0.1}), motion(0.0, 1.0))


def test_a_model_file_carries_it_and_runs_it():
    text = 'name = "bumps"\nexpression = "yaw += k * v * sin(w * distance)"\n'
    text += 'k = "0.02 +- 0.001"\nw = { value = 3.0, unit = "1/m" }\n'
    model = parse_model(HEAD + text)
    again = parse_model(format_model(model))
    assert again.effects == model.effects
    assert again.standard_errors == {"bumps.k": 0.001}
    n = 500
    poses = np.column_stack((np.arange(n) * 0.01, np.zeros(n), np.zeros(n)))
    yaw = NoisyPath(again, 1).feed(10**11 + np.arange(n) * 20_000_000, poses).error_xyt[:, 2]
    s = np.arange(1, n) * 0.01
    assert yaw[1:] == pytest.approx(-np.cumsum(0.02 * 0.01 * np.sin(3.0 * s)), abs=1e-9)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ('name = "wheelbase"\nexpression = "yaw += v"', "library has an effect of that name"),
        ('name = "mine"\nexpression = 3', "write text"),
        ('name = "mine"\nexpression = "yaw += open(1)"', "no function 'open'"),
        ('name = "mine"\nexpression = "yaw += k * v"\nk = "x"', "write a number"),
        ('name = "mine"\nexpression = "yaw += k * v"', "'k' is not known"),
        ('name = "gauss_markov"\nsigma = 0.1\nchannel = "up"', "along or yaw or wheels"),
        ('name = "gauss_markov"\nsigma = 0.1\nchannel = 3', "along or yaw or wheels"),
        ('name = "wheel_scale"\ne = "wide"', "write a number"),
    ],
)
def test_model_files_complain_in_one_line(text, complaint):
    with pytest.raises(ModelError, match=complaint):
        parse_model(HEAD + text)


def test_a_word_goes_through_a_model_file():
    model = parse_model(HEAD + 'name = "gauss_markov"\nsigma = 0.1\nchannel = "yaw"')
    assert model.effects[0].channel == "yaw"
    assert parse_model(format_model(model)).effects == model.effects


def test_it_travels_between_processes_and_equals_itself():
    effect = user_effect("bumps", "yaw += k * v", {"k": 0.02}, {"k": "rad/m"})
    assert pickle.loads(pickle.dumps(effect)) == effect  # noqa: S301 - our own bytes
    assert effect == user_effect("bumps", "yaw += k * v", {"k": 0.02}, {"k": "rad/m"})
    assert parameters(effect)[0].unit == "rad/m"


@pytest.fixture
def plugged(monkeypatch):
    def plug(*points):
        monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: [EntryPoint(*p, group) for p in points])
        registry.cache_clear()
        return registry()

    yield plug
    registry.cache_clear()


def test_another_packages_effect_is_found(plugged):
    assert "good" in plugged(("good", "test_contract:Good"))


@pytest.mark.parametrize(
    ("value", "complaint"),
    [
        ("test_contract:Missing", "cannot be loaded"),
        ("json:dumps", "not an effect class"),
        ("odomcorrupt.effects.gains:Wheelbase", "taken"),
    ],
)
def test_a_broken_one_is_reported_and_stops_nothing(plugged, value, complaint):
    before = set(registry())
    with pytest.warns(UserWarning, match=complaint):
        found = plugged(("bad", value))
    assert set(found) == before


@pytest.mark.parametrize(
    ("name", "values", "complaint"),
    [
        ("wheel_scal", {}, r"did you mean wheel_scale\?"),
        ("gauss_markov", {"chanel": "yaw"}, r"did you mean channel\?"),
        ("gauss_markov", {"channel": "up"}, "write along or yaw or wheels"),
        ("gauss_markov", {"sigma": "much"}, "must be a number"),
        ("backlash", {"travel": -0.001}, r"must lie in \[0, 0.05\] m"),
    ],
)
def test_what_is_wrong_with_an_effect_is_said(name, values, complaint):
    with pytest.raises(EffectError, match=complaint):
        effect_from_values(name, values)


def page(*args):
    result = CliRunner().invoke(cli, ["effects", *(args if "--json" in args else ("-v", *args))])
    assert result.exit_code == 0, result.output
    return result.output


def test_the_list_names_every_effect_with_kind_and_summary():
    text = page()
    for name, kind in registry().items():
        line = next(line for line in text.splitlines() if line.startswith(f"{name} "))
        assert kind.kind in line
        assert kind.summary in line


@pytest.mark.parametrize("name", registry())
def test_a_page_tells_everything(name):
    text, kind = page(name), registry()[name]
    for part in kind.about:
        assert (", ".join(part) if isinstance(part, tuple) else part) in text
    facts = json.loads(page(name, "--json"))
    assert facts["confused_with"] == list(kind.about.confused_with)
    assert {p["name"] for p in facts["parameters"]} | set(facts["words"]) == {f.name for f in dataclasses.fields(kind)}


def test_the_example_of_a_page_can_be_typed():
    from odomcorrupt.model.model_file import parse_effect

    for name in registry():
        example = page(name).splitlines()[-1].split()[-1]
        assert parse_effect(example).effect.name == name
        assert parse_effect(example).effect.acts


def test_json_lists_all():
    assert [e["name"] for e in json.loads(page("--json"))["effects"]] == list(registry())


OFFICE = str(FIXTURES / "office.mcap")
WOBBLE = """
from dataclasses import dataclass
from typing import ClassVar

from odomcorrupt.effects.effect import Effect, Kind, TwistError, parameter, stacked


@dataclass(frozen=True, slots=True)
class Wobble(Effect):
    name: ClassVar[str] = "wobble"
    kind: ClassVar[Kind] = "effect"
    summary: ClassVar[str] = "the robot sways"

    k: float = parameter("", "of the speed", low=-0.1, high=0.1, typical=0.01)

    def twist_error(self, motion, state):
        return TwistError(stacked(0.0, self.k * motion.v, 0.0, motion.v), state)


class Plain:
    pass
"""
NONE = "rot_rot = 0\nrot_trans = 0\ntrans_trans = 0\ntrans_rot = 0"
WORDS = 'expression = "across += k * v"\nk = 0.05\n'


def drive_of(path):
    """Return the odometry's poses (n, 3)."""
    with open_reader(path) as reader:
        return scan_bag(reader).odometry[0].xyt


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "sway_in_folder.py").write_text(WOBBLE)
    (tmp_path / "sway_broken.py").write_text("1 / 0\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    return tmp_path


def test_a_class_of_this_folder_acts_as_the_same_words_in_a_model_file_do(folder, capsys):
    assert run([OFFICE, "own.mcap", "-v", "--seed", "1", "--effect", "sway_in_folder.Wobble:k=0.05"]) == 0
    assert "effects wobble (k 0.05)" in capsys.readouterr().err
    Path("robot.toml").write_text(f'schema = 1\n[noise]\n{NONE}\n[[effect]]\nname = "words"\n{WORDS}')
    assert run([OFFICE, "words.mcap", "-v", "--seed", "1", "--model", "robot.toml"]) == 0
    own, words, clean = (drive_of(Path(name)) for name in ("own.mcap", "words.mcap", OFFICE))
    assert np.abs(own - words).max() < 1e-9
    assert np.abs(own - clean).max() > 0.01


@pytest.mark.parametrize(
    ("effect", "sentence"),
    [
        ("sway_in_folder.Wobble:k=7", "effect wobble, k: 7; it must lie in"),
        ("sway_in_folder.Wobble:q=7", "effect wobble has no parameter 'q'"),
        ("sway_in_folder.Plain", "sway_in_folder.Plain: is not an effect class"),
        ("sway_in_folder.Missing", "sway_in_folder.Missing: is not an effect class"),
        ("sway_nowhere.Wobble", "sway_nowhere cannot be imported (ModuleNotFoundError"),
        ("sway_broken.Wobble", "sway_broken cannot be imported (ZeroDivisionError: division by zero)"),
        (".Wobble", "cannot be imported"),
    ],
)
def test_what_is_no_effect_is_one_line_of_wrong_usage(folder, invoke, effect, sentence):
    said = invoke([OFFICE, "out.mcap", "--effect", effect], 2).err
    assert sentence in said
    assert said.count("\n") == 1


def test_a_model_file_names_no_code(folder, invoke):
    Path("robot.toml").write_text(f'schema=1\n[noise]\n{NONE}\n[[effect]]\nname = "sway_in_folder.Wobble"\nk = 0.01\n')
    assert "no effect is called 'sway_in_folder.Wobble'" in invoke([OFFICE, "out.mcap", "--model", "robot.toml"], 1).err


@pytest.mark.usefixtures("folder")
def test_workers_of_a_batch_find_the_class_too(capsys):
    words = ["batch", OFFICE, "runs", "--runs", "2", "--jobs", "2", "--seed", "1", "--output", "trajectories"]
    assert run([*words, "--effect", "sway_in_folder.Wobble:k=0.05"]) == 0, capsys.readouterr().err
