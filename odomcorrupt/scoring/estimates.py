"""Discovery and reading of a localisation's estimate of each run: a topic, an edge of TF, a TUM or CSV file."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.messages import gather, locate, stamps_or_log_ns
from odomcorrupt.bags.open import open_reader
from odomcorrupt.errors import OdomCorruptError, TopicError
from odomcorrupt.scoring.errors import ScoreError
from odomcorrupt.study.io.bag import read_bag
from odomcorrupt.study.io.raw_trajectory import in_order
from odomcorrupt.study.io.text import is_text, read_text
from odomcorrupt.study.io.topic_selection import parse_address, plain

if TYPE_CHECKING:
    from os import PathLike

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.geometry.trajectory import Trajectory
    from odomcorrupt.study.io.raw_trajectory import Samples
    from odomcorrupt.study.io.topic_selection import Role

_BAGS = (".mcap", ".bag", ".db3")
_TEXTS = (".tum", ".txt", ".csv")
_PLANAR = np.array([0, 1, 5])


class NoEstimateError(ScoreError):
    """A run has no output of the localisation."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A trajectory estimated by a localisation.

    source : file and topic
    frame : frame of the poses, "" if unknown
    covariance : (n, 3, 3) of x, y, heading, if the messages contain any
    notes : omissions in reading
    """

    source: str
    frame: str
    trajectory: Trajectory
    covariance: Array | None
    notes: tuple[str, ...]


def find_estimate(directory: Path, run_file: Path, *, needs_topic: bool) -> Path:
    """Return the file with the estimate of a run.

    That is a file or bag in `directory` with the run's name, with or without a suffix (`run_000012.tum`,
    `run_000012_amcl.mcap`, a ROS 2 bag `run_000012/`), else the run's bag itself.

    directory : directory of the localisation's outputs
    run_file : corrupted run
    needs_topic : whether a topic was given, so that the run's bag itself may contain the estimate

    Raises
    ------
    NoEstimateError
        If there is none.
    ScoreError
        If several files are possible.
    """
    name = run_file.name.split(".")[0]
    own = run_file.resolve()
    found = []
    for path in sorted(directory.glob(f"{name}*")):
        rest = path.name[len(name) :]
        usable = path.is_dir() or path.suffix in (*_BAGS, *_TEXTS)
        if usable and not re.match(r"[0-9]", rest) and path.resolve() != own:
            found.append(path)
    if len(found) > 1:
        names = ", ".join(path.name for path in found[:4])
        raise ScoreError(f"{directory}: {len(found)} files could be the estimate of {name} ({names}); keep one of them")
    if found:
        return found[0]
    if needs_topic and own.exists() and own.suffix not in _TEXTS:
        return run_file
    raise NoEstimateError(
        f"no file {name}* with an estimate in {directory}; name another place with --outputs, or a "
        "topic of the run with --estimate"
    )


def read_estimate(path: str | PathLike[str], address: str | None = None, *, role: Role = "estimate") -> Estimate:
    """Return an estimate from a text file, or from a topic or an edge of TF of a bag.

    Parameters
    ----------
    path : TUM or CSV file, or bag
    address : topic, or edge of TF as "/tf:map.base_link"; None for a text file
    role : "truth" also allows topics of positions without headings

    Returns
    -------
    Estimate
        Trajectory, frame, covariances.

    Raises
    ------
    OdomCorruptError
        If the file cannot be read, or has no such topic; NoEstimateError if the topic has no message.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> oc.read_estimate("fixtures/office.mcap", "/odom").frame
    'odom'
    """
    path = Path(path)
    place = str(path)
    covariance = None
    if is_text(path):
        samples = read_text(path, place)
    else:
        if address is None:
            raise ScoreError(f"{place}: is a bag; name the topic or the edge of TF in it with --{role}")
        samples = read_bag(_bag_in(path), place, {role: address})[role]
    if not len(samples):
        raise NoEstimateError(f"{samples.place} holds no message")
    ordered = in_order(samples)
    bad = len(samples) - int(np.isfinite(samples.xyz).all(axis=1).sum())
    notes = (*ordered.notes, *((f"{bad} poses are not numbers",) if bad else ()))
    if not is_text(path) and address is not None and not parse_address(address).frames:
        covariance = _covariances(_bag_in(path), address, ordered)
    return Estimate(ordered.place, ordered.frame, ordered.trajectory(), covariance, notes)


def _bag_in(path: Path) -> Path:
    """Return the bag in a directory: itself, or the only bag inside."""
    if not path.is_dir() or (path / "metadata.yaml").exists():
        return path
    inside = [one for one in sorted(path.iterdir()) if one.suffix in _BAGS or one.is_dir()]
    return _bag_in(inside[0]) if len(inside) == 1 else path


def _covariances(path: Path, topic: str, ordered: Samples) -> Array | None:
    """Return covariances (n, 3, 3) at the stamps of samples read from a topic, None if it has none."""
    stamps, values = [], []
    with open_reader(path) as reader:
        channels = [c for c in reader.channels.values() if plain(c.topic) == plain(topic)]
        for block in reader.blocks():
            for channel in channels:
                for layout in locate(block, channel):
                    item = layout.items[0]
                    if "pose_covariance" in item.fields:
                        full = gather(block, layout, item, "pose_covariance").reshape(-1, 6, 6)
                        stamps.append(stamps_or_log_ns(block, layout, layout.items[0]))
                        values.append(full[:, _PLANAR[:, None], _PLANAR])
    if not stamps:
        return None
    every, matrices = np.concatenate(stamps), np.concatenate(values)
    unique, index = np.unique(every, return_index=True)
    at = np.clip(np.searchsorted(unique, ordered.stamps_ns), 0, len(unique) - 1)
    found = matrices[index[at]]
    found[unique[at] != ordered.stamps_ns] = np.nan
    return found if np.any(found) else None


def read_first(paths: list[Path], address: str) -> Estimate:
    """Read a topic from the first of several bags that has it; TopicError of the last one if none has."""
    last: OdomCorruptError = TopicError(f"{address}: no bag to read it from; name one with --truth-bag")
    for path in paths:
        if path.exists() and path.suffix not in _TEXTS:
            try:
                return read_estimate(path, address, role="truth")
            except OdomCorruptError as error:
                last = error
    raise last
