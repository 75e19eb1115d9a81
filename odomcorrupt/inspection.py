"""Contents of a bag: its odometry and TF from one pass, and the messages that corruption would modify."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from odomcorrupt.bags.messages import TRANSFORMS, gather, locate
from odomcorrupt.corruption.odometry_source import (
    ENCODINGS,
    ODOMETRY,
    contains_truth,
    frame_of,
    frames_of,
    localisation_words,
    plain,
    says_truth,
    side_of,
    topics_with_true_motion,
    tree_of,
)
from odomcorrupt.corruption.patch import PLANAR_BLOCK
from odomcorrupt.corruption.path import JUMP_MIN_S, JUMP_SPEED
from odomcorrupt.corruption.pose_faults import FAR_M, Alternation, PoseFaults, frame_faults
from odomcorrupt.corruption.reorder import WINDOW_NS
from odomcorrupt.corruption.se2_on_se3 import PLANAR
from odomcorrupt.corruption.summary import SIDEWAYS, leaks_line
from odomcorrupt.errors import ModelError, TopicError
from odomcorrupt.geometry.se2 import increments, inverse, wrap
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.presets import suggested
from odomcorrupt.standard_streams import visible
from odomcorrupt.summary import ALWAYS, Line, Summary, aligned, command_line

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, Block, Channel
    from odomcorrupt.bags.messages import Item, Layout
    from odomcorrupt.corruption.odometry_source import Frames
    from odomcorrupt.geometry.se2 import Array


@dataclass(slots=True)
class CovarianceCheck:
    """Faults of many 6 x 6 covariances in x, y and yaw."""

    count: int = 0
    largest: float = 0.0
    zero: bool = True
    senseless: bool = False
    crooked: bool = False
    changed: bool = False
    _first: Array | None = None

    def take(self, flat: Array) -> None:
        """Check covariances (n, 36), row-major 6 x 6."""
        planar = flat[:, PLANAR_BLOCK]
        if not len(planar):
            return
        if self._first is None:
            self._first = planar[0].copy()
        self.count += len(planar)
        self.changed |= not bool(np.array_equal(planar, np.broadcast_to(self._first, planar.shape), equal_nan=True))
        self.zero &= not bool(planar.any())
        square = planar.reshape(-1, 3, 3)
        diagonal = np.diagonal(square, axis1=1, axis2=2)
        if not np.isfinite(planar).all() or (diagonal < 0.0).any():
            self.senseless = True
            return
        self.largest = max(self.largest, float(diagonal.max()))
        off = np.abs(square - square.transpose(0, 2, 1)).max(axis=(1, 2))
        # tolerance of the symmetry and positive-semidefiniteness checks, relative to the largest variance
        allowed = 1e-9 * diagonal.max(axis=1)
        self.crooked |= bool((off > allowed).any() or (np.linalg.eigvalsh(square)[:, 0] < -allowed).any())

    def oddity(self, *, never_changes: bool) -> str | None:
        """Return a warning, or None; never_changes: whether constant covariances deserve one."""
        if self.zero:
            return "are all zero" if self.count else None
        if self.senseless:
            return "are negative or not numbers"
        # smallest variance that means "unknown", m^2 or rad^2
        if self.largest >= 1e3:
            return f'mean "unknown" (up to {self.largest:.3g})'
        if self.crooked:
            return "are not symmetric, or not positive"
        if never_changes and self.count > 1 and not self.changed:
            return "never change"
        return None


@dataclass(slots=True)
class TopicRecord:
    """A topic: type, number of messages, first and last log time, and the longest time between two messages."""

    topic: str
    msgtype: str
    count: int = 0
    first_ns: int = 2**62
    last_ns: int = -(2**62)
    longest_gap_ns: int = 0

    @property
    def rate_hz(self) -> float | None:
        """Mean rate, Hz; None for fewer than two messages or no time between them."""
        span_ns = self.last_ns - self.first_ns
        return (self.count - 1) * 1e9 / span_ns if self.count > 1 and span_ns > 0 else None


@dataclass(slots=True)
class PathRecord:
    """All messages of an odometry topic, or all transforms of a TF edge on one topic, in the order of arrival.

    frame, child : frames of its first message; of an edge, parent and child
    stamps_ns (n,); xyt (n, 3) metres, radians; twist (n, 3) forward and leftward m/s, yaw rad/s, None for TF
    pose_covariance, twist_covariance : checks of the covariances
    faults : counts of unusable poses
    """

    topic: str
    frame: str
    child: str
    stamps_ns: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    xyt: Array = field(default_factory=lambda: np.zeros((0, 3)))
    twist: Array | None = None
    pose_covariance: CovarianceCheck = field(default_factory=CovarianceCheck)
    twist_covariance: CovarianceCheck = field(default_factory=CovarianceCheck)
    faults: PoseFaults = field(default_factory=PoseFaults)
    _parts: list[tuple[NDArray[np.int64], Array, Array]] = field(default_factory=list)

    def take(self, block: Block, layout: Layout, item: Item) -> None:
        """Add the messages of a layout."""
        stamps_ns, xyt = self.faults.read(block, layout, item)
        twist = xyt[:, :0]
        if "twist" in item.fields:
            twist = gather(block, layout, item, "twist")[:, PLANAR]
            self.pose_covariance.take(gather(block, layout, item, "pose_covariance"))
            self.twist_covariance.take(gather(block, layout, item, "twist_covariance"))
        self._parts.append((stamps_ns, xyt, twist))

    def complete(self) -> PathRecord:
        """Return the record with its arrays, after the last message."""
        self.stamps_ns, self.xyt, twist = map(np.concatenate, zip(*self._parts, strict=True))
        if twist.size:
            self.twist = twist
            self.faults.paths.take(self.xyt[np.argsort(self.stamps_ns, kind="stable")])
        self._parts.clear()
        return self


@dataclass(frozen=True, slots=True)
class BagScan:
    """Topics by name, odometry, TF edges and frames by channel id (see `frame_of`) of a bag."""

    topics: dict[str, TopicRecord]
    odometry: tuple[PathRecord, ...]
    edges: tuple[PathRecord, ...]
    channels: tuple[Channel, ...]
    placed: Mapping[int, str]


def scan_bag(reader: BagReader, watch: Callable[[Block], None] = lambda _: None) -> BagScan:
    """Return the topics, odometry and TF edges of a bag, from one pass; `watch` is called with every block.

    Raises
    ------
    BagError
        If the bag cannot be read.
    """
    topics: dict[str, TopicRecord] = {}
    odometry: dict[str, PathRecord] = {}
    edges: dict[tuple[str, str, str], PathRecord] = {}
    seen: Counter[int] = Counter()
    placed: dict[int, str] = {}
    for block in reader.blocks():
        watch(block)
        for number, count in zip(*np.unique(block.table["channel"], return_counts=True), strict=True):
            channel = reader.channels[int(number)]
            frame = None if channel.id in seen else frame_of(block, channel)
            placed |= {} if frame is None else {channel.id: frame}
            seen[channel.id] += int(count)
            _count(topics, channel, block)
            if channel.encoding not in ENCODINGS:
                continue
            if channel.msgtype == ODOMETRY:
                for layout in locate(block, channel):
                    item = layout.items[0]
                    new = PathRecord(channel.topic, item.frame_id, item.child_frame_id)
                    odometry.setdefault(channel.topic, new).take(block, layout, item)
            elif channel.msgtype in TRANSFORMS:
                for layout in locate(block, channel):
                    for item in layout.items:
                        key = (channel.topic, plain(item.frame_id), plain(item.child_frame_id))
                        edges.setdefault(key, PathRecord(*key)).take(block, layout, item)
    return BagScan(
        dict(sorted(topics.items())),
        tuple(record.complete() for _, record in sorted(odometry.items())),
        tuple(record.complete() for _, record in sorted(edges.items())),
        tuple(reader.channels[number] for number in sorted(seen)),
        placed,
    )


def _count(topics: dict[str, TopicRecord], channel: Channel, block: Block) -> None:
    record = topics.setdefault(channel.topic, TopicRecord(channel.topic, channel.msgtype))
    times = block.table["log_ns"][block.table["channel"] == channel.id]
    # blocks of a bag may overlap in time: only a message later than all before it ends a gap
    known = times if record.count == 0 else np.append(record.last_ns, times)
    record.longest_gap_ns = max(record.longest_gap_ns, int(np.diff(np.maximum.accumulate(known)).max(initial=0)))
    record.count += len(times)
    record.first_ns = min(record.first_ns, int(times.min()))
    record.last_ns = max(record.last_ns, int(times.max()))


MOVING = 0.05
"""Speed, m/s or rad/s, below which a robot counts as standing."""


def _findings(record: PathRecord) -> dict[str, Any]:
    """Return motion and warnings (oddities) of one odometry topic, as values by name: metres, radians, seconds."""
    finite = np.isfinite(record.xyt).all(axis=1)
    near = (np.abs(np.nan_to_num(record.xyt[:, :2])) < FAR_M).all(axis=1)
    leaps = _leaps(record.stamps_ns)
    sound = finite & near & ~leaps
    stamps, xyt = record.stamps_ns[sound], record.xyt[sound]
    dt = np.diff(stamps) * 1e-9
    steps = increments(xyt) if len(xyt) else increments(np.zeros((1, 3)))
    length = np.hypot(steps.ds_m, steps.dl_m)
    jump = length > JUMP_SPEED * np.maximum(dt, JUMP_MIN_S)
    good = (dt > 0.0) & ~jump
    speed = np.divide(length, dt, out=np.zeros_like(length), where=good)
    turning = np.divide(np.abs(steps.dtheta_rad), dt, out=np.zeros_like(length), where=good)
    duration = float(dt[dt > 0.0].sum())
    odd = []
    if zero := record.faults.zero_stamps:
        odd.append(f"{zero} of {len(record.stamps_ns)} stamps are zero: log times are used instead")
    if (numberless := np.count_nonzero(~finite) - record.faults.no_orientation) > 0:
        odd.append(f"{numberless} poses are not numbers")
    odd += record.faults.sentences()
    if leaps.any():
        odd.append(f"{np.count_nonzero(leaps)} stamps lie far ahead of their neighbours'")
    if record.twist is not None and not record.faults.paths.alternates:
        odd += _twist_oddities(record.twist[sound], xyt, dt, good, speed)
    for name, watch in (("pose", record.pose_covariance), ("twist", record.twist_covariance)):
        said = watch.oddity(never_changes=name == "pose")
        odd += [f"{name} covariances of x, y, yaw {said}"] if said else []
    return {
        "messages": len(record.stamps_ns),
        "duration_s": duration,
        "rate_hz": (len(stamps) - 1) / duration if duration > 0.0 and len(stamps) > 1 else None,
        "distance_m": float(length[~jump].sum()),
        "reverse_m": float(np.abs(steps.ds_m[~jump & (steps.ds_m < 0.0)]).sum()),
        "sideways_m": float(np.abs(steps.dl_m[~jump]).sum()),
        "turned_rad": float(np.abs(steps.dtheta_rad[~jump]).sum()),
        "standing_s": float(dt[good & (speed < MOVING) & (turning < MOVING)].sum()),
        **_steps_back(stamps),
        "jumps": int(np.count_nonzero(jump & (dt >= -WINDOW_NS * 1e-9))),
        "oddities": odd,
    }


def _leaps(stamps_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return a mask (n,) of stamps far ahead of both neighbours: errors of one message, not restarts of time."""
    leaps = np.zeros(len(stamps_ns), dtype=bool)
    before, here, after = stamps_ns[:-2], stamps_ns[1:-1], stamps_ns[2:]
    leaps[1:-1] = (here > before + WINDOW_NS) & (here > after + WINDOW_NS) & (after >= before - WINDOW_NS)
    return leaps


