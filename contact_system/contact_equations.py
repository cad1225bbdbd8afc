r"""One contact as a CasADi function: its derivatives and outputs.

`contact_system.system` explains the coordinates "chart" and "frame" and the functions' arguments,
and makes a system of all contacts of a scene. The equations are those of `theory`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .surfaces import TINY, TURN, Surface
from .theory import symbols as ca
from .theory.development import InChart, InSpace, moving
from .theory.equations import (
    chart_rates,
    flip,
    pushed_paths,
    reflection,
    relative_pose,
    relative_twist,
    relative_velocity,
    slip_acceleration,
)
from .theory.gain import Law
from .theory.geometry import rotation
from .theory.profile import integral, polynomial, product
from .theory.symbols import per_structure


class Form(NamedTuple):
    """How the motion of one contact is written: with the surfaces, the key of its cached function.

    forced: whether W_1 and V are states. in_space: whether finger and object are moved in space.
    growths: intervals on which sigma grows, if the gain law cancels growth.
    """

    coordinates: str
    forced: bool
    in_space: tuple[bool, bool]
    law: Law
    n_profile: int
    growths: tuple[tuple[float, float], ...]

    @property
    def sizes(self) -> tuple[int, ...]:
        """Sizes of the parts of the state: finger, object, then psi, or W_1 and V if forced."""
        if self.coordinates == "chart":
            return 4, 4, 1
        finger, obj = ((InSpace if space else InChart).size for space in self.in_space)
        return (finger, obj, 2, 2) if self.forced else (finger, obj)

    @property
    def n_held(self) -> int:
        return 0 if self.coordinates == "chart" or self.forced else 5


class Body(NamedTuple):
    """One body of a contact; its numbers (sign and parameters), size and place are symbols."""

    surface: Surface
    in_space: bool
    numbers: ca.SX
    size: ca.SX
    place: ca.SX  # state of its moving frame

    def at(self, *place: ca.SX | float) -> Body:
        return self._replace(place=ca.vertcat(*place))

    def call(self, name: str, *arguments: ca.SX | float) -> ca.SX:
        """The value of a function of the moving frame (`theory.development`)."""
        function = moving(self.surface, self.in_space)(name)
        return function(ca.vertcat(self.place, *arguments), self.numbers)

    def regularity(self) -> ca.SX:
        """The least diagonal entry of M over the size: 0 where the chart is singular.

        Negative where f_u x f_v points into the body, as beyond a sphere's pole; 1 for charts that
        are regular everywhere.
        """
        surface = self.surface
        if self.in_space or surface.chart.singular_at == "":
            return ca.SX(1)
        least = self.call("lame")[2] / self.size
        if not surface.has_implicit:
            return least
        x, p, q = ca.vertsplit(self.call("frame"), 3)
        right_handed = moving(surface, True)("second")(ca.vertcat(x, p), self.numbers)  # n x p
        return ca.copysign(least, ca.dot(right_handed, q))


class ContactMotion(NamedTuple):
    """What the outputs of a contact are computed from; (p_i, q_i) are the moving frames."""

    rate: ca.SX  # derivative of the contact's part of x
    state: ca.SX  # u1 v1 u1' v1' u2 v2 u2' v2' psi
    bodies: tuple[Body, Body]
    velocities: tuple[ca.SX, ca.SX]  # of the contact point along (p_i, q_i)
    turn: ca.SX  # (2, 2), maps components along (p_1, q_1) to those along (p_2, q_2)
    sliding: ca.SX  # slip along (p_2, q_2)
    theta: ca.SX  # the angle of (p_2, q_2) in E2
    carried: ca.SX  # W_1 and V, along (p_1, q_1) and (p_2, q_2)


def _decay(form: Form, value: ca.SX, profile: list[ca.SX], since: ca.SX, t: ca.SX) -> ca.SX:
    """exp(-(L(t) - L(since))) with L as in `Gain.exponent`."""
    powers: Sequence[ca.SX] = [ca.SX(1)]
    for _ in range(form.law.power):
        powers = product(powers, profile)
    exponent = integral(powers)
    decay = ca.exp(-value * (polynomial(exponent, t) - polynomial(exponent, since)))
    for start, stop in form.growths:
        first, last = (
            ca.fmax(polynomial(profile, ca.fmin(ca.fmax(time, start), stop)), TINY)
            for time in (since, t)
        )
        decay *= first / last
    return decay


def _chart_motion(
    tip: Body, body: Body, x: ca.SX, w: ca.SX, sigma: ca.SX, slope: ca.SX, lam: ca.SX
) -> ContactMotion:
    """Motion in chart coordinates, where theta = 0; slope: sigma'."""
    q1, rate_1, q2, rate_2, psi = ca.vertsplit(x, [0, 2, 4, 6, 8, 9])
    shapes = [b.surface.geometry_expr(b.numbers, q) for b, q in ((tip, q1), (body, q2))]
    tip, body, contact_rate = tip.at(q1, 0), body.at(q2, 0), rate_2 + w[4:6]
    velocities = tip.call("vector", rate_1), body.call("vector", contact_rate)
    turn = reflection(ca.cos(psi), ca.sin(psi))
    slip = relative_velocity(turn, velocities[0], body.call("vector", rate_2))
    return ContactMotion(
        rate=chart_rates(shapes, x, slope / sigma, lam, w),
        state=ca.vertcat(x[:6], contact_rate, psi),
        bodies=(tip, body),
        velocities=velocities,
        turn=turn,
        sliding=relative_velocity(turn, *velocities),
        theta=ca.SX(0),
        carried=ca.vertcat(velocities[0], slip) / sigma,
    )


