"""Settings of a station: one table, the same in Python, YAML, a scene file and ``--set``."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from contact_system import Scene, SceneError
from contact_system.checks import (
    did_you_mean,
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

LOOK = 0.01
"""How often a planner looks at the distance from the plan where no period is given, s."""

CHOICES = {
    "contact_model": ("hydroelastic", "point"),
    "discrete_contact_approximation": ("sap", "lagged", "similar"),
    "object": ("free", "welded", "turning"),
    "coordinates": (*COORDINATES, "plan"),
    "forces": ("constant", "balance"),
}
EDGES = ("finger_edge", "object_edge")
GAINS = ("position_gain", "velocity_gain", "normal_damping", "spin_gain")
RESTARTS = ("restart_period", "restart_distance")
MAY_BE_0 = {"time_step", "friction", "gravity", *GAINS, "slip_gain", "restart_distance"}
HANDS_ONLY = ("turn", "move")
TIPS_ONLY = ("coordinates", "disturbance_input", *RESTARTS)  # that are free


@dataclass
class Push:
    """A force on one body for some time.

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
        if self.on not in (names := body_names(scene)):
            raise SceneError(
                f"on = {self.on!r}{did_you_mean(str(self.on), names)}: give one of "
                f"{', '.join(names)}"
            )
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
    """What can be pushed: the contacts by their names, and the object."""
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

    With a step of h the driver uses at most 0.4 m/h of what damps and 0.1 m/h^2 of what is a
    stiffness, and of rotations with the least moment of inertia instead of m.

    Parameters
    ----------
    time_step : float
        Of the plant, s; 0 makes it continuous, for Drake's integrators.
    contact_model : str
        "hydroelastic", or "point" where Drake's point contact is exact: spheres on a sphere or on
        a plane.
    discrete_contact_approximation : str
        "sap", "lagged" or "similar". "lagged" is quicker and as true while fingers roll, but where
        one slides in fast rolling it makes too little friction: in D1 0.88 mu N at steps of 1 ms,
        0.74 at 1.5 ms.
    object : str
        "free"; "welded" to the world; "turning" as the scene prescribes it.
    object_mass : float
        kg, spread evenly, with the mass centre at the body's origin.
    finger_mass : float
        kg, of each finger, in the same way.
    stiffness : float
        N/m, of a contact that carries ``normal_force``.
    friction : float
        Coulomb's coefficient, static and dynamic.
    normal_force : float
        N, along the planned normal, with which every finger presses; with ``forces = "balance"`` or
        a hand at least, and ``stiffness`` is that at the mean force of the plan, as far as it is
        simulated.
    gravity : float
        m/s^2, towards -z of the world: 9.81, without a sign.
    forces : str or None
        "constant": each finger presses with ``normal_force``. "balance": a :class:`ForceBalancer`
        chooses normal and tangential forces that hold the object, which is free, against gravity.
        None: "balance" where the object is free and there is gravity, else "constant".
    friction_share : float
        Of a balance, the part of each friction cone that it uses at most, 1 or less.
    finger_edge, object_edge : float or None
        m, edges of the meshes at the planned contacts; None: chosen by the size of the patch.
    position_gain : float
        Of the driver, N/m, in the tangent plane.
    velocity_gain : float
        N s/m, there.
    normal_damping : float
        N s/m, along the normal; contact itself is elastic.
    spin_gain : float
        N m s.
    slip_gain : float
        lam of the slip that is measured, 1/s; 0 leaves the loop open. At most 0.8/h is used, which
        takes away so much of the slip in a step.
    coordinates : str or None
        "chart" or "frame", of the :class:`ContactPlanner`, who chooses where it is None; "plan": a
        :class:`PlanSource` is the planner, without states, disturbance port and restarts, exact
        under every scheme.
    disturbance_input : bool
        Whether the planner's `disturbance` port is there, exported.
    restart_period, restart_distance : float or None
        Of the :class:`ContactPlanner`, s and m; without any it does not restart. Restarts have to
        fall on steps of the plant. Slip is rejected by the driver's ``slip_gain``; a restart serves
        where the way back to the curve is too long.
    pushes : list of Push
        Where there are any, they are what the port `push` would give.
    hand : Hand or None
        Fingertips are on its joints, and not free (see :func:`plan_reorientation`).
    turn : list of list of float
        Rotation vectors in the world, degrees, by which a hand turns the object one after another;
        the object takes the shortest way to where they lead.
    move : list of float
        By how much it moves the object's middle, m.
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
        """Whether contact forces are those that hold the object."""
        if self.forces is None:
            return self.object == "free" and self.gravity != 0
        return self.forces == "balance"

    @property
    def restarts(self) -> bool:
        """Whether the planner restarts from measured states."""
        return self.restart_period is not None or self.restart_distance is not None

    @property
    def closed_loop(self) -> bool:
        """Whether anything that is measured acts on the fingers."""
        return self.restarts or self.slip_gain > 0

    def opened(self) -> "StationConfig":
        """The same with the loop open."""
        return dataclasses.replace(self, slip_gain=0.0, restart_period=None, restart_distance=None)

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
        """Refuse what a hand cannot do, and what does nothing with one, or without."""
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
        if self.object != "free" or not self.time_step:
            raise SceneError('hand: it needs object = "free" and a time_step above 0')
        if scene.disturbances:
            raise SceneError("disturbances: a hand does not follow them; leave them out, or push")
        if self.forces == "constant":
            raise SceneError('forces = "constant": with a hand they balance; leave it out')

    def _check_restarts(self) -> None:
        """Refuse restarts between two steps of a discrete plant, whose state is that of the step's
        end by then: a planner that starts from it would be ahead, by another time at each restart.
        """
        step, period = self.time_step, self.restart_period
        steps = (LOOK if period is None else period) / step
        whole = max(1, round(steps))
        # A restart a little before the step sees the right state; one after it, the next step's.
        if not -1e-6 < steps / whole - 1 < 1e-9:
            every = f" (None: {LOOK:g} s)" if period is None else ""
            raise SceneError(
                f"restart_period = {period!r}{every}: restarts have to fall on steps of the plant, "
                f"time_step = {step!r}; give restart_period = {whole * step:.9g}, or another "
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
    """The configuration, or what the scene's table says, that ``what`` is made from."""
    require_scene(scene)
    if config is None:
        return StationConfig.from_scene(scene)
    with naming(f"{scene.title}, {what}"):
        of_kind(StationConfig, config, "config", "a StationConfig")
        config.check(scene)
    return config


def _made(kind: Any, given: Any, name: str) -> Any:
    """A dataclass, or one from the table that a scene file has for it."""
    if isinstance(given, kind):
        return given
    keys = [f.name for f in dataclasses.fields(kind)]
    of_kind(dict, given, name, f"a table with {', '.join(keys)}")
    known_keys(given, keys, f"{name}: ")
    return kind(**given)
