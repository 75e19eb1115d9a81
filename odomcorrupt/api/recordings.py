"""Recordings of odometry and truth, read from bags, TUM and CSV files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

from odomcorrupt.drive_types import AUTO, DRIVE_TYPES, STEERED
from odomcorrupt.errors import RecordingError
from odomcorrupt.extras import require

if TYPE_CHECKING:
    from odomcorrupt.model.motion_model import Origin
    from odomcorrupt.study.io import Source
    from odomcorrupt.study.io.recording import Recording

__all__ = ["PathLikes", "Recordings", "as_paths", "as_recordings", "describe", "read_recordings", "require_travel"]

PathLikes = str | PathLike[str] | Iterable[str | PathLike[str]]
"""One path or several."""


@dataclass(frozen=True, slots=True, repr=False)
class Recordings(Sequence["Recording"]):
    """Runs of one robot: a sequence of `Recording`, several of a file where resets cut its run into stretches.

    runs : the recordings
    sources : the files that they were read from, and how
    """

    runs: tuple[Recording, ...]
    sources: tuple[Source, ...]

    @overload
    def __getitem__(self, index: int) -> Recording: ...
    @overload
    def __getitem__(self, index: slice) -> Recordings: ...
    def __getitem__(self, index: int | slice) -> Recording | Recordings:
        """Return one recording, or some of them."""
        return self.runs[index] if isinstance(index, int) else replace(self, runs=self.runs[index])

    def __len__(self) -> int:
        return len(self.runs)

    def __repr__(self) -> str:
        return f"<Recordings: {', '.join(describe(run) for run in self.runs)}>"

    @property
    def track_m(self) -> float | None:
        """Nominal distance between the wheels, metres; None where it is not known."""
        return next((source.track_m for source in self.sources if source.track_m is not None), None)

    @property
    def notes(self) -> tuple[str, ...]:
        """What reading left out or noticed, in sentences, each with the name of its recording."""
        return tuple(f"{run.name}: {note}" for run in self.runs for note in run.notes[1:])

    def on_track(self, track_m: float | None) -> Recordings:
        """Return the same recordings of a robot whose track is known, where they did not say it themselves.

        Parameters
        ----------
        track_m : float or None
            Nominal distance between the wheels, metres; None changes nothing.

        Returns
        -------
        Recordings

        """
        if track_m is None or self.track_m is not None:
            return self
        return self._with(track_m=track_m)

    def of_drive_type(self, drive_type: str) -> Recordings:
        """Return the same recordings of a robot whose drive type is known, where they did not say it themselves.

        Parameters
        ----------
        drive_type : str
            As of `read_recordings`; "" and "auto" change nothing.

        Returns
        -------
        Recordings
            Of a steered drive without a track.

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
        """Origin of the frame of satellite fixes; None where no truth is of these."""
        return next((run.geodetic_origin for run in self.runs if run.geodetic_origin is not None), None)

    def in_frame(self, origin: Origin | None) -> Recordings:
        """Return the same recordings with satellite fixes in the frame of another origin.

        Parameters
        ----------
        origin : odomcorrupt.study.io.geodesy.Origin or None
            Origin of an east-north frame; None leaves them in the frame of their first fix.

        Returns
        -------
        Recordings

        """
        from odomcorrupt.study.io.geodesy import in_frame

        return replace(self, runs=tuple(in_frame(run, origin) for run in self.runs))

    def read_alike(self, paths: PathLikes) -> Recordings:
        """Return other files, read with the topics, clock shift and track of the first of these.

        Parameters
        ----------
        paths : path or sequence of paths
            Bags or tables.

        Returns
        -------
        Recordings

        Raises
        ------
        RecordingError
            Where the truth of the first recording is in a file of its own.

        """
        first = self.sources[0]
        if first.truth_path is not None:
            raise RecordingError(
                f"{first.path}: its truth is in {first.truth_path}; read the other recordings with read_recordings"
            )
        return _read([replace(first, path=path, name="") for path in as_paths(paths)])


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

    Parameters
    ----------
    paths : path or several
        Bags, or TUM or CSV files with the odometry.
    odom, truth : str, optional
        Topics, or edges of TF as "/tf:map.base_link"; by default the only topic that can be meant.
    truth_bag : path or several, optional
        Bag, TUM or CSV file with the truth, where the recordings have none: one for all, or one for each.
    truth_shift_s : float
        Added to the stamps of the truth, seconds, where its clock is far off.
    track_m : float, optional
        Nominal distance between the wheels, metres; effects of single wheels need it.
    names : sequence of str
        What to call the recordings, where not by their files.
    scan : str, optional
        Topic of a laser that is to be the truth; by default the only one of a bag that holds no truth. "none" leaves
        it out.
    laser_scale_accuracy : float
        Standard deviation of the laser's own scale error: no scale is known better.
    drive_type : str
        How the robot's wheels steer it: differential, skid, car, tricycle or omni; by default guessed from its motion.
    imu : str, optional
        Topic of a gyro; by default the only Imu of a bag. Beside a truth or a laser it shows where the odometry's
        heading comes from; without either it is the truth of headings, for `diagnose` alone.
    gyro_scale_accuracy : float
        Standard deviation of the gyro's own scale error: no gain of turns is known better where it is the truth.
    joints : (str, str), optional
        Left and right wheel in JointState, whose angles are to be the odometry. Without them, joints whose names say
        that they are wheels give the nominal track alone.
    relative : path or several, optional
        CSV file of relative motions (t0,t1,dx,dy,dyaw) that are to be the truth: one for all, or one for each.
    progress : callable, optional
        Called with what is done next, and the share of the reading that is done.

    Returns
    -------
    Recordings
        One recording of each file, or several where resets cut it into independent stretches.

    Raises
    ------
    TopicError
        Where a topic or frame is missing or several could be meant; the message lists them.
    RecordingError
        Where what is there cannot be odometry and truth of one run; the message says why.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> rec = oc.read_recordings("fixtures/mystery.mcap", truth="/ground_truth")
    >>> rec[0].name
    'mystery.mcap'

    """
    require("scipy", "the study needs it", "study")
    from odomcorrupt.study.io import Source

    if drive_type not in (AUTO, *DRIVE_TYPES):
        raise RecordingError(f"drive_type: {drive_type!r}; it is one of {', '.join((AUTO, *DRIVE_TYPES))}")
    files, truths = as_paths(paths), as_paths(truth_bag)
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
    from odomcorrupt.study.io.reader import read_runs

    found: list[Recording] = []
    for n, source in enumerate(sources):
        if progress is not None:
            progress("reading", n / len(sources))
        found += read_runs(source, progress and _nth(progress, n, len(sources)))
    runs = Recordings(tuple(found), tuple(sources))
    return runs.in_frame(runs.geodetic_origin)


def _nth(progress: Callable[[str, float], None], n: int, count: int) -> Callable[[str, float], None]:
    """Return what is called with the share of one of several recordings."""
    return lambda stage, share: progress(stage, (n + share) / count)


def as_paths(paths: PathLikes) -> list[Path]:
    """Return the paths of one path or several, each of them text or a path."""
    if isinstance(paths, str | PathLike):
        return [Path(fspath(paths))]
    return [Path(fspath(path)) for path in paths]


def as_recordings(given: Recordings | PathLikes, like: Recordings | None = None) -> Recordings:
    """Return recordings as they are, or read from paths: in the same way as others, where there are any."""
    if isinstance(given, Recordings):
        return given
    return read_recordings(given) if like is None else like.read_alike(given)


def require_travel(runs: Recordings) -> Recordings:
    """Return recordings whose truths measured travel.

    Raises
    ------
    RecordingError
        Where one has a gyro alone: a model without travel is none.

    """
    blind = [run.name for run in runs if not run.positioned]
    if blind:
        raise RecordingError(
            f"{blind[0]}: wheels and a gyro alone say nothing of travel, and a model needs it: only diagnose can use "
            "them; give a truth, scans or relative motions (--truth, --scan, --relative)"
        )
    return runs


def describe(recording: Recording) -> str:
    """Return one line about a recording: poses, seconds and metres of its odometry, poses and seconds of its truth."""
    import numpy as np

    odometry, truth = recording.odometry, recording.truth
    spans = [(t.stamps_ns[-1] - t.stamps_ns[0]) * 1e-9 for t in (odometry, truth)]
    travelled = np.linalg.norm(np.diff(odometry.xyt[:, :2], axis=0), axis=1).sum()
    return (
        f"{recording.name}: odometry {len(odometry)} poses in {spans[0]:.1f} s ({travelled:.1f} m), "
        f"truth {len(truth)} poses in {spans[1]:.1f} s"
    )
