"""A folder that jobs are put into: each is corrected once, into another folder, when it is whole.

Nothing is touched while it grows. An output is made in a hidden folder beside its place, and moves there in one step
after the journal says that it is whole: whenever a run is killed, the next one finds each job either done, or to be
begun again, or whole and to be moved.
"""

from __future__ import annotations

import hashlib
import shutil
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Any

from layerfix.commands.journal import Job, Journal, Signature, only_one, sha256_of, signature_of
from layerfix.commands.options import Options
from layerfix.commands.project import fix_file as fix
from layerfix.commands.summary import Summary
from layerfix.errors import InputError, LayerfixError, OutputError
from layerfix.files import check_target, put_in_place
from layerfix.formats import find_format
from layerfix.formats.table import rows

JOURNAL, MAKING, LOCK, LOG = (
    ".layerfix-watch.json",
    ".layerfix-watch.part",
    ".layerfix-watch.lock",
    "layerfix-watch.log",
)
UNFINISHED = ("", ".part", ".partial", ".tmp", ".temp", ".crdownload", ".download", ".filepart")  # and no suffix


@dataclass(frozen=True)
class Event:
    """What happened to a job: `corrected`, `failed`, `changed` (while it was read: it is begun again), or `skipped`
    (it is no job).

    summary: what `fix` did, of a corrected one; why: of one that failed or was skipped
    """

    event: str
    job: str
    target: str
    time: str
    summary: Summary | None = None
    why: str = ""

    def line(self) -> str:
        """For people and the log."""
        said = self.why
        if self.summary is not None:
            s = self.summary
            said = f"{s.layers_changed} of {s.layers} layers changed, {s.added_mm3:.4g} mm³ added, {s.seconds:.1f} s"
            said = "; ".join([said, *s.notes])
        return f"{self.time}  {self.event:9}  {self.job}{': ' if said else ''}{said}"

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


