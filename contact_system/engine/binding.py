"""The binding of the engine's library: structures as in engine.h, and functions.

It handles tables, numbers and addresses, not scenes or surfaces.
"""

from __future__ import annotations

import ctypes
import functools
import sys
from collections.abc import Sequence
from ctypes import POINTER, Structure, c_char_p, c_double, c_int32, c_int64, c_void_p
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

N_TABLES = 7
OTHER = ("geometry", "inverse", "geodesic")
"""Tables that the engine runs only for its callers, in the order of engine.h."""


def _each(ctype: Any, names: str) -> list[tuple[str, Any]]:
    """Fields of one type, from their names with spaces between."""
    return [(name, ctype) for name in names.split()]


class TableData(Structure):
    """``table_t``."""

    _fields_ = _each(c_int32, "n_in n_const n_out n_lit first_lit first_out n_regs twin")
    _fields_ += _each(c_void_p, "prologue body literals")

    @property
    def address(self) -> int:
        return ctypes.addressof(self)


class SurfaceData(Structure):
    """``surface_t``."""

    _fields_ = [
        ("name", c_char_p),
        *_each(c_int32, "n_numbers double_cover closed_form may_be_singular"),
        *_each(c_double, "period_u period_v"),
        ("chart", c_void_p * N_TABLES),  # of ``tables``
        ("space", c_void_p * N_TABLES),
        ("other", c_void_p * len(OTHER)),
    ]


class Program(Structure):
    """``program_t``: what ``step`` runs, on registers of one double each."""

    _fields_ = [("code", c_void_p), ("registers", c_void_p)]


class Followed(Structure):
    """``geodesic_t``: how geodesics of a surface are followed."""

    _fields_ = _each(c_void_p, "surface rates numbers") + _each(c_double, "size first longest")


class Failure(Structure):
    """``failure_t``: why a call failed."""

    _fields_ = _each(c_int64, "code contact side panels by_length at_rest tried most costliest")
    _fields_ += _each(c_double, "t end value u v")


class Fact(Structure):
    """``fact_t``: how one body was planned on one interval."""

    _fields_ = _each(c_double, "start stop")
    _fields_ += _each(c_int64, "side kind in_space by_length panels reason offset")


class Sensor(Structure):
    """``sensor_t``: limits of Newton's method for a measured contact."""

    _fields_ = _each(c_double, "small most_steps settled conformal")


class Steered(Structure):
    """``steered_t``: one body of a contact that is steered."""

    _fields_ = [
        ("geodesic", c_void_p),
        ("normal_curvature", c_double),
        ("start", c_double * 9),
        *_each(c_double * 3, "place goal"),
        ("within", c_double * 4),
        ("wanted", c_int64),
    ]


class Steer(Structure):
    """``steer_t``: start and goal of a contact."""

    _fields_ = [
        ("body", Steered * 2),
        *_each(c_double, "psi w_angle w_length unit"),
        ("rotation", c_double * 9),
        ("origin", c_double * 3),
        *_each(c_double, "size longest tolerance reached"),
        *_each(c_int64, "has_rotation is_pose parts steps"),
    ]


# Addresses are passed as integers: making pointer objects takes longer than the call.
_CALLS: dict[str, Any] = {
    "plan": ctypes.CFUNCTYPE(c_void_p, c_void_p, c_int64, c_void_p, POINTER(Failure)),
    "drop": ctypes.CFUNCTYPE(None, c_void_p),
    # PYFUNCTYPE keeps Python's lock: these change the plan, which other threads may evaluate
    "anchor": ctypes.PYFUNCTYPE(c_int32, c_void_p, c_void_p, POINTER(Failure)),
    "evaluate": ctypes.CFUNCTYPE(c_int32, c_void_p, c_int64, c_void_p, c_void_p, POINTER(Failure)),
    "moments": ctypes.PYFUNCTYPE(c_int32, c_void_p, c_double, c_void_p, POINTER(Failure)),
    "facts": ctypes.CFUNCTYPE(c_int64, c_void_p, c_int64, c_int64, POINTER(Fact)),
    "run": ctypes.CFUNCTYPE(c_int32, c_void_p, c_int64, c_void_p, c_void_p, c_void_p),
    # PYFUNCTYPE again: these take a microsecond, after which threads should not wait for the lock
    "load": ctypes.PYFUNCTYPE(None, c_void_p, c_void_p),
    "step": ctypes.PYFUNCTYPE(None, c_void_p),
    "step_tangents": ctypes.PYFUNCTYPE(None, c_void_p, c_void_p),
    "geodesics": ctypes.CFUNCTYPE(c_int32, c_void_p, c_int64, *[c_void_p] * 4, c_int64, c_void_p),
    "evaluate_at": ctypes.CFUNCTYPE(c_int32, c_void_p, c_double, c_void_p, POINTER(Failure)),
    "steer": ctypes.CFUNCTYPE(c_int32, c_void_p, c_int64, c_int64, *[c_void_p] * 3),
    "sign_changes": ctypes.PYFUNCTYPE(
        c_int64, POINTER(c_double), c_int64, c_int64, c_double, c_double, POINTER(c_double)
    ),
    "sense": ctypes.PYFUNCTYPE(None, c_void_p, c_void_p, c_int64, c_void_p),
    "rays": ctypes.CFUNCTYPE(c_int32, c_void_p, c_void_p, c_double, c_int64, c_void_p, c_void_p),
    "wind": ctypes.PYFUNCTYPE(None, c_void_p, c_void_p, c_void_p),
}


