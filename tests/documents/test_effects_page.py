"""docs/effects.md names the effects that it describes by group, and its table on the site has the whole library."""

import math
import re
import sys
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace as Names

from odomcorrupt.effects import ground, registry, steering
from odomcorrupt.effects.wheels import TRACKS_M

DOCS = Path(__file__).parents[2] / "docs"
sys.path.append(str(DOCS))

from effects_page import library, on_page_markdown  # noqa: E402 - its folder had to be found first

PAGE = (DOCS / "effects.md").read_text(encoding="utf8")


def test_the_site_has_every_effect_before_the_definition():
    rows = re.findall(r"^\| `(\w+)` \|", library(), re.MULTILINE)
    assert sorted(rows) == sorted(registry())
    whole = on_page_markdown(PAGE, page=Names(file=Names(src_uri="effects.md")))
    assert whole.index("## The library") < whole.index("## Definition")


def test_effects_with_a_heading_source_and_random_ones_are_those_of_the_code():
    part = PAGE.split("## Where the heading comes from", 1)[1].split("therefore have a parameter", 1)[0]
    assert set(re.findall(r"`(\w+)`", part)) == {
        name for name, kind in registry().items() if any(field.name == "heading" for field in fields(kind))
    }
    part = PAGE.split("## Randomness", 1)[1].split("Each states", 1)[0]
    assert set(re.findall(r"`(\w+)`", part)) == {name for name, kind in registry().items() if kind.kind == "noise"}
    part = PAGE.split("## Events", 1)[1].split("An effect of your own", 1)[0]
    events = set(re.findall(r"^\| `(\w+)` \|", part, re.MULTILINE))
    assert events == {name for name, kind in registry().items() if kind.kind == "event"}


def test_every_exact_alias_is_stated():
    part = PAGE.split("Some effects are exact aliases", 1)[1].split("No recording", 1)[0]
    for name, kind in registry().items():
        if kind.aliased_with is not None:
            assert f"`{name}` of `{kind.aliased_with}`" in part


def test_the_table_of_scans_has_the_values_of_the_code():
    rows = dict(re.findall(r"^\| ((?:`\w+`(?:, )?)+) \| (.+) \|$", PAGE.split("## Amplitudes", 1)[1], re.MULTILINE))
    kinds = registry()
    assert f"{len(kinds['slope'].scan(()))} directions" in rows["`slope`"]
    ways = [100.0 * effect.way for effect in kinds["castor_kick"].scan(())]
    assert f"{ways[0]:g}, {ways[1]:g} and {ways[2]:g} cm" in rows["`castor_kick`"]
    taus = [effect.tau for effect in kinds["complementary_filter"].scan(())]
    assert "{:g}, {:g}, {:g} and {:g} s".format(*taus) in rows["`complementary_filter`"]
    none, *taus = (effect.time_constant for effect in kinds["hard_iron"].scan(()))
    assert none == 0.0
    assert "{:g}, {:g} and {:g} s".format(*taus) in rows["`hard_iron`"]
    assert f"{TRACKS_M[0]:g} to {TRACKS_M[-1]:g} m" in rows["`backlash`, `accel_slip`"]
    degrees = [round(math.degrees(math.atan(tangent))) for tangent in (*steering._STEEP, *steering._STEEPER)]
    row = rows["`steering_scale`, `steering_offset`, `steering_play`"]
    assert f"takes {degrees[0]} or {degrees[1]} degrees" in row
    assert f"{degrees[2]} or {degrees[3]} degrees" in row
    assert f"{100 * ground._LEAST_SHARE:g} to {100 * ground._MOST_SHARE:g} % of the path" in rows["`region_slip`"]
    assert f"{ground._MOST_DISCS} at most" in rows["`region_slip`"]