def _steps_back(stamps_ns: NDArray[np.int64]) -> dict[str, int]:
    """Count restarts (jumps back by more than the sorting window) and messages out of order by less."""
    restarts = swapped = 0
    while len(stamps_ns):
        behind = stamps_ns[1:] - np.maximum.accumulate(stamps_ns)[:-1]
        far = np.flatnonzero(behind < -WINDOW_NS)
        stop = int(far[0]) if len(far) else len(behind)
        swapped += int(np.count_nonzero(behind[:stop] < 0))
        restarts += bool(len(far))
        stamps_ns = stamps_ns[stop + 1 :]
    return {"restarts": restarts, "swapped": swapped}


def _twist_oddities(twist: Array, xyt: Array, dt: Array, good: NDArray[np.bool_], speed: Array) -> list[str]:
    """Return warnings where twists (n, 3) disagree with the rates of the poses, in the body or the odom frame."""
    finite = np.asarray(np.isfinite(twist).all(axis=1), dtype=np.bool_)
    odd = [] if finite.all() else [f"{np.count_nonzero(~finite)} twists are not numbers"]
    moving = good & (speed > MOVING) & finite[1:]
    if np.count_nonzero(moving) < 10:
        return odd
    steps = increments(xyt)
    # a corrupt number must not overflow when squared
    stated = np.clip(twist[1:][moving], -1e9, 1e9)
    body = np.column_stack((steps.ds_m, steps.dl_m))[moving] / dt[moving, None]
    world = np.diff(xyt[:, :2], axis=0)[moving] / dt[moving, None]
    if not stated.any():
        return [*odd, "twists are all zero while the robot moves"]
    in_body = float(np.sqrt(np.mean((stated[:, :2] - body) ** 2)))
    in_world = float(np.sqrt(np.mean((stated[:, :2] - world) ** 2)))
    typical = float(np.sqrt(np.mean(body**2)))
    if in_world < 0.5 * in_body and in_body > 0.1 * typical:
        odd.append("twists seem to be in the odom frame, not in the child frame as the message type requires")
    elif min(in_body, in_world) > 0.5 * typical:
        odd.append(f"twists do not fit the poses (they differ by {in_body:.2g} m/s at {typical:.2g} m/s)")
    return odd


