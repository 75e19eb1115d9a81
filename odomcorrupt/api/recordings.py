"""Recordings of odometry and truth, read from bags, TUM and CSV files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

from odomcorrupt.drive_types import AUTO, DRIVE_TYPES, STEERED
from odomcorrupt.errors import RecordingError
from odomcorrupt.extras import part_of_study

if TYPE_CHECKING:
    from odomcorrupt.model.motion_model import Origin
    from odomcorrupt.study.io import Source
    from odomcorrupt.study.io.recording import Mistake, Recording

PathLikes = str | PathLike[str] | Iterable[str | PathLike[str]]
"""One path or several."""
_BAGS, _METADATA = (".mcap", ".bag", ".db3"), "metadata.yaml"
"""Suffixes of the bags in a folder (tables of text may be anything), and the file that makes a folder one bag."""
_LEAST_TRAVEL_M = 0.5
"""Least travel of a study, m: noise of 1 mm a step in 15 min of turns on the spot (20 Hz) adds up to 0.1 to 0.25 m."""


@dataclass(frozen=True, slots=True, repr=False)
class Recordings(Sequence["Recording"]):
    """Runs of one robot: a sequence of `Recording`; resets of a run split its file into several.

    runs : the recordings
    sources : source files, with the options of reading
    """

    runs: tuple[Recording, ...]
    sources: tuple[Source, ...]

    @overload
    def __getitem__(self, index: int) -> Recording: ...
    @overload
    def __getitem__(self, index: slice) -> Recordings: ...
    def __getitem__(self, index: int | slice) -> Recording | Recordings:
        """Return one recording, or a slice of them."""
        return self.runs[index] if isinstance(index, int) else replace(self, runs=self.runs[index])

    def __len__(self) -> int:
        return len(self.runs)

    def __repr__(self) -> str:
        return f"<Recordings: {', '.join(describe(run) for run in self.runs)}>"

    @property
    def track_m(self) -> float | None:
        """Nominal distance between the wheels, metres; None if unknown."""
        return next((source.track_m for source in self.sources if source.track_m is not None), None)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes of the reader on omissions and oddities, in sentences, each with the name of its recording."""
        return tuple(f"{run.name}: {note}" for run in self.runs for note in run.notes[1:])

    @property
    def alerts(self) -> tuple[str, ...]:
        """Findings of the reader that every summary shows, in sentences."""
        return tuple(dict.fromkeys(alert for run in self.runs for alert in run.alerts))

    @property
    def mistakes(self) -> tuple[Mistake, ...]:
        """Plain mistakes of wiring, units, signs and axes, each once."""
        return tuple({one.name: one for run in reversed(self.runs) for one in reversed(run.mistakes)}.values())[::-1]

    def on_track(self, track_m: float | None) -> Recordings:
        """Return the same recordings with a known track; recordings that state their own keep it.

        track_m : nominal distance between the wheels, metres; None changes nothing
        """
        if track_m is None or self.track_m is not None:
            return self
        return self._with(track_m=track_m)

    def of_drive_type(self, drive_type: str) -> Recordings:
        """Return the same recordings with a known drive type; recordings that state their own keep it.

        drive_type : as of `read_recordings`; "" and "auto" change nothing

        Returns
        -------
        Recordings
            Steered drives are returned without a track.
        """
        said = all(source.drive_type == AUTO for source in self.sources)
        if drive_type in ("", AUTO) or not said:
            return self
        return self._with(drive_type=drive_type, track_m=None if drive_type in STEERED else self.track_m)

    def _with(self, **known: Any) -> Recordings:
        runs = tuple(replace(run, **known) for run in self.runs)
        return Recordings(runs, tuple(replace(source, **known) for source in self.sources))

    @property
    def geodetic_origin(self) -> Origin | None:
        """Origin of the frame of satellite fixes; None if no truth consists of fixes."""
        return next((run.geodetic_origin for run in self.runs if run.geodetic_origin is not None), None)

    def in_frame(self, origin: Origin | None) -> Recordings:
        """Return the same recordings with satellite fixes converted to the frame of another origin.

        origin : origin of an east-north frame; None leaves them in the frame of their first fix
        """
        from odomcorrupt.study.io.fixes import in_frame

        return replace(self, runs=tuple(in_frame(run, origin) for run in self.runs))

    def read_alike(self, paths: PathLikes) -> Recordings:
        """Return the recordings in other files, read with the topics, clock shift and track of the first of these.

        paths : bags or tables

        Raises
        ------
        RecordingError
            If the truth of the first recording is in a separate file.
        """
        first = self.sources[0]
        if first.truth_path is not None:
            raise RecordingError(
                f"{first.path}: its truth is in {first.truth_path}; read the other recordings with read_recordings"
            )
        return _read([replace(first, path=path, name="") for path in as_paths(paths)])


