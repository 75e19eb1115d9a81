"""Recordings of simulated robots with faults that are stated in a separate file."""

from __future__ import annotations

import io
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from odomcorrupt.api.result import Result
from odomcorrupt.errors import EffectError, OdomCorruptError
from odomcorrupt.extras import part_of_study
from odomcorrupt.geometry.se2 import between, compose
from odomcorrupt.result_files import refuse_existing, write_file
from odomcorrupt.rng import draw_seed
from odomcorrupt.simulation.faults import EVERY, Hidden, draw_causes, names_of, source_of_turns
from odomcorrupt.simulation.routes import read_commands
from odomcorrupt.simulation.run import Scenario, fingerprint, format_answer, write_mcap
from odomcorrupt.simulation.run import simulate as simulate_run
from odomcorrupt.summary import Line, Summary, command_line

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.figure import Figure

    from odomcorrupt.simulation.run import SimulatedRun

_HEADINGS = {"wheels": "encoders", "gyro": "gyro"}
"""Heading sources: the user's word, and the simulator's."""


@dataclass(frozen=True, slots=True, repr=False)
class Simulation(Result):
    """A simulated recording, and the faults of its robot.

    target, answer_path : the bag, and the file with the answer; None if not written
    answer_text : contents of that file
    settings : robot, route, duration and so on, as in the file
    recording : odometry and truth as arrays
    bag : the bag's bytes
    """

    target: Path | None
    answer_path: Path | None
    answer_text: str
    settings: Mapping[str, str | float]
    recording: SimulatedRun
    bag: bytes

    @property
    def answer(self) -> dict[str, Any]:
        """Faults of the robot: causes and their parameters."""
        return self.recording.answer

    @property
    def track_m(self) -> float:
        """Nominal distance between the wheels, metres."""
        return self.recording.track_m

    def summary(self) -> Summary:
        """Return a description of the recording, and the path of its answer."""
        what = f"{self.settings['duration_s']:g} s of /odom and /ground_truth in {self.target or 'stdout'}"
        robot = f"heading from {self.settings['heading']}, nominal track {self.track_m} m"
        lines = [Line("RECORDED", what, "good"), Line("robot", robot), Line("seed", str(self.settings["seed"]))]
        if self.answer_path is not None:
            lines.append(Line("answer", f"its faults are listed in {self.answer_path}"))
        if self.target is not None:
            following = ["odomcorrupt", "learn", self.target, "--track", self.track_m, "-o", "robot.toml"]
            lines.append(command_line(following))
        return Summary(tuple(lines))

    def _values(self) -> dict[str, Any]:
        return {  # the answer stays in its file
            "output": None if self.target is None else str(self.target),
            "answer": None if self.answer_path is None else str(self.answer_path),
            "track_m": self.track_m,
            **self.settings,
        }

    def rows(self) -> list[dict[str, Any]]:
        """Return the odometry, one row per message."""
        run = self.recording
        return [
            {"stamp_ns": int(stamp), "x_m": float(x), "y_m": float(y), "yaw_rad": float(yaw)}
            for stamp, (x, y, yaw) in zip(run.odom_stamps_ns, run.odom_xyt, strict=True)
        ]

    def _figure(self) -> Figure:
        """Return a figure of the true path and that of the odometry."""
        from odomcorrupt.report.plots.paths import draw_corruption

        run = self.recording
        odometry = compose(run.truth_xyt[0], between(run.odom_xyt[:1], run.odom_xyt))
        name = "simulation" if self.target is None else self.target.name
        rows = [int(i * (len(odometry) - 1) / (len(run.truth_xyt) - 1)) for i in range(len(run.truth_xyt))]
        return draw_corruption(run.truth_xyt, odometry[rows], name, names=("truth", "odometry"))


