"""What an integrator must not change: the exact laws of contact speed and slip, watched.

An explicit scheme whose step is too long for the gain makes slip grow without end, and one that is
too long for the motion makes contacts too fast; neither need ever meet a number that is not
finite. While nothing accelerates a contact (theory sections 3, 4)

    |M1 q1'| / sigma  is constant,      |v_rel| / sigma  never grows,

and accelerations d1, d2 add at most the integral of (|M1 d1| + |M2 d2|) / sigma.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_system import SceneSystem
from contact_system.errors import SceneError
from contact_system.scene import Scene
from contact_system.theory import symbols as ca
from contact_system.theory.profile import polynomial

Array = NDArray[np.float64]

TOLERANCE = 0.25
"""Of the path speed and the slip that there are at first."""
WATCHED = 0.01
"""The part of the tolerance from which on every step is looked at."""
STANDING = 1e-6
"""The part of the greatest sigma below which its quotients say nothing."""
SPREAD = 3.0
"""By how much Lame coefficients may grow until limits follow, for an accelerated contact."""


MANY = 4096
"""So many steps in a row are refused, each shorter than a `MOST`-th of what is left of a scene."""
MOST = 2e7
"""Steps; the whole would take more than a quarter of an hour."""


class StepWatch:
    """How fast a simulation comes on; error control may ask for steps of 1e-9 s all the way."""

    def __init__(self, scene: Scene):
        self.scene, self.count, self.short, self.last = scene, 0, 0, 0.0

    def step(self, t: float) -> str:
        """Note a step that ends at t; what is wrong where the end will never be reached, or ""."""
        length, left = t - self.last, self.scene.duration - t
        self.count, self.last = self.count + 1, t
        self.short = self.short + 1 if 0.0 < length * MOST < left else 0
        if self.short < MANY:
            return ""
        self.short = 0
        return (
            f"{self.scene.title}: at t = {t:.6g} s the integrator takes steps of "
            f"{length:.2g} s, and the scene ends at {self.scene.duration:g} s; "
        )


class Limits(NamedTuple):
    """What speed and slip may become, relative to sigma, in one simulation of n contacts.

    Attributes
    ----------
    speed, slip : (n)
        |M1 q1'| / sigma and |v_rel| / sigma at first.
    stretch : (n, 2)
        The greatest that `SceneSystem.function` gives on the way, of finger and object.
    pushes : (n, 2)
        What `pushes` gives.
    """

    speed: Array
    slip: Array
    stretch: Array
    pushes: Array

    @property
    def forced(self) -> Array:
        """How much the scene's accelerations can change W and V at most: (n)."""
        return SPREAD * (self.pushes * self.stretch).sum(axis=1)

    @property
    def off(self) -> Array:
        """How far from its first value a speed is too far: (n)."""
        return TOLERANCE * self.speed + self.forced

    @property
    def most_slip(self) -> Array:
        """The greatest |v_rel| / sigma: (n)."""
        return self.slip + TOLERANCE * (self.speed + self.slip) + self.forced

    def widened(self, stretch: Array) -> Limits:
        """The limits once a contact has been where its charts are stretched so much."""
        return self._replace(stretch=np.fmax(self.stretch, stretch))

    @property
    def unknown(self) -> bool:
        """Whether they were taken from a contact at rest, where sigma is 0."""
        return not np.isfinite(self.speed).all()

    def begun(self, speed: Array, slip: Array) -> Limits:
        """The limits of contacts that have left a rest."""
        return self._replace(speed=speed, slip=slip)

    def near(self) -> Array:
        """Limits well within these, as `pace_function` takes them: (5 n)."""
        if self.unknown:  # look at every step
            return np.full(5 * len(self.speed), -np.inf)
        less = (1 - WATCHED) * TOLERANCE * self.speed
        off, slip = self.off - less, self.most_slip - less
        return np.concatenate(
            [self.speed - off, self.speed + off, slip, SPREAD * self.stretch.ravel()]
        )


def has_invariants(system: SceneSystem) -> bool:
    """Whether an integrator could break the laws and what disturbs them is known beforehand."""
    integrated = system.coordinates == "chart" or any(form.forced for form in system.forms)
    return integrated and not system.disturbance_input


