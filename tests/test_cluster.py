"""Many machines: a real scheduler and real workers, which are killed by their pids in the middle of the work."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import layerfix as lf
from layerfix.commands.batch import fix_all
from layerfix.commands.fix import fix
from layerfix.commands.options import options_of
from tests.independent_readers import write_sl1
from tests.making import box, contents, environment, joined, thin_part, write_stl

pytest.importorskip("distributed")
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning")
HOW = {"pixel_mm": 0.25, "layer_mm": 0.25, "min_feature_mm": 0.75, "method": "quick"}
PATIENCE_S = 60


class Cluster:
    """A scheduler and its workers, a process each; a worker has one thread."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.workers = folder, []
        # A worker that is gone is given up after 1 s, not 30.
        self.environment = {**environment(), "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "1s"}
        place = folder / "scheduler.json"
        self.scheduler = self._start("dask_scheduler", "--host", "127.0.0.1", "--port", "0",
                                     "--scheduler-file", str(place))  # fmt: skip
        deadline = time.monotonic() + PATIENCE_S
        while not place.exists() or not place.read_text():
            assert self.scheduler.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.05)
        self.address = json.loads(place.read_text())["address"]

    def _start(self, program: str, *arguments: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.{program}", *arguments, "--no-dashboard"]
        return subprocess.Popen(command, env=self.environment, cwd=self.folder, stdin=subprocess.DEVNULL,
                                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)  # fmt: skip

    def add_worker(self) -> None:
        """One more."""
        self.workers.append(self._start("dask_worker", self.address, "--nthreads", "1", "--no-nanny",
                                        "--local-directory", str(self.folder)))  # fmt: skip

    def kill_worker(self) -> None:
        """The oldest, by its pid, without a chance to say goodbye."""
        worker = self.workers.pop(0)
        os.kill(worker.pid, 9)
        worker.wait()

    def end(self) -> None:
        """All of it."""
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def started(tmp_path_factory) -> Iterator[Cluster]:
    """One scheduler for all tests."""
    cluster = Cluster(tmp_path_factory.mktemp("cluster"))
    try:
        yield cluster
    finally:
        cluster.end()


@pytest.fixture
def cluster(started) -> Cluster:
    """It has two workers."""
    while len(started.workers) < 2:
        started.add_worker()
    return started


@pytest.fixture(scope="module")
def local() -> lf.Orientation:
    """What a search finds here."""
    return lf.orient(thin_part(), **HOW)


def found_the_same(one: lf.Orientation, other: lf.Orientation) -> bool:
    """Poses, counts, and how many of them."""
    return (one.best, one.candidates, one.evaluations, one.screened) == (
        other.best,
        other.candidates,
        other.evaluations,
        other.screened,
    )


def test_a_worker_that_is_killed_changes_nothing(cluster, local):
    """The search goes on with the other one, to the same end."""
    killed = []

    def kill(state):
        if state.done > 15 and not killed:
            killed.append(state.done)
            cluster.kill_worker()

    found = lf.orient(thin_part(), executor=cluster.address, progress=kill, **HOW)
    assert killed
    assert found_the_same(found, local)
    assert cluster.address in found.engine


def test_all_workers_are_killed_and_one_comes_back(cluster, local):
    """The part, too, was held by them alone: it is made again."""
    killed = []

    def kill(state):
        if state.done > 15 and not killed:
            killed.append(state.done)
            while cluster.workers:
                cluster.kill_worker()
            cluster.add_worker()

    found = lf.orient(thin_part(), executor=cluster.address, progress=kill, **HOW)
    assert killed
    assert found_the_same(found, local)


def test_a_client_of_ones_own_is_used_and_left_open(cluster):
    """As `executor=`; it is its owner's."""
    from distributed import Client

    how = {**HOW, "method": "anneal", "evaluations": 20}
    with Client(cluster.address, set_as_default=False) as client:
        found = lf.orient(thin_part(), executor=client, **how)
        assert client.submit(sum, [1, 2]).result() == 3
    assert found_the_same(found, lf.orient(thin_part(), **how))


def test_a_batch_survives_its_workers(cluster, tmp_path):
    """Twelve parts, both workers killed after the first result, one new: every output as here, to the byte."""
    sources = []
    for k in range(12):
        part = joined(thin_part(), box([1 + 0.3 * k, 1, 0], [1.15 + 0.3 * k, 3, 1]))
        sources.append(write_stl(tmp_path / f"part{k}.stl", part))
    options = options_of(None, {"pixel_mm": (0.1, 0.1), "layer_mm": 0.1, "min_feature_mm": 0.4})
    killed = []

    def kill(done, total):
        if not killed:
            killed.append(done)
            while cluster.workers:
                cluster.kill_worker()
            cluster.add_worker()

    away = fix_all(sources, tmp_path / "away", options, ".zip", cluster.address, kill)
    here = fix_all(sources, tmp_path / "here", options, ".zip")
    assert killed
    assert away.failed == here.failed == ()
    assert [one.source for one in away.done] == [str(source) for source in sources]
    assert [(one.added_mm3, one.layers) for one in away.done] == [(one.added_mm3, one.layers) for one in here.done]
    assert contents(tmp_path / "away") == contents(tmp_path / "here")
    assert len(contents(tmp_path / "away")) == 12


def test_folders_errors_and_what_stays_free_go_there_and_back(cluster, tmp_path):
    """A folder of images is an output, too; an error names the file as it is here."""
    source = write_stl(tmp_path / "part.stl", thin_part())
    (tmp_path / "bad.stl").write_bytes(b"words, many words, and no triangle at all " * 20)
    bore = write_stl(tmp_path / "bore.stl", box([2.1, 0, 0.5], [3, 4, 3]))
    given = {"pixel_mm": (0.1, 0.1), "layer_mm": 0.1, "min_feature_mm": 0.4, "keep_out": bore}
    options = options_of(None, given)
    away = fix_all([tmp_path / "bad.stl", source], tmp_path / "away", options, "", cluster.address)
    here = fix_all([tmp_path / "bad.stl", source], tmp_path / "here", options, "")
    assert away.failed == here.failed
    assert away.failed[0][1].startswith(f"{tmp_path / 'bad.stl'}: ")
    assert contents(tmp_path / "away") == contents(tmp_path / "here")


@pytest.mark.parametrize("kind", ["mesh", "job", "greys", "keep-out"])
def test_slabs_of_one_file_are_corrected_on_workers_that_die(cluster, tmp_path, kind, monkeypatch):
    """A mesh is sliced there; a job's layers are sent; a worker is killed in the middle: the bytes are those of a run
    here, and so is the summary."""
    from layerfix.commands import slabs

    monkeypatch.setattr(slabs, "MOST_IN_SLAB", 3)
    given = {"min_feature_mm": 0.4}
    if kind in ("mesh", "keep-out"):
        source = write_stl(tmp_path / "part.stl", thin_part())
        given |= {"pixel_mm": (0.05, 0.05), "layer_mm": 0.05}
        target = "fixed.zip"
        if kind == "keep-out":
            given["keep_out"] = write_stl(tmp_path / "bore.stl", box([2.1, 0, 0.5], [3, 4, 3]))
    else:
        random = np.random.default_rng(2)
        layers = [np.zeros((90, 140), np.uint8) for _ in range(24)]
        for k, layer in enumerate(layers):
            layer[20:60, 20:50] = 255
            layer[10:80, 70 + k % 5] = 255
            if kind == "greys":
                layer[20:60, 50] = random.integers(1, 255, 40)
        source = write_sl1(tmp_path / "job.sl1", layers)
        target = "fixed.sl1"
    killed = []

    def kill(done, total):
        if done > 4 and not killed:
            killed.append(done)
            cluster.kill_worker()

    here = fix(source, tmp_path / f"here-{target}", options_of(None, given))
    away = fix(source, tmp_path / f"away-{target}", options_of(None, {**given, "scheduler": cluster.address}), kill)
    assert killed
    assert (tmp_path / f"here-{target}").read_bytes() == (tmp_path / f"away-{target}").read_bytes()
    assert (away.added_mm3, away.thinnest_mm, away.topology, away.conflicts) == (
        here.added_mm3, here.thinnest_mm, here.topology, here.conflicts,
    )  # fmt: skip
    assert away.added_mm3 > 0


def test_what_cannot_be_spread_is_refused(cluster, tmp_path):
    """Before anything is written."""
    source = write_stl(tmp_path / "part.stl", thin_part())
    given = {"pixel_mm": (0.1, 0.1), "layer_mm": 0.1, "min_feature_mm": 0.4, "scheduler": cluster.address}
    with pytest.raises(lf.LayerfixError, match="the smooth surface is of all of them at once"):
        fix(source, tmp_path / "a.stl", options_of(None, given))
    with pytest.raises(lf.LayerfixError, match="does not answer"):
        fix(source, tmp_path / "a.zip", options_of(None, {**given, "scheduler": "tcp://127.0.0.1:1"}))
    assert not list(tmp_path.glob("a.*"))


def test_workers_of_another_version_are_refused(cluster, monkeypatch):
    """Both versions are named."""
    from layerfix.orientation import cluster as module

    monkeypatch.setattr(module, "__version__", "9.9.9")
    with pytest.raises(lf.LayerfixError, match=rf"runs layerfix {lf.__version__}, this is layerfix 9\.9\.9"):
        lf.orient(thin_part(), executor=cluster.address, **HOW)


def test_a_scheduler_without_workers_is_told_of(started, monkeypatch):
    """Within ten seconds."""
    from layerfix.orientation import cluster as module

    monkeypatch.setattr(module, "WAIT_S", 1.0)
    while started.workers:
        started.kill_worker()
    begun = time.monotonic()
    with pytest.raises(lf.LayerfixError, match="has no workers; start some with `dask worker tcp://"):
        lf.orient(thin_part(), executor=started.address, **HOW)
    assert time.monotonic() - begun < 10
