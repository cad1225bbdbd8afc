"""Many scenes: planned over any executor, results as one table, failures kept beside them.

Contacts do not act on each other, so contacts of many scenes that share object, profile, gain,
duration and windows are planned as one scene of many contacts. One by one the time would go into
Python's calls: of scenes of one contact each, slip would take 3 times as long, `summary` 8 times.
"""

from __future__ import annotations

import contextlib
import copy
import functools
import itertools
import json
import numbers
import os
import pickle
import sys
import threading
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sized
from concurrent import futures
from concurrent.futures import Executor, Future
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .checks import a_path, flag, make_folder
from .errors import ContactSystemError
from .measures import REJECTED
from .plan import Plan, checked_tolerance, plan, require_plan
from .scene import Contact, Disturbance, Scene, load_scene, scene_text, scene_to_toml
from .writing import writing

Item = Scene | str | os.PathLike | Callable[[], Scene]
"""A scene, the name or file of one, or a function that makes one (called where it is planned)."""

Evaluate = Callable[[Plan], Mapping[str, ArrayLike]]

TOGETHER = 1000  # contacts a plan; more save nothing, and their samples would leave the cache
SAMPLES = 100  # times at which `summary` looks at a plan
LOSSES = 2  # workers that a chunk may lose while it is the only one at work
WATCH = "contact_system-sweep"  # the thread by which a worker ends with its sweep


