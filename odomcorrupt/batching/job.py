"""The runs of one input and one model: their files, and the command that makes each of them alone."""

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

Output = Literal["full", "overlay", "trajectories"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """One directory of runs.

    source, directory : absolute paths, for workers on other machines
    model, spreads : model of all runs, and the parameters drawn for each run
    split : whether changed messages are written in chunks of their own
    model_text : content of the directory's model.toml
    model_words, option_words : command-line arguments of a single run: model (if not drawn), and all others
    shown_source, shown_directory : paths as typed
    condition : map to which every run is constrained; None without one
    suffix : of the names of whole bags, "" for directories; None: that of the input
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
    suffix: str | None = None

    def model_of(self, run: int) -> MotionModel:
        """Return the model of a run: the common one, or one with the run's drawn parameters."""
        return draw_robot(self.model, self.spreads, self.seed, run) if self.spreads else self.model

    def name_of(self, run: int) -> str:
        """Return the name of a run's file."""
        suffixes = {"overlay": ".mcap", "trajectories": ".tum"}
        return f"run_{run:06d}{suffixes.get(self.output, self._bag_suffix)}"

    @property
    def _bag_suffix(self) -> str:
        """Suffix of a whole bag; a single compressed file is written as what is in it."""
        if self.suffix is not None:
            return self.suffix
        name = self.source.with_suffix("") if self.source.suffix in (".zstd", ".zst") else self.source
        return "" if self.source.is_dir() else name.suffix

    def path_of(self, run: int) -> Path:
        """Return the path of a run's file."""
        return self.directory / self.name_of(run)

    def robot_of(self, run: int) -> str:
        """Return the name of the file with a run's drawn model."""
        return f"robots/{run:06d}.toml"

    def command_of(self, run: int) -> str:
        """Return the shell command that makes this run alone, as a whole bag, from the batch's working directory."""
        name = self.name_of(run)
        if self.output != "full":
            name = f"run_{run:06d}{self._bag_suffix}"
        words = ("--model", f"{self.shown_directory}/{self.robot_of(run)}") if self.spreads else self.model_words
        seed = ("--seed", str(self.seed), "--run", str(run))
        return shlex.join(["odomcorrupt", self.shown_source, name, *words, *self.option_words, *seed])


@dataclass(frozen=True, slots=True)
class Task:
    """Runs of one job made in one pass over its input."""

    job: Job
    runs: tuple[int, ...]
