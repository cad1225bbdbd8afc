"""The laws that judge a plan in the stress bench. No plan is judged by another plan of ours:

========================  =========================================================================
law                       how it is written here
========================  =========================================================================
on the surface            level functions of `stress_scenes`
speed                     |M1 q1'| = sigma |W1|,  |M2 q2'| = sigma |W - V exp(-L)|
slip                      v_rel = sigma exp(-L) V in closed form, length and angle to R_psi M1 q1'
no slip part              R_psi M1 q1' - M2 q2' = v_rel from states; material points in the twist
no spin                   omega . n = 0; normals turn with the bodies (`_twist`)
frames                    pose orthonormal, contact points meet, normals oppose
geodesics                 plane, cylinder, sphere: closed form; quadrics: Joachimsthal's integral
                          (x A A x)(p A p), in which Jacobi's and Clairaut's are contained; torus:
                          Clairaut
motion, anywhere          x(b) - x(a) = int x' dt, and D(M q'/sigma)/dt = (forcing + lam v_rel)/
                          sigma with parallel transport in space, as Gauss sums over short panels
========================  =========================================================================

Bounds. A plan's tolerance bounds the error of contact points over the body's size. Rounding adds
64 eps, and 8 eps for each radian that the path can turn (after many revolutions arc length and
coordinates have so many digits less). The sum is e. The error of directions and normals is greater
by kappa, size times greatest curvature, and that of results from chart coordinates by
size / (least Lame coefficient), which is large at a pole. Each law below states its multiple.
"""

from __future__ import annotations

import functools
import itertools
import math
import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial import polynomial as poly
from numpy.polynomial.legendre import leggauss
from oracles.formulas import reflection

import contact_system as cs

from .stress_scenes import DISTURBANCES, EPS, Array, Body, Trial

NODES, WEIGHTS = leggauss(10)
NAN = math.nan


@dataclass(frozen=True)
class Verdict:
    """How a case ended.

    "right": every error within its bound; "refused": a clear error of the package; "silent": wrong,
    NaN or infinite; "crash": another exception, or the end of the process; "hang". The error is the
    one nearest to its bound, or furthest beyond it; the message is what was compared, or the text
    of the refusal or exception.
    """

    outcome: str
    error: float = NAN
    bound: float = NAN
    message: str = ""


@dataclass
class Meter:
    """Compares errors with their bounds, and keeps the one with the greatest ratio."""

    law: str = "nothing compared"
    error: float = 0.0
    bound: float = math.inf
    compared: int = 0

    def see(self, law: str, error: Any, bound: Any) -> None:
        """Compare errors (any shape) with their bounds (of a shape that broadcasts)."""
        error, bound = np.broadcast_arrays(np.abs(error), np.asarray(bound, dtype=float))
        if not error.size:
            return
        self.compared += 1
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = error / np.maximum(bound, 1e-300)
        k = int(np.argmax(np.where(np.isnan(ratio), np.inf, ratio)))
        if not ratio.flat[k] <= self.error / self.bound:
            self.law, self.error = law, float(error.flat[k])
            self.bound = max(float(bound.flat[k]), 1e-300)

    def verdict(self) -> Verdict:
        """Right if everything was within its bound."""
        right = self.compared > 0 and self.error <= self.bound
        return Verdict("right" if right else "silent", self.error, self.bound, self.law)


# Patterns of what a refusal must contain: the place (an object made outside a scene can name only
# its own key), the value, and a word of the remedy.
PLACE = re.compile(
    r"scene|contact|gain|profile|disturbance|Sphere|Cylinder|Torus|Ellipsoid|Quadric|Surface|"
    r"^[\w ]+(\[\d\])?( =|:| at )"
)
VALUE = re.compile(r"\d| = |nan|inf")
REMEDY = re.compile(
    r"\b(use|give|move|turn|start|end|restart|shorten|lengthen|lower|raise|make|ask|write|choose|"
    r"must|leave|change|scale|split|keep|set|plan|add|exchange|continue|check|announce|run|pass|accelerate)\b",
    re.IGNORECASE,
)


def refusal(text: str) -> Verdict:
    """ "refused" if a text names place, value and remedy, else "crash" with what is missing."""
    parts = {"the scene or contact": PLACE, "a value": VALUE, "a remedy": REMEDY}
    missing = [name for name, pattern in parts.items() if not pattern.search(text)]
    if missing:
        return Verdict("crash", message=f"the error does not name {', '.join(missing)}: {text}")
    return Verdict("refused", message=text)


