"""Outputs that appear whole or not at all: a temporary beside the target, then one rename."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from layerfix.errors import InputError, OutputError

A_LONG_TIME_AGO = (1980, 1, 1, 0, 0, 0)  # the earliest time of a zip entry: same content, same bytes


def _is_image(path: Path) -> bool:
    return path.suffix.lower() == ".png" and not path.is_dir()


def check_target(path: Path, *, force: bool, ours: Callable[[Path], bool] = _is_image) -> None:
    """Raises OutputError if `path` exists and may not be replaced, or its folder cannot be written to."""
    if path.is_dir() and not path.is_symlink():
        if any(path.iterdir()):
            _check_replaceable(path, force, ours)
    elif os.path.lexists(path) and not force:
        raise OutputError(f"{path}: exists already; use --force to replace it")
    parent = path.absolute().parent
    if not parent.is_dir():
        raise OutputError(f"{path}: there is no folder {parent}")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise OutputError(f"{path}: the folder {parent} cannot be written to")


def _check_replaceable(folder: Path, force: bool, ours: Callable[[Path], bool]) -> None:
    if not force:
        raise OutputError(f"{folder}: exists already and is not empty; use --force to replace it")
    strange = next((p for p in folder.iterdir() if not ours(p)), None)
    if strange is not None:
        raise OutputError(
            f"{folder}: holds '{strange.name}', which layerfix did not write; choose another folder or empty this one"
        )


def check_apart(target: Path, source: Path) -> None:
    """Raises OutputError if a target is the input or inside it: that is never written over, nor written into."""
    inside = source.is_dir() and source.resolve() in target.absolute().parents
    if inside or (target.exists() and source.exists() and target.samefile(source)):
        raise OutputError(f"{target}: is {'inside ' if inside else ''}the input; layerfix never writes to its input")


@contextmanager
def whole_file(path: Path, *, force: bool) -> Iterator[BinaryIO]:
    """A binary file to write to; it takes the place of `path` when the block ends without an error.

    Raises OutputError naming `path` for anything the system refuses: no space, no permission.
    """
    check_target(path, force=force)
    if path.is_dir():
        raise OutputError(f"{path}: is a folder; a {path.suffix or 'file'} is to be written there")
    temporary: Path | None = None
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.absolute().parent)
        temporary = Path(name)
        with os.fdopen(handle, "w+b") as file:
            yield file
        temporary.chmod(_mode(path))
        os.replace(temporary, path)
        temporary = None
    except OSError as problem:
        raise OutputError(_refused(path, problem)) from problem
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


@contextmanager
def whole_folder(path: Path, *, force: bool, ours: Callable[[Path], bool] = _is_image) -> Iterator[Path]:
    """A new folder to write into; it takes the place of `path` when the block ends without an error.

    ours  which files and folders may be lost with a folder that is replaced
    """
    check_target(path, force=force, ours=ours)
    if os.path.lexists(path) and not path.is_dir():
        raise OutputError(f"{path}: is a file; a folder is to be written there")
    temporary: Path | None = None
    try:
        temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".part", dir=path.absolute().parent))
        yield temporary
        temporary.chmod(0o777 & ~_umask())
        _swap_in(temporary, path)
        temporary = None
    except OSError as problem:
        raise OutputError(_refused(path, problem)) from problem
    finally:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)


def _swap_in(temporary: Path, path: Path) -> None:
    """Put `temporary` in the place of `path`; what was there goes only once the new one is in place."""
    if not path.is_dir():
        os.replace(temporary, path)
        return
    old = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".old", dir=path.absolute().parent))
    try:
        os.replace(path, old / "was")
        os.replace(temporary, path)
    except BaseException:  # a signal too: the old folder goes back to its place
        if (old / "was").is_dir() and not path.exists():
            os.replace(old / "was", path)
        raise
    finally:
        shutil.rmtree(old, ignore_errors=True)


@contextmanager
def reading(path: str | Path) -> Iterator[None]:
    """Turn what the system says about an unreadable input into an InputError that names it."""
    try:
        yield
    except OSError as problem:
        raise InputError(f"{path}: cannot be read: {(problem.strerror or str(problem)).lower()}") from problem


def _refused(path: Path, problem: OSError) -> str:
    return f"{path}: could not be written: {(problem.strerror or str(problem)).lower()}; nothing was left behind"


def _umask() -> int:
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


def _mode(path: Path) -> int:
    """The permissions of the file being replaced, or those of a new file (mkstemp's are private)."""
    try:
        return path.stat().st_mode & 0o777
    except FileNotFoundError:
        return 0o666 & ~_umask()
