"""Chunks: the scenes that one worker plans, together where possible, evaluates and tabulates.

Contacts do not act on each other, so contacts of many scenes that share object, profile, gain,
duration and windows are planned as one scene of many contacts. For scenes of one contact this makes
slip 3 times and `summary` 8 times as fast, because fewer Python calls are needed.
"""

from __future__ import annotations

import contextlib
import copy
import functools
import operator
import os
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import ContactSystemError
from ..plan import plan
from ..scene import Contact, Disturbance, Scene, load_scene, scene_to_toml

Item = Scene | str | os.PathLike[str] | Callable[[], Scene]
"""A scene, the name or file of one, or a function that makes one (called where it is planned)."""

Evaluate = Callable[[Any], Mapping[str, ArrayLike]]
"""A function of a Plan, or with ``each=True`` of a Scene."""

WATCH = "contact_system-sweep"  # the thread that ends a worker together with its sweep
TOGETHER = 1000  # contacts in a plan; more are not faster, and their samples exceed the cache


@dataclass(frozen=True)
class Failure:
    """A scene that was not planned or evaluated.

    Attributes
    ----------
    scene : int
        Its index among the scenes given, from 0.
    name : str
    error : str
        Kind and text of the error.
    text : str
        The scene as a scene file; its repr where a file cannot hold it.
    """

    scene: int
    name: str
    error: str
    text: str


@dataclass(frozen=True)
class Part:
    """Results of one chunk of scenes: a table as in :class:`Sweep`, and the failures."""

    table: np.ndarray
    failures: list[Failure]


@dataclass(frozen=True)
class Chunk:
    """Scenes that a worker takes at a time, the index of the first, and the file for results."""

    first: int
    items: tuple[Item, ...]
    file: Path | None


Batch = list[tuple[int, Scene]]
"""Scenes of equally many contacts that can be planned as one, with their indices."""

Run = functools.partial[Part]
"""The function of a chunk that workers call: `run_chunk` with its first three arguments."""


