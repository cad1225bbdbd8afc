r"""The whole scene as one system of ordinary differential equations, as CasADi functions.

For whoever integrates a scene in his own way: a Drake LeafSystem, an FMU. Everything is a pure
function of

====== =========================================================================================
t      time, s
x      continuous states, contact by contact
w      disturbances acting now, 6 a contact: accelerations of finger and object (chart components),
       object rate offset; empty where the scene has no windows and no input asks for them
held   numbers that only a restart changes, 5 a contact: W_1, V and the time at which V held;
       contacts that are accelerated have none, nor has any in chart coordinates
p      parameters: gain, profile coefficients, the surfaces' numbers and sizes
====== =========================================================================================

Two choices of coordinates describe the same motion:

* "chart", the paper's equations (theory section 2): u1 v1 u1' v1' u2 v2 u2' v2' psi a contact;
  singular at poles and where sigma = 0, stiff in lam;
* "frame", moving frames (theory sections 4, 5): a point and a tangent (x, p) in space, or
  (u, v, theta) where a surface has only a chart or its chart decides the sign of a disturbance.
  Slip costs no state, V e^{-L} being in closed form. Only a contact that is accelerated carries
  W_1 and V, and with V the rate lam. Frames are chosen so that psi = -theta_1 - theta_2: the map
  between them is diag(1, -1).

The equations themselves stand in `equations` and `development`; here they are put together.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from .charts import TINY, TURN
from .checks import did_you_mean, flag, real_array
from .development import driven_motion, forced_motion, reflection, starting_slip
from .equations import chart_equations
from .errors import SceneError
from .expressions import SYMBOLS
from .geometry import upper_inverse
from .kept import kept
from .kernels import per_structure
from .kinematics import relative_pose, relative_twist
from .profile import integral, law_rate, polynomial, product
from .scene import (
    DISTURBANCE_KINDS,
    Disturbance,
    FingerAcceleration,
    ObjectAcceleration,
    ObjectRateOffset,
    Scene,
    acting,
    refuse_rest,
    require_scene,
)
from .starts import Start, measured_start, scene_start
from .surfaces import Ellipsoid, Surface
from .tracks import (
    coordinate_kernel,
    frame_kernel,
    in_space,
    restoring_kernel,
    rotation,
    shape_kernel,
    standing_size,
    vector_kernel,
)
from .user_surfaces import UserSurface

SX = ca.SX
Array = np.ndarray

COORDINATES = ("chart", "frame")
INPUTS = ("t", "x", "w", "held", "p")
PER_CONTACT = {
    "state": 9, "slip": 2, "twist": 6, "acceleration": 6, "pose": 12, "contact_point": 6,
    "normal": 3, "regularity": 2,
}  # fmt: skip
"""Outputs of :meth:`SceneSystem.function` that have so many numbers a contact."""
HELD = 5
FLIP = reflection(SX(1), SX(0))
"""R_0 between the moving frames of finger and object."""


class Form(NamedTuple):
    """How the motion of one contact is written; with the surfaces' structures it names a kernel."""

    coordinates: str
    forced: bool
    ambient: tuple[bool, bool]
    law: str
    n_profile: int
    growths: tuple[tuple[float, float], ...]

    @property
    def sizes(self) -> tuple[int, int, int, int]:
        """Numbers of states: finger, object, W_1, V."""
        if self.coordinates == "chart":
            return 4, 4, 1, 0
        finger, obj = map(standing_size, self.ambient)
        return finger, obj, 2 * self.forced, 2 * self.forced

    @property
    def n_held(self) -> int:
        return HELD * (self.coordinates == "frame" and not self.forced)


class Body(NamedTuple):
    """One side of a contact: its numbers ``p`` and its size are symbols."""

    surface: Surface
    ambient: bool
    p: SX
    size: SX


