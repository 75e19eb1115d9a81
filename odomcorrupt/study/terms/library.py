"""Library effects that a robot can have, as terms of the selection."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from odomcorrupt.effects import registry
from odomcorrupt.effects.wheels import brings_track
from odomcorrupt.study.estimate.drive_type import GAINS_OF_TURNS, MOUNTING, DriveType, drive_type_of, mountings
from odomcorrupt.study.estimate.regressors import drives_sideways
from odomcorrupt.study.io.recording import shared_frame
from odomcorrupt.study.terms.term import LibraryTerm

if TYPE_CHECKING:
    from collections.abc import Container, Sequence

    from odomcorrupt.effects.effect import Effect, Motion
    from odomcorrupt.study.io.recording import Recording


def library_families(
    recordings: Sequence[Recording], motions: Sequence[Motion], have: Container[str]
) -> list[tuple[LibraryTerm, ...]]:
    """Return every systematic library effect that a robot can have and that can be tested, at every shape.

    Clocks are excluded. Of aliases only one is tested and the others are reported as other readings; if that one is no
    effect of this drive type, its alias is tested. Effects of single wheels need a track, given or as a parameter,
    effects of places and headings a frame that all recordings share.

    motions : smooth motions of the recordings
    have : names of effects that are already in the model
    """
    drive = drive_type_of(recordings)
    track = not drive.steered and all(m.track_m is not None for m in motions)
    sideways = drive.name == "omni" or (drive.name != "differential" and drives_sideways(motions))
    placed = shared_frame(recordings) is not None
    families = []
    for name, kind in registry().items():
        wanted = kind.kind not in ("noise", "event") and not kind.clock and name not in have and _is_tested(kind, drive)
        possible = (sideways or not kind.needs_sideways) and (track or not kind.needs_track or brings_track(kind))
        possible = possible and (placed or not kind.reads_places)
        if name in MOUNTING and name not in mountings(recordings):
            continue
        if wanted and possible:
            family = LibraryTerm.family(kind, motions)
            if source := drive.heading_source:
                family = tuple(t for t in family if getattr(t.start, "heading", source) == source)
            if drive.steered:  # its odometry does not compare two wheels: one travel turns the robot, too
                values = {"track": 0.0} if brings_track(kind) else {}
                tracked = (replace(t, start=replace(t.start, **values)) for t in family)  # type: ignore[type-var]
                family = tuple(dict.fromkeys(tracked))
                family = () if kind.needs_track else family
            families.append(family)
    return [family for family in families if family]


def _is_tested(kind: type[Effect], drive: DriveType) -> bool:
    """Return whether an effect is tested itself, and not only reported as an alias of a tested one."""
    if not drive.admits(kind):
        return False
    # a lever arm has two parameters, so its one-parameter alias for steered robots is tested too; but not with an
    # antenna, which is likelier off the axle than the base frame is
    of_steered = drive.steered and kind.drives is not None and not drive.antenna
    return kind.aliased_with is None or of_steered or kind.name == GAINS_OF_TURNS.get(drive.heading_source)
