"""`njit` as this package uses it: numba's, with kernels that are loaded when first called and never stale.

A kernel has one signature and is compiled, or loaded from `layerfix.kernel_cache`, at its first call; a helper has
none and is compiled into the kernels that call it. So a run loads only what it calls, and compiles only that. Loading
needs none of numba's registries (with scipy, 0.35 s), as long as nothing has to be compiled.

The stamp of a kernel is a digest of its bytecode, its constants, and the stamps of what it calls, all the way down:
it changes whenever the machine code may, wherever the edit was, and is the same in a checkout and in an install.
"""

from __future__ import annotations

import hashlib
import importlib
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from threading import Lock
from types import CodeType, ModuleType
from typing import Any, ClassVar

import llvmlite.binding as llvm
import numba
import numpy as np
from numba.core import config, event, types
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher, cpu_target
from numba.core.runtime import rtsys
from numba.core.serialize import dumps

from layerfix import kernel_cache, kernels_ahead

LOOK_S = 0.02  # how often another process is looked at
PACKAGE = __name__.partition(".")[0]
_known: set[Any] = set()  # types, so that none is made anew
_knowing = Lock()


class Helper(CPUDispatcher):  # type: ignore[misc]  # numba has no types
    """A function that is compiled into the kernels that call it, for whatever types they call it with."""

    # What Python and C call a function through is compiled, too, and takes a sixth of the time.
    wrappers: ClassVar = {"no_cfunc_wrapper": True, "no_cpython_wrapper": True}

    def __init__(self, py_func: Callable[..., Any], options: dict[str, Any]) -> None:
        super().__init__(py_func, {}, {"nopython": True, "boundscheck": None, **self.wrappers, **options})
        self._stamp: str | None = None
        self._for_python: Any = None

    def __call__(self, *args: Any) -> Any:
        """A call from Python, as tests make it."""
        if self._for_python is None:
            self._for_python = numba.njit(self.py_func)
        return self._for_python(*args)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """numba's hook for a call from another function, which is being compiled: one code for all integers, where
        numba would compile it once more for every constant."""
        plain = tuple(arg.literal_type if isinstance(arg, types.IntegerLiteral) else arg for arg in args)
        return super().get_call_template(plain, kws)

    @property
    def name(self) -> str:
        """With its module, without the package."""
        return f"{self.py_func.__module__.partition('.')[2]}.{self.py_func.__name__}"

    @property
    def stamp(self) -> str:
        """Digest of everything in the sources that the machine code depends on."""
        if self._stamp is None:
            self._stamp = "itself"  # as one that calls itself sees it
            self._stamp = _digest(repr(list(_parts(self.py_func))), 16)
        return self._stamp

    @property
    def calls(self) -> list[Kernel]:
        """The kernels that this one calls, itself or through helpers."""
        found: list[Kernel] = []
        for _, value in _globals(self.py_func):
            if isinstance(value, Helper) and value is not self:
                found += [value] if isinstance(value, Kernel) else value.calls
        return found


class Kernel(Helper):
    """A function with one declared signature, loaded or compiled when it is first called."""

    wrappers: ClassVar = {"no_cfunc_wrapper": True}
    __call__ = CPUDispatcher.__call__

    def __init__(self, py_func: Callable[..., Any], signature: Any, options: dict[str, Any]) -> None:
        super().__init__(py_func, options)
        self.signature = signature
        self._cache = _Cache(self)

    @property
    def compiled(self) -> Any:
        """numba's CompileResult of the signature, once it is ready."""
        return next(iter(self.overloads.values()))

    def ready(self) -> Any:
        """Load or compile, if that has not happened yet. Returns what Python calls."""
        with global_compiler_lock:
            if not self.overloads:
                for kernel in self.calls:
                    kernel.ready()
                with self._cache.compiling:
                    self.compile(self.signature)
                self.disable_compile()
                # Other kernels call this one as it is, where numba would compile it into each of them once more.
                compiled = self.compiled
                self.targetctx.remove_user_function(compiled.entry_point)
                self.targetctx.insert_user_function(compiled.entry_point, compiled.fndesc, [])
        return self.compiled.entry_point

    def ready_if_kept(self) -> bool:
        """Load it unless something has to be compiled for that, it or what it calls. Returns whether it is ready."""
        if not self.overloads and all(kernel.ready_if_kept() for kernel in self.calls) and self._cache.is_kept():
            self.ready()
        return bool(self.overloads)

    def can_be_compiled(self) -> bool:
        """Whether all that it calls is there, and no other process compiles it just now."""
        return all(kernel.ready_if_kept() for kernel in self.calls) and not self._cache.is_claimed()

    def _compile_for_args(self, *args: Any, **kws: Any) -> Any:
        """numba's hook for argument types that are new. Raises TypeError for what the signature does not take."""
        entry_point = self.ready()
        if not self._search_new_conversions(*args):
            self._explain_matching_error(*args)
        return entry_point

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """numba's hook for a call from another kernel, which is being compiled."""
        self.ready()
        return super().get_call_template(args, kws)


