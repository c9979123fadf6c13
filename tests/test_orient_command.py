"""``layerfix orient`` and ``fix --orient`` as processes: outputs, figures, interruption, bad input."""

from __future__ import annotations

import json
import signal
import time
from pathlib import Path

import click
import numpy as np
import pytest
from PIL import Image

import layerfix as lf
from layerfix.cli.orient import searching
from layerfix.orientation.search import State
from layerfix.samples import sample
from tests.making import box, contents, joined, run_layerfix, start_layerfix, turned, write_stl

HOW = ("--pixel", "0.25mm", "--layer", "0.25mm", "--min-feature", "0.75mm")


@pytest.fixture
def part(tmp_path) -> Path:
    """Three thin plates that lean."""
    fins = [box([-2 + 0.8 * k, -2, 0], [-1.7 + 0.8 * k, 2, 4]) for k in range(3)]
    return write_stl(tmp_path / "part.stl", turned(joined(*fins), "x", 25))


def test_everything_is_written_and_agrees(tmp_path, part):
    """The part in three formats on the plate, the transform, the map, the front; fix of the part says the same."""
    outputs = ("best.stl", "best.3mf", "best.obj", "all.json", "map.png", "map.svg")
    fronts = ("front.csv", "front.json", "front.svg")
    targets = [word for name in outputs for word in ("-o", name)] + [w for f in fronts for w in ("--pareto", f)]
    done = run_layerfix("orient", "part.stl", *HOW, "--method", "quick", "--json", *targets, cwd=tmp_path)
    assert done.code == 0, done.err
    summary = json.loads(done.out)
    assert json.loads((tmp_path / "all.json").read_text()) == summary
    assert summary["reduction_percent"] > 80
    matrix = np.array(summary["matrix"])
    original = lf.load_mesh(part)
    expected = (np.column_stack([original.vertices, np.ones(len(original.vertices))]) @ matrix.T)[:, :3]
    for name in outputs[:3]:
        mesh = lf.load_mesh(tmp_path / name)
        assert abs(mesh.bounds_mm[0, 2]) < 1e-6
        assert np.allclose(mesh.bounds_mm, [expected.min(axis=0), expected.max(axis=0)], atol=1e-5)
        assert mesh.volume_mm3 == pytest.approx(original.volume_mm3, rel=1e-5)
    fixed = run_layerfix("fix", "best.obj", "out.zip", *HOW, "--z-sampling", "middle", "--json", cwd=tmp_path)
    volumes = json.loads(fixed.out)
    for key in ("added_mm3", "removed_mm3"):
        assert volumes[key] == pytest.approx(summary["best"][key], abs=0.1)
    assert np.asarray(Image.open(tmp_path / "map.png")).std() > 20
    assert (tmp_path / "map.svg").read_text().startswith("<svg")
    rows = (tmp_path / "front.csv").read_text().splitlines()
    assert rows[0].startswith("theta1_rad,theta2_rad,x,y,z,changed_px,")
    poses = json.loads((tmp_path / "front.json").read_text())["poses"]
    assert len(rows) == len(poses) + 1
    assert min(pose["changed_px"] for pose in poses) <= summary["best"]["changed_px"]


def test_the_words_say_what_it_won(tmp_path, part):
    """Before, after, how to get there, what else was good."""
    done = run_layerfix("orient", part, *HOW, "--method", "anneal", "--evaluations", "30")
    assert done.code == 0, done.err
    names = [line[:10].strip() for line in done.out.splitlines()]
    assert {"as given", "best", "turned by", "up is", "others", "searched"} <= set(names)
    assert "% less" in done.out
    assert contents(tmp_path).keys() == {"part.stl"}


def test_fix_turns_the_part_first(tmp_path, part):
    """In one go: what is corrected is less, and a note says how the part was turned."""
    plain = json.loads(run_layerfix("fix", part, tmp_path / "a.zip", *HOW, "--json").out)
    done = run_layerfix("fix", part, tmp_path / "b.zip", *HOW, "--orient", "quick", "--json")
    assert done.code == 0, done.err
    better = json.loads(done.out)
    assert better["added_mm3"] + better["removed_mm3"] < 0.3 * (plain["added_mm3"] + plain["removed_mm3"])
    assert any(note.startswith("turned by θ = [") and "% less" in note for note in better["notes"])


