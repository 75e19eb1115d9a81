"""Occupancy grids of nav2: read, written, and the free space in them.

A map is a .yaml that names a .pgm. The cells that a line crosses, each once, follow Amanatides & Woo, "A fast voxel
traversal algorithm for ray tracing", Eurographics 1987; a grid counts for each cell the rays that ended in it and those
that passed through.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from odomcorrupt.bags.rosbag2.bounded_yaml import load_yaml
from odomcorrupt.errors import MapError, RecordingError
from odomcorrupt.geometry.se2 import rotate
from odomcorrupt.input_files import open_input, read_input

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array


FREE, OCCUPIED, UNKNOWN = 0, 1, 2
MAX_CELLS = 50_000_000
"""Largest number of cells of a map; more indicate an error: a drift of kilometres or a resolution of millimetres."""
_FINEST_M, _COARSEST_M, _FARTHEST_M = 1e-3, 1e3, 1e8
"""Bounds of a map's resolution and origin: what is beyond them is no map, and would overflow or take minutes."""


@dataclass(frozen=True, slots=True)
class Grid:
    """An occupancy grid in the plane.

    cells : (rows, columns) uint8 of FREE, OCCUPIED or UNKNOWN; rows go along the grid's y axis
    resolution_m : side of a cell, metres
    origin_xyt : (3,) pose of the grid's outer corner of cell (0, 0), with the direction of its x axis
    """

    cells: NDArray[np.uint8]
    resolution_m: float
    origin_xyt: Array

    def __post_init__(self) -> None:
        usual = _FINEST_M <= self.resolution_m <= _COARSEST_M and np.abs(self.origin_xyt).max() <= _FARTHEST_M
        if not (usual and 0 < self.cells.size <= MAX_CELLS):
            rows, columns = self.cells.shape
            raise MapError(
                f"map: {columns} x {rows} cells of {self.resolution_m:g} m at {self.origin_xyt.tolist()}; at most "
                f"{MAX_CELLS:,} cells of {_FINEST_M:g} to {_COARSEST_M:g} m can be used"
            )

    def places(self, xy: Array) -> Array:
        """Return positions (..., 2) in metres as column and row (..., 2) in cells, not rounded."""
        return rotate(xy - self.origin_xyt[:2], -np.full(xy.shape[:-1], self.origin_xyt[2])) / self.resolution_m

    def states(self, xy: Array) -> NDArray[np.uint8]:
        """Return the state of the cells at positions (n, 2); UNKNOWN outside the map."""
        return self.look_up(self.cells, xy, UNKNOWN)

    def look_up(self, layer: NDArray[np.uint8], xy: Array, outside: int) -> NDArray[np.uint8]:
        """Return the entries of a layer (rows, columns) at positions (n, 2)."""
        rows, columns = layer.shape
        place = np.floor(self.places(xy))
        # non-finite positions count as outside
        x, y = place[..., 0], place[..., 1]
        inside = (x >= 0.0) & (x < columns) & (y >= 0.0) & (y < rows)
        column, row = (np.where(inside, part, 0.0).astype(np.int64) for part in (x, y))
        return np.where(inside, layer[row, column], np.uint8(outside))

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom, top in metres, for a map with unrotated axes."""
        rows, columns = self.cells.shape
        x, y = self.origin_xyt[:2]
        return float(x), float(x + columns * self.resolution_m), float(y), float(y + rows * self.resolution_m)


SAVED_UNKNOWN = 205
"""Pixel value of unknown in every map_saver; with nav2's own free_thresh of 0.25 it would load as free."""
_USUAL = {"mode": "trinary", "negate": "0", "free_thresh": "0.25", "occupied_thresh": "0.65"}
_GAP = rb"(?:\s|#[^\n]{0,200}\n)+"
_HEADER = re.compile(rb"P5" + _GAP + rb"(\d{1,9})" + _GAP + rb"(\d{1,9})" + _GAP + rb"(\d{1,5})\s")


