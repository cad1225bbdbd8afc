"""What the component computes for one contact, as CasADi functions of the component's variables.

Nothing of the mathematics is written here: `contact_system.system.contact_function` and the moving
frames of `contact_system.theory.development` are put into the variables that an importer sees.
Those of a contact are, in this order,

* its state, eleven numbers (theory section 4): u1 v1; theta1, the angle in E1 of a frame that is
  carried along by parallel transport; the path velocity M1 dq1/ds in that frame, W1; u2 v2 theta2
  and the object's path velocity likewise; psi. At the start the carried frames are E1 and E2, so
  the velocities are those of the scene. They stay constant while nothing acts, exist where
  sigma = 0, and u', v' follow from them. In the frames E1, E2 themselves they would turn all the
  time, and an importer's solver would let their length drift (measured, K4 by CVode at 1e-10:
  4e-7 rad off, here 9e-8, with the nominal values of `variables` 3e-8);
* the derivatives of those eleven, slip (2), twist (6), the pose of the finger in the object's
  frame (rotation row by row, 9, position, 3), the contact point on finger and object (3 + 3).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Hashable, Sequence
from typing import NamedTuple

import numpy as np

from contact_system.errors import ContactSystemError, SceneError
from contact_system.scene import Contact, Scene
from contact_system.starts import scene_start
from contact_system.surfaces import Ellipsoid, Quadric, Surface, UserSurface
from contact_system.system import PER_CONTACT, Form, contact_function, flip, start_function
from contact_system.theory import symbols as ca
from contact_system.theory.geometry import rotation
from contact_system.theory.profile import polynomial
from contact_system.theory.symbols import per_structure

LAYOUT = {"INPUT": 6, "STATE": 11, "RATE": 11, "SLIP": 2, "TWIST": 6, "POSE": 12, "POINTS": 6}
"""The block of numbers of a contact: disturbance inputs, state, and results from RATE on."""
INPUTS, STATES = LAYOUT["INPUT"], LAYOUT["STATE"]
BLOCK = sum(LAYOUT.values())
RESULTS = BLOCK - INPUTS - STATES
TOLERANCE = 1e-14
"""Of plans in this process, and of what is cut off a panel in the FMU; with 1e-13 K4 ends 4e-14 of
its size away."""
INFINITE = 1e200  # no rate is greater; kernels divide an acceleration by 1e-300 where sigma is 0
WORK_SIZE = 1.0
"""Stands for a body's size where `contact_function` asks for one and no result depends on it."""


class Arguments(NamedTuple):
    """Symbols of what a contact depends on.

    time (1), state (11), disturbance (6): accelerations of finger and object, object rate offset,
    chart components; law: gain, then the profile's coefficients; parameters of finger and object.
    """

    time: ca.SX
    state: ca.SX
    disturbance: ca.SX
    law: ca.SX
    finger: ca.SX
    object: ca.SX


def sided(surface: Surface) -> Hashable:
    """What C is made for: the side of a surface is none of its parameters."""
    return surface.structure, surface.inside


def arguments(finger: Surface, obj: Surface, n_profile: int) -> Arguments:
    """Symbols for a contact of these surfaces under a profile of so many coefficients."""
    sizes = {"t": 1, "x": STATES, "w": 6, "law": 1 + n_profile}
    sizes |= {"p1": len(finger.parameters), "p2": len(obj.parameters)}
    return Arguments(*(ca.SX.sym(name, size) for name, size in sizes.items()))