def disagreement_m(record: PathRecord, edge: PathRecord, *, turned: bool) -> float | None:
    """Return the largest difference between a TF edge and the odometry, metres; None without overlap in time.

    turned : whether the edge points from the base to odom
    """
    # of messages with equal stamps the last one
    stamps_ns, rows = np.unique(record.stamps_ns[::-1], return_index=True)
    origin_ns = int(stamps_ns[0])
    inside = (edge.stamps_ns >= origin_ns) & (edge.stamps_ns <= stamps_ns[-1])
    if len(stamps_ns) < 2 or not inside.any():
        return None
    at_s = (edge.stamps_ns[inside] - origin_ns) * np.float64(1e-9)
    odometry = Trajectory(stamps_ns, record.xyt[::-1][rows]).at(at_s, origin_ns)
    tf = inverse(edge.xyt[inside]) if turned else edge.xyt[inside]
    # a heading error counts as its displacement at a distance of 1 m
    off = np.hypot(*(tf - odometry)[:, :2].T) + np.abs(wrap((tf - odometry)[:, 2]))
    return float(np.nanmax(off)) if np.isfinite(off).any() else None


SCANS = ("sensor_msgs/msg/LaserScan", "sensor_msgs/msg/PointCloud2")
_GAP_S, _GAP_PERIODS = 2.0, 5.0
"""A reported gap between scans is longer than this, in seconds and in usual periods."""


