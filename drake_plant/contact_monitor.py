"""What contact physics makes of a plan: slip, forces and contact coordinates, measured."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import ContactSurface, GeometryId
from pydrake.multibody.plant import ContactResults
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from contact_system import Plane, Scene, SceneError, Surface
from contact_system.scene import require_scene
from contact_system.scene.contact import rolled

from .config import require_config
from .contact_gauge import COLUMNS, NUMBERS, TINY, ContactGauges
from .lifetimes import NO_DICTIONARY, array_entry, weakly
from .plant import ScenePlant, declare_plant_inputs
from .pressing import contact_depth
from .scratch import PerThread

Array = NDArray[np.float64]

# Bodies planned on the radii that they roll on meet there. A plane has no radius: there it is where
# the planned finger's surface is.
AT_FINGER = 1.0
SIZES = {name: rows.stop - rows.start for name, rows in COLUMNS.items()} | {"sliding": 3}
NOISY = ("state", "sliding")
ANOTHER = 0.1
"""Of its size, by how much a body differs that is another one."""
SATURATED = 0.95
"""Friction counts as saturated from this part of mu N on: facets let N itself ripple."""
SLIDES = 0.7
"""Slip is fed back from this part on: "lagged" makes no more than 0.74 where a finger slides."""


class ContactMonitor(LeafSystem):
    """Contact results and motion of the bodies to what each contact does.

    .. pydrake_system::

        name: ContactMonitor
        input_ports:
        - contact_results
        - body_poses
        - body_spatial_velocities
        - noise (optional)
        output_ports:
        - state
        - slip
        - normal_force
        - tangential_force
        - contact_point
        - sliding

    The first three inputs are the plant's; `noise` (9n) is added to `state`, and so to `sliding`,
    which follows from it. Of a discrete plant slip and forces are those of the step that ended
    now, state and contact point are those now. Without sampled output ports Drake reports the step
    that begins instead: all are those of now, as in a continuous plant. Of the outputs, n contacts
    in the scene's order and SI units,

    * `state` (9n) holds u1 v1 du1 dv1 u2 v2 du2 dv2 psi in principal values, for the planner's
      `measured_state`; its rates fulfil ``R_psi M1 q1' - M2 q2' = v_rel`` with the measured slip;
    * `slip` (2n) is v_rel in E2, minus the velocity of the finger's material point relative to the
      object's (theory section 2);
    * `normal_force` (n) is positive where the bodies press;
    * `tangential_force` (2n) acts on the finger, in E2;
    * `contact_point` (3n) is where the line normal to both surfaces meets the object's, in O;
    * `sliding` (3n) is v_rel of `state` as a vector in O where the contact slides, which shows in
      its friction: at 85 % of mu N or more. Zero elsewhere, so that noise moves no finger that
      rolls. mu is that of the plant's configuration.

    Where a finger touches the object with several patches or pairs of points, forces are those of
    their sum, taken along and across the normal at its centre of pressure.
    Without contact the forces are 0 and the others are those of the points nearest to each other.
    Bodies are taken to move in a step with the velocity at its end, as free ones do. Slip of those
    that swing on joints is off by a step times their centripetal acceleration at most.
    Where there is no contact frame (such as at a pole) what needs one is NaN: a planner that
    restarts then keeps its plan.

    Parameters
    ----------
    scene : Scene
        Its surfaces measure the coordinates. In a closed loop it is the planner's scene, so that
        planner and monitor read the same slip from the same rates.
    scene_plant : ScenePlant
        Finalized; the bodies' frames are their surfaces' own.

    Raises
    ------
    SceneError
        No ScenePlant, or one of other surfaces, sizes or contacts than the scene.

    Attributes
    ----------
    measured : callable
        Of a Context, all that the ports say but for noise: (n, 17), `contact_gauge.COLUMNS`.
    """

    __slots__ = NO_DICTIONARY

    def __init__(self, scene: Scene, scene_plant: ScenePlant):
        super().__init__()
        require_scene(scene)
        require_config(scene_plant, ScenePlant, "scene_plant")
        n = len(scene.contacts)
        if not _alike(scene, scene_plant.scene, 2 * contact_depth(scene_plant.config)):
            raise SceneError(
                f"{scene.title} has other surfaces, sizes or contacts than scene_plant, of "
                f"{scene_plant.scene.title}: give the scene that it was made for, or rolling_scene "
                "of it"
            )
        self._scene, self._friction = scene, scene_plant.config.friction
        plant, fingers = scene_plant.plant, scene_plant.finger_bodies
        flat = isinstance(scene.object, Plane)
        self._at_finger = [
            flat and rolling.finger != nominal.finger
            for rolling, nominal in zip(scene.contacts, scene_plant.scene.contacts)
        ]
        self._object = int(scene_plant.object_body.index())
        self._fingers = [int(body.index()) for body in fingers]
        # Of two geometries the contact, and whether the first is the object's; a plant of
        # somebody's own may have other bodies that fingers touch. By number: a GeometryId of the
        # plant's would keep the plant.
        self._pairs: dict[tuple[int, int], tuple[int | None, bool]] = {}
        for i, body in enumerate(fingers):
            both = map(plant.GetCollisionGeometriesForBody, (body, scene_plant.object_body))
            for of_finger, of_object in itertools.product(*both):
                self._pairs[of_object.get_value(), of_finger.get_value()] = i, True
                self._pairs[of_finger.get_value(), of_object.get_value()] = i, False
        step = plant.time_step() if plant.has_sampled_output_ports() else 0.0
        self._gauges = PerThread(lambda: ContactGauges(scene, step), {})
        inputs = declare_plant_inputs(
            self, "contact_results", "body_poses", "body_spatial_velocities"
        )
        self._results, self._poses, self._velocities = inputs
        self._noise = self.DeclareVectorInputPort("noise", 9 * n)
        tickets = [port.ticket() for port in inputs]
        ticket, self.measured = array_entry(self._CalcMeasured, (n, NUMBERS), tickets)
        for name, size in SIZES.items():
            needs = {ticket, self._noise.ticket()} if name in NOISY else {ticket}
            calc = weakly(self._CalcVector, name)
            self.DeclareVectorOutputPort(name, size * n, calc, needs)

    def _CalcVector(self, name: str, context: Context, output: BasicVector) -> None:
        measured = self.measured(context)
        rows = measured[:, COLUMNS["state" if name in NOISY else name]]
        if name in NOISY and self._noise.HasValue(context):
            rows = rows + self._noise.Eval(context).reshape(-1, 9)
        if name == "sliding":
            rows = self._Sliding(measured, rows)
        output.SetFromVector(rows.ravel())

    def _Sliding(self, measured: Array, states: Array) -> Array:
        """v_rel in O of what slides, (n, 3), 0 of what does not."""
        normal = measured[:, COLUMNS["normal_force"]][:, 0]
        friction = np.hypot(*measured[:, COLUMNS["tangential_force"]].T)
        found, scene = np.zeros((len(measured), 3)), self._scene
        slides = (friction >= SLIDES * self._friction * normal) & (normal > 0)
        for i in np.flatnonzero(slides).tolist():
            found[i] = _slip(scene.contacts[i].finger, scene.object, states[i])
        return np.nan_to_num(found)  # no feedback at a pole

    def _CalcMeasured(self, context: Context) -> Array:
        X_W, V_W = self._poses.Eval(context), self._velocities.Eval(context)
        gauges = self._gauges.own
        gauges.look(X_W, V_W, self._object, self._fingers)
        self._Touch(gauges, self._results.Eval(context))
        return gauges.measure()

    def _Pair(self, first: GeometryId, second: GeometryId) -> tuple[int | None, bool]:
        return self._pairs.get((first.get_value(), second.get_value()), (None, False))

    def _Touch(self, gauges: ContactGauges, results: ContactResults) -> None:
        """Tell the gauges of all patches and points between fingers and object."""
        for k in range(results.num_hydroelastic_contacts()):
            info = results.hydroelastic_contact_info(k)
            patch = info.contact_surface()
            i, first = self._Pair(patch.id_M(), patch.id_N())
            if i is not None:
                share = _share_of_M(patch) if first else 1.0 - _share_of_M(patch)
                F_Ac_W = info.F_Ac_W().get_coeffs()  # body A has geometry M
                force = -F_Ac_W if first else F_Ac_W
                gauges.touch(i, share, share, patch.centroid(), force[3:], force[:3])
        for k in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(k)
            pair, p_WC, force = info.point_pair(), info.contact_point(), info.contact_force()
            i, first = self._Pair(pair.id_A, pair.id_B)
            if i is not None:
                # It acts midway in depth where both are equally stiff, else nearer to the stiffer's
                # surface; a depth may be 0, or rounding alone.
                off = math.dist(pair.p_WCa if first else pair.p_WCb, p_WC)
                share = AT_FINGER if self._at_finger[i] else min(1.0, off / max(pair.depth, TINY))
                gauges.touch(i, share, 0.0, p_WC, force if first else -force, 0.0)


def _alike(one: Scene, other: Scene, pressed: float) -> bool:
    """Whether two scenes have the same bodies, but for what contact presses in, m."""
    bodies = [(scene.object, *(c.finger for c in scene.contacts)) for scene in (one, other)]
    return len(bodies[0]) == len(bodies[1]) and all(
        type(a) is type(b) and abs(a.size - b.size) <= max(ANOTHER * b.size, pressed)
        for a, b in zip(*bodies)
    )


def _slip(finger: Surface, obj: Surface, state: Array) -> Array:
    """v_rel (eq. `netrelvel`) of the state of a contact (9,) as a vector in O, m/s."""
    u1, v1, *rates_1, u2, v2, du2, dv2, psi = state
    a1, a2 = finger.metric_root(u1, v1) @ rates_1, obj.metric_root(u2, v2) @ (du2, dv2)
    return obj.frame(u2, v2)[:, :2] @ (rolled(psi, a1) - a2)


def _share_of_M(patch: ContactSurface) -> float:
    """How much of the depth geometry M gives way, 0 where it is rigid.

    From each surface to the patch pressure grows by that body's gradient, to the same at the patch.
    """
    if not patch.HasGradE_M():
        return 0.0
    if not patch.HasGradE_N():
        return 1.0
    face = patch.num_faces() // 2  # any
    in_M, in_N = (math.hypot(*g(face)) for g in (patch.EvaluateGradE_M_W, patch.EvaluateGradE_N_W))
    return in_N / (in_M + in_N)
