"""The planner as an FMI slave in this process: the FMU's own code behind fmpy's classes.

An unmodified ``fmpy.simulate_fmu`` runs it, without an exported file::

    with in_process(scene, "3.0") as slave:
        result = fmpy.simulate_fmu(**slave, output_interval=1e-3)

An error is fmpy's FMICallException, and its text ends with the log line.
"""

from __future__ import annotations

import contextlib
import logging
import shutil
import tempfile
import weakref
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi3 import FMU3Slave
from fmpy.model_description import read_model_description

from contact_system.checks import flag, of_kind, one_of
from contact_system.engine.binding import LIBRARY
from contact_system.scene import Scene

from .data import scene_data
from .description import VERSIONS, model_description, model_identifier
from .variables import variable_table

Logger = Callable[[int, str, str], None]
"""Takes a status, a category of `LOG_CATEGORIES` and a text."""


@contextlib.contextmanager
def in_process(scene: Scene, fmi_version: str = "2.0", **given: Any) -> Iterator[dict[str, Any]]:
    """What ``fmpy.simulate_fmu`` needs to run a scene in this process, as keyword arguments.

    Parameters
    ----------
    scene : Scene
    fmi_version : "2.0" or "3.0"
    given
        Further arguments of `PlannerSlave2` or `PlannerSlave3`.

    Raises
    ------
    ContactSystemError
        A scene that no importer can step, or an unknown version.
    """
    slaves = dict(zip(VERSIONS, (PlannerSlave2, PlannerSlave3)))
    slave = slaves[one_of(fmi_version, slaves, "fmi_version")](scene, **given)
    yield {
        "filename": slave.unzipDirectory,
        "model_description": read_model_description(slave.unzipDirectory, validate=True),
        "fmu_instance": slave,
        "fmi_type": "CoSimulation",
        "use_event_mode": given.get("event_mode", False),
        "early_return_allowed": given.get("early_return", False),
    }


class _Slave:
    """What both versions of FMI share; mixed in before fmpy's class."""

    _version: str
    _plain: type
    instantiate: Callable[..., None]
    component: Any = None

    def __init__(
        self, scene: Scene, name: str = "", logger: Logger | None = None, **described: Any
    ):
        remedy = "a function of a status, a category and a text, or None"
        of_kind((Callable, type(None)), logger, "logger", remedy)
        table, identifier = variable_table(scene, **described), model_identifier(scene)
        self.scene, self._logger, self._said = scene, logger or _log, ""
        folder = Path(tempfile.mkdtemp(prefix="contact-system-"))
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        data, token = scene_data(table, self._version)
        text = model_description(table, token, self._version, ("CoSimulation",))
        (folder / "modelDescription.xml").write_text(text, "utf-8")
        (folder / "resources").mkdir()
        (folder / "resources" / "scene.bin").write_bytes(data)
        # fmpy finds functions by the name of its own class, and in FMI 3 a library elsewhere by
        # a modelIdentifier that is an absolute path; the attributes that it sets are taken over
        plain = self._plain(
            guid=token,
            modelIdentifier=str(LIBRARY.with_suffix("")),
            libraryPath=str(LIBRARY),
            unzipDirectory=str(folder),
            instanceName=name or identifier,
        )
        self.__dict__ |= plain.__dict__ | {"modelIdentifier": identifier}
        self.instantiate(loggingOn=True)

    def _tell(self, *words: Any) -> None:
        status, category, text = words[-3:]  # FMI 2 gives the instance first
        self._said = text.decode()
        self._logger(status, category.decode(), self._said)

    def _call(self, function: str, *args: Any, **given: Any) -> Any:
        try:
            return super()._call(function, *args, **given)  # type: ignore[misc]
        except FMICallException as error:
            error.args = (f"{error.args[0]} {self._said}",)
            raise

    def freeInstance(self) -> None:
        """Free what the instance holds, once; garbage collection does it too."""
        if self.component:
            super().freeInstance()  # type: ignore[misc]
            self.component = None

    __del__ = freeInstance

    def freeLibrary(self) -> None:
        """Do nothing: the library is this package's engine, which stays loaded."""


def _log(status: int, category: str, text: str) -> None:
    level = (logging.INFO, logging.WARNING, logging.WARNING, logging.ERROR)[status]
    logging.getLogger("fmu_export").log(level, "%s: %s", category, text)


class PlannerSlave2(_Slave, FMU2Slave):
    """A scene as fmpy's slave for FMI 2.0 Co-Simulation, instantiated.

    Parameters
    ----------
    scene : Scene
    name : str
        The instance's name.
    logger : callable, optional
        See `Logger`; by default the logger "fmu_export" of `logging`.
    described
        ``arrays`` and ``measured``, as for `export_fmu`.

    Raises
    ------
    SceneError
        A scene that no importer can step, or an option of the wrong kind.
    """

    _version, _plain = "2.0", FMU2Slave

    def instantiate(self, visible: bool = False, callbacks: Any = None, loggingOn: bool = False):
        """Begin again, with this slave's logger."""
        self.freeInstance()
        self._kept = fmi2CallbackFunctions(logger=fmi2CallbackLoggerTYPE(self._tell))
        super().instantiate(visible, self._kept, loggingOn)


class PlannerSlave3(_Slave, FMU3Slave):
    """A scene as fmpy's slave for FMI 3.0 Co-Simulation, instantiated.

    Parameters
    ----------
    scene : Scene
    name : str
        As for `PlannerSlave2`; so are logger and described.
    logger : callable, optional
    described
    event_mode : bool
        The importer handles events: steps report the edges of disturbance windows.
    early_return : bool
        With event mode: a step ends at such an edge.
    """

    _version, _plain = "3.0", FMU3Slave

    def __init__(
        self,
        scene: Scene,
        name: str = "",
        logger: Logger | None = None,
        event_mode: bool = False,
        early_return: bool = False,
        **described: Any,
    ):
        self._options = flag(event_mode, "event_mode"), flag(early_return, "early_return")
        super().__init__(scene, name, logger, **described)

    def instantiate(self, visible: bool = False, loggingOn: bool = False, **_: Any):
        """Begin again, with this slave's logger and options."""
        self.freeInstance()
        events, early = self._options
        super().instantiate(visible, loggingOn, events, early, self._tell)
