"""Odometry integrated from the velocities of a bag, with or without noise on them."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from odomcorrupt.api.bag_options import drive_path
from odomcorrupt.api.result import Result
from odomcorrupt.errors import ModelError, TopicError
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.rng import draw_seed
from odomcorrupt.scoring.errors import ScoreError, path_errors
from odomcorrupt.summary import Line, Summary
from odomcorrupt.trajectories import find_truth, noisy_twists, read_drive, read_poses, rewrite_path
from odomcorrupt.trajectories import integrate as integrate_twists

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.scoring.errors import PathErrors
    from odomcorrupt.trajectories import Drive, Hold, Rewritten, Rule

_HELD = {"next": "until the next stamp", "previous": "since the previous stamp"}


@dataclass(frozen=True, slots=True, repr=False, kw_only=True)
class Integration(Result):
    """Odometry integrated from the velocities of a bag.

    source : the bag
    drive : odometry of the bag: stamps, poses and twists
    rule, hold : integration rule, and the interval over which a twist holds
    xyt : (n, 3) poses integrated from the twists as they are, metres and radians
    runs_xyt : (runs, n, 3) poses integrated from twists with noise; one run that equals `xyt` without noise
    twist_noise, seed : standard deviations of the noise, m/s and rad/s, and its seed; None without noise
    truth_topic : topic of the truth; None if there is none
    truth_error : error of `xyt` against the truth; None without a truth, or if it shares no time with the odometry
    own_error : error of `xyt` against the poses of the bag's own odometry
    """

    source: str
    drive: Drive
    rule: Rule
    hold: Hold
    xyt: Array
    runs_xyt: Array
    twist_noise: tuple[float, float] | None
    seed: int | None
    truth_topic: str | None
    truth_error: PathErrors | None
    own_error: PathErrors

    def summary(self) -> Summary:
        """Return the odometry's length, the rule, the errors, and the effect of the noise."""
        drive = self.drive
        hertz = (len(drive) - 1) / float(drive.t_s[-1])
        whole = f"{len(drive)} twists of {drive.topic}, {drive.distance_m[-1]:.4g} m in {drive.t_s[-1]:.4g} s"
        whole += f" ({hertz:.3g} Hz)"
        lines = [Line("INTEGRATED", whole, "good"), Line("rule", f"{self.rule}, a twist holds {_HELD[self.hold]}")]
        lines += [Line("note", note, "warning") for note in drive.notes]
        label = "error"
        for error, name in ((self.truth_error, self.truth_topic), (self.own_error, drive.topic)):
            if error is not None:
                most = f"at most {error.position_m.max():.4f} m and {np.abs(error.heading_rad).max():.4f} rad"
                lines.append(Line(label, f"against {name}: {most}"))
                label = ""
        if self.twist_noise is not None:
            white = "{:g} m/s and {:g} rad/s".format(*self.twist_noise)
            ends = self.runs_xyt[:, -1] - self.xyt[-1]
            position, heading = np.sqrt((ends[:, :2] ** 2).sum(axis=1).mean()), np.sqrt((ends[:, 2] ** 2).mean())
            said = f"{len(self.runs_xyt)} runs with white noise of {white} on every twist, seed {self.seed}"
            apart = f"they end {position:.3g} m and {heading:.3g} rad away (RMS), which depends on the message rate"
            lines += [Line("noise", said), Line("", apart)]
        return Summary(tuple(lines))

    def _values(self) -> dict[str, Any]:
        return {"rule": self.rule, "hold": self.hold, "sentences": [line.text for line in self.summary().lines]}

    def rows(self) -> list[dict[str, Any]]:
        """Return the poses integrated from the twists as they are, one row per message."""
        return [
            {"stamp_ns": stamp, "x_m": x, "y_m": y, "yaw_rad": yaw}
            for stamp, (x, y, yaw) in zip(self.drive.stamps_ns.tolist(), self.xyt.tolist(), strict=True)
        ]

    def save(self, path: str | PathLike[str], *, overwrite: bool = False) -> Rewritten:
        """Write the bag with the poses of run 0 in its odometry and the TF edges that go with it; all else stays.

        path : bag of any kind; not a pipe
        overwrite : whether an existing bag is replaced

        Returns
        -------
        odomcorrupt.trajectories.Rewritten
            Numbers of odometry messages and transforms with other poses.

        Raises
        ------
        BagError
            If the bag exists and `overwrite` is false, or cannot hold the messages.
        """
        provenance = {"command": "integrate", "rule": self.rule, "hold": self.hold}
        if self.twist_noise is not None:
            provenance |= {"seed": str(self.seed), "twist_noise": "{} {}".format(*self.twist_noise)}
        return rewrite_path(
            Path(self.source), drive_path(path), self.drive, self.runs_xyt[0], provenance, overwrite=overwrite
        )

    def _figure(self) -> Figure:
        """Return a figure of the path and its error; with noise, of all runs around the true path."""
        from odomcorrupt.report.plots.paths import draw_errors, draw_runs

        error = self.own_error if self.truth_topic is None else self.truth_error
        if error is None:
            raise TopicError("odometry and truth share no time; name another topic with --truth")
        name = "bag's own path" if self.truth_topic is None else "true path"
        if self.twist_noise is None:
            title = f"Odometry integrated from velocities alone ({self.rule})"
            return draw_errors(error, name, f"twists, {self.rule}", title)
        v, omega = self.twist_noise
        title = f"Velocities with white noise of {v:g} m/s and {omega:g} rad/s"
        return draw_runs(self.runs_xyt, error.truth_xyt, name, title)


