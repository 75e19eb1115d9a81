"""One hostile input tried: what may happen, and everything that may not.

May: an answer, or one error of the project's own class, in one line. May not: another error, a warning, a hang, memory
beyond the bound, debris, a touched input, messages lost without a word, an error that advises what was already given.
"""

import io
import resource
import shutil
import signal
import sqlite3
import tempfile
import warnings
from collections import Counter
from contextlib import closing, contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path

from mcap.reader import NonSeekingReader
from mcap.records import Attachment, Message, Metadata
from mcap.stream_reader import StreamReader
from mutations import ros1_headers
from rosbags.rosbag1 import Reader as Ros1LibraryReader

from odomcorrupt.bags.messages import READABLE, UnreadableEncodingError, locate
from odomcorrupt.bags.open import open_reader, open_writer
from odomcorrupt.cli import run
from odomcorrupt.corruption.transform import Options, Transform
from odomcorrupt.errors import OdomCorruptError
from odomcorrupt.model.motion_model import MotionModel, Noise
from odomcorrupt.model.noise_laws import Coefficients

CPU_S = 20
"""No small input takes longer."""
WALL_S = 600
"""Nor waits for anything, however busy the machine is."""
MEMORY_BYTES = 1 << 29
"""How much more than at the start may be asked for: inputs are small, whatever they claim."""

MODEL = MotionModel(Noise("diffusion", Coefficients(0.05, 0.02, 0.05, 0.01)))


class FoundError(BaseException):
    """A promise that was broken; no library may swallow it."""


@contextmanager
def guarded(cpu_s=CPU_S):
    """Bound time and memory, and make warnings errors."""

    def late(_number, _frame):
        raise FoundError(f"took longer than {cpu_s} s of CPU time, or {WALL_S} s")

    before = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    handlers = {number: signal.signal(number, late) for number in (signal.SIGALRM, signal.SIGPROF)}
    signal.alarm(WALL_S)
    signal.setitimer(signal.ITIMER_PROF, cpu_s)
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY_BYTES, before[1]))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
        signal.alarm(0)
        signal.setitimer(signal.ITIMER_PROF, 0)
        for number, handler in handlers.items():
            signal.signal(number, handler)


def judged(function, *args):
    """Call a function; return its result, or the project's own error. Anything else is raised as found."""
    try:
        with guarded():
            return function(*args)
    except OdomCorruptError as error:
        if not str(error) or ("\n" in str(error).strip() and len(str(error)) > 2000):
            raise FoundError(f"an error without a clear line: {error!r}") from error
        return error
    except Exception as error:
        raise FoundError(f"{type(error).__name__}: {error}") from error


def library_content(path: Path) -> list[tuple] | None:
    """Return what other people's libraries see: messages, type first, and then what else; None where they refuse."""
    try:
        with guarded():
            return _library_content(path)
    except (Exception, FoundError):  # noqa: BLE001 - theirs may fail as they like
        return None


def library_count(path: Path) -> int | None:
    """Return how many messages other people's libraries see, None where they refuse."""
    seen = library_content(path)
    return None if seen is None else sum(one[0] is not EXTRA for one in seen)


EXTRA = object()
"""In place of a type: an attachment or metadata."""
OURS = {"nav_msgs/Odometry", "nav_msgs/msg/Odometry", "tf2_msgs/TFMessage", "tf2_msgs/msg/TFMessage", "tf/tfMessage"}
"""Types of messages that may change."""


def others(path: Path) -> list[tuple] | None:
    """Return what an independent reader gets beside odometry, TF and our own note; None where it refuses the bag."""
    seen = library_content(path)
    return None if seen is None else [one for one in seen if one[0] not in OURS and one[:2] != (EXTRA, "odomcorrupt")]


def rest_is_kept(path: Path, out: Path) -> bool:
    """Whether readers get the same of both bags, beside odometry and TF, where they take the first.

    A ROS 1 bag's index may leave out messages that lie in its chunks: ours has them all. Then nothing may be missing,
    and no message may have come from anywhere else than the input's chunks.
    """
    before, after = others(path), others(out)
    if before in (None, after) or path.suffix != ".bag" or after is None:
        return before in (None, after)
    return not Counter(before) - Counter(after) and walked_count(path) == walked_count(out)


