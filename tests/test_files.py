"""Outputs are there whole or not at all, whatever goes wrong, and what was there before is kept till then."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import stat
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from layerfix import slice_mesh, write
from layerfix.errors import InputError, OutputError
from layerfix.files import check_target, whole_file, whole_folder
from tests.making import contents, run_layerfix, run_without_override, sphere, start_layerfix, thin_part, write_stl

FIX = ("--pixel", "50um", "--layer", "0.1mm", "--min-feature", "0.4mm")
# Fails within the block, in the ways it can: our own error, the system's, Ctrl-C, and one nobody thought of.
ERRORS = [
    InputError("a broken layer"),
    OSError(28, "No space left on device"),
    KeyboardInterrupt(),
    ZeroDivisionError(),
]


def write_file(path: Path, data: bytes, *, force: bool = False, error: BaseException | None = None) -> None:
    with whole_file(path, force=force) as file:
        file.write(data)
        if error:
            raise error


def write_folder(path: Path, *names: str, force: bool = False, error: BaseException | None = None) -> None:
    with whole_folder(path, force=force) as folder:
        for name in names:
            (folder / name).write_bytes(name.encode())
        if error:
            raise error


def test_a_file_appears_when_the_block_ends(tmp_path):
    """Inside the block only a hidden temporary is there; afterwards only the file."""
    with whole_file(tmp_path / "out.zip", force=False) as file:
        file.write(b"half")
        (name,) = contents(tmp_path)
        assert name.startswith(".out.zip.")
        assert name.endswith(".part")
        file.write(b"whole")
    assert contents(tmp_path) == {"out.zip": b"halfwhole"}


def test_a_folder_appears_when_the_block_ends(tmp_path):
    """The same for a folder and what is in it."""
    with whole_folder(tmp_path / "out", force=False) as folder:
        (folder / "1.png").write_bytes(b"1")
        assert not (tmp_path / "out").exists()
        assert folder.parent == tmp_path
    assert contents(tmp_path) == {"out": None, "out/1.png": b"1"}


@pytest.mark.parametrize("error", ERRORS, ids=lambda e: type(e).__name__)
@pytest.mark.parametrize("existing", [False, True])
def test_an_error_in_the_block_leaves_nothing_new(tmp_path, error, existing):
    """File or folder: no part of the output, no temporary; what was there before is untouched."""
    if existing:
        write_file(tmp_path / "out.zip", b"old")
        write_folder(tmp_path / "out", "old.png")
    before = contents(tmp_path)
    expected = OutputError if isinstance(error, OSError) else type(error)
    with pytest.raises(expected):
        write_file(tmp_path / "out.zip", b"new", force=True, error=error)
    with pytest.raises(expected):
        write_folder(tmp_path / "out", "new.png", force=True, error=error)
    assert contents(tmp_path) == before


def test_what_the_system_says_names_the_target(tmp_path):
    """A full disk is an OutputError with the path and the reason."""
    with (
        pytest.raises(
            OutputError, match=r"out\.zip: could not be written: no space left on device; nothing was left"
        ),
        whole_file(tmp_path / "out.zip", force=False),
    ):
        raise OSError(28, "No space left on device")


@pytest.mark.parametrize("kind", [whole_file, whole_folder])
def test_an_existing_target_needs_force(tmp_path, kind):
    """Without force it is refused before the block, with force it is replaced whole."""
    write = write_file if kind is whole_file else write_folder
    write(tmp_path / "out", *([b"old"] if kind is whole_file else ["old.png"]))
    before = contents(tmp_path)
    with pytest.raises(OutputError, match=r"out: exists already.*use --force"), kind(tmp_path / "out", force=False):
        pytest.fail("the block must not run")
    assert contents(tmp_path) == before
    write(tmp_path / "out", *([b"new"] if kind is whole_file else ["new.png"]), force=True)
    assert contents(tmp_path) == ({"out": b"new"} if kind is whole_file else {"out": None, "out/new.png": b"new.png"})


def test_an_empty_folder_needs_no_force(tmp_path):
    """One that was made to be filled."""
    (tmp_path / "out").mkdir()
    write_folder(tmp_path / "out", "1.png")
    assert contents(tmp_path) == {"out": None, "out/1.png": b"1.png"}


@pytest.mark.parametrize("strange", ["notes.txt", "sub", ".hidden"])
def test_a_folder_with_other_things_is_never_replaced(tmp_path, strange):
    """Force is for layers that layerfix wrote; a folder with anything else in it is named and kept."""
    write_folder(tmp_path / "out", "1.png")
    (tmp_path / "out" / strange).mkdir() if strange == "sub" else (tmp_path / "out" / strange).write_text("mine")
    before = contents(tmp_path)
    with pytest.raises(OutputError, match=f"out: holds '{strange}', which layerfix did not write"):
        write_folder(tmp_path / "out", "2.png", force=True)
    assert contents(tmp_path) == before


def test_a_file_is_not_written_over_a_folder_nor_a_folder_over_a_file(tmp_path):
    """Not even by force."""
    (tmp_path / "out.zip").mkdir()
    (tmp_path / "out").write_text("mine")
    before = contents(tmp_path)
    with pytest.raises(OutputError, match=r"out\.zip: is a folder"):
        write_file(tmp_path / "out.zip", b"", force=True)
    with pytest.raises(OutputError, match="out: is a file"):
        write_folder(tmp_path / "out", "1.png", force=True)
    assert contents(tmp_path) == before


def test_a_symlink_is_replaced_and_what_it_points_to_is_kept(tmp_path):
    """A link counts as existing; by force the link goes, not the file or folder behind it."""
    (tmp_path / "real.zip").write_text("mine")
    write_folder(tmp_path / "real", "mine.png")
    (tmp_path / "out.zip").symlink_to("real.zip")
    (tmp_path / "out").symlink_to("real")
    for call in (
        lambda **k: write_file(tmp_path / "out.zip", b"new", **k),
        lambda **k: write_folder(tmp_path / "out", **k),
    ):
        with pytest.raises(OutputError, match="exists already"):
            call()
        call(force=True)
    assert (tmp_path / "real.zip").read_text() == "mine"
    assert (tmp_path / "real" / "mine.png").exists()
    assert not (tmp_path / "out.zip").is_symlink()
    assert not (tmp_path / "out").is_symlink()
    assert not [name for name in contents(tmp_path) if name.startswith(".")]


def test_a_link_to_nowhere_counts_as_existing(tmp_path):
    """It is somebody's link."""
    (tmp_path / "out.zip").symlink_to("nowhere")
    with pytest.raises(OutputError, match="exists already"):
        check_target(tmp_path / "out.zip", force=False)


