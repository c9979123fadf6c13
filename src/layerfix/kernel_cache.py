"""Compiled kernels on disk: one file each, named by a digest of everything the machine code depends on.

numba's own cache looks at the file a kernel stands in: after an edit of a kernel that it calls in another file, the
old machine code still ran. Here the digest is part of the name, so that a stale file is never opened; what is in a
file has a digest, too, so that an empty, cut-short or garbled one counts as none; files appear by one rename, so that
several processes may begin at once; and nothing is written where nothing may be: reading tries every place.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import secrets
import sys
import time
import warnings
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

SUFFIX, CLAIM, TEMPORARY = ".kernel", ".claim", ".new"
CLAIM_S = 60.0  # no kernel takes so long: a claim that is older was left by a process that was killed
DIGEST_BYTES = 16


class KernelsNotKept(UserWarning):
    """Compiled kernels could not be written anywhere: every process compiles them anew."""


def places() -> list[Path]:
    """Folders in which kernels are looked for, in order; the first that can be written to takes new ones.

    ``NUMBA_CACHE_DIR`` and no other if it is set; else the package itself and the user's cache folder. Outside the
    package every installation has a folder of its own, so that two versions do not clear each other's kernels away.
    """
    package, own = _package()
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:
        return [Path(given, own)]
    home = _user_cache()
    return [package / "__pycache__" / "kernels", *([home / own] if home is not None else [])]


@cache
def _package() -> tuple[Path, str]:
    """Where this package is, and the name of its own folder elsewhere."""
    package = Path(__file__).resolve().parent
    return package, f"layerfix-{hashlib.blake2b(os.fsencode(package), digest_size=6).hexdigest()}"


def _user_cache() -> Path | None:
    """The folder for caches of this user, as the system has it; None without a home."""
    variable = "LOCALAPPDATA" if sys.platform == "win32" else "XDG_CACHE_HOME"
    given = os.environ.get(variable, "")
    if os.path.isabs(given):
        return Path(given)
    try:
        home = Path.home()
    except RuntimeError:
        return None
    if sys.platform == "win32":
        return home / "AppData" / "Local"
    return home / "Library" / "Caches" if sys.platform == "darwin" else home / ".cache"


def load(name: str, machine: str, digest: str) -> Any:
    """What was saved under these names, or None if nothing sound is there."""
    for place in places():
        try:
            data = (place / _file_name(name, machine, digest)).read_bytes()
        except (OSError, ValueError):
            continue
        body = data[DIGEST_BYTES:]
        if len(data) > DIGEST_BYTES and _digest(body) == data[:DIGEST_BYTES]:
            return pickle.loads(body)
    return None


def kept(name: str, machine: str, digest: str) -> bool:
    """Whether `load` has something to look at."""
    return any((place / _file_name(name, machine, digest)).exists() for place in places())


def claim(name: str, machine: str, digest: str) -> Path | bool:
    """Say that this process compiles a kernel, so that others do not: the claim, to be given back by `release`.

    False if another process compiles it just now; True where no claim can be written, and none is needed.
    """
    for place in places():
        path = (place / _file_name(name, machine, digest)).with_suffix(CLAIM)
        try:
            place.mkdir(parents=True, exist_ok=True)
            if claimed(name, machine, digest):
                return False
            path.unlink(missing_ok=True)
            with path.open("x") as file:
                file.write(str(os.getpid()))
        except FileExistsError:
            return False
        except (OSError, ValueError):
            continue
        return path
    return True


def claimed(name: str, machine: str, digest: str) -> bool:
    """Whether a process that is alive has claimed a kernel."""
    for place in places():
        path = (place / _file_name(name, machine, digest)).with_suffix(CLAIM)
        try:
            if time.time() - path.stat().st_mtime < CLAIM_S and _alive(path.read_text()):
                return True
        except (OSError, ValueError):
            continue
    return False


def release(claim: Path | bool) -> None:
    """Give a claim back."""
    if isinstance(claim, Path):
        with suppress(OSError):
            claim.unlink()


def forget_claims(pids: Sequence[int]) -> None:
    """Clear away what processes that were killed have claimed."""
    gone = {str(pid) for pid in pids}
    for place in places():
        for path in place.glob(f"*{CLAIM}"):
            with suppress(OSError):
                if path.read_text() in gone:
                    path.unlink()


def _alive(pid: str) -> bool:
    """Whether there is such a process, as far as that can be asked; one that has not said its number yet is there."""
    if os.name != "posix" or not pid:
        return True
    try:
        os.kill(int(pid), 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass
    return True


def save(name: str, machine: str, digest: str, value: bytes) -> Path | None:
    """Keep a pickled kernel in the first place that takes it, and clear away what it replaces.

    name     of the kernel, with its module
    machine  digest of Python and the processor: kernels for other ones stay
    digest   of all that the machine code depends on
    Returns the file, or None (and warns, once) if no place can be written to.
    """
    for place in places():
        target = place / _file_name(name, machine, digest)
        try:
            place.mkdir(parents=True, exist_ok=True)
            _write(target, _digest(value) + value)
        except (OSError, ValueError):
            continue
        with suppress(OSError):
            for old in place.glob(_file_name(name, machine, "*")):
                if old != target:
                    old.unlink()
        return target
    _warn()
    return None


@cache
def _warn() -> None:
    warnings.warn(
        "compiled kernels cannot be kept, as no folder for them can be written to; every run compiles them anew"
        f" ({_advice()})",
        KernelsNotKept,
        stacklevel=2,
    )


def _advice() -> str:
    given = os.environ.get("NUMBA_CACHE_DIR")
    return f"NUMBA_CACHE_DIR is {given}" if given else "NUMBA_CACHE_DIR names a folder"


def _file_name(name: str, machine: str, digest: str) -> str:
    return f"{name}-{machine}-{digest}{SUFFIX}"


def _digest(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=DIGEST_BYTES).digest()


def _write(target: Path, data: bytes) -> None:
    """The file appears whole or not at all, and may be read by all whom the folder lets in."""
    temporary = target.with_name(f".{secrets.token_hex(8)}{TEMPORARY}")
    try:
        temporary.write_bytes(data)
        os.replace(temporary, target)
    except BaseException:
        with suppress(OSError):
            temporary.unlink()
        raise
