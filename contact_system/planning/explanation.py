"""What the engine did, in words: the lines of ``Plan.explain()``, and errors if it failed."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from .. import limits
from ..engine.binding import Fact, Failure
from ..errors import ChartSingularity, ContactSystemError, SceneError, SurfaceError
from ..scene import DISTURBANCE_KINDS, SIDES, STILL, Disturbance, Scene
from ..surfaces import ImplicitSurface, Surface

EPS = 2.0**-52

# failure_t.code, and kind and reason of fact_t, as in engine.h
STUCK, TOO_MANY_PANELS, TOO_LONG, SINGULAR_CHART, SINGULAR_TIME, OUTSIDE = range(2, 8)
CIRCLE, LINE, PANELS = range(3)
NO_SLIP, NEGLIGIBLE, SLIPS, PUSHED = range(4)


Windows = dict[type[Disturbance], Any]  # start and stop of a contact's disturbances of each kind, s


# --- how a plan was made -------------------------------------------------------------------------


def lines(scene: Scene, facts: Sequence[Sequence[Fact]]) -> list[str]:
    """How each contact and interval was planned, why, and what was skipped; facts by contact."""
    contacts_by_text: dict[tuple[str, ...], list[int]] = {}
    for i, of_contact in enumerate(facts):
        contacts_by_text.setdefault(tuple(_of_contact(scene, i, of_contact)), []).append(i)
    result = []
    for text, contacts in contacts_by_text.items():
        result += [f"{', '.join(map(scene.contact_title, contacts))}:", *text]
    return result


def _of_contact(scene: Scene, contact: int, facts: Sequence[Fact]) -> list[str]:
    windows = _windows(scene, contact)

    def words(f: Fact) -> tuple[str, str, str]:
        return SIDES[f.side], _method(f), _reason(scene, contact, windows, f)

    result = []
    for (side, method, reason), run in itertools.groupby(facts, words):
        alike = list(run)
        panels = sum(f.panels for f in alike)
        count = f", {panels} panel{'s' * (panels > 1)}" * (panels > 0)
        interval = f"[{alike[0].start:.6g}, {alike[-1].stop:.6g}] s"
        result.append(f"  {side:6s} {interval}  {method}{count}  ({reason})")
    return result + [f"  skipped: {text}" for text in _skipped(facts)]


def _method(f: Fact) -> str:
    place = "space" if f.in_space else "its chart"
    if f.kind == CIRCLE:
        return "closed form: great circle"
    if f.kind == LINE and f.panels:
        return "quadrature of slip"
    if f.kind == LINE:
        return "closed form: straight line on the developed surface"
    if f.reason == PUSHED:
        return "forced development"
    if f.by_length:
        return f"geodesic in arc length, in {place}"
    return f"development in {place}"


_SLIP = {NO_SLIP: "no slip", NEGLIGIBLE: "slip is below tolerance", SLIPS: "slip"}


def _reason(scene: Scene, contact: int, windows: Windows, f: Fact) -> str:
    on_finger, last = SIDES[f.side] == "finger", scene.way(contact)[-1]
    if f.reason == PUSHED:
        return _disturbances(windows, f)
    if scene.contacts[contact].follows:
        why = "rolling is imposed"
        if on_finger:
            return why + "; integrated even where a closed form is known, to confirm it"
    elif f.offset:
        why = _disturbances(windows, f) + ", slip" * (f.reason == SLIPS)
    elif f.reason != NO_SLIP and last.profile == STILL and f.start >= last.start:
        return "the contact rests"
    else:
        why = "nothing accelerates it" if on_finger else _SLIP[f.reason]
    if f.kind == LINE and f.panels:
        return why + "; a developable surface"
    if f.kind == PANELS and f.by_length:
        return why + "; no closed form on this surface"
    return why


def _windows(scene: Scene, contact: int) -> Windows:
    found: Windows = {kind: [] for kind in DISTURBANCE_KINDS}
    for d in scene.disturbances:
        if d.contact == contact and any(d.value):
            found[type(d)].append((d.start, d.stop))
    return {kind: np.reshape(spans, (-1, 2)) for kind, spans in found.items()}


def _disturbances(windows: Windows, f: Fact) -> str:
    """The kinds of disturbances that change a body's path, in the order of `DISTURBANCE_KINDS`.

    Those of the finger change the object's path too.
    """
    return " and ".join(
        kind.kind
        for kind, spans in windows.items()
        if SIDES[f.side] in (kind.side, "object")
        and ((spans[:, 0] <= f.start) & (f.start < spans[:, 1])).any()
    )


def _skipped(facts: Sequence[Fact]) -> list[str]:
    def in_closed_form(f: Fact) -> bool:
        return f.kind == CIRCLE or (f.kind == LINE and not f.panels)

    fingers, objects = ([f for f in facts if SIDES[f.side] == side] for side in SIDES)
    notes = []
    if all(map(in_closed_form, facts)):
        notes.append("all integration")
    elif all(map(in_closed_form, fingers)):
        notes.append("integration of the finger")
    if all(f.reason == NO_SLIP for f in objects):
        if any(f.offset for f in objects):
            notes.append("gain (slip comes from rate offsets alone, and ends with them)")
        else:
            notes.append("slip and gain (there is no slip)")
    return notes


# --- why it failed -------------------------------------------------------------------------------


def failed(scene: Scene, failure: Failure) -> Exception:
    """The error of a failed call of the engine."""
    name = f"{scene.title}, {scene.contact_title(failure.contact)}"
    contact = scene.contacts[failure.contact]
    surface = (contact.finger, scene.object)[failure.side]
    if failure.code in (STUCK, TOO_MANY_PANELS):
        return ContactSystemError(f"{name}: {_ended_early(scene, failure, surface)}")
    if failure.code == TOO_LONG:
        return SceneError(
            f"{name}: its path is {failure.value:.3g} times as long as {surface!r} is large; "
            f"above {failure.end:g} rounding leaves less than four digits of its position; lower "
            "its velocity, sigma or the duration"
        )
    if failure.code == SINGULAR_CHART:
        return singular_path(name, surface, (failure.u, failure.v))
    if failure.code == SINGULAR_TIME:
        return ChartSingularity(
            f"{name}: {surface!r}: at t = {failure.t:.17g} s the contact is at a singular point of "
            f"the chart ({surface.chart.singular_at or 'pole'}), where u', v' and psi do not "
            "exist. Ask for points, pose and twist there (they do), or for a time nearby"
        )
    return ContactSystemError(
        f"{name}: there is not enough memory; shorten the scene, or plan fewer contacts at once"
    )


def _ended_early(scene: Scene, failure: Failure, surface: Surface) -> str:
    """Where and why a motion ended early, and what to do."""
    where = f"{failure.t:.9g}"
    reached = f"arc length {where} m" if failure.by_length else f"t = {where} s"
    why = _singular(surface, (failure.u, failure.v))
    at_rest = failure.at_rest and (
        f"an acceleration acts where the path almost rests, sigma = {failure.value:.3g} m/s; add a "
        "constant to the profile, or accelerate before or after"
    )
    if failure.code == STUCK and not why:
        why = at_rest or (
            "the path reaches a singular point of its chart or its surface (start elsewhere, "
            "change the direction, or end the scene before), or rounding exceeds the tolerance, as "
            "on a fast path, far from the body's origin, or where terms of its formula cancel, as "
            "for thin bodies with turned axes (give a greater tolerance, or write the formula in "
            "the body's principal axes or as a Quadric)"
        )
    if why:
        return f"the motion cannot be continued past {reached}: {why}"
    start = scene.contacts[failure.contact].start()[failure.side]
    why = at_rest or (
        f"{_far_away(surface, start)}shorten the scene, lower the speed, the acceleration or the "
        "surface's curvature, or give a surface of your own a greater size; where the path comes "
        "to where a formula has no values, end the scene or the disturbance before"
    )
    return (
        f"{failure.panels} panels reach {reached} of {failure.end:.9g} only, and the plan has "
        f"tried {failure.tried} of at most {limits.PANELS:.15g}, {failure.most} of them for "
        f"{scene.contact_title(failure.costliest)}; {why}, or set contact_system.limits.PANELS "
        "higher"
    )


def singular_path(name: str, surface: Surface, place: tuple[float, float]) -> ContactSystemError:
    """The error for a path through a singular point of its chart."""
    other = "use the default method" if surface.has_implicit else "give an ImplicitSurface"
    return ContactSystemError(
        f"{name}: the path goes through a singular point of its chart, {surface!r} at (u, v) = "
        f"({place[0]:.9g}, {place[1]:.9g}), where the contact frame turns over; start elsewhere, "
        f"change the direction, end the scene before, or {other}, which needs no chart"
    )


def _singular(surface: Surface, place: tuple[float, float]) -> str:
    """What is singular at (u, v), and what to do; empty if nothing is."""
    try:
        surface.canonical(*place)
        if isinstance(surface, ImplicitSurface) and surface.is_flat(*place):
            return (
                f"{surface!r}: the gradient of F vanishes on the surface; give an F without such "
                "a power: x**2 + y**2 + z**2 - r**2, not (x**2 + y**2 + z**2 - r**2)**3"
            )
    except ChartSingularity as error:
        end = "or end the scene or the disturbance before"
        return f"the path comes to a singular point of its chart: {error}, {end}"
    except SurfaceError:  # the place is not visible from the centre
        pass
    return ""


def _far_away(surface: Surface, at: Sequence[float]) -> str:
    """What to do if rounding is large for the body's size, far from its origin; empty if not."""
    distance = math.hypot(*surface.point(*at))
    rounding = EPS * distance / surface.size
    if rounding < 1e-12:  # the default tolerance
        return ""
    return (
        f"{distance:.3g} m from the body's origin, positions are rounded by {rounding:.1g} of its "
        f"size, so give tolerance={10.0 ** math.ceil(math.log10(rounding)):g} or more; else "
    )
