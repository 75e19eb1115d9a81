"""Corruption of one bag: reader, transform, writer; an output without changes is a copy of the input's bytes."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, BinaryIO, cast

import odomcorrupt
from odomcorrupt.bags.open import open_reader, open_writer, target_of
from odomcorrupt.bags.output import Output
from odomcorrupt.bags.pipeline import Workers, default_threads
from odomcorrupt.corruption.inverse import changes_nothing
from odomcorrupt.corruption.odometry_source import plain, topics_with_true_motion
from odomcorrupt.corruption.pose_faults import PoseFaults
from odomcorrupt.corruption.transform import Transform
from odomcorrupt.errors import TopicError
from odomcorrupt.model.model_file import format_model
from odomcorrupt.rng import SEED_LIMIT, stream

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from odomcorrupt.bags.block import BagReader, BagWriter, Block, Channel
    from odomcorrupt.bags.convert.message_types import Generation
    from odomcorrupt.bags.open import Form, Target
    from odomcorrupt.corruption.odometry_source import Frames
    from odomcorrupt.corruption.patch import Changes
    from odomcorrupt.corruption.path import Drift, PathSource
    from odomcorrupt.corruption.reorder import TimeOrder
    from odomcorrupt.corruption.transform import Options
    from odomcorrupt.model.motion_model import MotionModel


def may_stay(source: Path | None, reader: BagReader, form: Form) -> bool:
    """Return whether an output may be a byte copy of its input: one file, or a pipe, and the same format.

    source : the input; None is a pipe
    form : format of the output
    """
    if (source is not None and (source.is_dir() or not source.exists())) or getattr(reader, "mode", "none") != "none":
        return False
    if source is not None and reader.kind == "sqlite3":
        from odomcorrupt.bags.rosbag2.database import unfinished  # noqa: PLC0415 - sqlite3 is slow to import

        if unfinished(source):
            return False
    return not form.directory and form.kind == reader.kind


class TeeReader:
    """Stream that records the bytes read from a pipe, so that they can be copied to an output."""

    def __init__(self, stream: BinaryIO | None = None) -> None:
        self._stream: BinaryIO = sys.stdin.buffer if stream is None else stream
        self._kept = bytearray()
        self._output: Output | None = None
        self._recording = True

    def read(self, size: int = -1) -> bytes:
        """Return at most `size` bytes."""
        data = self._stream.read(size)
        self._take(data)
        return data

    def readinto(self, view: memoryview) -> int:
        """Read bytes into a buffer; return how many."""
        got: int = self._stream.readinto(view)  # type: ignore[attr-defined] # a buffered stream has it
        self._take(view[:got])
        return got

    def _take(self, data: bytes | memoryview) -> None:
        if self._output is not None:
            self._output.write(data)
        elif self._recording:
            self._kept += data

    def play(self, output: Output) -> None:
        """Write the bytes read so far to an output, and from now on all that are read."""
        self._output = output
        output.write(bytes(self._kept))
        self._kept.clear()

    def stop(self) -> None:
        """Stop recording."""
        self._recording = False
        self._kept.clear()


def write_as_it_was(
    bag: TeeReader | Path, target: Path | None, blocks: Iterable[Block], watch: Callable[[Block], None], *, overwrite:
    bool = False,
) -> None:  # fmt: skip
    """Copy a bag byte by byte after reading its blocks (a pipe: while reading); `watch` is called with each block.

    bag : the file, or the stream from which the blocks are read
    target : the output; None is stdout
    """
    output = Output(target, sys.stdout.buffer if target is None else None, overwrite=overwrite)
    output.summing = False
    try:
        output.open()
        if isinstance(bag, TeeReader):
            bag.play(output)
        for block in blocks:
            watch(block)
        with nullcontext(bag) if isinstance(bag, TeeReader) else bag.open("rb") as rest:
            while piece := rest.read(1 << 16):
                if rest is not bag:
                    output.write(piece)
        output.commit()
    except BaseException:
        output.discard()
        raise


@dataclass(frozen=True, slots=True)
class Container:
    """Options for reading and writing bags, as `odomcorrupt.api.bag_options.BagOptions` describes them."""

    overwrite: bool = False
    compression: str | None = None
    level: int | None = None
    recover: bool = False
    ros: Generation | None = None
    storage: str | None = None
    exclude: tuple[str, ...] = ()
    rename: tuple[str, ...] = ()
    scan_every: int = 1
    threads: int | None = field(default=None, compare=False, repr=False)  # does not change the output

    @property
    def as_it_was(self) -> bool:
        """Whether an output without changes may be a byte copy of the input."""
        same = self.compression is None and self.level is None
        return same and not (self.recover or self.exclude or self.rename or self.scan_every > 1)

    def target(self, path: Path | None, reader: BagReader) -> Target:
        """Return an output, with a reader of the input that yields the messages as the output has them."""
        if self.scan_every < 1:
            raise TopicError(f"scan_every: {self.scan_every}; 1 keeps all laser scans, 2 every second one")
        return target_of(
            path, reader, ros=self.ros, storage=self.storage, exclude=self.exclude, rename=self.rename,
            recover=self.recover, scan_every=self.scan_every,
        )  # fmt: skip

    def writer(self, path: Path | None, output: Target, workers: Workers | None = None) -> BagWriter:
        """Return the writer of an output; parameters as of `open_writer`."""
        return open_writer(
            path, output.reader, overwrite=self.overwrite, compression=self.compression, level=self.level,
            workers=workers, form=output.form,
        )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Outcome:
    """Result of one run.

    odometry : name of the odometry source
    channels : those that carried messages
    order : counts of odometry messages that were out of order, and of jumps back in time
    unusable : odometry poses that are not numbers
    added : number of added messages, by topic or edge
    losses : parts of a damaged input that could not be read, one sentence each
    placed : frame in which a channel's data are given, by channel id, see `frame_of`
    stayed : topics of the TF edges that are not moved, "parent -> child"; true_edges : those with the true motion
    faults : counts of unusable odometry poses
    remarks : what the output's message types cannot hold, in sentences
    scans : number of laser scans that are kept, by topic, where others are left out
    others : results of the other robots corrupted in the same pass
    """

    model: MotionModel
    seed: int
    run: int
    odometry: str
    frames: Frames
    changes: Changes
    drift: Drift
    channels: tuple[Channel, ...]
    order: TimeOrder
    unusable: int
    added: Mapping[str, int]
    losses: tuple[str, ...]
    placed: Mapping[int, str]
    stayed: Mapping[str, str] = field(default_factory=dict)
    true_edges: frozenset[str] = frozenset()
    faults: PoseFaults = field(default_factory=PoseFaults)
    remarks: tuple[str, ...] = ()
    scans: Mapping[str, int] = field(default_factory=dict)
    others: tuple[Outcome, ...] = ()

    @property
    def with_true_motion(self) -> list[str]:
        """Unmodified topics and TF edges that contain the true motion."""
        topics = topics_with_true_motion(self.channels, self.moved_topics, self.placed, self.frames.odom)
        return [*topics, *sorted(self.true_edges)]

    @property
    def moved_topics(self) -> set[str]:
        """Topics of odometry and other sensors that are moved, of all robots."""
        every = [one.changes for one in (self, *self.others)]
        return {topic for changes in every for topic in (*changes.odometry, *changes.sensors)}


def corrupt_bag(
    source: Path | None, target: Path | None, model: MotionModel, *, seed: int, run: int, options: Options, container:
    Container, watch: Callable[[Block], None] = lambda _: None, path: PathSource | None = None, metadata: Mapping[str,
    str] | None = None, also: Sequence[str] = (),
) -> Outcome:  # fmt: skip
    """Write a corrupted copy of a bag and return what was changed; the output appears only when complete.

    source, target : bags; None is a pipe
    model : noise and effects
    seed, run : seed of all draws, and number of the run
    options : what is moved
    container : how bags are read and written
    watch : called with every block written
    path : corrupted path, instead of the noisy path that the model draws
    metadata : further metadata for the output, besides model, seed, run and version
    also : odometry topics of other robots, each with a drift of its own, whose seed follows from `seed`

    Raises
    ------
    BagError
        If the input cannot be read or the output not be written.
    TopicError
        If there is no odometry source.
    EffectError
        If an effect is too strong for this drive.
    """
    transform = Transform(model, seed, run, options, path=path)
    robots = [transform]
    for ordinal, topic in enumerate(also, 1):
        own = int(stream(seed, run, "robot", ordinal).integers(SEED_LIMIT))
        kept = options._replace(
            odom_topic=topic, odom_frame=None, base_frame=None, keep_truth=None, scan_noise=0.0, scan_keep=1.0, imu=None
        )
        robots.append(Transform(model, own, run, kept))
    is_identity = changes_nothing(model) and not options.degrades
    adds = options.keep_truth is not None or options.new_odom_frame is not None
    tape = TeeReader() if source is None and is_identity and not adds and container.as_it_was else None
    threads = default_threads(source) if container.threads is None else container.threads
    with (
        Workers(threads) as workers,
        open_reader(source, cast("BinaryIO | None", tape), recover=container.recover) as raw,
    ):
        output = container.target(target, raw)
        reader = output.reader
        for robot in robots:
            robot.odometry.prepare(reader, reader.name)
        if len({plain(topic) for topic in (*also, transform.odometry.topic or "")}) <= len(also):
            raise TopicError(f"--also {also[0]}: is corrupted already; name the odometry of each robot once")
        writer = container.writer(target, output, workers)
        if is_identity and not adds and container.as_it_was and reader is raw and may_stay(source, reader, output.form):
            blocks = _chained(robots, reader)
            write_as_it_was(tape or reader.paths[0], target, blocks, watch, overwrite=container.overwrite)
        else:
            if tape is not None:
                tape.stop()
            with writer:
                for block in _chained(robots, reader, writer):
                    writer.write(block)
                    watch(block)
                for robot in robots:
                    robot.require_source()
                if not is_identity:
                    more = dict(metadata or {}) | ({"also": " ".join(also)} if also else {})
                    writer.provenance("odomcorrupt", provenance(model, seed=seed, run=run) | more)
        first, *others = (outcome_of(robot, reader, model, seed=robot.seed, run=run) for robot in robots)
        return replace(first, others=tuple(others))


def _chained(robots: Sequence[Transform], reader: BagReader, writer: BagWriter | None = None) -> Iterator[Block]:
    """Return the blocks of a bag, changed by the transform of one robot after the other."""
    blocks = None
    for robot in robots:
        blocks = robot.blocks(reader, reader.name, writer, blocks)
    assert blocks is not None  # noqa: S101 - there is at least one
    return blocks


def outcome_of(transform: Transform, reader: BagReader, model: MotionModel, *, seed: int, run: int) -> Outcome:
    """Return the result of a transform that has read a bag to its end.

    transform : after its last block
    reader : the bag that it read, still open
    model : model to report
    seed, run : seed of all draws, and number of the run
    """
    drift = transform.drift.result()
    assert drift is not None  # noqa: S101 - the transform raises where there was no odometry
    frames = transform.odometry.frames
    assert frames is not None  # noqa: S101 - as above
    odometry, truth, edge = transform.odometry, transform.truth, transform.run.edge
    added = {} if truth is None else {f"messages of clean odometry on {truth.topic}": truth.count}
    added |= {} if edge is None else {f"transforms {edge.frame} -> {frames.odom}": edge.count}
    return Outcome(
        model=model, seed=seed, run=run, odometry=odometry.name, frames=frames, changes=transform.changes, drift=drift,
        channels=tuple(reader.channels[number] for number in sorted(transform.seen)), order=transform.order,
        unusable=transform.unusable, faults=odometry.faults, added=added, placed=transform.placed,
        stayed=dict(transform.stayed), true_edges=frozenset(transform.true_edges), losses=tuple(reader.losses),
        remarks=tuple(getattr(reader, "remarks", ())), scans=dict(getattr(reader, "scans", {})),
    )  # fmt: skip


def provenance(model: MotionModel, **numbers: int) -> dict[str, str]:
    """Return what is noted in an output: version, model, and numbers such as seed and run."""
    return {"version": odomcorrupt.__version__, **{k: str(n) for k, n in numbers.items()}, "model": format_model(model)}
