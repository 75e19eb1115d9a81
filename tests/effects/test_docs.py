"""What docs/effects.md says can be typed."""

from __future__ import annotations

import re
import textwrap
from pathlib import Path

from odomcorrupt.effects import registry
from odomcorrupt.effects.expression import FUNCTIONS, VARIABLES
from odomcorrupt.model.model_file import parse_model
from odomcorrupt.testing import check_effect

PAGE = (Path(__file__).parents[2] / "docs" / "effects.md").read_text(encoding="utf-8")
HEAD = 'schema = 1\n[noise]\nlaw = "diffusion"\nrot_rot = 0\nrot_trans = 0\ntrans_trans = 0\ntrans_rot = 0\n'


def block(language):
    return textwrap.dedent(re.search(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)[1])


def test_the_expression_is_read():
    effect = parse_model(HEAD + block("toml")).effects[0]
    assert effect.name == "my_bumps"
    assert effect.acts


def test_the_class_keeps_the_contract():
    names: dict[str, object] = {"__name__": __name__}
    head = "from dataclasses import dataclass\nfrom odomcorrupt.effects.effect import "
    head += "Effect, Motion, State, TwistError, parameter, stacked\n"
    exec(compile(head + block("python"), "effects.md", "exec", dont_inherit=True), names)  # noqa: S102 - our own page
    check_effect(names["Wobble"])


def test_every_word_of_the_language_is_documented():
    listed = PAGE[PAGE.index("Statements add to") : PAGE.index("Nothing else is accepted")]
    assert all(re.search(rf"\b{word}\b", listed) for word in (*VARIABLES, *FUNCTIONS))


def test_shapes_and_aliases_are_documented():
    for name, kind in registry().items():
        if kind.aliased_with:
            assert re.search(rf"`{name}` of `{kind.aliased_with}`", PAGE)