def _library_content(path: Path) -> list[tuple]:
    if path.is_dir():
        parts = [part for part in sorted(path.iterdir()) if part.suffix in (".db3", ".mcap")]
        return [(*one, number) for number, part in enumerate(parts) for one in _library_content(part)]
    begin = path.read_bytes()[:8]
    if begin.startswith(b"#ROSBAG"):
        with Ros1LibraryReader(path) as reader:
            return sorted((one.msgtype, one.topic, time_ns, data) for one, time_ns, data in reader.messages())
    if not begin.startswith(b"\x89MCAP"):
        with closing(sqlite3.connect(f"file:{path}?immutable=1", uri=True)) as connection:
            query = (
                "SELECT type, messages.rowid, name, timestamp, data FROM messages LEFT JOIN topics "
                "ON topics.id = topic_id ORDER BY messages.rowid"
            )
            return connection.execute(query).fetchall()
    with path.open("rb") as stream:
        seen = [
            (schema and schema.name, channel.topic, channel.message_encoding, sorted(channel.metadata.items()),
             schema and schema.data, one.log_time, one.publish_time, one.sequence, one.data)
            for schema, channel, one in NonSeekingReader(stream, validate_crcs=True).iter_messages(log_time_order=False)
        ]  # fmt: skip
    with path.open("rb") as stream:
        records = list(StreamReader(stream, validate_crcs=True).records)
    extra = [one for one in records if isinstance(one, Attachment)]
    seen += [(EXTRA, one.name, one.media_type, one.log_time, one.data) for one in extra]
    return seen + [(EXTRA, one.name, one.metadata) for one in records if isinstance(one, Metadata)]


def walked_count(path: Path) -> int | None:
    """Count the messages of well-formed chunks without a look at indexes and the checksum of all; None for sqlite3."""
    data = path.read_bytes()
    try:
        with guarded():
            if data.startswith(b"\x89MCAP"):
                records = StreamReader(io.BytesIO(data), validate_crcs=False).records
                return sum(isinstance(record, Message) for record in records)
            return sum(b"op=\x02" in header for header in ros1_headers(data))
    except (Exception, FoundError):  # noqa: BLE001 - as above
        return None


def read_through(path: Path, recover: bool) -> tuple[int, list[str]]:  # noqa: FBT001 - passed on by `judged`
    """Read a bag as a corruption does, and find the numbers in its messages; return the count and the losses."""
    count = 0
    with open_reader(path, recover=recover) as reader:
        for block in reader.blocks():
            count += len(block.table)
            for number in set(block.table["channel"].tolist()):
                channel = reader.channels[number]
                if channel.msgtype in READABLE and channel.encoding in ("cdr", "ros1"):
                    try:
                        locate(block, channel)
                    except UnreadableEncodingError:  # of what is damaged recovery leaves nothing
                        if not recover:
                            raise
        return count, list(reader.losses)


def corrupt(path: Path, target: Path, recover: bool) -> list[str]:  # noqa: FBT001 - as above
    """Corrupt a bag as the command does; return the losses."""
    transform = Transform(MODEL, 7, 0, Options(odom_topic="/odom"))
    with open_reader(path, recover=recover) as reader:
        transform.odometry.prepare(reader, reader.name)
        with open_writer(target, reader) as writer:
            for block in transform.blocks(reader, reader.name, writer):
                writer.write(block)
            writer.provenance("odomcorrupt", {"seed": "7"})
        return list(reader.losses)


def corrupt_pipe(data: bytes) -> tuple[int, str]:
    """Corrupt through pipes; return how many bytes come out."""
    out, source = io.BytesIO(), io.BytesIO(data)
    source.seekable = lambda: False  # type: ignore[method-assign]
    transform = Transform(MODEL, 7, 0, Options(odom_topic="/odom"))
    with open_reader(None, source) as reader:
        transform.odometry.prepare(reader, reader.name)
        with open_writer(None, reader, stream=out) as writer:
            for block in transform.blocks(reader, reader.name, writer):
                writer.write(block)
    return len(out.getvalue()), ""


def command(*words: str) -> int:
    """Run a command; one that fails says one line, one that succeeds says no trace."""
    said, out = io.StringIO(), io.StringIO()
    with redirect_stderr(said), redirect_stdout(out):
        code = run(words)
    text = said.getvalue()
    if code not in (0, 1, 2, 3):
        raise FoundError(f"exit code {code}")
    if code in (1, 2) and text.count("\n") != 1:
        raise FoundError(f"not one line: {text!r}")
    if "--recover" in words and "--recover" in text:
        raise FoundError(f"advises what was given: {text!r}")
    return code


