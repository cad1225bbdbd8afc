r"""Measure what contacts do in a simulation: slip, forces and contact coordinates.

Slip depends on the point of a hydroelastic patch at which the velocities of the bodies are
compared: a fingertip that spins at 35 rad/s changes its tangential velocity by 0.35 mm/s every 10
um along the normal. The right point is the one where slip is zero when friction is, as while a
finger rolls. Friction acts on every face of the patch, along that face. The edge of a curved patch
lies lower than its middle, which changes the velocity there, and its faces are tilted, which
changes it back. So the mean of the faces' slip, each along its own face, is the slip at the
object's surface above the middle of the patch (exactly on spheres; else it differs by spin times
depth/6 times the difference of k2/(k1 + k2) between the principal directions, where k1 and k2 are
the bodies' curvatures). Slip measured at zero friction [mm/s], for spheres of 0.04 and 0.1 m,
0.2 mm deep, 58 faces, spin 35 rad/s, steps of 0.1 ms, in 30 random orientations:

==========================================  ===============
at the centroid of area                     -0.90 +- 0.13
at the centre of pressure                   -0.65 +- 0.13
at the object's surface                     +0.09 +- 0.13
mean over faces, each along itself          +0.06 +- 0.13
==========================================  ===============

so velocities are compared at the object's surface: that needs no face, only the poses of the two
bodies. What remains is due to the facets of the meshes. If the object of a user's plant is
compliant too, the patch lies between the two surfaces, as their stiffnesses divide the depth, and
slip is taken there.

A discrete step solves for the forces at the place to which it moves the bodies. In fast rolling
this is further along the curve than the patch from which the step starts (1 mm at 1 m/s and 1 ms),
and the normal differs: with the patch's own normal, 10 mN of a normal force of 1 N would count as
friction. So the normal is taken at the centre of pressure, which follows from the torque of the
contact force. Slip is taken at the poses from which the step starts, as the solver makes contacts
stick or slide there. At the poses of the step's end the same velocities would be up to 8 mm/s of
slip in D3, whose object turns, where Drake's own point contact has 1e-4 mm/s.
"""

from __future__ import annotations

import itertools
import math
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
from pydrake.geometry import ContactSurface, GeometryId
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from contact_system import Plane, Scene, Surface
from contact_system.checks import Array, of_kind
from contact_system.contact_sensor import GAP, ON_FINGER, ON_OBJECT, SLIP, STATES, probes_of
from contact_system.scene import require_scene
from contact_system.scene.contact import rolled
from contact_system.theory import symbols as ca
from contact_system.theory.lowering import Table
from contact_system.theory.symbols import per_structure

from .lifetimes import NO_DICTIONARY, array_entry, weakly
from .plant import MOTIONS, ScenePlant, declare_plant_inputs
from .pressing import require_alike
from .tables import FingerTables, named, per_thread, slices

TINY = sys.float_info.min
TOLERANCE = 1e-7
"""Error of contact points that probes find, over the size of the bodies."""
MEASURED = {"slip": 2, "normal_force": 1, "tangential_force": 2, "state": 9, "contact_point": 3}
"""Numbers of each contact; the first three are those of the step that ended now."""
COLUMNS = slices(MEASURED)
MOTION_INPUTS = {"X_WO": 12, "V_WO": 6, "A_WO": 6, "X_WF": 12, "V_WF": 6, "A_WF": 6}
MOTION_INPUTS |= {"point": 3, "force": 3, "torque": 3}
"""What Drake tells of a contact, in the world: motion of both bodies, the point C where the contact
force on the finger acts, this force, and its torque about C."""
THEN, IN_F, IN_O, LOAD, NOW = slice(18), slice(18, 21), slice(21, 24), slice(21, 30), slice(30, 48)
"""Columns of the results of `_motion`; LOAD: C, force and torque in O."""
FORCE_INPUTS = {"at": 3, "E2": 9, "K2": 4, "K1": 4, "gap": 1}
FORCE_INPUTS |= {"point": 3, "force": 3, "torque": 3, "k_share": 1}
"""What the forces of a contact follow from, in O where the step began: the probe's results from the
object's point on; C, force and torque as in `MOTION_INPUTS`; which part of the patch's curvature
is the finger's."""
NOISY = ("state", "sliding")
SATURATED = 0.95
"""Friction counts as saturated from this part of mu N on, as facets make N itself ripple."""
SLIDES = 0.7
"""A contact counts as sliding from this part of mu N on: "lagged" makes as little as 0.74 of it."""


