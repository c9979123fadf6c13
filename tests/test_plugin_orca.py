"""The OrcaSlicer plugin: its settings and memory by themselves, the whole of it on the stand-in host."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import shapely

from layerfix import LayerfixError, kernel_cache
from tests import orca_host as host
from tests.making import SOURCE
from tests.outlines_drawn import UNIT_MM, rings

ROOT = Path(__file__).parents[1]
PLUGIN = ROOT / "plugin" / "orca"
OPTIONS = {"nozzle_diameter": "0.4,0.4", "outer_wall_line_width": "0.42", "initial_layer_line_width": "0.5"}
PLATE = shapely.box(0, 0, 10, 10).difference(shapely.Point(5, 5).buffer(2))
WALL = shapely.box(12, 0, 12.2, 10)
STRIP = shapely.box(12, 4, 12.2, 6)

pytestmark = pytest.mark.skipif(not PLUGIN.is_dir(), reason="not a checkout")


@pytest.fixture(scope="module")
def plugin():
    """The package, loaded by the stand-in host: (module, the step, the page)."""
    sys.path.insert(0, str(PLUGIN))
    try:
        step, page = host.Host().load("layerfix_orca")
        yield sys.modules["layerfix_orca"], step, page
    finally:
        sys.path.remove(str(PLUGIN))
        for name in [name for name in sys.modules if name.partition(".")[0] in ("layerfix_orca", "orca")]:
            del sys.modules[name]


def part(*regions, layers=3, number=1, name="part"):
    """An object of so many layers of 0.2 mm with these regions."""
    made = [host.Layer(0.2 * (k + 1), 0.2, [rings(shape) for shape in regions]) for k in range(layers)]
    return host.PrintObject(made, name=name, number=number)


def slice_object(step, thing, options=OPTIONS, cancel_after=None):
    """What the host does at posSlice."""
    job = host.Print([thing], options)
    if cancel_after is not None:
        job.cancel_after = cancel_after
    with host.audited():
        return step.execute(host.Context(host.Step.posSlice, job, thing))


def widths(thing, region=0):
    """Of the thin wall of a region in each layer, in mm."""
    clip = shapely.box(11e6, -1e6, 14e6, 11e6)
    bodies = (layer.regions()[region].slices.shape().intersection(clip) for layer in thing.layers())
    return [round((body.bounds[2] - body.bounds[0]) * UNIT_MM, 3) for body in bodies]


def bytes_of(thing):
    """All coordinates of an object's slices."""
    seen = hashlib.sha256()
    for layer in thing.layers():
        for region in layer.regions():
            for surface in region.slices.surfaces:
                for ring in (surface.expolygon.contour, *surface.expolygon.holes):
                    seen.update(ring.as_array().tobytes())
    return seen.hexdigest()


def test_a_thin_wall_is_thickened_to_two_beads_and_more_in_the_first_layer(plugin):
    """0.84 mm, and 1 mm on the plate; each layer is made anew once."""
    _, step, _ = plugin
    thing = part(shapely.union_all([PLATE, WALL]))
    result = slice_object(step, thing)
    assert result.status is host.PluginResult.Success
    assert "3 of 3 layers" in result.message
    assert widths(thing) == pytest.approx([1.0, 0.85, 0.85], abs=0.051)
    assert [layer.made for layer in thing.layers()] == [1, 1, 1]


def test_regions_share_what_is_added_and_do_not_overlap(plugin):
    """A strip of the wall is of another region: both grow, each beside its own."""
    _, step, _ = plugin
    thing = part(shapely.union_all([PLATE, WALL]).difference(STRIP), STRIP)
    slice_object(step, thing)
    for layer in thing.layers():
        first, second = (region.slices.shape() for region in layer.regions())
        assert first.intersection(second).area == 0
        assert np.ptp(second.bounds[0::2]) * UNIT_MM > 0.8
        assert (second.bounds[1] * UNIT_MM, second.bounds[3] * UNIT_MM) == pytest.approx((4, 6), abs=0.05)


