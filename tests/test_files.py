"""Outputs are there whole or not at all, whatever goes wrong, and what was there before is kept till then."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from layerfix import files, slice_mesh, write
from layerfix.errors import InputError, OutputError
from layerfix.files import (
    already_written,
    check_apart,
    check_input,
    check_target,
    unfit_for_windows,
    whole_file,
    whole_folder,
)
from tests.making import (
    contents,
    environment,
    run_layerfix,
    run_without_override,
    sphere,
    start_layerfix,
    thin_part,
    write_stl,
)

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


def test_through_a_link_what_it_points_to_is_written(tmp_path):
    """A link counts as existing; by force it stays, and the file or folder behind it is the new one."""
    place = tmp_path / "elsewhere"
    place.mkdir()
    (place / "real.zip").write_text("mine")
    write_folder(place / "real", "mine.png")
    (tmp_path / "out.zip").symlink_to("elsewhere/real.zip")
    (tmp_path / "out").symlink_to("elsewhere/real")
    for call in (
        lambda **k: write_file(tmp_path / "out.zip", b"new", **k),
        lambda **k: write_folder(tmp_path / "out", "new.png", **k),
    ):
        with pytest.raises(OutputError, match="exists already"):
            call()
        call(force=True)
    assert contents(place) == {"real.zip": b"new", "real": None, "real/new.png": b"new.png"}
    assert os.readlink(tmp_path / "out.zip") == "elsewhere/real.zip"
    assert os.readlink(tmp_path / "out") == "elsewhere/real"
    assert set(os.listdir(tmp_path)) == {"elsewhere", "out.zip", "out"}


def test_through_a_link_to_nowhere_by_force(tmp_path):
    """The file that the link waits for is made; a link that leads to itself is refused."""
    (tmp_path / "out.zip").symlink_to("later.zip")
    write_file(tmp_path / "out.zip", b"new", force=True)
    assert (tmp_path / "later.zip").read_bytes() == b"new"
    assert (tmp_path / "out.zip").is_symlink()
    (tmp_path / "loop.zip").symlink_to("loop.zip")
    with pytest.raises(OutputError, match=r"loop\.zip: is a link that leads nowhere"):
        write_file(tmp_path / "loop.zip", b"new", force=True)
    assert (tmp_path / "loop.zip").is_symlink()


def test_the_input_behind_a_link_is_never_written_to(tmp_path):
    """A target that is a link into the input folder is inside the input."""
    (tmp_path / "layers").mkdir()
    (tmp_path / "out").symlink_to("layers/new")
    with pytest.raises(OutputError, match="out: is inside the input"):
        check_apart(tmp_path / "out", tmp_path / "layers")


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


@pytest.fixture
def no_exchange(monkeypatch):
    """A system that cannot swap two folders in one step."""
    monkeypatch.setattr(files, "_exchanged", lambda one, other: False)


@pytest.mark.parametrize("error", [OSError(5, "Input/output error"), KeyboardInterrupt()], ids=["error", "Ctrl-C"])
@pytest.mark.parametrize("moment", ["before", "after"])
@pytest.mark.parametrize("which", [1, 2])
def test_an_interrupted_replacement_costs_neither_folder(tmp_path, monkeypatch, no_exchange, which, moment, error):
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


def test_a_folder_that_cannot_be_put_back_at_once_is_put_back_by_the_next_run(tmp_path, monkeypatch, no_exchange):
    """The disk fails after the first rename, and at putting back too: the old folder is not cleared away with the
    helper folder that holds it.
    """
    write_folder(tmp_path / "out", "old.png")
    rename, calls = os.replace, []

    def fails_from_the_second_on(source: Path, target: Path) -> None:
        calls.append(source)
        if len(calls) > 1:
            raise OSError(5, "Input/output error")
        rename(source, target)

    monkeypatch.setattr(os, "replace", fails_from_the_second_on)
    with pytest.raises(OutputError, match="input/output error"):
        write_folder(tmp_path / "out", "new.png", force=True)
    assert not (tmp_path / "out").exists()
    monkeypatch.setattr(os, "replace", rename)
    with pytest.raises(OutputError, match="exists already"):
        check_target(tmp_path / "out", force=False)
    assert contents(tmp_path) == {"out": None, "out/old.png": b"old.png"}


def test_nothing_is_left_if_the_old_folder_cannot_be_moved(tmp_path, monkeypatch, no_exchange):
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


# Kills itself, with no chance to clear away, right after the first rename of a folder that replaces another.
KILLED_BETWEEN = """
import os, signal, sys
from pathlib import Path
from layerfix import files

rename = os.replace

def once(source, target):
    rename(source, target)
    os.kill(os.getpid(), signal.SIGKILL)

if sys.argv[2] == "in two steps":
    files._exchanged = lambda one, other: False