def test_a_folder_that_is_not_there_is_named(tmp_path):
    """The parent must exist: a typing error must not make folders."""
    for target in ("none/out", "none/out.zip"):
        with pytest.raises(OutputError, match=r"there is no folder .*none"):
            check_target(tmp_path / target, force=False)
    (tmp_path / "file").write_text("mine")
    with pytest.raises(OutputError, match=r"there is no folder .*file"):
        check_target(tmp_path / "file" / "out.zip", force=False)


def test_permissions_are_those_of_a_new_file(tmp_path):
    """The temporary is private; the result is as open as any new file, and a replaced one stays as it was."""
    mask = os.umask(0o027)
    try:
        write_file(tmp_path / "out.zip", b"1")
        write_folder(tmp_path / "out", "1.png")
        assert stat.S_IMODE((tmp_path / "out.zip").stat().st_mode) == 0o640
        assert stat.S_IMODE((tmp_path / "out").stat().st_mode) == 0o750
        (tmp_path / "out.zip").chmod(0o604)
        write_file(tmp_path / "out.zip", b"2", force=True)
        assert stat.S_IMODE((tmp_path / "out.zip").stat().st_mode) == 0o604
    finally:
        os.umask(mask)


@pytest.mark.parametrize("error", [OSError(5, "Input/output error"), KeyboardInterrupt()], ids=["error", "Ctrl-C"])
@pytest.mark.parametrize("moment", ["before", "after"])
@pytest.mark.parametrize("which", [1, 2])
def test_an_interrupted_replacement_costs_neither_folder(tmp_path, monkeypatch, which, moment, error):
    """Replacing a folder is two renames. Stopped before or right after either of them, one of the two folders is
    there, whole: Python raises Ctrl-C as soon as the system call that it came during is done.
    """
    write_folder(tmp_path / "out", "old.png")
    rename, calls = os.replace, []

    def stops(source: Path, target: Path) -> None:
        calls.append(source)
        if len(calls) == which and moment == "before":
            raise error
        rename(source, target)
        if len(calls) == which and isinstance(error, KeyboardInterrupt):
            raise error

    if moment == "after" and isinstance(error, OSError):
        return  # a call that failed has done nothing
    monkeypatch.setattr(os, "replace", stops)
    with pytest.raises((OutputError, KeyboardInterrupt)):
        write_folder(tmp_path / "out", "new.png", force=True)
    old, new = {"out": None, "out/old.png": b"old.png"}, {"out": None, "out/new.png": b"new.png"}
    assert contents(tmp_path) in ([old, new] if (which, moment) == (2, "after") else [old])


