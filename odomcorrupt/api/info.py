"""Contents of a bag: topics, odometry and its faults, and the messages that corruption would modify."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike, fspath
from typing import TYPE_CHECKING, Any

import numpy as np

from odomcorrupt.api.bag_options import bag_path
from odomcorrupt.api.result import Result
from odomcorrupt.bags.open import open_reader
from odomcorrupt.bags.provenance import ProvenanceWatcher
from odomcorrupt.errors import RecordingError
from odomcorrupt.inspection.scan import scan_bag
from odomcorrupt.inspection.summary import brief, summarise, summary_text
from odomcorrupt.report.json.numbers import finite

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from odomcorrupt.bags.block import Block
    from odomcorrupt.inspection.scan import OdometryRecord
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
        return brief(dict(self.values), self.source)

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

    Parameters
    ----------
    bag : path
        Bag of any kind, read once; "-" is a pipe.
    odom_topic : str, optional
        Odometry topic that a model would be applied to; by default the only one.
    odom_frame, base_frame : str, optional
        Frames, if those of the odometry messages differ from those of TF.
    recover : bool
        Whether to read the undamaged parts of a damaged bag.
    watch : callable
        Called with every block read.

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
