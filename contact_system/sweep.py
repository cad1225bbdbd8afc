"""Many scenes: planned over any executor, results as one table, failures kept beside them.

Contacts are independent of each other, so contacts of many scenes that share object, profile, gain,
duration and windows are planned as one scene of many contacts; that is where the speed comes from.
Other scenes are planned one by one.
"""

from __future__ import annotations

import contextlib
import copy
import hashlib
import itertools
import json
import numbers
import os
import pickle
import sys
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sized
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    wait,
)
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .checks import a_path, flag, make_folder, writing
from .errors import ContactSystemError
from .measures import REJECTED
from .plan import Plan, checked_tolerance, plan, require_plan
from .scene import Contact, Disturbance, Scene, load_scene, scene_text, scene_to_toml

Item = Scene | str | os.PathLike | Callable[[], Scene]
"""A scene, the name or file of one, or a function that makes one (called where it is planned)."""

Evaluate = Callable[[Plan], Mapping[str, ArrayLike]]

TOGETHER = 1000  # contacts a plan; more save nothing, and their samples would leave the cache
SAMPLES = 100  # times at which `summary` looks at a plan
LOSSES = 2  # workers that a chunk may lose while it is the only one at work


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


@dataclass(frozen=True)
class Kept:
    """A part in a file, and the digest by which the file knows its scenes."""

    path: Path
    digest: str


class Sweep:
    """Results of :func:`sweep`; iterating gives them one chunk's table at a time, in order.

    Those of a sweep with a folder stay there and are read when they are asked for; a
    ContactSystemError says where they were removed, damaged or written over since.
    """

    def __init__(self, parts: Mapping[int, Part | Kept]):
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
                    f"'{part.path}' holds results of this sweep no more: since then it was "
                    "removed, damaged or written over by another sweep; call sweep again, with a "
                    "folder of its own"
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
        "state_end": plan.states([plan.end])[0],
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
class Job:
    """What is done with every scene."""

    evaluate: Evaluate
    tolerance: float


@dataclass(frozen=True)
class Chunk:
    """Scenes that one worker takes: its number, the place of its first scene, the scenes."""

    number: int
    first: int
    items: tuple[Item, ...]


Placed = tuple[int, Scene]
"""A scene and its place among all."""


def run_chunk(job: Job, chunk: Chunk) -> Part:
    """Plan and evaluate the scenes of a chunk; what goes wrong is part of the result."""
    failures: list[Failure] = []
    alike: dict[Any, list[Placed]] = {}
    for place, item in enumerate(chunk.items, chunk.first):
        try:
            scene = _scene(item)
            alike.setdefault(_kind(scene), []).append((place, scene))
        except Exception as error:  # whatever a user's function raises
            failures.append(_failure(place, item, error))
    batches = [batch for scenes in alike.values() for batch in _batches(scenes)]
    if chunk.number == 0 and batches:  # one alone: an axis of times that is as long as the
        first = batches.pop(0)  # contacts are many must not pass for rows of contacts
        batches[:0] = [part for part in (first[:1], first[1:]) if part]
    tables = [table for batch in batches for table in _rows(job, batch, failures)]
    table = _joined(tables)
    failures.sort(key=lambda failure: failure.scene)
    return Part(table[np.argsort(table["scene"], kind="stable")], failures)


def _scene(item: Item) -> Scene:
    if isinstance(item, Scene):
        return item
    if isinstance(item, (str, os.PathLike)):
        return load_scene(item)
    scene = item() if callable(item) else item
    if not isinstance(scene, Scene):
        raise ContactSystemError(
            f"{scene!r:.80} is no scene; give a Scene, the name or file of one, or a function that "
            "makes one"
        )
    return scene


def _kind(scene: Scene) -> tuple:
    """Scenes that agree in this can be planned as one."""
    windows = frozenset((type(d), d.start, d.stop) for d in scene.disturbances)
    return (
        scene.object,
        scene.profile,
        scene.gain,
        scene.duration,
        scene.turning,
        windows,
        repr(scene.paper),
    )


