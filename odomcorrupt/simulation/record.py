"""Result of a simulated drive: a recording, and its hidden fault in a file whose hash is in the bag."""

from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

import numpy as np

from odomcorrupt.simulation.encoders import Odometry
from odomcorrupt.simulation.faults import CAUSES, EVERY, Parameters
from odomcorrupt.simulation.planar import wrap
from odomcorrupt.simulation.streams import stream
from odomcorrupt.simulation.tracker import Track

EPOCH_NS = 1_750_000_000_000_000_000


@dataclass(frozen=True, slots=True)
class SimulatedRun:
    """A recording and its fault. Poses are m, m, rad wrapped to (-pi, pi]; twists m/s, m/s, rad/s in the body.

    Attributes
    ----------
    odom_stamps_ns : ndarray of int64, shape (n,)
        Stamps of the odometry's clock.
    odom_xyt, odom_twist : ndarray, shape (n, 3)
        Pose of the base in the odometry frame; mean twist since the previous sample.
    truth_stamps_ns : ndarray of int64, shape (m,)
        Stamps of the tracker's clock.
    truth_xyt : ndarray, shape (m, 3)
        Pose of the tracked frame in the world.
    answer : dict
        ``cause`` (str, several joined by +, or None), ``parameters`` of a single cause (names and units as in the
        effects' table), ``causes`` (parameters of each by its name) and ``track_m`` (nominal).
    track_m : float
        Nominal track, m.
    """

    odom_stamps_ns: np.ndarray
    odom_xyt: np.ndarray
    odom_twist: np.ndarray
    truth_stamps_ns: np.ndarray
    truth_xyt: np.ndarray
    answer: dict[str, Any]
    track_m: float


def record(odom: Odometry, track: Track, faults: Mapping[str, Parameters], track_m: float) -> SimulatedRun:
    """Return the recording of odometry and tracker, with its faults.

    faults : parameters of each fault by its name
    track_m : nominal track, m
    """
    causes = {name: dict(parameters) for name, parameters in faults.items()}
    single = next(iter(causes.values())) if len(causes) == 1 else {}
    return SimulatedRun(
        odom_stamps_ns=_to_ns(odom.stamps_s),
        odom_xyt=_wrapped(odom.xyt),
        odom_twist=odom.twist,
        truth_stamps_ns=_to_ns(track.stamps_s),
        truth_xyt=_wrapped(track.xyt),
        answer={"cause": "+".join(causes) or None, "parameters": single, "causes": causes, "track_m": track_m},
        track_m=track_m,
    )


def _to_ns(times_s: np.ndarray) -> np.ndarray:
    return EPOCH_NS + np.rint(times_s * 1e9).astype(np.int64)


def _wrapped(xyt: np.ndarray) -> np.ndarray:
    return np.column_stack((xyt[:, :2], wrap(xyt[:, 2])))


def format_answer(run: SimulatedRun, seed: int, made: Mapping[str, str | float]) -> str:
    """Return the fault as TOML, with a salt against recovery from the hash by guessing.

    seed : seed of the run
    made : other arguments of the run
    """
    lines = ["schema = 1", f"seed = {seed}", f'salt = "{stream(seed, "salt").bytes(16).hex()}"']
    lines += [f"{name} = {_toml(value)}" for name, value in made.items()]
    lines += [f"track_m = {run.track_m!r}"]
    if not run.answer["causes"]:
        lines += ["causes = []"]
    for name, parameters in run.answer["causes"].items():
        lines += ["", "[[causes]]", f'name = "{name}"', f"in_library = {str(name in CAUSES).lower()}"]
        if name not in CAUSES:
            lines += [f'depends_on = "{EVERY[name].depends_on}"']
        lines += ["[causes.parameters]", *(f"{key} = {_toml(value)}" for key, value in parameters.items())]
    return "\n".join(lines) + "\n"


def fingerprint(answer: str) -> str:
    """Return the SHA-256 of an answer file's text, in hexadecimal."""
    return sha256(answer.encode()).hexdigest()


def _toml(value: str | float) -> str:
    return f'"{value}"' if isinstance(value, str) else repr(value)
