"""What no mid-plane meets: against columns walked one by one, and drawn by hand."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from layerfix import slice_mesh
from layerfix.errors import InputError
from layerfix.mesh import sheets
from layerfix.mesh.triangles import Mesh, Part
from tests.making import box, cone, inside_out, joined, run_layerfix, save_stl, sphere, turned

LEAST = 0.25


def stretches(mesh: Mesh, x: float, y: float, inside) -> list[tuple[float, float]]:
    """Solid over one point of the plate, from below: each facet asked whether it lies over it, and how high."""
    corners = mesh.vertices[mesh.faces]
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]

    def side(p, q):
        return (q[:, 0] - p[:, 0]) * (y - p[:, 1]) - (q[:, 1] - p[:, 1]) * (x - p[:, 0])

    one, two, three = side(b, c), side(c, a), side(a, b)
    over = ((one > 0) & (two > 0) & (three > 0)) | ((one < 0) & (two < 0) & (three < 0))
    area = (one + two + three)[over]
    z = (one[over] * a[over, 2] + two[over] * b[over, 2] + three[over] * c[over, 2]) / area
    found, winding, start = [], 0, 0.0
    for height, up in sorted(zip(z.tolist(), (area > 0).tolist(), strict=True)):
        was = inside(winding)
        winding += -1 if up else 1
        if inside(winding) and not was:
            start = height
        elif was and not inside(winding):
            found.append((start, height))
    return found


RULES = {"nonzero": lambda n: n != 0, "even_odd": lambda n: n % 2 != 0, "positive": lambda n: n > 0}


def expected(mesh: Mesh, stack, fill: str) -> tuple[np.ndarray, np.ndarray]:
    """(layers, H, W): what mid-planes meet, and with what they miss."""
    z0 = mesh.bounds_mm[0, 2]
    bounds = stack.z_mm + z0
    middles = bounds.mean(axis=1)
    met = np.zeros((len(stack), stack.height, stack.width), bool)
    missed = np.zeros_like(met)
    for j in range(stack.height):
        for i in range(stack.width):
            x = stack.origin_mm[0] + (i + 0.5) * stack.pixel_mm[0]
            y = stack.origin_mm[1] - (j + 0.5) * stack.pixel_mm[1]
            for low, high in stretches(mesh, x, y, RULES[fill]):
                through = (middles > low) & (middles < high)
                met[through, j, i] = True
                if through.any():
                    continue
                held = np.minimum(high, bounds[:, 1]) - np.maximum(low, bounds[:, 0])
                held[0] = max(held[0], min(high, bounds[0, 1]) - low)
                held[-1] = max(held[-1], high - max(low, bounds[-1, 0]))
                k = int(held.argmax())
                if high - low >= LEAST * (bounds[k, 1] - bounds[k, 0]):
                    missed[k, j, i] = True
    return met, met | missed


def plates(seed: int) -> Mesh:
    """Some thin and thick bodies that overlap, turned about all axes."""
    rng = np.random.default_rng(seed)
    bodies = []
    for _ in range(rng.integers(1, 4)):
        low = rng.uniform(-1, 0.5, 3)
        size = rng.uniform(0.3, 1.6, 3) * np.array([1, 1, rng.choice([0.03, 0.08, 0.2, 1.0])])
        body = box(low, low + size)
        kind = rng.integers(0, 4)
        body = sphere(0.5, 9, 5) if kind == 1 else cone(0.7, 0.3, 7) if kind == 2 else body
        body = inside_out(body) if kind == 3 and rng.random() < 0.4 else body
        tilt = rng.uniform(-25, 25) if rng.random() < 0.6 else 0.013
        bodies.append(turned(turned(body, "x", tilt), "y", rng.uniform(-20, 20)))
    return turned(joined(*bodies), "z", rng.uniform(0, 360))


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from(sorted(RULES)), st.sampled_from([None, 0.25]))
def test_as_columns_walked_one_by_one(seed, fill, first_layer_mm):
    """Every pixel of every layer, with and without; a few of the millions lie within a snap of an edge."""
    mesh = plates(seed)
    assume(mesh.size_mm[2] > LEAST * (first_layer_mm or 0.12) + 1e-6)
    how = {"pixel_mm": 0.06, "layer_mm": 0.12, "first_layer_mm": first_layer_mm, "fill": fill, "margin_mm": 0.1}
    found = slice_mesh(mesh, **how, hairlines=False)
    assume(mesh.size_mm[2] > (first_layer_mm or 0.12) / 2 + 1e-6)  # or the plain cut has no layer
    plain = slice_mesh(mesh, **how, hairlines=False, z_sampling="middle")
    met, whole = expected(mesh, found, fill)
    differs = (np.asarray(plain) != met).sum(), (np.asarray(found) != whole).sum()
    assert max(differs) <= 0.002 * met.sum() + 3, differs
    if fill != "positive":
        assert [layer.sheet_px for layer in found] == [
            layer.count_px() - other.count_px() for layer, other in zip(found, plain, strict=True)
        ]


def block_and_sheet(low: float, high: float) -> Mesh:
    """3 mm of a block, and a wide sheet through it."""
    return joined(box([0, 0, 0], [3, 3, 3]), box([-3, -3, low], [6, 6, high]))


@pytest.mark.parametrize(
    ("low", "high", "layer"),
    [(1.16, 1.24, 5), (1.11, 1.21, 5), (1.19, 1.29, 6), (1.15, 1.25, 5), (1.11, 1.16, 5)],
)
def test_a_sheet_goes_into_the_layer_that_holds_most_of_it(low, high, layer):
    """Between the mid-planes 1.1 and 1.3 of layers of 0.2 mm; the lower of two that hold as much."""
    stack = slice_mesh(block_and_sheet(low, high), pixel_mm=0.1, layer_mm=0.2)
    assert [k for k, one in enumerate(stack) if one.count_px() > 900] == [layer]
    assert [k for k, one in enumerate(stack) if one.sheet_px] == [layer]
    assert stack[layer].count_px() == 8100


def test_what_is_lower_than_a_quarter_is_left_out_and_counted():
    """A foil beside the block; the same foil through the block hangs together with it and is a feather edge."""
    foil = joined(box([0, 0, 0], [3, 3, 3]), box([5, 0, 1.18], [6, 3, 1.22]))
    stack = slice_mesh(foil, pixel_mm=0.1, layer_mm=0.2)
    assert [layer.count_px() for layer in stack] == [900] * 15
    assert [k for k, layer in enumerate(stack) if layer.sheets_lost] == [5]
    assert (
        sum(layer.sheets_lost for layer in slice_mesh(block_and_sheet(1.18, 1.22), pixel_mm=0.1, layer_mm=0.2)) == 0
    )


def test_the_ends_take_what_lies_beyond():
    """A foot under the first mid-plane, a lid above the last."""
    mesh = joined(box([0, 0, 0], [3, 3, 3]), box([0, 0, 0], [6, 6, 0.08]), box([0, -3, 2.93], [3, 3, 3.02]))
    stack = slice_mesh(mesh, pixel_mm=0.1, layer_mm=0.2)
    assert [layer.count_px() for layer in stack] == [3600, *[900] * 13, 1800]


@pytest.mark.parametrize("mesh", [sphere(3, 64, 32), cone(3, 3, 64), turned(box([0, 0, 0], [3, 3, 3]), "x", 40)])
def test_ordinary_parts_hardly_change(mesh):
    """Feather edges stay out but for what a quarter of a layer explains; most layers do not change at all."""
    stack = slice_mesh(mesh, pixel_mm=0.05, layer_mm=0.1)
    added, solid = sum(layer.sheet_px for layer in stack), sum(layer.count_px() for layer in stack)
    assert added < 2e-3 * solid
    assert all(layer.sheets_lost == 0 for layer in stack)


def test_threads_and_single_layers_agree():
    """Whoever asks, and in what order."""
    stack = slice_mesh(plates(7), pixel_mm=0.02, layer_mm=0.05)
    one, four = (np.asarray(stack.with_workers(n)) for n in (1, 4))
    assert np.array_equal(one, four)
    fresh = slice_mesh(plates(7), pixel_mm=0.02, layer_mm=0.05)
    for k in reversed(range(len(stack))):
        assert np.array_equal(fresh[k].image(), one[k])


def test_the_command_tells_and_the_api_refuses(tmp_path):
    """A note with the place, an option to have it off, a name that is not known."""
    save_stl(tmp_path / "part.stl", block_and_sheet(1.16, 1.24))
    how = ("--pixel", "0.1mm", "--layer", "0.2mm", "--min-feature", "0.4mm")
    run = run_layerfix("fix", tmp_path / "part.stl", tmp_path / "out.zip", *how)
    assert "thinner than a layer of 0.2 mm in 1 layer, the first at z = 1.000 mm: drawn one layer thick" in run.out
    run = run_layerfix("fix", tmp_path / "part.stl", tmp_path / "out2.zip", *how, "--z-sampling", "middle")
    assert "thinner than a layer" not in run.out
    with pytest.raises(InputError, match="z_sampling='top' is not known; choose from rescue, middle"):
        slice_mesh(block_and_sheet(1, 2), pixel_mm=0.1, layer_mm=0.2, z_sampling="top")


def test_a_part_of_less_than_half_a_layer_is_one_layer():
    """A quarter of it at least; under that it is refused."""
    stack = slice_mesh(box([0, 0, 0], [2, 1, 0.08]), pixel_mm=0.1, layer_mm=0.2)
    assert [layer.count_px() for layer in stack] == [200]
    for height, how in ((0.04, {}), (0.08, {"z_sampling": "middle"})):
        with pytest.raises(InputError, match=r"the part is .* tall, under (a quarter of|half) the first layer"):
            slice_mesh(box([0, 0, 0], [2, 1, height]), pixel_mm=0.1, layer_mm=0.2, **how)


def covered(mesh: Mesh, stack, fill: str, share: float) -> np.ndarray:
    """(layers, H, W): what fills a share of a layer, and stretches that fill it of none where most of them is."""
    bounds = stack.z_mm + mesh.bounds_mm[0, 2]
    heights = np.diff(bounds, axis=1)[:, 0]
    bounds[0, 0], bounds[-1, 1] = bounds[0, 0] - 1, bounds[-1, 1] + 1  # the ends take what lies beyond
    out = np.zeros((len(stack), stack.height, stack.width), bool)
    for j in range(stack.height):
        for i in range(stack.width):
            x = stack.origin_mm[0] + (i + 0.5) * stack.pixel_mm[0]
            y = stack.origin_mm[1] - (j + 0.5) * stack.pixel_mm[1]
            total = np.zeros(len(stack))
            for low, high in stretches(mesh, x, y, RULES[fill]):
                held = np.maximum(np.minimum(high, bounds[:, 1]) - np.maximum(low, bounds[:, 0]), 0)
                total += held
                k = int(held.argmax())
                if not (held >= share * heights).any() and high - low >= LEAST * heights[k]:
                    out[k, j, i] = True
            out[:, j, i] |= total >= share * heights
    return out


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from(sorted(RULES)), st.sampled_from([0.25, 0.5, 0.8]))
def test_overlap_as_columns_say(seed, fill, share):
    """Every pixel, but a few within a snap of an edge."""
    mesh = plates(seed)
    assume(mesh.size_mm[2] > 0.07)
    stack = slice_mesh(mesh, pixel_mm=0.06, layer_mm=0.12, fill=fill, margin_mm=0.1, hairlines=False,
                       z_sampling="overlap", min_overlap=share)  # fmt: skip
    whole = covered(mesh, stack, fill, share)
    differs = (np.asarray(stack) != whole).sum()
    assert differs <= 0.004 * whole.sum() + 4, differs


@pytest.mark.parametrize("degrees", [0, 5, 20])
def test_a_tilted_sheet_is_whole_in_overlap_too(degrees):
    """Half of a layer of 0.15 mm is more than the sheet of 0.05 mm; as much of it is there as with rescue."""
    mesh = joined(box([-8, -8, -4], [-7, -7, 4]), turned(box([-4, -4, 0], [4, 4, 0.05]), "x", degrees))
    volumes = [
        slice_mesh(mesh, pixel_mm=0.1, layer_mm=0.15, z_sampling=how).volume_mm3() - 8
        for how in ("rescue", "overlap")
    ]
    assert volumes[1] == pytest.approx(volumes[0], rel=0.1)
    assert volumes[0] > 8 * 8 * 0.05


@pytest.mark.parametrize("how", ["rescue", "overlap"])
def test_slabs_make_no_difference(monkeypatch, how):
    """However many layers are looked through at once."""
    mesh = joined(turned(box([-3, -3, 0], [3, 3, 0.06]), "x", 8), box([-3, 3.2, 0.02], [3, 5, 1.93]), cone(1.5, 1.7))
    found = []
    for slab in (1, 2, 5, 16):
        monkeypatch.setattr(sheets, "SLAB", slab)
        stack = slice_mesh(mesh, pixel_mm=0.1, layer_mm=0.05, z_sampling=how)
        found.append([layer.rows.tobytes() for layer in stack])
    assert all(other == found[0] for other in found)


def test_parts_add_no_images():
    """Memory does not grow by images of a layer with the parts of a mesh."""

    def peak_bytes(count: int) -> int:
        sheets = [box((0, 3 * k, 0.62), (2, 3 * k + 2, 0.68)) for k in range(count)]
        whole = joined(*sheets, box((0, 0, 0), (150, 3 * 12, 0.3)))
        parts = tuple(Part((12 * k, 12 * k + 12)) for k in range(count))
        mesh = Mesh(whole.vertices, whole.faces, parts=parts)
        stack = slice_mesh(mesh, pixel_mm=0.02, layer_mm=0.2).with_workers(1)
        tracemalloc.start()
        assert sum(layer.sheet_px > 0 for layer in stack) == 1
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return peak

    peak_bytes(1)  # what is loaded once
    few, many = peak_bytes(2), peak_bytes(12)
    layer_bytes = 150 * 36 / 0.02**2 / 8
    assert many - few < 5 * layer_bytes, (few / layer_bytes, many / layer_bytes)
