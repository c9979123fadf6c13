"""A watched folder: each job that is put into it is corrected once, whatever happens meanwhile."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from layerfix import LayerStack, load_printer, write
from layerfix.commands import watch as module
from layerfix.commands.fix import fix
from layerfix.commands.options import options_of
from layerfix.commands.watch import JOURNAL, LOCK, LOG, MAKING, Event, Watch
from layerfix.errors import InputError, OutputError
from tests.independent_readers import png_bytes
from tests.making import contents, start_layerfix, thin_part, write_stl

OPTIONS = options_of(None, {"min_feature_mm": 0.4})
FAST = ("--min-feature", "0.4mm", "--interval", "0.05", "--settle", "0.2", "--json")
SIZE = (2560, 1620)


def fin(left: int) -> np.ndarray:
    """(H, W) bool with a wall of 2 px."""
    image = np.zeros(SIZE, bool)
    image[100:400, left % 1500 : left % 1500 + 2] = True
    return image


def job(path: Path, layers: int = 2, left: int = 100) -> Path:
    """A job for a Prusa SL1S with a fin of 2 px, another place in each layer."""
    images = (fin(left + 7 * k) for k in range(layers))
    write(path, LayerStack.from_images(images, pixel_mm=0.05, layer_mm=0.05), load_printer("prusa-sl1s"), force=True)
    return path


def folders(tmp_path: Path) -> tuple[Path, Path]:
    """Where jobs go, and where they come out."""
    into, out = tmp_path / "in", tmp_path / "out"
    into.mkdir()
    out.mkdir()
    return into, out


def corrected(source: Path, tmp_path: Path) -> bytes:
    """What `fix` makes of a job."""
    target = tmp_path / f"expected-{len(list(tmp_path.iterdir()))}{source.suffix}"
    fix(source, target, OPTIONS)
    return target.read_bytes()


def look_once(into: Path, out: Path, options: module.Options = OPTIONS) -> list[Event]:
    """A run to the end of what is there."""
    events: list[Event] = []
    Watch(into, out, options, events.append, settle_s=0.01, interval_s=0.01).run(once=True)
    return events


def until(true: Callable[[], object], process: subprocess.Popen[str]) -> None:
    """Wait for something, as long as the process lives."""
    deadline = time.monotonic() + 120
    while not true():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.01)


def visible(folder: Path) -> set[str]:
    """Names that are not hidden."""
    return {path.name for path in folder.iterdir() if not path.name.startswith(".")}


# a real process -------------------------------------------------------------------------------------------


def test_killed_in_the_middle_it_goes_on_and_every_job_comes_out_once(tmp_path):
    """A job that is copied bit by bit, one that is being corrected when the process is killed by SIGKILL, one that
    comes while nobody watches: each comes out once, as `fix` makes it, and nothing half is ever to be seen.
    """
    into, out = folders(tmp_path)
    first, long = job(tmp_path / "first.sl1s"), job(tmp_path / "long.sl1s", layers=120)
    data = first.read_bytes()
    (into / "first.sl1s").write_bytes(data[: len(data) // 2])
    process = start_layerfix("watch", into, "--out", out, *FAST)
    until((out / LOCK).exists, process)
    for at in range(len(data) // 2, len(data), len(data) // 16 + 1):
        with (into / "first.sl1s").open("ab") as file:
            file.write(data[at : at + len(data) // 16 + 1])
        time.sleep(0.03)
    until((out / "first.sl1s").exists, process)
    assert (out / "first.sl1s").read_bytes() == corrected(first, tmp_path)
    shutil.copy(long, into / "long.sl1s")
    until(lambda: list((out / MAKING).glob(".long.sl1s.*.part")), process)
    process.kill()
    printed = process.communicate()[0].splitlines()
    assert [(e["event"], e["job"]) for e in map(json.loads, printed)] == [("corrected", "first.sl1s")]
    assert visible(out) == {"first.sl1s", LOG}
    assert json.loads((out / JOURNAL).read_text())["jobs"]["long.sl1s"]["state"] == "begun"

    job(into / "other.sl1s", left=300)
    again = start_layerfix("watch", into, "--out", out, *FAST)
    until(lambda: len((out / LOG).read_text(encoding="utf-8").splitlines()) == 3, again)
    again.send_signal(signal.SIGINT)
    printed, error = again.communicate(timeout=60)
    assert (again.returncode, error.strip()) == (130, "layerfix: stopped")
    assert [e["job"] for e in map(json.loads, printed.splitlines())] == ["long.sl1s", "other.sl1s"]
    assert (out / "long.sl1s").read_bytes() == corrected(long, tmp_path)
    assert visible(out) == {"first.sl1s", "long.sl1s", "other.sl1s", LOG}
    log = (out / LOG).read_text(encoding="utf-8").splitlines()
    assert [line.split()[3].strip(":") for line in log] == ["first.sl1s", "long.sl1s", "other.sl1s"]


def test_once_ends_and_says_whether_all_went_well(tmp_path):
    """Exit code 1 with one that is broken, told in a line; the others are done all the same."""
    into, out = folders(tmp_path)
    job(into / "good.sl1s")
    (into / "broken.sl1s").write_bytes(b"PK no zip at all")
    (into / "notes").write_text("not a job")
    (into / "half.sl1s.part").write_bytes(b"PK")
    process = start_layerfix("watch", into, "--out", out, "--min-feature", "0.4mm", "--settle", "0", "--once")
    printed, error = process.communicate(timeout=120)
    assert (process.returncode, error) == (1, "")
    assert {tuple(line.split()[2:4]) for line in printed.splitlines()} == {
        ("failed", "broken.sl1s:"), ("corrected", "good.sl1s:")}  # fmt: skip
    assert visible(out) == {"good.sl1s", LOG}


# step by step ---------------------------------------------------------------------------------------------


def test_what_is_done_is_not_done_again(tmp_path):
    """Neither by another run, nor when the file is touched; a file of that name with something else in it is."""
    into, out = folders(tmp_path)
    source = job(into / "a.sl1s")
    assert [e.event for e in look_once(into, out)] == ["corrected"]
    before = {k: v for k, v in contents(out).items() if k != JOURNAL}
    assert look_once(into, out) == []
    os.utime(source, (1, 1))
    assert look_once(into, out) == []
    assert {k: v for k, v in contents(out).items() if k != JOURNAL} == before
    job(into / "a.sl1s", left=500)
    assert [e.event for e in look_once(into, out)] == ["corrected"]
    assert (out / "a.sl1s").read_bytes() == corrected(source, tmp_path) != before["a.sl1s"]


def test_a_failed_job_is_told_once_and_tried_again_when_it_changes(tmp_path):
    """Then it may go well; and an older output of ours is replaced though a failure came between."""
    into, out = folders(tmp_path)
    source = job(into / "a.sl1s")
    assert [e.event for e in look_once(into, out)] == ["corrected"]
    source.write_bytes(source.read_bytes()[:2000])
    (failure,) = look_once(into, out)
    assert (failure.event, failure.job) == ("failed", "a.sl1s")
    assert "a.sl1s" in failure.why
    assert MAKING not in failure.why
    assert look_once(into, out) == []
    job(into / "a.sl1s", left=500)
    assert [e.event for e in look_once(into, out)] == ["corrected"]


def test_what_failed_for_an_option_is_tried_again_with_another(tmp_path):
    """Images that do not say their pitch, then with it; what is done stays done."""
    into, out = folders(tmp_path)
    with zipfile.ZipFile(into / "a.zip", "w") as archive:
        for k in range(2):
            archive.writestr(f"{k}.png", png_bytes(255 * fin(40)[80:164, :128].astype(np.uint8)))
    (failure,) = look_once(into, out)
    assert (failure.event, "give --printer, or --pixel" in failure.why) == ("failed", True)
    assert look_once(into, out) == []
    images = options_of(None, {"min_feature_mm": 0.4, "pixel_mm": (0.05, 0.05), "layer_mm": 0.1})
    assert [e.event for e in look_once(into, out, images)] == ["corrected"]
    assert look_once(into, out) == []


def test_what_is_no_job_is_skipped_and_told_once(tmp_path):
    """A table and G-code are; a job that is broken or of a kind that cannot be read has failed."""
    into, out = folders(tmp_path)
    (into / "table.csv").write_text("layer,mm\n")
    (into / "part.gcode").write_text("G1 X1 Y1 E1\n")
    (into / "more").mkdir()
    write_stl(into / "more" / "part.stl", thin_part())
    (into / "broken.sl1s").write_bytes(b"PK no zip at all")
    (into / "locked.ctb").write_bytes(b"\x07\x01\xfd\x12" + bytes(100))
    told = {e.job: e.event for e in look_once(into, out)}
    assert told == {"table.csv": "skipped", "part.gcode": "skipped", "more": "skipped", "broken.sl1s": "failed",
                    "locked.ctb": "failed"}  # fmt: skip
    assert look_once(into, out) == []


def test_what_somebody_else_wrote_is_not_replaced(tmp_path):
    """A file of that name that is not ours: the job fails, the file stays; with --force it goes."""
    into, out = folders(tmp_path)
    job(into / "a.sl1s")
    (out / "a.sl1s").write_bytes(b"mine")
    (failure,) = look_once(into, out)
    assert "exists already; use --force" in failure.why
    assert (out / "a.sl1s").read_bytes() == b"mine"
    (out / JOURNAL).unlink()
    look_once(into, out, options_of(None, {"min_feature_mm": 0.4, "force": True}))
    assert (out / "a.sl1s").read_bytes() == corrected(into / "a.sl1s", tmp_path)


def test_folders_of_images_and_meshes_are_jobs_too(tmp_path):
    """A folder comes out as a folder, again when an image is added; folders without images are none."""
    into, out = folders(tmp_path)
    stack = LayerStack.from_images([fin(40)[80:164, :128]], pixel_mm=0.05, layer_mm=0.05)
    write(into / "layers", stack)
    (into / "empty").mkdir()
    write_stl(into / "part.stl", thin_part())
    images = options_of(None, {"min_feature_mm": 0.4, "pixel_mm": (0.05, 0.05), "layer_mm": 0.1})
    assert {e.event for e in look_once(into, out, images)} == {"corrected"}
    assert visible(out) == {"layers", "part.stl", LOG}
    shutil.copy(next((into / "layers").glob("*.png")), into / "layers" / "99999.png")
    assert [e.job for e in look_once(into, out, images)] == ["layers"]
    assert len(list((out / "layers").glob("*.png"))) == 2


@pytest.mark.parametrize("step", ["begun", "finished", "in its place"])
def test_a_run_killed_at_any_step_is_gone_on_with(tmp_path, monkeypatch, step):
    """Stopped dead right after a step was noted: the next run has the same output, and corrects it once more only if
    it was not whole yet.
    """

    class Killed(BaseException):
        pass

    into, out = folders(tmp_path)
    source = job(into / "a.sl1s")
    real_set, real_put = module.Journal.set, module.put_in_place

    def kill_after_set(journal: module.Journal, name: str, noted: module.Job) -> None:
        real_set(journal, name, noted)
        if noted.state == step:
            raise Killed

    def kill_after_put(finished: Path, path: Path) -> None:
        real_put(finished, path)
        if step == "in its place":
            raise Killed

    with monkeypatch.context() as killing:
        killing.setattr(module.Journal, "set", kill_after_set)
        killing.setattr(module, "put_in_place", kill_after_put)
        with pytest.raises(Killed):
            look_once(into, out)
    assert visible(out) == ({"a.sl1s"} if step == "in its place" else set())
    assert [e.event for e in look_once(into, out)] == (["corrected"] if step == "begun" else [])
    assert (out / "a.sl1s").read_bytes() == corrected(source, tmp_path)
    assert not (out / MAKING).exists() or not list((out / MAKING).iterdir())
    assert look_once(into, out) == []


def test_a_job_that_changes_while_it_is_read_is_read_again(tmp_path, monkeypatch):
    """Nothing of the first reading comes out."""
    into, out = folders(tmp_path)
    source = job(into / "a.sl1s")
    job(tmp_path / "new.sl1s", left=700)
    seen: list[bytes] = []

    def slow_fix(path: Path, target: Path, options: module.Options) -> module.Summary:
        summary = fix(path, target, options)
        seen.append(target.read_bytes())
        if len(seen) == 1:
            shutil.copy(tmp_path / "new.sl1s", source)
        return summary

    monkeypatch.setattr(module, "fix", slow_fix)
    assert [e.event for e in look_once(into, out)] == ["changed", "corrected"]
    assert (out / "a.sl1s").read_bytes() == seen[1] != seen[0]


def test_two_watchers_do_not_share_an_output_folder(tmp_path):
    """The second says so and ends."""
    into, out = folders(tmp_path)
    with module.only_one(out / LOCK), pytest.raises(OutputError, match="another `layerfix watch` is at work there"):
        look_once(into, out)


def test_wrong_folders_and_journals_are_named(tmp_path):
    """Missing ones, one for both, and a journal that is none."""
    into, out = folders(tmp_path)
    with pytest.raises(InputError, match="no such folder"):
        look_once(tmp_path / "none", out)
    with pytest.raises(OutputError, match="make it"):
        look_once(into, tmp_path / "none")
    with pytest.raises(OutputError, match="corrected again"):
        look_once(into, into)
    for text in ("{", "[]", '{"schema_version": 9, "jobs": {}}', '{"schema_version": 1, "jobs": {"a": 3}}'):
        (out / JOURNAL).write_text(text)
        with pytest.raises(InputError, match="is no journal"):
            look_once(into, out)


def test_watch_takes_the_options_of_fix():
    """All but those of one file."""
    from layerfix.cli.fix import fix as fix_command
    from layerfix.cli.watch import NOT_HERE
    from layerfix.cli.watch import watch as command

    names = {p.name for p in command.params}
    assert {p.name for p in fix_command.params} - set(NOT_HERE) <= names
    assert not {"picture", "layers"} & names