def summarise(
    scan: BagScan, *, odom_topic: str | None, odom_frame: str | None, base_frame: str | None
) -> dict[str, Any]:
    """Return a bag's summary as JSON-compatible values: metres, radians, seconds.

    Raises
    ------
    TopicError
        If `odom_topic` is not an odometry topic of the bag.
    """
    odom_topic = odom_topic and odom_topic.partition("@")[0]
    source = _source(scan, odom_topic)
    stated = ("", "") if source is None else (source.frame, source.child)
    frames = frames_of(*stated, odom_frame, base_frame)
    drives, home = scan.odometry, None if source is None else source.topic
    if not drives and frames is not None:
        edge = _edge_that_drives(scan, frames, odom_topic)
        drives, home, source = (), None, None
        if edge is not None:  # TF is the odometry
            xyt = edge.xyt if edge.frame == frames.odom else inverse(edge.xyt)
            name, base = f"TF {frames.odom} -> {frames.base}", frames.base or ""
            faults = PoseFaults(zero_stamps=edge.faults.zero_stamps)
            source = replace(edge, topic=name, frame=frames.odom, child=base, xyt=xyt, faults=faults)
            faults.paths.take(xyt[np.argsort(edge.stamps_ns, kind="stable")])
            drives, home = (source,), edge.topic

    def shares(topic: str, with_topic: str | None = home) -> bool:
        """Return whether two topics have the same TF tree; without a source there is no other robot."""
        return with_topic is None or tree_of(topic, scan.channels) == tree_of(with_topic, scan.channels)

    def off_tf_m(o: PathRecord) -> float | None:
        """Return the largest difference of an odometry from its edge of TF, metres."""
        ends = {plain(o.frame), plain(o.child)}
        edges = (e for e in scan.edges if frames is not None and shares(e.topic, o.topic) and "static" not in e.topic)
        edge = next((e for e in edges if {e.frame, e.child} == ends), None)
        return None if edge is None else disagreement_m(o, edge, turned=edge.frame != plain(o.frame))

    moved = {
        o.topic
        for o in drives
        if frames is not None
        and (o is source or (plain(o.frame) == frames.odom and shares(o.topic) and not says_truth(o.topic)))
    }
    sides = [side_of(e.frame, e.child, frames) if frames is not None and shares(e.topic) else None for e in scan.edges]
    true: list[str] = []
    if frames is not None:
        still = (e for e, side in zip(scan.edges, sides, strict=True) if side is None and shares(e.topic))
        ends = ((e.topic, e.frame, e.child) for e in still)
        true = [*topics_with_true_motion(scan.channels, moved, scan.placed, frames.odom)]
        true += sorted({"{} {} -> {}".format(*one) for one in ends if contains_truth(*one, frames)})
    return {
        "odometry_source": None if source is None else source.topic,
        "odom_frame": None if frames is None else frames.odom,
        "base_frame": None if frames is None else frames.base,
        "topics": [
            {"topic": t.topic, "type": t.msgtype, "messages": t.count, "rate_hz": t.rate_hz}
            | {"longest_gap_s": t.longest_gap_ns * 1e-9}
            for t in scan.topics.values()
        ],
        "odometry": [
            {"topic": o.topic, "frame": o.frame, "child": o.child, "moved": o.topic in moved, **_findings(o)}
            | {"tf_differs_m": off_tf_m(o)}
            for o in drives
        ],
        "edges": [
            {"topic": e.topic, "parent": e.frame, "child": e.child, "transforms": len(e.stamps_ns), "moved": bool(side)}
            for e, side in zip(scan.edges, sides, strict=True)
        ],
        "still_true": true,
        "remarks": _remarks(scan, source, frames, [e for e in scan.edges if shares(e.topic)], asked_frame=odom_frame),
    }