def test_what_is_kept_free_turns_with_the_part(tmp_path):
    """Two thin plates in a corner, one of which is upright in any pose: with what is outside kept free, no
    material goes there."""
    plates = box([-2, -2, 0], [-1.7, 2, 4]), box([-2, -2, 0], [2, -1.7, 4])
    outside = box([-5, -5, -1], [-2, 5, 6]), box([-2, -5, -1], [5, -2, 6])
    part = write_stl(tmp_path / "part.stl", turned(joined(*plates), "x", 25))
    bore = write_stl(tmp_path / "bore.stl", turned(joined(*outside), "x", 25))
    how = (*HOW, "--orient", "quick", "--surface", "voxels")
    for name, more in (("free.stl", ()), ("kept.stl", ("--keep-out", bore))):
        run = run_layerfix("fix", part, tmp_path / name, *how, *more)
        assert run.code == 0, run.err
    assert run_layerfix("orient", part, *HOW, "--method", "quick", "-o", tmp_path / "best.json").code == 0
    matrix = np.linalg.inv(json.loads((tmp_path / "best.json").read_text())["matrix"])
    beyond = []
    for name in ("free.stl", "kept.stl"):
        back = lf.load_mesh(tmp_path / name).transformed(matrix[:3, :3]).moved(matrix[:3, 3])
        beyond.append(float(-2 - turned(back, "x", -25).vertices[:, :2].min()))
    assert beyond[0] > 0.2  # half of what is missing, less a pixel
    assert beyond[1] < 0.13  # half a pixel
    layers = run_layerfix(
        "fix", part, tmp_path / "c.zip", *HOW, "--orient", "quick", "--keep-out", tmp_path / "b.zip"
    )
    assert layers.code == 2


def test_ctrl_c_writes_the_best_so_far_and_resume_goes_on(tmp_path):
    """Exit code 130, outputs there and whole; resumed, the end is that of a run without a break."""
    write_stl(tmp_path / "part.stl", sample("molecule").mesh())
    how = ("--pixel", "0.3mm", "--layer", "0.3mm", "--min-feature", "0.9mm", "--log", "log.jsonl")
    run = ("orient", "part.stl", *how, "--method", "quick", "-o", "best.stl", "-o", "best.json")
    process = start_layerfix(*run, cwd=tmp_path)
    deadline = time.monotonic() + 100
    while time.monotonic() < deadline and len(_lines(tmp_path / "log.jsonl")) < 60:
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in err
    assert "broken off: this is the best so far" in out
    early = json.loads((tmp_path / "best.json").read_text())
    assert early["interrupted"]
    assert early["best"]["changed_px"] <= early["initial"]["changed_px"]
    assert lf.load_mesh(tmp_path / "best.stl").bounds_mm[0, 2] == 0
    before = _lines(tmp_path / "log.jsonl")
    done = run_layerfix(*run, "--resume", "--force", cwd=tmp_path)
    assert done.code == 0, done.err
    after = _lines(tmp_path / "log.jsonl")
    assert after[: len(before)] == before
    late = json.loads((tmp_path / "best.json").read_text())
    assert not late["interrupted"]
    assert late["evaluations"] > early["evaluations"]


def _lines(path: Path) -> list[str]:
    return path.read_text().splitlines() if path.exists() else []


BAD = {
    "no numbers": (("part.stl",), "a mesh needs --printer, or --pixel and --layer"),
    "layers": (("layers/0.png", *HOW), "layers/0.png: holds layers, which are sliced already"),
    "suffix": (
        ("part.stl", *HOW, "-o", "best.zip"),
        "best.zip: a build direction is written as .stl .3mf .obj .json",
    ),
    "front": (("part.stl", *HOW, "--pareto", "front.stl"), "front.stl: a front is written as .csv .json .png .svg"),
    "twice": (("part.stl", *HOW, "-o", "a.stl", "-o", "a.stl"), "a.stl: is named twice"),
    "input": (("part.stl", *HOW, "-o", "part.stl", "--force"), "part.stl: is the input"),
    "exists": (("part.stl", *HOW, "-o", "old.stl"), "old.stl: exists already; use --force"),
    "zero": (("part.stl", *HOW, "--weights", "added=0,removed=0"), "all weights are 0"),
    "negative": (("part.stl", *HOW, "--weights", "support=-2"), "weight support=-2: it must be 0 or more"),
    "words": (("part.stl", *HOW, "--weights", "support"), "'support' is not a weight: write added=1,support=0.2"),
    "fit to what": (("part.stl", *HOW, "--fit"), "--fit: to what? give --printer"),
    "fits nowhere": (("huge.stl", "-p", "prusa-sl1s", "--fit"), "mm in no direction"),
    "no log": (("part.stl", *HOW, "--resume"), "--resume: goes on from a log; give --log, too"),
    "two": (("part.stl", *HOW, "--scheduler", "tcp://a:1", "--processes", "2"), "--scheduler and --processes"),
    "address": (("part.stl", *HOW, "--scheduler", "nonsense"), "scheduler tcp://nonsense: does not answer"),
    "nobody": (("part.stl", *HOW, "--scheduler", "127.0.0.1:9"), "start one with `dask scheduler`"),
    "flat": (("flat.stl", *HOW), "flat.stl: the part is flat"),
}


