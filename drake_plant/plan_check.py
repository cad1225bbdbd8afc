"""What is refused while a planner is integrated: drift off the exact plan, and singular points.

With fixed steps nothing controls the error of a planner's states, nor does cenic, which controls
the plant's alone (github.com/RobotLocomotion/drake/issues/23921). But the exact states are known:
those of the plan from where the simulation began or last restarted.
"""

from __future__ import annotations

import numpy as np

from contact_system import Plan, Scene, SceneSystem
from contact_system import plan as make_plan
from contact_system.checks import Array
from contact_system.engine.binding import sign_changes
from contact_system.errors import ChartSingularity, ContactSystemError, SceneError
from contact_system.scene import SIDES, refuse_rest

CLEARANCE = 0.01
"""A contact nearer than this to a chart's singularity is refused; a fraction of the body's size."""

TOLERANCE = 1.5e-6
"""How far contact points may be off the exact plan, per metre of path and of the greater body's
size. In D1 that is 1e-6 m at 0.5 s and 9e-6 m at the end, where runge_kutta3 is off by 5e-6 m with
the steps of 1 ms of a discrete plant, by 3e-4 m alone at an accuracy of 1e-3, cenic by 30 mm."""

COMPARISONS = 20
"""How often a planner is compared with the plan over a scene, besides whenever the time since the
start has doubled; each comparison takes 30 us."""


def exact_plan(scene: Scene, start: float, states: bytes, end: float) -> Plan | None:
    """The plan from states (the bytes of (n, 9)) at a start, or the scene's if empty, to an end.

    None where there is no such plan, as from a pole or a rest.
    """
    try:
        if end > scene.duration:  # simulations may go on until sigma is negative
            turns = sign_changes(scene.profile.coefficients, scene.duration, 2 * end)
            scene = scene.replace(duration=min([2 * end, *((1 - 1e-9) * t for t in turns)]))
        plan = make_plan(scene)
        return plan.restart(start, np.frombuffer(states).reshape(-1, 9)) if states else plan
    except ContactSystemError:
        return None


def refuse_drift(scene: Scene, plan: Plan, t: float, points: Array, tolerance: float) -> None:
    """Raise a SceneError where contact points (6 n) are too far from the plan's at time t."""
    off = np.sqrt(((points.reshape(-1, 2, 3) - plan.points(t)[0]) ** 2).sum(axis=2))
    size = max(surface.size for surface in scene.surfaces)
    worst, limit = off.max(), tolerance * (size + scene.path_length(t))
    if worst <= limit:
        return
    i, side = divmod(int(np.argmax(off)), 2)
    raise SceneError(
        f"{scene.title}, {scene.contact_title(i)}: integrated to t = {t:.6g} s its point on the "
        f"{SIDES[side]} is {worst:.2g} m off the exact plan, and "
        f"{limit:.2g} m is allowed: the integrator does not control this planner's error, "
        "or not enough; use error control with a smaller accuracy, such as 1e-8 (not cenic, which "
        "controls the plant's alone), or smaller steps; or PlanSource(plan(scene)), exact under "
        "every scheme; or allow more with ContactPlanner(scene, tolerance=...); or, if the Context "
        "was given another state on the way, call Simulator.Initialize() first"
    )


def refuse_singularity(system: SceneSystem, t: Array, x: Array, w: Array, held: Array) -> None:
    """Raise the error for the contact that is nearest to a singular point of its chart."""
    scene, time = system.scene, float(t[0])
    values = system.evaluate("regularity", time, x, w, held).reshape(-1, 2)
    i, side = divmod(int(np.argmin(values)), 2)
    surface = scene.object if side else scene.contacts[i].finger
    where = surface.chart.singular_at or "pole"
    remedy = 'use coordinates="frame" (of ContactPlanner, or [drake]), which has no such points'
    remedy += ", or smaller steps if the motion does not lead there"
    if system.coordinates == "frame":
        remedy = "move the contact away from that point, or turn the body's axes"
    raise ChartSingularity(
        f"{scene.title}, {scene.contact_title(i)}, {SIDES[side]}: at t = {time:.6g} "
        f"s the contact is {values[i, side]:.2g} of the body's size from a singular point of the "
        f"chart of {surface!r} ({where}): less than {CLEARANCE:g}, or beyond it; {remedy}"
    )


def refuse(system: SceneSystem, t: Array, x: Array, w: Array, held: Array) -> None:
    """Raise the error that tells why states, disturbances or derivatives are not integrated."""
    scene, time = system.scene, float(t[0])
    sigma = float(scene.speeds(time).min())
    if sigma < 0:
        raise SceneError(
            f"{scene.title}: sigma = {sigma:.6g} m/s at t = {time:.6g} s is negative; the "
            f"scene runs from 0 to {scene.duration:g} s: simulate no further, or change the profile"
        )
    for i, part in enumerate(system.state_slices):
        for name, value in (("state", x[part]), ("disturbance", w[6 * i : 6 * i + 6])):
            if not np.isfinite(value).all():
                raise SceneError(
                    f"{scene.title}, {scene.contact_title(i)}: the {name} at t = {time:.6g} s is "
                    f"{value.tolist()}; it must be finite. Check what sets it"
                )
    for i in range(len(w) // 6):
        if w[6 * i : 6 * i + 4].any():
            refuse_rest(scene, i, time, time)
    if not system.evaluate("clearance", time, x, w, held)[0] > CLEARANCE:
        refuse_singularity(system, t, x, w, held)
    rates = system.evaluate("derivatives", time, x, w, held)
    worst = [float(np.abs(rates[part]).max()) for part in system.state_slices]
    i = int(np.argmax(worst))  # of NaNs the first
    raise ChartSingularity(
        f"{scene.title}, {scene.contact_title(i)}: at t = {time:.6g} s (sigma = {sigma:.6g} m/s) "
        f"derivatives are as large as {worst[i]:.3g}: the contact is at a pole, an acceleration "
        "acts while sigma = 0, or the steps are too long for the integrator. Move the contact, "
        "raise sigma, or take smaller steps"
    )