class ContactMotion(NamedTuple):
    """What every output of a contact is read off.

    Attributes
    ----------
    rate : x'
    state : u1 v1 u1' v1' u2 v2 u2' v2' psi
    slip : in E2
    frames : x, p, q of finger and object, (9) each
    curvatures : K_pp, K_pq, K_qq of finger and object
    velocities : of the contact point along (p_i, q_i)
    sliding : slip along (p_2, q_2)
    turn : (2, 2), takes tangent components along (p_1, q_1) to (p_2, q_2)
    """

    rate: SX
    state: SX
    slip: SX
    frames: list[SX]
    curvatures: list[SX]
    velocities: tuple[SX, SX]
    sliding: SX
    turn: SX


# --- sigma, lam and the decay of slip -----------------------------------------------------------


def _decay(form: Form, value: SX, profile: list[SX], since: SX, t: SX) -> SX:
    """exp(-(L(t) - L(since))), as `Gain.exponent` gives L."""
    if form.law == "path":
        energy = integral(product(profile, profile))
        return ca.exp(-value * (polynomial(energy, t) - polynomial(energy, since)))
    decay = ca.exp(-value * (t - since))
    for start, stop in form.growths:
        first, last = (
            ca.fmax(polynomial(profile, ca.fmin(ca.fmax(time, start), stop)), TINY)
            for time in (since, t)
        )
        decay *= first / last
    return decay


# --- one contact ---------------------------------------------------------------------------------


def _bodies(finger: Surface, obj: Surface, form: Form) -> tuple[tuple[Body, Body], list[SX]]:
    """Finger and object, and the symbols of their numbers, each followed by the body's size."""
    symbols = [SX.sym(name, len(s.parameters) + 1) for name, s in (("p1", finger), ("p2", obj))]
    sides = [
        # not p[:-1], which is a row where a surface has no parameters
        Body(s, a, *ca.vertsplit(p, [0, len(s.parameters), len(s.parameters) + 1]))
        for s, a, p in zip((finger, obj), form.ambient, symbols)
    ]
    return (sides[0], sides[1]), symbols


def _regularity(body: Body, u: SX, v: SX) -> SX:
    """The lesser Lame coefficient over the size: 0 where the chart is singular.

    Negative where f_u x f_v points into the body (beyond a sphere's pole); 1 for charts that are
    regular everywhere.
    """
    surface = body.surface
    if body.ambient or not (surface.chart.singular_at or isinstance(surface, UserSurface)):
        return SX(1)
    shape = surface.geometry_expr(body.p, u, v)
    least = ca.fmin(shape.metric_root[0, 0], shape.metric_root[1, 1]) / body.size
    if not surface.has_implicit:
        return least
    x = SX.sym("x", 3)
    gradient = ca.gradient(surface.implicit_expr(body.p, x), x)
    outward = ca.dot(shape.frame[:, 2], ca.substitute(gradient, x, shape.point))
    return ca.copysign(least, outward)


def _chart_motion(tip: Body, body: Body, x: SX, w: SX, drive: tuple[SX, SX, SX]) -> ContactMotion:
    sigma, slope, lam = drive
    point = ca.vertcat(x, slope / sigma, lam, w)
    rate = chart_equations(tip.surface, body.surface).function(point, ca.vertcat(tip.p, body.p))
    shapes = (tip.surface.geometry_expr(tip.p, x[0], x[1]),
              body.surface.geometry_expr(body.p, x[4], x[5]))  # fmt: skip
    moved = x[6:8] + w[4:6]
    turn = reflection(ca.cos(x[8]), ca.sin(x[8]))
    velocities = (shapes[0].metric_root @ x[2:4], shapes[1].metric_root @ moved)
    slip = turn @ velocities[0] - velocities[1]
    frames = [ca.vertcat(s.point, ca.vec(s.frame[:, :2])) for s in shapes]
    curvatures = [ca.vec(s.curvature_form)[[0, 1, 3]] for s in shapes]
    state = ca.vertcat(x[:6], moved, x[8])
    return ContactMotion(rate, state, slip, frames, curvatures, velocities, slip, turn)


def _moving_frame(body: Body, own: SX) -> SX:
    """The frame that a state stands for: (x, p, q), on the surface again, or (u, v, theta)."""
    if not body.ambient:
        return own
    return restoring_kernel(body.surface).function(ca.vertcat(own, SX(3, 1)), body.p)


