"""What a batch makes of one input and one model: which files, and by which command each can be made alone."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from odomcorrupt.batching.parameter_draws import Spread, draw_robot

if TYPE_CHECKING:
    from pathlib import Path

    from odomcorrupt.corruption.run import Container
    from odomcorrupt.corruption.transform import Options
    from odomcorrupt.mapping.map_condition import MapCondition
    from odomcorrupt.model.motion_model import MotionModel

__all__ = ["Job", "Output", "Task"]

Output = Literal["full", "overlay", "trajectories"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """One directory of runs.

    source, directory : absolute, for workers elsewhere
    model, spreads : of all runs, and the parameters that are drawn anew for each
    split : whether changed messages go into chunks of their own
    model_text : of the directory's model.toml
    model_words, option_words : how a single run is told its model, where none is drawn, and everything else
    shown_source, shown_directory : the paths as they were typed
    condition : the map that no run may leave; None without one
    """

    source: Path
    directory: Path
    model: MotionModel
    spreads: tuple[Spread, ...]
    seed: int
    options: Options
    container: Container
    output: Output
    split: bool
    model_text: str
    model_words: tuple[str, ...]
    option_words: tuple[str, ...]
    shown_source: str
    shown_directory: str
    condition: MapCondition | None = None

    def model_of(self, run: int) -> MotionModel:
        """Return the model of a run: that of all, or the robot that is drawn for it."""
        return draw_robot(self.model, self.spreads, self.seed, run) if self.spreads else self.model

    def name_of(self, run: int) -> str:
        """Return the name of a run's file."""
        suffixes = {"overlay": ".mcap", "trajectories": ".tum"}
        suffix = suffixes.get(self.output, "" if self.source.is_dir() else self.source.suffix)
        return f"run_{run:06d}{suffix}"

    def path_of(self, run: int) -> Path:
        """Return where a run's file goes."""
        return self.directory / self.name_of(run)

    def robot_of(self, run: int) -> str:
        """Return the name of the file with a run's drawn robot."""
        return f"robots/{run:06d}.toml"

    def command_of(self, run: int) -> str:
        """Return the command that makes this run alone, as a whole bag, in the directory where the batch was called."""
        name = self.name_of(run)
        if self.output != "full":
            name = f"run_{run:06d}" + ("" if self.source.is_dir() else self.source.suffix)
        words = ("--model", f"{self.shown_directory}/{self.robot_of(run)}") if self.spreads else self.model_words
        seed = ("--seed", str(self.seed), "--run", str(run))
        return shlex.join(["odomcorrupt", self.shown_source, name, *words, *self.option_words, *seed])


@dataclass(frozen=True, slots=True)
class Task:
    """Runs of one job that are made in one pass over its input."""

    job: Job
    runs: tuple[int, ...]
