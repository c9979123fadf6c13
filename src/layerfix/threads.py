"""Results by index from some threads: in order, each made once, and few of them ahead of who reads."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from contextlib import suppress
from queue import Empty, SimpleQueue
from threading import Lock, Thread
from typing import Any, Generic, TypeVar

Result = TypeVar("Result")
TURN_S = 6e-3  # what a thread takes in a row takes about so long


class Remembered(Generic[Result]):
    """A `make` by index that keeps what was asked for last; a thread that asks for one being made waits for it."""

    def __init__(self, make: Callable[[int], Result], keep: int) -> None:
        self._make, self._keep = make, keep
        self._lock = Lock()
        self._made: dict[int, Result] = {}
        self._making: dict[int, Lock] = {}

    def __call__(self, index: int) -> Result:
        with self._lock:
            if index in self._made:
                return self._again(index)
            turn = self._making.setdefault(index, Lock())
        with turn:
            with self._lock:
                if index in self._made:
                    return self._again(index)
            result = self._make(index)
            with self._lock:
                self._made[index] = result
                self._making.pop(index, None)
                while len(self._made) > self._keep:
                    del self._made[next(iter(self._made))]  # what was not asked for the longest
            return result

    def _again(self, index: int) -> Result:
        result = self._made[index] = self._made.pop(index)
        return result


def in_threads(work: Callable[[int], Result], order: list[int], workers: int, most: int) -> Generator[Result]:
    """Yield work(order[0]), work(order[1]) … as so many threads make them; equal neighbours are made once.

    A thread takes one at a time or, if they turn out to take less than TURN_S, up to `most` in a row: handing over
    costs as much as a tenth of a small layer, and neighbours share what they are cut from. What `work` raises comes
    in its turn, as with one worker: after the results of all that is below it.

    No executor and no futures: their locks are Python's own, and a Ctrl-C that arrives just after the main thread
    has taken one leaves it taken, for ever (seen once in some hundred interrupted runs). SimpleQueue is C.
    """
    todo: SimpleQueue[list[int]] = SimpleQueue()
    done: SimpleQueue[tuple[list[tuple[int, Any, BaseException | None]], float]] = SimpleQueue()
    over: list[bool] = []

    def labour() -> None:
        while chosen := todo.get():
            made: list[tuple[int, Any, BaseException | None]] = []
            begun = time.perf_counter()
            for i in chosen:
                if over:
                    break
                try:
                    made.append((i, work(i), None))
                except BaseException as problem:
                    made.append((i, None, problem))
                    break
            done.put((made, time.perf_counter() - begun))
            del made  # or its results would outlive the reader's interest by a turn

    threads = [Thread(target=labour, name=f"layers-{n}", daemon=True) for n in range(workers)]
    ready: dict[int, tuple[Any, BaseException | None]] = {}
    asked, at_once = 0, 1
    try:
        for thread in threads:
            thread.start()
        for index, wanted in enumerate(order):
            while asked < min(index + 1 + 2 * workers * at_once, len(order)):
                stop = min((asked // at_once + 1) * at_once, len(order))
                if chosen := [k for k in range(asked, stop) if order[k] == k]:
                    todo.put(chosen)
                asked = stop
            while wanted not in ready:
                made, seconds = done.get()
                ready.update((i, (result, problem)) for i, result, problem in made)
                at_once = 1 << (max(1, min(most, int(TURN_S * len(made) / max(seconds, 1e-9)))).bit_length() - 1)
                del made
            if (wrong := ready[wanted][1]) is not None:
                raise wrong
            yield ready[wanted][0]
            if index + 1 == len(order) or order[index + 1] != wanted:
                del ready[wanted]
    finally:
        over.append(True)
        with suppress(Empty):
            while True:
                todo.get_nowait()
        for _ in threads:
            todo.put([])
        for thread in threads:
            if thread.ident is not None:  # it was started
                thread.join()
