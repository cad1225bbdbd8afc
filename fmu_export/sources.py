"""The C sources of one scene: kernels generated from contact_system, tables, hand-written files.

``model.h`` and ``model.c`` hold all that differs from scene to scene; a file ``motion_*.c`` holds
the collocation of one kind of motion around its kernel. Nothing here needs a compiler.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from itertools import accumulate
from pathlib import Path

import casadi as ca
import numpy as np

from contact_system import kernels, panels
from contact_system.charts import TINY
from contact_system.development import driven_motion, forced_motion, state_size
from contact_system.expressions import SYMBOLS
from contact_system.kernels import NODES, PRELUDE, Kernel, c_statements
from contact_system.profile import GAIN_LAWS
from contact_system.scene import DISTURBANCE_KINDS
from contact_system.surfaces import Surface
from contact_system.system import FLIP
from contact_system.tracks import (
    coordinate_kernel,
    frame_kernel,
    in_space,
    lame_kernel,
    restoring_kernel,
    rotation,
    standing_size,
    vector_kernel,
)

from .description import model_identifier
from .following import TOLERANCE
from .model import (
    BLOCK,
    INFINITE,
    LAYOUT,
    STATES,
    arguments,
    contact_results,
    contact_values,
    first_state,
    regularity,
)
from .variables import Table

SX = ca.SX

C_SOURCES = Path(__file__).parent / "c"
HAND_WRITTEN = ("component.h", "component.c", "timeline.c", "state.c", "fmi.h")
LAWS = tuple(GAIN_LAWS)
SHARED = (
    "check_grown", "check_value", "enter_windows", "forward", "gauss_end", "gauss_integral",
    "gauss_node", "gauss_series", "get_rates", "get_states", "get_values", "kinds", "least",
    "model_digest", "model_token", "names", "next_edge", "next_window", "nominals", "orders",
    "past_end", "places", "read_state", "report", "reset", "reverse", "set_slope", "set_states",
    "set_time", "set_value", "sizes", "start", "start_values", "step", "study_profile", "windows",
    "write_state",
)  # fmt: skip
"""What files have in common. Each name bears the model's: importers that compile the sources may
link several models into one program."""

Forms = tuple[bool, bool]
"""Whether finger and object are moved in space (x, p, q), else in their charts."""


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
    files["common.h"] = (kernels.C_SOURCES / "common.h").read_text("utf-8")
    with SYMBOLS:
        model = _Model(table, token)
    return files | model.motions | {"model.h": model.header, "model.c": model.source}


class _Model:
    """Collects what the kinds of contact of a scene need, each once."""

    def __init__(self, table: Table, token: str):
        self.table, self.scene = table, table.scene
        self.functions: list[str] = []
        self.names: dict[object, str] = {}
        self.motions: dict[str, str] = {}
        self.n_states, self.n_constants = 0, 0
        kinds: dict[object, int] = {}
        rows, places = [], []
        for i, contact in enumerate(self.scene.contacts):
            finger = contact.finger
            key = (finger.structure, finger.periods())
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
            "N": NODES, "N_CONTACTS": len(scene.contacts), "N_WINDOWS": len(scene.disturbances),
            "N_VALUES": self.table.n_values, "N_PROFILE": len(scene.profile.coefficients),
            "SYSTEM_STATES": STATES, "GAIN": self.table.parameter_first["gain"],
            "OBJECT": self.table.parameter_first["object"], "HORIZON": float(scene.duration),
            "MAX_STATES": self.n_states, "MAX_CONSTANTS": self.n_constants,
            "MAX_NUMBERS": max(1, *(len(b.parameters) for b in bodies)),
            "GAIN_LAW": scene.gain.law.upper(),
            "MOTIONS": ", ".join(name.removesuffix(".c") for name in self.motions),
            "TOLERANCE": TOLERANCE, "BLOCK_SIZE": BLOCK, "INFINITE": INFINITE,
            "ALMOST_RESTS": panels.ALMOST_RESTS,
        }  # fmt: skip
        offsets = accumulate(LAYOUT.values(), initial=0)
        sizes |= {f"AT_{name}": offset for name, offset in zip(LAYOUT, offsets)}
        laws = ", ".join(law.upper() for law in LAWS)
        text = "".join(f"#define {name} {value}\n" for name, value in sizes.items())
        own = model_identifier(self.table)
        motions = (name.removesuffix(".c") for name in self.motions)
        # The model's name last: `contact_kinds`, `enter_windows` are names of this code already.
        text += "".join(f"#define {name} {name}_of_{own}\n" for name in (*SHARED, *motions))
        return (
            f"/* {own}: generated */\n"
            f"#ifndef CONTACT_MODEL\n#define CONTACT_MODEL\n{text}enum {{ {laws} }};\n#endif\n"
        )

    def _source(self, kind_rows: Sequence[str], places: Sequence[str], token: str) -> str:
        m, values = panels.collocation(), self.table.n_values
        series = np.vstack([m.series[:-1].T, m.series[-1:]])
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
        tables = [
            ("double gauss_node", m.node), ("double gauss_integral", m.integral.T),
            ("double gauss_series", series), ("double gauss_end", m.end),
            ("double start_values", self.table.start_values),
            ("double nominals", self.table.state_nominals),
            ("double least", least), ("unsigned char sizes", sizes),
        ]  # fmt: skip
        return "".join([
            '#include "component.h"\n\n', *self.functions,
            "static const contact_kind_t contact_kinds[] = {\n", *kind_rows, "};\n",
            "const place_t places[] = {\n", *places, "};\n",
            "const window_t windows[] = {\n", *map(self._window, self.scene.disturbances),
            "  {0, 0, 0, {0}}};\n",
            *(_array(name, a) for name, a in tables),
            "const order_t orders[] = {",
            *(f"{{{i}, {j}}}, " for i, j in self.table.orders), "{0, 0}};\n",
            f"const unsigned char kinds[] = {{{', '.join(kinds)}}};\n",
            f'const char *const model_token = "{token}";\n',
            "const char *const names[] = {\n", *(f'  "{name}",\n' for name in names), "};\n",
        ])  # fmt: skip

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
            self._of_place("spatial", frame_kernel(s), s) if s.double_cover and a else "NULL"
            for s, a in zip(bodies, home)
        ]
        results = contact_results(finger, obj, law, n_profile)
        a = arguments(finger, obj, n_profile)
        values = results(*a)
        fields = [
            "{" + ", ".join(forms) + "}",
            self._start(finger, home),
            "{" + ", ".join(spatial) + "}",
            "{" + ", ".join(self._of_place("lame", lame_kernel(s), s) for s in bodies) + "}",
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
        size = ", ".join(str(state_size(ambient)) for ambient in forms)
        motion = self._motion(finger, forms, pushed)
        coordinates = [self._coordinates(s, a) for s, a in zip((finger, obj), forms)]
        outputs = self._outputs(finger, forms)
        return (
            f"{{{{{size}}}, &{motion}, {{{', '.join(coordinates)}}}, "
            f"{self._slip(forms[1])}, {', '.join(outputs)}}}"
        )

    def _function(self, name: str, inputs: Sequence[SX], value: SX, *key: object) -> str:
        """The name of a C function of these inputs, written on first use."""
        known = (name, *(getattr(k, "structure", k) for k in key))
        if known not in self.names:
            called = f"{name}_{len(self.names)}"
            self.names[known] = called
            self.functions.append(_c_function(called, inputs, value))
        return self.names[known]

    def _coordinates(self, surface: Surface, ambient: bool) -> str:
        p = SX.sym("p", len(surface.parameters))
        frame, c = SX.sym("frame", state_size(ambient)), SX.sym("c", 2)
        value = coordinate_kernel(surface, ambient).function(ca.vertcat(frame, c), p)
        return self._function("coordinates", (frame, c, p), value, surface, ambient)

    def _of_place(self, name: str, kernel: Kernel, surface: Surface) -> str:
        """Of a chart state, which is what the kernel takes."""
        place, p = SX.sym("place", 3), SX.sym("p", kernel.n_constant)
        return self._function(name, (place, p), kernel.function(place, p), surface)

    def _velocity(self) -> str:
        turn, w1v = SX.sym("turn", 2), SX.sym("w1v", 4)
        finger = rotation(turn[0]).T @ w1v[:2]
        obj = rotation(turn[1]).T @ (FLIP @ w1v[:2] - w1v[2:])
        return self._function("velocity", (turn, w1v), ca.vertcat(finger, obj))

    def _drive(self) -> str:
        sigma, w1v = SX.sym("sigma"), SX.sym("w1v", 4)
        value = sigma * ca.vertcat(w1v[:2], FLIP @ w1v[:2] - w1v[2:])
        return self._function("drive", (sigma, w1v), value)

    def _slip(self, ambient: bool) -> str:
        obj = self.scene.object
        frame, theta, v = SX.sym("frame", state_size(ambient)), SX.sym("theta"), SX.sym("v", 2)
        offset, p = SX.sym("offset", 2), SX.sym("p", len(obj.parameters))
        pushed = vector_kernel(obj, ambient).function(frame, ca.vertcat(p, offset))
        value = rotation(theta) @ (v - pushed)
        return self._function("slip", (frame, theta, v, offset, p), value, ambient)

    def _outputs(self, finger: Surface, forms: Forms) -> list[str]:
        """Twist, pose and contact points from the frames of both bodies."""
        obj = self.scene.object
        a = arguments(finger, obj, len(self.scene.profile.coefficients))
        frames = [SX.sym("frame", state_size(ambient)) for ambient in forms]
        w1v = SX.sym("w1v", 4)
        state = ca.vertcat(*(f[: standing_size(k)] for f, k in zip(frames, forms)), w1v)
        found = contact_values(finger, obj, forms, self.scene.gain.law, a, state)
        inputs = (a.time, *frames, w1v, a.disturbance, a.law, a.finger, a.object)
        return [
            self._function(name, inputs, found[name], finger, forms)
            for name in ("twist", "pose", "contact_point")
        ]

    def _start(self, finger: Surface, home: Forms) -> str:
        obj = self.scene.object
        a = arguments(finger, obj, len(self.scene.profile.coefficients))
        state = first_state(finger, obj, home, a)
        parts, at = [], 0
        for surface, ambient, p in zip((finger, obj), home, (a.finger, a.object)):
            own = state[at : at + standing_size(ambient)]
            at += own.numel()
            if ambient:
                own = restoring_kernel(surface).function(ca.vertcat(own, SX(3, 1)), p)
            parts.append(own)
        value = ca.vertcat(*parts, state[at:])
        return self._function("start", (a.state, a.finger, a.object), value, finger)

    def _regularity(self, finger: Surface) -> str:
        a = arguments(finger, self.scene.object, 1)
        inputs = (a.state, a.finger, a.object)
        value = regularity(finger, self.scene.object)(*inputs)
        return self._function("regularity", inputs, value, finger)

    def _products(self, a: Sequence[SX], values: SX, finger: Surface) -> list[str]:
        """Jacobian times seeds, and its transpose times seeds."""
        seeds = [SX.sym("seed", x.numel()) for x in a]
        along = ca.jtimes(values, ca.vertcat(*a), ca.vertcat(*seeds))
        result_seeds = SX.sym("seed", values.numel())
        back = ca.jtimes(values, ca.vertcat(*a), result_seeds, True)
        return [
            self._function("forward", (*a, *seeds), along, finger),
            self._function("reverse", (*a, result_seeds), back, finger),
        ]

    # --- motion ----------------------------------------------------------------------------------

    def _motion(self, finger: Surface, forms: Forms, pushed: bool) -> str:
        """The name of a ``motion_t`` in a file of its own, written on first use."""
        key = ("motion", finger.structure, forms, pushed)
        if key not in self.names:
            obj = self.scene.object
            kernel = (_pushed_pair if pushed else _driven_pair)(finger, obj, forms)
            name = f"motion_{len(self.motions)}"
            self.names[key] = name
            self.motions[f"{name}.c"] = motion_source(kernel, name, pushed)
            self.n_states = max(self.n_states, kernel.n_result)
            self.n_constants = max(self.n_constants, kernel.n_constant)
        return self.names[key]


# --- motion of both bodies -----------------------------------------------------------------------


def _driven_pair(finger: Surface, obj: Surface, forms: Forms) -> Kernel:
    """Finger and object while nothing accelerates them.

    point: frames of both, sigma, decay. constant: numbers of both, W_1, V.
    """
    frames = [SX.sym("frame", state_size(ambient)) for ambient in forms]
    p1, p2 = SX.sym("p1", len(finger.parameters)), SX.sym("p2", len(obj.parameters))
    w1, v, drive, none = SX.sym("W1", 2), SX.sym("V", 2), SX.sym("drive", 2), SX(2, 1)
    tip, body = driven_motion(finger, forms[0]), driven_motion(obj, forms[1])
    rates = [
        tip.function(ca.vertcat(frames[0], drive), ca.vertcat(p1, w1, none, none)),
        body.function(ca.vertcat(frames[1], drive), ca.vertcat(p2, FLIP @ w1, v, none)),
    ]
    constant = ca.vertcat(p1, p2, w1, v)
    kernel = Kernel("driven", ca.vertcat(*frames, drive), constant, ca.vertcat(*rates))
    place = {"row": frames[0].numel(), "constant": p1.numel()}
    kernel.restores = (*tip.restores, *(r._replace(**place) for r in body.restores))
    kernel.reach = min(tip.reach, body.reach)
    return kernel


def _pushed_pair(finger: Surface, obj: Surface, forms: Forms) -> Kernel:
    """A contact under disturbances that are linear in local time.

    point: frame of the finger, W_1, frame of the object, V; sigma, decay (unused), local time.
    constant: numbers of both, disturbances (6), their slopes (6).
    """
    frames = [SX.sym("frame", state_size(ambient)) for ambient in forms]
    p1, p2 = SX.sym("p1", len(finger.parameters)), SX.sym("p2", len(obj.parameters))
    w1, v, drive = SX.sym("W1", 2), SX.sym("V", 2), SX.sym("drive", 3)
    first, slope = SX.sym("first", 6), SX.sym("slope", 6)
    motion = forced_motion(finger, obj, forms, True)
    state = ca.vertcat(frames[0], w1, frames[1], v)
    rates = motion.function(
        # a path at rest under no acceleration stays as it is: 0/TINY, not 0/0
        ca.vertcat(state, ca.fmax(drive[0], TINY), 0),
        ca.vertcat(p1, p2, 1, 0, w1, first + drive[2] * slope),
    )
    kernel = Kernel("pushed", ca.vertcat(state, drive), ca.vertcat(p1, p2, first, slope), rates)
    kernel.restores, kernel.reach = motion.restores, motion.reach
    return kernel


def motion_source(kernel: Kernel, name: str, timed: bool) -> str:
    """C99 of one ``motion_t``: panels.c around a kernel, without vector forms of the C library.

    Those would differ from machine to machine in the last digit.
    """
    text = panels.panel_source(kernel).removeprefix(PRELUDE)
    if timed:  # sigma, decay and local time: the third row is panels.c's own
        text = "#define DRIVES 3\n" + text
    return (
        f'#include "component.h"\n#define ONE_PANEL\n{text}\n'
        f"const motion_t {name} = {{NX, NC, {2 * timed}, panel, restore}};\n"
    )


# --- text ----------------------------------------------------------------------------------------


def _c_function(name: str, inputs: Sequence[SX], value: SX) -> str:
    """C99 of a ``kernel_t``: ``void name(arguments_t a, double *y)``."""
    function = ca.Function(name, list(inputs), [ca.cse(ca.densify(ca.vec(value)))])
    names = [[f"a[{i}][{j}]" for j in range(x.numel())] for i, x in enumerate(inputs)]
    lines, (outputs,) = c_statements(function, names)
    lines += [f"y[{i}] = {output};" for i, output in enumerate(outputs)]
    body = "".join(f"  {line}\n" for line in lines)
    return f"static void {name}(arguments_t a, double *restrict y) {{\n{body}}}\n\n"


def _winding(surface: Surface) -> str:
    u, v = (period or 0.0 for period in surface.periods())
    cover = int(surface.double_cover)
    return f"{{.double_cover = {cover}, .period_u = {u!r}, .period_v = {v!r}}}"


def _array(declaration: str, values: np.ndarray) -> str:
    return f"const {declaration}[] = {{{_numbers(values.ravel())}}};\n"


def _numbers(values: np.ndarray) -> str:
    return ", ".join(repr(x) for x in values.tolist())