def _frame_motion(
    tip: Body, body: Body, form: Form, x: ca.SX, w: ca.SX, sigma: ca.SX, lam: ca.SX, held: ca.SX
) -> ContactMotion:
    """Motion in parallel-transported frames; held: W_1 and V."""
    w1, v = ca.vertsplit(held, 2)
    states = ca.vertsplit(x, np.cumsum([0, *form.sizes]).tolist())
    # states in space are put back on the surface
    tip, body = (
        b.at(b.at(f).call("restore") if b.in_space else f) for b, f in zip((tip, body), states)
    )
    offset = body.call("vector", w[4:6])
    velocities = sigma * w1, sigma * (flip() @ w1 - v) + offset
    rates = []
    for b, f, velocity in zip((tip, body), states, velocities):
        rates.append(b.call("motion", velocity))
        if b.in_space:  # drift off the surface decays over a path as long as a radius of curvature
            curvature = ca.sqrt(ca.sumsqr(b.call("shape")) / 2 + TINY)
            rates[-1] += sigma * curvature * (b.place - f)
    if form.forced:
        pushed = tip.call("vector", w[:2]), body.call("vector", w[2:4])
        w1_rate, v_rate = pushed_paths(ca.fmax(sigma, TINY), flip(), *pushed)
        rates += [w1_rate, v_rate - lam * v]
    first, second = (b.call("coordinates", c) for b, c in zip((tip, body), velocities))
    psi = -first[4] - second[4]
    psi -= TURN * ca.floor((psi + math.pi) / TURN)
    return ContactMotion(
        rate=ca.vertcat(*rates),
        state=ca.vertcat(first[:4], second[:4], psi),
        bodies=(tip, body),
        velocities=velocities,
        turn=flip(),
        sliding=sigma * v - offset,
        theta=second[4],
        carried=ca.vertcat(w1, v),
    )


def _outputs(
    motion: ContactMotion, t: ca.SX, x: ca.SX, w: ca.SX, sigma: ca.SX, slope: ca.SX, lam: ca.SX
) -> dict[str, ca.SX]:
    """The outputs that `SceneSystem.function` lists for each contact."""
    rate, state, (tip, body), velocities, turn, sliding, theta, carried = motion
    frames = tip.call("frame"), body.call("frame")
    shapes = tip.call("shape"), body.call("shape")

    def derivative(value: ca.SX) -> ca.SX:
        """d/dt along the motion; disturbances are constant between edges."""
        return ca.jtimes(value, x, rate) + ca.jtimes(value, t, ca.SX(1))

    twist = ca.vertcat(*relative_twist(frames, shapes, velocities, turn, sliding))
    (x1, _), (x2, tangents) = (ca.vertsplit(frame, [0, 3, 9]) for frame in frames)
    normal = ca.cross(tangents[:3], tangents[3:])
    pushed = tip.call("vector", w[:2]), body.call("vector", w[2:4])
    return {
        "derivatives": rate,
        "state": state,
        "slip": rotation(theta) @ sliding,
        "slip_acceleration": rotation(theta)
        @ slip_acceleration(carried[2:], sigma, slope, lam, turn, *pushed),
        "twist": twist,
        "acceleration": derivative(twist),
        "pose": ca.vertcat(*map(ca.vec, relative_pose(*frames, turn))),
        "contact_point": ca.vertcat(x1, x2),
        "normal": normal,
        "normal_rate": derivative(normal),
        "carried": carried,
        "regularity": ca.vertcat(tip.regularity(), body.regularity()),
    }


@per_structure
def contact_function(finger: Surface, obj: Surface, form: Form) -> ca.Function:
    """Derivatives and outputs of one contact; see `SceneSystem.function`.

    Inputs: t, x, w (6), held, law (gain, profile coefficients), numbers and size of the finger and
    of the object.
    """
    numbers = [ca.SX.sym("p", len(s.parameters) + 1) for s in (finger, obj)]
    tip, body = (
        Body(s, space, ca.vertcat(s.sign, p)[:-1], p[-1], ca.SX())
        for s, space, p in zip((finger, obj), form.in_space, numbers)
    )
    t, x, w = ca.SX.sym("t"), ca.SX.sym("x", sum(form.sizes)), ca.SX.sym("w", 6)
    held, law = ca.SX.sym("held", form.n_held), ca.SX.sym("law", 1 + form.n_profile)
    profile = ca.vertsplit(law[1:])
    sigma = polynomial(profile, t)
    slope = ca.gradient(sigma, t)
    growth = ca.fmax(0, slope / ca.fmax(sigma, TINY))
    lam = form.law.rate(law[0], sigma, growth)
    if form.coordinates == "chart":
        motion = _chart_motion(tip, body, x, w, sigma, slope, lam)
    else:
        carried = x[-4:]
        if not form.forced:
            decay = _decay(form, law[0], profile, held[4], t)
            carried = ca.vertcat(held[:2], held[2:4] * decay)
        motion = _frame_motion(tip, body, form, x, w, sigma, lam, carried)
    outputs = _outputs(motion, t, x, w, sigma, slope, lam)
    inputs = {"t": t, "x": x, "w": w, "held": held, "law": law, "p1": numbers[0], "p2": numbers[1]}
    values = [ca.densify(value) for value in ca.cse(list(outputs.values()))]
    return ca.Function("contact", [*inputs.values()], values, [*inputs], [*outputs])