os.replace = once
with files.whole_folder(Path(sys.argv[1]), force=True) as folder:
    (folder / "new.png").write_bytes(b"new")
if sys.argv[2] == "in one step":
    os.kill(os.getpid(), signal.SIGKILL)
"""


def killed_while_replacing(folder: Path, how: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", KILLED_BETWEEN, str(folder), how], env=environment(), capture_output=True, check=False
    )
    assert done.returncode == -9, done.stderr


@pytest.mark.parametrize("name", ["out", "o" * 255, "ö" * 127])
def test_a_folder_lost_between_two_renames_is_put_back_by_the_next_run(tmp_path, name):
    """After the kill the target is gone; the next look at it, even one without force, finds it where it was."""
    write_folder(tmp_path / name, "old.png")
    write_folder(tmp_path / f"{name[:5]}.other", "1.png")
    before = contents(tmp_path)
    killed_while_replacing(tmp_path / name, "in two steps")
    assert not (tmp_path / name).exists()
    with pytest.raises(OutputError, match="exists already and is not empty"):
        check_target(tmp_path / name, force=False)
    assert {k: v for k, v in contents(tmp_path).items() if not k.startswith(".")} == before
    assert not list(tmp_path.glob(".*.old"))
    write_folder(tmp_path / name, "newer.png", force=True)
    assert os.listdir(tmp_path / name) == ["newer.png"]


def test_what_another_target_lost_is_left_to_it(tmp_path):
    """`out` and `out.b`: a helper folder of the one is not taken for the other's."""
    write_folder(tmp_path / "out.b", "old.png")
    killed_while_replacing(tmp_path / "out.b", "in two steps")
    check_target(tmp_path / "out", force=False)
    assert not (tmp_path / "out").exists()
    with pytest.raises(OutputError, match="exists already"):
        check_target(tmp_path / "out.b", force=False)


@pytest.mark.skipif(sys.platform != "linux", reason="renameat2 is Linux's")
def test_a_folder_is_replaced_in_one_step_where_the_system_can(tmp_path, monkeypatch):
    """No moment without the target: nothing is renamed but by the exchange, and a kill right after costs nothing."""
    write_folder(tmp_path / "out", "old.png")
    if not files._exchanged(tmp_path / "out", tmp_path / "out"):
        pytest.skip("this file system cannot exchange")
    monkeypatch.setattr(os, "replace", lambda *paths: pytest.fail("renamed"))
    write_folder(tmp_path / "out", "new.png", force=True)
    assert contents(tmp_path) == {"out": None, "out/new.png": b"new.png"}
    monkeypatch.undo()
    killed_while_replacing(tmp_path / "out", "in one step")
    assert contents(tmp_path)["out/new.png"] == b"new"


