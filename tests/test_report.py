"""The report: what it holds, and what a real browser makes of it."""

from __future__ import annotations

import base64
import hashlib
import io
import json
import re
import shutil
import subprocess
import zlib
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from PIL import Image

import layerfix as lf
from layerfix.bits import pack
from layerfix.errors import InputError
from layerfix.layers.verdict import judge
from layerfix.report import collect as collecting
from layerfix.report import places as listing
from layerfix.report.bodies import body
from layerfix.report.collect import About, collect
from layerfix.report.page import page_of, show
from layerfix.report.spans import Window, cut, spans_of, varints, window_of
from tests.making import box, chosen_faces, joined, run_layerfix, thin_part, write_stl

VIEWER = Path(lf.__file__).parent / "report" / "viewer"
IMAGES = arrays.arrays(np.bool_, st.tuples(st.integers(1, 7), st.integers(1, 140)))


def numbers(data: bytes) -> Iterator[int]:
    """LEB128, read the plain way."""
    value = shift = 0
    for byte in data:
        value |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            yield value
            value = shift = 0


def decoded(report: Any, name: str) -> list[np.ndarray]:
    """The layers of a report as images, as docs/report.md says."""
    frame, images = report.meta["frame"], report.meta["images"]
    offsets, found = images[name]["offsets"], []
    for low, high in pairwise(offsets):
        stream = numbers(zlib.decompress(report.blobs[name][low:high], -15))
        for runs in stream:
            line = np.zeros(frame["width"] * frame["height"], bool)
            place = 0
            for k in range(runs):
                length = next(stream)
                line[place : place + length] = k % 2
                place += length
            found.append(line.reshape(frame["height"], frame["width"]))
    return found


@settings(max_examples=60, deadline=None)
@given(IMAGES)
def test_runs_are_those_of_the_pixels(image):
    """Of packed rows, without unpacking them."""
    again = np.zeros_like(image)
    spans = spans_of(pack(image))
    for y, first, past in spans:
        assert not again[y, first:past].any()
        again[y, first:past] = True
    assert np.array_equal(again, image)
    assert len(spans) == (np.diff(np.pad(image, ((0, 0), (1, 1))).astype(int), axis=1) == 1).sum()


