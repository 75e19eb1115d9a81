"""A wheel-level simulator of recordings: an oracle that knows wheels, ground and clocks only.

The layers, each its own file and its own random streams::

    route -> motor -> gear -> tyres, grip, contact -> encoders + driver -> odometry
                                                  `-> tracker           -> truth

A cause is a change of the *machine* (a radius, a track, a tyre, a gyro, a clock, a marker); nothing in here knows how
such a change looks as an error of the odometry. That is what makes it a judge of those who claim to know.
"""

from odomcorrupt.simulation.bag import write_mcap
from odomcorrupt.simulation.commands import Commands, read_commands
from odomcorrupt.simulation.encoders import Rig
from odomcorrupt.simulation.faults import CAUSES, OUTSIDE
from odomcorrupt.simulation.record import SimulatedRun
from odomcorrupt.simulation.routes import ROUTES, Segment
from odomcorrupt.simulation.run import simulate, simulate_without
from odomcorrupt.simulation.tracker import TRACKERS, Tracker

__all__ = [
    "CAUSES",
    "OUTSIDE",
    "ROUTES",
    "TRACKERS",
    "Commands",
    "Rig",
    "Segment",
    "SimulatedRun",
    "Tracker",
    "read_commands",
    "simulate",
    "simulate_without",
    "write_mcap",
]
