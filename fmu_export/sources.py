"""The C sources of one scene: kernels generated from contact_system, tables, hand-written files.

``model.h`` and ``model.c`` hold all that differs from scene to scene. No compiler is needed here.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple

import numpy as np

import contact_system
from contact_system.motion import ALMOST_RESTS
from contact_system.scene import DISTURBANCE_KINDS
from contact_system.surfaces import TINY, Surface
from contact_system.system import flip
from contact_system.theory import symbols as ca
from contact_system.theory.development import body_motion, in_space, moving
from contact_system.theory.equations import pushed_paths
from contact_system.theory.geometry import rotation
from contact_system.theory.symbols import making_symbols

from .codegen import c_function, c_loop
from .description import model_identifier
from .model import (
    BLOCK,
    INFINITE,
    LAYOUT,
    STATES,
    TOLERANCE,
    arguments,
    contact_results,
    contact_values,
    first_state,
    regularity,
    sided,
)
from .variables import Table

C_SOURCES = Path(__file__).parent / "c"
GAUSS = Path(contact_system.__file__).parent / "engine" / "generated" / "gauss.inc"
HAND_WRITTEN = (
    *("component.h", "component.c", "panels.c", "winding.h", "timeline.c", "state.c"),
    *("fmi.h", "fmi_both.h"),
)
SHARED = (
    *("check_grown", "check_value", "enter_windows", "forward", "get_rates", "get_states"),
    *("get_values", "kinds", "least", "model_digest", "model_token", "names", "next_edge"),
    *("next_window", "nominals", "orders", "panel", "past_end", "places", "read_state", "report"),
    *("reset", "restore", "reverse", "set_slope", "set_states", "set_time", "set_value", "sizes"),
    *("start", "start_values", "step", "study_profile", "windows", "write_state"),
)
"""What files have in common. Each name bears the model's: importers that compile the sources may
link several models into one program."""

Forms = tuple[bool, bool]
"""Whether finger and object are moved in space (x, p), else in their charts."""


def c_sources(table: Table, token: str, fmi_version: str) -> dict[str, str]:
    """File name -> text of everything that is compiled, headers included.

    Parameters
    ----------
    table : Table
    token : str
        Instantiation token (FMI 3) or GUID (FMI 2).
    fmi_version : "2.0" or "3.0"
    """
    layer = f"fmi{fmi_version[0]}.c"
    files = {name: (C_SOURCES / name).read_text("utf-8") for name in (*HAND_WRITTEN, layer)}
    files["gauss.inc"] = GAUSS.read_text("utf-8")
    with making_symbols():
        model = _Model(table, token)
    return files | {"model.h": model.header, "model.c": model.source}


class _Model:
    """Collects what the kinds of contact of a scene need, each once."""

    def __init__(self, table: Table, token: str):
        self.table, self.scene = table, table.scene
        self.functions: list[str] = []
        self.names: dict[object, str] = {}
        self.n_states, self.n_constants = 0, 0
        kinds: dict[object, int] = {}
        rows, places = [], []
        for i, contact in enumerate(self.scene.contacts):
            finger = contact.finger
            key = (sided(finger), finger.periods())
            if key not in kinds:
                kinds[key] = len(kinds)
                rows.append(self._kind(finger))
            sizes = f"{{{finger.size!r}, {self.scene.object.size!r}}}"
            place = (table.blocks[i], table.finger_first[i])
            places.append(f"  {{&contact_kinds[{kinds[key]}], {place[0]}, {place[1]}, {sizes}}},\n")
        self.source = self._source(rows, places, token)
        self.header = self._header()

    # --- files -----------------------------------------------------------------------------------

    def _header(self) -> str:
        scene, bodies = self.scene, [self.scene.object, *(c.finger for c in self.scene.contacts)]
        sizes = {
            "N_CONTACTS": len(scene.contacts),
            "N_WINDOWS": len(scene.disturbances),
            "N_VALUES": self.table.n_values,
            "N_PROFILE": len(scene.profile.coefficients),
            "SYSTEM_STATES": STATES,
            "GAIN": self.table.parameter_first["gain"],
            "OBJECT": self.table.parameter_first["object"],
            "HORIZON": float(scene.duration),
            "MAX_STATES": self.n_states,
            "MAX_CONSTANTS": self.n_constants,
            "MAX_NUMBERS": max(1, *(len(b.parameters) for b in bodies)),
            "GAIN_LAW": scene.gain.law.upper(),
            "TOLERANCE": TOLERANCE,
            "BLOCK_SIZE": BLOCK,
            "INFINITE": INFINITE,
            "ALMOST_RESTS": ALMOST_RESTS,
        }
        offsets = accumulate(LAYOUT.values(), initial=0)
        sizes |= {f"AT_{name}": offset for name, offset in zip(LAYOUT, offsets)}
        text = "".join(f"#define {name} {value}\n" for name, value in sizes.items())
        own = model_identifier(self.table)
        # The model's name last: `contact_kinds`, `enter_windows` are names of this code already.
        text += "".join(f"#define {name} {name}_of_{own}\n" for name in SHARED)
        return (
            f"/* {own}: generated */\n#ifndef CONTACT_MODEL\n#define CONTACT_MODEL\n{text}#endif\n"
        )

    def _source(self, kind_rows: Sequence[str], places: Sequence[str], token: str) -> str:
        values = self.table.n_values
        least = np.full(values, -sys.float_info.max)
        sizes = np.zeros(values, dtype=int)
        kinds, names = ["CALCULATED"] * values, [""] * values
        for row in self.table.rows:
            own = slice(row.reference, row.reference + row.size)
            kinds[own] = [row.kind.upper()] * row.size
            names[own] = row.elements or (row.name,)
            if row.minimum is not None:
                least[own] = row.minimum
            sizes[row.reference] = row.size
        tables = {
            "double start_values": self.table.start_values,
            "double nominals": self.table.state_nominals,
            "double least": least,
            "unsigned char sizes": sizes,
        }
        parts = [
            *('#include "component.h"\n\n', *self.functions),
            *("static const contact_kind_t contact_kinds[] = {\n", *kind_rows, "};\n"),
            *("const place_t places[] = {\n", *places, "};\n"),
            *("const window_t windows[] = {\n", *map(self._window, self.scene.disturbances)),
            "  {0, 0, 0, {0}}};\n",
            *(f"const {name}[] = {{{_numbers(a)}}};\n" for name, a in tables.items()),
            *("const order_t orders[] = {", *(f"{{{i}, {j}}}, " for i, j in self.table.orders)),
            f"{{0, 0}}}};\nconst unsigned char kinds[] = {{{', '.join(kinds)}}};\n",
            f'const char *const model_token = "{token}";\n',
            *("const char *const names[] = {\n", *(f'  "{name}",\n' for name in names), "};\n"),
        ]
        return "".join(parts)

    def _window(self, d) -> str:
        values = np.zeros(6)
        first = 2 * DISTURBANCE_KINDS.index(type(d))
        values[first : first + 2] = d.value
        return f"  {{{d.contact}, {d.start!r}, {d.stop!r}, {{{_numbers(values)}}}}},\n"

    # --- one kind of contact ---------------------------------------------------------------------

    def _kind(self, finger: Surface) -> str:
        """The initializer of a ``contact_kind_t``."""
        obj = self.scene.object
        home = (in_space(finger, False), in_space(obj, False))
        tip, body = (in_space(finger, True), in_space(obj, True))
        forms = [
            self._form(finger, home, False),
            self._form(finger, (tip, home[1]), True),
            self._form(finger, (tip, body), True),
        ]
        law, n_profile = self.scene.gain.law, len(self.scene.profile.coefficients)
        bodies = finger, obj
        spatial = [
            self._of_place("start", s, True) if s.double_cover and a else "NULL"
            for s, a in zip(bodies, home)
        ]
        results = contact_results(finger, obj, law, n_profile)
        a = arguments(finger, obj, n_profile)
        values = results(*a)
        fields = [
            "{" + ", ".join(forms) + "}",
            self._start(finger, home),
            "{" + ", ".join(spatial) + "}",
            "{" + ", ".join(self._of_place("lame", s, False) for s in bodies) + "}",
            self._regularity(finger),
            self._velocity(),
            self._drive(),
            self._function("rates", a, values[:STATES], finger),
            self._function("results", a, values[STATES:], finger),
            *self._products(a, values, finger),
            f"{{{len(finger.parameters)}, {len(obj.parameters)}}}",
            "{" + ", ".join(map(_winding, (finger, obj))) + "}",
            str(int(not (finger.has_implicit and obj.has_implicit))),
        ]
        return "  {" + ",\n   ".join(fields) + "},\n"

    def _form(self, finger: Surface, forms: Forms, pushed: bool) -> str:
        """The initializer of a ``form_t``."""
        obj = self.scene.object
        size = ", ".join("IN_SPACE" if ambient else "IN_CHART" for ambient in forms)
        motion = self._motion(finger, forms, pushed)
        coordinates = [self._coordinates(s, a) for s, a in zip((finger, obj), forms)]
        return (
            f"{{{{{size}}}, &{motion}, {{{', '.join(coordinates)}}}, "
            f"{self._slip(forms[1])}, {self._outputs(finger, forms)}}}"
        )

    def _function(self, name: str, inputs: Sequence[ca.SX], value: ca.SX, *key: object) -> str:
        """The name of a C function of these inputs, written on first use."""
        known = (name, *(sided(k) if isinstance(k, Surface) else k for k in key))
        if known not in self.names:
            called = f"{name}_{len(self.names)}"
            self.names[known] = called
            self.functions.append(c_function(called, inputs, value))
        return self.names[known]

    def _coordinates(self, surface: Surface, ambient: bool) -> str:
        body, c = _Body.of(surface, ambient), ca.SX.sym("c", 2)
        value = body.find("coordinates", c)
        return self._function("coordinates", (body.frame, c, body.p), value, surface, ambient)

    def _of_place(self, name: str, surface: Surface, ambient: bool) -> str:
        """Of u, v, theta: the frame in space, or the Lame coefficients."""
        body, place = _Body.of(surface, ambient), ca.SX.sym("place", 3)
        value = moving(surface, ambient)(name)(place, body.numbers)
        called = "spatial" if ambient else name
        return self._function(called, (place, body.p), value, surface)

    def _velocity(self) -> str:
        turn, w1v = ca.SX.sym("turn", 2), ca.SX.sym("w1v", 4)
        finger = rotation(turn[0]).T @ w1v[:2]
        obj = rotation(turn[1]).T @ (flip() @ w1v[:2] - w1v[2:])
        return self._function("velocity", (turn, w1v), ca.vertcat(finger, obj))

    def _drive(self) -> str:
        sigma, w1v = ca.SX.sym("sigma"), ca.SX.sym("w1v", 4)
        value = sigma * ca.vertcat(w1v[:2], flip() @ w1v[:2] - w1v[2:])
        return self._function("drive", (sigma, w1v), value)

    def _slip(self, ambient: bool) -> str:
        body = _Body.of(self.scene.object, ambient)
        theta, v, offset = ca.SX.sym("theta"), ca.SX.sym("v", 2), ca.SX.sym("offset", 2)
        value = rotation(theta) @ (v - body.find("vector", offset))
        return self._function("slip", (body.frame, theta, v, offset, body.p), value, ambient)

    def _outputs(self, finger: Surface, forms: Forms) -> str:
        """Twist, pose and contact points from the frames of both bodies."""
        obj = self.scene.object
        a = arguments(finger, obj, len(self.scene.profile.coefficients))
        frames = [_Body.of(s, ambient).frame for s, ambient in zip((finger, obj), forms)]
        w1v = ca.SX.sym("w1v", 4)
        state = ca.vertcat(*frames, w1v)
        found = contact_values(finger, obj, forms, self.scene.gain.law, a, state)
        value = ca.vertcat(*(found[name] for name in ("twist", "pose", "contact_point")))
        inputs = (a.time, *frames, w1v, a.disturbance, a.law, a.finger, a.object)
        return self._function("outputs", inputs, value, finger, forms)

    def _start(self, finger: Surface, home: Forms) -> str:
        obj = self.scene.object
        a = arguments(finger, obj, len(self.scene.profile.coefficients))
        state = first_state(finger, obj, home, a)
        bodies = [_Body.of(*given) for given in zip((finger, obj), home, (a.finger, a.object))]
        ends = np.cumsum([0, *(b.frame.numel() for b in bodies), 4]).tolist()
        tip, body, velocities = ca.vertsplit(state, ends)
        frames = [b._replace(frame=own).restored for b, own in zip(bodies, (tip, body))]
        value = ca.vertcat(*frames, velocities)
        return self._function("start", (a.state, a.finger, a.object), value, finger)

    def _regularity(self, finger: Surface) -> str:
        a = arguments(finger, self.scene.object, 1)
        inputs = (a.state, a.finger, a.object)
        value = regularity(finger, self.scene.object)(*inputs)
        return self._function("regularity", inputs, value, finger)

    def _products(self, a: Sequence[ca.SX], values: ca.SX, finger: Surface) -> list[str]:
        """Jacobian times seeds, and its transpose times seeds."""
        seeds = [ca.SX.sym("seed", x.numel()) for x in a]
        along = ca.jtimes(values, ca.vertcat(*a), ca.vertcat(*seeds))
        result_seeds = ca.SX.sym("seed", values.numel())
        back = ca.jtimes(values, ca.vertcat(*a), result_seeds, True)
        return [
            self._function("forward", (*a, *seeds), along, finger),
            self._function("reverse", (*a, result_seeds), back, finger),
        ]

    # --- motion ----------------------------------------------------------------------------------

    def _motion(self, finger: Surface, forms: Forms, pushed: bool) -> str:
        """The name of a ``motion_t``, written on first use."""
        key = ("motion", sided(finger), forms, pushed)
        if key not in self.names:
            name = self.names[key] = f"motion_{len(self.names)}"
            tip, body = _Body.of(finger, forms[0]), _Body.of(self.scene.object, forms[1])
            motion = (_pushed_pair if pushed else _driven_pair)(tip, body)
            self.functions.append(motion_source(motion, name))
            self.n_states = max(self.n_states, motion.state.numel())
            self.n_constants = max(self.n_constants, motion.constants.numel())
        return self.names[key]


# --- motion of both bodies -----------------------------------------------------------------------


class _Body(NamedTuple):
    """One side of a contact: symbols of its moving frame and of its parameters."""

    surface: Surface
    ambient: bool
    p: ca.SX
    frame: ca.SX

    @classmethod
    def of(cls, surface: Surface, ambient: bool, p: ca.SX | None = None) -> _Body:
        p = ca.SX.sym("p", len(surface.parameters)) if p is None else p
        return cls(surface, ambient, p, ca.SX.sym("frame", moving(surface, ambient).size))

    @property
    def numbers(self) -> ca.SX:
        return ca.vertcat(self.surface.sign, self.p)

    def find(self, name: str, *point: ca.SX) -> ca.SX:
        """What a function of the moving frame gives (`theory.development`)."""
        return moving(self.surface, self.ambient)(name)(
            ca.vertcat(self.frame, *point), self.numbers
        )

    def moved(self, c: ca.SX, offset: ca.SX | None = None) -> ca.SX:
        """The frame's rate, driven by c."""
        return body_motion(self.surface, self.ambient, self.numbers, self.frame, c, offset)

    @property
    def restored(self) -> ca.SX:
        """The frame on its surface again."""
        return self.find("restore") if self.ambient else self.frame


