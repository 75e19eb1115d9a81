"""The machine and the floor under it: nominal and true dimensions, sensors, tyres; patches, slopes and grip."""

from dataclasses import dataclass, field, replace

import numpy as np


@dataclass(frozen=True, slots=True)
class Disc:
    """A round patch, m."""

    x_m: float
    y_m: float
    radius_m: float

    def holds(self, place: complex) -> bool:
        """Return whether a point (x + iy, m) is inside."""
        return abs(place - complex(self.x_m, self.y_m)) < self.radius_m


@dataclass(frozen=True, slots=True)
class Strip:
    """An infinite strip of width 2 `half_m`, whose centre line has direction `direction_rad` through (x, y)."""

    x_m: float
    y_m: float
    direction_rad: float
    half_m: float

    def holds(self, place: complex) -> bool:
        """Return whether a point (x + iy, m) is inside."""
        along = (place - complex(self.x_m, self.y_m)) * np.exp(-1j * self.direction_rad)
        return bool(abs(along.imag) < self.half_m)


@dataclass(frozen=True, slots=True)
class Slippery:
    """A place where the fraction `slip` of the travel is lost, by each wheel inside or by the whole axle."""

    place: Disc | Strip
    slip: float
    by_wheel: bool
    """Whether each wheel slips by its own position; otherwise both slip by that of the axle's middle."""


@dataclass(frozen=True, slots=True)
class Bursts:
    """Short losses of grip: rate (1/s), mean fraction of the travel lost, and duration (s)."""

    rate_hz: float
    slip: float
    duration_s: float


@dataclass(frozen=True, slots=True)
class Floor:
    """The floor; the default is level, dry and uniform."""

    slippery: tuple[Slippery, ...] = ()
    bursts: tuple[Bursts, ...] = ()
    downhill: tuple[complex, ...] = ()
    """Creep per metre rolled, as vectors x + iy: a tyre yields sideways only while it rolls."""
    grain: float = 0.0
    """Sideways creep per metre rolled at 45 degrees to the carpet's ribs: wheels tend to roll along them."""
    grain_from_rad: float = 0.0
    """Direction of the ribs."""
    uneven: tuple[tuple[float, float], ...] = ()
    """Gauss-Markov variation of the travel per metre rolled: (sigma, correlation time in s)."""
    jolts_inverse_dof: float = 0.0
    """Weight of the tails of the random creep: 1 / degrees of freedom of Student's t."""
    grip_mps: float = np.inf
    """Rim speed above which a wheel loses grip."""
    grip_slip: float = 0.0
    """Fraction of the travel lost above `grip_mps`."""
    braking_mps2: float = np.inf
    """Deceleration above which a braking wheel slides."""
    braking_slip: float = 0.0
    """Fraction of the travel gained while sliding."""


DRIVE_TYPES = ("differential", "skid")


@dataclass(frozen=True, slots=True)
class Robot:
    """A machine with one driven wheel, or row of wheels, on each side; its odometry uses the nominal dimensions only.

    New physics is a new field that has no effect at its default, read by its layer of the simulator.
    """

    nominal_radius_m: float
    nominal_track_m: float
    motor_lag_s: float
    travel_noise_m_per_sqrt_m: float
    radius_right_m: float
    radius_left_m: float
    track_m: float
    scrub_arm_m: float = 0.0
    """Sideways travel of the tread per radian of turn: wheels in rows scrub, and creep at random as a result."""

    # tyres
    lateral_creep_s: float = 0.0
    """Mass over lateral creep coefficient of the tyres (N per m/s of sideways speed); 0 for a rigid tyre."""
    traction_s2_per_m: float = 0.0
    """Mass over longitudinal slip stiffness (N per unit of slip ratio); 0 for a rigid tyre."""
    growth_s_per_m: float = 0.0
    """Relative growth of a wheel's radius per m/s of rim speed."""
    warming_per_s: float = 0.0
    """Relative growth of both radii per second since the start."""
    eccentricity: float = 0.0
    """Distance of the right axle from the middle of its wheel, over the radius."""
    eccentric_from_rad: float = 0.0
    load_shift_s: float = np.inf
    """Time at which the load slides to one side, s after the start."""
    load_squeeze: float = 0.0
    """Relative loss of the right radius from that time on (and gain of the left)."""

    # turning of the body
    rotation_centre_behind_m: float = 0.0
    """Distance of the centre of rotation behind the base frame."""
    lean: float = 0.0
    """Relative loss of effective track in left turns, and gain in right ones (contact patches move under the load)."""
    scrub_s: float = 0.0
    """Relative growth of the effective track per rad/s of turn rate."""
    play_of_track: tuple[tuple[float, float], ...] = ()
    """Gauss-Markov variation of the effective track: (sigma, correlation time in s)."""
    play_of_rims: tuple[tuple[float, float], ...] = ()
    """Gauss-Markov turn per way driven: (sigma in rad/m, correlation time in s)."""

    # gear, encoders and heading sensor
    gear_play_m: float = 0.0
    """Play between motor (with the encoder) and wheel, at the rim."""
    tick_travel_m: float = 0.0
    """Travel per tick at the rim, instead of the rig's resolution."""
    lost_cycles: float = 0.0
    """Fraction of the driver's cycles whose ticks (and turn) are lost in transmission."""
    gyro_bias_radps: float = 0.0
    gyro_scale: float = 0.0
    gyro_walk_radps_per_sqrt_s: float = 0.0
    hard_iron_rad: float = 0.0
    """Amplitude of the compass error of a heading sensor with a magnetometer."""
    hard_iron_from_rad: float = 0.0
    """World heading at which this error crosses zero upwards."""

    # tracked marker, and clocks
    marker_xyt: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Pose of the tracked frame in the base frame; m, m, rad."""
    odom_clock_offset_s: float = 0.0
    odom_clock_rate: float = 0.0
    """Odometry clock's seconds per true second, minus 1."""

    floor: Floor = field(default_factory=Floor)
    """Floor under the robot."""


def build_robot(rng: np.random.Generator, drive_type: str = "differential") -> Robot:
    """Return a random robot without faults: its true wheels and track are the nominal ones.

    The nominal track of a skid-steered robot is its effective one, larger than the distance of its wheels; its tread
    is still dragged in turns.

    drive_type : "differential" or "skid": one wheel on each side and castors, or a row of wheels on each side
    """
    radius_m = round(rng.uniform(0.07, 0.12), 3)
    track_m = round(rng.uniform(0.32, 0.5), 3)
    robot = Robot(
        nominal_radius_m=radius_m,
        nominal_track_m=track_m,
        motor_lag_s=rng.uniform(0.06, 0.15),
        travel_noise_m_per_sqrt_m=rng.uniform(0.001, 0.003),
        radius_right_m=radius_m,
        radius_left_m=radius_m,
        track_m=track_m,
    )
    if drive_type == "differential":
        return robot
    wider_m = round(track_m * rng.uniform(1.3, 2.0), 3)
    return replace(robot, nominal_track_m=wider_m, track_m=wider_m, scrub_arm_m=rng.uniform(0.1, 0.25))
