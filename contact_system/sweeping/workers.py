"""Runs a sweep's chunks on an executor, and again those that are lost with a worker."""

from __future__ import annotations

import dataclasses
import itertools
import os
import pickle
from collections.abc import Callable, Generator, Iterable
from concurrent import futures
from concurrent.futures import Executor, Future
from typing import Any

from ..errors import ContactSystemError
from .chunk import NOTHING, Chunk, Part, Run, a_failure, end_with

GUARD = "sweep below if __name__ == '__main__'"
LOST = f" Give workers more memory, and {GUARD}."


def spread(
    chunks: Iterable[Chunk], run: Run, executor: Executor, ahead: int
) -> Generator[tuple[Chunk, Part]]:
    """Run chunks on an executor, at most ``ahead`` at a time.

    Chunks that are lost with a worker run again at the end, several at a time; those lost again run
    one at a time. The scenes of a chunk that is lost even then become failures, which are not put
    in a file: the next sweep tries them again, perhaps with more memory.
    """
    pools = [executor]  # and its replacements

    def submit(chunk: Chunk) -> Future:
        try:
            return pools[-1].submit(run, chunk)
        except RuntimeError as error:
            broke = isinstance(error, futures.BrokenExecutor)
            if not broke or not isinstance(executor, futures.ProcessPoolExecutor):
                raise ContactSystemError(
                    f"the executor {executor!r} takes no work ({error}); give one that is not "
                    f"shut down, and if it starts processes, {GUARD}; with a folder, finished "
                    "chunks are not done again"
                ) from error
        names = ("_max_workers", "_mp_context", "_initializer", "_initargs")
        pools.append(futures.ProcessPoolExecutor(*(getattr(executor, name) for name in names)))
        return pools[-1].submit(run, chunk)

    # a worker that never gets a chunk must end with the sweep, too
    if isinstance(executor, futures.ProcessPoolExecutor):
        pool: Any = executor
        if pool._initializer is not _begin:
            pool._initargs = (os.getpid(), pool._initializer, pool._initargs)
            pool._initializer = _begin
    try:
        for most in (ahead, ahead, 1):
            lost: list[tuple[Chunk, Any]] = []
            for chunk, part in _work(chunks, submit, most):
                if isinstance(part, Part):
                    yield chunk, part
                else:
                    lost.append((chunk, part))
            chunks = [chunk for chunk, _ in lost]
    finally:
        for pool in pools[1:]:
            pool.shutdown()
    for chunk, error in lost:
        failures = [
            a_failure(*placed, error, LOST) for placed in enumerate(chunk.items, chunk.first)
        ]
        yield dataclasses.replace(chunk, file=None), Part(NOTHING, failures)


def _work(
    chunks: Iterable[Chunk], submit: Callable[[Chunk], Future], ahead: int
) -> Generator[tuple[Chunk, Any]]:
    """Chunks as they finish, each with its part or with the error that ended its worker."""
    working: dict[Future, Chunk] = {}
    waiting = iter(chunks)
    try:
        while True:
            for chunk in itertools.islice(waiting, ahead - len(working)):
                working[submit(chunk)] = chunk
            if not working:
                return
            for future in futures.wait(working, return_when=futures.FIRST_COMPLETED).done:
                yield working.pop(future), _outcome(future)
    finally:
        for future in working:
            future.cancel()


def _begin(sweeper: int, initializer: Callable | None, arguments: tuple) -> None:
    """Initialise a worker: watch the sweep, then call the executor's own initializer."""
    end_with(sweeper)
    if initializer is not None:
        initializer(*arguments)


def _outcome(future: Future) -> Part | Exception:
    """The part, or the error of a lost worker; any other error is raised."""
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
        if type(error).__name__ == "KilledWorker":  # Dask, after several workers died
            return error
        raise