def test_nothing_is_left_if_the_old_folder_cannot_be_moved(tmp_path, monkeypatch):
    """The first of the two renames fails: the old folder stays, and no helper folder remains beside it."""
    write_folder(tmp_path / "out", "old.png")
    before = contents(tmp_path)
    rename = os.replace

    def first_fails(source: Path, target: Path) -> None:
        if Path(source) == tmp_path / "out":
            raise OSError(16, "Device or resource busy")
        rename(source, target)

    monkeypatch.setattr(os, "replace", first_fails)
    with pytest.raises(OutputError, match="busy"):
        write_folder(tmp_path / "out", "new.png", force=True)
    assert contents(tmp_path) == before


# With a real process -------------------------------------------------------------------------------------


def test_the_folder_one_stands_in_as_the_target(tmp_path):
    """`layerfix fix part.stl .` in an empty folder either fills it or says why not; nothing is left beside it."""
    write_stl(tmp_path / "part.stl", thin_part())
    (tmp_path / "here").mkdir()
    done = run_layerfix("fix", tmp_path / "part.stl", ".", *FIX, cwd=tmp_path / "here")
    assert set(os.listdir(tmp_path)) == {"part.stl", "here"}
    assert done.code in (0, 2)
    assert bool(os.listdir(tmp_path / "here")) == (done.code == 0)
    assert "Traceback" not in done.err


@pytest.mark.parametrize("target", ["out", "out.zip"])
def test_a_folder_that_cannot_be_written_to(tmp_path, target):
    """Refused before any work, in one line that names the folder."""
    write_stl(tmp_path / "part.stl", thin_part())
    (tmp_path / "closed").mkdir(mode=0o555)
    before = contents(tmp_path)
    done = run_without_override("fix", tmp_path / "part.stl", f"closed/{target}", *FIX, cwd=tmp_path)
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith(f"layerfix: closed/{target}: the folder ")
    assert done.err.endswith("cannot be written to\n")
    assert contents(tmp_path) == before


def test_an_input_that_may_not_be_read(tmp_path):
    """A mesh, a zip, a folder, an image in it, a printer: one line that names it, no traceback."""
    write_stl(tmp_path / "part.stl", thin_part())
    for name in ("layers.zip", "layers", "closed"):
        write(tmp_path / name, slice_mesh(thin_part(), pixel_mm=0.05, layer_mm=0.1))
    shutil.copy(Path(__file__).parents[1] / "sample_printers" / "prusa-sl1s.toml", tmp_path / "my.toml")
    (tmp_path / "open.stl").write_bytes((tmp_path / "part.stl").read_bytes())
    for name in ("part.stl", "layers.zip", "closed", "layers/00004.png", "my.toml"):
        (tmp_path / name).chmod(0)
    before = set(os.listdir(tmp_path))
    calls = {"part.stl": ("part.stl", *FIX), "layers.zip": ("layers.zip", *FIX), "closed": ("closed", *FIX),
             "00004.png": ("layers", *FIX), "my.toml": ("open.stl", "-p", "my.toml")}  # fmt: skip
    problems = []
    for named, call in calls.items():
        done = run_without_override("fix", call[0], "out.zip", *call[1:], cwd=tmp_path)
        last = (done.err.splitlines() or [""])[-1]
        if done.code != 2 or named not in last or not re.search("permission|readable", last, re.IGNORECASE):
            problems.append(f"{named}: exit {done.code}: {last}")
    assert problems == []
    assert set(os.listdir(tmp_path)) == before


@contextlib.contextmanager
def small_disk(place: Path) -> Iterator[bool]:
    """A file system of 200 kB at `place`, if this system lets us mount one."""
    place.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=200k", "tmpfs", str(place)], capture_output=True, check=False
    )
    try:
        yield mounted.returncode == 0
    finally:
        if mounted.returncode == 0:
            subprocess.run(["umount", str(place)], check=True)


def limit_file_size() -> None:
    """For a new process: no file may grow beyond 20 kB."""
    import resource

    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))


@pytest.mark.parametrize("target", ["out", "out.zip"])
def test_a_full_disk(tmp_path, target):
    """Exit code 2, one line that names the target, nothing left on the disk, and an older output kept.

    Where no small disk can be mounted, a limit on the size of files stands in for it.
    """
    part = write_stl(tmp_path / "part.stl", sphere(15, 60, 30))
    options = (*FIX, "--force", "--bits", "8")
    with small_disk(tmp_path / "disk") as mounted:
        place = tmp_path / "disk" / target
        if target == "out":
            place.mkdir()
            (place / "old.png").write_bytes(b"old")
        else:
            place.write_bytes(b"old")
        before = contents(tmp_path)
        more = {} if mounted else {"preexec_fn": limit_file_size}
        if not mounted and target == "out":
            options += ("--pixel", "5um")  # each image is a file of its own and has to pass the limit
        process = start_layerfix("fix", part, place, *options, **more)
        out, err = process.communicate(timeout=120)
        assert contents(tmp_path) == before
    assert (process.returncode, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert err.startswith(f"layerfix: {place}: could not be written: ")
    assert "nothing was left behind" in err