def brief(values: dict[str, Any], name: str) -> Summary:
    """Return a short summary: odometry source, its motion, messages that would be modified, warnings.

    values : result of `summarise`, with the bag's provenance
    name : name of the bag
    """
    lines = []
    for o in values["odometry"]:
        if o["topic"] == values["odometry_source"]:
            rate = "" if o["rate_hz"] is None else f", {o['rate_hz']:.3g} Hz"
            drive = f"{o['distance_m']:.4g} m in {o['duration_s']:.4g} s{rate}"
            lines.append(Line("ODOMETRY", f"{o['topic']} ({o['frame']} -> {o['child']}): {drive}", "good"))
    remarks = [*values["remarks"]]
    if not lines and values["odometry"]:
        lines.append(Line("NO CHOICE", "several odometry topics: name one, see below", "bad"))
    elif not lines:
        lines.append(Line("NO ODOMETRY", remarks.pop(0), "bad"))
    said = (sentence for o in values["odometry"] for sentence in o.get("mistakes", ()))
    lines = [*(Line("MISTAKE", sentence, "bad", ALWAYS) for sentence in said), *lines]
    lines += [Line("corrupted", provenance_words(one), "warning") for one in values.get("provenance", ())]
    edges = [f"{e['parent']} -> {e['child']}" for e in values["edges"] if e["moved"]]
    topics = [o["topic"] for o in values["odometry"] if o["moved"]]
    lines.append(Line("moves", ", ".join([*topics, *(f"TF {edge}" for edge in edges)]) or "nothing"))
    named = suggested(name for one in (*values["topics"], *values["edges"]) for name in map(str, one.values()))
    lines += [Line("robot", f"looks like a {named}: --preset {named}")] if named else []
    if values["still_true"]:
        lines.append(leaks_line(values["still_true"]))
    lines += [Line("anomaly", sentence, "warning") for o in values["odometry"] for sentence in o["oddities"]]
    lines += [
        Line("anomaly", f"{t['topic']}: no scans for {t['longest_gap_s']:.1f} s", "warning")
        for t in values["topics"]
        if t["type"] in SCANS and t["rate_hz"] and t["longest_gap_s"] > max(_GAP_S, _GAP_PERIODS / t["rate_hz"])
    ]
    lines += [
        Line("truth", f"{t['topic']}: odomcorrupt learn finds what makes the odometry drift from it")
        for t in values["topics"]
        if says_truth(t["topic"]) and t["type"].endswith(("Odometry", "Stamped")) and t["topic"] not in topics
    ]
    lines += [Line("note", remark, "warning", short=remark.partition(" and localise")[0]) for remark in remarks]
    words = ["odomcorrupt", "preview", name]
    return Summary((*lines, *((command_line(words),) if values["odometry_source"] is not None else ())))


