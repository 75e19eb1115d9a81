"""Wheel-level simulator of recordings with known faults, independent of the effects library.

The layers, each with a file and random streams of its own::

    route -> motor -> gear -> tyres, grip, contact -> encoders + driver -> odometry
                                                  `-> tracker           -> truth

A fault is a change of the *machine* (a radius, a track, a tyre, a gyro, a clock, a marker). The simulator contains no
formula for the resulting odometry error, so it is an independent test of the diagnosis.
"""

from odomcorrupt.simulation.faults import CAUSES, OUTSIDE
from odomcorrupt.simulation.routes import ROUTES, Commands, Segment, read_commands
from odomcorrupt.simulation.run import SimulatedRun, simulate, simulate_without, write_mcap
from odomcorrupt.simulation.sensors import TRACKERS, Rig, Tracker

__all__ = ["CAUSES", "OUTSIDE", "ROUTES", "TRACKERS", "Commands", "Rig", "Segment", "SimulatedRun", "Tracker",
           "read_commands", "simulate", "simulate_without", "write_mcap"]  # fmt: skip