@settings(max_examples=60, deadline=None)
@given(IMAGES, st.integers(1, 4), st.integers(0, 3))
def test_a_reduced_layer_is_solid_where_any_of_its_pixels_is(image, step, air):
    """And a layer that is not reduced is itself."""
    spans = spans_of(pack(image))
    found = window_of([spans], air, 10**9)
    window = Window(found.left, found.top, found.width, found.height, step)
    rows, columns = window.shape
    line = np.zeros(rows * columns, bool)
    for first, past in cut(spans, window):
        line[first:past] = True
    wanted = np.zeros((rows, columns), bool)
    for y, x in np.argwhere(image):
        wanted[(y - window.top) // step, (x - window.left) // step] = True
    assert np.array_equal(line.reshape(rows, columns), wanted)


@given(st.lists(st.integers(0, 2**35 - 1)))
def test_numbers_of_any_size(values):
    assert list(numbers(varints(np.array(values, np.int64)))) == values


def test_a_large_layer_is_reduced_to_what_a_screen_shows():
    window = window_of([np.array([[0, 0, 9000], [5000, 0, 9000]], np.int32)], 0, 4_000_000)
    assert window.step == 4
    assert np.prod(window.shape) <= 4_000_000


def test_a_body_comes_back_within_a_step():
    """Decoded as docs/report.md says."""
    mesh = thin_part()
    data, known = body(mesh.vertices, mesh.faces.astype(np.int64))
    raw = np.frombuffer(zlib.decompress(data, -15), np.uint8)
    n, corners = known["vertices"], 3 * known["faces"]
    moves = [
        raw[2 * n * a : 2 * n * (a + 1)].reshape(2, n).T.copy().view("<u2").ravel().astype(int) for a in range(3)
    ]
    places = np.stack([np.cumsum((m >> 1) ^ -(m & 1)) for m in moves], axis=1)
    vertices = places * known["step_mm"] + known["low_mm"]
    below = raw[6 * n :].reshape(4, corners).T.copy().view("<u4").ravel()
    index, newest = [], 0
    for code in below.tolist():
        index.append(newest - code)
        newest += code == 0
    found = vertices[np.array(index).reshape(-1, 3)]
    assert np.abs(found - mesh.vertices[mesh.faces]).max() <= max(known["step_mm"])


@pytest.fixture(scope="module")
def stacks() -> tuple[lf.LayerStack, lf.LayerStack]:
    stack = lf.slice_mesh(thin_part(), pixel_mm=0.05, layer_mm=0.2, margin_mm=0.8)
    return stack, lf.correct(stack, min_feature_mm=0.8)


def test_the_page_holds_every_pixel(stacks):
    """Before, and what changed; and the charts are the volumes of it."""
    before, after = stacks
    report = collect(before, after, About("part", feature_mm=0.8))
    frame = report.meta["frame"]
    x, y = frame["left_px"], frame["top_px"]
    was, changed = decoded(report, "before"), decoded(report, "changed")
    assert len(was) == len(changed) == len(before)
    for k, (one, other) in enumerate(zip(before, after, strict=True)):
        canvas = np.pad(one.image(), 50), np.pad(one.image() ^ other.image(), 50)
        view = np.s_[y + 50 : y + 50 + frame["height"], x + 50 : x + 50 + frame["width"]]
        assert np.array_equal(was[k], canvas[0][view])
        assert np.array_equal(changed[k], canvas[1][view])
        added = (other.image() & ~one.image()).sum() * 0.05**2 * 0.2
        assert report.meta["charts"]["added_mm3"][k] == pytest.approx(added, rel=1e-3)
    corner = frame["corner_mm"]
    assert corner == pytest.approx([before.origin_mm[0] + x * 0.05, before.origin_mm[1] - y * 0.05])


def test_what_is_too_much_is_sampled_and_said(stacks, monkeypatch):
    """Layers, and pixels."""
    monkeypatch.setattr(collecting, "MOST_LAYERS", 4)
    monkeypatch.setattr(collecting, "MOST_PX", 2000)
    before, after = stacks
    report = collect(before, after, About("part"))
    assert report.meta["layers"]["shown"] == list(range(0, len(before), 3))
    assert len(report.meta["charts"]["added_mm3"]) == len(before)
    notes = " ".join(report.meta["notes"])
    assert "every third is in this page" in notes
    assert "pixels to one" in notes
    monkeypatch.setattr(collecting, "MOST_SPANS", 500)
    assert len(collect(before, after, About("part")).meta["layers"]["shown"]) < 4


def test_places_that_are_too_many_are_counted(monkeypatch):
    """Each kind has its share of the table."""
    images = np.zeros((4, 40, 60), bool)
    images[:, 5:35, 5:55:12] = True
    stack = lf.LayerStack.from_images(images, pixel_mm=0.1, layer_mm=0.1)
    verdicts = tuple(judge(stack, min_feature_mm=0.8))
    monkeypatch.setattr(listing, "MOST_OF_A_KIND", 2)
    meta = collect(stack, stack, About("part", feature_mm=0.8, verdicts=verdicts)).meta
    kinds = [place["kind"] for place in meta["places"]]
    assert kinds.count("lost") == 2
    assert meta["more_places"] == {"lost": 3}  # of 5 walls in 4 layers each


def test_what_goes_on_from_layer_to_layer_is_one_row():
    """Two walls, one of which is interrupted for a layer and leans: three rows, each with where it is worst."""
    images = np.zeros((9, 40, 60), bool)
    images[:, 5:35, 10:12] = True  # upright
    for k in (0, 1, 2, 3, 5, 6, 7, 8):  # leans by two pixels a layer
        images[k, 5:35, 30 + 2 * k : 33 + 2 * k] = True
    images[2, 5:38, 10:12] = True  # longest here
    stack = lf.LayerStack.from_images(images, pixel_mm=0.1, layer_mm=0.1)
    verdicts = tuple(judge(stack, min_feature_mm=0.8))
    meta = collect(stack, lf.correct(stack, min_feature_mm=0.8), About("walls", verdicts=verdicts)).meta
    lost = [place for place in meta["places"] if place["kind"] == "lost"]
    assert sorted(tuple(place["layers"]) for place in lost) == [(0, 3), (0, 8), (5, 8)]
    assert next(place for place in lost if place["layers"] == [0, 8])["layer"] == 2


def test_layers_of_another_file_are_compared():
    """What merged between two files is found, though nothing says how; and what was not looked for is said."""
    apart = np.zeros((2, 12, 30), bool)
    apart[:, 3:9, 3:12] = apart[:, 3:9, 14:25] = True
    together = apart.copy()
    together[1, 5:7] |= np.arange(30) % 29 > 4
    before, after = (lf.LayerStack.from_images(one, pixel_mm=0.1, layer_mm=0.1) for one in (apart, together))
    meta = collect(before, after, About("two")).meta
    assert [(place["kind"], place["layer"]) for place in meta["places"]] == [("merged", 1)]
    same = collect(before, before, About("two")).meta
    assert same["places"] == []
    assert "was not looked for" in same["looked_for"]


def test_nothing_solid_is_refused():
    empty = lf.LayerStack.from_images(np.zeros((2, 5, 5), bool), pixel_mm=0.1, layer_mm=0.1)
    with pytest.raises(InputError, match="void: nothing is solid in any of 2 layers"):
        collect(empty, empty, About("void"))


def test_no_text_of_a_file_is_markup(stacks):
    """Names and notes are in the page as JSON, without a sign that could end it."""
    evil = "</script><script>alert(1)</script><!-- & ü"
    page = page_of(collect(*stacks, About(evil, notes=(evil,), inputs=({"name": evil},))))
    assert "<script>alert" not in page
    assert page.isascii()
    meta = json.loads(re.search(r'id="meta">(.*?)</script>', page, re.S)[1])
    assert meta["title"] == meta["notes"][-1] == meta["inputs"][0]["name"] == evil


def test_a_notebook_shows_the_page_in_a_frame(stacks, tmp_path):
    """And saves it."""
    shown = show(*stacks, title="part")
    assert shown._repr_html_().startswith('<iframe srcdoc="&lt;!doctype html&gt;')
    shown.save(tmp_path / "part.html")
    assert (tmp_path / "part.html").read_text() == page_of(shown.report)
    with pytest.raises(InputError, match="are not the same layers"):
        show(stacks[0], stacks[0][1:])


@pytest.mark.skipif(shutil.which("npm") is None, reason="npm is not here")
def test_the_viewer_is_built_from_its_sources(tmp_path):
    """To the same bytes; what is in it is licensed in the file beside it."""
    for path in (*VIEWER.glob("*.mjs"), *VIEWER.glob("package*.json")):
        shutil.copy(path, tmp_path)
    shutil.copytree(VIEWER / "src", tmp_path / "src")
    installed = subprocess.run(
        ["npm", "ci", "--no-audit", "--no-fund"], cwd=tmp_path, capture_output=True, check=False
    )
    if installed.returncode:
        pytest.skip("npm finds no packages here")
    subprocess.run(["node", "build.mjs"], cwd=tmp_path, check=True)
    for name in ("viewer.js", "THIRD_PARTY_LICENSES.txt"):
        assert (tmp_path / name).read_bytes() == (VIEWER / name).read_bytes()
    assert "three 0." in (VIEWER / "THIRD_PARTY_LICENSES.txt").read_text()


def letter_f() -> lf.Mesh:
    """An F as seen from above, thin strokes, on a plate."""
    return joined(box((0, 0, 0), (8, 12, 1)), box((2, 1, 0.9), (2.4, 11, 3)), box((2.2, 10.6, 0.9), (7, 11, 3)),
                  box((2.2, 6, 0.9), (5, 6.4, 3)))  # fmt: skip


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("report")
    part = write_stl(folder / "a <b> & 'ü' \".stl", letter_f())
    run = run_layerfix("report", part, "-p", "prusa-mk3s-0.4", "-o", folder / "f.html", "--json")
    assert (run.code, run.err) == (0, "")
    done = json.loads(run.out)
    assert done["bytes"] == (folder / "f.html").stat().st_size < 2_000_000
    text = (folder / "f.html").read_text()
    meta = json.loads(re.search(r'id="meta">(.*?)</script>', text, re.S)[1])
    assert meta["inputs"][0] == {"name": part.name, "bytes": part.stat().st_size,
                                 "sha256": hashlib.sha256(part.read_bytes()).hexdigest()}  # fmt: skip
    assert dict(meta["summary"])["after correction"] == "0"
    assert base64.b64decode(re.search(r'id="before">(.*?)</script>', text)[1])
    return folder / "f.html", meta


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    chromium = shutil.which("chromium")
    if chromium is None:
        pytest.skip("chromium is not installed")
    with playwright.sync_playwright() as running:
        made = running.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--enable-unsafe-swiftshader"])
        yield made
        made.close()


def opened(browser: Any, path: Path, link: str = "", **how: Any) -> tuple[Any, list[str]]:
    """The page, ready; and what its console complained of."""
    found = browser.new_page(viewport={"width": 1000, "height": 800}, **how)
    said: list[str] = []
    found.on(
        "console", lambda m: said.append(m.text) if m.type in ("error", "warning") and "stall" not in m.text else 0
    )
    found.on("pageerror", lambda problem: said.append(str(problem)))
    found.goto(path.as_uri() + link)
    found.wait_for_function("window.layerfix && layerfix.ready")
    return found, said


def picture(found: Any, name: str) -> np.ndarray:
    found.wait_for_timeout(150)
    return np.asarray(Image.open(io.BytesIO(found.locator(f"#{name}").screenshot())).convert("RGB")).astype(int)


def orange(image: np.ndarray) -> np.ndarray:
    return (image[..., 0] > image[..., 1] + 70) & (image[..., 0] > image[..., 2] + 70)


def test_the_page_in_a_browser(browser, page):
    """Layers, keys, the number, modes, charts, the table, links, both themes; nothing is asked of the network."""
    path, meta = page
    asked: list[str] = []
    found, said = opened(browser, path, "#layer=8")
    found.on("request", lambda request: asked.append(request.url))
    state = lambda: found.evaluate("[layerfix.layer, layerfix.mode]")  # noqa: E731
    at = lambda k: found.wait_for_function(f"layerfix.layer === {k}")  # noqa: E731
    assert state() == [8, "difference"]
    high = picture(found, "layer")
    assert orange(high).sum() > 50
    counts = found.evaluate("layerfix.counts")
    area = counts["added"] * 0.05**2 * (meta["layers"]["z_mm"][8][1] - meta["layers"]["z_mm"][8][0])
    assert area == pytest.approx(meta["charts"]["added_mm3"][8], rel=1e-3)
    # An F in both views: its arms point to the right of its stem, and the longer one is at the back (the top).
    found.locator("[data-view=top]").click()
    for name in ("layer", "view"):
        y, x = np.nonzero(orange(picture(found, name)))
        assert x.mean() > np.median(x) + 3, name
        assert (y < (y.min() + y.max()) / 2).mean() > 0.55, name
    found.locator("#slider").evaluate("s => { s.value = 2; s.dispatchEvent(new Event('input')); }")
    at(2)
    assert np.abs(picture(found, "layer") - high).max() > 60
    assert found.evaluate("location.hash") == "#layer=2"
    for key, layer in (("ArrowUp", 3), ("PageUp", 13), ("ArrowDown", 12), ("Home", 0)):
        found.keyboard.press(key)
        at(layer)
    found.keyboard.press("n")
    changed = next(k for k in range(1, 20) if meta["charts"]["added_mm3"][k] or meta["charts"]["removed_mm3"][k])
    at(changed)
    found.locator("#number").fill("10")
    found.locator("#number").press("Enter")
    at(10)
    found.locator("#layer").focus()
    for key, mode in (("1", "before"), ("2", "after"), ("3", "difference")):
        found.keyboard.press(key)
        assert state() == [10, mode]
    found.keyboard.press("1")
    assert orange(picture(found, "layer")).sum() == 0
    found.keyboard.down("b")
    assert state()[1] == "after"
    found.keyboard.up("b")
    assert state()[1] == "before"
    plain = picture(found, "layer")
    found.keyboard.press("s")
    assert np.abs(picture(found, "layer") - plain).max() > 60
    chart = found.locator("#charts svg").first
    size = chart.bounding_box()
    chart.click(position={"x": size["width"] * 0.5, "y": 40})
    found.wait_for_function(f"Math.abs(layerfix.layer - {meta['layers']['count'] / 2}) <= 1")
    first = meta["places"][0]
    found.locator("#places tbody tr").first.click()
    at(first["layer"])
    assert found.locator("#places tbody tr").first.get_attribute("aria-current") == "true"
    light = picture(found, "layer")
    found.locator("#theme").click()
    assert found.evaluate("document.documentElement.dataset.theme") == "dark"
    assert np.abs(picture(found, "layer") - light).mean() > 20
    assert found.locator("#title").inner_text() == meta["title"]
    found.locator("#section").uncheck()
    whole = picture(found, "view")
    found.locator("[data-view=front]").click()
    assert np.abs(picture(found, "view") - whole).max() > 60
    assert (said, asked) == ([], [])
    found.close()


@pytest.mark.parametrize("size_mm", [(40, 6, 40), (6, 40, 3), (8, 8, 60)])
@pytest.mark.parametrize("screen", [(1000, 800), (360, 1600)])
def test_the_whole_part_is_in_view(browser, tmp_path, size_mm, screen):
    """Long, high and flat, on a desk and on a narrow screen: nothing but background along the edges."""
    part = write_stl(tmp_path / "part.stl", box((0, 0, 0), size_mm))
    path = tmp_path / "part.html"
    how = ("--pixel", "0.2mm", "--layer", "0.5mm", "--min-feature", "0.8mm")
    assert run_layerfix("report", part, "-o", path, *how).code == 0
    found = browser.new_page(viewport={"width": screen[0], "height": screen[1]})
    found.goto(path.as_uri())
    found.wait_for_function("window.layerfix && layerfix.ready")
    found.locator("#slider").evaluate("s => { s.value = s.max; s.dispatchEvent(new Event('input')); }")
    for view in ("corner", "front"):
        found.locator(f"[data-view={view}]").click()
        seen = picture(found, "view")[12:-12, 12:-12]  # without rounded corners and frames
        there = np.abs(seen - seen[0, 0]).max(axis=2) > 12
        assert there.sum() > 500
        assert not np.concatenate([there[0], there[-1], there[:, 0], there[:, -1]]).any(), view
    found.close()


def test_a_printed_page_shows_the_pictures_as_they_are(browser, page):
    """Neither view is stretched, the controls stay on the screen, and every row of the table is on paper."""
    found, said = opened(browser, page[0], "#layer=8")
    found.emulate_media(media="print")
    for name in ("view", "layer"):  # drawn for the screen, and on paper as wide as there is room
        assert found.evaluate(f"getComputedStyle(document.getElementById('{name}')).objectFit") == "contain"
    assert not found.locator("#slider").is_visible()
    assert found.evaluate("getComputedStyle(document.querySelector('.scroll')).maxHeight") == "none"
    assert said == []
    found.close()


def test_without_webgl_the_layers_work(browser, page):
    """With a message in place of the 3D view; and dark, as the system says."""
    context = browser.new_context(color_scheme="dark", viewport={"width": 500, "height": 700})
    context.add_init_script(
        "const get = HTMLCanvasElement.prototype.getContext;"
        "HTMLCanvasElement.prototype.getContext = function (kind, ...more) {"
        " return kind.startsWith('webgl') ? null : get.call(this, kind, ...more); };"
    )
    found = context.new_page()
    found.goto(page[0].as_uri())
    found.wait_for_function("window.layerfix && layerfix.ready")
    assert found.locator("#no-webgl").is_visible()
    assert picture(found, "layer").mean() < 90
    assert found.evaluate("document.documentElement.scrollWidth <= innerWidth")
    context.close()


def test_what_differs_between_two_files(tmp_path):
    """A job and its correction; others are refused by both their names."""
    part = write_stl(tmp_path / "part.stl", thin_part())
    for name, options in (("raw", ["--mode", "add_only"]), ("fixed", [])):
        feature = "0.1mm" if name == "raw" else "0.8mm"
        run = run_layerfix("fix", part, tmp_path / f"{name}.zip", "--pixel", "50um", "--layer", "0.2mm",
                           "--min-feature", feature, *options)  # fmt: skip
        assert run.code == 0, run.err
    frame = ("--pixel", "50um", "--layer", "0.2mm")
    run = run_layerfix("report", "raw.zip", "fixed.zip", "-o", "r.html", *frame, cwd=tmp_path)
    assert run.code == 2  # another margin: other frames
    assert "raw.zip has" in run.err
    assert "fixed.zip has" in run.err
    run = run_layerfix("report", part, part, "-o", tmp_path / "same.html", "--min-feature", "0.8mm", *frame)
    assert run.code == 0, run.err


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["-o", "page.txt"], "page.txt: the report is a page; call it .html"),
        (["-o", "old.html"], "old.html: exists"),
        (["missing.stl", "-o", "new.html"], "missing.stl"),
    ],
)
def test_refusals_of_the_command(tmp_path, args, said):
    write_stl(tmp_path / "part.stl", thin_part())
    (tmp_path / "old.html").write_text("mine")
    run = run_layerfix("report", "part.stl", *args, "-p", "prusa-mk3s-0.4", cwd=tmp_path)
    assert run.code == 2
    assert said in run.err
    assert (tmp_path / "old.html").read_text() == "mine"
    assert not (tmp_path / "new.html").exists()


