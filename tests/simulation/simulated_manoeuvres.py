"""Drives so simple that the right answer needs no model, recorded without any noise, and how to look at them."""

import dataclasses

import numpy as np

from odomcorrupt.simulation import Rig, Segment, Tracker, simulate

FLAWLESS_RIG = Rig(
    sampling_jitter_s=0.0,
    stamp_jitter_s=0.0,
    ticks_per_turn=None,
    gyro_noise_rad_per_sqrt_s=0.0,
    motor_ripple=0.0,
    creep=0.0,
)
FLAWLESS_TRACKER = Tracker(sampling_jitter_s=0.0, noise_m=0.0, noise_rad=0.0, dropouts_per_min=0.0)
REST = Segment(0.0, 0.0, 1.0, 1.0)
STRAIGHT = (REST, Segment(0.5, 0.0, 19.0), Segment(0.0, 0.0, 5.0))
SPIN_LEFT = (REST, Segment(0.0, 0.8, 19.0), Segment(0.0, 0.0, 5.0))
CIRCLE_LEFT = (REST, Segment(0.6, 0.5, 40.0))
CIRCLE_RIGHT = (REST, Segment(0.6, -0.5, 40.0))


def silent(cause, parameters, route, duration_s=28.0, seed=5, **options):
    return simulate(
        seed, cause, parameters=parameters, route=route, duration_s=duration_s, rig=FLAWLESS_RIG,
        truth=FLAWLESS_TRACKER, **options,
    )  # fmt: skip


def from_start(stamps_ns, xyt, at_ns):
    """Poses at other stamps, headings unwrapped, as seen from the first of them."""
    seen = [np.interp(at_ns, stamps_ns, column) for column in (xyt[:, 0], xyt[:, 1], np.unwrap(xyt[:, 2]))]
    place = (seen[0] - seen[0][0] + 1j * (seen[1] - seen[1][0])) * np.exp(-1j * seen[2][0])
    return np.column_stack((place.real, place.imag, seen[2] - seen[2][0]))


def both(run):
    """Odometry and truth at the odometry's stamps, each from its own start."""
    at_ns = run.odom_stamps_ns[(run.odom_stamps_ns > run.truth_stamps_ns[0])]
    at_ns = at_ns[at_ns < run.truth_stamps_ns[-1]]
    return from_start(run.odom_stamps_ns, run.odom_xyt, at_ns), from_start(run.truth_stamps_ns, run.truth_xyt, at_ns)


def way_m(xyt):
    return np.hypot(*np.diff(xyt[:, :2], axis=0).T).sum()


def same(one, other):
    return all(np.array_equal(getattr(one, f.name), getattr(other, f.name)) for f in dataclasses.fields(one))