class BagTrial:
    """Tries damaged bags in a directory of its own."""

    def __init__(self, room: Path) -> None:
        self.room = Path(tempfile.mkdtemp(dir=room))
        self.outcomes: Counter[str] = Counter()
        self.intact = 0

    def lay(self, source: Path, part: str | None, data: bytes) -> Path:
        """Put the damaged bag where a bag is looked for; part names the damaged file of a directory."""
        for left in self.room.iterdir():
            shutil.rmtree(left) if left.is_dir() else left.unlink()
        place = self.room / source.name
        if part is None:
            place.write_bytes(data)
        else:
            shutil.copytree(source, place)
            (place / part).write_bytes(data)
        return place

    def run(self, place: Path, count: int, way: str, action: str, intact: int = 0) -> None:
        """Try one action, and judge what came of it.

        intact : how many messages lie in chunks that were not touched
        """
        self.intact = intact
        getattr(self, f"_{action}")(place, count, way)
        left = {one.name for one in self.room.iterdir()} - {place.name, "out" + place.suffix, "out.mcap"}
        if left:
            raise FoundError(f"debris: {left}")

    def _read(self, place: Path, count: int, way: str) -> None:
        got = judged(read_through, place, False)
        self._note("read", got)
        if isinstance(got, tuple):
            self._compare(place, got[0], count, way)

    def _corrupt(self, place: Path, count: int, way: str, suffix: str | None = None) -> None:
        target = self.room / ("out" + (place.suffix if suffix is None else suffix))
        before = None if place.is_dir() else place.read_bytes()
        got = judged(corrupt, place, target, False)
        self._note("corrupt", got)
        if before is not None and place.read_bytes() != before:
            raise FoundError("the input was touched")
        if isinstance(got, OdomCorruptError):
            if target.exists():
                raise FoundError("an error, and an output")
            return
        written = library_count(target)
        if written is None and library_count(place) is not None:
            raise FoundError("the output cannot be read, the input can")
        if suffix is None and not rest_is_kept(place, target):
            raise FoundError("what another reader gets beside odometry and TF is not what it was")
        if written is not None:
            self._compare(place, written, count, way)

    def _convert(self, place: Path, count: int, way: str) -> None:
        self._corrupt(place, count, way, ".mcap")

    def _pipe(self, place: Path, _count: int, _way: str) -> None:
        if not place.is_dir():
            self._note("pipe", judged(corrupt_pipe, place.read_bytes()))

    def _recover(self, place: Path, count: int, _way: str) -> None:
        got = judged(read_through, place, True)
        self._note("recover", got)
        if isinstance(got, OdomCorruptError):
            if "--recover" in str(got):
                raise FoundError(f"advises what was given: {got}")
            if self.intact > 0:
                raise FoundError(f"{self.intact} messages in whole chunks, and none recovered: {got}")
            return
        saved, losses = got
        if saved < self.intact:
            raise FoundError(f"{self.intact} messages in whole chunks, {saved} recovered: {losses}")
        seen = library_count(place)
        if saved < count and seen != saved and not losses:
            raise FoundError(f"{count - saved} of {count} messages lost without a word")
        if any("--recover" in loss for loss in losses):
            raise FoundError(f"advises what was given: {losses}")

    def _rescue(self, place: Path, _count: int, _way: str) -> None:
        target = self.room / ("out" + place.suffix)
        got = judged(corrupt, place, target, True)
        self._note("rescue", got)
        if isinstance(got, OdomCorruptError):
            if "--recover" in str(got):
                raise FoundError(f"advises what was given: {got}")
            if target.exists():
                raise FoundError("an error, and an output")

    def _info(self, place: Path, _count: int, _way: str) -> None:
        self._note("info", judged(command, "info", str(place)))

    def _compare(self, place: Path, got: int, count: int, way: str) -> None:
        """Compare a count with that of the bag before the damage, or with what other libraries see now."""
        if got == count:
            return
        seen = library_count(place)
        if seen is None and got > count:
            # others may refuse a bag for an index or a checksum that tell of fewer messages: no loss
            seen = sum(walked_count(part) or 0 for part in sorted(place.iterdir() if place.is_dir() else [place]))
        if seen is None or seen != got:
            raise FoundError(f"{got} messages of {count} after {way}; others see {seen}")

    def _note(self, action: str, got: object) -> None:
        kind = "refused" if isinstance(got, OdomCorruptError) or got in (1, 2) else "done"
        self.outcomes[f"{action} {kind}"] += 1


ACTIONS = ("read", "read", "corrupt", "convert", "pipe", "recover", "recover", "rescue", "info")