# --- laws ----------------------------------------------------------------------------------------


def run(trial: Trial) -> Verdict:
    """Plan a trial and judge the plan."""
    return Judge(trial, cs.plan(trial.scene, trial.tolerance)).verdict()


def left_over(sigma: Array, gain: cs.Gain, t: Array) -> Array:
    """|v_rel| at t (n,) over |v_rel/sigma| at 0: sigma exp(-L) of the gain laws, m/s."""
    if gain.law == "path":
        energy = poly.polyint(poly.polymul(sigma, sigma))
        lost = gain.value * poly.polyval(t, energy)
        return poly.polyval(t, sigma) * np.exp(-np.maximum(lost, 0.0))
    left = np.exp(-gain.value * t)
    if gain.law == "time":
        return left * poly.polyval(t, sigma)
    # guaranteed: slip keeps its size while sigma grows and shrinks with it
    return left * _fallen(sigma, t)


def _fallen(sigma: Array, t: Array) -> Array:
    """sigma(0) times the factors by which sigma falls, where it falls, until t (n,)."""
    slope, end = np.trim_zeros(poly.polyder(sigma), "b"), float(t.max())
    roots = poly.polyroots(slope) if len(slope) > 1 else np.array([])
    turns = (float(r.real) for r in roots if abs(r.imag) < 1e-6 * end and 0 < r.real < end)
    knots = np.array([0.0, *sorted(turns)])
    values, now = (np.maximum(poly.polyval(at, sigma), 0.0) for at in (knots, t))
    left = [values[0]]
    for before, after in itertools.pairwise(values):
        left.append(left[-1] * (min(1.0, after / before) if before > 0 else 1.0))
    k = np.searchsorted(knots, t, side="right") - 1
    shrunk = np.minimum(now, values[k]) / np.maximum(values[k], 1e-300)
    return np.array(left)[k] * np.where(values[k] > 0, shrunk, 1.0)


@dataclass
class Sample:
    """Results of a plan at times where states exist; pairs are for finger and object."""

    t: Array  # (n,)
    states: Array  # (n, 9)
    x: tuple[Array, Array]  # contact points (n, 3)
    frame: tuple[Array, Array]  # (n, 3, 3)
    root: tuple[Array, Array]  # M of the chart (n, 2, 2)

    def part(self, where: slice) -> Sample:
        """The sample at some of its times."""
        own = ((a[where], b[where]) for a, b in (self.x, self.frame, self.root))
        return Sample(self.t[where], self.states[where], *own)

    @functools.cached_property
    def turn(self) -> Array:
        """R_psi (n, 2, 2)."""
        return reflection(self.states[:, 8])

    @functools.cached_property
    def rate(self) -> list[Array]:
        """Velocities of the contact points in space, (n, 3) each."""
        return [self.space(k, self.plane(k)) for k in (0, 1)]

    def plane(self, k: int) -> Array:
        """M q' in the contact frame, (n, 2)."""
        return np.einsum("nij,nj->ni", self.root[k], self.states[:, 4 * k + 2 : 4 * k + 4])

    def space(self, k: int, plane: Array) -> Array:
        """Components in a contact frame as vectors in space, (n, 3)."""
        return np.einsum("nij,nj->ni", self.frame[k][:, :, :2], plane)