class ContactMonitor(LeafSystem):
    """Measures each contact from a plant's contact results and the motion of the bodies.

    .. pydrake_system::

        name: ContactMonitor
        input_ports:
        - contact_results
        - body_poses
        - body_spatial_velocities
        - body_spatial_accelerations (optional)
        - noise (optional)
        output_ports:
        - slip
        - normal_force
        - tangential_force
        - state
        - contact_point
        - sliding

    The first four inputs are the plant's; `noise` (9n) is added to `state`, and so to `sliding`,
    which follows from it. With a discrete plant slip and forces are those of the step that has just
    ended, state and contact point those of now. Without sampled output ports Drake reports the step
    that begins instead: then all are those of now, as with a continuous plant. Without the plant's
    accelerations, rates of the state are those of half a step ago, as a discrete plant's velocities
    are. The outputs, for n contacts in the scene's order, in SI units:

    * `state` (9n) holds u1 v1 du1 dv1 u2 v2 du2 dv2 psi in principal values, for the planner's
      `measured_state`; its rates fulfil ``R_psi M1 q1' - M2 q2' = v_rel``, the slip at their time;
    * `slip` (2n) is v_rel in E2: the velocity of the finger's material point relative to the
      object's is -v_rel (theory section 2);
    * `normal_force` (n) is positive where the bodies press;
    * `tangential_force` (2n) acts on the finger, in E2;
    * `contact_point` (3n) is where the line normal to both surfaces meets the object's, in O;
    * `sliding` (3n) is v_rel of `state` as a vector in O if the contact slides, that is if friction
      is 70 % of mu N or more; else zero, so that noise does not move a finger that rolls. mu is
      that of the plant's configuration.

    If a finger touches the object with several patches or pairs of points, the forces are those of
    their sum, taken along and across the normal at its centre of pressure. Without contact they are
    0, and the other outputs are those of the two nearest points of the bodies.
    Bodies are taken to move in a step with the velocity at its end, as free ones do. For bodies
    that swing on joints the error of slip is at most a step times their centripetal acceleration.
    Where there is no contact frame (such as at a pole), outputs that need one are NaN: a planner
    that restarts then keeps its plan.

    Parameters
    ----------
    scene : Scene
        The contact coordinates are those of its surfaces. In a closed loop give the planner's
        scene, so that planner and monitor mean the same slip by the same rates.
    scene_plant : ScenePlant
        Finalized; the bodies' frames are those of their surfaces.

    Raises
    ------
    SceneError
        Not a ScenePlant, or one with other surfaces, sizes or contacts than the scene.

    Attributes
    ----------
    measured : callable
        A function of a Context: all outputs without noise, (n, 17), by columns as in `COLUMNS`.
    """

    __slots__ = NO_DICTIONARY

    def __init__(self, scene: Scene, scene_plant: ScenePlant):
        super().__init__()
        require_scene(scene)
        of_kind(ScenePlant, scene_plant, "scene_plant", "a ScenePlant")
        n = len(scene.contacts)
        require_alike(scene, scene_plant.scene, scene_plant.config, "monitor")
        self._scene, self._friction = scene, scene_plant.config.friction
        plant, fingers = scene_plant.plant, scene_plant.finger_bodies
        # Slip in point contact is taken where the surfaces that bodies roll on meet. A plane is not
        # offset, so there that is at the planned finger's surface.
        flat = isinstance(scene.object, Plane)
        self._at_finger = [
            flat and rolling.finger != nominal.finger
            for rolling, nominal in zip(scene.contacts, scene_plant.scene.contacts)
        ]
        self._object = int(scene_plant.object_body.index())
        self._fingers = [int(body.index()) for body in fingers]
        # For two geometries their contact, and whether the first is the object's; others in a
        # user's plant do not count. Keys are numbers, as GeometryIds would keep the plant alive.
        self._pairs: dict[tuple[int, int], tuple[int | None, bool]] = {}
        for i, body in enumerate(fingers):
            both = map(plant.GetCollisionGeometriesForBody, (body, scene_plant.object_body))
            for of_finger, of_object in itertools.product(*both):
                self._pairs[of_object.get_value(), of_finger.get_value()] = i, True
                self._pairs[of_finger.get_value(), of_object.get_value()] = i, False
        step = plant.time_step() if plant.has_sampled_output_ports() else 0.0
        self._gauges = per_thread(lambda: ContactGauges(scene, step))
        names = "contact_results", *MOTIONS, "body_spatial_accelerations"
        inputs = declare_plant_inputs(self, plant, *names)
        self._results, self._poses, self._velocities, self._accelerations = inputs
        self._noise = self.DeclareVectorInputPort("noise", 9 * n)
        tickets = [port.ticket() for port in inputs]
        shape = n, sum(MEASURED.values())
        ticket, self.measured = array_entry(self._CalcMeasured, shape, tickets)
        for name, size in (MEASURED | {"sliding": 3}).items():
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
        """v_rel in O of contacts that slide, 0 of others, (n, 3), m/s."""
        normal = measured[:, COLUMNS["normal_force"]][:, 0]
        friction = np.hypot(*measured[:, COLUMNS["tangential_force"]].T)
        found, scene = np.zeros((len(measured), 3)), self._scene
        slides = (friction >= SLIDES * self._friction * normal) & (normal > 0)
        for i in np.flatnonzero(slides).tolist():
            found[i] = _slip(scene.contacts[i].finger, scene.object, states[i])
        return np.nan_to_num(found)  # no feedback at a pole

    def _Pair(self, first: GeometryId, second: GeometryId) -> tuple[int | None, bool]:
        return self._pairs.get((first.get_value(), second.get_value()), (None, False))

    def _CalcMeasured(self, context: Context) -> Array:
        results, pressing = self._results.Eval(context), [list[Any]() for _ in self._fingers]
        for k in range(results.num_hydroelastic_contacts()):
            info = results.hydroelastic_contact_info(k)
            patch = info.contact_surface()
            i, first = self._Pair(patch.id_M(), patch.id_N())
            if i is not None:
                share = _share_of_M(patch) if first else 1.0 - _share_of_M(patch)
                F_Ac_W = info.F_Ac_W().get_coeffs()  # body A has geometry M
                force = -F_Ac_W if first else F_Ac_W
                pressing[i].append(((share, share), patch.centroid(), force[3:], force[:3]))
        for k in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(k)
            pair, p_WC, force = info.point_pair(), info.contact_point(), info.contact_force()
            i, first = self._Pair(pair.id_A, pair.id_B)
            if i is not None:
                # If both are equally stiff the force acts at half of the depth, else nearer to the
                # stiffer one's surface. The depth may be 0 or negative by rounding.
                off = math.dist(pair.p_WCa if first else pair.p_WCb, p_WC)
                share = 1.0 if self._at_finger[i] else min(1.0, off / max(pair.depth, TINY))
                force = force if first else -force
                pressing[i].append(((share, 0.0), p_WC, force, np.zeros(3)))
        X_W, V_W = self._poses.Eval(context), self._velocities.Eval(context)
        A_W = self._accelerations.Eval(context) if self._accelerations.HasValue(context) else None
        return self._gauges().measure(X_W, V_W, A_W, self._object, self._fingers, pressing)


