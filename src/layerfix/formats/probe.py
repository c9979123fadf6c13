"""A first look at a file, from which its format is recognised: by what is in it, not by its name."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Collection
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from layerfix.files import reading

if TYPE_CHECKING:
    from layerfix.formats.jobs.zips import Archive

HEAD_BYTES = 16384  # what the readers of meshes need to see


class Probe:
    """A folder, or a file's first bytes and, of a zip, its entries. Raises InputError for what cannot be read."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.suffix = path.suffix.lower()
        self.is_folder = path.is_dir()
        self.head = b""
        self.is_zip = False
        if not self.is_folder:
            with reading(path), path.open("rb") as file:
                self.head = file.read(HEAD_BYTES)
                self.is_zip = zipfile.is_zipfile(file)

    @cached_property
    def archive(self) -> Archive:
        """The zip. Raises InputError for what is none, and for one that is not to be trusted."""
        from layerfix.formats.jobs.zips import Archive

        return Archive(self.path)

    @property
    def entries(self) -> Collection[str]:
        """Names of a zip's entries; none of anything else."""
        return self.archive.entries if self.is_zip else ()


def starts(*beginnings: bytes, at: int = 0) -> Callable[[Probe], bool]:
    """One of these bytes at this place."""
    return lambda probe: probe.head[at:].startswith(beginnings)


def is_zip_with(*names: str) -> Callable[[Probe], bool]:
    """A zip with an entry of one of these names (in small letters; the entry may have capitals)."""
    return lambda probe: any(name.lower() in names for name in probe.entries)


def is_folder(probe: Probe) -> bool:
    """A folder."""
    return probe.is_folder


def has_suffix(*suffixes: str) -> Callable[[Probe], bool]:
    """A file called so, where nothing in it gives its kind away."""
    return lambda probe: probe.suffix in suffixes and not probe.is_folder
