"""Shooting: Newton's method aims geodesics at points, starting from the chord or a fan of rays."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from ..checks import within
from ..engine import binding
from ..engine.binding import Followed
from ..errors import SurfaceError
from ..surfaces import Surface
from ..theory.development import in_space

if TYPE_CHECKING:
    from .geodesic import Pairs

Array = np.ndarray

MET = 1e-13  # of the size: distance from b at which a geodesic has met it
DETAIL = 0.3  # of the least radius of curvature: length over which a surface is nearly flat
NEAR = 3e-8  # of that length, and rad: from so near one step of Newton's method meets b
SHARP, ROUGH = 5e-15, 1e-4  # error of a step, of the size: on a geodesic, and on a ray of a fan
STEPS = 25  # most steps of Newton's method
RAYS = 64  # of a fan
# A strip between two rays is flat where its chord and its arcs across, by J of one ray and of both,
# differ by less than the part FLAT and its width is below the part NARROW of the size. It saves
# 12/13 of the time on a thin disk.
FLAT, NARROW = 0.02, 0.05
SPLITS = 40  # most halvings of a strip
TOGETHER = 1024  # most strips that are examined at once
FARTHEST = 30.0  # longest geodesics, in multiples of the size plus the points' distance
MOST_SIZES = 1e4  # most sizes between points; the time of a search grows with their distance


class Follower(Followed):
    """Follows geodesics of a surface from states (6 or 3, n): see ``geodesics`` in engine.h.

    space: whether states are in space, (x, p), or in the chart, (u, v, theta).
    """

    def __init__(self, surface: Surface):
        self.space = in_space(surface)
        super().__init__(
            ctypes.addressof(surface.engine_data),
            surface.tables.geodesic.address,
            binding.address(surface.numbers),
            surface.size,
            DETAIL * min(surface.least_radius, 0.5 * surface.size),
            surface.panel_limit * surface.size / 8,
        )
        self.kept = surface  # the engine points to its numbers

    def __call__(self, start: Array, length: Array, tolerance: Any, samples: int = 0) -> Array:
        """The ends: x, p, q, J, J', M, M' (13, n); or x, J at equal steps, (samples, 4, n)."""
        n, address = len(length), binding.address
        start, length = np.ascontiguousarray(start), np.ascontiguousarray(length)
        tolerance = np.full(n, tolerance)
        end, path = np.empty((13, n)), np.empty((samples, 4, n))
        arguments = address(start), address(length), address(tolerance), address(end)
        at_path = address(path) if samples else None
        if binding.geodesics(ctypes.addressof(self), n, *arguments, samples, at_path):
            raise MemoryError
        return path if samples else end


class Search:
    """The search for geodesics between pairs of points."""

    def __init__(self, pairs: Pairs):
        self.pairs, self.follow, self.surface = pairs, pairs.follow, pairs.surface
        self.detail = DETAIL * self.least_radius()
        self.examined = np.zeros(len(pairs.chord), int)  # strips of each pair
        self.lost = np.full(len(pairs.chord), math.inf)
        """For each pair the least length at which a line that was near b could not be followed."""
        farthest = float(pairs.chord.max(initial=0.0))
        if farthest > MOST_SIZES * self.surface.size:
            raise SurfaceError(
                f"{self.surface!r}: points are {farthest:.3g} m apart, and geodesics are searched "
                f"over {MOST_SIZES:g} times the size, {self.surface.size:g} m; give nearer points, "
                "or a surface of a greater size"
            )

    def least_radius(self) -> float:
        """Typical least radius of curvature, m, at most half the size.

        If that of the surface is unknown, the median of those at the points.
        """
        size, radius = self.surface.size, self.surface.least_radius
        if radius == size:  # it is unknown
            uv = np.concatenate([self.pairs.uv, self.pairs.uv_b])
            curvature = np.linalg.norm(self.surface.curvature_form(*uv.T), axis=(1, 2))
            radius = float(np.median(size / np.fmax(curvature * size, 2)))  # NaN at poles
        return min(radius, 0.5 * size)

    def shortest(self) -> tuple[Array, Array]:
        """Directions and lengths of the shortest geodesic of each pair."""
        every = np.arange(len(self.pairs.chord))
        phi, s, met, _ = self.aim(every, *self.chords(every))
        which = np.flatnonzero(~met | (s > self.surface.injectivity * (1 + 1e-12)))
        s[~met] = math.inf
        # begin with a short reach: on thin bodies the time of a fan grows fast with it
        chord = self.pairs.chord
        reach = np.where(s > 1.6 * chord, 1.2 * chord, s * (1 + 1e-6))[which]
        while len(which):
            far = reach > FARTHEST * (self.surface.size + chord[which])
            if far.any():
                k = which[far][0]
                raise SurfaceError(
                    f"{self.surface!r}: no geodesic of less than {reach[far][0]:.3g} m leads from "
                    f"{self.pairs.x[k].tolist()} to {self.pairs.b[k].tolist()}; check that both "
                    "are on one connected piece and that the shortest line does not meet an edge"
                )
            for k, direction, length, _ in zip(*self.within_reach(*self.fan(which, reach))):
                if length < s[k]:
                    phi[k], s[k] = direction, length
            missing = s[which] > reach
            which, reach = which[missing], np.minimum(1.5 * reach, s[which] * (1 + 1e-6))[missing]
        doubtful = self.lost < s * (1 - 1e-3)
        if doubtful.any():
            k = doubtful.argmax()
            raise SurfaceError(
                f"{self.surface!r}: the shortest line from {self.pairs.x[k].tolist()} to "
                f"{self.pairs.b[k].tolist()} comes too close to an edge or a pole of the chart; "
                "move an end a little, or write the surface as an ImplicitSurface"
            )
        return phi, s

    def several(self, most: int, longest: float | None) -> tuple[Array, Array]:
        """Directions and lengths of the shortest few geodesics of a single pair, in order."""
        only, size = np.zeros(1, dtype=int), self.surface.size
        if longest is None:
            longest = float(self.shortest()[1][0]) + 4 * math.pi * size
            longest *= 1 + 1e-12  # on a sphere it is just met
        reach = np.minimum(2 * self.pairs.chord, longest)
        # the chord finds a b that lies before the first sample of rays and, as it is aimed alone, a
        # line straight through a pole of a chart
        direct = self.within_reach(only, *self.chords(only), np.full(1, longest))
        while True:
            both = (
                self.within_reach(*self.fan(only, reach)),
                [w[direct[2] <= reach] for w in direct],
            )
            _, phi, s, j = map(np.concatenate, zip(*both))
            kept: list[int] = []
            for i in np.argsort(s):
                # several aims may find the same geodesic
                turns = np.remainder(phi[i] - phi[kept] + math.pi, 2 * math.pi) - math.pi
                if not (np.hypot(s[i] - s[kept], turns * j[i]) <= 1e-6 * size).any():
                    kept.append(int(i))
            if len(kept) >= most or reach[0] >= longest:
                return phi[kept], s[kept]
            reach = np.minimum(1.5 * reach, longest)

    def within_reach(self, which: Array, phi: Array, s: Array, reach: Array) -> list[Array]:
        """Geodesics that candidates lead to, if not longer than the reach: pair, phi, length, J."""
        phi, s, met, j = self.aim(which, phi, s)
        met &= s <= reach
        return [w[met] for w in (which, phi, s, j)]

    # -- aiming

    def chords(self, which: Array) -> tuple[Array, Array]:
        """Directions and lengths of arcs from a to b of circles tangent to the surface at a."""
        pairs, chord = self.pairs, self.pairs.chord[which]
        r = pairs.b[which] - pairs.x[which]
        ahead, aside = (np.einsum("ij,ij->i", w[which], r) for w in (pairs.p, pairs.q))
        rise = np.sqrt(np.maximum(chord**2 - ahead**2 - aside**2, 0))
        angle = np.arctan2(rise, np.hypot(ahead, aside))
        return np.arctan2(aside, ahead), chord / np.sinc(angle / math.pi)

    def aim(self, which: Array, phi: Array, s: Array) -> tuple[Array, Array, Array, Array]:
        """Newton's method: the directions and lengths found, whether they meet b, and J."""
        size, n = self.surface.size, len(phi)
        phi, s, off, field = phi.copy(), s.copy(), np.full(n, math.inf), np.zeros(n)
        active = np.arange(n)
        for _ in range(STEPS):
            k = which[active]
            end = self.follow(self.pairs.start(k, phi[active]), s[active], SHARP)
            lost = ~np.isfinite(end[0])
            close = active[lost & np.isfinite(off[active])]
            np.minimum.at(self.lost, which[close], s[close])
            active, k, end = active[~lost], k[~lost], end[:, ~lost]
            r, j = self.pairs.b[k].T - end[:3], end[9]
            away = np.sqrt(np.einsum("ij,ij->j", r, r))
            along, aside = (np.einsum("ij,ij->j", r, w) for w in (end[3:6], end[6:9]))
            # what is left to b is almost normal to the surface: b is beyond a thin body's rim
            over = (along**2 + aside**2 < 0.1 * away**2) & (away > NEAR * self.detail)
            along = np.where(over, np.maximum(away, self.detail), along)
            turn = aside * j / (j**2 + (1e-12 * size) ** 2)
            turn = np.maximum(np.minimum(turn, 0.5), -0.5)
            half, grown = 0.5 * s[active], self.growth(j)
            phi[active] += turn
            s[active] += np.maximum(np.minimum(along, half), -half)
            # the error after a step is the square of the one before
            close = (away <= NEAR * self.detail) & (np.abs(turn) * grown <= NEAR)
            off[active], field[active] = np.where(close, 0.0, away), j
            done = off[active] <= 0.02 * MET * size * grown
            active = active[~done]
            if not len(active):
                break
        return phi, s, off <= MET * size * self.growth(field), field

    def growth(self, field: Array) -> Array:
        """Growth of errors along geodesics with J = ``field`` at the end."""
        return np.maximum(np.abs(field) / self.surface.size, 1.0)

    # -- a fan of directions

    def fan(self, which: Array, reach: Array) -> list[Array]:
        """Candidates for geodesics to b within the reach, except where b is close to a: arrays of
        pair, direction, length, reach."""
        order = np.argsort(reach)  # fans of similar size together
        which, reach = which[order], reach[order]
        # 0.137 keeps rays off axes of symmetry, along which they would meet poles of charts
        angles = 2 * math.pi * (np.arange(RAYS) + 0.137) / RAYS
        phi, width = np.tile(angles, len(which)), np.full(RAYS * len(which), 2 * math.pi / RAYS)
        found = self.candidates(np.repeat(which, RAYS), np.repeat(reach, RAYS), phi, width)
        return [np.concatenate(w) for w in zip(*found)]

    def candidates(
        self, pair: Array, limit: Array, phi: Array, width: Array, depth: int = 0
    ) -> Iterator[tuple[Array, ...]]:
        """Candidates in strips between two rays, and in the halves of wide strips.

        A strip is a pair of points, the reach, the direction of one ray, the angle to the other:
        arrays (strips,). Along strips, numbers are (steps, strips), vectors (steps, 3, strips).
        """
        if len(pair) > TOGETHER:  # to limit memory
            for part in (slice(i, i + TOGETHER) for i in range(0, len(pair), TOGETHER)):
                yield from self.candidates(pair[part], limit[part], phi[part], width[part], depth)
            return
        self.examined += np.bincount(pair, minlength=len(self.examined))
        most = self.examined.argmax()
        what = (
            f"{self.surface!r}, least radius of curvature about {self.detail / DETAIL:.2g} m: "
            f"strips of a search for geodesics from {self.pairs.x[most].tolist()}"
        )
        within("STRIPS", self.examined[most], what, SurfaceError)
        count = int(min(max(math.ceil(limit.max() / self.detail), 8), 400))
        exact = np.minimum(0.01 * width, ROUGH)
        sides = (self.pairs.start(pair, side) for side in (phi, phi + width))
        left, right = (self.follow(side, limit, exact, count) for side in sides)  # x and J
        across = right[:, :3] - left[:, :3]
        chord = np.sqrt(np.einsum("kij,kij->kj", across, across))
        arc = width * np.abs(left[:, 3] + right[:, 3]) / 2
        wide = np.maximum(chord, width * np.maximum(np.abs(left[:, 3]), np.abs(right[:, 3])))
        alike = np.maximum(wide - arc, arc - chord) <= FLAT * arc
        flat = alike & (arc <= NARROW * self.surface.size)
        middle = 0.5 * (left[:, :3] + right[:, :3])
        r = self.pairs.b[pair].T - middle
        away = np.sqrt(np.einsum("kij,kij->kj", r, r))
        near, coarse = self.passing(away, wide, flat, limit)
        coarse &= depth < SPLITS
        k, strip, share, ahead = self.closest(near & ~coarse, away, across, r, middle)
        s = limit[strip] / count * np.maximum(k + 1 + ahead * count / limit[strip], 0.25)
        yield pair[strip], phi[strip] + width[strip] * share, s, limit[strip]
        folds = left[k, 3, strip] * right[k, 3, strip] < 0  # a caustic: two geodesics may meet b
        for side in (0.0, 1.0):
            folded = strip[folds]
            yield pair[folded], phi[folded] + side * width[folded], s[folds], limit[folded]
        if coarse.any():
            pair, limit, phi, half = (w[coarse] for w in (pair, limit, phi, 0.5 * width))
            halves = np.tile(pair, 2), np.tile(limit, 2), np.concatenate([phi, phi + half])
            yield from self.candidates(*halves, np.tile(half, 2), depth + 1)

    def passing(self, away: Array, wide: Array, flat: Array, reach: Array) -> tuple[Array, Array]:
        """Where strips pass b while they are narrow or flat, (steps, strips), and which strips must
        be split, (strips,). away: distance of their middle from b; wide: their width.

        Where a strip is too wide, its rays do not tell what is between them: split it if b is near.
        """
        parts, strips = wide.shape
        too_wide = np.maximum.accumulate(~flat & (wide > 2 * self.detail), axis=0)
        near = ~too_wide & (away <= 0.75 * (wide + reach / parts))
        first = np.argmax(too_wide, axis=0), np.arange(strips)
        left = reach * (1 - (first[0] + 1) / parts) + wide[first]
        return near, too_wide[-1] & (away[first] <= left)

    def closest(
        self, near: Array, away: Array, across: Array, r: Array, middle: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Closest passages of strips to b: step, strip, fraction of the width, length past step,
        each (passages,). r: from the strips' middle to b."""
        padded = np.pad(away, ((1, 1), (0, 0)), constant_values=math.inf)
        k, strip = np.nonzero(near & (away <= padded[:-2]) & (away <= padded[2:]))
        a, r = across[k, :, strip], r[k, :, strip]
        wide = np.maximum(np.sqrt(np.einsum("ij,ij->i", a, a)), 1e-300)
        aside = np.einsum("ij,ij->i", a, r) / wide
        # else b belongs to a neighbouring strip
        inside = np.abs(aside) <= 0.75 * wide + 0.2 * self.detail
        k, strip, r, share = k[inside], strip[inside], r[inside], 0.5 + (aside / wide)[inside]
        low = np.minimum(np.maximum(k - 1, 0), len(middle) - 2)
        along = middle[low + 1, :, strip] - middle[low, :, strip]
        step = np.maximum(np.linalg.norm(along, axis=1), 1e-300)
        return k, strip, np.clip(share, 0, 1), np.einsum("ij,ij->i", along, r) / step
