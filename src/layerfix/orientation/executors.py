"""Evaluations in other processes: ours, or whatever has `submit`, as executors do; and which engine a user means."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import suppress
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

from layerfix import __version__
from layerfix.errors import InputError
from layerfix.orientation.engines import Done, Engine, Seconds, Task, Threads, check_version
from layerfix.orientation.objective import Counts, Objective
from layerfix.processors import processors

ATTEMPTS = 3  # for a chunk whose process died


class _Sent(NamedTuple):
    """How a part gets to another process: by name, as a file there, or itself."""

    version: str
    token: str
    path: str
    objective: Objective | None


@lru_cache(maxsize=2)
def _loaded(token: str, path: str) -> Objective:
    import pickle

    found: Objective = pickle.loads(Path(path).read_bytes())
    return found


_kept: dict[str, Objective] = {}


def compute(sent: _Sent, tasks: Sequence[Task]) -> tuple[list[Counts], float] | None:
    """What a worker does. None if it has no part of that name, no file of it, and was not sent it."""
    check_version(sent.version)
    objective = _kept.get(sent.token) or sent.objective
    if objective is None:
        try:
            objective = _loaded(sent.token, sent.path)
        except FileNotFoundError:
            return None
    if sent.token not in _kept:
        _kept.clear()
        _kept[sent.token] = objective
    started = time.perf_counter()
    counts = [objective.count(*task) for task in tasks]
    return counts, time.perf_counter() - started


class Executors:
    """Whatever has `submit(function, *arguments)` → a future of `concurrent.futures`.

    The part goes into a file, which a process reads once; where there is no such file (another machine), it is sent
    along. A chunk whose process died is sent again, to a new pool if this one is ours.
    """

    def __init__(self, objective: Objective, executor: Executor, workers: int, name: str) -> None:
        import pickle

        self._executor: Executor | None = executor
        self.workers, self.name = workers, name
        handle, self._path = tempfile.mkstemp(prefix="layerfix-part-", suffix=".pickle")
        with os.fdopen(handle, "wb") as file:
            pickle.dump(objective, file)
        self._objective = objective
        self._sent = _Sent(__version__, objective.token, self._path, None)
        self._seconds = Seconds()

    def _anew(self) -> bool:
        """Put a new pool in the place of a broken one; False if it is not ours."""
        return False

    def run(self, tasks: Sequence[Task]) -> Generator[Done]:
        """As `Engine.run`."""
        waiting: dict[Future[Any], list[int]] = {}
        attempts: dict[int, int] = {}
        left = self._seconds.chunks(tasks, self.workers)

        def send(chunk: list[int], sent: _Sent) -> None:
            assert self._executor is not None
            waiting[self._executor.submit(compute, sent, [tasks[k] for k in chunk])] = chunk

        try:
            while left or waiting:
                while left:
                    try:
                        send(left[-1], self._sent)
                    except BrokenExecutor:
                        self._mend(left[-1], attempts)
                        continue
                    left.pop()
                ready, _ = wait(waiting, return_when=FIRST_COMPLETED)
                for future in ready:
                    chunk = waiting.pop(future)
                    try:
                        found = future.result()
                    except BrokenExecutor:
                        self._mend(chunk, attempts)
                        left.append(chunk)
                        left += waiting.values()
                        waiting.clear()
                        break
                    if found is None:
                        send(chunk, self._sent._replace(objective=self._objective))
                        continue
                    counts, seconds = found
                    self._seconds.add([tasks[k] for k in chunk], seconds)
                    for k, one in zip(chunk, counts, strict=True):
                        yield Done(k, one, seconds / len(chunk))
        finally:
            for future in waiting:
                future.cancel()

    def _mend(self, chunk: list[int], attempts: dict[int, int]) -> None:
        attempts[chunk[0]] = attempts.get(chunk[0], 0) + 1
        if attempts[chunk[0]] >= ATTEMPTS or not self._anew():
            raise InputError(
                f"the workers ({self.name}) died {attempts[chunk[0]]} times over the same poses, perhaps for want of"
                " memory; nothing but the log is left. (A script that starts processes keeps what it does under"
                ' `if __name__ == "__main__":`, since each of them imports it)'
            )

    def close(self) -> None:
        """The file goes; the executor is its owner's."""
        with suppress(OSError):
            os.unlink(self._path)


class Processes(Executors):
    """Processes of this machine, ours to begin, mend and end."""

    def __init__(self, objective: Objective, workers: int) -> None:
        super().__init__(objective, self._pool(workers), workers, f"{workers} process{'es' if workers > 1 else ''}")

    @staticmethod
    def _pool(workers: int) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_begin_worker)

    def _anew(self) -> bool:
        assert self._executor is not None
        self._executor.shutdown(wait=False, cancel_futures=True)
        self._executor = self._pool(self.workers)
        return True

    def close(self) -> None:
        """The pool ends, too."""
        if self._executor is not None:
            self._executor.shutdown(wait=False, cancel_futures=True)
            self._executor = None
        super().close()


def _begin_worker() -> None:
    """A worker leaves Ctrl-C to the process that it works for."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)


def engine_for(executor: object, objective: Objective, workers: int = 0) -> Engine:
    """The engine that `executor` names: None is threads, a number processes, and so on (see `orient`).

    Raises InputError for anything else.
    """
    if executor is None:
        return Threads(objective, workers)
    if isinstance(executor, bool):
        raise InputError(f"executor={executor}: give a number of processes, an executor, a client or an address")
    if isinstance(executor, int):
        if executor < 1:
            raise InputError(f"executor={executor}: at least one process")
        return Processes(objective, executor)
    if isinstance(executor, str) or hasattr(executor, "get_executor"):
        from layerfix.orientation.cluster import Cluster

        return Cluster(objective, executor)
    if hasattr(executor, "submit"):
        count = getattr(executor, "_max_workers", None) or processors()
        given: Any = executor
        return Executors(objective, given, int(count), type(executor).__name__)
    raise InputError(
        f"executor is a {type(executor).__name__}; it may be None, a number of processes, an executor with submit(),"
        " a distributed.Client, or the address of a scheduler such as 'tcp://host:8786'"
    )