@dataclass
class Watch:
    """A watched folder and its outputs.

    settle_s    how long a job's size and time must have stayed the same
    interval_s  between two looks
    """

    folder: Path
    out: Path
    options: Options
    tell: Callable[[Event], None] = lambda event: None
    settle_s: float = 2.0
    interval_s: float = 1.0

    def run(self, *, once: bool = False) -> int:
        """Look and correct until stopped; `once`: until all that is there is corrected or has failed.

        Gives the number of jobs that failed. Raises InputError for a folder that is not there, OutputError for one
        that cannot take outputs, or that another process watches into.
        """
        self._check()
        with only_one(self.out / LOCK):
            self.journal = Journal.opened(self.out / JOURNAL)
            self._go_on()
            seen: dict[str, tuple[Signature, float]] = {}
            failed = 0
            while True:
                waiting = self._waiting()
                for path, signature in waiting:
                    since = seen.get(path.name)
                    if since is None or since[0] != signature:
                        seen[path.name] = signature, time.monotonic()
                    elif time.monotonic() - since[1] >= self.settle_s:
                        failed += self._take(path, signature)
                        shutil.rmtree(self.out / MAKING, ignore_errors=True)
                        seen.pop(path.name)
                if once and not waiting:
                    return failed
                time.sleep(self.interval_s)

    def _check(self) -> None:
        if not self.folder.is_dir():
            raise InputError(f"{self.folder}: no such folder; jobs are put into one")
        if not self.out.is_dir():
            raise OutputError(f"{self.out}: there is no such folder for the corrected jobs; make it")
        if self.out.resolve() == self.folder.resolve():
            raise OutputError(f"{self.out}: is the folder that is watched; corrected jobs would be corrected again")
        check_target(self.out / JOURNAL, force=True)

    def _go_on(self) -> None:
        """After a run that was killed: what is whole goes to its place, what is half goes away."""
        making = self.out / MAKING
        for name, job in list(self.journal.jobs.items()):
            if job.state == "finished":
                if (making / name).exists():
                    put_in_place(making / name, self.out / name)
                self.journal.set(name, replace(job, state="done", written=True))
        shutil.rmtree(making, ignore_errors=True)

    def _waiting(self) -> list[tuple[Path, Signature]]:
        """Jobs that are not done, the oldest first."""
        found = []
        for path in self.folder.iterdir():
            signature = signature_of(path) if self._is_job(path) else None
            known = self.journal.jobs.get(path.name)
            settled = known is not None and known.signature == signature and self._settled(known)
            if signature is not None and not settled:
                found.append((path, signature))
        return sorted(found, key=lambda one: (one[1].mtime_ns, one[0].name))

    def _settled(self, known: Job) -> bool:
        """Whether nothing is to be done as long as it is the same; what failed is tried again with other options."""
        return known.state in ("done", "skipped") or (known.state == "failed" and known.options == self._asked)

    @cached_property
    def _asked(self) -> str:
        return hashlib.blake2b(repr(self.options).encode(), digest_size=8).hexdigest()

    def _is_job(self, path: Path) -> bool:
        """By its name alone: a file that is not hidden, nor called as unfinished ones are; a folder with something in
        it."""
        if path.name.startswith(".") or path.resolve() == self.out.resolve():
            return False
        if path.is_dir():
            return any(not one.name.startswith(".") for one in path.iterdir())
        return path.is_file() and path.suffix.lower() not in UNFINISHED

    def _take(self, path: Path, signature: Signature) -> bool:
        """Correct a job; True if it failed."""
        name, known = path.name, self.journal.jobs.get(path.name)
        target, making = self.out / name, self.out / MAKING / name
        try:
            sha256 = sha256_of(path)
        except InputError:  # it has gone, or is still being written under a lock
            return False
        job = Job("begun", signature, sha256, written=known is not None and known.written)
        if known is not None and self._settled(known) and known.sha256 == sha256:
            self.journal.set(name, replace(known, signature=signature))  # touched, not changed
            return False
        if (why := _no_job(path)) is not None:
            self.journal.set(name, replace(job, state="skipped", why=why))
            self._say("skipped", name, target, why=why)
            return False
        try:
            check_target(target, force=self.options.run.force or job.written)
            self.journal.set(name, job)
            (self.out / MAKING).mkdir(exist_ok=True)
            summary = fix(
                path, making, replace(self.options, run=replace(self.options.run, force=True, picture=None))
            )
        except LayerfixError as problem:
            if signature_of(path) != signature:
                return self._changed(name, job, target)
            self.journal.set(name, replace(job, state="failed", why=str(problem), options=self._asked))
            self._say("failed", name, target, why=str(problem).replace(str(making), str(target)))
            return True
        if signature_of(path) != signature:
            return self._changed(name, job, target)
        self.journal.set(name, replace(job, state="finished"))
        put_in_place(making, target)
        self.journal.set(name, replace(job, state="done", written=True))
        self._say("corrected", name, target, replace(summary, target=str(target)))
        return False

    def _changed(self, name: str, job: Job, target: Path) -> bool:
        self._say("changed", name, target, why="it changed while it was read, and is read again")
        return False

    def _say(self, event: str, name: str, target: Path, summary: Summary | None = None, why: str = "") -> None:
        said = Event(event, name, str(target), datetime.now().isoformat(" ", "seconds"), summary, why)
        with (self.out / LOG).open("a", encoding="utf-8") as file:
            file.write(said.line() + "\n")
        self.tell(said)


def _no_job(path: Path) -> str | None:
    """Why a file is none that is corrected: nothing in it is known, nor is what it is called; or a folder, for it has
    no images. None of a job, even of one that cannot be read."""
    if path.is_dir():
        return None if any(path.glob("*.png")) else f"{path}: a folder without PNG images; only those are jobs"
    try:
        find_format(path)
    except InputError as problem:
        named = (row for row in rows() if path.suffix.lower() in row.suffixes)
        if not any(row.layers or row.mesh or not row.writers for row in named):
            return str(problem)
    return None
