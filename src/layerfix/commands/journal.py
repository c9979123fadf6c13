"""What a watched folder's jobs have come to, on disk: written whole after every step, so that a killed run is gone on
with where it was.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from layerfix.errors import InputError, OutputError
from layerfix.files import whole_file

State = Literal["begun", "finished", "done", "failed", "skipped"]
SCHEMA_VERSION = 1


@dataclass(frozen=True)
class Signature:
    """By what a file (or a folder of files) is known to be what it was, without reading it."""

    bytes: int
    mtime_ns: int
    files: int = 1


@dataclass(frozen=True)
class Job:
    """One job: begun (its output is in the making), finished (its output is whole, not yet in its place), done,
    failed, with why, or skipped, since it is none.

    written  an output of that name is ours, of this or of an earlier job
    options  a digest of those that it failed with
    """

    state: State
    signature: Signature
    sha256: str
    why: str = ""
    written: bool = False
    options: str = ""


@dataclass
class Journal:
    """Jobs by name. Every change is on the disk before it counts."""

    path: Path
    jobs: dict[str, Job] = field(default_factory=dict)

    @classmethod
    def opened(cls, path: Path) -> Journal:
        """As it was left; empty if there is none. Raises InputError for a file that is no journal."""
        if not path.exists():
            return cls(path)
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            if data["schema_version"] != SCHEMA_VERSION:
                raise ValueError(f"schema_version {data['schema_version']}, known is {SCHEMA_VERSION}")
            return cls(path, {name: _job(values) for name, values in data["jobs"].items()})
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as problem:
            raise InputError(
                f"{path}: is no journal of `layerfix watch` ({problem}); remove it to begin anew"
            ) from problem

    def set(self, name: str, job: Job) -> None:
        """Note what a job has come to."""
        self.jobs[name] = job
        text = json.dumps({"schema_version": SCHEMA_VERSION, "jobs": {k: asdict(v) for k, v in self.jobs.items()}})
        with whole_file(self.path, force=True) as file:
            file.write(text.encode())


def _job(values: dict[str, Any]) -> Job:
    return Job(**{**values, "signature": Signature(**values["signature"])})


def signature_of(path: Path) -> Signature | None:
    """What a file or folder looks like from outside; None if it is not there (any more)."""
    try:
        if not path.is_dir():
            found = path.stat()
            return Signature(found.st_size, found.st_mtime_ns)
        inside = [entry.stat() for entry in os.scandir(path)]
        newest = max((one.st_mtime_ns for one in inside), default=0)
        return Signature(sum(one.st_size for one in inside), newest, len(inside))
    except OSError:
        return None


def sha256_of(path: Path) -> str:
    """Of a file's bytes; of a folder, of the names and bytes of its files."""
    whole = hashlib.sha256()
    try:
        for one in sorted(path.iterdir()) if path.is_dir() else [path]:
            if not one.is_file():
                continue
            with one.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256")
            if one == path:
                return digest.hexdigest()
            whole.update(one.name.encode("utf-8", "surrogateescape") + b"\0" + digest.digest())
    except OSError as problem:
        raise InputError(f"{path}: cannot be read: {(problem.strerror or str(problem)).lower()}") from problem
    return whole.hexdigest()


@contextmanager
def only_one(path: Path) -> Iterator[None]:
    """Hold a lock file for the block. Raises OutputError if another process holds it; a killed one holds nothing."""
    with path.open("a+b") as file:
        try:
            if os.name == "nt":
                import msvcrt

                file.seek(0)
                msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]  # elsewhere there is none
            else:
                import fcntl

                fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as problem:
            raise OutputError(f"{path.parent}: another `layerfix watch` is at work there") from problem
        yield
