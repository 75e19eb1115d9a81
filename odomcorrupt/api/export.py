"""Numbers of a model as parameters of ros2_control, nav2, robot_localization or Gazebo."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from odomcorrupt import export
from odomcorrupt.api.model import as_model
from odomcorrupt.api.result import Result
from odomcorrupt.errors import ModelError
from odomcorrupt.result_files import refuse_existing, write_text
from odomcorrupt.summary import Line, Summary

if TYPE_CHECKING:
    from odomcorrupt.api.model import ModelLike
    from odomcorrupt.export import Snippet, Turn

Target = Literal["ros2_control", "nav2", "robot_localization", "gazebo"]


@dataclass(frozen=True, slots=True, repr=False)
class Export(Result):
    """Parameters of another program.

    name, to : name of the model, and the program
    result : complete result: YAML, comments, values by name, effects that the program cannot represent
    """

    name: str
    to: Target
    result: Snippet

    def summary(self) -> Summary:
        """Return the values, and the effects that cannot be represented."""
        left = self.result.left_out
        lines = [Line("EXPORTED", f"{self.name} for {self.to}", "warning" if left else "good")]
        if left:
            lines.append(Line("left out", f"{', '.join(left)}: comments in the file say why", "warning"))
        values = {name: export.number(value) for name, value in self.result.values.items()}
        shown = [f"{name} {value}" for name, value in values.items()]
        if self.to == "robot_localization":
            shown = [f"twist covariance diagonal {', '.join(values.values())}"]
        lines.append(Line("values", ", ".join(shown)))
        return Summary(tuple(lines))

    def details(self) -> str:
        """Return the YAML, with assumptions and effects left out as comments."""
        return self.result.text

    def _values(self) -> dict[str, Any]:
        return {"to": self.to, "yaml": self.result.text}

    def rows(self) -> list[dict[str, Any]]:
        """Return names and values of the parameters."""
        return [{"parameter": name, "value": value} for name, value in self.result.values.items()]

    def save(self, path: str | PathLike[str], *, overwrite: bool = False) -> Path:
        """Write the YAML; return the path.

        path : file to write
        overwrite : whether an existing file is replaced

        Raises
        ------
        OdomCorruptError
            If the file exists and `overwrite` is false.
        """
        target = Path(fspath(path))
        refuse_existing(target, overwrite=overwrite)
        write_text(target, self.result.text + "\n")
        return target


def export_parameters(
    model: ModelLike,
    to: Target,
    *,
    track_m: float | None = None,
    wheelbase_m: float | None = None,
    wheel_radius_m: float | None = None,
    update_min_d: float = 0.25,
    update_min_a: float = 0.2,
    turn: Turn = "rolling",
    speed: float = 0.5,
    turn_rate: float = 0.5,
    rate: float = 50.0,
    controller: str | None = None,
) -> Export:
    """Return wheel multipliers, amcl's alphas, covariances for robot_localization, or a drive plugin of Gazebo.

    Multipliers come from wheel_scale, unequal_wheels and wheelbase; alphas and covariances from the noise law.

    model : model of the robot, noise, model file or preset
    to : "ros2_control", "nav2", "robot_localization" or "gazebo"
    track_m : nominal distance between left and right wheels, metres; by default that of the model
    wheelbase_m, wheel_radius_m : distance between the axles of an omni or steered base, and radius of the wheels,
        metres; for "gazebo", and for "ros2_control" unless the base has two wheels
    update_min_d, update_min_a : distance (m) and angle (rad) after which amcl updates its particles
    turn : turn on which amcl's noise is matched to the model's: "rolling" (along an arc) or on the "spot"
    speed, turn_rate, rate : speed (m/s) and turn rate (rad/s) at which the noise is evaluated, and rate of the
        odometry, Hz
    controller : name of the node in the YAML; by default that of the controller for this base

    Returns
    -------
    Export
        `details()` is the YAML, `rows()` and `to_pandas()` have its values.

    Raises
    ------
    ModelError
        If the model or a number is invalid, or the track is needed and not known.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> alphas = oc.export_parameters("typical", "nav2", update_min_d=0.2)
    >>> [(row["parameter"], round(row["value"], 5)) for row in alphas.rows()[:2]]
    [('alpha1', 0.025), ('alpha2', 0.001)]
    """
    robot = as_model(model).motion_model
    drive = export.Steady(speed, turn_rate, rate)
    base = export.Base(track_m, wheelbase_m, wheel_radius_m)
    node = controller or export.BASES[export.wheel_layout(robot)][0]
    snippets = {
        "nav2": lambda: export.amcl_snippet(robot, update_min_d, update_min_a, turn, drive),
        "robot_localization": lambda: export.twists_snippet(robot, drive, node),
        "ros2_control": lambda: export.wheels_snippet(robot, base, node),
        "gazebo": lambda: export.gazebo_snippet(robot, base),
    }
    if to not in snippets:
        raise ModelError(f"to: {to!r}; write one of {', '.join(snippets)}")
    return Export(Path(fspath(model)).name if isinstance(model, str | PathLike) else "model", to, snippets[to]())
