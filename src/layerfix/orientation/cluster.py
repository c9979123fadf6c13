"""Many machines: Dask distributed does the work of keeping workers, tasks and failures; nothing of it is done again.

The part is made on the cluster by a task, not scattered: what is scattered is lost for good with the last worker
that holds it, the result of a task is made again. A worker fetches it once; a task then is a few poses. A task whose
worker dies is run again by the scheduler, elsewhere or when a worker comes.
"""

from __future__ import annotations

import re
import socket
import warnings
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from layerfix import __version__
from layerfix.errors import InputError, LayerfixError
from layerfix.orientation.engines import Done, Seconds, Task, check_version

if TYPE_CHECKING:
    from layerfix.orientation.objective import Objective

WAIT_S = 8.0  # for a scheduler to answer, and for its first worker
RETRIES = 3
AHEAD = 4  # chunks that every worker has waiting


def connected(address: str) -> Any:
    """A `distributed.Client` of a scheduler's address. Raises InputError within ten seconds if there is none."""
    try:
        from distributed import Client
    except ImportError as problem:
        raise InputError("a scheduler needs Dask: pip install 'layerfix[dask]'") from problem
    import logging

    for name in ("distributed", "distributed.client"):  # which tell of workers that come and go
        logging.getLogger(name).setLevel(logging.ERROR)
    address = address if "://" in address else f"tcp://{address}"
    try:
        _answers(address)
        make: Any = Client
        return make(address, timeout=f"{WAIT_S}s", set_as_default=False)
    except (OSError, ValueError, OverflowError, RuntimeError, ImportError) as problem:
        reason = " ".join(str(problem).split())[:120] or type(problem).__name__
        raise InputError(
            f"scheduler {address}: does not answer ({reason}); start one with `dask scheduler`, and give its address"
            " as tcp://host:8786"
        ) from problem


def _answers(address: str) -> None:
    """Raises OSError or ValueError unless something listens there: a client that could not connect takes its time to
    go away again."""
    found = re.fullmatch(r"(?:tcp|tls)://(.+):(\d{1,5})/?", address)
    if found is None:
        if address.startswith(("tcp://", "tls://")):
            raise ValueError("an address has a host and a port")
        return  # of another kind: its maker knows
    with socket.create_connection((found[1].strip("[]"), int(found[2])), timeout=WAIT_S):
        pass


def checked(client: Any) -> int:
    """How many threads the workers have. Raises InputError if there are none, or one of another version."""
    with suppress(Exception):  # a TimeoutError of one of three classes
        client.wait_for_workers(1, timeout=WAIT_S)
    if not client.nthreads():
        where = client.scheduler.address
        raise InputError(f"scheduler {where}: has no workers; start some with `dask worker {where}`")
    try:
        versions: dict[str, str] = client.run(_version)
    except Exception as problem:
        reason = " ".join(str(problem).split())[:160]
        raise InputError(
            f"the workers cannot run layerfix {__version__}: {reason}; install it there, too"
        ) from problem
    for version in sorted(set(versions.values()) - {__version__}):
        where = ", ".join(sorted(worker for worker, found in versions.items() if found == version))
        raise InputError(
            f"the worker at {where} runs layerfix {version}, this is layerfix {__version__}: install the same on both"
        )
    return sum(int(threads) for threads in client.nthreads().values()) or 1


def _version() -> str:
    from layerfix import __version__ as version

    return version


def _made(version: str, objective: Objective) -> Objective:
    """The part, on the cluster."""
    check_version(version)
    return objective


def _count(version: str, objective: Objective, tasks: Sequence[Task]) -> tuple[list[Any], float]:
    import time

    check_version(version)
    started = time.perf_counter()
    counts = [objective.count(*task) for task in tasks]
    return counts, time.perf_counter() - started


def send(client: Any, function: Callable[..., Any], *arguments: Any, **own: Any) -> Any:
    """`client.submit`, without its warning that what is sent is large: it is sent once."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sending large graph")
        return client.submit(function, *arguments, **own)


def as_ready(client: Any, futures: Any = ()) -> Any:
    """Futures of a client as they are done; more can be added."""
    import distributed

    make: Any = distributed.as_completed
    return make(futures, loop=client.loop)


class Cluster:
    """The workers of a scheduler, by its address or a client of it."""

    def __init__(self, objective: Objective, where: Any) -> None:
        self._own = isinstance(where, str)
        self._client = connected(where) if self._own else where
        try:
            self.workers = checked(self._client)
            self.name = f"{self.workers} threads of the workers of {self._client.scheduler.address}"
            key = f"layerfix-part-{objective.token}"
            self._part = send(self._client, _made, __version__, objective, key=key, retries=RETRIES)
        except BaseException:
            self.close()
            raise
        self._seconds = Seconds()

    def run(self, tasks: Sequence[Task]) -> Generator[Done]:
        """As `Engine.run`. Raises InputError for a worker that cannot do it."""
        left = self._seconds.chunks(tasks, self.workers)
        waiting: dict[Any, list[int]] = {}
        ready = as_ready(self._client)

        def more() -> None:
            while left and len(waiting) < AHEAD * self.workers:
                chunk = left.pop()
                future = self._client.submit(
                    _count, __version__, self._part, [tasks[k] for k in chunk], pure=False, retries=RETRIES
                )
                waiting[future] = chunk
                ready.add(future)

        try:
            more()
            while waiting:
                future = next(ready)
                chunk = waiting.pop(future)
                try:
                    counts, seconds = future.result()
                except LayerfixError:
                    raise
                except Exception as problem:
                    reason = " ".join(str(problem).split())[:200]
                    raise InputError(f"a worker could not count its poses: {reason}") from problem
                more()
                self._seconds.add([tasks[k] for k in chunk], seconds)
                for k, one in zip(chunk, counts, strict=True):
                    yield Done(k, one, seconds / len(chunk))
        finally:
            if waiting:
                with suppress(Exception):
                    self._client.cancel(list(waiting))

    def close(self) -> None:
        """The part is let go, and a client of ours ends."""
        self._part = None
        if self._own and self._client is not None:
            with suppress(Exception):
                self._client.close(timeout=2)
        self._client = None