class _Cache(NullCache):  # type: ignore[misc]  # numba has no types
    """Where a kernel's machine code comes from and goes to: the interface of numba's caches."""

    def __init__(self, kernel: Kernel) -> None:
        self._kernel = kernel
        self.compiling = ExitStack()  # what is over once it is compiled, or cannot be

    @property
    def cache_path(self) -> str:
        return str(kernel_cache.places()[0])

    def stored(self) -> Any:
        """The pickled parts of the compiled kernel, or None."""
        return kernel_cache.load(*self._names())

    def is_kept(self) -> bool:
        """Whether it was compiled before."""
        return kernel_cache.kept(*self._names())

    def is_claimed(self) -> bool:
        """Whether another process compiles it just now."""
        return kernel_cache.claimed(*self._names())

    def _of_another_process(self) -> Any:
        """What another process compiles just now, once it has; None if none does: then it is for this one to do."""
        names = self._names()
        while not (claim := kernel_cache.claim(*names)):
            time.sleep(LOOK_S)
        self.compiling.callback(kernel_cache.release, claim)
        return self.stored()

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        parts = self.stored()
        if parts is None:
            kernels_ahead.begin()
            parts = self._of_another_process()
        if parts is None:
            self.compiling.enter_context(short_messages())
            return None
        rtsys.initialize(target_context)  # what `target_context.refresh()` would do at the end of everything else
        return CompileResult._rebuild(target_context, *parts)

    def save_overload(self, sig: Any, data: Any) -> None:
        if not data.library.has_dynamic_globals:
            (name, kind, (machine_code, _)), *others = data._replace(type_annotation="")._reduce()
            library = name, kind, (machine_code, _bitcode_of_a_name(data.fndesc.llvm_cpython_wrapper_name))
            kernel_cache.save(*self._names(), dumps((library, *others)))

    def _names(self) -> tuple[str, str, str]:
        kernel = self._kernel
        machine = _machine(kernel.targetctx.codegen())
        # The order of a set is another one in every process.
        options = sorted(
            (name, sorted(value) if isinstance(value, (set, frozenset)) else value)
            for name, value in kernel.targetoptions.items()
        )
        symbols = [called.compiled.fndesc.mangled_name for called in kernel.calls]
        versions = numba.__version__, np.__version__
        whole = repr((kernel.stamp, str(kernel.signature), options, symbols, machine, versions))
        return kernel.name, machine, _digest(whole, 12)


def njit(signature: Any = None, *, cache: bool = False, **options: Any) -> Any:
    """`@njit` or `@njit(signature, cache=True, nogil=True)`, as in numba, for functions of this package."""
    if callable(signature) and not isinstance(signature, types.Type):
        return njit()(signature)

    def decorate(py_func: Callable[..., Any]) -> Any:
        if config.DISABLE_JIT:
            return py_func
        return Helper(py_func, options) if signature is None else Kernel(py_func, signature, options)

    return decorate


def know(value: Any, kind: types.Type, *kernels: Any) -> None:
    """Have numba know the type of an argument, and that kernels take it as `kind`, before threads bring it; and have
    those kernels ready.

    Two threads that are first with a tuple can make its type twice; and a kernel that one thread brings it to while
    another loads the kernel may refuse it (seen once in some hundred runs of two threads on a busy machine).
    """
    with _knowing:
        actual = numba.typeof(value)
        _known.add(actual)
        if not cpu_target.typing_context.install_possible_conversions([actual], [kind]):
            raise TypeError(f"{actual} is not taken as {kind}")
    for kernel in kernels:
        if isinstance(kernel, Kernel):  # plain functions are where numba compiles nothing
            kernel.ready()


def kernels_of(*modules: str) -> list[Kernel]:
    """The kernels (not helpers) that stand in these modules, which are imported."""
    found = [
        value
        for module in modules
        for value in vars(importlib.import_module(module)).values()
        if isinstance(value, Kernel) and value.py_func.__module__ == module
    ]
    return found


def ready(*modules: str) -> None:
    """Load all kernels of these modules, compiling what was not compiled before: no later call will."""
    for kernel in kernels_of(*modules):
        kernel.ready()


def ready_beside(parent: int, *modules: str) -> None:
    """All kernels of these modules that other processes do not compile, as long as the parent process is there."""
    waiting = _with_called(kernels_of(*modules))
    with suppress(KeyboardInterrupt):
        while waiting and (sys.platform == "win32" or os.getppid() == parent):
            chosen = next((kernel for kernel in waiting if kernel.ready_if_kept() or kernel.can_be_compiled()), None)
            if chosen is None:  # all that is left, or what it calls, is in the making
                time.sleep(LOOK_S)
                continue
            chosen.ready()
            waiting.remove(chosen)


