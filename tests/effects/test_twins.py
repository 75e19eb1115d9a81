"""Twins, scans of shapes, and what enters the study's library."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from manoeuvres import motion

from odomcorrupt.drive_types import DRIVE_TYPES
from odomcorrupt.effects import registry
from odomcorrupt.effects.compensation import error_of
from odomcorrupt.effects.effect import amplitudes, parameters
from odomcorrupt.effects.wheels import brings_track

KINDS = registry()


def varied():
    n = 500
    wave = np.arange(n) / 50.0
    return motion(0.5 + 0.4 * np.sin(wave), np.cos(2.0 * wave), seconds=n / 50.0, track=0.4)


@pytest.mark.parametrize("name", [name for name, kind in KINDS.items() if kind.aliased_with])
def test_twins_have_the_same_regressor(name):
    kind, twin = KINDS[name], KINDS[KINDS[name].aliased_with]
    p = amplitudes(kind)[0]
    ours = error_of(kind(**{p.name: p.typical}), varied())
    theirs = error_of(twin(**{p.name: p.typical}), varied())
    assert ours.any()
    assert np.array_equal(ours, theirs)


@pytest.mark.parametrize("drive_type", DRIVE_TYPES)
def test_no_other_two_effects_of_a_drive_type_have_the_same_regressor(drive_type):
    drive = varied()
    columns = {}
    for name, kind in KINDS.items():
        if kind.kind in ("noise", "event") or kind.aliased_with or drive_type not in (kind.drives or DRIVE_TYPES):
            continue
        for p in amplitudes(kind):
            f = error_of(kind(**{p.name: p.typical}), drive).ravel()
            columns[name, p.name] = f / np.linalg.norm(f) if f.any() else f
    matrix = np.array(list(columns.values()))
    likeness = np.abs(matrix @ matrix.T - np.eye(len(matrix)))
    likeness[~matrix.any(axis=1)] = 0.0
    assert likeness.max() < 0.999


STEERING = ("steering_offset", "steering_play", "steering_scale", "flat_spot")
SHAPED = [n for n, k in KINDS.items() if any(not p.amplitude and not p.optional for p in parameters(k))]
SHAPED.append("hard_iron")  # its filter is optional, and tried
SHAPED.remove("flat_spot")  # its circumference is a line of a spectrum


@pytest.mark.parametrize("name", [name for name in SHAPED if KINDS[name].kind not in ("noise", "event")])
def test_a_scan_is_finite_at_the_identity_and_within_bounds(name):
    kind = KINDS[name]
    found = kind.scan([varied(), varied()])
    assert 1 < len(found) <= 400
    assert len(set(found)) == len(found)
    for effect in found:
        assert not effect.acts
        assert all(p.low <= getattr(effect, p.name) <= p.high for p in parameters(effect))


@pytest.mark.parametrize("name", [name for name, kind in KINDS.items() if name not in (*SHAPED, *STEERING)])
def test_an_effect_without_shapes_needs_one_try(name):
    assert KINDS[name].scan([varied()]) == (KINDS[name](),)


@pytest.mark.parametrize(
    "name", [n for n, k in KINDS.items() if brings_track(k) and k.kind != "noise" and n != "flat_spot"]
)
def test_an_effect_of_single_wheels_brings_tracks_where_the_robots_is_not_known(name):
    kind = KINDS[name]
    found = kind.scan([replace(varied(), track_m=None)])
    own = {effect.track for effect in found} - {0.0}
    assert min(own) < 0.2
    assert max(own) > 1.0
    p = amplitudes(kind)[0]
    known = [replace(effect, track=0.4, **{p.name: p.typical}) for effect in found]
    for effect in known:
        bare = error_of(replace(effect, track=0.0), varied())
        assert np.array_equal(error_of(effect, replace(varied(), track_m=None)), bare)


def test_a_scan_of_discs_has_one_near_any_patch_of_the_floor():
    n = 3000
    wave = np.arange(n) / 50.0
    drive = motion(0.5, 0.5 * np.sin(0.3 * wave), seconds=n / 50.0)
    slipped = error_of(KINDS["region_slip"](slip=0.05, x=float(drive.x[900]), y=float(drive.y[900]), radius=1.3), drive)
    best = 0.0
    for disc in KINDS["region_slip"].scan([drive]):
        column = error_of(type(disc)(slip=0.05, x=disc.x, y=disc.y, radius=disc.radius), drive)
        best = max(best, float((column * slipped).sum() / np.linalg.norm(column) / np.linalg.norm(slipped)))
    assert best > 0.85


def test_a_scan_of_a_parked_robot_is_empty():
    assert KINDS["region_slip"].scan([motion(0.0, 0.0)]) == ()


def test_two_slopes_at_right_angles_make_every_slope():
    drive = varied()
    whole = error_of(KINDS["slope"](creep=0.02, direction=0.7), drive)
    east = error_of(KINDS["slope"](creep=0.02 * math.cos(0.7), direction=0.0), drive)
    north = error_of(KINDS["slope"](creep=0.02 * math.sin(0.7), direction=math.pi / 2.0), drive)
    assert east + north == pytest.approx(whole, abs=1e-15)
