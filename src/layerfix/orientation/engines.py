"""Where evaluations are computed: what an engine is, and the threads of this process.

A task is a pose and a range of its layers. Results come back in any order, each with the seconds it took; a search is
the same whichever engine computes it, and however many workers there are.
"""

from __future__ import annotations

import math
import time
from collections.abc import Generator, Sequence
from contextlib import suppress
from queue import SimpleQueue
from threading import Thread
from typing import NamedTuple, Protocol

from layerfix import __version__
from layerfix.errors import InputError
from layerfix.orientation.directions import Pose
from layerfix.orientation.objective import Counts, Objective
from layerfix.processors import processors

CHUNK_S = 0.05  # a task that is sent somewhere is to take at least so long
MOST_IN_CHUNK = 64
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

    def run(self, tasks: Sequence[Task]) -> Generator[Done]:
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

    def run(self, tasks: Sequence[Task]) -> Generator[Done]:
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


def check_version(version: str) -> None:
    """Raises InputError where another layerfix runs than there: their kernels may count differently."""
    if version != __version__:
        raise InputError(
            f"a worker runs layerfix {__version__}, this is layerfix {version}: install the same on both"
        )


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