def pace_function(system: SceneSystem) -> ca.Function:
    """(t, x, w, held, p, limits) -> derivatives, guard, clearance, excess, speed, slip, stretch.

    The first three and the last are those of `SceneSystem.function`. Limits are those of
    `Limits.near`: least and most speed, slip (n each), stretch (2 n). Excess (1) is positive where
    one of them is passed; speed and slip (n each) are relative to sigma. Object rate offsets are no
    part of the slip that the equations feed back (theory section 7), so w is zero here.
    """
    n = len(system.scene.contacts)
    core = system.function("derivatives", "guard", "clearance")
    names = ("derivatives", "slip", "contact_point", "stretch")
    state, slip, points, stretch = (system.function(name) for name in names)
    symbols = [ca.SX.sym(core.name_in(i), core.size1_in(i)) for i in range(core.n_in())]
    t, x, w, held, p = symbols
    resting = [t, x, ca.SX.zeros(w.numel()), held, p]
    moved = ca.reshape(ca.jtimes(points(*resting), x, state(*resting)), 6, n)[:3, :]
    coefficients = p[1 : 1 + len(system.scene.profile.coefficients)]
    sigma = polynomial(ca.vertsplit(coefficients), t)
    speed = ca.sqrt(ca.sum1(moved**2)).T / sigma
    slipping = ca.sqrt(ca.sum1(ca.reshape(slip(*resting), 2, n) ** 2)).T / sigma
    stretched = stretch(*resting)
    limits = ca.SX.sym("limits", 5 * n)
    least, most, slipped, reach = ca.vertsplit(limits, [0, n, 2 * n, 3 * n, 5 * n])
    excess = ca.mmax(ca.vertcat(least - speed, speed - most, slipping - slipped, stretched - reach))
    outputs = [*core(*symbols), excess, speed, slipping, stretched]
    dense = [ca.densify(value) for value in ca.cse(outputs)]
    return ca.Function("scene_pace", [*symbols, limits], dense)


def no_limits(system: SceneSystem) -> Array:
    """Limits for contacts of which nobody knows how they started: (5 n)."""
    n = len(system.scene.contacts)
    return np.concatenate([np.full(n, -np.inf), np.full(4 * n, np.inf)])


def stiffness(system: SceneSystem) -> float:
    """The greatest rate, of the gain or of sigma, in the scene and as long after it, 1/s."""
    profile, gain = system.scene.profile, system.scene.gain
    t = np.linspace(0.0, 2 * system.scene.duration, 201)
    sigma = profile(t)
    t, sigma = t[sigma > 0], sigma[sigma > 0]
    return float(np.max(gain.rate(profile, t) + np.abs(profile.rate(t)) / sigma))


def pushes(system: SceneSystem) -> Array:
    """The integral of |d| / sigma over the scene's accelerations, of finger and object: (n, 2)."""
    scene, found = system.scene, np.zeros((len(system.scene.contacts), 2))
    for d in scene.disturbances:
        if not d.accelerates:
            continue
        times = np.linspace(d.start, d.stop, 101)
        slowness = (d.stop - d.start) * np.mean(1.0 / np.maximum(scene.profile(times), 1e-300))
        side = 0 if d.side == "finger" else 1
        found[int(d.contact), side] += np.linalg.norm(d.value) * slowness
    return found


def stands(scene: Scene, t: float) -> bool:
    """Whether sigma is too small for what is relative to it."""
    most = scene.profile(np.linspace(0, scene.duration, 101)).max()
    return scene.profile(t) <= STANDING * most


def refuse_pace(system: SceneSystem, t: float, limits: Limits, speed: Array, slip: Array) -> None:
    """Raise where a speed or a slip is beyond its limit.

    Raises
    ------
    SceneError
        It is the integrator that cannot take steps as long as these.
    """
    scene, sigma = system.scene, system.scene.profile(t)
    steady = np.abs(speed - limits.speed) <= limits.off
    fine = steady & (slip <= limits.most_slip)
    if fine.all() or stands(scene, t):
        return
    i = int(np.argmin(fine))
    most = sigma * limits.most_slip[i]
    found = f"slips at {sigma * slip[i]:.4g} m/s; at most {most:.4g} is possible"
    if not steady[i]:
        found = f"moves at {sigma * speed[i]:.4g} m/s instead of {sigma * limits.speed[i]:.4g}"
    remedy = "use smaller steps, an implicit scheme, or error control with a smaller accuracy"
    if system.coordinates == "chart":
        remedy += ', or ContactPlanner(scene, coordinates="frame"), which is less stiff'
    raise SceneError(
        f"{scene.title}, contact {i}: integrated to t = {t:.6g} s it {found}: the steps "
        f"are too long for this integrator; {remedy}; or, if the Context was given another state "
        "on the way, call Simulator.Initialize() first"
    )
