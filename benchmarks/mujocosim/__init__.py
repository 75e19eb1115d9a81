"""A second judge: a rigid body with wheels in MuJoCo, where contact does what contact does.

Wheels carry the body by contact forces alone; the encoders, the driver and the tracker are the wheel-level
simulator's, and so is the record. A cause is a change of the body or its floor before the first step.
"""

from mujocosim.body import Body, build
from mujocosim.causes import CAUSES
from mujocosim.run import simulate_body

__all__ = ["CAUSES", "Body", "build", "simulate_body"]
