"""Result of a selection: the model, the steps to it, refused candidates, and unexplained dependences."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from odomcorrupt.study.estimate.drive_type import drive_type_of, readings_of
from odomcorrupt.study.select.contribution import is_exact
from odomcorrupt.study.select.decisions import DECISIONS, Decisions

if TYPE_CHECKING:
    from collections.abc import Mapping

    from odomcorrupt.study.estimate.clocks import Clocks
    from odomcorrupt.study.estimate.drive_type import DriveType
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.candidates import Candidate, Dependence
    from odomcorrupt.study.select.contribution import Contribution
    from odomcorrupt.study.select.heterogeneity import ParameterDifference
    from odomcorrupt.study.select.random_effects import DetectedRandomEffect


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """One step of the selection.

    before : the fit before the step
    candidates : effects of the library, the included one first
    added : name of the included effect; None if there was none
    dependence : dependence that was included in place of a library effect, if any
    """

    before: Fit
    candidates: tuple[Candidate, ...]
    added: str | None
    dependence: Dependence | None = None

    @property
    def name(self) -> str | None:
        """Name of the included effect, or title of the included dependence; None if nothing was included."""
        return self.added if self.dependence is None else self.dependence.title

    @property
    def alternatives(self) -> tuple[str, ...]:
        """Names of effects with nearly the gain of the included one, or aliased with it."""
        if self.added is None:
            return ()
        least = self.candidates[0].gain - DECISIONS.alternative_nats
        near = [c.name for c in self.candidates[1:] if not c.refused and c.gain > least]
        drive = drive_type_of(self.before.problem.recordings)
        own = self.candidates[0].score.estimated
        aliased = [*readings_of(own, drive), *(twin for name in near for twin in readings_of(name, drive))]
        return tuple(dict.fromkeys(name for name in (*near, *aliased) if name != self.added))


@dataclass(frozen=True, slots=True, kw_only=True)
class Learned:
    """Result of a selection.

    clocks : clocks of the recordings
    rounds : all steps in order; the last one included nothing, or a limit was reached
    noise : encoder effects and detected random effects
    unknown : dependences that no library effect explains, and those that may replace an included effect
    laws : those dependences that are in the model as basis functions
    against : odds of the evaluated sets of terms without each included effect against those with it
    fit : the final fit
    error_m : its 10 s position error on the fitted data, m
    disagreements : parameters that differ between recordings
    contradictions : effects that fit the data only with a physically impossible sign, refused with the reason
    decisions : the thresholds of the selection
    hides_losses : whether ticks are too coarse to show lost increments, which then look like a larger wheel
    held_out : gain of each part of the model on held-out data, nats, and its standard error
    left_out : why parts that were found failed on held-out data and are not in the model, by name
    contributions : displacement of the odometry by each systematic part, if it was computed
    drifts_too_far : whether the model drifts clearly more than the recordings, if it was tested
    misfit : factor by which held-out errors exceed the predicted ones, if they reject the model; else 1
    """

    clocks: Clocks
    rounds: tuple[Step, ...]
    noise: tuple[DetectedRandomEffect, ...]
    unknown: tuple[Dependence, ...]
    laws: tuple[Dependence, ...]
    against: Mapping[str, float]
    fit: Fit
    error_m: float
    disagreements: tuple[ParameterDifference, ...] = ()
    contradictions: tuple[Candidate, ...] = ()
    decisions: Decisions = DECISIONS
    hides_losses: bool = False
    held_out: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    left_out: Mapping[str, str] = field(default_factory=dict)
    contributions: Mapping[str, Contribution] = field(default_factory=dict)
    drifts_too_far: bool = False
    misfit: float = 1.0

    def is_negligible(self, name: str) -> bool:
        """Return whether the part of the model with this name is present but negligible in practice."""
        own = self.contributions.get(name)
        return own is not None and own.negligible(self.decisions.practical)

    @property
    def of_setup(self) -> tuple[str, ...]:
        """Names of included effects of the recording set-up: position and yaw of the tracked point on the robot."""
        setup = [effect for effect in self.fit.effects if effect.kind == "setup"]
        return tuple(effect.name for effect in setup if not readings_of(effect, self.drive_type))

    @property
    def lacking(self) -> tuple[str, ...]:
        """Names of the included effects of the robot itself that are not negligible, in order."""
        return tuple(name for name in self.added if not self.is_negligible(name) and name not in self.of_setup)

    @property
    def unexplained(self) -> tuple[Dependence, ...]:
        """Dependences that no effect of the model explains, except negligible ones."""
        return tuple(one for one in self.unknown if not (one.instead_of or self.hardly_moves(one)))

    def hardly_moves(self, one: Dependence) -> bool:
        """Return whether a dependence is negligible: by its part in the model, else by the remaining error."""
        return self.is_negligible(one.name) if one in self.laws else self.hardly_errs

    @property
    def hardly_errs(self) -> bool:
        """Whether the remaining error is negligible in practice."""
        return is_exact(self.error_m, self.fit.problem.motions, self.decisions.practical)

    def why_left_out(self, one: Dependence) -> str:
        """Return why a dependence that the selection included is not in the model; "" for others."""
        # included ones precede others of the same name
        included = one is next((other for other in self.unknown if other.name == one.name), None)
        return self.left_out.get(one.name, "") if included and one not in self.laws else ""

    @property
    def contradicted(self) -> tuple[Candidate, ...]:
        """Contradictions, unless the model has an unexplained dependence.

        A dependence only approximates an unlisted cause, and the misfit of an approximation may have any sign.
        """
        return () if self.unexplained else self.contradictions

    @property
    def left_nats(self) -> float:
        """Largest gain among the dependences that no effect explains, nats; 0 if there are none."""
        return max((one.nats for one in self.unknown if not one.instead_of), default=0.0)

    @property
    def drive_type(self) -> DriveType:
        """Drive type of the robot, stated or guessed."""
        return drive_type_of(self.fit.problem.recordings)

    def may_be_losses(self, name: str) -> bool:
        """Return whether an effect may be lost increments instead: travel is missing, and coarse ticks hide losses."""
        grown = any(e.name == name == "wheel_scale" and getattr(e, "e", 0.0) > 0.0 for e in self.fit.effects)
        return grown and self.hides_losses

    @property
    def added(self) -> tuple[str, ...]:
        """Names of the library effects that were included and kept, in order."""
        return tuple(step.added for step in self.steps if step.added is not None)

    @property
    def steps(self) -> tuple[Step, ...]:
        """Steps whose term is in the final model; for a term included twice, the later step."""
        kept = {effect.name for effect in self.fit.effects}
        stayed = {step.name: step for step in self.rounds if step.added in kept or step.dependence in self.laws}
        return tuple(step for step in self.rounds if stayed.get(step.name) is step)
