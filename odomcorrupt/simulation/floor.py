"""The floor: where it is level, even and dry, and where it is not. Places and directions are the truth frame's."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Disc:
    """A round patch, m."""

    x_m: float
    y_m: float
    radius_m: float

    def holds(self, place: complex) -> bool:
        """Tell whether a point (x + iy, m) lies in it."""
        return abs(place - complex(self.x_m, self.y_m)) < self.radius_m


@dataclass(frozen=True, slots=True)
class Strip:
    """A band without ends, as wide as twice `half_m`, whose middle line runs in `direction_rad` through (x, y)."""

    x_m: float
    y_m: float
    direction_rad: float
    half_m: float

    def holds(self, place: complex) -> bool:
        """Tell whether a point (x + iy, m) lies in it."""
        along = (place - complex(self.x_m, self.y_m)) * np.exp(-1j * self.direction_rad)
        return bool(abs(along.imag) < self.half_m)


@dataclass(frozen=True, slots=True)
class Slippery:
    """A place where the part `slip` of the way rolled is lost: by each wheel that is in it, or by the whole axle."""

    place: Disc | Strip
    slip: float
    by_wheel: bool
    """Whether each wheel is asked where it is; else the middle of the axle speaks for both."""


@dataclass(frozen=True, slots=True)
class Bursts:
    """Short losses of grip: how many per second, the mean part of the way lost, and how long, s."""

    rate_hz: float
    slip: float
    duration_s: float


@dataclass(frozen=True, slots=True)
class Floor:
    """What the wheels roll on; the default is level, dry and the same everywhere."""

    slippery: tuple[Slippery, ...] = ()
    bursts: tuple[Bursts, ...] = ()
    downhill: tuple[complex, ...] = ()
    """Creep per metre rolled, as vectors x + iy: a tyre pulled aside yields only while it rolls."""
    grain: float = 0.0
    """Sideways creep per metre rolled at 45 degrees to the carpet's ribs: wheels prefer to roll along them."""
    grain_from_rad: float = 0.0
    """Direction of the ribs."""
    uneven: tuple[tuple[float, float], ...] = ()
    """Random wander of the way made per metre rolled: (sigma, correlation time in s)."""
    jolts_inverse_dof: float = 0.0
    """How heavy the tails of the random creep are: 1 / degrees of freedom of Student's t."""
    grip_mps: float = np.inf
    """Rim speed above which the floor no longer holds a wheel."""
    grip_slip: float = 0.0
    """Part of the way lost above `grip_mps`."""
    braking_mps2: float = np.inf
    """Deceleration above which a braking wheel is dragged."""
    braking_slip: float = 0.0
    """Part of the way gained while dragged."""
