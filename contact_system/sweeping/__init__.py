"""Sweeps: many scenes planned on any executor; the results are one table, and failures."""

from __future__ import annotations

import contextlib
import functools
import itertools
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sized
from concurrent.futures import Executor
from pathlib import Path

import numpy as np

from ..checks import flag, of_kind, whole_number
from ..errors import ContactSystemError
from ..files import a_path, make_folder
from ..measures import summary
from ..plan import checked_tolerance
from ..scene import Scene
from ..terminal import Progress
from .chunk import Chunk, Evaluate, Failure, Item, Part, Run, joined, run_chunk
from .files import digest, read, store
from .workers import spread

__all__ = ["Failure", "Sweep", "sweep"]


class Sweep:
    """Results of :func:`sweep`; iterating yields the table of each chunk, in order.

    If the sweep has a folder, each access reads results from its files, and a ContactSystemError
    names a file that was removed or damaged since.
    """

    def __init__(self, parts: Mapping[int, Part | Path]):
        self._parts = [parts[k] for k in sorted(parts)]

    def parts(self) -> Iterator[Part]:
        """Chunk by chunk, in the order of the scenes."""
        for part in self._parts:
            if isinstance(part, Part):
                yield part
            elif (found := read(part)) is not None:
                yield found
            else:
                raise ContactSystemError(
                    f"'{part}' no longer holds results of this sweep: it was removed or damaged; "
                    "call sweep again"
                )

    def __iter__(self) -> Iterator[np.ndarray]:
        return (part.table for part in self.parts())

    @property
    def table(self) -> np.ndarray:
        """Structured array, one row for each contact: scene, contact, name, and the outputs.

        ``scene`` is the index in the order given; scenes in :attr:`failures` have no rows. If all
        scenes failed, a ContactSystemError tells the first failure.
        """
        table = joined(list(self))
        if not len(table) and (failures := self.failures):
            raise ContactSystemError(
                f"no scene has a result; the first of {len(failures)} in failures: "
                f"{failures[0].error}"
            )
        return table

    @property
    def failures(self) -> list[Failure]:
        """The failures, in the order of the scenes."""
        return [failure for part in self.parts() for failure in part.failures]


def sweep(
    scenes: Iterable[Item],
    evaluate: Evaluate = summary,
    executor: Executor | None = None,
    *,
    each: bool = False,
    folder: str | os.PathLike[str] | None = None,
    chunk: int | None = None,
    ahead: int | None = None,
    tolerance: float = 1e-12,
    compiled: bool | None = None,
) -> Sweep:
    """Plan and evaluate many scenes.

    Parameters
    ----------
    scenes : iterable of Scene
        It may be a generator; only the scenes being worked on are taken from it. An item may also
        be the name or file of a scene, or a function without arguments that makes one: the worker
        calls it, and an error it raises is a failure of that scene.
    evaluate : callable
        Takes a Plan and returns a dict of arrays with one row for each contact of the plan,
        (n_contacts, ...). Scenes that differ only in contacts and values of disturbances are
        planned together, so the plan may hold the contacts of many scenes: treat each contact on
        its own. An error it raises is a failure of the scene.
    each : bool
        True: ``evaluate`` takes each Scene by itself, and nothing is planned. For slow functions
        such as ``drake_plant.outcome``. Rows are the scene's contacts.
    executor : concurrent.futures.Executor, optional
        Threads, processes, or a Dask cluster's ``client.get_executor()``; default: this thread.
        Chunks lost with a worker are done again, and a broken process pool is replaced.
    folder : path, optional
        Keep the results of each chunk in a file there, not in memory. The same call continues an
        interrupted sweep: it skips chunks of which the scenes (or the contents of their files), the
        gain laws, the tolerance, the name of ``evaluate``, and the numbers, texts, tuples, arrays
        and parts of scenes in its closure and defaults of arguments are unchanged; of one that a
        function made also the functions there. Code is not compared: give another folder after a
        change of a function or class of yours. A lambda, having no name, is refused. Sweeps may
        share a folder, even at the same time, and damaged chunks are done again. Results of scenes
        that have changed stay there.
    chunk : int, optional
        Number of scenes that a worker takes at a time, and at most plans together; default 500, or
        1 with ``each``.
    ahead : int, optional
        Number of chunks at work or waiting for a worker; default: twice this machine's cores. For a
        cluster, give at least twice its workers.
    tolerance : float
        As in :func:`plan`.
    compiled : bool or None
        Ignored, as in :func:`plan`.

    Returns
    -------
    Sweep
        ``table``, ``failures``.

    Raises
    ------
    ContactSystemError
        An argument of the wrong type or value; outputs that do not have one row of numbers or texts
        for each contact, or that differ from scene to scene; a folder that cannot be made or
        written to; functions that cannot be sent to another process; a broken executor that cannot
        be replaced.
    """
    if isinstance(scenes, (Scene, str, os.PathLike)) or not isinstance(scenes, Iterable):
        raise ContactSystemError(f"scenes = {scenes!r:.80}: give a list of scenes, such as [scene]")
    if flag(each, "each") and chunk is None:
        chunk = 1
    chunk = 500 if chunk is None else whole_number(chunk, "chunk")
    ahead = 2 * (os.cpu_count() or 1) if ahead is None else whole_number(ahead, "ahead")
    of_kind(Callable, evaluate, "evaluate", "a function of a plan, or of a scene with each=True")
    remedy = "an executor, such as ProcessPoolExecutor(4) or a Dask client's get_executor()"
    of_kind((Executor, type(None)), executor, "executor", remedy)
    tolerance = checked_tolerance(tolerance)
    run = functools.partial(run_chunk, evaluate, None if each else tolerance, os.getpid())
    if folder is not None:  # absolute, as the current folder may change before results are read
        folder = make_folder(a_path(folder, "folder"), "give another folder").absolute()
    parts: dict[int, Part | Path] = {}
    chunks = _unfinished(scenes, chunk, run, folder, parts)
    if executor is None:
        finished = ((done, run(done)) for done in chunks)
    else:
        finished = spread(chunks, run, executor, ahead)
    # a generator has no known length: only the count beside the progress bar changes
    steps = -(-len(scenes) // chunk) if isinstance(scenes, Sized) else sys.maxsize
    with Progress(max(steps, 1), "0 scenes") as progress, contextlib.closing(finished):
        count = 0
        for done, part in finished:
            parts[done.first] = part if done.file is None else store(part, done.file)
            count += len(done.items)
            progress.name, progress.done = f"{count} scenes", len(parts)
    return Sweep(parts)


def _unfinished(
    scenes: Iterable[Item], size: int, run: Run, folder: Path | None, parts: dict[int, Part | Path]
) -> Iterator[Chunk]:
    """Chunks of scenes that have no results yet; files with results are added to ``parts``."""
    items, first, file = iter(scenes), 0, None
    while batch := tuple(itertools.islice(items, size)):
        if folder is not None:
            file = folder / f"chunk-{first:08d}-{digest(run, first, batch)}.npz"
        if file is not None and read(file) is not None:
            parts[first] = file
        else:
            yield Chunk(first, batch, file)
        first += size