def test_pages_of_fix_and_check(tmp_path):
    """Beside what they do anyway."""
    part = write_stl(tmp_path / "part.stl", thin_part())
    run = run_layerfix("fix", part, tmp_path / "x.zip", "-p", "prusa-mk3s-0.4", "--report", tmp_path / "fix.html")
    assert (run.code, run.err) == (0, "")
    run = run_layerfix("check", part, "-p", "prusa-mk3s-0.4", "--report", tmp_path / "check.html")
    assert (run.code, run.err) == (1, "")
    pages = [(tmp_path / name).read_text() for name in ("fix.html", "check.html")]
    assert ["would be lost" in page for page in pages] == [False, True]


def test_what_slicing_closed_is_told_of_pictures_and_pages(tmp_path):
    """As `fix` and `check` tell it; and of a page, of empty layers in the middle."""
    whole = box([0, 0, 0], [4, 4, 1])
    part = write_stl(tmp_path / "part.stl", chosen_faces(whole, np.arange(len(whole.faces)) != 0))
    part.write_bytes(part.read_bytes() + b"rest")
    many, one = "gaps closed in 6 layers, the longest 3.5 mm", "gaps closed in 1 layer, the longest 0.4 mm"
    for command, args, said in (("report", ["-o", "page.html"], many), ("show", ["-o", "a.png", "--layer", 0], one)):
        run = run_layerfix(command, part, "-p", "prusa-mk3s-0.4", *args, "--json", cwd=tmp_path)
        rest, gaps = json.loads(run.out)["notes"]
        assert (rest, gaps) == ("4 bytes after the last triangle left out", f"open mesh: {said}")
        run = run_layerfix(command, part, "-p", "prusa-mk3s-0.4", *args, "--force", cwd=tmp_path)
        assert f"note      {gaps}\n" in run.out
    hollow = lf.slice_mesh(joined(whole, box([0, 0, 2], [4, 4, 3])), pixel_mm=0.1, layer_mm=0.2)
    assert "5 layers are empty in the middle" in collect(hollow, hollow, About("part")).meta["notes"][0]