def _slip(finger: Surface, obj: Surface, state: Array) -> Array:
    """v_rel (eq. `netrelvel`) of the state of a contact (9,) as a vector in O, m/s."""
    u1, v1, *rates_1, u2, v2, du2, dv2, psi = state
    a1, a2 = finger.metric_root(u1, v1) @ rates_1, obj.metric_root(u2, v2) @ (du2, dv2)
    return obj.frame(u2, v2)[:, :2] @ (rolled(psi, a1) - a2)


def _share_of_M(patch: ContactSurface) -> float:
    """The part of the depth by which geometry M gives way, 0 if it is rigid.

    Pressure grows by each body's gradient from its surface to the patch, where both are equal.
    """
    if not patch.HasGradE_M():
        return 0.0
    if not patch.HasGradE_N():
        return 1.0
    face = patch.num_faces() // 2  # any
    in_M, in_N = (math.hypot(*g(face)) for g in (patch.EvaluateGradE_M_W, patch.EvaluateGradE_N_W))
    return in_N / (in_M + in_N)


# --- one contact ---------------------------------------------------------------------------------


class ContactGauges:
    """Measures all contacts of a scene at one time; one thread at a time may use it.

    scene : Scene
    step : s, of the discrete plant whose forces are those of the last step; 0 if they are of now
    """

    def __init__(self, scene: Scene, step: float):
        self._probes = probes_of(scene, TOLERANCE)
        steps = [[step]] * len(self._probes)
        self._motions = FingerTables(_motion(), MOTION_INPUTS, steps)
        self._forces = FingerTables(_forces(), FORCE_INPUTS, [[]] * len(steps))
        self._result = np.zeros((len(steps), sum(MEASURED.values())))

    def measure(
        self, X_W: Any, V_W: Any, A_W: Any, obj: int, fingers: list[int], pressing: list[list[Any]]
    ) -> Array:
        """Slip, normal force, tangential force in E2, state, contact point in O: (n, 17).

        X_W, V_W, A_W : Drake's lists of all bodies; A_W may be None
        pressing : for each contact its patches and point pairs, as `_whole` takes them
        """
        self._motions.put(X_W, V_W, obj, fingers)
        x = self._motions.x
        if A_W is not None:
            x["A_WO"][:] = A_W[obj].get_coeffs()
            x["A_WF"][:] = [A_W[body].get_coeffs() for body in fingers]
        for i, parts in enumerate(pressing):
            probe, moved, result = self._probes[i], self._motions.results[i], self._result[i]
            seen, found, inputs = probe.seen, probe.found, self._forces.points[i]
            share = k_share = 0.0
            if parts:
                (share, k_share), *load = parts[0] if len(parts) == 1 else _whole(parts)
                x["point"][i], x["force"][i], x["torque"][i] = load
            self._motions.machines[i].run()
            # slip and forces, where the step that ended now began
            seen[:18], seen[18], seen[19] = moved[THEN], share, 0.0  # slip follows from the twist
            if parts:
                probe.find(moved[IN_O], moved[IN_F])
            else:
                probe.find(probe.approach())
            inputs[:21], inputs[21:30] = found[ON_OBJECT.start : GAP + 1], moved[LOAD]
            inputs[30], result[:2] = k_share, found[SLIP]
            self._forces.machines[i].run()
            result[2:5] = self._forces.results[i] if parts else 0.0
            # where the contact is now, with the slip of the step as known
            seen[:18], seen[18], seen[19], seen[20:] = moved[NOW], 0.0, 1.0, result[:2]
            probe.find(found[ON_OBJECT], found[ON_FINGER])
            result[5:14], result[14:17] = found[STATES], found[ON_OBJECT]
        return self._result


