"""Set-ups of `truth_exact` in MuJoCo, with its own primitives and collision detection."""

from __future__ import annotations

import math
import time
from typing import Any, NamedTuple

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

import contact_system as cs

from .truth_exact import INERTIA, MASS, RADIUS, Drive, Ended, Setup, setups

VERSION = f"MuJoCo {mujoco.__version__}"
SETTLING = 0.5
"""s, in which a ball at rest that is pressed sinks in to its depth."""


class Method(NamedTuple):
    """Attributes of MuJoCo's ``option``, and how stiff contact is: time constant over the step."""

    name: str
    options: dict[str, Any]
    stiff: float | None = 2.0  # None: the default, 0.02 s


ELLIPTIC = {"cone": "elliptic"}
STICKY = ELLIPTIC | {"impratio": 100}
METHODS = [
    Method("as it comes: pyramid, Newton, 20 ms", {}, None),
    Method("pyramid, Newton", {}),
    Method("elliptic, Newton", ELLIPTIC),
    Method("elliptic, Newton, impratio 100", STICKY),
    Method("elliptic, Newton, noslip 3", ELLIPTIC | {"noslip_iterations": 3}),
    Method("elliptic, CG", ELLIPTIC | {"solver": "CG"}),
    Method("elliptic, PGS", ELLIPTIC | {"solver": "PGS"}),
    Method("elliptic, Newton, impratio 100, discrete", STICKY | {"integrator": "discrete"}),
    Method("elliptic, Newton, impratio 100, RK4", STICKY | {"integrator": "RK4"}),
]


def run(name: str, method: Method, step: float, limit: float = math.inf) -> Ended:
    """Simulate a set-up by a method, with a step; runs are so short that ``limit`` is not used."""
    depth = _depth(setups()[name], method, step)
    setup = setups(depth / 2, depth / 2)[name]
    model, data = _start(setup, method, step, still=False)
    steps = round(setup.end / step)
    begin = time.thread_time()
    _advance(setup, model, data, steps)
    spent = time.thread_time() - begin
    turned = Rotation.from_quat(data.qpos[-4:], scalar_first=True)
    return Ended(setup, steps * step, data.qpos[-7:-4], data.qvel[-6:-3], turned, spent)


def _advance(setup: Setup, model: mujoco.MjModel, data: mujoco.MjData, steps: int) -> None:
    if not setup.guide:
        mujoco.mj_step(model, data, steps)
        return
    drive, h = Drive(setup, model.opt.timestep), model.opt.timestep
    ball = model.nbody - 1
    matrix = np.zeros(9)
    for k in range(steps):
        mujoco.mju_quat2Mat(matrix, data.qpos[3:])
        turned = matrix.reshape(3, 3)
        v, w = data.qvel[:3], turned @ data.qvel[3:]
        wrench = drive(k * h, data.qpos[:3], v, turned, w)
        data.xfrc_applied[ball] = np.roll(wrench, 3)
        mujoco.mj_step(model, data)


def _depth(setup: Setup, method: Method, step: float) -> float:
    """How deep the normal force presses the ball into the surface, m."""
    model, data = _start(setup, method, step, still=True)
    normal = setup.motion(np.zeros(1)).normal[0]
    at = data.qpos[-7:-4].copy()
    data.xfrc_applied[-1, :3] = -setup.pressed * normal
    model.opt.gravity[:] = 0.0
    mujoco.mj_step(model, data, round(SETTLING / step))
    return float((at - data.qpos[-7:-4]) @ normal)


def _start(
    setup: Setup, method: Method, step: float, still: bool
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Model and data at the start of the set-up, moving or ``still``."""
    model = mujoco.MjModel.from_xml_string(_xml(setup, method, step))
    data = mujoco.MjData(model)
    start = setup.motion(np.zeros(1))
    turned = start.turned[0]
    data.qpos[-7:] = [*start.x[0], *turned.as_quat(scalar_first=True)]
    if not still:
        data.qvel[-6:] = [*start.v[0], *turned.inv().apply(start.w[0])]
        if setup.table:
            data.qvel[0] = setup.table
    return model, data


def _xml(setup: Setup, method: Method, step: float) -> str:
    """Bodies of nominal size. The table is as heavy as the solvers bear: at 1e6 kg m^2 Newton's and
    CG's tolerances let the ball slip, at 100 the ball turns the table by a millionth."""
    surface = setup.scene.object
    if isinstance(surface, cs.Plane):
        shape = 'type="plane" size="0 0 1"'
    elif isinstance(surface, cs.Sphere):
        shape = f'type="sphere" size="{surface.radius}"'
    else:
        shape = f'type="ellipsoid" size="{surface.a} {surface.b} {surface.c}"'
    table = f"<geom {shape}/>"  # condim 3: neither rolling nor torsional friction
    if setup.table:
        still = '<inertial pos="0 0 0" mass="1" diaginertia="100 100 100"/>'
        shape = 'type="cylinder" size="2 0.1" pos="0 0 -0.1"'
        table = f'<body>{still}<joint type="hinge" axis="0 0 1"/><geom {shape}/></body>'
    reference = 0.02 if method.stiff is None else method.stiff * step
    options = {"timestep": step, "gravity": " ".join(map(str, setup.gravity))} | method.options
    attributes = " ".join(f'{key}="{value}"' for key, value in options.items())
    inertia = " ".join([str(INERTIA)] * 3)
    return f"""<mujoco><option {attributes}/>
      <default><geom solref="{reference} 1" friction="{setup.friction} 0 0" condim="3"/></default>
      <worldbody>{table}
        <body><freejoint/><inertial pos="0 0 0" mass="{MASS}" diaginertia="{inertia}"/>
          <geom type="sphere" size="{RADIUS}"/></body>
      </worldbody></mujoco>"""
