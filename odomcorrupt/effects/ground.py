"""Effects of places and of the floor: slippery regions, slopes, castors."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from odomcorrupt.drive_types import PIVOTING
from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, choice, gain, parameter, stacked
from odomcorrupt.effects.gears import AT_REST, crossed
from odomcorrupt.effects.wheels import Rims, body_of, heading_choice, needed_track_m, scaled, wheel_motions

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array


_MOST_DISCS = 400
_ANGLES = (1e-3, np.pi / 6.0, np.pi / 3.0)
"""Of the first rectangles, rad; not exactly 0, at which an optional parameter is held."""
_RESTS_M = 1e-12
"""Ways shorter than this are at one place, m."""
_LEAST_SHARE, _MOST_SHARE = 0.01, 0.8
"""Fractions of the path inside a disc below and above which its slip cannot be estimated."""


@dataclass(frozen=True, slots=True)
class RegionSlip(Effect):
    """f = -slip (v, vy, omega) inside a disc or rectangle of the truth frame, for the part of each step that is inside.

    With contact = wheels, f acts on each wheel: one slips before the other at the edge, and the robot turns. With a
    width the patch is a rectangle, as carpets are.
    """

    name = "region_slip"
    odd = True
    summary = "the wheels slip on one patch of the floor"
    reads_truth = True
    reads_places = True
    about = About(
        equation="f = -slip (v, vy, omega) where (x, y) lies inside the disc or rectangle; (v, vy, 0) with a gyro; "
        "contact = wheels: f_wheel = -slip u of each wheel that is inside",
        typical="1 to 10 % at a carpet's edge, on wet floor, on a ramp (an estimate)",
        source="engineering judgement; no published figures known to us",
        confused_with=("scale_drift", "wheel_scale", "slope", "slip_burst"),
        drive="cross the place again at other times and in other headings, and drive elsewhere as much",
    )

    slip: float = parameter("", "part of the wheels' travel that is lost inside", low=-0.1, high=0.5, typical=0.05)
    x: float = parameter("m", "centre", low=-1e8, high=1e8, typical=1.0, amplitude=False)
    y: float = parameter("m", "centre", low=-1e8, high=1e8, typical=1.0, amplitude=False)
    radius: float = parameter(
        "m", "of the disc; of a rectangle, half its length", low=0.05, high=1e3, typical=1.0, identity=1.0,
        amplitude=False,
    )  # fmt: skip
    width: float = parameter(
        "m", "half the width of a rectangle; 0: a disc", low=0.0, high=1e3, typical=1.0, amplitude=False, optional=True
    )
    angle: float = parameter(
        "rad", "from the x axis to the length of a rectangle",
        low=-np.pi, high=np.pi, typical=0.5, amplitude=False, optional=True,
    )  # fmt: skip
    heading: str = heading_choice()
    contact: str = choice("what must be on the patch to slip: the centre of the robot, or each wheel", "body", "wheels")

    @classmethod
    def scan(cls, motions: Sequence[Motion]) -> tuple[Self, ...]:
        """Return discs over the area covered: three sizes, centres half a radius to a radius apart.

        Discs that contain hardly any or nearly all of the path are left out.
        """
        xy = np.concatenate([np.stack((m.x, m.y), axis=1) for m in motions])
        way = np.concatenate([m.travel for m in motions])
        if not way.sum() > 0.0:
            return ()
        low, high = xy.min(axis=0), xy.max(axis=0)
        extent = float((high - low).max())
        found: list[Self] = []
        for radius in (extent / 12.0, extent / 6.0, extent / 3.0):
            if radius < 0.1:
                continue
            # positions are binned to grid cells, so that the cost of the sums below does not grow with the message rate
            cell = np.round((xy - low) / (radius / 4.0)).astype(np.int64)
            # both cell indices in one number: it sorts like the pair, in a tenth of the time
            wide = int(cell[:, 1].max()) + 1
            numbers, which = np.unique(cell @ (wide, 1), return_inverse=True)
            places = np.stack(np.divmod(numbers, wide), axis=1)
            share = np.bincount(which.ravel(), way) / way.sum()
            centres = np.unique(np.round(places / 4.0).astype(np.int64), axis=0) * 4
            for centre in centres:
                inside = share[((places - centre) ** 2).sum(axis=1) <= 16.0].sum()
                if _LEAST_SHARE < inside < _MOST_SHARE:
                    at = low + centre * (radius / 4.0)
                    found.append(cls(x=float(at[0]), y=float(at[1]), radius=radius))
        every = -(-len(found) // _MOST_DISCS) or 1
        return tuple(found[::every])

    @classmethod
    def in_rectangle(
        cls, angle: float, at_xy: tuple[float, float], half_m: float, side_m: float, motions: Sequence[Motion]
    ) -> Self:
        """Return a rectangle; an infinite one ends beyond the path that it contains.

        angle : of the first axis, rad; at_xy : a point on both centre lines, m
        half_m, side_m : half the sides along the first and the second axis, m; the latter may be infinite
        """
        c, s = np.cos(angle), np.sin(angle)
        x, y = np.concatenate([np.stack((m.x, m.y)) for m in motions], axis=1) - np.array(at_xy)[:, None]
        beside = (c * y - s * x)[np.abs(c * x + s * y) < half_m]
        middle = 0.0
        if not np.isfinite(side_m):
            low, high = (beside.min(), beside.max()) if len(beside) else (-half_m, half_m)
            middle, side_m = 0.5 * (low + high), 0.5 * (high - low) + half_m
        return cls(
            x=float(at_xy[0] - s * middle), y=float(at_xy[1] + c * middle), radius=float(side_m), width=half_m,
            angle=float(np.arctan2(c, -s)) or _ANGLES[0],
        )  # fmt: skip

    def related(self) -> tuple[Self, ...]:
        """Return rectangles of the area of the disc, at three angles; a search tries them around the best disc."""
        half = 0.5 * np.sqrt(np.pi) * self.radius
        return tuple(replace(self, radius=half, width=half, angle=angle) for angle in _ANGLES)

    def continued(self, motions: Sequence[Motion]) -> Self:
        """Return a rectangle with each edge half-way to the nearest path beyond it, or twice as far out if none is.

        The data leave an edge free between the last path inside it and the first one outside.
        """
        if not self.width:
            return self
        ahead, left = self._inside_axes(*(np.concatenate([getattr(m, axis) for m in motions]) for axis in ("x", "y")))
        low, high = _free_edges(ahead, np.abs(left) <= self.width, self.radius)
        right, top = _free_edges(left, np.abs(ahead) <= self.radius, self.width)
        forward, sideways = 0.5 * (low + high), 0.5 * (right + top)
        c, s = np.cos(self.angle), np.sin(self.angle)
        return replace(
            self,
            x=float(self.x + c * forward - s * sideways),
            y=float(self.y + s * forward + c * sideways),
            radius=float(0.5 * (high - low)),
            width=float(0.5 * (top - right)),
        )

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: a scale error that depends on the position."""
        if self.contact == "wheels":
            track_m = needed_track_m(self, motion.track_m)
            rims = Rims(*(self._ratio(wheel) * wheel.v for wheel in wheel_motions(motion, track_m)))
            return TwistError(body_of(rims, track_m, self.heading), state)
        return TwistError(stacked(*scaled(motion, self._ratio(motion), self.heading), motion.v), state)

    def _ratio(self, motion: Motion) -> Array:
        """Return the relative speed error (n,): -slip times the part of each interval's path inside the patch."""
        # most intervals are inside or outside as a whole; only the others are cut at the edge
        way_m = np.abs(motion.v * motion.dt_s) + np.abs(motion.vy * motion.dt_s)
        square = (motion.x - self.x) ** 2 + (motion.y - self.y) ** 2
        inner, outer = min(self.radius, self.width or self.radius), np.hypot(self.radius, self.width)
        inside = square < np.maximum(inner - way_m, 0.0) ** 2
        ratio = np.where(inside, -self.slip, 0.0)
        near = np.flatnonzero((square <= (outer + way_m) ** 2) & ~inside)
        ahead, left = self._inside_axes(motion.x[near], motion.y[near])
        dt_s = motion.dt_s[near]
        to = motion.theta[near] + 0.5 * motion.omega[near] * dt_s - self.angle
        v, vy, c, s = motion.v[near] * dt_s, motion.vy[near] * dt_s, np.cos(to), np.sin(to)
        forward, sideways = c * v - s * vy, s * v + c * vy
        if self.width:
            both = (_within(ahead, forward, self.radius), _within(left, sideways, self.width))
            first, last = np.maximum(both[0][0], both[1][0]), np.minimum(both[0][1], both[1][1])
        else:
            way = np.hypot(forward, sideways)
            c = np.divide(forward, way, out=np.ones_like(way), where=way > 0.0)
            s = np.divide(sideways, way, out=np.zeros_like(way), where=way > 0.0)
            half = np.sqrt(np.maximum(self.radius**2 - (c * left - s * ahead) ** 2, 0.0))
            first, last = _within(c * ahead + s * left, way, half)
        ratio[near] = -self.slip * np.maximum(last - first, 0.0)
        return ratio

    def _inside_axes(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return places (n,), (n,), m, relative to the centre, along the length and the width of the patch."""
        x, y, c, s = x - self.x, y - self.y, np.cos(self.angle), np.sin(self.angle)
        return c * x + s * y, c * y - s * x


def _within(start: Array, way: Array, half: Array | float) -> tuple[Array, Array]:
    """Return the parts (n,), (n,) of ways (n,), m, from starts (n,) at which they enter and leave -half to half."""
    way = np.where(np.abs(way) < _RESTS_M, _RESTS_M, way)
    ends = (-half - start) / way, (half - start) / way
    return np.clip(np.minimum(*ends), 0.0, 1.0), np.clip(np.maximum(*ends), 0.0, 1.0)


def _free_edges(along: Array, beside: NDArray[np.bool_], half: float) -> tuple[float, float]:
    """Return the middle of the range of each edge, -half and half, in which the data are the same.

    along : positions (n,) on the axis that the edges cut; beside : which of them are within the other two edges
    """
    on = along[beside]
    inside, above, below = on[np.abs(on) <= half], on[on > half], on[on < -half]
    if not len(inside):
        return -half, half
    top = 0.5 * (inside.max() + above.min()) if len(above) else 2.0 * half
    bottom = 0.5 * (inside.min() + below.max()) if len(below) else -2.0 * half
    return float(bottom), float(top)


def _downhill(it: Any, m: Motion) -> tuple[Array, Array, float]:
    """Return f: the creep in the body frame."""
    speed, away = it.creep * np.abs(m.v), it.direction - m.theta
    return speed * np.cos(away), speed * np.sin(away), 0.0


def _forwards(it: Any) -> Any:
    """Return the equivalent effect with positive creep."""
    turned = it.direction + (math.pi if it.creep < 0.0 else 0.0)
    return replace(it, creep=abs(it.creep), direction=math.remainder(turned, 2.0 * math.pi))


# Two of them at right angles span all directions linearly; a negative creep is the opposite direction, so that half a
# turn of directions is tried.
Slope = gain(
    "slope",
    "the robot creeps in one direction of the world as it drives",
    _downhill,
    About(
        equation="f = creep abs(v) (cos(direction - theta), sin(direction - theta), 0)",
        typical="0.3 to 3 % of the way on ramps of 2 to 5 degrees (an estimate)",
        source="slip under a constant force, with a linear tyre (Rajamani, Vehicle Dynamics and Control)",
        confused_with=("mount_yaw", "wheel_scale", "region_slip"),
        drive="drive the same place in all four headings",
    ),
    odd=True,
    reads_truth=True,
    reads_places=True,
    plain=_forwards,
    creep=parameter("", "creep per metre driven", low=-0.2, high=0.2, typical=0.01),
    direction=parameter(
        "rad", "heading it creeps towards, in the truth frame", low=-6.29, high=6.29, typical=1.0, amplitude=False,
        trials=tuple(math.pi * i / 12 for i in range(12)),
    ),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class CastorKick(Effect):
    """f = (0, 0, angle v / way) while the castors swing round, 0 once they trail.

    The castors' state is the play operator on the robot's travel: after a reversal they swing round within `way`, which
    is two to four times the 10 to 50 mm by which they trail. The next reversal undoes the turn, so driving forth and
    back leaves none.
    """

    name = "castor_kick"
    odd = True
    initial = AT_REST
    summary = "castors swing round after each reversal and turn the robot"
    drives = PIVOTING
    about = About(
        equation="f_yaw = angle v / way within `way` after each reversal of the travel, 0 elsewhere",
        typical="0.5 to 3 degrees within 5 to 20 cm (an estimate: off-centre castors, a load on one side)",
        source="engineering judgement; the play operator, as in Visintin 1994, Differential Models of Hysteresis",
        confused_with=("backlash", "unequal_wheels"),
        drive="drive a metre forth and back, many times, with long straights between",
    )

    angle: float = parameter("rad", "turn left after a reversal to forwards", low=-0.3, high=0.3, typical=0.02)
    way: float = parameter(
        "m", "travel within which the castors swing round", low=0.01, high=0.5, typical=0.1, identity=0.1,
        amplitude=False, trials=(0.05, 0.1, 0.2),
    )  # fmt: skip

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: a turn in proportion to the travel during which the castors swing."""
        swing, after = crossed(motion.v * motion.dt_s, state, self.way)
        rate = np.divide(self.angle / self.way, motion.dt_s, out=np.zeros_like(swing), where=motion.dt_s > 0.0)
        return TwistError(stacked(0.0, 0.0, rate * swing, motion.v), after)