def run_chunk(evaluate: Evaluate, tolerance: float | None, sweeper: int, chunk: Chunk) -> Part:
    """Plan and evaluate the scenes of a chunk; errors become failures in the result.

    If the tolerance is None nothing is planned, and each scene is evaluated by itself. ``sweeper``
    is the id of the sweep's process; this process ends with it.
    """
    end_with(sweeper)

    def work(batch: Batch) -> None:
        try:
            scene = _together(batch)
            outputs = evaluate(scene if tolerance is None else plan(scene, tolerance))
        except Exception as error:  # a user's function may raise anything
            if len(batch) > 1:  # bisect, to find the scene that fails
                half = len(batch) // 2
                work(batch[:half])
                work(batch[half:])
            else:
                failures.append(a_failure(*batch[0], error))
        else:
            tables.append(_table(batch, outputs))

    failures: list[Failure] = []
    tables: list[np.ndarray] = []
    alike: dict[Any, Batch] = {}
    for place, item in enumerate(chunk.items, chunk.first):
        try:
            scene = _scene(item)
            # the first scene is planned alone: in a batch, an axis of times as long as the number
            # of contacts could be mistaken for rows of contacts
            key = (not alike, *_shared(scene)) if tolerance is not None else place
            alike.setdefault(key, []).append((place, scene))
        except Exception as error:  # a user's function may raise anything
            failures.append(a_failure(place, item, error))
    for batch in alike.values():
        size = max(1, TOGETHER // len(batch[0][1].contacts))
        for k in range(0, len(batch), size):
            work(batch[k : k + size])
    failures.sort(key=lambda failure: failure.scene)
    table = joined(tables)
    return Part(table[np.argsort(table["scene"], kind="stable")], failures)


def end_with(sweeper: int) -> None:
    """If this process is a worker of a sweep in another process, let it end when that one does.

    Otherwise it would wait for work forever: it holds both ends of its queue, so it sees no end.
    """
    if os.getpid() == sweeper or any(thread.name == WATCH for thread in threading.enumerate()):
        return
    from multiprocessing import parent_process  # not on the planner's path

    parent, born = parent_process(), os.getppid()
    if parent is not None and parent.pid == sweeper:

        def watch() -> None:
            # workers forked later may keep the parent's sentinel alive, hence the check of getppid;
            # a worker of a fork server is no child of the sweep, hence is_alive
            while parent.is_alive() and os.getppid() == born:
                parent.join(1.0)
            os._exit(1)

        threading.Thread(target=watch, name=WATCH, daemon=True).start()


def _scene(item: Item) -> Scene:
    scene = item() if callable(item) else item
    if isinstance(scene, Scene):
        return scene
    if isinstance(item, (str, os.PathLike)):
        return load_scene(item)
    raise ContactSystemError(
        f"{scene!r:.80} is no scene; give a Scene, the name or file of one, or a function that "
        "makes one"
    )


ITS_OWN = {"contacts", "disturbances", "name", "description"}
"""Fields in which scenes that are planned as one may differ."""
COMMON = operator.attrgetter(*(f.name for f in fields(Scene) if f.name not in ITS_OWN))


def _shared(scene: Scene) -> tuple:
    """Key of the scenes that can be planned as one."""
    common = (repr(x) if isinstance(x, dict) else x for x in COMMON(scene))
    windows = frozenset((type(d), d.start, d.stop) for d in scene.disturbances)
    return *common, windows, len(scene.contacts)


def _together(batch: Batch) -> Scene:
    """The contacts of a batch, in order, as one scene.

    Its parts were checked in their own scenes; to check them again would slow down a sweep of
    disturbed scenes by a seventh.
    """
    contacts: list[Contact] = []
    disturbances: list[Disturbance] = []
    for _, scene in batch:
        for d in scene.disturbances:
            shifted = copy.copy(d)
            vars(shifted)["contact"] = int(d.contact) + len(contacts)
            disturbances.append(shifted)
        contacts += scene.contacts
    one = copy.copy(batch[0][1])
    vars(one).update(contacts=tuple(contacts), disturbances=tuple(disturbances))
    return one


OWN = {"scene": "i8", "contact": "i8", "name": "U1"}  # columns that every table has
NOTHING = np.empty(0, dtype=list(OWN.items()))


def _table(batch: Batch, outputs: Mapping[str, ArrayLike]) -> np.ndarray:
    """The outputs of `evaluate`, checked, as a table with one row for each contact of the batch."""
    each = len(batch[0][1].contacts)
    columns = {
        "scene": np.repeat([place for place, _ in batch], each),
        "contact": np.tile(np.arange(each), len(batch)),
        "name": np.repeat([scene.name for _, scene in batch], each),
    }
    count = len(columns["name"])
    if not isinstance(outputs, Mapping):
        raise ContactSystemError(
            f"evaluate returned {type(outputs).__name__}; return a dict of arrays"
        )
    for key, value in outputs.items():
        if not isinstance(key, str) or not key:
            raise ContactSystemError(f"evaluate returned the key {key!r}; give names as text")
        try:
            array = np.asarray(value)
        except ValueError:  # rows of different shapes
            array = np.array(None)
        if key in OWN or array.shape[:1] != (count,) or array.dtype.hasobject:
            raise ContactSystemError(
                f"evaluate returned '{key}' of shape {array.shape} and type {array.dtype}; give "
                f"one row of numbers or texts for each contact of the plan, ({count}, ...), and a "
                "name other than scene, contact, name"
            )
        columns[key] = array
    table = np.empty(count, [(key, array.dtype, array.shape[1:]) for key, array in columns.items()])
    for key, array in columns.items():
        table[key] = array
    return table


def joined(tables: list[np.ndarray]) -> np.ndarray:
    """The tables one after the other, as one."""
    tables = [table for table in tables if len(table)]
    try:
        return np.concatenate(tables) if tables else NOTHING
    except TypeError as error:
        raise ContactSystemError(
            f"evaluate returned different outputs for different scenes ({error}); return the same "
            "names and shapes for all"
        ) from None


def a_failure(place: int, item: Item, error: BaseException, remedy: str = "") -> Failure:
    text, name = repr(item), getattr(item, "name", "")
    if isinstance(item, Scene):
        with contextlib.suppress(ContactSystemError):  # a surface that a file cannot hold
            text = scene_to_toml(item)
    return Failure(place, str(name), f"{type(error).__name__}: {error}{remedy}", text)
