"""What a selection of terms found, step by step: the model, what was refused, and what is open."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from odomcorrupt.study.select.decisions import DECISIONS, Decisions
from odomcorrupt.study.terms.drive_type import drive_type_of, readings_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from odomcorrupt.study.estimate.clocks import Clocks
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.candidates import Candidate
    from odomcorrupt.study.select.contribution import Contribution
    from odomcorrupt.study.select.dependence import Dependence
    from odomcorrupt.study.select.heterogeneity import ParameterDifference
    from odomcorrupt.study.select.random_effects import RandomCoefficient
    from odomcorrupt.study.terms.drive_type import DriveType

__all__ = ["Learned", "Step"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """One step of the selection.

    before : the model before it
    candidates : effects of the library, the one that was included first
    added : name of the effect that was included, None where none was
    dependence : what was included instead, because no effect of the library explains it
    alternative_nats : see `Decisions`
    """

    before: Fit
    candidates: tuple[Candidate, ...]
    added: str | None
    dependence: Dependence | None = None
    alternative_nats: float = DECISIONS.alternative_nats

    @property
    def name(self) -> str | None:
        """What was included: the name of an effect, or what depends on what; None if nothing was."""
        return self.added if self.dependence is None else self.dependence.title

    @property
    def alternatives(self) -> tuple[str, ...]:
        """Effects that would have done nearly as well as the included one."""
        if self.added is None:
            return ()
        least = self.candidates[0].gain - self.alternative_nats
        near = [c.name for c in self.candidates[1:] if not c.refused and c.gain > least]
        drive = drive_type_of(self.before.problem.recordings)
        own = self.candidates[0].score.estimated
        aliased = [*readings_of(own, drive), *(twin for name in near for twin in readings_of(name, drive))]
        return tuple(dict.fromkeys(name for name in (*near, *aliased) if name != self.added))


@dataclass(frozen=True, slots=True, kw_only=True)
class Learned:
    """What a selection found.

    clocks : those of the recordings
    rounds : all steps in order; the last one included nothing, or a limit was reached
    noise : what encoders did, and random effects that were found
    unknown : dependences that no effect of the library explains, and those that may stand in the place of one
    laws : those of them that are in the model as basis functions
    margins : by how many nats each included effect explains more than the best basis function would in its place
    fit : the final fit
    error_m : its 10 s position error on the fitted data
    disagreements : parameters that recordings do not agree about
    contradictions : effects that would explain the data only with a sign that physics forbids, refused with the reason
    decisions : the decisions it was selected by
    hides_losses : whether ticks are too coarse to show lost increments, which then look like a larger wheel
    held_out : log likelihood that each part of the model gains on data it was not fitted on, and its standard error
    contributions : how far each systematic part moves the odometry, where that was measured
    first_clocks : as they were found before anything else was; None where increments were restored first
    """

    clocks: Clocks
    rounds: tuple[Step, ...]
    noise: tuple[RandomCoefficient, ...]
    unknown: tuple[Dependence, ...]
    laws: tuple[Dependence, ...]
    margins: Mapping[str, float]
    fit: Fit
    error_m: float
    disagreements: tuple[ParameterDifference, ...] = ()
    contradictions: tuple[Candidate, ...] = ()
    decisions: Decisions = DECISIONS
    hides_losses: bool = False
    held_out: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    contributions: Mapping[str, Contribution] = field(default_factory=dict)
    first_clocks: Clocks | None = None

    def is_negligible(self, name: str) -> bool:
        """Return whether a part of the model, by name, is there and does not matter."""
        own = self.contributions.get(name)
        return own is not None and own.negligible(self.decisions.practical)

    @property
    def matters(self) -> tuple[str, ...]:
        """Names of the included effects of the library that matter, in order."""
        return tuple(name for name in self.added if not self.is_negligible(name))

    @property
    def of_setup(self) -> tuple[str, ...]:
        """Names of included effects that belong to the recording, and to no robot: where the tracked point sits."""
        setup = [effect for effect in self.fit.effects if effect.kind == "setup"]
        return tuple(effect.name for effect in setup if not readings_of(effect, self.drive_type))

    @property
    def lacking(self) -> tuple[str, ...]:
        """Names of the included effects of the robot that matter, in order."""
        return tuple(name for name in self.matters if name not in self.of_setup)

    @property
    def unexplained(self) -> tuple[Dependence, ...]:
        """Dependences that no effect of the model explains, without those that are in it and negligible."""
        left = [one for one in self.unknown if not one.instead_of]
        return tuple(one for one in left if one not in self.laws or not self.is_negligible(one.name))

    @property
    def left_nats(self) -> float:
        """What the plainest dependence gains that nothing else in the model explains."""
        return max((one.nats for one in self.unknown if not one.instead_of), default=0.0)

    @property
    def drive_type(self) -> DriveType:
        """How the robot's wheels steer it."""
        return drive_type_of(self.fit.problem.recordings)

    def may_be_losses(self, name: str) -> bool:
        """Return whether an effect may as well be increments that are lost: travel is missing, and ticks hide zeros."""
        grown = any(e.name == name == "wheel_scale" and getattr(e, "e", 0.0) > 0.0 for e in self.fit.effects)
        return grown and self.hides_losses

    @property
    def added(self) -> tuple[str, ...]:
        """Names of the effects of the library that were included and kept, in order."""
        return tuple(step.added for step in self.steps if step.added is not None)

    @property
    def steps(self) -> tuple[Step, ...]:
        """Steps whose inclusion is in the final model; of one that left and came back, the later."""
        kept = {effect.name for effect in self.fit.effects}
        stayed = {step.name: step for step in self.rounds if step.added in kept or step.dependence in self.laws}
        return tuple(step for step in self.rounds if stayed.get(step.name) is step)