def _frame_rates(
    bodies: tuple[Body, Body], forced: bool, frames: list[SX], w1: SX, v: SX, w: SX,
    drive: tuple[SX, SX, SX],
) -> list[SX]:  # fmt: skip
    """Rates of the two frames and, where they are states, of W_1 and V."""
    (tip, body), (sigma, _, lam) = bodies, drive
    if not forced:
        none = SX(2, 1)
        return [
            driven_motion(tip.surface, tip.ambient).function(
                ca.vertcat(frames[0], sigma, 1), ca.vertcat(tip.p, w1, none, none)
            ),
            driven_motion(body.surface, body.ambient, True).function(
                ca.vertcat(frames[1], sigma, 1), ca.vertcat(body.p, FLIP @ w1, v, w[4:6])
            ),
        ]
    kernel = forced_motion(tip.surface, body.surface, (tip.ambient, body.ambient), True)
    point = ca.vertcat(frames[0], w1, frames[1], v, ca.fmax(sigma, TINY), 0)
    rates = kernel.function(point, ca.vertcat(tip.p, body.p, 1, 0, w1, w))
    n1, n2 = frames[0].numel(), frames[1].numel()
    finger, w1_rate, obj, v_rate = ca.vertsplit(rates, np.cumsum([0, n1, 2, n2, 2]).tolist())
    return [finger, obj, w1_rate, v_rate - lam * v]


def _frame_motion(
    bodies: tuple[Body, Body], form: Form, x: SX, w: SX, drive: tuple[SX, SX, SX], w1: SX, v: SX
) -> ContactMotion:
    sigma, offset, obj = drive[0], w[4:6], bodies[1]
    own = ca.vertsplit(x, np.cumsum([0, *form.sizes]).tolist())
    frames = [_moving_frame(b, s) for b, s in zip(bodies, own)]
    rates = _frame_rates(bodies, form.forced, frames, w1, v, w, drive)
    for k, b in enumerate(bodies):
        if b.ambient:  # drift off the surface dies out along a path of the body's size
            rates[k] = rates[k][:6] + sigma / b.size * (frames[k][:6] - own[k])
    velocities = [sigma * w1, sigma * (FLIP @ w1 - v)]
    sides = [
        coordinate_kernel(b.surface, b.ambient).function(ca.vertcat(f, c), b.p)
        for b, f, c in zip(bodies, frames, velocities)
    ]
    theta = sides[1][4]
    psi = -sides[0][4] - theta
    psi -= TURN * ca.floor((psi + math.pi) / TURN)
    state = ca.vertcat(sides[0][:4], sides[1][:2], sides[1][2:4] + offset, psi)
    pushed = vector_kernel(obj.surface, obj.ambient).function(frames[1], ca.vertcat(obj.p, offset))
    sliding = sigma * v - pushed
    curvatures = [
        shape_kernel(b.surface, b.ambient).function(f, b.p) for b, f in zip(bodies, frames)
    ]
    spatial = [
        f if b.ambient else frame_kernel(b.surface).function(f, b.p) for b, f in zip(bodies, frames)
    ]
    return ContactMotion(
        ca.vertcat(*rates), state, rotation(theta) @ sliding, spatial, curvatures,
        (velocities[0], velocities[1] + pushed), sliding, FLIP,
    )  # fmt: skip


def _relative(motion: ContactMotion) -> tuple[SX, SX]:
    """Pose, by columns (12), and twist of the finger's frame in the object's, by `kinematics`."""

    def numbers(value: SX, *shape: int) -> Array:
        array = np.empty(value.numel(), dtype=object)
        array[:] = value.elements()
        return array.reshape(1, *shape)

    frames = [numbers(frame, 9, 1) for frame in motion.frames]
    k1, k2 = (numbers(k, 3, 1) for k in motion.curvatures)
    a1, a2 = (numbers(a, 2, 1) for a in motion.velocities)
    turn = numbers(motion.turn.T, 2, 2)
    pose = relative_pose(frames[0], frames[1], turn)
    twist = relative_twist(frames[1], pose, (k1, k2), (a1, a2), turn, numbers(motion.sliding, 2, 1))
    return ca.vertcat(*pose[0, 0, :3].T.ravel()), ca.vertcat(*twist.ravel())