def contact_values(
    finger: Surface, obj: Surface, forms: tuple[bool, bool], law: str, a: Arguments, state: ca.SX
) -> dict[str, ca.SX]:
    """What `contact_function` gives, by its names in `SceneSystem.function`; the pose row by row.

    The state, with W_1 and V, is that of moving frames between which R_0 is diag(1, -1): their
    angles sum to -psi. One in space (`forms`) is carried as (x, p).
    """
    form = Form("frame", True, forms, law, a.law.numel() - 1, ())
    values = contact_function(finger, obj, form)(
        a.time, state, a.disturbance, ca.SX(0, 1), a.law, *_sized(a)
    )
    found = dict(zip(("derivatives", *PER_CONTACT), values))
    pose = found["pose"]
    return found | {"pose": ca.vertcat(ca.vec(ca.reshape(pose[:9], 3, 3).T), pose[9:])}


def first_state(finger: Surface, obj: Surface, forms: tuple[bool, bool], a: Arguments) -> ca.SX:
    """What `contact_values` takes as the state, from the component's."""
    x = a.state
    velocities = (rotation(x[2]) @ x[3:5], rotation(x[7]) @ x[8:10])
    given = ca.vertcat(x[0:2], x[5:7], x[10], *velocities)
    form = Form("frame", True, forms, "path", a.law.numel() - 1, ())  # no law acts yet
    return start_function(finger, obj, form)(0, given, ca.SX.zeros(a.law.numel()), *_sized(a))[0]


def _sized(a: Arguments) -> tuple[ca.SX, ca.SX]:
    return ca.vertcat(a.finger, WORK_SIZE), ca.vertcat(a.object, WORK_SIZE)


@per_structure
def regularity(finger: Surface, obj: Surface) -> ca.Function:
    """State, numbers of finger and object -> least Lame coefficient of each body's chart, m.

    0 at a pole or an umbilic, less where the chart's frame points inward.
    """
    a = arguments(finger, obj, 1)
    frame = ca.vertcat(a.state[0:2], 0, a.state[5:7], ca.SX(5, 1))
    found = contact_values(finger, obj, (False, False), "path", a, frame)["regularity"]
    return ca.Function("regularity", [a.state, a.finger, a.object], [ca.densify(found)])


@per_structure
def contact_results(finger: Surface, obj: Surface, law: str, n_profile: int) -> ca.Function:
    """The 37 results of a contact from its state (see the module's text); exact at sigma = 0.

    `contact_values` takes the finger's frame turned by psi + theta1 + theta2, which stays constant.
    """
    a = arguments(finger, obj, n_profile)
    u1, theta1, w1, u2, theta2, y, psi = ca.vertsplit(a.state, [0, 2, 3, 5, 7, 8, 10, 11])
    turn = rotation(psi + theta1 + theta2)
    w = turn @ w1
    state = ca.vertcat(u1, -psi - theta2, u2, theta2, w, flip() @ w - y)
    # where sigma has ended the path rests: solvers look there from within their last step
    ended = polynomial(ca.vertsplit(a.law[1:]), a.time) < 0
    own = a._replace(law=ca.vertcat(a.law[0], ca.if_else(ended, 0, a.law[1:])))
    found = contact_values(finger, obj, (False, False), law, own, state)
    finger_rate, theta1_rate, object_rate, theta2_rate, w_rate, v_rate = ca.vertsplit(
        found["derivatives"], [0, 2, 3, 5, 6, 8, 10]
    )
    results = ca.vertcat(
        *(finger_rate, theta1_rate, turn.T @ w_rate),
        *(object_rate, theta2_rate, flip() @ w_rate - v_rate),
        -theta1_rate - theta2_rate,
        *(found[name] for name in ("slip", "twist", "pose", "contact_point")),
    )
    return ca.Function("results", list(a), [ca.densify(ca.cse(results))])


@per_structure
def jacobian(function: ca.Function) -> ca.Function:
    """All arguments, one after the other, -> derivatives: (n_results, n_arguments)."""
    sizes = [function.nnz_in(i) for i in range(function.n_in())]
    z = ca.SX.sym("z", sum(sizes))
    parts = ca.vertsplit(z, np.cumsum([0, *sizes]).tolist())
    return ca.Function("jacobian_of", [z], [ca.densify(ca.jacobian(function(*parts), z))])