def provenance_words(provenance: Mapping[str, str]) -> str:
    """Return earlier corruptions of a bag, as text."""
    from odomcorrupt.corruption.summary import model_brief  # noqa: PLC0415 - only for bags that were
    from odomcorrupt.model.model_file import parse_model  # noqa: PLC0415 - as above

    parts = [f"{key} {provenance[key]}" for key in ("seed", "run", "version") if key in provenance]
    try:
        model = [model_brief(parse_model(provenance["model"]), "")] if "model" in provenance else []
    except ModelError:
        model = ["a model that this version cannot read"]
    return ", ".join(["before", *parts, *model])


def _source(scan: BagScan, asked: str | None) -> PathRecord | None:
    if asked is None:
        return scan.odometry[0] if len(scan.odometry) == 1 else None
    for record in scan.odometry:
        if plain(record.topic) == plain(asked):
            return record
    if not scan.odometry and any(plain(edge.topic) == plain(asked) for edge in scan.edges):
        return None
    topics = ", ".join(o.topic for o in scan.odometry) or "no topic"
    raise TopicError(f"{asked}: is not a nav_msgs/Odometry topic with messages ({topics} is); name another one")


def _edge_that_drives(scan: BagScan, frames: Frames, topic: str | None) -> PathRecord | None:
    """Return the TF edge between odom and base; None if there is none."""
    for edge in scan.edges:
        asked = "static" not in edge.topic if topic is None else plain(edge.topic) == plain(topic)
        if asked and {edge.frame, edge.child} == {frames.odom, frames.base}:
            return edge
    return None


def _remarks(
    scan: BagScan, source: PathRecord | None, frames: Frames | None, edges: Sequence[PathRecord], *,
    asked_frame: str | None,
) -> list[str]:  # fmt: skip
    said = []
    if not scan.odometry and source is not None:
        said.append("no nav_msgs/Odometry topic: TF is the odometry")
    elif not scan.odometry and frames is not None:
        ends = f"{frames.odom} and {frames.base or 'a base'}"
        said.append(f"no nav_msgs/Odometry topic, and no transform between {ends}: name an edge of the table")
    elif not scan.odometry:
        way_out = "; TF alone can be corrupted with --odom-frame and --base-frame" if scan.edges else ""
        kinds = sorted({f"{c.topic} is one in {c.encoding}" for c in scan.channels if c.msgtype == ODOMETRY})
        unread = f" that can be read ({', '.join(kinds)})" if kinds else ""
        said.append(f"no nav_msgs/Odometry topic{unread}{way_out}")
    elif source is None:
        said.append("several nav_msgs/Odometry topics: name the one to corrupt with --odom-topic")
    elif frames is None and asked_frame is None:
        said.append(f"{source.topic} is in frame {source.frame!r}: name the frame that is to drift with --odom-frame")
    odom, base = (None, None) if frames is None else (frames.odom, frames.base)
    said += frame_faults([(e.frame, e.child) for e in edges], odom, base)
    if frames is not None:
        moved = [e for e in edges if side_of(e.frame, e.child, frames) is not None]
        for e in (e for e in moved if "static" in e.topic):
            said.append(
                f"/tf_static holds {e.frame} -> {e.child}: published once for all time, it cannot follow a drift"
            )
        for e in moved if scan.odometry else ():
            path = Alternation()
            path.take(e.xyt[np.argsort(e.stamps_ns, kind="stable")])
            said += [f"TF {e.frame} -> {e.child}: {path.sentence()}"] if path.alternates else []
        said += localisation_words({f"{e.frame} -> {e.child}": e.topic for e in edges}, frames, scan.channels)
        if not moved:
            said.append(f"no transform from or to {frames.odom} would move")
    return said