class Engine(Structure):
    """``engine_t``: the library's functions, for the widest vectors of this processor."""

    _fields_ = [("variant", c_char_p), *_CALLS.items()]


_SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
LIBRARY = Path(__file__).with_name(f"_engine{_SUFFIX}")
"""The engine, and the functions of FMI over it."""


try:
    _LIBRARY = ctypes.CDLL(str(LIBRARY))
except OSError as error:
    raise ImportError(
        f"the engine of contact_system cannot be loaded: {error}; install the package again "
        "(pip install .); in a clone, whose sources Python takes first, run programs elsewhere "
        "or pip install -e ."
    ) from None
_LIBRARY.contact_engine.restype = POINTER(Engine)
ENGINE: Engine = _LIBRARY.contact_engine().contents
# reading a field of a structure makes a new function object every time
plan, anchor, evaluate = ENGINE.plan, ENGINE.anchor, ENGINE.evaluate
moments, facts, _run, step = ENGINE.moments, ENGINE.facts, ENGINE.run, ENGINE.step
geodesics, steer, rays, wind = ENGINE.geodesics, ENGINE.steer, ENGINE.rays, ENGINE.wind
sense = ENGINE.sense
_sign_changes = ENGINE.sign_changes
_method = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.py_object)(
    ("PyInstanceMethod_New", ctypes.pythonapi)
)
drop = _method(ENGINE.drop)
"""The ``__del__`` of objects with a plan's address as ``_as_parameter_``. Python code there would
lose Ctrl-C."""
LAYOUT = tuple((c_int32 * 4).in_dll(_LIBRARY, "contact_layout"))
"""Version of the scene's buffer; numbers in its header, in a contact, and in a moment of one."""


def builtin_tables(data: SurfaceData) -> SimpleNamespace:
    """The tables of a bundled surface, with the attributes of `lowering.SurfaceTables`."""
    chart, space, other = (
        [None if at is None else TableData.from_address(at) for at in addresses]
        for addresses in (data.chart, data.space, data.other)
    )
    return SimpleNamespace(chart=chart, space=space, **dict(zip(OTHER, other)))


_COUNT = c_int32.in_dll(_LIBRARY, "n_builtin_surfaces").value
SURFACES = {
    data.name.decode(): data for data in (SurfaceData * _COUNT).in_dll(_LIBRARY, "builtin_surfaces")
}
"""The bundled surfaces by their ``table_name``."""
START, POSE = (TableData * 2).in_dll(_LIBRARY, "contact_tables")
"""The first two tables of contacts in engine.h."""


def address(array: Any) -> int:
    """Address of a contiguous array's first number."""
    try:  # an eighth of the time that numpy takes
        return ctypes.addressof(ctypes.c_char.from_buffer(array))
    except (TypeError, ValueError):  # read-only, or empty
        return array.ctypes.data


def sign_changes(
    coefficients: Sequence[float], start: float, stop: float, order: int = 0
) -> list[float]:
    """Times inside (start, stop) at which a polynomial's derivative changes sign, ascending.

    Double roots, also rounded ones, are no sign changes. Coefficients have the lowest power first.
    """
    n = len(coefficients)
    times = (c_double * (2 * n))()
    return times[: _sign_changes((c_double * n)(*coefficients), n, order, start, stop, times)]


def run(table: TableData, points: np.ndarray, constants: Any) -> np.ndarray:
    """Evaluate a table at points (n_in, n), with constants (n_const,): (n_out, n)."""
    points = np.ascontiguousarray(points, dtype=float)
    constants = np.ascontiguousarray(constants, dtype=float)
    out = np.empty((table.n_out, points.shape[1]))
    if _run(table.address, points.shape[1], address(points), address(constants), address(out)):
        raise MemoryError
    return out


class Machine:
    """A table with registers of its own, for frequent evaluation by one thread at a time.

    ``run`` evaluates the table at ``point`` (n_in,), and writes ``results`` (n_out,). constants:
    (n_const,); registers: (n_regs,), zeros to run on.
    """

    def __init__(
        self,
        table: Any,
        constants: Sequence[float] | np.ndarray = (),
        registers: np.ndarray | None = None,
    ):
        r = np.zeros(table.n_regs) if registers is None else registers
        r[table.n_in : table.first_lit] = constants
        self.addresses = c_void_p(table.address), c_void_p(r.ctypes.data)
        ENGINE.load(*self.addresses)
        code = Program(table.body, r.ctypes.data)
        # making the address beforehand saves half of the time of a call
        self.run = functools.partial(step, c_void_p(ctypes.addressof(code)))
        vars(self.run)["kept"] = table, code, r  # kept alive: C has only their addresses
        self.point, self.results = r[: table.n_in], r[table.first_out :][: table.n_out]