def start_state(contact: Contact) -> np.ndarray:
    """The eleven numbers of a contact where its scene starts."""
    start = scene_start(contact)
    finger = (*start.finger_at, 0.0, *start.finger_velocity)
    return np.array([*finger, *start.object_at, 0.0, *start.object_velocity, start.angle])


def surface_with(surface: Surface, values: Sequence[float]) -> Surface:
    """The same kind of surface with other numbers.

    Raises
    ------
    SceneError
        Numbers that make another kind of surface, or that depend on each other.
    """
    numbers = tuple(values[: len(surface.parameters)])
    if numbers == surface.parameters:
        return surface
    if isinstance(surface, Quadric):
        raise SceneError(
            f"{surface!r}: its parameters depend on each other and cannot be set individually; "
            "step a scene with another matrix A"
        )
    other: Surface
    if isinstance(surface, UserSurface):
        named = dict(zip(surface.formula.names, numbers, strict=True))
        other = dataclasses.replace(surface, parameters=named)  # type: ignore[call-arg]
    elif isinstance(surface, Ellipsoid):
        axes = {1: (0, 0, 0), 2: (0, 0, 1) if surface.a == surface.b else (0, 1, 1), 3: (0, 1, 2)}
        other = Ellipsoid(*(numbers[k] for k in axes[len(numbers)]), inside=surface.inside)
    else:
        other = type(surface)(*numbers, inside=surface.inside)
    if other.structure != surface.structure:
        raise SceneError(
            f"{other!r} is another kind of surface than {surface!r}; step a scene that has it"
        )
    return other


def kept_order(surface: Surface) -> list[tuple[int, int]]:
    """What `surface_with` wants of a surface's numbers, found by asking it.

    Returns
    -------
    list of (i, j)
        Number i is to stay greater than number j; (i, i): number i is to stay what it is.
    """
    numbers, found = surface.parameters, []

    def refused(i: int, value: float) -> bool:
        try:
            surface_with(surface, (*numbers[:i], value, *numbers[i + 1 :]))
        except ContactSystemError:
            return True
        return False

    for i, x in enumerate(numbers):
        if refused(i, math.nextafter(x, math.inf)) and refused(i, math.nextafter(x, -math.inf)):
            found.append((i, i))
        else:
            found += [(i, j) for j, y in enumerate(numbers) if x > y and refused(i, y)]
    return found


def require_charts(scene: Scene) -> None:
    """Refuse surfaces without coordinates that can be set.

    Raises
    ------
    SceneError
        A surface without an explicit chart (`ImplicitSurface`).
    """
    bodies = [("the object", scene.object)]
    bodies += [(f"contact {i}", c.finger) for i, c in enumerate(scene.contacts)]
    for place, surface in bodies:
        if not surface.has_chart:
            raise SceneError(
                f"{scene.title}, {place}: {surface!r} has no explicit chart f(u, v), which "
                "an importer needs to set where the contact starts; give a ParametricSurface"
            )


def dependencies(function: ca.Function, samples: Sequence[Sequence[np.ndarray]]) -> np.ndarray:
    """Which results depend on which arguments, from exact derivatives at sample points.

    The expression's own structure would name too much: a path velocity of the object passes through
    V = R_0 W_1 - a_2, and R_0 W_1 - V depends on nothing but a_2 after all.

    Returns
    -------
    (n_results, n_arguments) bool
    """
    derivatives = jacobian(function)
    found = np.zeros(derivatives.size_out(0), dtype=bool)
    for sample in samples:
        at = np.concatenate([np.ravel(part) for part in sample])
        values = np.abs(derivatives(at).full() * np.where(at == 0, 1.0, at))
        largest = np.maximum(values.max(axis=1, keepdims=True), 1e-300)
        found |= ~(values <= 1e-12 * largest)  # a NaN says that there is a dependence
    return found