def _visible(value: Any) -> Any:
    """Return values with control characters in all strings escaped."""
    if isinstance(value, dict):
        return {key: _visible(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_visible(one) for one in value]
    return visible(value) if isinstance(value, str) else value


def summary_text(values: dict[str, Any]) -> str:
    """Return tables of topics and edges, then the motion of each odometry."""
    values = _visible(values)
    by_topic = {o["topic"]: o for o in values["odometry"]}
    rows: list[tuple[str, ...]] = [("topic", "type", "messages", "Hz", "")]
    for t in values["topics"]:
        rate = "" if t["rate_hz"] is None else f"{t['rate_hz']:.3g}"
        fate = "moves" if by_topic.get(t["topic"], {}).get("moved") else ""
        fate = "contains the true motion" if t["topic"] in values["still_true"] else fate
        rows.append((t["topic"], t["type"].replace("/msg/", "/"), str(t["messages"]), rate, fate))
    lines = aligned(rows, [i for i, head in enumerate(rows[0]) if head in _RIGHT])
    shown = [e for e in values["edges"] if e["moved"] or "static" not in e["topic"]]
    if shown:
        rows = [("edge", "topic", "transforms", "")]
        for e in shown:
            fate = "moves" if e["moved"] else ""
            rows.append((f"{e['parent']} -> {e['child']}", e["topic"], str(e["transforms"]), fate))
        lines += ["", *aligned(rows, [i for i, head in enumerate(rows[0]) if head in _RIGHT])]
    if len(shown) < len(values["edges"]):
        lines.append(f"and {len(values['edges']) - len(shown)} static edges that stay")
    for o in values["odometry"]:
        lines += ["", *_about(o, source=o["topic"] == values["odometry_source"])]
    return "\n".join(lines)


def _about(o: dict[str, Any], *, source: bool) -> list[str]:
    rate = "" if o["rate_hz"] is None else f", {o['rate_hz']:.3g} Hz"
    ends = f"{o['frame'] or 'no frame'} -> {o['child'] or 'no child'}"
    turned = f"{math.degrees(o['turned_rad']):.0f} deg of turning"
    driven = f"{o['distance_m']:.4g} m ({o['reverse_m']:.2f} m of it backwards) and {turned}"
    lines = [
        f"{o['topic']} ({ends}{rate})" + (": the odometry to corrupt" if source else ""),
        f"  {driven} in {o['duration_s']:.4g} s, {o['standing_s']:.1f} s of them standing",
    ]
    counts = [f"{o[key]} {words}" for key, words in _COUNTS.items() if o[key]]
    lines += [f"  {', '.join(counts)}"] if counts else []
    if o["sideways_m"] > SIDEWAYS * o["distance_m"] and not any("two publishers" in said for said in o["oddities"]):
        lines.append(f"  moves sideways ({o['sideways_m']:.3g} m): --law omni is made for that")
    # largest difference at which odometry and TF agree, metres
    if o["tf_differs_m"] is not None and o["tf_differs_m"] > 0.01:
        lines.append(f"  TF and odometry differ by up to {o['tf_differs_m']:.3g} m")
    return lines


_RIGHT = ("messages", "Hz", "transforms")
"""Columns of numbers."""
_COUNTS = {"restarts": "restarts of time", "swapped": "messages out of order", "jumps": "jumps of the pose"}
