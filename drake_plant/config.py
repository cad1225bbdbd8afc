"""Settings of a station: one table, the same in Python, YAML, a scene file and ``--set``."""

import dataclasses
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from contact_system import Scene, SceneError, Sphere
from contact_system.checks import (
    finite_number,
    finite_numbers,
    flag,
    known_keys,
    naming,
    of_kind,
    one_of,
)
from contact_system.scene import require_scene
from contact_system.system import COORDINATES

from .hand import Hand

CHECK_PERIOD = 0.01
"""How often a planner checks a `restart_distance` if no `restart_period` is given, s."""

CHOICES = {
    "contact_model": ("hydroelastic", "point"),
    "discrete_contact_approximation": ("sap", "lagged", "similar"),
    "object": ("free", "welded", "turning"),
    "coordinates": (*COORDINATES, "plan"),
    "forces": ("constant", "balance"),
}
EDGES = ("finger_edge", "object_edge")
GAINS = ("position_gain", "velocity_gain", "normal_damping", "spin_gain")
MAY_BE_0 = {"time_step", "friction", "gravity", *GAINS, "slip_gain", "restart_distance"}
# settings that do nothing without a hand, and with one
HANDS_ONLY = ("turn", "move")
TIPS_ONLY = ("coordinates", "disturbance_input", "restart_period", "restart_distance")


@dataclass
class Push:
    """A constant force on one body from one time to another.

    Parameters
    ----------
    on : str
        The contact's name, such as "finger 1", or "object". Write the key as ``"on"`` in YAML,
        which takes the bare word for true.
    start, stop : float
        s.
    force : list of float
        Three numbers, N, in the world, at the mass centre.
    """

    on: str = ""
    start: float = 0.0
    stop: float = 0.0
    force: list[float] = field(default_factory=list)

    def check(self, scene: Scene) -> None:
        """Raise a SceneError that names the first field that is wrong, its value and the remedy."""
        names = body_names(scene)
        one_of(self.on, names, "on")
        if names.count(self.on) > 1:
            raise SceneError(
                f"on = {self.on!r} names {names.count(self.on)} bodies: rename contacts"
            )
        for key in ("start", "stop"):
            finite_number(getattr(self, key), key, "not below 0")
        if not self.start < self.stop:
            raise SceneError(f"stop = {self.stop!r}: give a time after start = {self.start!r}")
        _three_numbers(self.force, "force")


def _three_numbers(vector: Any, name: str) -> None:
    if len(finite_numbers(vector, name)) != 3:
        raise SceneError(f"{name} = {vector!r}: give three numbers")


def body_names(scene: Scene) -> list[str]:
    """Names of the bodies that can be pushed: those of contacts, for the fingers, and "object"."""
    return [*(scene.contact_name(i) for i in range(len(scene.contacts))), "object"]


def check_pushes(scene: Scene, pushes: Sequence[Push]) -> None:
    """Raise a SceneError for the first push that a scene cannot have."""
    require_scene(scene)
    for k, push in enumerate(pushes):
        with naming(f"pushes[{k}]"):
            of_kind(Push, push, "push", "a Push")
            push.check(scene)


