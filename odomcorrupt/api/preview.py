"""A bag before it is corrupted: its contents, and a forecast of the drift that a model will cause in it."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from os import PathLike, fspath
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from odomcorrupt.api.bag_options import BagOptions, as_condition, bag_path, split_options
from odomcorrupt.api.model import Model, ModelLike, as_model
from odomcorrupt.api.result import Result
from odomcorrupt.bags.open import open_reader
from odomcorrupt.bags.provenance import ProvenanceWatcher
from odomcorrupt.corruption.inverse import SystematicEffects
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.corruption.summary import holonomic_words, model_brief, model_words, per_message, size_words
from odomcorrupt.corruption.transform import Options
from odomcorrupt.errors import OdomCorruptError, RecordingError
from odomcorrupt.forecasting import forecast, read_clean_drive
from odomcorrupt.inspection import brief as contents_brief
from odomcorrupt.inspection import scan_bag, summarise, summary_text
from odomcorrupt.report.plain import picked
from odomcorrupt.rng import draw_seed
from odomcorrupt.summary import Line, Summary

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from matplotlib.figure import Figure

    from odomcorrupt.bags.block import Block
    from odomcorrupt.forecasting import Forecast
    from odomcorrupt.inspection import PathRecord
    from odomcorrupt.mapping.conditioned import MapCondition


@dataclass(frozen=True, slots=True, repr=False)
class Info(Result):
    """Contents of a bag, and the messages that corruption would modify.

    source : the bag; "-" is a pipe
    values : everything found, see `to_dict`
    losses : unreadable parts of a damaged bag, in sentences
    """

    source: str
    values: Mapping[str, Any]
    losses: tuple[str, ...] = ()

    def summary(self) -> Summary:
        """Return the odometry and its motion, the messages that would be modified, and warnings."""
        return contents_brief(dict(self.values), self.source)

    def _tables(self) -> str:
        return summary_text(dict(self.values))

    def _values(self) -> dict[str, Any]:
        return dict(self.values)

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per topic: type, number and rate of its messages, and whether corruption modifies it."""
        moved = {one["topic"] for one in (*self.values["odometry"], *self.values["edges"]) if one["moved"]}
        return [{**one, "moved": one["topic"] in moved} for one in self.values["topics"]]


def info(
    bag: str | PathLike[str],
    *,
    odom_topic: str | None = None,
    odom_frame: str | None = None,
    base_frame: str | None = None,
    recover: bool = False,
    watch: Callable[[Block], None] = lambda _: None,
) -> Info:
    """Return a bag's topics, frames, TF edges, its motion, anomalies, and topics that still contain the true motion.

    bag : bag of any kind, read once; "-" is a pipe
    odom_topic : odometry topic that a model would be applied to; by default the only one
    odom_frame, base_frame : frames, if those of the odometry messages differ from those of TF
    recover : whether to read the undamaged parts of a damaged bag
    watch : called with every block read

    Returns
    -------
    Info
        `to_dict()` has all values, `to_pandas()` one row per topic.

    Raises
    ------
    BagError, TopicError
        If the bag cannot be read, or `odom_topic` is not an odometry topic of it.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> contents = oc.info("fixtures/office.mcap")
    >>> [row["topic"] for row in contents.rows() if row["moved"]]
    ['/odom', '/tf']
    >>> contents.to_dict()["odometry"][0]["messages"]
    3000
    """
    path, watcher = bag_path(bag), ProvenanceWatcher(watch)
    with open_reader(path, recover=recover) as reader:
        scan = scan_bag(reader, watcher)
        losses, remarks = tuple(reader.losses), getattr(reader, "remarks", ())
    found = {record.topic: _mistakes(record) for record in scan.odometry}
    values = summarise(scan, odom_topic=odom_topic, odom_frame=odom_frame, base_frame=base_frame)
    values["remarks"] += remarks
    for one in values["odometry"]:
        one["mistakes"] = found.get(one["topic"], [])
    return Info(fspath(bag), values | {"provenance": [*watcher.provenance(path)]}, losses)