def _batches(scenes: list[Placed]) -> Iterator[list[Placed]]:
    """At most TOGETHER contacts each, or one scene."""
    batch: list[Placed] = []
    count = 0
    for placed in scenes:
        own = len(placed[1].contacts)
        if batch and count + own > TOGETHER:
            yield batch
            batch, count = [], 0
        batch.append(placed)
        count += own
    yield batch


def _rows(job: Job, batch: list[Placed], failures: list[Failure]) -> list[np.ndarray]:
    """Tables of a batch; halved where something fails, down to the scene that does."""
    try:
        one = _together([scene for _, scene in batch])
        outputs = job.evaluate(plan(one, tolerance=job.tolerance))
    except Exception as error:  # whatever a user's function raises
        if len(batch) == 1:
            failures.append(_failure(*batch[0], error))
            return []
    else:
        return [_table(batch, outputs)]
    half = len(batch) // 2
    return _rows(job, batch[:half], failures) + _rows(job, batch[half:], failures)


def _together(scenes: list[Scene]) -> Scene:
    """The contacts of scenes of one kind, in order, as one scene.

    Its parts were checked in their own scenes; checking them again would double the time of a
    disturbed scene, so the new one is put together without.
    """
    first = scenes[0]
    if len(scenes) == 1:
        return first
    contacts: list[Contact] = []
    disturbances: list[Disturbance] = []
    for scene in scenes:
        for d in scene.disturbances:
            assert isinstance(d.contact, int)  # "all" is no more once it is in a scene
            moved = copy.copy(d)
            vars(moved)["contact"] = d.contact + len(contacts)
            disturbances.append(moved)
        contacts += scene.contacts
    one = copy.copy(first)
    vars(one).update(contacts=tuple(contacts), disturbances=tuple(disturbances))
    return one


