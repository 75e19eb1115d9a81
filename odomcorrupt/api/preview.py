"""A bag before it is corrupted: its contents, and a forecast of the drift that a model will cause in it."""

from __future__ import annotations

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
from odomcorrupt.corruption.summary import per_message
from odomcorrupt.corruption.transform import Options
from odomcorrupt.errors import OdomCorruptError, RecordingError
from odomcorrupt.forecasting.forecast import brief, forecast, forecast_json, forecast_text, read_clean_drive
from odomcorrupt.inspection.scan import scan_bag
from odomcorrupt.inspection.summary import brief as contents_brief
from odomcorrupt.inspection.summary import summarise, summary_text
from odomcorrupt.report.plain import finite
from odomcorrupt.rng import draw_seed

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from os import PathLike

    from matplotlib.figure import Figure

    from odomcorrupt.bags.block import Block
    from odomcorrupt.forecasting.forecast import Forecast
    from odomcorrupt.inspection.scan import OdometryRecord
    from odomcorrupt.mapping.conditioned import MapCondition
    from odomcorrupt.summary import Summary


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

    def details(self) -> str:
        """Return tables of topics and TF edges, then sentences about the odometry."""
        return summary_text(dict(self.values))

    def to_dict(self) -> dict[str, Any]:
        """Return the contents as docs/json.md describes them: metres, radians, seconds."""
        return finite(self.values)

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


def _mistakes(record: OdometryRecord) -> list[str]:
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
        return brief(self.result, self.model.motion_model, self.model.origin, self.seed)

    def details(self) -> str:
        """Return drive, model, a table of the drift, and whether the message rate matters."""
        return forecast_text(self.result, self.model.motion_model, self.model.origin, self.seed)

    def to_dict(self) -> dict[str, Any]:
        """Return the forecast as docs/json.md describes it: metres, radians, seconds."""
        return finite(forecast_json(self.result, self.model.motion_model, self.seed))

    def rows(self) -> list[dict[str, Any]]:
        """Return the drift after each distance, the last one at the end: RMS, 90 % quantile, mean error."""
        return [asdict(row) for row in self.result.rows]

    def _figure(self) -> Figure:
        """Return a figure of the noisy paths over the clean one, and of the drift against distance."""
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