def test_where_nothing_is_thin_nothing_is_set(plugin):
    """Not a bit, and no layer is made anew: what the host derived stays valid."""
    _, step, _ = plugin
    thing = part(PLATE)
    before = bytes_of(thing)
    result = slice_object(step, thing)
    assert "nothing is thinner than 0.84 mm" in result.message
    assert bytes_of(thing) == before
    assert [layer.made for layer in thing.layers()] == [0, 0, 0]


def test_a_second_call_changes_nothing(plugin):
    """Of the same object, whose slices are corrected already, and of one like it: no layer is corrected again."""
    module, step, _ = plugin
    first, second = (part(PLATE.union(WALL), number=n) for n in (1, 2))
    slice_object(step, first)
    once, corrected = bytes_of(first), dict(module.MEMORY._kept)
    slice_object(step, second)
    assert bytes_of(second) == once
    slice_object(step, first)
    assert bytes_of(first) == once
    assert dict(module.MEMORY._kept) == corrected


@pytest.mark.parametrize("after", [0, 2])
def test_cancelled_it_leaves_everything_as_it_was(plugin, after):
    """Before the first layer or in the middle."""
    _, step, _ = plugin
    thing = part(PLATE.union(shapely.box(12, 0, 12.31, 9)), number=7)
    before = bytes_of(thing)
    assert slice_object(step, thing, cancel_after=after).status is host.PluginResult.Skipped
    assert bytes_of(thing) == before


def test_other_steps_are_left_alone(plugin):
    """The host calls the plugin at every step; at the last there is no object."""
    _, step, _ = plugin
    thing = part(WALL)
    before = bytes_of(thing)
    job = host.Print([thing], OPTIONS)
    for at, one in ((host.Step.posPerimeters, thing), (host.Step.psGCodePostProcess, None)):
        assert step.execute(host.Context(at, job, one)).status is host.PluginResult.Success
    assert bytes_of(thing) == before


def test_settings_are_offered_and_heeded(plugin):
    """What get_default_config shows can be saved back; a feature of one's own counts; nonsense stops the slice."""
    _, step, _ = plugin
    offered = step.get_default_config()
    assert json.loads(json.dumps(offered)) == offered
    try:
        step.save_config(json.dumps({**offered, "min_feature_mm": 0.5}))
        thing = part(WALL)
        slice_object(step, thing)
        assert widths(thing) == pytest.approx([0.5, 0.5, 0.5], abs=0.051)
        step.save_config(json.dumps({"min_feature": 0.5}))
        result = slice_object(step, part(WALL))
        assert result.status is host.PluginResult.FatalError
        assert "no setting 'min_feature'; choose from min_feature_mm" in result.message
    finally:
        step.save_config("{}")


def test_on_a_raft_no_layer_is_the_first(plugin):
    """Its lowest layer is drawn as wide as the others."""
    _, step, _ = plugin
    thing = host.PrintObject([host.Layer(1.2, 0.2, [rings(WALL)])])
    slice_object(step, thing)
    assert widths(thing) == pytest.approx([0.85], abs=0.051)


def test_the_page_shows_the_last_slices(plugin):
    """By object, names as they are written, with a picture; it is sent anew when it asks."""
    module, step, page = plugin
    module.DONE.clear()
    assert "Nothing was sliced yet" in page.get_ui()
    slice_object(step, part(PLATE.union(WALL), number=3, name="<b>fin & plate"))
    with host.audited():
        page.on_message({"cmd": "refresh"})
        page.on_message("what?")
    (sent,) = page.posted
    assert sent["cmd"] == "page"
    assert "&lt;b&gt;fin &amp; plate" in sent["html"]
    assert "<svg" in sent["html"]
    assert sent["html"] in page.get_ui()


def settings_of(saved, **values):
    from layerfix_orca.settings import settings_of

    return settings_of(json.dumps(saved), values.get)


