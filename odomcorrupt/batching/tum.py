"""Paths as TUM files, and all paths of a batch as one npz."""

from __future__ import annotations

import io
import zipfile
from typing import TYPE_CHECKING, Self

import numpy as np

from odomcorrupt.bags.output import Output
from odomcorrupt.corruption.inverse import acts
from odomcorrupt.files import open_input
from odomcorrupt.geometry.se2 import yaw_from_quaternion

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path
    from types import TracebackType

    from numpy.typing import NDArray

    from odomcorrupt.batching.patch_batch import Portion
    from odomcorrupt.corruption.path import Knots
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import MotionModel

__all__ = ["TumPath", "TumSink", "read_tum", "write_npz"]

_LINE = "%d.%09d %.9f %.9f 0 0 0 %.12f %.12f\n"


class TumPath:
    """A path: stamps_ns (n,), xyt (n, 3) in metres and radians."""

    __slots__ = ("stamps_ns", "xyt")

    def __init__(self, stamps_ns: NDArray[np.int64], xyt: Array) -> None:
        self.stamps_ns = stamps_ns
        self.xyt = xyt


def format_tum(stamps_ns: NDArray[np.int64], xyt: Array) -> bytes:
    """Return TUM lines (time, position, unit quaternion) of planar poses xyt (n, 3), metres and radians."""
    seconds, rest = np.divmod(stamps_ns, 1_000_000_000)
    half = xyt[:, 2] / 2.0
    columns = (seconds, rest, xyt[:, 0], xyt[:, 1], np.sin(half), np.cos(half))
    values = [value for row in zip(*(column.tolist() for column in columns), strict=True) for value in row]
    return (_LINE * len(stamps_ns) % tuple(values)).encode()


def read_tum(path: Path) -> TumPath:
    """Return the planar poses of a TUM file, with stamps to the nanosecond."""
    with open_input(path) as stream:
        text = stream.read()
    stamps = [line.split(b" ", 1)[0] for line in text.splitlines()]
    numbers = np.loadtxt(io.BytesIO(text), ndmin=2)
    whole = np.array([int(stamp.replace(b".", b"")) for stamp in stamps], dtype=np.int64)
    return TumPath(whole, np.column_stack((numbers[:, 1:3], yaw_from_quaternion(numbers[:, 4:8]))))


class TumSink:
    """TUM file of one run's path, or without a model of the clean path; clock effects shift the stamps as in a bag."""

    def __init__(self, path: Path, model: MotionModel | None) -> None:
        self._output = Output(path, overwrite=True)
        self._clean = model is None
        self._clocks = () if model is None else tuple(e for e in model.effects if e.clock and acts(e))
        self._waiting: list[Knots] = []

    def restart(self) -> None:
        """Do nothing: a TUM file has no stretches."""

    def add(self, knots: Knots) -> None:
        """Take the next part of the path."""
        self._waiting.append(knots)

    def put(self, portion: Portion, _data: NDArray[np.uint8], _added: object = None) -> None:
        """Write the path so far."""
        for knots in self._waiting:
            xyt = knots.clean_xyt if self._clean else knots.clean_xyt + knots.error_xyt
            t_s = (knots.stamps_ns - portion.first_ns) * np.float64(1e-9)
            shift_s = sum((effect.stamp_shift_s(t_s) for effect in self._clocks), start=np.zeros(len(knots)))
            stamps_ns = knots.stamps_ns + np.rint(shift_s * 1e9).astype(np.int64)
            self._output.write(format_tum(stamps_ns, xyt))
        self._waiting.clear()

    def __enter__(self) -> Self:
        try:
            self._output.open()
        except BaseException:
            self._output.discard()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self._output.commit()
        finally:
            self._output.discard()


def write_npz(path: Path, clean: TumPath, runs: Sequence[int], files: Sequence[Path]) -> None:
    """Write all paths of a batch to an npz file, with one run in memory at a time.

    Arrays: runs (k,), stamps_ns (n,), clean_xyt (n, 3), xyt (k, n, 3), metres and radians.
    """
    output = Output(path, overwrite=True)
    try:
        output.open()
        with zipfile.ZipFile(_Sink(output), "w", zipfile.ZIP_STORED) as archive:
            for name, array in (("runs", np.array(runs)), ("stamps_ns", clean.stamps_ns), ("clean_xyt", clean.xyt)):
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, np.ascontiguousarray(array), allow_pickle=False)
            with archive.open("xyt.npy", "w", force_zip64=True) as member:
                shape = (len(files), *clean.xyt.shape)
                head = {"descr": "<f8", "fortran_order": False, "shape": shape}
                np.lib.format.write_array_header_2_0(member, head)
                for file in files:
                    member.write(np.ascontiguousarray(read_tum(file).xyt, dtype="<f8").tobytes())
        output.commit()
    finally:
        output.discard()


class _Sink(io.RawIOBase):
    """An output as a stream without seeking, for zip files."""

    def __init__(self, output: Output) -> None:
        self._output = output

    def writable(self) -> bool:
        return True

    def write(self, data: object, /) -> int:
        view = memoryview(data)  # type: ignore[arg-type]  # zipfile passes bytes
        self._output.write(view)
        return len(view)