@part_of_study
def read_recordings(
    paths: PathLikes,
    *,
    odom: str | None = None,
    truth: str | None = None,
    truth_bag: PathLikes = (),
    truth_shift_s: float = 0.0,
    track_m: float | None = None,
    names: Sequence[str] = (),
    scan: str | None = None,
    laser_scale_accuracy: float = 0.003,
    drive_type: str = AUTO,
    imu: str | None = None,
    gyro_scale_accuracy: float = 0.01,
    joints: tuple[str, str] | None = None,
    relative: PathLikes = (),
    progress: Callable[[str, float], None] | None = None,
) -> Recordings:
    """Return recordings of odometry and truth, cleaned and checked for plausibility.

    paths : bags, or TUM or CSV files with the odometry; a folder of them, a pattern such as "runs/*.mcap", or a list
        file (``*.list``), which has a path a line
    odom, truth : topics, or TF edges such as "/tf:map.base_link"; by default the only possible topic
    truth_bag : bag, TUM or CSV file with the truth, if the recordings contain none: one for all, or one for each
    truth_shift_s : added to the stamps of the truth, seconds, if its clock differs widely
    track_m : nominal distance between the wheels, metres; effects of single wheels need it
    names : names of the recordings, by default those of their files
    scan : laser topic from which to compute the truth; by default the only one of a bag without truth. "none" disables
        it
    laser_scale_accuracy : standard deviation of the laser's own scale error; it limits the accuracy of every scale
    drive_type : wheel layout: differential, skid, car, tricycle or omni; by default inferred from the motion
    imu : topic of a gyro; by default the only Imu of a bag. Beside a truth or a laser it shows the source of the
        odometry's heading; without either it is the truth of headings, for `diagnose` alone
    gyro_scale_accuracy : standard deviation of the gyro's own scale error; it limits the accuracy of turns if the gyro
        is the truth
    joints : (str, str) left and right wheel in JointState, whose angles replace the odometry. By default, joints with
        names of wheels determine the nominal track only
    relative : CSV file of relative motions (t0,t1,dx,dy,dyaw) to be used as the truth: one for all, or one for each
    progress : called with the next step of reading, and the completed share of it

    Returns
    -------
    Recordings
        One recording per file, or several if resets cut it into independent segments. Of several files, an unusable
        one is left out, with an alert.

    Raises
    ------
    TopicError
        If a topic or frame is missing or ambiguous; the message lists the candidates.
    RecordingError
        If the data cannot be odometry and truth of one run; the message states why.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> rec = oc.read_recordings("fixtures/mystery.mcap", truth="/ground_truth")
    >>> rec[0].name
    'mystery.mcap'
    """
    from odomcorrupt.study.io import Source

    if drive_type not in (AUTO, *DRIVE_TYPES):
        raise RecordingError(f"drive_type: {drive_type!r}; it is one of {', '.join((AUTO, *DRIVE_TYPES))}")
    files, truths = recording_paths(paths), as_paths(truth_bag)
    if not files:
        raise RecordingError("no recording given; name a bag with odometry and truth")
    if len(truths) > 1 and len(truths) != len(files):
        raise RecordingError(f"{len(truths)} truth bags for {len(files)} recordings; name one for all, or one for each")
    motions = as_paths(relative)
    if len(motions) not in (0, 1, len(files)):
        raise RecordingError(f"{len(motions)} files of relative motions for {len(files)} recordings; give each its own")
    each, each_motions = (own if len(own) > 1 else [*own, None][:1] * len(files) for own in (truths, motions))
    called = [*names, *[""] * (len(files) - len(names))]
    alike = Source(
        files[0], odom=odom, truth=truth, truth_shift_s=truth_shift_s, track_m=track_m, scan=scan,
        truth_scale_error=laser_scale_accuracy, drive_type=drive_type, imu=imu, gyro_scale_error=gyro_scale_accuracy,
        joints=joints,
    )  # fmt: skip
    rows = zip(files, each, each_motions, called, strict=True)
    return _read([replace(alike, path=p, truth_path=t, relative=m, name=name) for p, t, m, name in rows], progress)