def _with_called(kernels: Iterable[Kernel]) -> list[Kernel]:
    """All of them and all that they call, each once, what is called first."""
    found: dict[Kernel, None] = {}

    def add(kernel: Kernel) -> None:
        if kernel not in found:
            for called in kernel.calls:
                add(called)
            found[kernel] = None

    for kernel in kernels:
        add(kernel)
    return list(found)


@contextmanager
def short_messages() -> Iterator[None]:
    """Within the block, kernels are compiled with a plain message for a slice that gets values of another size.

    numba would write both shapes into it, and with that compile its texts into every kernel that assigns to a slice:
    an eighth of all the time.
    """
    from numba.np import arrayobj

    before = getattr(arrayobj, "raise_with_shape_context", None)  # numba 0.61 has none, nor such texts
    if before is None:
        yield
        return
    arrayobj.raise_with_shape_context = _without_shapes()
    try:
        yield
    finally:
        arrayobj.raise_with_shape_context = before


@cache
def _without_shapes() -> Callable[[Any, Any], None]:
    from numba.extending import overload

    def raise_plainly(given: Any, wanted: Any) -> None:
        raise NotImplementedError

    @overload(raise_plainly)  # type: ignore[untyped-decorator]  # numba has no types
    def raise_plainly_compiled(given: Any, wanted: Any) -> Callable[[Any, Any], None]:
        def raise_it(given: Any, wanted: Any) -> None:
            raise ValueError("cannot assign slice from input of different size")

        return raise_it

    return raise_plainly


@contextmanager
def compiling_told(tell: Callable[[str], None]) -> Iterator[None]:
    """Within the block, `tell` is called with the name of each kernel that is about to be compiled."""

    class Listener(event.Listener):  # type: ignore[misc]  # numba has no types
        def on_start(self, happened: Any) -> None:
            kernel = happened.data.get("dispatcher")
            if isinstance(kernel, Kernel):
                tell(kernel.name)

        def on_end(self, happened: Any) -> None:
            pass

    with event.install_listener("numba:compile", Listener()):
        yield


@cache
def _machine(codegen: Any) -> str:
    """Digest of Python and the processor."""
    return _digest(repr((sys.implementation.cache_tag, codegen.magic_tuple())), 4)


def _bitcode_of_a_name(symbol: str) -> bytes:
    """What is kept in place of a kernel's bitcode: no kernel is linked into another, and to parse it all would take
    most of the time of loading. numba asks only whether the function is there that Python calls."""
    bitcode: bytes = llvm.parse_assembly(f'define void @"{symbol}"() {{ ret void }}').as_bitcode()
    return bitcode


def _digest(text: str, size: int) -> str:
    return hashlib.blake2b(text.encode(), digest_size=size).hexdigest()


def _parts(function: Callable[..., Any]) -> Iterator[Any]:
    """All that a function's machine code depends on."""
    yield function.__defaults__
    for part in _codes(function.__code__):
        constants = [c for c in part.co_consts if not isinstance(c, CodeType)]
        yield part.co_code, constants, part.co_names, part.co_varnames
    for name, value in _globals(function):
        yield name, _value(function, name, value)


def _globals(function: Callable[..., Any]) -> Iterator[tuple[str, Any]]:
    """What stands in the module, or in the function around, under the names that a function uses."""
    names = {name for part in _codes(function.__code__) for name in part.co_names}
    known: dict[str, Any] = function.__globals__
    yield from ((name, known[name]) for name in sorted(names & known.keys()))
    cells = function.__closure__ or ()
    free = function.__code__.co_freevars
    yield from ((name, cell.cell_contents) for name, cell in zip(free, cells, strict=True))


def _codes(code: CodeType) -> Iterable[CodeType]:
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)


def _value(function: Callable[..., Any], name: str, value: Any) -> Any:
    """Something whose repr is the same exactly if the value is."""
    if isinstance(value, Helper):
        return value.stamp
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, tuple):
        return [_value(function, name, part) for part in value]
    if isinstance(value, ModuleType):
        if value.__name__.partition(".")[0] != PACKAGE:
            return value.__name__
        raise TypeError(f"{function.__qualname__} uses the module {value.__name__}: kernels import names from it")
    if isinstance(value, (np.generic, bool, int, float, complex, str, bytes, types.Type, type(None))):
        return type(value).__name__, repr(value)
    if callable(value):
        return getattr(value, "__module__", ""), getattr(value, "__qualname__", type(value).__name__)
    raise TypeError(f"{function.__qualname__} uses {name}, a {type(value).__name__}: kernels take plain constants")