# --- results -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Failure:
    """A scene that was not planned or evaluated.

    Attributes
    ----------
    scene : int
        Its place among the scenes given, from 0.
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
    """What became of one chunk of scenes: a table as in :class:`Sweep`, and the failures."""

    table: np.ndarray
    failures: list[Failure]


class Sweep:
    """Results of :func:`sweep`; iterating gives them one chunk's table at a time, in order.

    Those of a sweep with a folder stay there and are read when they are asked for; a
    ContactSystemError says where they were removed or damaged since.
    """

    def __init__(self, parts: Mapping[int, Part | Path]):
        self._parts = [parts[k] for k in sorted(parts)]

    def parts(self) -> Iterator[Part]:
        """Chunk by chunk, in the order of the scenes."""
        for part in self._parts:
            if isinstance(part, Part):
                yield part
            elif (found := _read(part)) is not None:
                yield found
            else:
                raise ContactSystemError(
                    f"'{part}' holds results of this sweep no more: since then it was removed or "
                    "damaged; call sweep again"
                )

    def __iter__(self) -> Iterator[np.ndarray]:
        return (part.table for part in self.parts())

    @property
    def table(self) -> np.ndarray:
        """Structured array, one row a contact: scene, contact, name, and a field an output.

        Scenes count from 0 in the order given; those in :attr:`failures` have no rows.
        """
        return _joined(list(self))

    @property
    def failures(self) -> list[Failure]:
        """What failed, in the order of the scenes."""
        return [failure for part in self.parts() for failure in part.failures]


def summary(plan: Plan) -> dict[str, np.ndarray]:
    """Slip, its rejection and the final state of each contact: what `sweep` tells by default.

    Parameters
    ----------
    plan : Plan

    Returns
    -------
    dict
        ``slip_start``, ``slip_peak``, ``slip_end`` : (n_contacts,), m/s; the peak is the greatest
        at 100 equally spaced times. ``recovery`` : (n_contacts,), s, the time after the contact's
        last disturbance (or the start) until slip stays below 5 % of its value there, interpolated
        between those times; inf if it stays above, nan if there is no slip.
        ``state_end`` : (n_contacts, 9), as :meth:`Plan.states`.

    Raises
    ------
    ContactSystemError
        If it is no plan.
    """
    require_plan(plan)
    since = np.full(len(plan.scene.contacts), plan.start)
    for d in plan.scene.disturbances:
        since[d.contact] = max(since[d.contact], d.stop)
    # a rate offset's slip ends with its window: what was there is seen just before
    before = np.where(since > plan.start, np.nextafter(since, plan.start), since)
    grid = np.linspace(plan.start, plan.end, SAMPLES)
    t = np.unique(np.concatenate([grid, since, before]))
    slip = plan.slip_speed(t)
    return {
        "slip_start": slip[0],
        "slip_peak": slip.max(axis=0),
        "slip_end": slip[-1],
        "recovery": _recovery(t, slip, since, before),
        "state_end": plan.states(plan.end)[0],
    }


def _recovery(t: np.ndarray, slip: np.ndarray, since: np.ndarray, before: np.ndarray) -> np.ndarray:
    """See `summary`; slip is (n_times, n_contacts)."""
    own, after = np.arange(slip.shape[1]), t[:, None] >= since
    left = slip[np.searchsorted(t, before), own]
    level = REJECTED * np.where(left > 0, left, np.where(after, slip, 0.0).max(axis=0))
    above = after & (slip >= level)
    last = len(t) - 1 - np.argmax(above[::-1], axis=0)
    following = np.minimum(last + 1, len(t) - 1)
    high, low = slip[last, own], slip[following, own]
    with np.errstate(all="ignore"):  # slip decays exponentially, or is gone at once
        part = np.where(low > 0, np.log(high / level) / np.log(high / low), 1.0)
        time = t[last] + part * (t[following] - t[last]) - since
    time[last == len(t) - 1] = np.inf
    time[~above.any(axis=0)] = 0.0
    time[level == 0] = np.nan
    return time


# --- planning a chunk --------------------------------------------------------------------------


@dataclass(frozen=True)
class Chunk:
    """Scenes that one worker takes, the place of the first among all, the file of the results."""

    first: int
    items: tuple[Item, ...]
    file: Path | None


Batch = list[tuple[int, Scene]]
"""Scenes that can be planned as one, of equally many contacts, and their places among all."""

Run = functools.partial[Part]
"""What workers do with a chunk: `run_chunk` with its first three arguments."""


def run_chunk(evaluate: Evaluate, tolerance: float, sweeper: int, chunk: Chunk) -> Part:
    """Plan and evaluate the scenes of a chunk; what goes wrong is part of the result.

    ``sweeper`` is the process of the sweep, which that of this chunk does not outlive.
    """
    _end_with(sweeper)

    def tables_of(batch: Batch) -> list[np.ndarray]:
        try:
            outputs = evaluate(plan(_together(batch), tolerance=tolerance))
        except Exception as error:  # whatever a user's function raises
            if len(batch) > 1:  # in halves, to find what fails
                half = len(batch) // 2
                return tables_of(batch[:half]) + tables_of(batch[half:])
            failures.append(_failure(*batch[0], error))
            return []
        return [_table(batch, outputs)]

    failures: list[Failure] = []
    alike: dict[Any, Batch] = {}
    for place, item in enumerate(chunk.items, chunk.first):
        try:
            scene = _scene(item)
            # the first one alone: an axis of times that is as long as the contacts are many must
            # not pass for rows of contacts
            alike.setdefault((not alike, *_shared(scene)), []).append((place, scene))
        except Exception as error:  # whatever a user's function raises
            failures.append(_failure(place, item, error))
    tables = []
    for batch in alike.values():
        size = max(1, TOGETHER // len(batch[0][1].contacts))
        for k in range(0, len(batch), size):
            tables += tables_of(batch[k : k + size])
    table = _joined(tables)
    failures.sort(key=lambda failure: failure.scene)
    return Part(table[np.argsort(table["scene"], kind="stable")], failures)


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


def _shared(scene: Scene) -> tuple:
    """Scenes that agree in this can be planned as one."""
    windows = frozenset((type(d), d.start, d.stop) for d in scene.disturbances)
    given = scene.object, scene.profile, scene.gain, scene.duration, scene.turning
    return *given, windows, repr(scene.paper), len(scene.contacts)


def _together(batch: Batch) -> Scene:
    """The contacts of a batch, in order, as one scene.

    Its parts were checked in their own scenes, and are not again: with that a sweep of disturbed
    scenes would take a seventh longer.
    """
    contacts: list[Contact] = []
    disturbances: list[Disturbance] = []
    for _, scene in batch:
        for d in scene.disturbances:
            moved = copy.copy(d)
            vars(moved)["contact"] = int(d.contact) + len(contacts)
            disturbances.append(moved)
        contacts += scene.contacts
    one = copy.copy(batch[0][1])
    vars(one).update(contacts=tuple(contacts), disturbances=tuple(disturbances))
    return one


def _table(batch: Batch, outputs: Mapping[str, ArrayLike]) -> np.ndarray:
    """One row a contact of the batch, from what `evaluate` returned."""
    contacts = len(batch[0][1].contacts)
    count = contacts * len(batch)
    columns = {
        "scene": np.repeat([place for place, _ in batch], contacts),
        "contact": np.tile(np.arange(contacts), len(batch)),
        "name": np.repeat([scene.name for _, scene in batch], contacts),
    }
    if not isinstance(outputs, Mapping):
        raise ContactSystemError(
            f"evaluate returned {type(outputs).__name__}; return a dict of arrays"
        )
    for key, value in outputs.items():
        if not isinstance(key, str):
            raise ContactSystemError(f"evaluate returned the key {key!r}; give names as text")
        try:
            array = np.asarray(value)
        except ValueError:  # rows of different shapes
            array = np.array(None)
        if key in columns or array.shape[:1] != (count,) or array.dtype.hasobject:
            raise ContactSystemError(
                f"evaluate returned '{key}' of shape {array.shape} and type {array.dtype}; give it "
                f"one row of numbers or texts a contact of the plan, ({count}, ...), and a name "
                "other than scene, contact, name"
            )
        columns[key] = array
    table = np.empty(count, [(key, array.dtype, array.shape[1:]) for key, array in columns.items()])
    for key, array in columns.items():
        table[key] = array
    return table


NOTHING = np.empty(0, dtype=[("scene", np.int64), ("contact", np.int64), ("name", "U1")])


def _joined(tables: list[np.ndarray]) -> np.ndarray:
    tables = [table for table in tables if len(table)]
    try:
        return np.concatenate(tables) if tables else NOTHING
    except TypeError as error:
        raise ContactSystemError(
            f"evaluate returned other outputs for other scenes ({error}); return the same names "
            "and shapes for all"
        ) from None


def _failure(place: int, item: Item, error: BaseException) -> Failure:
    text, name = repr(item), getattr(item, "name", "")
    if isinstance(item, Scene):
        with contextlib.suppress(ContactSystemError):  # a surface that a file cannot hold
            text = scene_to_toml(item)
    return Failure(place, str(name), f"{type(error).__name__}: {error}", text)


# --- the sweep ---------------------------------------------------------------------------------


def sweep(
    scenes: Iterable[Item],
    evaluate: Evaluate = summary,
    executor: Executor | None = None,
    *,
    folder: str | os.PathLike[str] | None = None,
    chunk: int = 500,
    ahead: int | None = None,
    tolerance: float = 1e-12,
    compiled: bool | None = None,
) -> Sweep:
    """Plan and evaluate many scenes.

    Parameters
    ----------
    scenes : iterable of Scene
        Also a generator, of which no more is taken than is at work. An item may be the name or file
        of a scene, or a function without arguments that makes one: it is called by the worker, and
        what it raises is a failure of that scene.
    evaluate : callable
        Takes a Plan and returns a dict of arrays with one row a contact of the plan,
        (n_contacts, ...). Contacts of scenes that differ in nothing but contacts and values of
        disturbances are planned together, so the plan may hold those of many scenes; treat each
        contact on its own. What it raises is a failure of the scene.
    executor : concurrent.futures.Executor, optional
        Threads, processes, a Dask cluster's ``client.get_executor()``; None: here. What is lost
        with a worker is done again; a pool of processes that broke is replaced by one like it.
    folder : path, optional
        Keep the results of each chunk in a file there, not in memory. The same call continues where
        an interrupted one stopped: chunks whose scenes (or what is in their files), tolerance and
        name of ``evaluate`` (and the numbers, texts, tuples and arrays that it encloses, where a
        function made it) have not changed are not done again; a lambda has no name of its own.
        Files are named and checked by digests: sweeps may share a folder, also at the same time,
        and what is damaged is done again. Results of scenes that have changed stay there.
    chunk : int
        Scenes that a worker takes at a time, and that are planned together at most.
    ahead : int, optional
        Chunks at work or waiting for a worker; by default twice this machine's cores. Give at least
        twice the workers of a cluster.
    tolerance, compiled
        As in :func:`plan`.

    Returns
    -------
    Sweep
        ``table``, ``failures``.

    Raises
    ------
    ContactSystemError
        ``scenes`` that are no list of them; ``chunk`` or ``ahead`` that is no whole number from 1;
        another argument of the wrong kind; outputs without a row of numbers or texts a contact, or
        that differ from scene to scene; a folder that cannot be made or written to; functions that
        cannot be sent to another process; an executor that broke and cannot be replaced.
    """
    from .cli import Progress  # not on the planner's path

    if isinstance(scenes, (Scene, str, os.PathLike)) or not isinstance(scenes, Iterable):
        raise ContactSystemError(f"scenes = {scenes!r:.80}: give a list of scenes; of one, [scene]")
    ahead = 2 * (os.cpu_count() or 1) if ahead is None else ahead
    for name, value in (("chunk", chunk), ("ahead", ahead)):
        whole = isinstance(value, numbers.Integral) and not isinstance(value, bool)
        if not whole or value < 1:
            raise ContactSystemError(f"{name} = {value!r}: give a whole number, at least 1")
    if not callable(evaluate):
        raise ContactSystemError(f"evaluate = {evaluate!r:.80}: give a function of a plan")
    if executor is not None and not isinstance(executor, Executor):
        raise ContactSystemError(
            f"executor = {executor!r:.80}: give an executor, such as ProcessPoolExecutor(4) or a "
            "Dask client's get_executor()"
        )
    flag(compiled, "compiled", none=True)
    run = functools.partial(run_chunk, evaluate, checked_tolerance(tolerance), os.getpid())
    if folder is not None:  # absolute: results may be read from another current folder
        folder = make_folder(a_path(folder, "folder"), "give another folder").absolute()
    parts: dict[int, Part | Path] = {}
    chunks = _unfinished(scenes, chunk, run, folder, parts)
    if executor is None:
        finished = ((done, run(done)) for done in chunks)
    else:
        finished = _spread(chunks, run, executor, ahead)
    # how many a generator has is not known: its bar stays empty, the count beside it runs
    steps = -(-len(scenes) // chunk) if isinstance(scenes, Sized) else sys.maxsize
    with Progress(max(steps, 1), "0 scenes") as progress, contextlib.closing(finished):
        count = 0
        for done, part in finished:
            parts[done.first] = _keep(part, done.file)
            count += len(done.items)
            progress.name, progress.done = f"{count} scenes", len(parts)
    return Sweep(parts)


def _spread(
    chunks: Iterator[Chunk], run: Run, executor: Executor, ahead: int
) -> Generator[tuple[Chunk, Part]]:
    """Run chunks on an executor, at most ``ahead`` at a time.

    Chunks lost with a worker go again in the end, one at a time, so that one which kills its worker
    shows: its scenes become failures after ``LOSSES`` more workers.
    """
    lost = []
    with contextlib.closing(_Crew(executor, run)) as crew:
        for chunk, part in crew.work(chunks, ahead):
            if isinstance(part, Part):
                yield chunk, part
            else:
                lost.append(chunk)
        for chunk in lost:
            for _ in range(LOSSES):
                ((_, part),) = crew.work([chunk], 1)
                if isinstance(part, Part):
                    break
            else:
                places = enumerate(chunk.items, chunk.first)
                part = Part(NOTHING, [_failure(*placed, part) for placed in places])
            yield chunk, part


class _Crew:
    """The workers of an executor, and of the one in its place after it broke."""

    def __init__(self, executor: Executor, run: Run):
        self.executor, self.given, self.run = executor, executor, run
        # a worker that was given no chunk yet must end with the sweep, too
        if isinstance(executor, futures.ProcessPoolExecutor):
            pool: Any = executor
            if pool._initializer is not _begin:
                pool._initargs = (os.getpid(), pool._initializer, pool._initargs)
                pool._initializer = _begin

    def work(self, chunks: Iterable[Chunk], ahead: int) -> Generator[tuple[Chunk, Any]]:
        """Chunks as they are done, each with its part or with the error that took its worker."""
        working: dict[Future, Chunk] = {}
        waiting = iter(chunks)
        try:
            while True:
                for chunk in itertools.islice(waiting, ahead - len(working)):
                    working[self._submit(chunk)] = chunk
                if not working:
                    return
                for future in futures.wait(working, return_when=futures.FIRST_COMPLETED).done:
                    yield working.pop(future), _outcome(future)
        finally:
            for future in working:
                future.cancel()

    def _submit(self, chunk: Chunk) -> Future:
        executor = self.executor
        try:
            return executor.submit(self.run, chunk)
        except RuntimeError as error:
            broke = isinstance(error, futures.BrokenExecutor)
            if not broke or not isinstance(executor, futures.ProcessPoolExecutor):
                raise ContactSystemError(
                    f"the executor {executor!r} takes no work ({error}); give one that is not "
                    "shut down, and where it starts processes, sweep below if __name__ == "
                    "'__main__'; with a folder, what is finished is not done again"
                ) from error
        self.close()
        names = ("_max_workers", "_mp_context", "_initializer", "_initargs")
        self.executor = futures.ProcessPoolExecutor(*(getattr(executor, name) for name in names))
        return self.executor.submit(self.run, chunk)

    def close(self) -> None:
        """Shut down what was not given."""
        if self.executor is not self.given:
            self.executor.shutdown()


def _begin(sweeper: int, initializer: Callable | None, arguments: tuple) -> None:
    """Begin a worker: watch the sweep, then do what the executor was given."""
    _end_with(sweeper)
    if initializer is not None:
        initializer(*arguments)


def _end_with(sweeper: int) -> None:
    """See that this process, if it is a worker of the sweep in another one, ends with that one.

    It would wait for work forever, as it holds the other end of its queue itself.
    """
    if os.getpid() == sweeper or any(thread.name == WATCH for thread in threading.enumerate()):
        return
    from multiprocessing import parent_process  # not on the planner's path

    parent, born = parent_process(), os.getppid()
    if parent is not None and parent.pid == sweeper:

        def watch() -> None:
            # of forked processes later ones may keep alive what tells that the parent is gone, and
            # one of a fork server is no child of it
            while parent.is_alive() and os.getppid() == born:
                parent.join(1.0)
            os._exit(1)

        threading.Thread(target=watch, name=WATCH, daemon=True).start()


def _outcome(future: Future) -> Part | Exception:
    """The part, or the error that says that the worker is gone; any other error is raised."""
    try:
        return future.result()
    except (futures.BrokenExecutor, futures.CancelledError) as error:
        return error
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise ContactSystemError(
            f"a chunk cannot be sent to the executor's processes ({error}); give functions of a "
            "module, or functools.partial of one, or an executor of threads"
        ) from error
    except Exception as error:
        if type(error).__name__ == "KilledWorker":  # of Dask, whose workers died again and again
            return error
        raise


# --- keeping results ---------------------------------------------------------------------------


def _unfinished(
    scenes: Iterable[Item], size: int, run: Run, folder: Path | None, parts: dict[int, Part | Path]
) -> Iterator[Chunk]:
    """Chunks of the scenes, but for those with results in a file, which joins the parts."""
    items, first, file = iter(scenes), 0, None
    while own := tuple(itertools.islice(items, size)):
        if folder is not None:
            file = folder / f"chunk-{first:08d}-{_digest(run, first, own)}.npz"
        if file is not None and _read(file) is not None:
            parts[first] = file
        else:
            yield Chunk(first, own, file)
        first += size


def _keep(part: Part, path: Path | None) -> Part | Path:
    """The part, or its file."""
    if path is None:
        return part
    failures = json.dumps([asdict(failure) for failure in part.failures])
    with writing(path) as file:
        seal = _seal(path, part.table, failures)
        np.savez(file, table=part.table, failures=failures, seal=seal)
    return path


def _read(path: Path) -> Part | None:
    """What is kept; None where the file is not there, is damaged or holds other results."""
    try:
        with np.load(path) as data:
            table, failures = data["table"], str(data["failures"])
            if str(data["seal"]) != _seal(path, table, failures):
                return None
            return Part(table, [Failure(**fields) for fields in json.loads(failures)])
    except Exception:  # whatever a file of another kind, or a damaged one, leads to
        return None


def _seal(path: Path, table: np.ndarray, failures: str) -> str:
    """Digest of what a file holds and, as its name does, of what that was made from."""
    import hashlib  # slow to import, and of no use but with a folder

    said = f"{path.name} {table.dtype.descr} {table.shape} {failures}"
    return hashlib.sha256(said.encode() + table.tobytes()).hexdigest()


def _digest(run: Run, first: int, items: tuple[Item, ...]) -> str:
    """Of all that decides a chunk's results."""
    import hashlib

    from . import __version__

    evaluate, tolerance, _ = run.args
    name = getattr(evaluate, "__qualname__", "")
    # a lambda has no name of its own, and a method's result depends on its object
    if not name or "<lambda>" in name or hasattr(evaluate, "__self__"):
        known = _pickled(evaluate)
    else:
        known = f"{evaluate.__module__}.{name} {_enclosed(evaluate)}".encode()
    found = hashlib.sha256(known + f"{__version__} {tolerance!r} {first}".encode())
    for item in items:
        found.update(_content(item))
    return found.hexdigest()[:32]


def _enclosed(function: Callable) -> str:
    """What a function made inside another one takes from there, as far as it stays what it is."""
    values = []
    for cell in getattr(function, "__closure__", None) or ():
        with contextlib.suppress(ValueError):  # a name that has no value yet
            if isinstance(cell.cell_contents, (numbers.Number, str, tuple, np.ndarray)):
                values.append(cell.cell_contents)
    with np.printoptions(threshold=sys.maxsize, floatmode="unique"):  # arrays in full
        return repr(values)


def _content(item: Item) -> bytes:
    """What tells an item from others: of a file also what is in it now."""
    if callable(item):  # its repr is its address
        return _pickled(item)
    said = repr(item)  # pickles of equal scenes may differ
    if isinstance(item, (str, os.PathLike)):
        try:
            said += scene_text(item)[0]
        except ContactSystemError as error:
            said += str(error)
    return said.encode()


def _pickled(function: Callable) -> bytes:
    try:
        return pickle.dumps(function)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise ContactSystemError(
            f"{function!r}: a sweep with a folder must know it again ({error}); give a function of "
            "a module, or functools.partial of one"
        ) from None
