"""Every evaluation as a line of JSON, so that a search that was broken off goes on where it was.

The first line says what was evaluated: the digest of the part and of how it is printed. A search repeats its steps
and finds those it has done in the log, so that it ends as it would have without the break.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import IO

from layerfix import __version__
from layerfix.errors import InputError, OutputError
from layerfix.orientation.directions import Pose
from layerfix.orientation.objective import Counts

KIND = "layerfix orient"
Key = tuple[float, float, float, int, int]


class Record:
    """A log that is written to as evaluations come, and what it already held."""

    def __init__(self, path: Path, token: str, *, resume: bool) -> None:
        """Raises OutputError if it exists and is not to be resumed, InputError if it is of something else."""
        self.path = path
        self.known: dict[Key, Counts] = {}
        self.resumed = resume and path.exists()
        if path.exists() and not resume:
            raise OutputError(f"{path}: exists already; use --resume to go on from it, or another name")
        if resume and not path.exists():
            raise InputError(f"{path}: no such log to resume from")
        head = {"kind": KIND, "version": __version__, "part": token}
        try:
            if self.resumed:
                whole = self._read(head)
                os.truncate(path, whole)
            self._file: IO[str] = path.open("a", encoding="utf-8")
            if not self.resumed:
                self._line(head)
        except OSError as problem:
            raise OutputError(f"{path}: the log could not be written: {problem.strerror}") from problem

    def _read(self, head: dict[str, str]) -> int:
        """Take in what is there; how many bytes of it are whole lines (the last may have been cut off)."""
        whole = 0
        for number, raw in enumerate(self.path.read_bytes().splitlines(keepends=True)):
            if not raw.endswith(b"\n"):
                break
            try:
                line = json.loads(raw)
                if number == 0:
                    self._check(line, head)
                else:
                    t1, t2, psi = line["pose"]
                    seen, layers, solid, added, removed, (a, b, c), height_mm = line["counts"]
                    key = (float(t1), float(t2), float(psi), int(line["first"]), int(line["stop"]))
                    self.known[key] = Counts(seen, layers, solid, added, removed, (a, b, c), float(height_mm))
            except (ValueError, KeyError, TypeError, IndexError) as problem:
                raise InputError(f"{self.path}: line {number + 1} is not of a log of layerfix orient") from problem
            whole += len(raw)
        if not whole:
            raise InputError(f"{self.path}: is not a log of layerfix orient: it has no first line")
        return whole

    def _check(self, line: dict[str, str], head: dict[str, str]) -> None:
        if not isinstance(line, dict) or line.get("kind") != KIND:
            raise InputError(f"{self.path}: is not a log of layerfix orient")
        if line.get("version") != head["version"]:
            raise InputError(f"{self.path}: was written by layerfix {line.get('version')}, this is {head['version']}")
        if line.get("part") != head["part"]:
            raise InputError(f"{self.path}: is of another part, or of other pixels, layers or corrections")

    def add(self, pose: Pose, first: int, stop: int, counts: Counts) -> None:
        """One evaluation. Raises OutputError if the disk refuses."""
        try:
            self._line({"pose": list(pose), "first": first, "stop": stop, "counts": list(counts)})
        except OSError as problem:
            raise OutputError(f"{self.path}: the log could not be written: {problem.strerror}") from problem

    def _line(self, line: Mapping[str, object]) -> None:
        self._file.write(json.dumps(line, separators=(",", ":")) + "\n")
        self._file.flush()

    def close(self) -> None:
        """No more lines."""
        self._file.close()
