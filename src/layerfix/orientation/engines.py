"""Where evaluations are computed: threads here, processes here, or whatever has `submit`, as executors do.

A task is a pose and a range of its layers. Results come back in any order, each with the seconds it took; a search is
the same whichever engine computes it, and however many workers there are.
"""

from __future__ import annotations

import math
import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import suppress
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from typing import Any, NamedTuple, Protocol

from layerfix import __version__
from layerfix.errors import InputError
from layerfix.orientation.directions import Pose
from layerfix.orientation.objective import Counts, Objective
from layerfix.processors import processors

CHUNK_S = 0.05  # a task that is sent somewhere is to take at least so long
MOST_IN_CHUNK = 64
ATTEMPTS = 3  # for a chunk whose process died
Task = tuple[Pose, int, int]


class Done(NamedTuple):
    """One task done: its number, what was counted, and how long that took."""

    number: int
    counts: Counts
    seconds: float


class Engine(Protocol):
    """Something that computes tasks."""

    workers: int
    name: str

    def run(self, tasks: Sequence[Task]) -> Iterator[Done]:
        """All of them, each once, in whatever order they are ready."""

    def close(self) -> None:
        """End what this engine began."""


class Threads:
    """Threads of this process: the kernels need no lock, and all share one part."""

    def __init__(self, objective: Objective, workers: int = 0) -> None:
        self._objective = objective
        self.workers = workers or processors()
        self.name = f"{self.workers} thread{'s' if self.workers > 1 else ''}"
        self._stopped = False

    def run(self, tasks: Sequence[Task]) -> Iterator[Done]:
        """As `Engine.run`. No executor: a Ctrl-C between its locks could hang it (see `layerfix.stack`)."""
        todo: SimpleQueue[int | None] = SimpleQueue()
        done: SimpleQueue[Done | BaseException] = SimpleQueue()

        def labour() -> None:
            while (k := todo.get()) is not None:
                started = time.perf_counter()
                try:
                    counts = self._objective.count(*tasks[k], stopped=lambda: self._stopped)
                    done.put(Done(k, counts, time.perf_counter() - started))
                except BaseException as problem:
                    done.put(problem)

        threads = [
            Thread(target=labour, name=f"poses-{n}", daemon=True) for n in range(min(self.workers, len(tasks)))
        ]
        for k in range(len(tasks)):
            todo.put(k)
        for _ in threads:
            todo.put(None)
        finished = False
        try:
            for thread in threads:
                thread.start()
            for _ in tasks:
                found = done.get()
                if isinstance(found, BaseException):
                    raise found
                yield found
            finished = True
        finally:
            if not finished:
                self._stopped = True
                with suppress(Exception):
                    while True:
                        todo.get_nowait()
                for _ in threads:
                    todo.put(None)
            for thread in threads:
                if thread.ident is not None:
                    thread.join()
            self._stopped = False

    def close(self) -> None:
        """Nothing is left."""


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


def check_version(version: str) -> None:
    """Raises InputError where another layerfix runs than there: their kernels may count differently."""
    if version != __version__:
        raise InputError(
            f"a worker runs layerfix {__version__}, this is layerfix {version}: install the same on both"
        )


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

    def run(self, tasks: Sequence[Task]) -> Iterator[Done]:
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
                " memory; nothing but the log is left"
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


class Seconds:
    """How long a layer takes, learnt as tasks are done, so that chunks are neither too small nor too large."""

    def __init__(self) -> None:
        self._per_task: dict[int, float] = {}

    def add(self, tasks: Sequence[Task], seconds: float) -> None:
        """Tasks of one length each, done in so many seconds together."""
        length = tasks[0][2] - tasks[0][1]
        mean = seconds / len(tasks)
        self._per_task[length] = (self._per_task.get(length, mean) + mean) / 2

    def chunks(self, tasks: Sequence[Task], workers: int) -> list[list[int]]:
        """Numbers of tasks that are sent together: CHUNK_S of work at least, and several chunks for every worker."""
        if not tasks:
            return []
        mean = self._per_task.get(tasks[0][2] - tasks[0][1], CHUNK_S)
        size = min(max(math.ceil(CHUNK_S / max(mean, 1e-6)), 1), MOST_IN_CHUNK, max(len(tasks) // (4 * workers), 1))
        numbers = list(range(len(tasks)))
        return [numbers[k : k + size] for k in range(0, len(tasks), size)][::-1]


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