class Motion(NamedTuple):
    """What a ``motion_t`` is made of; ``others`` are sigma, decay and local time."""

    state: ca.SX
    others: ca.SX
    constants: ca.SX
    rates: ca.SX
    restored: ca.SX
    n_stiff: int
    reach: float


def _driven_pair(tip: _Body, body: _Body) -> Motion:
    """Finger and object while nothing accelerates them.

    Constants: numbers of both, W_1, V.
    """
    w1, v, others = ca.SX.sym("W1", 2), ca.SX.sym("V", 2), ca.SX.sym("drive", 3)
    sigma, decay, _ = ca.vertsplit(others)
    rates = (tip.moved(sigma * w1), body.moved(sigma * (flip() @ w1 - v * decay)))
    return Motion(
        ca.vertcat(tip.frame, body.frame),
        others,
        ca.vertcat(tip.p, body.p, w1, v),
        ca.vertcat(*rates),
        ca.vertcat(tip.restored, body.restored),
        0,
        min(tip.surface.reach, body.surface.reach),
    )


def _pushed_pair(tip: _Body, body: _Body) -> Motion:
    """A contact under disturbances that are linear in local time; W_1 and V are states.

    Constants: numbers of both, disturbances (6), their slopes (6). The term -lam V of V' is left to
    panels.c.
    """
    w1, v, others = ca.SX.sym("W1", 2), ca.SX.sym("V", 2), ca.SX.sym("drive", 3)
    first, slope = ca.SX.sym("first", 6), ca.SX.sym("slope", 6)
    now = first + others[2] * slope
    # a path at rest under no acceleration stays as it is: 0/TINY, not 0/0
    sigma = ca.fmax(others[0], TINY)
    pushed = (tip.find("vector", now[0:2]), body.find("vector", now[2:4]))
    w1_rate, v_rate = pushed_paths(sigma, flip(), *pushed)
    moved = body.moved(sigma * (flip() @ w1 - v), now[4:6])
    return Motion(
        ca.vertcat(tip.frame, w1, body.frame, v),
        others,
        ca.vertcat(tip.p, body.p, first, slope),
        ca.vertcat(tip.moved(sigma * w1), w1_rate, moved, v_rate),
        ca.vertcat(tip.restored, w1, body.restored, v),
        2,
        min(tip.surface.reach, body.surface.reach),
    )


def motion_source(m: Motion, name: str) -> str:
    """C99 of one ``motion_t``."""
    reach = "HUGE_VAL" if math.isinf(m.reach) else repr(m.reach)
    n = m.state.numel()
    return (
        c_loop(f"rates_of_{name}", ca.vertcat(m.state, m.others), m.constants, m.rates)
        + c_function(f"restored_{name}", (m.state, m.constants), m.restored)
        + f"static const motion_t {name} = "
        f"{{{n}, {m.n_stiff}, {reach}, rates_of_{name}, restored_{name}}};\n\n"
    )


# --- text ----------------------------------------------------------------------------------------


def _winding(surface: Surface) -> str:
    u, v = (period or 0.0 for period in surface.periods())
    cover = int(surface.double_cover)
    return f"{{{cover}, {u!r}, {v!r}}}"


def _numbers(values: np.ndarray) -> str:
    return ", ".join(repr(x) for x in values.tolist())