def read_map(path: Path) -> Grid:
    """Read the map of a .yaml file.

    Cells darker than `occupied_thresh` are occupied, lighter than `free_thresh` free, all others unknown; in mode
    `raw` a value of 0 to 100 is a probability in percent.

    Raises
    ------
    MapError
        If the .yaml or its image cannot be read or is invalid.
    """
    keys = _USUAL | _keys(path)
    if missing := [key for key in ("image", "resolution", "origin") if key not in keys]:
        raise MapError(f"{path}: no {', '.join(missing)}; a map_server .yaml has image, resolution and origin")
    resolution = _float(path, "resolution", keys["resolution"])
    origin = [_float(path, "origin", part) for part in keys["origin"].strip("[] ").split(",")]
    if len(origin) != 3 or not resolution > 0.0:
        raise MapError(f"{path}: resolution {keys['resolution']}, origin {keys['origin']}; give metres and [x, y, yaw]")
    mode = keys["mode"].strip("\"'")
    if mode not in ("trinary", "scale", "raw"):
        raise MapError(f"{path}: mode {mode}; there are trinary, scale and raw")
    dark = np.arange(256) / (100.0 if mode == "raw" else 255.0)
    if mode != "raw" and not _float(path, "negate", keys["negate"]):
        dark = 1.0 - dark
    free, occupied = (_float(path, key, keys[key]) for key in ("free_thresh", "occupied_thresh"))
    if not 0.0 <= free <= occupied <= 1.0:
        raise MapError(f"{path}: free_thresh {free:g}, occupied_thresh {occupied:g}; give 0 to 1, the first smaller")
    state = np.full(len(dark), UNKNOWN, dtype=np.uint8)
    state[dark < free] = FREE
    state[(dark > occupied) & (dark <= 1.0)] = OCCUPIED
    if mode == "trinary":
        state[SAVED_UNKNOWN] = UNKNOWN
    # the first row of an image is the top one
    pixels = _read_pgm(_image(path, keys["image"].strip("\"'")))[::-1]
    return Grid(state[pixels], resolution, np.array(origin))


