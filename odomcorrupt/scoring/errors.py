"""Errors of one estimated trajectory against the truth: ATE, RPE, errors of 10 s motions, NEES, coverage, failures.

ATE and RPE are those of Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012, with the
definitions of the tool evo (root mean squares; alignment after Umeyama, PAMI 13(4), 1991, without scale; consecutive
motions). The truth is interpolated at the stamps of the estimate, whereas evo takes the nearest pose within 0.01 s;
with equal stamps the numbers agree.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from odomcorrupt.errors import OdomCorruptError
from odomcorrupt.geometry.se2 import between, compose, inverse, rotate, wrap
from odomcorrupt.geometry.trajectory import distance_along

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.geometry.trajectory import Trajectory

Alignment = Literal["rigid", "origin", "none", "same"]

RPE_M = 1.0
"""Path length of the motions compared by RPE, metres."""

WINDOW_S = 10.0
"""Duration of the motions of the 10 s error, seconds."""

CHI2_95 = {1: 3.841, 2: 5.991, 3: 7.815}
"""Upper 5 % points of chi squared by degrees of freedom."""


class ScoreError(OdomCorruptError):
    """Runs cannot be scored, or a gate cannot be evaluated."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits beyond which a run has failed.

    lost_m : position error above which the estimate is lost, metres
    lost_s : shortest duration above `lost_m`; at the end of a run any duration counts, seconds
    jump_m : change of the error between estimates at most 1 s apart that counts as a jump, metres
    least_coverage : fraction of the truth's path that the estimate must cover
    """

    lost_m: float = 1.0
    lost_s: float = 10.0
    jump_m: float = 0.5
    least_coverage: float = 0.9

    def __post_init__(self) -> None:
        for name in ("lost_m", "lost_s", "jump_m", "least_coverage"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0.0):
                raise ScoreError(f"{name}: {value:g}; it must be a number from 0 on")


@dataclass(frozen=True, slots=True)
class Failure:
    """Time, place and kind of a failure: "lost", or "diverged" (the error exceeded ten times `lost_m`)."""

    kind: Literal["lost", "diverged"]
    t_s: float
    distance_m: float
    xy_m: tuple[float, float]


@dataclass(frozen=True, slots=True)
class PathErrors:
    """An aligned estimate and the truth at its n stamps.

    t_s : (n,) seconds since the first stamp of the truth
    distance_m : (n,) path length of the truth up to each stamp
    truth_xyt, estimate_xyt : (n, 3) metres and radians; headings are NaN if either has positions only
    nees : (n,) normalised squared error per degree of freedom, empty if the estimate has no covariance
    inside_95 : fraction of the errors inside the 95 % ellipsoids of the estimate's covariance, NaN without
    coverage : fraction of the truth's path length between the estimate's first and last stamp
    """

    t_s: Array
    distance_m: Array
    truth_xyt: Array
    estimate_xyt: Array
    nees: Array
    inside_95: float
    coverage: float

    @property
    def position_m(self) -> Array:
        """Position error (n,), metres."""
        return np.linalg.norm(self.estimate_xyt[:, :2] - self.truth_xyt[:, :2], axis=1)

    @property
    def heading_rad(self) -> Array:
        """Heading error (n,), estimate minus truth, wrapped, radians."""
        return wrap(self.estimate_xyt[:, 2] - self.truth_xyt[:, 2])

    def metrics(self) -> dict[str, float]:
        """Return metrics by name: metres, radians; NaN without headings or sufficient length."""
        from odomcorrupt.study.validate.trajectory_error import relative_errors  # noqa: PLC0415 - needs SciPy

        position = self.position_m
        rpe = relative_errors(self.truth_xyt, self.estimate_xyt, RPE_M)
        window = _windows(self.truth_xyt, self.estimate_xyt, self.t_s)
        return {
            "ate_m": _rms(position),
            "ate_rad": _rms(self.heading_rad),
            "max_m": float(position.max()),
            "rpe_m": _rms(rpe.translation_m),
            "rpe_rad": _rms(rpe.rotation_rad),
            "error_10s_m": _rms(window),
            "end_m": float(position[-1]),
            "nees": float(self.nees.mean()) if len(self.nees) else float("nan"),
            "inside_95": self.inside_95,
        }

    def failure(self, limits: Limits) -> Failure | None:
        """Return the failure of an estimate lost for `lost_s` seconds or until its end; None if it never was."""
        over = self.position_m > limits.lost_m
        edges = np.flatnonzero(np.diff(np.concatenate(([False], over, [False])).astype(np.int8)))
        for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
            last = end >= len(over)
            if last or self.t_s[end] - self.t_s[begin] >= limits.lost_s:
                far = bool((self.position_m[begin:end] > 10.0 * limits.lost_m).any())
                x, y = self.truth_xyt[begin, :2].tolist()
                return Failure(
                    "diverged" if far else "lost", float(self.t_s[begin]), float(self.distance_m[begin]), (x, y)
                )
        return None

    def jumps(self, limits: Limits) -> NDArray[np.int64]:
        """Return the indices (k,) of estimates that jumped: by at least `jump_m` against the truth, within 1 s."""
        off = self.estimate_xyt[:, :2] - self.truth_xyt[:, :2]
        moved = np.linalg.norm(np.diff(off, axis=0), axis=1)
        return np.flatnonzero((moved >= limits.jump_m) & (np.diff(self.t_s) <= 1.0)) + 1


def path_errors(
    estimate: Trajectory, truth: Trajectory, *, align: Alignment = "rigid", covariance: Array | None = None
) -> PathErrors:
    """Return the errors of an estimate at its stamps within the truth's period.

    estimate, truth : headings may be NaN, if only positions were recorded
    align : "rigid": rotated and translated for the smallest distance of positions; "origin": first poses made equal;
        "none", "same": as recorded, both in one frame
    covariance : (n, 3, 3) covariance of x, y (metres) and heading (radians) in the estimate's frame

    Returns
    -------
    PathErrors
        Both trajectories at the same stamps, and NEES; `metrics()` has ATE, RPE and the others.

    Raises
    ------
    ScoreError
        If they do not overlap in time.
    """
    origin = int(truth.stamps_ns[0])
    t_s = estimate.seconds_since(origin)
    truth_s = truth.seconds_since(origin)
    shared = (t_s >= truth_s[0]) & (t_s <= truth_s[-1])
    if np.count_nonzero(shared) < 2:
        spans = [f"{one.stamps_ns[0] * 1e-9:.3f} to {one.stamps_ns[-1] * 1e-9:.3f} s" for one in (estimate, truth)]
        said = "no time in common: the estimate has {}, the truth {}".format(*spans)
        raise ScoreError(f"{said}; give both the same clock (use_sim_time with ros2 bag play --clock)")
    t_s, own = t_s[shared], estimate.xyt[shared]
    if np.isfinite(truth.xyt[:, 2]).all():
        true = truth.at(t_s, origin)
    else:
        x, y = (np.interp(t_s, truth_s, truth.xyt[:, i]) for i in (0, 1))
        true = np.column_stack((x, y, np.full(len(t_s), np.nan)))
    aligned = _aligned(true, own, align)
    gone = distance_along(truth.xyt)
    distance = np.interp(t_s, truth_s, gone)
    coverage = float((distance[-1] - distance[0]) / gone[-1]) if gone[-1] > 0.0 else 1.0
    nees, inside = np.zeros(0), float("nan")
    if covariance is not None:
        turned = aligned[0, 2] - own[0, 2] if np.isfinite(own[0, 2]) else 0.0
        nees, inside = _nees(true, aligned, covariance[shared], turned)
    return PathErrors(t_s, distance, true, aligned, nees, inside, coverage)


def _aligned(true: Array, own: Array, align: Alignment) -> Array:
    if align in ("none", "same"):
        return own
    if align == "rigid":
        from odomcorrupt.study.validate.trajectory_error import aligned_rigidly  # noqa: PLC0415 - needs SciPy

        return aligned_rigidly(true, own)
    if not (np.isfinite(true[0]).all() and np.isfinite(own[0]).all()):
        raise ScoreError("--align origin: aligns the first poses, which needs headings; use rigid")
    return compose(true[0], between(own[0], own))


def _windows(true: Array, own: Array, t_s: Array) -> Array:
    """Return position errors (m,) of consecutive motions of `WINDOW_S`, each starting from the true pose."""
    cuts = [0]
    while (following := int(np.searchsorted(t_s, t_s[cuts[-1]] + WINDOW_S - 1e-6))) < len(t_s):
        cuts.append(following)
    ends = np.array(cuts)
    moved = between(true[ends[:-1]], true[ends[1:]])
    error = compose(inverse(moved), between(own[ends[:-1]], own[ends[1:]]))
    return np.hypot(error[:, 0], error[:, 1])


def _nees(true: Array, own: Array, covariance: Array, turned_rad: float) -> tuple[Array, float]:
    """Return NEES per degree of freedom (m,), and the fraction inside 95 %, for valid covariances."""
    error: Array = own - true
    error[:, 2] = wrap(error[:, 2])
    # into the axes of the covariance, which the alignment has rotated
    error[:, :2] = rotate(error[:, :2], np.full(len(error), -turned_rad))
    dof = 3 if np.isfinite(error[:, 2]).all() else 2
    error, covariance = error[:, :dof], covariance[:, :dof, :dof]
    usable: NDArray[np.bool_] = np.asarray((np.abs(covariance) < 1e12).all(axis=(1, 2)))  # false for NaN
    symmetric = (covariance + np.swapaxes(covariance, 1, 2)) / 2.0
    eigenvalues = np.linalg.eigvalsh(np.where(usable[:, None, None], symmetric, np.eye(dof)))
    usable &= eigenvalues[:, 0] > 1e-15
    if not usable.any():
        return np.zeros(0), float("nan")
    solved = np.linalg.solve(symmetric[usable], error[usable][:, :, None])[:, :, 0]
    squared = np.sum(error[usable] * solved, axis=1)
    return squared / dof, float(np.mean(squared <= CHI2_95[dof]))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")