def _whole(parts: list[Any]) -> tuple[Array, Array, Array, Array]:
    """A contact of several patches or point pairs as one: shares and C are means, weighted by the
    sizes of the forces.

    parts : of each its shares (where between the surfaces of object, 0, and finger, 1, slip is
        taken; the part of the patch's curvature that is the finger's, the rest is the object's), C,
        the force on the finger, and its torque about C, in the world
    """
    shares, points, forces, torques = map(np.array, zip(*parts))
    sizes = np.linalg.norm(forces, axis=1) + TINY  # forces of size 0 get equal weights
    weights = sizes / sizes.sum()
    C = weights @ points
    return weights @ shares, C, forces.sum(0), (torques + np.cross(points - C, forces)).sum(0)


@per_structure
def _motion() -> Table:
    """Table: `MOTION_INPUTS`; step -> X_OF (12), V_OF_O (6), C in F, C in O, force and torque in O,
    when the step that has just ended began; X_OF, V_OF_O of now.

    A discrete plant has moved the bodies from there with the velocities that it reports, so these
    are those of half a step ago.
    """
    (row, x), step = named(MOTION_INPUTS), ca.SX.sym("step")
    then = _in_object(x, -step)
    x.w_WO, x.v_WO = x.w_WO + step / 2 * x.alpha_WO, x.v_WO + step / 2 * x.a_WO
    x.w_WF, x.v_WF = x.w_WF + step / 2 * x.alpha_WF, x.v_WF + step / 2 * x.a_WF
    found = ca.vertcat(then, _in_object(x, ca.SX(0))[:18])
    return Table(ca.Function("motion", [row, step], [ca.densify(found)]))