def format_map(grid: Grid, image_name: str) -> tuple[bytes, str]:
    """Return a map's .pgm, and the .yaml that names it."""
    value = np.array([254, 0, SAVED_UNKNOWN], dtype=np.uint8)[grid.cells[::-1]]
    rows, columns = value.shape
    x, y, yaw = grid.origin_xyt
    text = (
        f"image: {image_name}\nmode: trinary\nresolution: {grid.resolution_m:.6g}\n"
        f"origin: [{x:.6f}, {y:.6f}, {yaw:.6f}]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    return f"P5\n{columns} {rows}\n255\n".encode() + value.tobytes(), text


def _keys(path: Path) -> dict[str, str]:
    """Return the keys of a map's .yaml, as text."""
    try:
        found = load_yaml(read_input(path, 1 << 14, "map's .yaml", MapError).decode(errors="replace"))
    except ValueError as error:
        raise MapError(
            f"{path}: is not a map's .yaml of names and numbers: {error}; name the one that comes with the image"
        ) from error
    return {str(key): str(value) for key, value in found.items()} if isinstance(found, dict) else {}


def _image(path: Path, name: str) -> Path:
    """Return the path of the image, in the .yaml's directory or below; an untrusted map must not open other files."""
    image = path.parent / name
    try:
        inside = image.resolve().is_relative_to(path.parent.resolve())
    except (OSError, ValueError, RuntimeError) as error:
        raise MapError(f"{path}: image {name[:80]!r}; it must name a file") from error
    if not inside:
        raise MapError(f"{path}: image {name[:80]!r} lies outside of the map's directory; put it beside the .yaml")
    return image


def _float(path: Path, key: str, text: str) -> float:
    words = {"true": "1", "false": "0"}
    try:
        value = float(words.get(text.strip().lower(), text))
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise MapError(f"{path}: {key} is {text!r}; it must be a number")
    return value


def _read_pgm(path: Path) -> NDArray[np.uint8]:
    """Read a binary .pgm (rows, columns), if it is not too large for a map."""
    with open_input(path, MapError) as file:
        match = _HEADER.match(head := file.read(4096))
        if match is None:
            raise MapError(
                f"{path}: begins with {head[:8]!r}, which is not a binary PGM (P5); convert the image to that"
            )
        columns, rows, most = (int(number) for number in match.groups())
        if columns * rows > MAX_CELLS:
            raise MapError(f"{path}: {columns} x {rows} pixels; a map has at most {MAX_CELLS:,}")
        file.seek(match.end())
        pixels = file.read(columns * rows)
    if not (0 < most <= 255 and columns > 0 and rows > 0 and len(pixels) == columns * rows):
        raise MapError(f"{path}: {columns} x {rows} pixels up to {most}, {len(pixels)} bytes of them; it is damaged")
    value = np.frombuffer(pixels, dtype=np.uint8).reshape(rows, columns)
    return value if most == 255 else np.minimum(value * (255.0 / most), 255.0).astype(np.uint8)


_RAYS_AT_ONCE = 1 << 15


@dataclass(frozen=True, slots=True)
class Canvas:
    """An empty map: lower left corner (2,) in metres, side of a cell, rows and columns."""

    low_xy: Array
    resolution_m: float
    shape: tuple[int, int]


def canvas_for(points_xy: Array, resolution_m: float) -> Canvas:
    """Return the smallest canvas of whole cells that holds points (n, 2) with a margin of half a metre."""
    low = np.floor((points_xy.min(axis=0) - 0.5) / resolution_m) * resolution_m
    columns, rows = np.ceil((points_xy.max(axis=0) + 0.5 - low) / resolution_m)
    if not rows * columns <= MAX_CELLS:
        raise RecordingError(
            f"map: {rows * columns:.3g} cells of {resolution_m:g} m; a coarser --resolution or less noise makes fewer"
        )
    return Canvas(low, resolution_m, (int(rows), int(columns)))


def traverse(start: Array, end: Array) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Yield, step by step, the cells on lines from start to end (n, 2), in cells.

    Each step gives the indices (m,) of the lines that have not reached their end, and their cells (m, 2) as column and
    row; the end cell itself is not given.
    """
    cell, last = np.floor(start).astype(np.int64), np.floor(end).astype(np.int64)
    direction = end - start
    way = np.sign(direction).astype(np.int64)
    with np.errstate(divide="ignore", invalid="ignore"):
        stride = np.abs(1.0 / direction)
        # distance to the next border of a column or row, as a fraction of the line
        border = np.where(way > 0, cell + 1.0 - start, start - cell) * stride
    border, stride = np.where(way == 0, np.inf, border), np.where(way == 0, np.inf, stride)
    left = np.abs(last - cell).sum(axis=1)
    number = np.arange(len(start))
    while (going := left > 0).any():
        if not going.all():
            number, left, cell, way = number[going], left[going], cell[going], way[going]
            border, stride, last = border[going], stride[going], last[going]
        yield number, cell
        # rounding must not move a line past its last column or row
        border = np.where(cell == last, np.inf, border)
        axis = np.argmin(border, axis=1)
        row = np.arange(len(axis))
        cell = cell.copy()
        cell[row, axis] += way[row, axis]
        border[row, axis] += stride[row, axis]
        left = left - 1


def draw_map(canvas: Canvas, from_xy: Array, to_xy: Array) -> Grid:
    """Return the map of n rays (n, 2) from laser positions to hits, metres in the map's frame."""
    rows, columns = canvas.shape
    passed, hit = np.zeros(rows * columns, dtype=np.int64), np.zeros(rows * columns, dtype=np.int64)
    start, end = ((xy - canvas.low_xy) / canvas.resolution_m for xy in (from_xy, to_xy))
    inside = ((start >= 0.0) & (start < (columns, rows)) & (end >= 0.0) & (end < (columns, rows))).all(axis=1)
    start_cell, end_cell = np.floor(start[inside]).astype(np.int64), np.floor(end[inside]).astype(np.int64)
    # a laser is finer than the cells: rays between the same two cells are traversed once, from centre to centre
    flat_end = end_cell[:, 1] * columns + end_cell[:, 0]
    key = (start_cell[:, 1] * columns + start_cell[:, 0]) * (rows * columns) + flat_end
    _, first, weight = np.unique(key, return_index=True, return_counts=True)
    for i in range(0, len(first), _RAYS_AT_ONCE):
        part = slice(i, i + _RAYS_AT_ONCE)
        begin, finish = ((cells[first[part]] + 0.5).astype(np.float64) for cells in (start_cell, end_cell))
        for number, cell in traverse(begin, finish):
            np.add.at(passed, cell[:, 1] * columns + cell[:, 0], weight[part][number])
    np.add.at(hit, flat_end, 1)
    share = hit / np.maximum(hit + passed, 1)
    # smallest share of the rays reaching a cell that end in it, for the cell to be a wall (gmapping's occ_thresh)
    cells = np.where(share >= 0.25, OCCUPIED, FREE)
    cells = np.where(hit + passed == 0, UNKNOWN, cells).astype(np.uint8)
    return Grid(cells.reshape(rows, columns), canvas.resolution_m, np.array([*canvas.low_xy, 0.0]))


Unknown = Literal["blocked", "free"]
Check = Literal["endpoint", "path"]


@dataclass(frozen=True, slots=True)
class FreeSpace:
    """Map inflated for a robot.

    blocked : (rows, columns) 1 in cells where the robot's centre cannot be
    map_from_odom : (3,) pose of the odom frame in the map; positions are given in the odom frame
    outside : 1 if positions beyond the map's border count as blocked
    """

    grid: Grid
    blocked: NDArray[np.uint8]
    map_from_odom: Array
    outside: int

    def free(self, xy: Array) -> NDArray[np.bool_]:
        """Return whether the robot can be at positions (n, 2) in the odom frame."""
        return self.grid.look_up(self.blocked, self._in_map(xy), self.outside) == 0

    def reachable(self, from_xy: Array, to_xy: Array) -> NDArray[np.bool_]:
        """Return whether the straight path to each position (n, 2) is free, both ends included.

        The lecture's star: a position behind a wall is free, but not reachable.
        """
        rows, columns = self.blocked.shape
        clear = self.free(to_xy)
        # a path to a blocked end need not be checked
        left = np.flatnonzero(clear)
        start, end = (self.grid.places(self._in_map(xy[left])) for xy in (from_xy, to_xy))
        for number, cell in traverse(start, end):
            inside = (cell >= 0).all(axis=1) & (cell[:, 0] < columns) & (cell[:, 1] < rows)
            column, row = np.where(inside[:, None], cell, 0).T
            stopped = np.where(inside, self.blocked[row, column], self.outside) != 0
            clear[left[number[stopped]]] = False
        return clear

    def _in_map(self, xy: Array) -> Array:
        turn = np.full(xy.shape[:-1], self.map_from_odom[2])
        return rotate(xy, turn) + self.map_from_odom[:2]


@dataclass(frozen=True, slots=True)
class Constraint:
    """Constraint of motions to free space: the space, the part of a motion that is checked, and the number of tries."""

    space: FreeSpace
    check: Check = "endpoint"
    tries: int = 100

    def allows(self, from_xy: Array, to_xy: Array) -> NDArray[np.bool_]:
        """Return whether motions (n,) between positions (n, 2) are free."""
        return self.space.free(to_xy) if self.check == "endpoint" else self.space.reachable(from_xy, to_xy)


def free_space(
    grid: Grid, radius_m: float, *, unknown: Unknown = "blocked", map_from_odom: Array | None = None
) -> FreeSpace:
    """Prepare a map for a round robot.

    grid : occupancy grid
    radius_m : radius of the robot. A cell is blocked if a wall is nearer than this to its centre, accurate
        to half a cell's diagonal
    unknown : whether the robot's centre may be in an unknown cell, or beyond the map. Only walls are inflated by the
        radius; unknown cells are not
    map_from_odom : pose of the odom frame in the map; by default the same frame
    """
    if not (np.isfinite(radius_m) and radius_m >= 0.0):
        raise MapError(f"robot radius: {radius_m} m; it must be zero or more")
    # largest product of the cells of a map and the robot's radius in cells: ten seconds
    if radius_m / grid.resolution_m * grid.cells.size > 2e9:
        raise MapError(
            f"map: {grid.cells.size:,} cells of {grid.resolution_m:g} m, and a robot of {radius_m:g} m; that takes "
            "minutes: give a coarser map, or a smaller --robot-radius"
        )
    # a radius of three and a half cells must not be reduced by rounding
    blocked = _inflated(grid.cells == OCCUPIED, radius_m / grid.resolution_m * (1.0 + 1e-9))
    if unknown == "blocked":
        blocked |= grid.cells == UNKNOWN
    pose = np.zeros(3) if map_from_odom is None else map_from_odom
    return FreeSpace(grid, blocked.astype(np.uint8), pose, int(unknown == "blocked"))


def _inflated(walls: NDArray[np.bool_], radius: float) -> NDArray[np.bool_]:
    """Return the cells with a centre within the radius, in cells, of a wall's square.

    A disc is a stack of rows. Each row's range is looked up in cumulative sums, so the cost grows with the radius
    instead of its square.
    """
    rows, columns = walls.shape
    reach = int(np.floor(radius + 0.5))
    # cumulative sums along each row, continued by its ends as far as a disc reaches
    beyond = min(reach, columns)
    total = np.zeros((rows, columns + 1 + 2 * beyond), dtype=np.int32)
    np.cumsum(walls, axis=1, out=total[:, beyond + 1 : beyond + 1 + columns])
    total[:, beyond + 1 + columns :] = total[:, beyond + columns, None]
    out = np.zeros_like(walls)
    for down in range(min(reach, rows - 1) + 1):
        gap = max(down - 0.5, 0.0)
        if gap > radius:
            break
        # even a zero radius keeps the robot's centre out of the wall cell
        run = min(int(np.floor(np.sqrt(radius**2 - gap**2) + 0.5)), columns) if radius > 0.0 else 0
        near = total[:, beyond + run + 1 :][:, :columns] > total[:, beyond - run :][:, :columns]
        out[down:] |= near[: rows - down]
        out[: rows - down] |= near[down:]
    return out