def _read(sources: Sequence[Source], progress: Callable[[str, float], None] | None = None) -> Recordings:
    from odomcorrupt.study.io.reader import read_study

    runs = Recordings(tuple(read_study(sources, progress)), tuple(sources))
    return runs.in_frame(runs.geodetic_origin)


def as_paths(paths: PathLikes) -> list[Path]:
    """Return a list of paths from one path or several, strings or Path objects."""
    if isinstance(paths, str | PathLike):
        return [Path(fspath(paths))]
    return [Path(fspath(path)) for path in paths]


def recording_paths(paths: PathLikes) -> list[Path]:
    """Return the files of recordings: a folder, a pattern or a list file in place of the files that it names.

    Raises
    ------
    RecordingError
        If a folder, a pattern or a list names no file.
    """
    return [file for path in as_paths(paths) for file in _files_of(path)]


def _files_of(path: Path) -> list[Path]:
    """Return the recordings that a path stands for, in alphabetical order; a file or a rosbag2 folder stands alone."""
    if path.suffix == ".list" and path.is_file():
        lines = (line.strip() for line in path.read_text(encoding="utf-8").splitlines())
        found = [path.parent / line for line in lines if line and not line.startswith("#")]
    elif path.is_dir() and not (path / _METADATA).exists():
        found = sorted(p for p in path.iterdir() if p.suffix in _BAGS or (p / _METADATA).exists())
    elif not set(str(path)).isdisjoint("*?[") and not path.exists():
        found = sorted(Path(path.anchor).glob(str(path.relative_to(path.anchor))))
    else:
        return [path]
    if not found:
        raise RecordingError(f"{path}: names no recording; give bags (*.mcap, *.bag, rosbag2 folders)")
    return found


def as_recordings(given: Recordings | PathLikes, like: Recordings | None = None) -> Recordings:
    """Return recordings unchanged, or read from paths, with the options of `like` if given."""
    if isinstance(given, Recordings):
        return given
    return read_recordings(given) if like is None else like.read_alike(given)


def require_travel(runs: Recordings, *, turns: bool = False) -> Recordings:
    """Return the recordings if all their truths measure travel, and the robot travelled.

    The noise of an odometry that only turns on the spot is its only travel. An effect of travel then removes this
    noise, with a small standard error: it would be named with any size.

    turns : whether truths of headings alone are accepted

    Raises
    ------
    RecordingError
        If the only truth of a recording is a gyro, or if the robot only turned on the spot: a model needs travel.
    """
    blind = [run.name for run in runs if not run.positioned]
    if blind and not turns:
        raise RecordingError(
            f"{blind[0]}: wheels and a gyro alone do not measure travel, which a model needs: only diagnose can use "
            "them; give a truth, scans or relative motions (--truth, --scan, --relative)"
        )
    travelled_m = max((run.travel_m for run in runs), default=0.0)
    if travelled_m < _LEAST_TRAVEL_M and not blind:
        raise RecordingError(
            f"{runs[0].name}: travels {travelled_m:.2f} m only, at least {_LEAST_TRAVEL_M:g} m are needed: turns on "
            "the spot show nothing about travel; add a drive of some metres"
        )
    return runs


def describe(recording: Recording) -> str:
    """Return a one-line description: poses, seconds and metres of the odometry, poses and seconds of the truth."""
    from odomcorrupt.geometry.trajectory import distance_along

    odometry, truth = recording.odometry, recording.truth
    travelled = distance_along(odometry.xyt)[-1]
    spans = [(t.stamps_ns[-1] - t.stamps_ns[0]) * 1e-9 for t in (odometry, truth)]
    return (
        f"{recording.name}: odometry {len(odometry)} poses in {spans[0]:.1f} s ({travelled:.1f} m), "
        f"truth {len(truth)} poses in {spans[1]:.1f} s"
    )