def test_bad_input_is_one_line_and_nothing_is_written(tmp_path, part):
    """Exit code 2, what is wrong and what would be accepted; quickly, also where nobody answers."""
    from layerfix.cli import layerfix

    (tmp_path / "layers").mkdir()
    Image.fromarray(np.full((20, 20), 255, np.uint8)).save(tmp_path / "layers" / "0.png")
    (tmp_path / "old.stl").write_bytes(b"old")
    write_stl(tmp_path / "huge.stl", box([0, 0, 0], [300, 300, 300]))
    flat = lf.Mesh(np.array([[0, 0, 0], [9, 0, 0], [0, 9, 0], [9, 9, 0.0]]), np.array([[0, 1, 2], [1, 3, 2]]))
    write_stl(tmp_path / "flat.stl", flat)
    before = contents(tmp_path)
    from click.testing import CliRunner

    started = time.monotonic()
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        for name, (arguments, message) in BAD.items():
            done = CliRunner().invoke(layerfix, ["orient", *arguments])
            said = done.output if isinstance(done.exception, SystemExit) else str(done.exception)
            assert done.exit_code != 0, name
            assert isinstance(done.exception, (lf.LayerfixError, SystemExit)), (name, done.exception)
            assert message in said, name
    assert time.monotonic() - started < 60
    assert contents(tmp_path) == before
    done = run_layerfix("orient", "part.stl", *HOW, "--weights", "beauty=1", cwd=tmp_path)
    assert (done.code, len(done.err.splitlines())) == (2, 1)
    assert "weight of 'beauty': there is no such aim" in done.err


def test_many_files_go_into_one_folder(tmp_path, part):
    """Each under its own name, as by itself; one that cannot be read is told of and stops nobody."""
    write_stl(tmp_path / "other.stl", box([0, 0, 0], [3, 3, 0.8]))
    (tmp_path / "bad.stl").write_bytes(b"not a mesh, just words that go on for a while" * 20)
    single = run_layerfix("fix", "part.stl", "single.zip", *HOW, cwd=tmp_path)
    assert single.code == 0, single.err
    done = run_layerfix("fix", "part.stl", "bad.stl", "other.stl", "--out-dir", "out", "--out-type", "zip", "--json",
                        *HOW, cwd=tmp_path)  # fmt: skip
    assert done.code == 2
    assert "bad.stl" in done.err
    found = json.loads(done.out)
    assert [one["target"] for one in found["done"]] == ["out/part.zip", "out/other.zip"]
    assert [one["source"] for one in found["failed"]] == ["bad.stl"]
    assert contents(tmp_path / "out").keys() == {"part.zip", "other.zip"}
    assert (tmp_path / "out" / "part.zip").read_bytes() == (tmp_path / "single.zip").read_bytes()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("part.stl", "sub/part.obj", "--out-dir", "out"), "both would become out/part.zip; rename one"),
        (("part.stl", "--out-dir", "part.stl"), "part.stl: is a file; the results go to a folder"),
        (("part.stl", "--out-dir", "out", "--picture", "a.png"), "--picture: is of one part"),
        (("part.stl", "none.stl", "--out-dir", "out"), "none.stl: no such file"),
        (("part.stl", "--out-dir", "out", "--scheduler", "127.0.0.1:9"), "start one with `dask scheduler`"),
    ],
)
def test_what_a_batch_refuses(tmp_path, part, arguments, message, monkeypatch):
    """Before any work; the folder is not made."""
    from layerfix.commands.batch import fix_all
    from layerfix.commands.options import options_of

    (tmp_path / "sub").mkdir()
    lf.write(tmp_path / "sub" / "part.obj", lf.load_mesh(part))
    monkeypatch.chdir(tmp_path)
    words = list(arguments)
    at = words.index("--out-dir")
    given = {"pixel_mm": (0.25, 0.25), "layer_mm": 0.25, "min_feature_mm": 0.75}
    more = dict(zip(words[at + 2 :: 2], words[at + 3 :: 2], strict=True))
    if "--picture" in more:
        given["picture"] = Path(more["--picture"])
    with pytest.raises(lf.LayerfixError, match=message):
        fix_all([Path(word) for word in words[:at]], Path(words[at + 1]), options_of(None, given),
                scheduler=more.get("--scheduler"))  # fmt: skip
    assert not Path("out").exists()


def test_many_files_need_a_folder(part):
    """And its options need it, too."""
    done = run_layerfix("fix", part, part, "out.zip", *HOW)
    assert done.code == 2
    assert "Several inputs go with --out-dir DIR" in done.err


def test_a_signal_whose_exception_went_nowhere_ends_the_search():
    """It is raised once more, and then no more: what was found so far is written."""
    state = State(1, 2, 3.0, "turning")
    with click.Context(click.Command("orient"), obj=[]) as context, searching("part.stl") as shown:
        shown(state)
        context.obj.append(2)
        with pytest.raises(KeyboardInterrupt):
            shown(state)
        shown(state)