@pytest.mark.parametrize(
    ("saved", "values", "every", "first"),
    [
        ({}, {}, 0.9, 0.9),
        ({}, {"nozzle_diameter": "0.6"}, 1.35, 1.35),
        ({}, {"nozzle_diameter": "0.4", "line_width": "0.45"}, 0.9, 0.9),
        ({}, {"nozzle_diameter": "0.4;0.4", "outer_wall_line_width": "105%", "line_width": "0.5"}, 0.84, 1.0),
        ({}, {"outer_wall_line_width": "0", "initial_layer_line_width": "0.5"}, 0.9, 1.0),
        ({"beads": 1}, {"outer_wall_line_width": "0.42"}, 0.42, 0.45),
        ({"min_feature_mm": 0.7}, {"outer_wall_line_width": "0.42", "initial_layer_line_width": "0.5"}, 0.7, 0.7),
        ({"min_feature_mm": 0.7, "first_layer_min_feature_mm": 1.1}, {}, 0.7, 1.1),
    ],
)
def test_the_minimum_feature_is_two_line_widths(plugin, saved, values, every, first):
    """As the host's options say; percentages are of the nozzle; 0 and what is missing is the host's own choice."""
    found = settings_of(saved, **values)
    assert (found.min_feature_mm, found.first_layer_min_feature_mm) == pytest.approx((every, first))
    assert found.keep_gaps_mm is None


@pytest.mark.parametrize(
    ("saved", "told"),
    [
        ({"beads": -1}, "beads is -1"),
        ({"beads": "two"}, "beads is 'two'"),
        ({"beads": 0}, "give one of them"),
        ({"mode": "thick"}, "mode 'thick'"),
        ([1], "they are an object"),
        ({"pixel_mm": float("nan")}, "pixel_mm is nan"),
    ],
)
def test_settings_that_cannot_be_are_refused(plugin, saved, told):
    """With the value, and what would be accepted."""
    with pytest.raises(LayerfixError, match=told):
        settings_of(saved)


def test_memory_is_bounded(plugin):
    """The oldest layers go first; the sum is right."""
    from layerfix_orca.memory import Memory

    memory = Memory(most_bytes=3000)
    settings = settings_of({"min_feature_mm": 0.8})
    for k in range(12):
        memory.corrected([rings(shapely.box(0, 0, 0.3, 2 + k))], settings, False, UNIT_MM)
    assert memory.bytes == sum(size for _, size in memory._kept.values()) <= 3000