def _in_object(x: SimpleNamespace, later: ca.SX) -> ca.SX:
    R_WO, p_WO = _moved(x.R_WO, x.p_WO, x.w_WO, x.v_WO, later)
    R_WF, p_WF = _moved(x.R_WF, x.p_WF, x.w_WF, x.v_WF, later)
    R_OW, p_OF_W, w_OF_W = R_WO.T, p_WF - p_WO, x.w_WF - x.w_WO
    v_OF_W = x.v_WF - x.v_WO - ca.cross(x.w_WO, p_OF_W)
    X_OF, p_FC = R_OW @ ca.horzcat(R_WF, p_OF_W), R_WF.T @ (x.point - p_WF)
    vectors = R_OW @ ca.horzcat(w_OF_W, v_OF_W, x.point - p_WO, x.force, x.torque)
    V_OF, contact = ca.vertsplit(ca.vec(vectors), [0, 6, 15])
    return ca.vertcat(ca.vec(X_OF.T), V_OF, p_FC, contact)


def _moved(R: ca.SX, p: ca.SX, w: ca.SX, v: ca.SX, later: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Rotation and position after a step of Drake, which updates quaternions by Cayley's map."""
    a = ca.skew(later / 2 * w)
    turn = ca.SX.eye(3) + 2 * (a + a @ a) / (1 + later**2 / 4 * ca.sumsqr(w))
    return turn @ R, p + later * v


@per_structure
def _forces() -> Table:
    """Table: `FORCE_INPUTS` -> normal force, tangential force in E2, (3).

    They are along and across the normal at the centre of pressure, to first order.
    """
    row, x = named(FORCE_INPUTS)
    E2, K2, K1 = ca.reshape(x.E2, 3, 3), ca.reshape(x.K2, 2, 2), ca.reshape(x.K1, 2, 2)
    arm, force, torque = (E2.T @ v for v in (x.point - x.at, x.force, x.torque))
    curvature = K2 - x.k_share * (K2 + K1)
    # a force along n at r from where the torque is taken has the torque r x n
    pressing = ca.fmax(force[2], TINY)
    offset = ca.if_else(force[2] > 0, ca.vertcat(-torque[1], torque[0]) / pressing, 0)
    tilt = curvature @ (arm[:2] + offset)
    normal = force[2] + ca.dot(tilt, force[:2])
    found = ca.vertcat(normal, force[:2] - normal * tilt)
    return Table(ca.Function("forces", [row, ca.SX(0, 1)], [ca.densify(found)]))
