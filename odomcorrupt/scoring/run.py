"""Scores of a batch's estimates: per run, statistics over runs, and against the odometry's drift."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from odomcorrupt.bags.messages import gather, located, stamps_or_log_ns
from odomcorrupt.bags.open import open_reader
from odomcorrupt.batching.manifest import BEGINNING, read_beginning, read_records
from odomcorrupt.corruption.odometry_source import plain
from odomcorrupt.corruption.path import LEG_M
from odomcorrupt.corruption.se2_on_se3 import PLANAR
from odomcorrupt.errors import OdomCorruptError, TopicError
from odomcorrupt.geometry.trajectory import distance_along
from odomcorrupt.scoring.errors import Alignment, Failure, Limits, PathErrors, ScoreError, path_errors
from odomcorrupt.study.io.bag import read_bag
from odomcorrupt.study.io.raw_trajectory import in_order
from odomcorrupt.study.io.text import is_text, read_text
from odomcorrupt.study.io.topic_selection import parse_address

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from os import PathLike

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.geometry.trajectory import Trajectory
    from odomcorrupt.study.io.raw_trajectory import Samples
    from odomcorrupt.study.io.topic_selection import Role


LOST_PART = 0.05
"""Fraction of lost runs that defines the break-down point."""
_LOST_LOGIT = float(np.log(LOST_PART / (1.0 - LOST_PART)))


def quantile(values: Array, q: float) -> Array:
    """Return a quantile over the last axis of values, which may be infinite; linear between neighbours."""
    ordered = np.sort(values, axis=-1)
    at = q * (ordered.shape[-1] - 1)
    low, high = ordered[..., int(np.floor(at))], ordered[..., int(np.ceil(at))]
    with np.errstate(invalid="ignore"):
        return np.where(low == high, low, low + (at - np.floor(at)) * (high - low))


@dataclass(frozen=True, slots=True)
class Quantile:
    """A quantile over runs and its 95 % interval by order statistics; infinite if too few runs bound it."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Summary:
    """Statistics of one metric over the n runs that have it: metres, radians or dimensionless."""

    n: int
    mean: float
    median: Quantile
    p90: Quantile
    p95: Quantile
    max: float


def summarise(values: Array) -> Summary:
    """Return mean, quantiles and maximum of values (n,), which may be infinite, ignoring NaN."""
    own = np.sort(values[~np.isnan(values)])
    if not len(own):
        nothing = Quantile(*[float("nan")] * 3)
        return Summary(0, float("nan"), nothing, nothing, nothing, float("nan"))
    return Summary(
        len(own), float(own.mean()), _quantile(own, 0.5), _quantile(own, 0.9), _quantile(own, 0.95), float(own[-1])
    )


def _quantile(ordered: Array, q: float) -> Quantile:
    """Return a quantile; its interval covers it with at least 95 % for any distribution (David & Nagaraja 2003)."""
    from scipy.special import bdtr  # noqa: PLC0415 - a gate of the pytest plugin needs no SciPy

    n = len(ordered)
    counts = bdtr(np.arange(n + 1), n, q)
    lower, upper = int(np.searchsorted(counts, 0.025, side="right")), int(np.searchsorted(counts, 0.975)) + 1
    low = float(ordered[lower - 1]) if lower >= 1 else 0.0
    high = float(ordered[upper - 1]) if upper <= n else float("inf")
    return Quantile(float(quantile(ordered, q)), low, high)


@dataclass(frozen=True, slots=True)
class Growth:
    """Growth of an error with the drift: proportional to drift to the power `exponent`, with its 95 % interval."""

    exponent: float
    low: float
    high: float