def built(folder):
    done = subprocess.run([sys.executable, ROOT / "plugin" / "build.py", folder], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return {Path(line).name: Path(line) for line in done.stdout.splitlines()}


def test_the_same_sources_give_the_same_bytes(tmp_path):
    """Twice, into two folders; no name has a version in it, as presets know plugins by their file."""
    first, second = built(tmp_path / "a"), built(tmp_path / "b")
    assert set(first) == {"layerfix_orca.whl", "layerfix_cura.curapackage"}
    for name, path in first.items():
        assert path.read_bytes() == second[name].read_bytes()


LOAD_AND_SLICE = """
import sys, json
from pathlib import Path

class Missing:  # what the wheel does not name among its dependencies is not there
    def find_spec(self, name, path=None, target=None):
        if name in ("trimesh", "skimage", "isal", "zlib_ng", "PIL", "click", "cloup", "rich"):
            raise ModuleNotFoundError(name, name=name)

sys.meta_path.insert(0, Missing())
sys.path.append(sys.argv[3])
import tests.orca_host as host
from tests.outlines_drawn import rings
import shapely, shutil

program = host.Host()
package, fields = program.install(Path(sys.argv[1]), Path(sys.argv[2]))
kernels = Path(fields["folder"], "layerfix", "__pycache__", "kernels")
if sys.argv[4]:
    shutil.copytree(sys.argv[4], kernels)  # what an earlier start of the program had compiled
step, page = program.load(package)
import layerfix, cv2
noise = shapely.union_all([shapely.Point(3 * k, k % 5).buffer(0.05 + 0.1 * k) for k in range(12)])
wall = shapely.box(12, 0, 12.2, 10).difference(shapely.Point(12.1, 5).buffer(0.02))
regions = [rings(noise.union(wall)), rings(shapely.box(40, 0, 40.3, 4)), []]
thing = host.PrintObject([host.Layer(0.2 * (k + 1), 0.2, regions) for k in range(2)])
job = host.Print([thing], {"nozzle_diameter": "0.4"})
results = []
for saved in ({}, {"mode": "as_printed", "keep_gaps_mm": 0.1}, {"min_feature_mm": 3.0}):
    step.save_config(json.dumps(saved))
    with host.audited():
        result = step.execute(host.Context(host.Step.posSlice, job, thing))
        page.get_ui()
    results.append([result.status.name, result.message])
print(json.dumps({"fields": fields, "results": results, "layerfix": layerfix.__file__}))
"""


def test_the_wheel_installs_loads_and_slices_in_a_process_of_its_own(tmp_path):
    """With nothing but its dependencies; in `execute` no file is opened, nothing compiled, no process started."""
    wheel = built(tmp_path / "out")["layerfix_orca.whl"]
    with zipfile.ZipFile(wheel) as archive:
        assert archive.testzip() is None
        viewer = {name.rpartition("/")[2] for name in archive.namelist() if "/report/viewer/" in name}
        assert viewer == {"viewer.js", "style.css", "template.html", "THIRD_PARTY_LICENSES.txt"}
        assert not [name for name in archive.namelist() if "__pycache__" in name or name.endswith(".pyc")]
    kernels = next((place for place in kernel_cache.places() if place.is_dir()), "")
    environment = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "NUMBA_CACHE_DIR")}
    run = [sys.executable, "-c", LOAD_AND_SLICE, wheel, tmp_path / "data", str(ROOT), str(kernels)]
    done = subprocess.run(run, capture_output=True, text=True, env=environment, cwd=tmp_path, timeout=300)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout.splitlines()[-1])
    assert said["layerfix"].startswith(str(tmp_path / "data"))
    assert [status for status, _ in said["results"]] == ["Success"] * 3
    assert "2 of 2 layers" in said["results"][0][1]
    fields = said["fields"]
    assert (fields["plugin_key"], fields["Name"]) == ("layerfix_orca", "layerfix-orca")
    assert fields["Summary"].startswith("Thickens")


def test_pip_installs_the_wheel(tmp_path):
    """Under the name that pip wants: every file is the one of the record."""
    wheel = built(tmp_path / "out")["layerfix_orca.whl"]
    with zipfile.ZipFile(wheel) as archive:
        info = next(name.partition("/")[0] for name in archive.namelist() if ".dist-info/" in name)
    named = tmp_path / f"{info.removesuffix('.dist-info')}-py3-none-any.whl"
    shutil.copy(wheel, named)
    pip = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "-q",
        "--no-deps",
        "--no-index",
        "--target",
        tmp_path / "site",
        named,
    ]
    done = subprocess.run(pip, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "site" / "layerfix_orca" / "__init__.py").is_file()
    assert (tmp_path / "site" / "layerfix" / "sample_printers").is_dir()


def test_the_stand_in_keeps_the_rules():
    """What would pass here and fail there is refused here."""
    thing = part(WALL)
    slices = thing.layers()[0].regions()[0].slices
    (old,) = slices.surfaces
    ring = np.array([[0, 0], [10, 0], [10, 10]], np.int64)
    slices.set([host.ExPolygon(ring[::-1])], host.SurfaceType.stInternal)
    assert np.array_equal(slices.surfaces[0].expolygon.contour.as_array(), ring)  # turned the right way round
    with pytest.raises(host.StaleReferenceError):
        _ = old.expolygon
    for wrong in (ring.astype(float), ring[:2], [[0, 0], [1, 0], [1, 1]]):
        with pytest.raises(ValueError, match="ExPolygon"):
            host.ExPolygon(wrong)
    for wrong in (host.ExPolygon(ring), [ring]):
        with pytest.raises(TypeError):
            slices.set(wrong, host.SurfaceType.stInternal)
    with pytest.raises(host.RefusedError), host.audited():
        Path(os.devnull).read_bytes()
    with pytest.raises(host.RefusedError), host.audited():
        subprocess.run([sys.executable, "-c", ""], check=True)
    assert SOURCE.is_dir()
