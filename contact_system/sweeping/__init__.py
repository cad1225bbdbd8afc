"""Many scenes: planned over any executor, results as one table, failures kept beside them."""

from __future__ import annotations

import contextlib
import functools
import itertools
import numbers
import os
import sys
from collections.abc import Iterable, Iterator, Mapping, Sized
from concurrent.futures import Executor
from pathlib import Path

import numpy as np

from ..checks import a_path, flag, make_folder
from ..errors import ContactSystemError
from ..plan import checked_tolerance
from ..scene import Scene
from .chunk import Chunk, Evaluate, Failure, Item, Part, Run, joined, run_chunk
from .files import digest, keep, read
from .summaries import summary
from .workers import spread

__all__ = ["Failure", "Sweep", "summary", "sweep"]


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
            elif (found := read(part)) is not None:
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
        return joined(list(self))

    @property
    def failures(self) -> list[Failure]:
        """What failed, in the order of the scenes."""
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
        Also a generator, of which no more is taken than is at work. An item may be the name or file
        of a scene, or a function without arguments that makes one: it is called by the worker, and
        what it raises is a failure of that scene.
    evaluate : callable
        Takes a Plan and returns a dict of arrays with one row a contact of the plan,
        (n_contacts, ...). Contacts of scenes that differ in nothing but contacts and values of
        disturbances are planned together, so the plan may hold those of many scenes; treat each
        contact on its own. What it raises is a failure of the scene.
    each : bool
        ``evaluate`` takes a Scene instead, each by itself, and nothing is planned here: for
        ``drake_plant.outcome``, and whatever else takes long. Rows are the scene's contacts.
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
    chunk : int, optional
        Scenes that a worker takes at a time, and that are planned together at most; by default 500,
        of ``each`` 1.
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
    from ..cli import Progress  # not on the planner's path

    if isinstance(scenes, (Scene, str, os.PathLike)) or not isinstance(scenes, Iterable):
        raise ContactSystemError(f"scenes = {scenes!r:.80}: give a list of scenes; of one, [scene]")
    ahead = 2 * (os.cpu_count() or 1) if ahead is None else ahead
    if flag(each, "each") and chunk is None:
        chunk = 1
    chunk = 500 if chunk is None else chunk
    for name, value in (("chunk", chunk), ("ahead", ahead)):
        whole = isinstance(value, numbers.Integral) and not isinstance(value, bool)
        if not whole or value < 1:
            raise ContactSystemError(f"{name} = {value!r}: give a whole number, at least 1")
    if not callable(evaluate):
        raise ContactSystemError(
            f"evaluate = {evaluate!r:.80}: give a function of a plan, or of a scene with each=True"
        )
    if executor is not None and not isinstance(executor, Executor):
        raise ContactSystemError(
            f"executor = {executor!r:.80}: give an executor, such as ProcessPoolExecutor(4) or a "
            "Dask client's get_executor()"
        )
    flag(compiled, "compiled", none=True)
    tolerance = checked_tolerance(tolerance)
    run = functools.partial(run_chunk, evaluate, None if each else tolerance, os.getpid())
    if folder is not None:  # absolute: results may be read from another current folder
        folder = make_folder(a_path(folder, "folder"), "give another folder").absolute()
    parts: dict[int, Part | Path] = {}
    chunks = _unfinished(scenes, chunk, run, folder, parts)
    if executor is None:
        finished = ((done, run(done)) for done in chunks)
    else:
        finished = spread(chunks, run, executor, ahead)
    # how many a generator has is not known: its bar stays empty, the count beside it runs
    steps = -(-len(scenes) // chunk) if isinstance(scenes, Sized) else sys.maxsize
    with Progress(max(steps, 1), "0 scenes") as progress, contextlib.closing(finished):
        count = 0
        for done, part in finished:
            parts[done.first] = keep(part, done.file)
            count += len(done.items)
            progress.name, progress.done = f"{count} scenes", len(parts)
    return Sweep(parts)


def _unfinished(
    scenes: Iterable[Item], size: int, run: Run, folder: Path | None, parts: dict[int, Part | Path]
) -> Iterator[Chunk]:
    """Chunks of the scenes, but for those with results in a file, which joins the parts."""
    items, first, file = iter(scenes), 0, None
    while own := tuple(itertools.islice(items, size)):
        if folder is not None:
            file = folder / f"chunk-{first:08d}-{digest(run, first, own)}.npz"
        if file is not None and read(file) is not None:
            parts[first] = file
        else:
            yield Chunk(first, own, file)
        first += size