@per_structure
def contact_function(finger: Surface, obj: Surface, form: Form) -> ca.Function:
    """Derivatives, then the outputs of `PER_CONTACT`, of one contact.

    Inputs: t, x, w (6), held, law (gain, profile coefficients), numbers and size of the finger and
    of the object. The twist's rate follows by the chain rule along the motion.
    """
    bodies, numbers = _bodies(finger, obj, form)
    t, x, w = SX.sym("t"), SX.sym("x", sum(form.sizes)), SX.sym("w", 6)
    held, law = SX.sym("held", form.n_held), SX.sym("law", 1 + form.n_profile)
    sigma = polynomial(ca.vertsplit(law[1:]), t)
    slope = ca.gradient(sigma, t)
    growth = ca.fmax(0, slope / ca.fmax(sigma, TINY))
    drive = (sigma, slope, law_rate(form.law, law[0], sigma, growth))
    if form.coordinates == "chart":
        motion = _chart_motion(*bodies, x, w, drive)
    elif form.forced:
        motion = _frame_motion(bodies, form, x, w, drive, x[-4:-2], x[-2:])
    else:
        v = held[2:4] * _decay(form, law[0], ca.vertsplit(law[1:]), held[4], t)
        motion = _frame_motion(bodies, form, x, w, drive, held[:2], v)

    def along(value: SX) -> SX:
        """The total time derivative; disturbances do not change between edges."""
        return ca.jtimes(value, x, motion.rate) + ca.jtimes(value, t, SX(1))

    pose, twist = _relative(motion)
    regularity = [_regularity(b, x[k], x[k + 1]) for b, k in zip(bodies, (0, form.sizes[0]))]
    (x1, _), (x2, tangents) = (ca.vertsplit(f, [0, 3, 9]) for f in motion.frames)
    outputs = [
        motion.rate, motion.state, motion.slip, twist, along(twist),
        pose, ca.vertcat(x1, x2),
        ca.cross(tangents[:3], tangents[3:]), ca.vertcat(*regularity),
    ]  # fmt: skip
    inputs = [t, x, w, held, law, *numbers]
    return ca.Function("contact", inputs, [ca.densify(value) for value in ca.cse(outputs)])


@per_structure
def start_function(finger: Surface, obj: Surface, form: Form) -> ca.Function:
    """States and held numbers of one contact from where it starts.

    Inputs: t; the finger's place, the object's place, psi, W_1 in E1, the object's path velocity
    in E2; law; numbers and size of the finger and of the object. A place is (u, v), or where there
    is no chart the point and the frame's axes x, y (9).
    """
    bodies, numbers = _bodies(finger, obj, form)
    t, law = SX.sym("t"), SX.sym("law", 1 + form.n_profile)
    at = [SX.sym("at", 2 if s.has_chart else 9) for s in (finger, obj)]
    psi, w1, y = SX.sym("psi"), SX.sym("W1", 2), SX.sym("Y", 2)
    if form.coordinates == "chart":
        sigma = polynomial(ca.vertsplit(law[1:]), t)
        parts = []
        for b, q, c in zip(bodies, at, (w1, y)):
            root = b.surface.geometry_expr(b.p, q[0], q[1]).metric_root
            parts += [q, sigma * (upper_inverse(root) @ c)]
        x, held = ca.vertcat(*parts, psi), SX(0, 1)
    else:
        frames = [_first_frame(b, q, a) for b, q, a in zip(bodies, at, (-psi, SX(0)))]
        w1_parallel = rotation(psi) @ w1
        v = starting_slip(w1_parallel, FLIP @ w1_parallel, y)
        if form.law == "guaranteed":  # which lets no slip leave a rest
            v = ca.if_else(polynomial(ca.vertsplit(law[1:]), t) > 0, v, 0)
        constants = ca.vertcat(w1_parallel, v)
        x, held = ca.vertcat(*frames), ca.vertcat(constants, t)
        if form.forced:
            x, held = ca.vertcat(x, constants), SX(0, 1)
    inputs = [t, ca.vertcat(*at, psi, w1, y), law, *numbers]
    return ca.Function("start", inputs, [ca.densify(x), ca.densify(held)])