def growth(drift: Array, error: Array) -> Growth | None:
    """Return the exponent by least squares of logarithms over runs (n,); None below 8 runs or without a range of drift.

    Source of the interval: normal theory with the residuals' own variance.
    """
    usable = (drift > 0.0) & (error > 0.0) & np.isfinite(drift) & np.isfinite(error)
    x, y = np.log(drift[usable]), np.log(error[usable])
    if len(x) < 8 or np.ptp(x) < 0.1:
        return None
    dx = x - x.mean()
    slope = float(np.sum(dx * y) / np.sum(dx**2))
    rest = y - y.mean() - slope * dx
    deviation = float(np.sqrt(np.sum(rest**2) / (len(x) - 2) / np.sum(dx**2)))
    return Growth(slope, slope - 2.0 * deviation, slope + 2.0 * deviation)


@dataclass(frozen=True, slots=True)
class Breakdown:
    """The drift at which 5 % of runs are lost, not extrapolated beyond the drifts of the runs.

    drift : most likely value; 0 below the smallest drift of the runs, infinite beyond the largest, None of too few runs
    low, high : 95 % interval by profile likelihood; 0 and infinity where no runs were, or these do not bound it
    width : factor of drift between 5 and 50 % of lost runs; None without a value of `drift`
    """

    drift: float | None
    low: float
    high: float
    width: float | None