def _mistakes(record: PathRecord) -> list[str]:
    """Return the plain mistakes that odometry shows without a truth; none without the libraries of the study."""
    try:
        from odomcorrupt.study.io.first_look import mistakes_alone
        from odomcorrupt.study.io.raw_trajectory import Samples, in_order
    except ImportError:
        return []
    none, xyt = np.zeros(0), record.xyt
    xyz = np.column_stack((xyt[:, :2], np.zeros(len(xyt))))
    path = Samples("", "", record.frame, record.stamps_ns, xyz, xyt[:, 2], none.astype(np.int64), none)
    try:
        return [one.sentence.removeprefix(": ") for one in mistakes_alone(in_order(path))]
    except RecordingError:  # too few poses
        return []


@dataclass(frozen=True, slots=True, repr=False)
class Preview(Result):
    """Drift that a motion model will cause in the odometry of a bag, from many runs.

    result : complete numerical result: the drive, the drift after each distance, paths
    model : model of the drift
    seed : seed of the runs
    losses : unreadable parts of a damaged input, in sentences
    """

    result: Forecast
    model: Model
    seed: int
    losses: tuple[str, ...] = ()

    def summary(self) -> Summary:
        """Return the drift at the end and on the way, the model, and whether the message rate matters."""
        outlook, model = self.result, self.model.motion_model
        *middle, end = outlook.rows
        said = f"{size_words(end.position_rms_m, end.heading_rms_rad)} RMS after {outlook.distance_m:.4g} m"
        lines = [Line("DRIFT", f"{said}; 9 of 10 below {end.position_90_m:.3g} m", "good")]
        lines += [
            Line(f"at {row.after_m:g} m", f"{size_words(row.position_rms_m, row.heading_rms_rad)} RMS")
            for row in [row for row in middle if row.after_m >= 1.0][-2:]
        ]
        if per_message(model.noise):
            lines += [Line("rate", sentence, "warning") for sentence in self._rate]
        lines += [Line("anomaly", sentence, "warning") for sentence in self._warnings]
        rate = "" if outlook.rate_hz is None else f" at {outlook.rate_hz:.3g} Hz"
        drive = f"{outlook.name}: {outlook.distance_m:.4g} m in {outlook.duration_s:.4g} s{rate}"
        runs = f"runs {outlook.first_run} to {outlook.first_run + outlook.runs - 1} of seed {self.seed}, over {drive}"
        lines.append(Line("runs", f"{outlook.runs} of seed {self.seed}, over {outlook.name}", full=runs))
        origin = self.model.origin
        lines.append(Line("model", model_brief(model, origin.partition(":")[0]), full=model_words(model, origin)))
        if not per_message(model.noise):
            said = "the noise does not depend on the message rate"
            lines += [Line("rate", said, full=sentence) for sentence in self._rate]
        return Summary(tuple(lines))

    def _tables(self) -> str:
        outlook, model = self.result, self.model.motion_model
        systematic = any(effect.acts and effect.kind != "noise" for effect in model.effects)
        lines = ["    after     position   9 of 10 below       heading" + "   of it constant" * systematic]
        for row in outlook.rows:
            after = "the end" if row is outlook.rows[-1] else f"{row.after_m:.0f} m"
            line = f"{after:>9}   {row.position_rms_m:8.3g} m   {row.position_90_m:11.3g} m"
            line += f"   {math.degrees(row.heading_rms_rad):7.3g} deg"
            line += f"   {size_words(row.position_mean_m, row.heading_mean_rad)}" if systematic else ""
            lines.append(line)
        return "\n".join(lines)

    @property
    def _rate(self) -> list[str]:
        """Whether the noise depends on the message rate, in sentences; none without noise."""
        outlook, noise = self.result, self.model.motion_model.noise
        if noise.coefficients.noise_free:
            return []
        factors = (outlook.half_rate_position, outlook.half_rate_heading)
        grown = "travel would be {:.3g} and heading {:.3g} times as uncertain.".format(*factors)
        if per_message(noise):
            return [f"The noise depends on the message rate: at half of it, {grown}"]
        said = "The noise does not depend on the message rate."
        # deviation of a factor from 1 that the discretisation of a drive explains
        if max(abs(factor - 1.0) for factor in factors) > 0.03:
            said += f" This recording does: jitter between messages counts as motion; with every second message {grown}"
        return [said]

    @property
    def _warnings(self) -> list[str]:
        return holonomic_words(self.model.motion_model, self.result.sideways_m, self.result.distance_m)

    def _values(self) -> dict[str, Any]:
        outlook = self.result
        return {
            "odometry_source": outlook.name,
            **picked(outlook, "distance_m", "duration_s", "sideways_m", "rate_hz"),
            "seed": self.seed,
            **picked(outlook, "first_run", "runs"),
            "rows": self.rows(),
            "depends_on_rate": bool(per_message(self.model.motion_model.noise)),
            "half_rate_position_factor": outlook.half_rate_position,
            "half_rate_heading_factor": outlook.half_rate_heading,
            "warnings": self._warnings,
        }

    def rows(self) -> list[dict[str, Any]]:
        """Return the drift after each distance, the last one at the end: RMS, 90 % quantile, mean error."""
        return [asdict(row) for row in self.result.rows]

    def _figure(self) -> Figure:
        from odomcorrupt.report.plots.paths import draw_fan

        title = f"{self.result.name}: what this model does to {self.result.distance_m:.3g} m"
        if per_message(self.model.motion_model.noise) and self.result.rate_hz is not None:
            title += f" at {self.result.rate_hz:.3g} Hz; the noise depends on the message rate"
        return draw_fan(self.result, title)