def test_pictures_of_layers(tmp_path):
    """One from all sides, many small."""
    part = write_stl(tmp_path / "part.stl", thin_part())
    for name, args in (("one", ["--layer", "3"]), ("many", ["--strip"])):
        run = run_layerfix("show", part, "-p", "prusa-mk3s-0.4", "-o", tmp_path / f"{name}.png", *args, "--json")
        assert (run.code, run.err) == (0, "")
        assert json.loads(run.out)["layers"][:1] == ([3] if name == "one" else [0])
        image = np.asarray(Image.open(tmp_path / f"{name}.png").convert("RGB")).astype(int)
        assert orange(image).sum() > 100
    run = run_layerfix("show", part, "-p", "prusa-mk3s-0.4", "-o", tmp_path / "x.png", "--layer", "99")
    assert run.code == 2
    assert "layer 99 is not there; it has layers 0 to 12" in run.err
    run = run_layerfix("show", part, "-p", "prusa-mk3s-0.4", "-o", tmp_path / "x.png")
    assert "give either --layer or --strip" in run.err


def test_the_map_of_build_directions(browser, tmp_path):
    """A click names the direction that is there, arrows go on to the next worse one, a row of the ten best chooses;
    `fix --orient --report` has the map, too."""
    part = write_stl(tmp_path / "part.stl", thin_part())
    how = ("--pixel", "0.1mm", "--layer", "0.1mm", "--min-feature", "0.8mm")
    run = run_layerfix("orient", part, *how, "--method", "quick", "-o", tmp_path / "o.html", "--json")
    assert run.code == 0, run.err
    summary = json.loads(run.out)
    meta = json.loads(re.search(r'id="meta">(.*?)</script>', (tmp_path / "o.html").read_text(), re.S)[1])
    found = meta["orientation"]
    assert found["best"]["changed_px"] == summary["best"]["changed_px"] == found["candidates"][0]["value"]
    assert len(found["poses"]) == summary["screened"]
    assert sum(meta["charts"]["changed_px"]) == summary["best"]["changed_px"] > 0
    page, said = opened(browser, tmp_path / "o.html")
    canvas = page.locator("#directions canvas")
    canvas.scroll_into_view_if_needed()

    def chosen() -> dict[str, Any]:
        return page.evaluate("layerfix.directions.chosen")

    assert chosen()["value"] == found["candidates"][0]["value"]
    box = canvas.bounding_box()
    side = min(box["width"], box["height"]) - 56
    for x, y, axis in ((0.0, 0.0, 2), (0.49, 0.0, 0), (0.0, -0.49, 1)):
        page.mouse.click(box["x"] + box["width"] / 2 + x * side, box["y"] + box["height"] / 2 + y * side)
        assert abs(chosen()["direction"][axis]) > 0.95
    assert f"{chosen()['height_mm']:g} mm" in page.locator("#directions dl").inner_text()
    before = chosen()["value"]
    canvas.press("ArrowLeft")
    assert chosen()["value"] <= before
    page.locator("#directions tbody button").nth(1).click()
    assert chosen()["direction"] == found["candidates"][1]["direction"]
    assert said == []
    page.close()
    run = run_layerfix("fix", part, tmp_path / "f.stl", *how, "--orient", "quick", "--report", tmp_path / "f.html")
    assert run.code == 0, run.err
    meta = json.loads(re.search(r'id="meta">(.*?)</script>', (tmp_path / "f.html").read_text(), re.S)[1])
    assert len(meta["orientation"]["candidates"]) == len(found["candidates"])
