"""A plan as a LeafSystem without continuous state: exact under every integrator."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.framework import LeafSystem

from contact_system import Plan, SceneError
from contact_system.checks import Array
from contact_system.plan import require_plan
from contact_system.system import SystemMachine

from .lifetimes import NO_DICTIONARY
from .planner_base import PlannerBase, scene_system

PLANNED = dict(slip="slip", twist="twist", pose="pose", state="states", contact_point="points")
"""Ports that Plan.evaluate fills, and its names for them."""
RATES = ("acceleration", "normal", "normal_rate")
"""Ports that are computed from the moving frames of a plan."""


class PlanSource(PlannerBase, LeafSystem):
    """The outputs of a plan at the current time, exact under every integrator.

    .. pydrake_system::

        name: PlanSource
        output_ports:
        - those of a ContactPlanner

    Unlike a ContactPlanner's in frame coordinates, chart coordinates are continuous along the path.
    There is no continuous state, so nothing is integrated, and no conversion to other scalars, so
    Drake's Clone refuses it; threads may share it with a Context each. No integrator steps across
    an edge of the scene's windows or a corner of legs.

    Parameters
    ----------
    plan : Plan
        Of ``method="auto"``; also one that was restarted or continued.

    Raises
    ------
    ContactSystemError
        Not such a plan. In a simulation: a time outside the plan's horizon, a contact at a pole or
        an umbilic where the port's numbers do not exist.
    """

    __slots__ = NO_DICTIONARY

    def __init__(self, plan: Plan):
        LeafSystem.__init__(self)
        require_plan(plan)
        if plan.method != "auto":
            raise SceneError(
                f"{plan.scene.title}: method = {plan.method!r}: give a plan of the default method"
            )
        self.plan = plan
        self._DeclareOutputs(scene_system(plan.scene, "frame"))

    def _Parts(self, context: Any, *outputs: str) -> list[Array]:
        t, names = context.get_time(), [name for name in outputs if name in PLANNED]
        results = self.plan.evaluate(t, *(PLANNED[name] for name in names)) if names else {}
        found = {name: results[PLANNED[name]] for name in names}
        if "pose" in found:  # the port has the rotation by columns
            found["pose"] = found["pose"][0, :, :3].swapaxes(1, 2)
        if len(names) < len(outputs):
            found |= self._Rates(t)
        return [found[name] for name in outputs]

    def _Rates(self, t: float) -> dict[str, Array]:
        system = self.system
        x, held = system.place(t, self.plan.moments(t))
        machine = SystemMachine(system, *RATES)
        machine.point[:] = np.hstack([t, x, system.window_values(t), held])
        machine.run()
        return dict(zip(RATES, machine.parts))