def preview(
    bag: str | PathLike[str],
    model: ModelLike = "typical",
    *,
    seed: int | None = None,
    run: int = 0,
    runs: int = 100,
    within: MapCondition | str | PathLike[str] | None = None,
    watch: Callable[[Block], None] = lambda _: None,
    **options: Unpack[BagOptions],
) -> Preview:
    """Return how far a motion model will make the odometry of a bag drift, from many runs; no bag is written.

    bag : bag of any kind, read once; "-" is a pipe
    model : model, noise, model file or preset; by default the preset `typical`
    seed : seed of all random draws: run k is the one that `corrupt` draws with this seed and `run=k`; by default drawn
    run, runs : number of the first run, and number of runs, two or more
    within : map condition or a map's .yaml; as in `corrupt`
    watch : called with every block read
    **options : see `BagOptions`; those that concern only the output have no effect

    Returns
    -------
    Preview
        `rows()` and `to_pandas()` have the drift after 1, 2, 5, 10 ... m and at the end.

    Raises
    ------
    BagError, TopicError, EffectError, ModelError, MapError
        If the bag cannot be read, has no odometry to apply the model to, or the model is invalid.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> forecast = oc.preview("fixtures/office.mcap", "typical", runs=20)
    >>> [row["after_m"] for row in forecast.rows()[:3]], round(forecast.result.distance_m, 2)
    ([1.0, 2.0, 5.0], 25.05)
    """
    moved, container = split_options(options)
    if runs < 2:
        raise OdomCorruptError(f"runs: {runs}; draw two or more")
    chosen = as_model(model)
    robot, condition = chosen.motion_model, as_condition(within)
    wanted = Options(moved.odom_topic, moved.odom_frame, moved.base_frame)
    with open_reader(bag_path(bag), recover=container.recover) as reader:
        drive = read_clean_drive(reader, robot, wanted, watch)
        losses = tuple(reader.losses)
    systematic = SystematicEffects(robot)
    seed = draw_seed() if seed is None else seed
    paths = (
        (None if condition is None else condition.path(robot, seed, number, drive))
        or NoisyPath(robot, seed, number, systematic=systematic)
        for number in range(run, run + runs)
    )
    return Preview(forecast(drive, robot, paths, first_run=run), chosen, seed, losses)
