"""The body: a box on two wheels and a castor, and what its wheels truly measure once it stands."""

from dataclasses import dataclass, replace

import mujoco
import numpy as np

RADIUS_M, TRACK_M = 0.1, 0.4
STEP_S = 0.001
ROUNDS = 4

# a castor that drags makes the body nod; one that hardly drags does not
XML = """
<mujoco>
  <option timestep="{step}" integrator="Euler" cone="elliptic" impratio="20" gravity="{gravity}"/>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" friction="0.9 0.005 0.0001" condim="3"/>
    <body name="base" pos="0 0 {height}">
      <freejoint/>
      <geom type="box" size="0.2 0.12 0.05" pos="-0.03 0 0" mass="11" contype="0" conaffinity="0"/>
      <geom name="castor" type="sphere" size="0.03" pos="-0.2 0 {castor_z}" mass="0.1" condim="3"
            priority="1" friction="0.003 0.005 0.0001" solref="0.004 1"/>
      <body name="load" pos="-0.03 {load_y} 0.1">
        <geom type="box" size="0.05 0.05 0.05" mass="0.001" contype="0" conaffinity="0"/>
      </body>
      {wheels}
    </body>
  </worldbody>
  <actuator>
    <velocity joint="right" kv="2"/>
    <velocity joint="left" kv="2"/>
  </actuator>
</mujoco>
"""

# a thin ellipsoid touches the floor in one point, half the track from the middle
WHEEL = """
      <body name="{name}" pos="0 {y} 0">
        <joint name="{name}" type="hinge" axis="0 1 0" armature="0.01"/>
        <geom name="{name}" type="ellipsoid" size="{size} 0.012 {size}" mass="0.5" condim="3" priority="2"
              friction="0.9 0.005 0.0001" solref="{solref} 1" solimp="0.98 0.98 0.001"/>
      </body>"""


@dataclass(frozen=True, slots=True)
class Body:
    """What is built: the radii on which the wheels shall roll when the unladen body stands, and the rest.

    Attributes
    ----------
    radius_right_m, radius_left_m : float
        Rolling radii, m.
    track_m : float
        Distance of the contact points, m.
    softness_s : float
        Time constant of the tyres' contact, s; the standing tyre gives as its square.
    load_kg, load_y_m : float
        Mass put on, and how far to the left, once the tyres are what they are.
    gravity : tuple of float
        In the world, m/s^2: a tilted floor is a tilted gravity.
    patch : tuple of float or None
        x, y, radius (m, from the start) and friction of a slippery place.
    """

    radius_right_m: float = RADIUS_M
    radius_left_m: float = RADIUS_M
    track_m: float = TRACK_M
    softness_s: float = 0.004
    load_kg: float = 0.0
    load_y_m: float = 0.0
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    patch: tuple[float, float, float, float] | None = None


@dataclass(frozen=True, slots=True)
class Standing:
    """A compiled body at rest on its wheels, and the radii (right, left) on which these roll, m."""

    model: mujoco.MjModel
    data: mujoco.MjData
    rolling_m: np.ndarray


def build(body: Body) -> Standing:
    """Compile a body whose standing wheels roll on the wanted radii, then put its load on.

    Contact acts half-way into the overlap, so a wheel rolls on the mean of its size and its axle's height. The size
    is found by letting the unladen, level body stand.
    """
    wanted = np.array([body.radius_right_m, body.radius_left_m])
    sizes = wanted
    for _ in range(ROUNDS):
        standing = _stand(replace(body, load_kg=0.0, gravity=(0.0, 0.0, -9.81)), sizes)
        sizes = sizes + wanted - standing.rolling_m
    return _stand(body, sizes)


def _stand(body: Body, sizes: np.ndarray) -> Standing:
    sides = (("right", -0.5 * body.track_m), ("left", 0.5 * body.track_m))
    wheels = "".join(
        WHEEL.format(name=name, y=y, size=size, solref=body.softness_s)
        for (name, y), size in zip(sides, sizes, strict=True)
    )
    text = XML.format(
        step=STEP_S,
        gravity=" ".join(map(str, body.gravity)),
        height=sizes.mean(),
        castor_z=0.03 - RADIUS_M,
        load_y=body.load_y_m,
        wheels=wheels,
    )
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    if body.load_kg > 0.0:
        _put_on(model, data, body.load_kg)
    mujoco.mj_step(model, data, nstep=600)
    heights = np.array([data.body(name).xpos[2] for name, _ in sides])
    return Standing(model, data, 0.5 * (sizes + heights))


def _put_on(model: mujoco.MjModel, data: mujoco.MjData, load_kg: float) -> None:
    """Make the load heavy without making the tyres stiffer: these are tuned to the mass at compile time."""
    load = model.body("load").id
    of_bodies, of_joints = model.body_invweight0.copy(), model.dof_invweight0.copy()
    model.body_inertia[load] *= load_kg / model.body_mass[load]
    model.body_mass[load] = load_kg
    mujoco.mj_setConst(model, data)
    model.body_invweight0[:], model.dof_invweight0[:] = of_bodies, of_joints