def breakdown(drift: Array, lost: NDArray[np.bool_]) -> Breakdown:
    """Return the break-down point of runs (n,) by logistic regression of losses on the logarithm of the drift.

    logit p = logit 0.05 + b (log d - log d5) with b > 0: more drift never helps. d5 is found on a grid, with b
    maximised at each point (profile likelihood), so that separable runs, or runs without losses, need no exception.
    Source: Cox & Snell, Analysis of Binary Data, 1989; intervals: Wilks, Ann. Math. Stat. 9, 1938.
    """
    usable = np.isfinite(drift) & (drift > 0.0)
    x, y = np.log(drift[usable]), lost[usable]
    if len(x) < 5:
        return Breakdown(None, 0.0, float("inf"), None)
    grid, slopes = np.linspace(x.min() - 3.0, x.max() + 3.0, 601), np.geomspace(0.3, 60.0, 40)
    every = np.stack([_log_likelihood(x, y, grid, slope) for slope in slopes])
    best = every.max(axis=0)
    # twice the decrease of the log likelihood at the ends of a 95 % interval of one parameter
    first, last = grid[np.flatnonzero(2.0 * (best.max() - best) <= 3.841)[[0, -1]]]
    low = 0.0 if first < x.min() else float(np.exp(min(first, x.max())))
    high = float("inf") if last > x.max() else float(np.exp(max(last, x.min())))
    # of a range of equal likelihood, the middle
    equal = np.flatnonzero(best >= best.max() - 1e-6)
    at = int(equal[len(equal) // 2])
    if y.all() or grid[at] < x.min():
        return Breakdown(0.0, 0.0, high, None)
    if not y.any() or grid[at] > x.max():
        return Breakdown(float("inf"), low, float("inf"), None)
    return Breakdown(float(np.exp(grid[at])), low, high, float(np.exp(-_LOST_LOGIT / slopes[every[:, at].argmax()])))


def _log_likelihood(x: Array, lost: NDArray[np.bool_], grid: Array, slope: float) -> Array:
    """Return log likelihoods (k,) of runs (n,) for break-down points (k,) and one slope."""
    z = _LOST_LOGIT + slope * (x[None, :] - grid[:, None])
    return -np.logaddexp(0.0, np.where(lost, -z, z)).sum(axis=1)


@dataclass(frozen=True, slots=True)
class Section:
    """A section of the path: begin and end (metres driven), its middle, and the errors of all runs in it.

    median_m, p90_m : statistics of the position error over runs, each run's mean in the section
    runs : number of runs in it
    failures : number of runs lost in it
    """

    from_m: float
    to_m: float
    xy_m: tuple[float, float]
    median_m: float
    p90_m: float
    runs: int
    failures: int


def sections(
    paths: list[tuple[Array, Array]], clean_m: Array, clean_xy: Array, lost_at_m: list[float]
) -> list[Section]:
    """Return errors along the path, in 20 sections of equal length.

    paths : for each run, metres driven (k,) and position error (k,)
    clean_m : (n,) metres driven along the truth
    clean_xy : (n, 2) positions along the truth
    lost_at_m : metres driven at which runs were lost
    """
    edges = np.linspace(0.0, float(clean_m[-1]), 21)
    found = []
    for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        means = [float(e[m].mean()) for d, e in paths if (m := (d >= begin) & (d <= end)).any()]
        middle = min(int(np.searchsorted(clean_m, (begin + end) / 2.0)), len(clean_m) - 1)
        x, y = clean_xy[middle].tolist()
        median, p90 = np.quantile(means, (0.5, 0.9)).tolist() if means else (float("nan"), float("nan"))
        failures = sum(begin <= at < end or (at == end == edges[-1]) for at in lost_at_m)
        found.append(Section(begin, end, (x, y), median, p90, len(means), failures))
    return found


ODOMETRY = "the odometry of the runs itself"
_BAGS = (".mcap", ".bag", ".db3")
_TEXTS = (".tum", ".txt", ".csv")


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


def find_estimate(directory: Path, run_file: Path, *, itself: bool) -> Path:
    """Return the file with the estimate of a run.

    That is a file or bag in `directory` with the run's name, with or without a suffix (`run_000012.tum`,
    `run_000012_amcl.mcap`, a ROS 2 bag `run_000012/`), else the run itself.

    directory : directory of the localisation's outputs
    run_file : corrupted run
    itself : whether the run itself may be the estimate: a bag if a topic was given, a text file if no run has another

    Raises
    ------
    NoEstimateError
        If there is none.
    ScoreError
        If several files are possible.
    """
    name = run_file.name.split(".")[0]
    own = run_file.resolve()
    found = [
        path
        for path in sorted(directory.glob(f"{name}*"))
        if (path.is_dir() or path.suffix in (*_BAGS, *_TEXTS)) and path.resolve() != own
        if not path.name[len(name) :][:1].isdigit()
    ]
    if len(found) > 1:
        names = ", ".join(path.name for path in found[:4])
        raise ScoreError(f"{directory}: {len(found)} files could be the estimate of {name} ({names}); keep one of them")
    if found:
        return found[0]
    if itself and own.exists():
        return run_file
    way_out = "name another place with --outputs, or a topic of the run with --estimate (docs/score.md)"
    raise NoEstimateError(f"no file {name}* with an estimate in {directory}; {way_out}")


def read_estimate(path: str | PathLike[str], address: str | None = None, *, role: Role = "estimate") -> Estimate:
    """Return an estimate from a text file, or from a topic or an edge of TF of a bag.

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
        for block, _, layout in located(reader, channels):
            item = layout.items[0]
            if "pose_covariance" in item.fields:
                full = gather(block, layout, item, "pose_covariance").reshape(-1, 6, 6)
                stamps.append(stamps_or_log_ns(block, layout, item))
                values.append(full[:, PLANAR[:, None], PLANAR])
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
    for path in (path for path in paths if path.exists() and path.suffix not in _TEXTS):
        try:
            return read_estimate(path, address, role="truth")
        except OdomCorruptError as error:
            last = error
    raise last


Status = Literal["ok", "lost", "diverged", "partial", "missing", "unreadable"]

ERRORS = ("ate_m", "ate_rad", "max_m", "rpe_m", "rpe_rad", "error_10s_m", "end_m")
"""Metrics that are infinite for a run without a complete output."""
METRICS = (*ERRORS, "nees", "inside_95")
"""Metrics of a run, in the order of display."""


@dataclass(frozen=True, slots=True, eq=False)
class RunScore:
    """Score of the estimate of one run.

    name : "run_000012", for a point of a sweep "alpha-scale=2/run_000012"
    seed, run : seed and run of the corruption
    status : "ok", "lost" or "diverged"; "partial": it covers less of the path than `Limits.least_coverage`;
        "missing": no output; "unreadable": see `reason`
    reason : a sentence, "" if status is "ok"
    drift : rms error of the odometry after 10 m, relative to 10 m (for shorter drives, at the end); NaN if unknown
    drift_end_m : position error of the odometry at the end, metres
    metrics : by the names of `METRICS`; empty without errors
    failure : time and place of the failure
    jumps_s : times of jumps, seconds since the truth's first stamp
    coverage : fraction of the truth's path that the estimate covers
    source : file of the estimate, and topic; the run's own file if there is no estimate
    events : events of the model: name, begin, end (seconds since the first stamp)
    notes : omissions in reading
    """

    name: str
    seed: int
    run: int
    status: Status
    reason: str = ""
    drift: float = float("nan")
    drift_end_m: float = float("nan")
    metrics: Mapping[str, float] = field(default_factory=dict)
    failure: Failure | None = None
    jumps_s: tuple[float, ...] = ()
    coverage: float = 0.0
    frame: str = ""
    source: str = ""
    events: tuple[tuple[str, float, float], ...] = ()
    notes: tuple[str, ...] = ()
    distance_m: Array = field(default_factory=lambda: np.zeros(0), repr=False)
    position_m: Array = field(default_factory=lambda: np.zeros(0), repr=False)
    estimate_xy: Array = field(default_factory=lambda: np.zeros((0, 2)), repr=False)

    @property
    def failed(self) -> bool:
        """Whether the estimate was lost, or there is no complete one."""
        return self.status != "ok"

    @property
    def scored(self) -> bool:
        """Whether the output covers the path, so that its errors are those of the whole run."""
        return self.status in ("ok", "lost", "diverged")

    @property
    def point(self) -> str:
        """Directory of the run's batch: the point of a sweep, or the input; "" if there is one batch only."""
        return self.name.rpartition("/")[0]


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class ScoreReport:
    """Scores of n runs.

    runs : all runs, in the order of the manifest
    align, limits : options of the scoring
    estimate, truth : sources of both
    inputs : name of each batch ("" if it is the only one), and hashes of its input and its model
    clean_m, clean_xy : (k,) metres driven along the truth, and (k, 2) positions there
    notes : notes on all runs
    """

    runs: tuple[RunScore, ...]
    estimate: str
    truth: str
    align: Alignment
    limits: Limits
    inputs: tuple[Mapping[str, str], ...]
    clean_m: Array
    clean_xy: Array
    notes: tuple[str, ...] = ()

    @property
    def failed(self) -> int:
        """Number of failed runs."""
        return sum(run.failed for run in self.runs)

    @property
    def identical(self) -> bool:
        """Whether all estimates are the same although the odometry of the runs differs, so that none is of its run."""
        scored = [run for run in self.runs if run.metrics]
        alike = all(np.array_equal(run.estimate_xy, scored[0].estimate_xy) for run in scored)
        return alike and max(run.drift_end_m for run in scored) > min(run.drift_end_m for run in scored)

    def summary(self, metric: str) -> Summary:
        """Return statistics of a metric over the runs; an error is infinite for a run without a complete output."""
        unknown, without = float("nan"), float("inf") if metric in ERRORS else float("nan")
        values = [run.metrics.get(metric, unknown) if run.scored else without for run in self.runs]
        return summarise(np.array(values))

    @property
    def drift(self) -> float:
        """Median of the runs' drifts."""
        return float(np.median([run.drift for run in self.runs]))

    @property
    def points(self) -> list[ScoreReport]:
        """The report of each batch alone, i.e. of each point of a sweep or each input, in the order of their drifts."""
        names = dict.fromkeys(run.point for run in self.runs)
        parts = [tuple(run for run in self.runs if run.point == name) for name in names]
        return sorted((replace(self, runs=part) for part in parts), key=lambda part: part.drift)

    @property
    def breakdown(self) -> Breakdown:
        """Drift at which 5 % of runs fail, see `statistics.breakdown`."""
        failed = np.array([run.failed for run in self.runs], dtype=bool)
        return breakdown(np.array([run.drift for run in self.runs]), failed)

    @property
    def growth(self) -> Growth | None:
        """Growth of ATE with the drift over the runs that were not lost."""
        runs = [run for run in self.runs if run.status == "ok"]
        return growth(np.array([run.drift for run in runs]), np.array([run.metrics["ate_m"] for run in runs]))

    @property
    def sections(self) -> list[Section]:
        """Errors along the path."""
        runs = [run for run in self.runs if run.scored]
        paths = [(run.distance_m, run.position_m) for run in runs]
        lost = [run.failure.distance_m for run in runs if run.failure is not None]
        return sections(paths, self.clean_m, self.clean_xy, lost)


def score(
    runs: Path | str | Sequence[Path | str],
    estimate: str | None = None,
    *,
    truth: str | None = None,
    truth_bag: str | PathLike[str] | None = None,
    outputs: str | PathLike[str] | None = None,
    align: Alignment = "rigid",
    limits: Limits | None = None,
) -> ScoreReport:
    """Return the errors of estimates of a batch's runs; parameters and errors are those of `odomcorrupt.score`."""
    limits = limits or Limits()
    roots = [Path(runs)] if isinstance(runs, str | Path) else [Path(one) for one in runs]
    places = [place for root in roots for place in _batches(root)]
    found: list[RunScore] = []
    clean: Trajectory | None = None
    truths: set[str] = set()
    inputs: list[Mapping[str, str]] = []
    for label, directory, root in places:
        beside = directory if outputs is None else Path(outputs) / directory.relative_to(root)
        records = read_records(directory)
        if not records:
            raise ScoreError(f"{directory}: the batch has no runs yet; make them with odomcorrupt batch")
        begun = read_beginning(directory)
        inputs.append({"batch": label, **{kind: begun[kind]["hash"] for kind in ("input", "model")}})
        frame = next(iter(records.values())).get("odom_frame", "")
        shared = _shared_truth(directory, truth, truth_bag, frame)
        files = {directory / record["file"] for record in records.values()}
        texts = all(file.suffix in _TEXTS for file in files)
        bare = texts and outputs is None and {*directory.glob("run_*")} <= files
        itself = estimate is None if bare else estimate is not None and not texts
        for number, record in records.items():
            name = f"{label}/run_{number:06d}" if label else f"run_{number:06d}"
            blank = RunScore(
                name, int(record["seed"]), number, "missing", source=str(directory / record["file"]), **_put_in(record)
            )
            one, used = _scored(
                blank, directory / record["file"], beside, estimate, shared or truth, align, limits, itself=itself
            )
            found.append(one)
            if used is not None:
                clean = clean or used.trajectory
                truths.add(used.source)
                _require_one_frame(one, used.frame, align)
    if clean is None or not any(run.metrics for run in found):
        why = f"{found[0].name}: {found[0].reason}"
        raise ScoreError(f"none of {len(found)} runs has an estimate that can be scored; {why}")
    return ScoreReport(
        tuple(found), ODOMETRY if bare else estimate or "text files", ", ".join(sorted(truths)), align, limits,
        tuple(inputs), distance_along(clean.xyt), clean.xyt[:, :2], tuple(_notes(found, truths, align)),
    )  # fmt: skip


def _require_one_frame(run: RunScore, true_frame: str, align: Alignment) -> None:
    """Refuse to subtract poses in two frames."""
    if align == "none" and run.frame and true_frame and run.frame.strip("/") != true_frame.strip("/"):
        said = f"{run.name}: the estimate is in frame {run.frame}, the truth in {true_frame}"
        way_out = "with --truth, align them with --align rigid, or say --align same if both frames are one"
        raise ScoreError(f"{said}; name a truth in {run.frame} {way_out}")


def _batches(root: Path) -> list[tuple[str, Path, Path]]:
    """Return label, directory and root of each batch below a directory."""
    if (root / BEGINNING).exists():
        return [("", root, root)]
    found = sorted(path.parent for path in root.rglob(BEGINNING)) if root.is_dir() else []
    if not found:
        raise ScoreError(f"{root}: holds no batch ({BEGINNING} is missing); make one with odomcorrupt batch")
    return [(str(path.relative_to(root)), path, root) for path in found]


def _put_in(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return the drift that a record of the manifest states."""
    drift = record.get("drift", {})
    end, distance = drift.get("end_drawn_m", float("nan")), drift.get("distance_m", 0.0)
    leg = drift.get("leg_drawn_m")
    part = leg / LEG_M if leg is not None else end / distance if distance > 0.0 else float("nan")
    events = tuple((e["effect"], float(e["from_s"]), float(e["to_s"])) for e in record.get("events", ()))
    return {"drift": float(part), "drift_end_m": float(end), "events": events}


def _shared_truth(directory: Path, topic: str | None, file: str | PathLike[str] | None, odom: str) -> Estimate | None:
    """Return the truth of all runs of a batch; None if it is a topic that the input does not have."""
    if file is not None:
        return read_estimate(file, topic, role="truth")
    if topic is None:
        return replace(read_estimate(directory / "clean.tum"), frame=odom)
    try:
        return read_first([Path(read_beginning(directory)["input"]["path"])], topic)
    except OdomCorruptError:
        return None


def _scored(
    blank: RunScore,
    run_file: Path,
    outputs: Path,
    estimate: str | None,
    truth: Estimate | str | None,
    align: Alignment,
    limits: Limits,
    *,
    itself: bool,
) -> tuple[RunScore, Estimate | None]:
    """Return the score of one run, and its truth if there is an estimate; a truth by its topic is in the run."""
    try:
        path = find_estimate(outputs, run_file, itself=itself)
        got = read_estimate(path, estimate)
    except NoEstimateError as error:
        return replace(blank, reason=str(error)), None
    except OdomCorruptError as error:
        return replace(blank, status="unreadable", reason=str(error)), None
    original = Path(read_beginning(run_file.parent)["input"]["path"])
    reference = truth if isinstance(truth, Estimate) else read_first([original, run_file, path], truth or "")
    blank = replace(blank, source=got.source, frame=got.frame, notes=got.notes)
    try:
        errors = path_errors(got.trajectory, reference.trajectory, align=align, covariance=got.covariance)
    except ScoreError as error:
        return replace(blank, status="unreadable", reason=str(error)), reference
    return _judged(blank, errors, limits), reference


def _judged(blank: RunScore, errors: PathErrors, limits: Limits) -> RunScore:
    failure = errors.failure(limits)
    status: Status = failure.kind if failure else "ok"
    at = f"from {failure.t_s:.1f} s ({failure.distance_m:.1f} m) on" if failure else ""
    reason = f"more than {limits.lost_m:g} m off {at}" if failure else ""
    if errors.coverage < limits.least_coverage:
        lost = f"; before that {reason}" if reason else ""
        status, reason = "partial", f"covers {100.0 * errors.coverage:.0f} % of the path{lost}"
    # number of points of each run's errors along the path that are kept for figures
    kept = np.unique(np.linspace(0, len(errors.t_s) - 1, 400).astype(int))
    return replace(
        blank, status=status, reason=reason, metrics=errors.metrics(), failure=failure, coverage=errors.coverage,
        jumps_s=tuple(errors.t_s[errors.jumps(limits)].tolist()), distance_m=errors.distance_m[kept],
        position_m=errors.position_m[kept], estimate_xy=errors.estimate_xyt[kept, :2],
    )  # fmt: skip


def _notes(runs: Sequence[RunScore], truths: set[str], align: Alignment) -> list[str]:
    """Return notes on all runs: frames, alignment and omissions in reading."""
    notes = []
    frames = sorted({run.frame for run in runs if run.metrics})
    if len(frames) > 1:
        notes.append(f"the estimates are in different frames: {', '.join(repr(frame) for frame in frames)}")
    if align in ("none", "same"):
        notes.append("not aligned: estimate and truth are taken to be in one frame")
    if any(name.endswith("clean.tum") for name in truths):
        notes.append("truth: the odometry before it was corrupted; --truth names another")
    for note, count in Counter(note for run in runs for note in run.notes).items():
        notes.append(f"{note} ({count} runs)" if count > 1 else note)
    return notes[:12]