class Judge:
    """Compares one plan with the laws."""

    def __init__(self, trial: Trial, plan: cs.Plan):
        self.trial, self.plan, self.scene = trial, plan, trial.scene
        self.bodies = (trial.finger, trial.object)
        self.meter, self.random = Meter(), np.random.default_rng(trial.seed)
        contact = self.scene.contacts[0]
        given = contact.object_velocity
        self.w1 = np.array(contact.finger_velocity, dtype=float)
        self.w2 = reflection(contact.angle) @ self.w1
        start = {"rolling": self.w2, "rest": np.zeros(2)}
        self.v = self.w2 - (start[given] if isinstance(given, str) else np.array(given))
        self.sigma = np.array(self.scene.profile.coefficients)
        self.windows = [(d.start, d.stop) for d in self.scene.disturbances]
        self.quiet = min([a for a, _ in self.windows], default=math.inf)
        self.speed = float(self._sigma(np.linspace(0, self.scene.duration, 33)).max())
        # Rounding of sigma is relative to this sum, as its terms cancel near its zeros.
        self.terms = float(poly.polyval(self.scene.duration, abs(self.sigma)))
        clear = np.where(abs(self.sigma) > 1e-30 * abs(self.sigma).max(), self.sigma, 0.0)
        self.roots = poly.polyroots(np.trim_zeros(clear, "b"))
        path = poly.polyval(self.scene.duration, poly.polyint(self.sigma))
        reach = path * (np.hypot(*self.w1) + np.hypot(*self.v))
        if self.windows:  # disturbances of `stress_scenes` make a path at most so much longer
            reach *= 10
        turns = [reach * b.kappa / b.size for b in self.bodies]
        self.e = [plan.tolerance + EPS * (64 + 8 * x) for x in turns]

    def verdict(self) -> Verdict:
        """The verdict of all laws together."""
        if max(self.e) - self.plan.tolerance > 1e-3:
            return Verdict("silent", message="planned, though no digit of a point can be known")
        times = self._times()
        everywhere = self.plan.points(times)[:, 0]
        self._on_surfaces(everywhere)
        sample, gaps = self.sample(times)
        for text in gaps:
            if (found := refusal(text)).outcome != "refused":
                return found
        if len(sample.t):
            self._states(sample)
            self._pose(sample)
            self._slip(sample)
        self._geodesics(times, everywhere, sample)
        self._short_panel(sample)
        return self.meter.verdict()

    # -- results of the plan

    def _times(self) -> Array:
        end = self.scene.duration
        drawn = self.random.uniform(0, end, 4)
        layer = 10 ** self.random.uniform(-14, 0, 2) * end
        edges = [e for w in self.windows for e in w]
        return np.unique([0.0, *drawn, *layer, *edges, *self.trial.special, end])

    def sample(self, times: Array) -> tuple[Sample, list[str]]:
        """The plan at the times where states exist, and its errors' texts at the others."""
        gaps: list[str] = []
        try:
            states = self.plan.states(times)[:, 0]
        except cs.ChartSingularity:
            kept, rows = [], []
            for t in times:
                try:
                    rows.append(self.plan.states([t])[0, 0])
                    kept.append(t)
                except cs.ChartSingularity as error:
                    gaps.append(str(error))
            times, states = np.array(kept), np.array(rows).reshape(-1, 9)
        self.meter.see("finite states", np.where(np.isfinite(states), 0.0, math.inf), 1.0)
        points = self.plan.points(times)[:, 0]
        parts: list[tuple[Array, ...]] = []
        for k, body in enumerate(self.bodies):
            q = states[:, 4 * k : 4 * k + 2].T
            parts.append((points[:, k], body.surface.frame(*q), body.surface.metric_root(*q)))
        return Sample(times, states, *zip(*parts)), gaps

    def _sigma(self, t: Array) -> Array:
        return poly.polyval(t, self.sigma)

    def _left(self, t: Array) -> Array:
        return left_over(self.sigma, self.scene.gain, t)

    # -- laws

    def _chart_loss(self, sample: Sample, k: int) -> Array:
        """Relative rounding error of what follows from chart coordinates, (n,)."""
        body, q = self.bodies[k], sample.states[:, 4 * k : 4 * k + 2]
        root = sample.root[k]
        least = np.minimum(root[:, 0, 0], root[:, 1, 1])
        # Rounding of coordinates in metres grows with the distance from the chart's origin.
        reach = 1 + np.abs(q).max(axis=1) * np.maximum(1.0, np.minimum(1.0, least / body.size))
        return 64 * EPS * reach * np.maximum(1.0, body.size / least)

    def loss(self, sample: Sample, k: int) -> Array:
        """Bound of the error of a unit vector in space that follows from states, (n,)."""
        return 4 * self.bodies[k].kappa * self.e[k] + self._chart_loss(sample, k)

    def _on_surfaces(self, points: Array) -> None:
        for k, body in enumerate(self.bodies):
            x = points[:, k]
            level, slope, _ = body.shape.derived(x)
            away = level / np.linalg.norm(slope, axis=1)
            scale = body.size + np.linalg.norm(x, axis=1)
            self.meter.see(f"point {k + 1} on its surface", away, self.e[k] * scale)

    def _states(self, sample: Sample) -> None:
        """Coordinates give the contact points, and rates their speeds by the exact law."""
        # An edge belongs to the window that starts there.
        sigma, still = self._sigma(sample.t), sample.t < self.quiet
        for k, (body, w) in enumerate(zip(self.bodies, self._path_velocities(sample.t))):
            where = body.surface.point(*sample.states[:, 4 * k : 4 * k + 2].T)
            size = body.size + np.linalg.norm(where, axis=1)
            bound = (2 * self.e[k] + self._chart_loss(sample, k)) * size
            away = np.linalg.norm(where - sample.x[k], axis=1)
            self.meter.see(f"f(u{k + 1}, v{k + 1}) is point {k + 1}", away, bound)
            speed = np.hypot(*sample.plane(k).T)  # hypot does not underflow
            bound = self.loss(sample, k) * (sigma + 1e-3 * self.terms) + 16 * EPS * self.terms
            bound *= 1 + np.hypot(*self.v)
            self.meter.see(f"speed of contact point {k + 1}", (speed - w)[still], bound[still])

    def _path_velocities(self, t: Array) -> tuple[Array, Array]:
        """|M1 q1'| and |M2 q2'| while nothing disturbs, m/s."""
        own = self._sigma(t) * np.hypot(*self.w1)
        difference = self._sigma(t)[:, None] * self.w2 - self._left(t)[:, None] * self.v
        return own, np.hypot(*difference.T)

    def _pose(self, sample: Sample) -> None:
        """Frames are orthonormal, points meet, normals oppose, the heading is psi."""
        pose, twist = self.plan.pose(sample.t)[:, 0], self.plan.twist(sample.t)[:, 0]
        rotation, origin = pose[:, :3, :3], pose[:, :3, 3]
        square = np.einsum("nji,njk->nik", rotation, rotation) - np.eye(3)
        self.meter.see("pose orthonormal", square, 4 * sum(self.e))
        x1, x2 = sample.x
        reach = sum(np.linalg.norm(x, axis=1) for x in (x1, x2, origin))
        met = np.einsum("nij,nj->ni", rotation, x1) + origin - x2
        self.meter.see("contact points meet", met, sum(self.e) * reach[:, None])
        n1, n2 = (b.normal(x) for b, x in zip(self.bodies, sample.x))
        n1 = np.einsum("nij,nj->ni", rotation, n1)
        loss = [self.loss(sample, k) for k in (0, 1)]
        self.meter.see("normals oppose", n1 + n2, sum(loss)[:, None])
        flip = np.zeros((len(sample.t), 3, 3))
        flip[:, :2, :2], flip[:, 2, 2] = sample.turn, -1.0
        expected = sample.frame[1] @ flip @ sample.frame[0].transpose(0, 2, 1)
        self.meter.see("pose against psi", rotation - expected, 4 * sum(loss)[:, None, None])
        self._twist(sample, twist, pose, n2, loss)

    def _twist(self, sample: Sample, twist: Array, pose: Array, n2: Array, loss: list) -> None:
        """No spin; material points in contact move by slip alone; normals turn with the bodies."""
        omega, v = twist[:, :3], twist[:, 3:]
        # Rates of normals, and the scale of their errors: a body's normal turns by at most
        # |x'| kappa / size; errors of speeds are relative to the greatest one.
        change = [b.turning(x, r)[1] for b, x, r in zip(self.bodies, sample.x, sample.rate)]
        fast = sum(
            (np.linalg.norm(r, axis=1) + 1e-3 * self.terms) * b.kappa / b.size
            for b, r in zip(self.bodies, sample.rate)
        )
        bound = 8 * sum(loss) * (fast + np.linalg.norm(omega, axis=1))
        self.meter.see("no spin", np.sum(omega * n2, 1), bound)
        turned = np.cross(omega, n2) - change[1]
        turned -= np.einsum("nij,nj->ni", pose[:, :3, :3], change[0])
        self.meter.see("normals turn with the bodies", turned, bound[:, None])
        slip, arm = sample.space(1, self.plan.slip(sample.t)[:, 0]), sample.x[1] - pose[:, :3, 3]
        point = v + np.cross(omega, arm)
        reach = sum(np.linalg.norm(x, axis=1) for x in (*sample.x, pose[:, :3, 3]))
        rounding = sum(self.e) * fast * reach + loss[1] * np.linalg.norm(slip, axis=1)
        self.meter.see("twist has slip alone", point + slip, 8 * rounding[:, None])

    def _slip(self, sample: Sample) -> None:
        """Slip against its law, slip from states, and the direction of slip."""
        slip = self.plan.slip(sample.t)[:, 0]
        length, still = np.linalg.norm(slip, axis=1), sample.t < self.quiet
        law = self._left(sample.t) * np.hypot(*self.v)
        floor = 64 * EPS * self.terms * (1 + np.hypot(*self.v))
        self.meter.see("slip law", (length - law)[still], floor)
        finger, obj = sample.plane(0), sample.plane(1)
        rolled = np.einsum("nij,nj->ni", sample.turn, finger)
        scale = np.linalg.norm(finger, axis=1) + np.linalg.norm(obj, axis=1)
        bound = sum(self.loss(sample, k) for k in (0, 1)) * scale + floor
        self.meter.see("slip of states", rolled - obj - slip, bound[:, None])
        # V and W2 are constant in one parallel frame: slip keeps its angle to R_psi M1 q1'.
        c, s = self.w2 @ self.v, self.w2[0] * self.v[1] - self.w2[1] * self.v[0]
        carried = np.array([[c, -s], [s, c]]) @ rolled.T / (self.w2 @ self.w2)
        carried *= self._left(sample.t) / np.maximum(self._sigma(sample.t), 1e-300)
        clear = still & (self._sigma(sample.t) > 1e-9 * self.speed)
        self.meter.see("direction of slip", (slip - carried.T)[clear], bound[clear, None])

    def _geodesics(self, times: Array, everywhere: Array, sample: Sample) -> None:
        """Closed forms and first integrals of the curves that are geodesics."""
        kinds = [type(d) for d in self.scene.disturbances]
        free = (cs.FingerAcceleration not in kinds, not kinds and not self.v.any())
        path = poly.polyval(times, poly.polyint(self.sigma))
        for k, (body, w) in enumerate(zip(self.bodies, (self.w1, self.w2))):
            if not free[k]:
                continue
            frame, x = body.surface.frame(*body.at), body.surface.point(*body.at)
            exact = body.geodesic(x, frame[:, :2] @ w, path)
            if exact is not None:
                error = np.linalg.norm(everywhere[:, k] - exact, axis=1)
                bound = 2 * self.e[k] * (body.size + np.linalg.norm(exact, axis=1))
                self.meter.see(f"geodesic {k + 1} in closed form", error, bound)
            elif body.shape.integral and len(sample.t):
                self._integral(k, body, sample, x, frame[:, :2] @ w)

    def _integral(self, k: int, body: Body, sample: Sample, x: Array, p: Array) -> None:
        clear = self._sigma(sample.t) > 1e-9 * self.speed
        sigma = self._sigma(sample.t[clear])
        along = sample.rate[k][clear] / sigma[:, None]
        value, by_x, by_p = body.shape.integral(sample.x[k][clear], along)
        first, from_x, from_p = body.shape.integral(x[None], p[None])
        # dividing the rate by sigma adds the rounding of sigma
        loss = self.loss(sample, k)[clear] + 16 * EPS * self.terms / sigma
        bound = 4 * self.e[k] * body.size * (by_x + from_x) + loss * (by_p + from_p)
        self.meter.see(f"integral of geodesic {k + 1}", value - first, bound)

    # -- the equations of motion over short panels

    def _short_panel(self, sample: Sample) -> None:
        """The equations of motion over a short panel, from a random one of the sample's times."""
        count = len(sample.t)
        panel = self._panel(sample, int(self.random.integers(0, count))) if count else None
        if panel is None:
            return
        t, acting = panel
        inside, gaps = self.sample(t)
        if not gaps and (self._sigma(t) > 1e-9 * self.speed).all():
            self._balance(inside, 0.5 * WEIGHTS * (t[-1] - t[0]), acting)

    def _panel(self, sample: Sample, k: int) -> tuple[Array, list] | None:
        """Ends and nodes of the panel from time k of the sample, and the disturbances in it."""
        here, begin = sample.part(slice(k, k + 1)), float(sample.t[k])
        acting = [d for d in self.scene.disturbances if d.start <= begin < d.stop]
        edges = [e for w in self.windows for e in w] + [self.scene.duration]
        later = [e for e in edges if e > begin]
        length = min(min(later) - begin, self._resolved(here, acting)) if later else 0.0
        if length <= 1e-6 * begin or length < 1e-290:
            return None
        # An edge belongs to the interval that starts there, so the panel ends before it.
        return begin + 0.999 * length * np.array([0.0, *(0.5 * (1 + NODES)), 1.0]), acting

    def _resolved(self, here: Sample, acting: list) -> float:
        """A length, s, of panels over which no quantity changes by more than a part of itself."""
        t, rates = here.t[0], [1e-300]
        sigma = float(self._sigma(t))
        fast = [float(np.linalg.norm(r)) + self.speed for r in here.rate]
        rates += [5 * f * b.kappa / b.size for f, b in zip(fast, self.bodies)]
        if sigma > 0 and not self._gone(float(self._left(here.t)[0]) / sigma):
            # zeros of sigma, by which the laws divide, and extrema, where law `guaranteed` changes
            knots = [*self.roots, *self.scene.profile.extrema(0, self.scene.duration)]
            rates += [5 / max(abs(t - x), 1e-300) for x in knots]
            rates.append(self._stiffness(t, 1 / max(rates)))
        for d in acting:
            body = self.bodies[0 if isinstance(d, cs.FingerAcceleration) else 1]
            rates.append(5 * math.sqrt(float(np.hypot(*d.value)) * body.kappa))
        if acting:
            for k, f in enumerate(fast):
                least = np.min(np.diagonal(here.root[k][0]))
                rates.append(5 * f / least)
        return 1 / max(rates)

    def _stiffness(self, t: float, length: float) -> float:
        """1/length of a panel from t, not longer than given, on which lam times length is <= 2."""
        while True:
            ahead = np.linspace(t, min(t + length, self.scene.duration), 5)
            lam = float(np.max(self.scene.gain.rate(self.scene.profile, ahead)))
            if not lam * length > 2:
                return 1 / length
            length /= 4

    def _gone(self, left: float) -> bool:
        """Whether slip is zero but for rounding, and no disturbance makes any."""
        return not self.windows and (not self.v.any() or left < 1e-18)

    def _balance(self, sample: Sample, weights: Array, acting: list) -> None:
        """The integrals of x' and D(M q'/sigma)/dt are the changes of x and M q'/sigma."""
        sigma = self._sigma(sample.t)
        gain = self.scene.gain.rate(self.scene.profile, sample.t)
        if self._gone(float(self._left(sample.t[:1])[0] / sigma[0])):
            gain = 0 * gain  # a large gain would make a force of slip that is only rounding
        given = {kind: np.zeros(2) for kind in DISTURBANCES}
        for d in acting:
            given[type(d)] = given[type(d)] + d.value
        forces = [given[cs.FingerAcceleration], given[cs.ObjectAcceleration]]
        velocity = [sample.plane(0), sample.plane(1) - sample.root[1] @ given[cs.ObjectRateOffset]]
        slip = np.einsum("nij,nj->ni", sample.turn, velocity[0]) - velocity[1]
        for k, body in enumerate(self.bodies):
            push = sample.root[k] @ forces[k] + (gain[:, None] * slip if k else 0.0)
            path = sample.space(k, velocity[k]) / sigma[:, None]
            n, turned = body.turning(sample.x[k], sample.rate[k])
            bent = n * np.sum(turned * path, 1, keepdims=True)
            change = sample.space(k, push) / sigma[:, None] - bent
            loss = float(self.loss(sample, k).max())
            moved = weights @ np.linalg.norm(sample.rate[k][1:-1], axis=1)
            reach = body.size + np.linalg.norm(sample.x[k][0])
            error = sample.x[k][-1] - sample.x[k][0] - weights @ sample.rate[k][1:-1]
            bound = 4 * self.e[k] * reach + loss * moved
            self.meter.see(f"point {k + 1} moves by its rate", error, bound)
            # errors of velocities times lam add to the change of the path velocity
            stiff = weights.sum() * gain.max()
            scale = np.linalg.norm(path, axis=1).max() + np.hypot(*self.w1)
            other = float(self.loss(sample, 0).max()) if k else 0.0
            error = path[-1] - path[0] - weights @ change[1:-1]
            unsure = self.terms / sigma.min() * EPS * 64  # relative rounding of sigma, the divisor
            bound = 8 * (loss + other + unsure) * scale * (1 + stiff)
            self.meter.see(f"path velocity {k + 1} obeys its equation", error, bound)