def _table(batch: list[Placed], outputs: Mapping[str, ArrayLike]) -> np.ndarray:
    """One row a contact of the batch, from what `evaluate` returned."""
    counts = [len(scene.contacts) for _, scene in batch]
    ends = np.cumsum(counts)
    count = int(ends[-1])
    columns = {
        "scene": np.repeat([place for place, _ in batch], counts),
        "contact": np.arange(count) - np.repeat(ends - counts, counts),
        "name": np.repeat([scene.name or "" for _, scene in batch], counts),
    }
    if not isinstance(outputs, Mapping):
        raise ContactSystemError(
            f"evaluate returned {type(outputs).__name__}; return a dict of arrays"
        )
    for key, value in outputs.items():
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
        if not isinstance(key, str):
            raise ContactSystemError(f"evaluate returned the key {key!r}; give names as text")
        columns[key] = array
    kinds = [(key, array.dtype, array.shape[1:]) for key, array in columns.items()]
    table = np.empty(count, dtype=kinds)
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
    if isinstance(scenes, (Scene, str, os.PathLike)) or not isinstance(scenes, Iterable):
        raise ContactSystemError(f"scenes = {scenes!r:.80}: give a list of scenes; of one, [scene]")
    ahead = 2 * (os.cpu_count() or 1) if ahead is None else ahead
    for name, value in (("chunk", chunk), ("ahead", ahead)):
        whole = isinstance(value, numbers.Integral) and not isinstance(value, bool)
        if not whole or value < 1:
            raise ContactSystemError(f"{name} = {value!r}: give a whole number, at least 1")
    for name, given, fits, remedy in (
        ("evaluate", evaluate, callable(evaluate), "a function of a plan"),
        (
            "executor",
            executor,
            executor is None or isinstance(executor, Executor),
            "an executor, such as ProcessPoolExecutor(4) or a Dask client's get_executor()",
        ),
    ):
        if not fits:
            raise ContactSystemError(f"{name} = {given!r:.80}: give {remedy}")
    from .cli import Progress  # not on the planner's path

    flag(compiled, "compiled", none=True)
    job = Job(evaluate, checked_tolerance(tolerance))
    store = _Store(job, None if folder is None else a_path(folder, "folder"))
    chunks = store.missing(_chunks(scenes, chunk))
    if executor is None:
        finished = ((c, run_chunk(job, c)) for c in chunks)
    else:
        finished = _spread(chunks, job, executor, ahead)
    # how many a generator has is not known: its bar stays empty, the count beside it runs
    steps = -(-len(scenes) // chunk) if isinstance(scenes, Sized) else sys.maxsize
    with Progress(max(steps, 1), "0 scenes") as progress, contextlib.closing(finished):
        count = 0
        for done, part in finished:
            store.put(done, part)
            count += len(done.items)
            progress.step(f"{count} scenes")
            progress.done = len(store.parts)
    return Sweep(store.parts)


def _chunks(scenes: Iterable[Item], size: int) -> Iterator[Chunk]:
    items = iter(scenes)
    for number in itertools.count():
        own = tuple(itertools.islice(items, size))
        if not own:
            return
        yield Chunk(number, number * size, own)


def _spread(
    chunks: Iterator[Chunk], job: Job, executor: Executor, ahead: int
) -> Generator[tuple[Chunk, Part]]:
    """Run chunks on an executor, at most ``ahead`` at a time.

    Chunks lost with a worker go again, one at a time, so that one which kills its worker shows: its
    scenes become failures after ``LOSSES`` workers.
    """
    crew = _Crew(executor)
    working: dict[Future, Chunk] = {}
    lost: deque[Chunk] = deque()
    losses: dict[int, int] = {}
    try:
        while True:
            while not working or (len(working) < ahead and not losses):
                chunk = lost.popleft() if lost else next(chunks, None)
                if chunk is None:
                    break
                working[crew.submit(run_chunk, job, chunk)] = chunk
            if not working:
                return
            alone = len(working) == 1
            for future in wait(working, return_when=FIRST_COMPLETED).done:
                chunk = working.pop(future)
                error = _loss(future)
                if error is None:
                    losses.pop(chunk.number, None)
                    yield chunk, _result(future)
                    continue
                losses[chunk.number] = losses.get(chunk.number, 0) + alone
                if losses[chunk.number] < LOSSES:
                    lost.append(chunk)
                else:
                    del losses[chunk.number]
                    places = enumerate(chunk.items, chunk.first)
                    failures = [_failure(place, item, error) for place, item in places]
                    yield chunk, Part(NOTHING, failures)
    finally:
        for future in working:
            future.cancel()
        crew.close()


def _result(future: Future) -> Part:
    try:
        return future.result()
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise ContactSystemError(
            f"a chunk cannot be sent to the executor's processes ({error}); give functions of a "
            "module, or functools.partial of one, or an executor of threads"
        ) from error


def _loss(future: Future) -> BaseException | None:
    """What a future says if its worker is gone; None where it has a result or its own error."""
    try:
        error = future.exception()
    except CancelledError as cancelled:
        return cancelled
    # Dask's own for a task whose workers died again and again
    gone = isinstance(error, (BrokenExecutor, CancelledError))
    return error if gone or type(error).__name__ == "KilledWorker" else None


class _Crew:
    """An executor, and the one in its place after it broke."""

    def __init__(self, executor: Executor):
        self.executor, self.given = executor, executor

    def submit(self, function: Callable[..., Part], *arguments: Any) -> Future:
        try:
            return self.executor.submit(function, *arguments)
        except BrokenExecutor as error:
            from concurrent.futures import ProcessPoolExecutor  # loads multiprocessing

            broken = self.executor
            if not isinstance(broken, ProcessPoolExecutor):
                raise ContactSystemError(
                    f"the executor {broken!r} broke ({error}) and cannot be replaced; repair it "
                    "and call again: with a folder, what is finished is not done again"
                ) from error
        except RuntimeError as error:
            raise ContactSystemError(
                f"the executor {self.executor!r} takes no work ({error}); give one that is not "
                "shut down, and where it starts processes, sweep below if __name__ == '__main__'"
            ) from error
        self.close()
        names = ("_max_workers", "_mp_context", "_initializer", "_initargs")
        self.executor = ProcessPoolExecutor(*(getattr(broken, name) for name in names))
        return self.executor.submit(function, *arguments)

    def close(self) -> None:
        """Shut down what was not given."""
        if self.executor is not self.given:
            self.executor.shutdown()


# --- keeping results ---------------------------------------------------------------------------


class _Store:
    """Results by number of their chunk: in memory, or as files that know their scenes."""

    def __init__(self, job: Job, folder: Path | None):
        # absolute: results are read later, perhaps from another current folder
        self.job, self.folder = job, None if folder is None else folder.absolute()
        self.parts: dict[int, Part | Kept] = {}
        self.unfinished: dict[int, Kept] = {}
        if folder is not None:
            make_folder(folder, "give another folder")

    def missing(self, chunks: Iterator[Chunk]) -> Iterator[Chunk]:
        """Those chunks that are not finished; the others are taken over."""
        for chunk in chunks:
            if self.folder is not None:
                path = self.folder / f"chunk-{chunk.number:08d}.npz"
                kept = Kept(path, _digest(self.job, chunk))
                if _read(kept) is not None:
                    self.parts[chunk.number] = kept
                    continue
                self.unfinished[chunk.number] = kept
            yield chunk

    def put(self, chunk: Chunk, part: Part) -> None:
        """Keep a result; a file is there whole or not at all."""
        if self.folder is None:
            self.parts[chunk.number] = part
            return
        kept = self.parts[chunk.number] = self.unfinished.pop(chunk.number)
        unfinished = kept.path.with_suffix(".part")
        failures = json.dumps([asdict(failure) for failure in part.failures])
        with writing(kept.path):
            with unfinished.open("wb") as file:
                np.savez(file, digest=kept.digest, table=part.table, failures=failures)
            unfinished.replace(kept.path)


def _read(kept: Kept) -> Part | None:
    """What is kept; None where its file is not there, is damaged or holds other results."""
    try:
        with np.load(kept.path) as data:
            if str(data["digest"]) != kept.digest:
                return None
            failures = [Failure(**fields) for fields in json.loads(str(data["failures"]))]
            return Part(data["table"], failures)
    except Exception:  # whatever a file of another kind, or a damaged one, leads to
        return None


def _digest(job: Job, chunk: Chunk) -> str:
    """Of all that decides a chunk's results."""
    from . import __version__

    name = getattr(job.evaluate, "__qualname__", "")
    # a lambda has no name of its own, and a method's result depends on its object
    if not name or "<lambda>" in name or hasattr(job.evaluate, "__self__"):
        known = _pickled(job.evaluate)
    else:
        known = f"{job.evaluate.__module__}.{name} {_enclosed(job.evaluate)}".encode()
    found = hashlib.sha256(known + f"{__version__} {job.tolerance!r} {chunk.first}".encode())
    for item in chunk.items:
        found.update(_content(item))
    return found.hexdigest()


def _enclosed(function: Callable) -> list:
    """What a function made inside another one takes from there, as far as it stays what it is."""
    values = []
    for cell in getattr(function, "__closure__", None) or ():
        with contextlib.suppress(ValueError):  # a name that has no value yet
            values.append(cell.cell_contents)
    return [_plain(x) for x in values if isinstance(x, (numbers.Number, str, tuple, np.ndarray))]


def _plain(value: Any) -> Any:
    """The value with lists for arrays, whose own repr rounds and leaves out."""
    if isinstance(value, tuple):
        return tuple(map(_plain, value))
    return value.tolist() if isinstance(value, np.ndarray) else value


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