def _first_frame(body: Body, place: SX, theta: SX) -> SX:
    """The state of a moving frame at a place, its first axis at -theta from the chart's."""
    if place.numel() == 9:
        return ca.vertcat(place[:3], ca.reshape(place[3:], 3, 2) @ rotation(theta)[:, 0])
    own = ca.vertcat(place, theta)
    return frame_kernel(body.surface).function(own, body.p)[:6] if body.ambient else own


# --- the scene -----------------------------------------------------------------------------------


class SceneSystem:
    """The equations of all contacts of a scene, ready to be integrated.

    Parameters
    ----------
    scene : Scene
    coordinates : "chart" or "frame"
        ``help(contact_system.system)`` explains both, and t, x, w, held and p.
    disturbance_input : bool
        Whether w may hold more than the scene's windows, on every contact.

    Attributes
    ----------
    x0, held0 : (n_x,), (n_held,)
        Where the scene starts, at t = 0.
    parameters : (n_p,)
        Values of p; their names are ``parameter_names``.
    n_w : int
        6 a contact, or 0 where w is empty.
    edges : tuple of float
        Times at which :meth:`window_values` changes, ascending, s.
    state_slices : list of slice
        The part of x that belongs to each contact.

    Raises
    ------
    SceneError
        A scene that cannot be written in these coordinates: sigma = 0 (chart), no explicit chart
        (chart), sigma = 0 while a contact is accelerated.
    """

    def __init__(self, scene: Scene, coordinates: str = "chart", disturbance_input: bool = False):
        if not isinstance(coordinates, str) or coordinates not in COORDINATES:
            raise SceneError(f"coordinates = {coordinates!r}: use one of {', '.join(COORDINATES)}")
        require_scene(scene)
        self.scene, self.coordinates = scene, coordinates
        self.disturbance_input = disturbance_input = flag(disturbance_input, "disturbance_input")
        self._refuse()
        n = len(scene.contacts)
        self.n_w = 6 * n if scene.disturbances or disturbance_input else 0
        self.edges = scene.window_edges
        self.forms = [self._form(i) for i in range(n)]
        self.state_slices = _consecutive(sum(form.sizes) for form in self.forms)
        self.held_slices = _consecutive(form.n_held for form in self.forms)
        bodies = [scene.object, *(contact.finger for contact in scene.contacts)]
        law = (scene.gain.value, *scene.profile.coefficients)
        self._number_slices = _consecutive([len(law), *(len(b.parameters) + 1 for b in bodies)])
        self.parameters = np.array([*law, *(x for b in bodies for x in (*b.parameters, b.size))])
        self.x0, self.held0 = self.place(0.0, [scene_start(c) for c in scene.contacts])
        self._functions: dict[tuple[str, ...], ca.Function] = {}

    # --- what a scene must fulfil ----------------------------------------------------------------

    def _refuse(self) -> None:
        scene = self.scene
        if self.coordinates == "chart":
            zeros = scene.profile.zeros(scene.duration)
            if zeros:
                raise SceneError(
                    f"{scene.title}: the chart equations divide by sigma, which is zero at "
                    f't = {zeros[0]:g} s; use coordinates="frame", which start and rest at zero'
                )
            for i, contact in enumerate(scene.contacts):
                for surface in (contact.finger, scene.object):
                    if not surface.has_chart:
                        raise SceneError(
                            f"{scene.title}, contact {i}: {surface!r} has no explicit "
                            'chart for the chart equations; use coordinates="frame"'
                        )
        for d in scene.disturbances:
            if not isinstance(d, ObjectRateOffset):
                where = f"{scene.title}, contact {d.contact}"
                refuse_rest(scene, where, d.start, d.stop)

    def _form(self, index: int) -> Form:
        scene, chart = self.scene, self.coordinates == "chart"
        own = {type(d) for d in scene.disturbances if d.contact == index}
        d1, d2, offset = (self.disturbance_input or kind in own for kind in DISTURBANCE_KINDS)
        ambient = [
            not chart and in_space(surface, pushed)
            for surface, pushed in (
                (scene.contacts[index].finger, d1),
                (scene.object, d2 or offset),
            )
        ]
        return Form(
            self.coordinates, not chart and (d1 or d2), (ambient[0], ambient[1]), scene.gain.law,
            len(scene.profile.coefficients), self._growths,
        )  # fmt: skip

    @kept
    def _growths(self) -> tuple[tuple[float, float], ...]:
        """Where sigma grows, which the guaranteed law makes up for; far beyond the horizon too."""
        if self.scene.gain.law != "guaranteed":
            return ()
        return tuple(self.scene.profile.growths(0.0, 1e3 * self.scene.duration))

    # --- names -----------------------------------------------------------------------------------

    @kept
    def parameter_names(self) -> list[str]:
        """Names of p, such as ``gain.eta``, ``profile[0]``, ``contacts[0].finger.radius``."""
        scene = self.scene
        names = [f"gain.{scene.gain.parameter}"]
        names += [f"profile[{k}]" for k in range(len(scene.profile.coefficients))]
        owners = [("object", scene.object)]
        owners += [(f"contacts[{i}].finger", c.finger) for i, c in enumerate(scene.contacts)]
        for owner, surface in owners:
            names += [f"{owner}.{name}" for name in (*_number_names(surface), "size")]
        return names

    # --- functions -------------------------------------------------------------------------------

    @kept
    def _symbols(self) -> dict[str, SX]:
        sizes = (1, len(self.x0), self.n_w, len(self.held0), len(self.parameters))
        return {name: SX.sym(name, size) for name, size in zip(INPUTS, sizes)}

    @kept
    def _expressions(self) -> dict[str, SX]:
        """Every output as an expression of the symbols."""
        t, x, w, held, p = self._symbols.values()
        law, obj, *fingers = (p[s] for s in self._number_slices)
        names = ("derivatives", *PER_CONTACT)
        found: dict[str, list[SX]] = {name: [] for name in names}
        for i, (contact, form) in enumerate(zip(self.scene.contacts, self.forms)):
            acts = self.disturbance_input or any(d.contact == i for d in self.scene.disturbances)
            own = w[6 * i : 6 * i + 6] if acts else SX.zeros(6)
            function = contact_function(contact.finger, self.scene.object, form)
            values = function(
                t, x[self.state_slices[i]], own, held[self.held_slices[i]], law, fingers[i], obj
            )
            for name, value in zip(names, values):
                found[name].append(value)
        outputs = {name: ca.vertcat(*values) for name, values in found.items()}
        outputs["guard"] = self._guard(outputs["derivatives"], t, law[1:])
        outputs["clearance"] = functools.reduce(ca.fmin, ca.vertsplit(outputs["regularity"]))
        outputs["stretch"] = ca.vertcat(
            *(self._stretch(i, state, finger, obj)
              for i, (state, finger) in enumerate(zip(found["state"], fingers)))
        )  # fmt: skip
        return outputs

    def _stretch(self, index: int, state: SX, finger: SX, obj: SX) -> SX:
        """|M| of finger and object, (2); 0 where the scene does not accelerate along the chart."""
        scene = self.scene
        kinds = {type(d) for d in scene.disturbances if d.contact == index}
        sides = (
            (FingerAcceleration, scene.contacts[index].finger, finger, state[:2]),
            (ObjectAcceleration, scene.object, obj, state[4:6]),
        )
        found, point = SX.zeros(2), SX.sym("point", 2)
        for k, (kind, surface, numbers, at) in enumerate(sides):
            if kind in kinds:
                p, _ = ca.vertsplit(numbers, [0, numbers.numel() - 1, numbers.numel()])
                m = surface.geometry_expr(p, point[0], point[1]).metric_root
                found[k] = ca.substitute(ca.norm_fro(m), point, at)
        return found

    def _guard(self, rate: SX, t: SX, profile: SX) -> SX:
        """1; -1 where sigma < 0; -inf or NaN where a derivative is not finite."""
        c = ca.vertsplit(profile)
        rounding = 1e-14 * polynomial([ca.fabs(k) for k in c], ca.fabs(t))
        return ca.copysign(1, polynomial(c, t) + rounding) - TINY * ca.sumsqr(rate)

    def function(self, *outputs: str) -> ca.Function:
        """The CasADi function (t, x, w, held, p) -> outputs, one vector each.

        Parameters
        ----------
        outputs : str
            "derivatives" (n_x); "guard" (1): negative or NaN where they must not be used, because
            sigma < 0 or one of them is not finite; "clearance" (1), the least regularity; per
            contact "state" (9), u1 v1 u1' v1' u2 v2 u2' v2' psi with object rate offsets in u2'
            v2', in frame coordinates in the chart's principal range; "slip" (2) in E2, m/s;
            "twist" (6), V_OF_O; "acceleration" (6), its time derivative; "pose" (12), the rotation
            from F to O column by column, then the origin of F in O; "contact_point" (6), on the
            finger in F, on the object in O; "normal" (3), of the object, outward, in O;
            "regularity" (2), distance of finger and object from their charts' singularities;
            "stretch" (2), the Frobenius norms of M of finger and object, m, 0 where the scene has
            no acceleration.

        Raises
        ------
        SceneError
            Another output.
        """
        with SYMBOLS:
            try:
                known = outputs in self._functions
            except TypeError:  # a list, which `_expression` refuses
                known = False
            if not known:
                values = ca.cse([self._expression(name) for name in outputs])
                name = "scene_" + "_".join(outputs)
                self._functions[outputs] = ca.Function(
                    name, list(self._symbols.values()), [ca.densify(v) for v in values],
                    list(INPUTS), list(outputs),
                )  # fmt: skip
        return self._functions[outputs]

    def _expression(self, output: str) -> SX:
        with SYMBOLS:
            known = self._expressions
        if not isinstance(output, str) or output not in known:
            raise SceneError(
                f"{self.scene.title}: output = {output!r} is unknown"
                f"{did_you_mean(output, known)}; use one of {', '.join(known)}"
            )
        return known[output]

    def depends(self, output: str) -> set[str]:
        """The inputs among t, x, w, held, p that an output of :meth:`function` depends on."""
        value, symbols = self._expression(output), self._symbols
        return {name for name in INPUTS if ca.depends_on(value, symbols[name])}

    def evaluate(
        self, output: str, t: float, x: ArrayLike, w: ArrayLike | None = None,
        held: ArrayLike | None = None,
    ) -> Array:  # fmt: skip
        """One output as numbers; by default with the windows that act, as held from the start.

        Parameters
        ----------
        output : str
            See :meth:`function`.
        t : float
            s.
        x, w, held : (n_x,), (n_w,), (n_held,)

        Raises
        ------
        SceneError
            Another output, or arrays of other lengths.
        """
        t = float(self._numbers("t", t))
        w = self.window_values(t) if w is None else w
        given = {"x": x, "w": w, "held": self.held0 if held is None else held}
        arrays = {name: self._numbers(name, value) for name, value in given.items()}
        function = self.function(output)
        for name, array in arrays.items():
            count = function.numel_in(name)
            if array.shape != (count,):
                raise SceneError(
                    f"{self.scene.title}: {name} has shape {array.shape}; give ({count},)"
                )
        return function(t, *arrays.values(), self.parameters).full().ravel()

    def _numbers(self, name: str, value: ArrayLike) -> Array:
        """The value as an array of floats, of t without an axis."""
        try:
            found = real_array(value)
            if name != "t" or found.ndim == 0:
                return found
        except (TypeError, ValueError, OverflowError):
            pass
        remedy = "a time in seconds" if name == "t" else "numbers"
        raise SceneError(f"{self.scene.title}: {name} = {value!r:.80}; give {remedy}")

    def __getstate__(self) -> dict:
        """What is pickled and copied: all but symbols and functions, which are made when asked."""
        made = ("_symbols", "_expressions", "_functions")
        return {k: v for k, v in vars(self).items() if k not in made} | {"_functions": {}}

    # --- windows ---------------------------------------------------------------------------------

    @kept
    def windows(self) -> list[tuple[Disturbance, slice]]:
        """The scene's disturbances and where each stands in w."""
        return [
            (d, slice(first, first + 2))
            for d in self.scene.disturbances
            for first in [6 * int(d.contact) + 2 * DISTURBANCE_KINDS.index(type(d))]
        ]

    def window_values(self, t: float) -> Array:
        """What the scene's windows add on the interval that begins at t: (n_w,)."""
        return acting(self.scene, t).ravel()[: self.n_w]

    # --- starting --------------------------------------------------------------------------------

    def place(self, t: float, starts: Sequence[Start]) -> tuple[Array, Array]:
        """States and held numbers of contacts that start at time t: (n_x,), (n_held,)."""
        scene, numbers = self.scene, [self.parameters[s] for s in self._number_slices]
        parts = []
        for i, (contact, form, start) in enumerate(zip(scene.contacts, self.forms, starts)):
            function = start_function(contact.finger, scene.object, form)
            at = [_place(contact.finger, start.finger_at), _place(scene.object, start.object_at)]
            given = np.hstack([*at, start.angle, start.finger_velocity, start.object_velocity])
            values = function(t, given, numbers[0], numbers[2 + i], numbers[1])
            parts.append([value.full().ravel() for value in values])
        return np.concatenate([x for x, _ in parts]), np.concatenate([held for _, held in parts])

    def from_states(
        self, t: float, state: ArrayLike, w: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """States and held numbers from measured chart states.

        Parameters
        ----------
        t : float
            s, with sigma(t) > 0.
        state : (n_contacts, 9) or (9 n_contacts,)
            u1 v1 u1' v1' u2 v2 u2' v2' psi, object rate offsets included in u2' v2'.
        w : (n_w,), optional
            The disturbances that act; by default the scene's windows.

        Returns
        -------
        x, held : (n_x,), (n_held,)

        Raises
        ------
        SceneError
            A wrong shape, NaN, sigma(t) <= 0, or a point that is not in its chart.
        """
        n, rows = len(self.scene.contacts), self._numbers("state", state)
        if rows.size != 9 * n:
            where = f"{self.scene.title}, restart"
            raise SceneError(f"{where}: state has shape {rows.shape}; give {(n, 9)}")
        t = float(self._numbers("t", t))
        w = self.window_values(t) if w is None else self._numbers("w", w)
        if w.shape != (self.n_w,):
            raise SceneError(f"{self.scene.title}: w has shape {w.shape}; give ({self.n_w},)")
        offsets = w.reshape(-1, 6)[:, 4:] if self.n_w else np.zeros((n, 2))
        starts = [
            measured_start(self.scene, i, t, row, offsets[i])
            for i, row in enumerate(rows.reshape(n, 9))
        ]
        return self.place(t, starts)


def _consecutive(sizes: Iterable[int]) -> list[slice]:
    ends = np.cumsum([0, *sizes]).tolist()
    return [slice(a, b) for a, b in zip(ends, ends[1:])]


def _place(surface: Surface, at: tuple[float, float]) -> Array:
    """What `start_function` takes for a body at (u, v)."""
    if surface.has_chart:
        return np.array(at)
    frame = surface.frame(*at)
    return np.hstack([surface.point(*at), frame[:, 0], frame[:, 1]])


def _number_names(surface: Surface) -> tuple[str, ...]:
    """Names of a surface's parameters where it has names for them, else their indices."""
    count = len(surface.parameters)
    names = tuple(f.name for f in dataclasses.fields(surface) if not f.kw_only)
    if isinstance(surface, UserSurface):
        names = tuple(surface.named_parameters)
    if isinstance(surface, Ellipsoid):
        names = {1: ("a",), 2: ("a", "b" if surface.b == surface.c else "c")}.get(count, names)
    return names if len(names) == count else tuple(f"parameters[{k}]" for k in range(count))