@dataclass
class StationConfig:
    """What a station, its plant and its driver are made of.

    Drake's ``yaml_load_typed`` and ``yaml_dump_typed`` read and write it; a scene's ``[drake]``
    table and ``contact-system drake --set drake.KEY=VALUE`` have the same keys.

    With steps of h the driver limits damping gains to 0.4 m/h and stiffnesses to 0.1 m/h^2, where m
    is the finger's mass, or its least moment of inertia for the gain of a rotation.

    Parameters
    ----------
    time_step : float
        Of the plant, s; 0 makes it continuous, for Drake's integrators.
    contact_model : str
        "hydroelastic", or "point" where Drake's point contact is exact: spheres on a sphere or on
        a plane.
    discrete_contact_approximation : str
        "sap", "lagged" or "similar". "lagged" is faster and as accurate while fingers roll, but its
        friction is too small where one slides in fast rolling: in D1 0.88 mu N at steps of 1 ms,
        0.74 mu N at 1.5 ms; in D4 0.67 mu N at 2 ms, too little for `slip_gain` to act.
    object : str
        "free"; "welded" to the world; "turning" as the scene prescribes it.
    object_mass : float
        kg, of uniform density, with the mass centre at the body's origin.
    finger_mass : float
        kg, of each finger, in the same way.
    stiffness : float
        N/m, of a contact that carries ``normal_force``.
    friction : float
        Coulomb's coefficient, static and dynamic.
    normal_force : float
        N, with which every finger presses along the planned normal. With ``forces = "balance"`` or
        a hand it is the least normal force, and ``stiffness`` is that at the mean of the planned
        normal forces over the simulated time.
    gravity : float
        m/s^2, towards -z of the world: 9.81, without a sign.
    forces : str or None
        "constant": each finger presses with ``normal_force``. "balance": a :class:`ForceBalancer`
        chooses normal and tangential forces that hold the object, which is free, against gravity.
        None: "balance" where the object is free and there is gravity, else "constant".
    friction_share : float
        The greatest part of each friction cone that balancing forces use, 1 or less.
    finger_edge, object_edge : float or None
        m, edges of the meshes at the planned contacts; None: chosen by the size of the patch.
    position_gain : float
        N/m, of the driver's spring in the tangent plane.
    velocity_gain : float
        N s/m, of its damper in the tangent plane.
    normal_damping : float
        N s/m, of its damper along the normal; contact itself has no damping.
    spin_gain : float
        N m s, of its damper of rotation.
    slip_gain : float
        1/s, the factor lam by which measured slip is fed back; 0 leaves the loop open. At most
        0.8/h is used, which removes 0.8 of the slip in a step.
    coordinates : str or None
        "chart" or "frame": coordinates of the :class:`ContactPlanner`, which chooses if None.
        "plan": a :class:`PlanSource` is the planner, exact under every scheme; it has no states,
        disturbance port or restarts.
    disturbance_input : bool
        Whether the planner has a port `disturbance`, which the station exports.
    restart_period, restart_distance : float or None
        Of the :class:`ContactPlanner`, s and m; if both are None it does not restart. Restarts have
        to fall on steps of the plant. Use ``slip_gain`` to reject slip, and restarts where a finger
        is too far from the planned curve to be led back. Restarts also take over errors of the
        measured rates, which add up: with one every 10 ms, in C1 to 1.3 mm after 0.3 s, and in R1,
        where they are large beside the low speeds about corners, to 41 mm after 4 s.
    pushes : list of Push
        If there are any, they take the place of the station's port `push`.
    hand : Hand or None
        Its joints carry the fingertips (see :func:`plan_reorientation`); None: they are free.
    turn : list of list of float
        Rotation vectors in the world, degrees, by which a hand turns the object one after another;
        the object takes the shortest way to where they lead.
    move : list of float
        m, by how much a hand moves the object's centre, in the world.
    """

    time_step: float = 1e-3
    contact_model: str = "hydroelastic"
    discrete_contact_approximation: str = "sap"
    object: str = "free"
    object_mass: float = 1.0
    finger_mass: float = 0.1
    stiffness: float = 1e4
    friction: float = 0.5
    normal_force: float = 1.0
    gravity: float = 0.0
    forces: str | None = None
    friction_share: float = 0.8
    finger_edge: float | None = None
    object_edge: float | None = None
    position_gain: float = 400.0
    velocity_gain: float = 60.0
    normal_damping: float = 30.0
    spin_gain: float = 0.04
    slip_gain: float = 0.0
    coordinates: str | None = None
    disturbance_input: bool = False
    restart_period: float | None = None
    restart_distance: float | None = None
    pushes: list[Push] = field(default_factory=list)
    hand: Hand | None = None
    turn: list[list[float]] = field(default_factory=list)
    move: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])

    @property
    def balances(self) -> bool:
        """Whether contact forces are chosen so that they hold the object."""
        if self.forces is None:
            return self.object == "free" and self.gravity != 0
        return self.forces == "balance"

    @property
    def restarts(self) -> bool:
        """Whether the planner restarts from measured states."""
        return self.restart_period is not None or self.restart_distance is not None

    @property
    def closed_loop(self) -> bool:
        """Whether measured contacts are fed back, by restarts or by ``slip_gain``."""
        return self.restarts or self.slip_gain > 0

    def opened(self) -> "StationConfig":
        """The same configuration with the loop open."""
        return dataclasses.replace(self, slip_gain=0.0, restart_period=None, restart_distance=None)

    def table(self) -> dict[str, Any]:
        """A scene's ``[drake]`` table that gives this configuration, with lists for arrays."""

        def plain(given: Any) -> Any:
            return os.fspath(given) if isinstance(given, os.PathLike) else given.tolist()

        table = json.loads(json.dumps(dataclasses.asdict(self), default=plain))
        return {key: value for key, value in table.items() if value is not None}

    def check(self, scene: Scene) -> None:
        """Raise a SceneError that names the first field that is wrong, its value and the remedy."""
        for f in dataclasses.fields(self):
            value = getattr(self, f.name)
            if value is None and f.type in (float | None, str | None):
                continue
            if f.type in (float, float | None):
                finite_number(value, f.name, "not below 0" if f.name in MAY_BE_0 else "above 0")
            elif f.name in CHOICES:
                one_of(value, CHOICES[f.name], f.name)
        flag(self.disturbance_input, "disturbance_input")
        if self.friction_share > 1:
            raise SceneError(f"friction_share = {self.friction_share!r}: give a part, at most 1")
        if self.balances and self.object != "free":
            raise SceneError(
                f'forces = "balance": the object is {self.object}, so that nothing moves it; give '
                '"constant", or object = "free"'
            )
        if self.balances and not self.time_step:
            raise SceneError(
                'forces = "balance": at time_step = 0 integrators take hours, as forces change in '
                'every trial step; give a time step, such as 0.001 s, or "constant"'
            )
        if self.coordinates == "plan" and (self.restarts or self.disturbance_input):
            raise SceneError(
                'coordinates = "plan": a plan has no disturbance port and does not restart; give '
                '"chart" or "frame", or leave disturbance_input and restarts out'
            )
        if self.slip_gain and not self.time_step:
            raise SceneError(
                f"slip_gain = {self.slip_gain!r}: at time_step = 0 the slip depends "
                "on the force that it asks for: give a time step, such as 0.001 s, or no slip_gain"
            )
        if self.restarts and self.time_step:
            self._check_restarts()
        check_pushes(scene, self.pushes)
        self._check_hand(scene)

    def _check_hand(self, scene: Scene) -> None:
        """Refuse what a hand cannot do, and settings without effect with a hand or without one."""
        of_kind((list, tuple), self.turn, "turn", "lists of three numbers, degrees")
        _three_numbers(self.move, "move")
        for k, turn in enumerate(self.turn):
            _three_numbers(turn, f"turn[{k}]")
        which, keys = ("without", HANDS_ONLY) if self.hand is None else ("with", TIPS_ONLY)
        for key in keys:
            value, default = getattr(self, key), getattr(StationConfig(), key)
            if list(np.ravel(value)) != list(np.ravel(default)):
                raise SceneError(f"{key} = {value!r}: it does nothing {which} a hand; leave it out")
        if self.hand is None:
            return
        of_kind(Hand, self.hand, "hand", "a Hand")
        self.hand.check(len(scene.contacts))
        for i, contact in enumerate(scene.contacts):
            if not isinstance(contact.finger, Sphere) or contact.finger.inside:
                raise SceneError(
                    f"{scene.contact_title(i)}: finger = {contact.finger!r}: a fingertip on joints "
                    "is a sphere"
                )
        if self.object != "free" or not self.time_step:
            raise SceneError('hand: it needs object = "free" and a time_step above 0')
        if scene.disturbances:
            raise SceneError("disturbances: a hand has none; leave them out, or give pushes")
        if self.forces == "constant":
            raise SceneError('forces = "constant": forces of a hand always balance; leave it out')

    def _check_restarts(self) -> None:
        """Refuse restarts between two steps of a discrete plant: its state is that of the next step
        already, so a planner that took it over would be ahead, each time by another time.
        """
        step, period = self.time_step, self.restart_period
        steps = (CHECK_PERIOD if period is None else period) / step
        whole = max(1, round(steps))
        # Just before a step a restart sees the state of now; just after it, that of the next step.
        if not -1e-6 < steps / whole - 1 < 1e-9:
            every = f" (None: {CHECK_PERIOD:g} s)" if period is None else ""
            raise SceneError(
                f"restart_period = {period!r}{every}: restarts have to fall on steps of the plant, "
                f"time_step = {step!r}; give restart_period = {whole * step:.12g}, or another "
                "multiple of it"
            )

    @classmethod
    def from_scene(cls, scene: Scene, **changes: Any) -> "StationConfig":
        """The scene's ``[drake]`` table, and changes to it.

        The object of a scene with a ``[turning]`` is "turning" unless they say otherwise.

        Raises
        ------
        SceneError
            An unknown key, with the nearest known one, or a value that is wrong.
        """
        require_scene(scene)
        table = {**({"object": "turning"} if scene.turning else {}), **scene.drake, **changes}
        with naming(f"{scene.title}, [drake]"):
            known_keys(table, sorted(f.name for f in dataclasses.fields(cls)))
            config = cls(**table)
            if config.hand is not None:
                config.hand = _made(Hand, config.hand, "hand")
            of_kind((list, tuple), config.pushes, "pushes", "a list of tables")
            config.pushes = [
                _made(Push, push, f"pushes[{k}]") for k, push in enumerate(config.pushes)
            ]
            config.check(scene)
        return config


def checked(scene: Scene, config: StationConfig | None, what: str) -> StationConfig:
    """The given configuration, checked, or the scene's own; errors say ``what`` it is for."""
    require_scene(scene)
    if config is None:
        return StationConfig.from_scene(scene)
    with naming(f"{scene.title}, {what}"):
        of_kind(StationConfig, config, "config", "a StationConfig")
        config.check(scene)
    return config


def _made(kind: Any, given: Any, name: str) -> Any:
    """The given instance of a dataclass, or one made from a scene file's table for it."""
    if isinstance(given, kind):
        return given
    keys = [f.name for f in dataclasses.fields(kind)]
    of_kind(dict, given, name, f"a table with {', '.join(keys)}")
    known_keys(given, keys, f"{name}: ")
    return kind(**given)
