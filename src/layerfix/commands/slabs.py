"""The layers of one large part or job, corrected on the workers of a Dask scheduler: a slab of layers is a task.

A mesh is sent once, by its content, and sliced where it is corrected. Layers of a job are read here and sent: workers
need no disk in common with us. What comes back are layers, which are written here: the output is what a run here
would have written, to the byte. A task whose worker dies is run again by the scheduler.
"""

from __future__ import annotations

import hashlib
import pickle
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from threading import Lock
from typing import TYPE_CHECKING, Any

from layerfix import __version__
from layerfix.errors import InputError, LayerfixError
from layerfix.mesh.slicing import sliced_mesh
from layerfix.orientation.cluster import RETRIES, checked, connected, send
from layerfix.orientation.engines import check_version

if TYPE_CHECKING:
    from layerfix.stack import Layer, LayerStack

SLAB_PX = 400_000_000  # of layers that are sent together: 50 MB before they are packed
MOST_IN_SLAB = 32
AHEAD = 2  # slabs that every thread of the workers has waiting


@contextmanager
def on_workers(fixed: LayerStack, scheduler: object) -> Iterator[LayerStack]:
    """The same corrected layers, made by the workers of a scheduler (an address, or a distributed.Client).

    fixed   what `correct` made
    raises  InputError for a scheduler that does not answer, has no workers, or workers of another version
    """
    client: Any = connected(scheduler) if isinstance(scheduler, str) else scheduler
    try:
        yield replace(fixed, make=Slabs(fixed, client, checked(client)))
    finally:
        if isinstance(scheduler, str):
            with suppress(Exception):
                client.close(timeout=2)


class Slabs:
    """`make` of layers that are made elsewhere. They are asked for about in order; slabs ahead are under way.

    make  how the layers would be made here
    """

    def __init__(self, fixed: LayerStack, client: Any, threads: int) -> None:
        self.make: Any = fixed.make
        self._client, self._count = client, len(fixed)
        by_size = max(SLAB_PX // (fixed.width * fixed.height), 1)
        self._length = max(min(by_size, MOST_IN_SLAB, len(fixed) // (4 * threads)), 1)
        self._slabs = -(-len(fixed) // self._length)
        self._ahead = AHEAD * threads
        self._lock = Lock()
        self._waiting: dict[int, Any] = {}
        self._ready: dict[int, list[Layer]] = {}
        self._turns: dict[int, Lock] = {}
        self._kept = None
        if sliced_mesh(fixed) is not None:
            packed = _packed(fixed.make)
            token = hashlib.sha256(packed).hexdigest()[:32]
            self._kept = send(client, _kept, __version__, packed, key=f"layerfix-layers-{token}", retries=RETRIES)

    def __call__(self, index: int) -> Layer:
        slab = index // self._length
        with self._lock:
            turn = self._turns.setdefault(slab, Lock())
        with turn:
            if slab not in self._ready:
                self._ready[slab] = self._fetched(slab)
                with self._lock:  # who asks for a slab no longer needs the one before the last
                    for old in [k for k in self._ready if k < slab - 1]:
                        del self._ready[old]
            return self._ready[slab][index - slab * self._length]

    def _fetched(self, slab: int) -> list[Layer]:
        for k in range(slab, min(slab + self._ahead, self._slabs)):
            self._send(k)
        with self._lock:
            future = self._waiting.pop(slab)
        try:
            found: list[Layer] = _unpacked(future.result())
        except LayerfixError:
            raise
        except Exception as problem:
            reason = " ".join(str(problem).split())[:200]
            raise InputError(f"a worker could not correct its layers: {reason}") from problem
        return found

    def _send(self, slab: int) -> None:
        with self._lock:
            if slab in self._waiting or slab in self._ready:
                return
            first, stop = slab * self._length, min((slab + 1) * self._length, self._count)
            if self._kept is not None:
                arguments: tuple[Any, ...] = (_cut, __version__, self._kept, first, stop)
            else:
                before = [self.make.make(k) for k in range(first, stop)]
                arguments = (_changed, __version__, _packed((self.make.change, before)))
            self._waiting[slab] = send(self._client, *arguments, pure=False, retries=RETRIES)


def _packed(what: object) -> bytes:
    return zlib.compress(pickle.dumps(what, protocol=5), 1)


def _unpacked(data: bytes) -> Any:
    return pickle.loads(zlib.decompress(data))


def _kept(version: str, packed: bytes) -> Callable[[int], Layer]:
    """How the layers are made, on the cluster."""
    check_version(version)
    make: Callable[[int], Layer] = _unpacked(packed)
    return make


def _cut(version: str, make: Callable[[int], Layer], first: int, stop: int) -> bytes:
    check_version(version)
    return _packed([make(k) for k in range(first, stop)])


def _changed(version: str, packed: bytes) -> bytes:
    check_version(version)
    change, layers = _unpacked(packed)
    return _packed([change(layer) for layer in layers])