def integrate(
    bag: str | PathLike[str],
    *,
    rule: Rule = "exact",
    hold: Hold = "next",
    twist_noise: tuple[float, float] | None = None,
    runs: int = 1,
    seed: int | None = None,
    odom_topic: str | None = None,
    truth: str | None = None,
) -> Integration:
    """Integrate the velocities of a bag's odometry to poses, and compare these with the truth and the bag's own poses.

    bag : bag of any kind; not a pipe
    rule : "euler", "midpoint" or "exact"; over an interval of constant twist: a straight line along its initial heading
        or its middle heading, or the circular arc
    hold : "next" or "previous"; whether a twist holds until the next stamp, or from the previous one
    twist_noise : (float, float) standard deviations of white noise on every twist, m/s and rad/s
    runs : number of runs with noise
    seed : seed of the noise; by default a random one, stated in the result. Run k is independent of the number of runs
    odom_topic : odometry topic whose twists are integrated; by default the only one
    truth : topic of poses to compare with; by default one named like a truth, if there is one

    Returns
    -------
    Integration
        `xyt` are the poses, `runs_xyt` those with noise, `truth_error` and `own_error` their errors; `save` writes the
        bag.

    Raises
    ------
    BagError, TopicError, RecordingError, ModelError
        If the bag cannot be read, has no odometry or no such truth, or a value is invalid.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> driven = oc.integrate("fixtures/office.mcap", twist_noise=(0.2, 0.04), runs=5, seed=1)
    >>> driven.runs_xyt.shape
    (5, 3000, 3)
    >>> driven.save("integrated.mcap").messages
    3000
    """
    path = drive_path(bag)
    if runs < 1:
        raise ModelError(f"--runs {runs}: draw one or more")
    if runs > 1 and twist_noise is None:
        raise ModelError(f"--runs {runs}: without --twist-noise all runs are the same")
    drive = read_drive(path, odom_topic)
    topic = truth or find_truth(path)
    xyt = integrate_twists(drive.xyt[0], drive.twist, drive.t_s, rule, hold=hold)
    integrated = Trajectory(drive.stamps_ns, xyt)
    truth_error = None
    if topic is not None:
        with suppress(ScoreError):  # no time in common
            truth_error = path_errors(integrated, read_poses(path, topic), align="origin")
    noise, drawn_seed, runs_xyt = None, None, xyt[None]
    if twist_noise is not None:
        white_v, white_omega = twist_noise
        noise = (float(white_v), float(white_omega))
        drawn_seed = draw_seed() if seed is None else seed
        twists = noisy_twists(drive.twist, *noise, seed=drawn_seed, runs=range(runs))
        runs_xyt = integrate_twists(drive.xyt[0], twists, drive.t_s, rule, hold=hold)
    return Integration(
        source=fspath(bag),
        drive=drive,
        rule=rule,
        hold=hold,
        xyt=xyt,
        runs_xyt=runs_xyt,
        twist_noise=noise,
        seed=drawn_seed,
        truth_topic=topic,
        truth_error=truth_error,
        own_error=path_errors(integrated, drive.trajectory, align="origin"),
    ).then("odomcorrupt", "integrate", path, "--plot", "errors.png")
