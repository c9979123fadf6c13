"""Layers that show nothing: all of them is an error, at the bottom, the top and in between they are told."""

from __future__ import annotations

import pytest

from layerfix import slice_mesh
from layerfix.errors import InputError
from layerfix.mesh.empty import empty_between, empty_ends, told_of_ends
from layerfix.mesh.triangles import Mesh
from tests.making import box, inside_out, joined, thin_part

NEEDLE = box([0.51, 0.51, 0], [0.54, 0.54, 9])  # between the centres of 0.1 mm pixels


def test_a_part_of_which_nothing_is_solid_is_refused():
    """With its size, the height of the layers, the pixels, and what was said when it was read."""
    needle = Mesh(NEEDLE.vertices, NEEDLE.faces, "needle.stl", ("1 beam left out",))
    stack = slice_mesh(needle, pixel_mm=(0.1, 0.2), layer_mm=0.3, hairlines=False)
    with pytest.raises(InputError) as caught:
        told_of_ends(stack, needle)
    for words in ("needle.stl", "0.03 × 0.03 × 9 mm", "30 layers of 0.3 mm", "0.1 mm × 0.2 mm", "1 beam left out"):
        assert words in str(caught.value)


def test_a_mesh_inside_out_is_nothing_to_positive_fill():
    """And that is said."""
    mesh = inside_out(box([0, 0, 0], [1, 1, 1]))
    with pytest.raises(InputError, match="nothing is solid"):
        told_of_ends(slice_mesh(mesh, pixel_mm=0.1, layer_mm=0.1, fill="positive"), mesh)


def test_empty_layers_at_the_ends_are_told():
    """A box with needles above and below: from where to where nothing is left."""
    mesh = joined(box([0, 0, 2], [2, 2, 3]), NEEDLE)
    stack = told_of_ends(slice_mesh(mesh, pixel_mm=0.1, layer_mm=0.5, hairlines=False), mesh)
    assert stack.notes == (
        "4 layers are empty at the bottom, up to z = 2.000 mm: the print would begin in the air",
        "12 layers are empty at the top, from z = 3.000 mm on: nothing there reaches a pixel's centre",
    )
    ends = empty_ends(stack)
    assert ends is not None
    assert tuple(ends) == (4, 5)
    one = told_of_ends(slice_mesh(joined(box([0, 0, 0], [2, 2, 1]), box([0.51, 0.51, 0], [0.54, 0.54, 1.5])),
                                  pixel_mm=0.1, layer_mm=0.5, hairlines=False), mesh)  # fmt: skip
    assert one.notes[0].startswith("1 layer is empty at the top")


def test_a_full_part_has_no_notes_and_two_layers_are_made():
    """The bottom and the top one."""
    made: list[int] = []
    stack = slice_mesh(thin_part(), pixel_mm=0.05, layer_mm=0.05)
    make = stack.make
    watched = type(stack)(stack.width, stack.height, stack.pixel_mm, stack.z_mm, lambda k: made.append(k) or make(k))
    assert told_of_ends(watched, thin_part()).notes == ()
    assert made == [0, len(stack) - 1]


def test_empty_layers_in_between_are_listed():
    """Up to five heights; those at the ends are not meant."""
    z = [(k / 10, (k + 1) / 10) for k in range(12)]
    solid = [False, True, False, True, *[False] * 6, True, False]
    assert empty_between(solid, z) == [
        "7 layers are empty in the middle, at z = 0.200, 0.400, 0.500, 0.600, 0.700 and 2 more mm:"
        " what is above hangs in the air"
    ]
    assert empty_between([True] * 12, z) == empty_between([False] * 12, z) == []
    assert empty_between([True, False, True], z[:3])[0].startswith("1 layer is empty in the middle, at z = 0.100 mm")