@part_of_study
def simulate(
    target: str | PathLike[str] | None = None,
    *,
    effects: Sequence[str] = (),
    parameters: Mapping[str, Mapping[str, float | str]] | None = None,
    size: float = 1.0,
    seed: int | None = None,
    robot: int | None = None,
    route: str = "office",
    drive: str | PathLike[str] | None = None,
    truth: Literal["mocap", "rtk"] = "mocap",
    heading: Literal["wheels", "gyro"] | None = None,
    drive_type: Literal["differential", "skid"] = "differential",
    duration_s: float | None = None,
    answer: str | PathLike[str] | None = None,
    overwrite: bool = False,
) -> Simulation:
    """Record a simulated robot with a hidden or a chosen fault, from its wheels, ground, sensors and clocks.

    target : MCAP to write, with its answer beside it. None writes nothing
    effects : names of faults; none: hidden ones are drawn; ("none",): a robot without faults
    parameters : parameters of faults by name, instead of drawn ones
    size : factor on the magnitude of a drawn fault
    seed, robot : seeds of the drive with its noise, by default drawn, and of the robot with its fault, by default
        `seed`
    route : office, loops, shuttle, slalom, yard or umbmark
    drive : bag with /cmd_vel to follow instead, as written by `diagnose --drive`
    truth : "mocap" or "rtk"; source of the truth
    heading : "wheels" or "gyro"; source of the heading; by default the one that the fault requires
    drive_type : "differential" or "skid"; wheel layout
    duration_s : seconds; by default 600, or the length of `drive`
    answer : file for the answer
    overwrite : whether existing files are replaced

    Returns
    -------
    Simulation
        The recording and its answer.

    Raises
    ------
    EffectError
        If a fault is unknown, or not visible with this source of heading.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> run = oc.simulate(effects=["wheelbase"], seed=3, duration_s=20.0)
    >>> run.answer["cause"]
    'wheelbase'
    """
    path = None if target is None else Path(fspath(target))
    secret = None if path is None else path.with_suffix(".answer.toml")
    secret = secret if answer is None else Path(fspath(answer))
    for file in (path, secret):
        refuse_existing(file, overwrite=overwrite)
    source = _HEADINGS[heading] if heading else None
    seed = draw_seed() if seed is None else seed
    robot_seed = seed if robot is None else robot
    if not effects:
        hidden = draw_causes(robot_seed, source)
    elif tuple(effects) == ("none",):
        hidden = Hidden((), source or "encoders")
    else:
        causes = names_of(list(effects))
        hidden = Hidden(causes, source or source_of_turns(causes))
        for name in causes:
            if hidden.yaw_from not in EVERY[name].shows_with:
                raise EffectError(f"{name}: has no effect with heading {heading}; choose the other source")
    commands = None if drive is None else read_commands(Path(fspath(drive)))
    seconds = duration_s or (600.0 if commands is None else commands.duration_s)
    if not 1.0 <= seconds <= 1e6:
        raise OdomCorruptError(f"duration: {seconds:g} s; simulate from 1 to 1e6 s")
    scenario = Scenario(
        duration_s=seconds,
        size=size,
        truth=truth,
        parameters=parameters or {},
        route=commands or route,
        yaw_from=hidden.yaw_from,
        robot_seed=robot,
        drive_type=drive_type,
        home=route,
    )
    run = simulate_run(seed, hidden.causes, scenario)
    settings: dict[str, str | float] = {
        "robot": robot_seed,
        "route": route if drive is None else Path(fspath(drive)).name,
        "duration_s": seconds,
        "truth": truth,
        "heading": next(name for name, own in _HEADINGS.items() if own == hidden.yaw_from),
        "drive_type": drive_type,
        "size": size,
    }
    text = format_answer(run, seed, settings)
    bag = io.BytesIO()
    write_mcap(run, bag, metadata={"answer_sha256": fingerprint(text)})
    if secret is not None:
        write_file(secret, text)
    if path is not None:
        write_file(path, bag.getvalue())
    return Simulation(path, secret, text, {"seed": seed, **settings}, run, bag.getvalue())