@pytest.mark.parametrize("letter", ["x", "ö", "☃"])
@pytest.mark.parametrize("size", range(249, 256))
def test_names_as_long_as_the_file_system_takes(tmp_path, letter, size):
    """The temporary beside it is no longer than it: every name that fits can be written, replaced and no more."""
    for suffix in (".zip", ""):
        room = size - len(suffix)
        name = letter * (room // len(letter.encode())) + "x" * (room % len(letter.encode())) + suffix
        assert len(name.encode()) == size
        for force in (False, True):
            (write_file(tmp_path / name, b"1", force=force) if suffix else
             write_folder(tmp_path / name, "1.png", force=force))  # fmt: skip
        assert (tmp_path / name).exists()
    assert len(os.listdir(tmp_path)) == 2


@pytest.mark.parametrize("name", ["x" * 256, "x" * 252 + ".zip", "ö" * 128, "x" * 5000])
def test_longer_names_are_refused_before_any_work(tmp_path, name):
    """With the name's length and what would do, not after the last layer."""
    with pytest.raises(OutputError, match=rf"the name has {len(name.encode())} bytes; file systems take 255"):
        check_target(tmp_path / name, force=True)


def test_what_is_written_is_on_the_disk_before_it_takes_its_place(tmp_path, monkeypatch):
    """A power cut after the rename must not show an empty file: sync first, then rename, then the folder."""
    calls: list[str] = []
    for module, name in ((os, "fsync"), (os, "replace"), (files, "_sync_all"), (files, "_exchanged")):
        real = getattr(module, name)
        monkeypatch.setattr(module, name, lambda *a, _real=real, _name=name: (calls.append(_name), _real(*a))[1])
    write_file(tmp_path / "out.zip", b"1")
    assert calls == ["fsync", "replace", "fsync"]
    calls.clear()
    write_folder(tmp_path / "out", "1.png")
    assert calls == ["_sync_all", "replace", "fsync"]
    calls.clear()
    write_folder(tmp_path / "out", "2.png", force=True)
    assert calls[:2] == ["_sync_all", "_exchanged"]
    assert calls[-1] == "fsync"


def test_every_file_is_synced_where_the_whole_disk_cannot_be(tmp_path, monkeypatch):
    """Without syncfs: one by one, also in folders within."""
    (tmp_path / "in").mkdir()
    for name in ("1.png", "in/2.png"):
        (tmp_path / name).write_bytes(b"x")
    synced: list[str] = []
    monkeypatch.setattr(sys, "platform", "darwin")
    monkeypatch.setattr(os, "fsync", lambda handle: synced.append(os.readlink(f"/proc/self/fd/{handle}")))
    files._sync_all(tmp_path)
    assert sorted(synced) == [str(tmp_path / "1.png"), str(tmp_path / "in/2.png")]


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_an_output_that_another_program_holds_open_says_so(tmp_path, monkeypatch, no_exchange, kind):
    """As on Windows, where the rename is refused: what is in the way, and that nothing is lost."""
    write = write_file if kind == "file" else write_folder
    write(tmp_path / "out", *([b"old"] if kind == "file" else ["old.png"]))
    before = contents(tmp_path)

    def refused(source: Path, target: Path) -> None:
        raise PermissionError(13, "The process cannot access the file because it is being used by another process")

    monkeypatch.setattr(os, "replace", refused)
    with pytest.raises(OutputError, match=r"out: could not be replaced: the process .*holds it open, close it there"):
        write(tmp_path / "out", *([b"new"] if kind == "file" else ["new.png"]), force=True)
    assert contents(tmp_path) == before


@pytest.mark.parametrize("name", ["NUL", "nul.zip", "Con", "AUX.tar.gz", "com1.sl1", "LPT9", "prn .txt", "COM¹.goo",
                                  "conout$", "out.", "out ", "a.b. ", "out.zip ", "..."])  # fmt: skip
def test_names_that_windows_takes_for_something_else(tmp_path, monkeypatch, name):
    """A device's name, a dot or a space at the end: refused there, since the output would go nowhere; elsewhere they
    are names like any other.
    """
    plain = name == "..."
    assert (unfit_for_windows(name) is None) == plain
    check_target(tmp_path / name, force=False)
    monkeypatch.setattr(files, "WINDOWS", True)
    if not plain:
        with pytest.raises(OutputError, match="choose another name"):
            check_target(tmp_path / name, force=False)


@pytest.mark.parametrize("name", ["null.zip", "com.zip", "com10", "COM0", "console", "a.nul", "aux1", ".zip", "x.y"])
def test_names_that_are_only_similar(name):
    """Nothing is refused that Windows takes."""
    assert unfit_for_windows(name) is None


@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to("/dev/null")], ids=["pipe", "device"])
def test_pipes_and_devices_are_neither_read_nor_replaced(tmp_path, make):
    """At once: opening a pipe would wait, reading a device might never end, replacing one would take it away."""
    path = tmp_path / "odd.zip"
    make(path)
    with pytest.raises(InputError, match=r"odd\.zip: is a (pipe|device); only regular files and folders are read"):
        check_input(path)
    with pytest.raises(InputError, match=r"odd\.zip: is a (pipe|device)"), files.reading(path):
        pytest.fail("the block must not run")
    with pytest.raises(OutputError, match=r"odd\.zip: is a (pipe|device); only files and folders are replaced"):
        check_target(path, force=True)
    assert stat.S_ISFIFO(path.stat().st_mode) or stat.S_ISCHR(path.stat().st_mode)


def test_inputs_that_are_not_there(tmp_path):
    """A missing one, one behind a file, one with too long a name, a folder where a file is wanted."""
    (tmp_path / "file").write_bytes(b"")
    for name in ("none.stl", "file/none.stl"):
        with pytest.raises(InputError, match=r"none\.stl: no such file or folder"):
            check_input(tmp_path / name)
    with pytest.raises(InputError, match="cannot be read: file name too long"):
        check_input(tmp_path / ("x" * 300))
    with pytest.raises(InputError, match="is a folder, not a file"):
        check_input(tmp_path, folders=False)
    check_input(tmp_path)
    check_input(tmp_path / "file", folders=False)


def test_a_further_output_that_fails_names_what_is_there(tmp_path):
    """The first output is whole, the second is not: both are said."""
    write_file(tmp_path / "out.zip", b"whole")
    full = OSError(28, "No space left on device")
    with (
        pytest.raises(OutputError, match=r"look\.png: .*no space left on device; .*; \S*out\.zip is there and whole"),
        already_written(tmp_path / "out.zip"),
    ):
        write_file(tmp_path / "look.png", b"", error=full)
    with pytest.raises(OutputError, match=r"nothing was left behind$"), already_written(tmp_path / "none"):
        write_file(tmp_path / "look.png", b"", error=full)


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
