"""LayerStack: a sequence on one frame whose layers are made on demand, in order, by a few threads."""

from __future__ import annotations

import io
import os
import pickle
import re
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import FrozenInstanceError, replace
from itertools import islice, pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image as Picture

from layerfix import Layer, LayerStack, correct
from layerfix.bits import pack
from layerfix.errors import InputError
from layerfix.stack import MOST_AT_ONCE, layer_bounds_mm, pitch_mm

IMAGES = np.random.default_rng(1).random((7, 5, 70)) < 0.5


class BrokenLayerError(Exception):
    """What a layer that cannot be made raises here."""


def numbered(index: int, width: int = 16) -> Layer:
    """A layer that knows its number: so many solid pixels."""
    return Layer(pack([[column < index % (width + 1) for column in range(width)]]), width, (index, index + 1.0))


def stack_by(make: Callable[[int], Layer], layers: int, workers: int) -> LayerStack:
    """A stack of `layers` layers of 1 mm."""
    return LayerStack(16, 1, (0.1, 0.1), layer_bounds_mm(layers, 1), make, workers=workers)


def stack_of_images(**options) -> LayerStack:
    """IMAGES as a stack."""
    return LayerStack.from_images(IMAGES, **{"pixel_mm": 0.05, "layer_mm": 0.1, **options})


def layer_threads() -> list[threading.Thread]:
    """Threads that make layers and are still there."""
    return [thread for thread in threading.enumerate() if thread.name.startswith("layers")]


# From images


@pytest.mark.parametrize(
    "given_as",
    [
        lambda images: images,
        list,
        tuple,
        iter,
        lambda images: (image for image in images),
        lambda images: images.astype(np.uint8) * 255,
        lambda images: images.tolist(),
    ],
    ids=["array", "list", "tuple", "iterator", "generator", "grey", "nested lists"],
)
def test_from_images_takes_any_iterable_of_images(given_as):
    """An array of layers, a list, a generator: the same stack."""
    stack = LayerStack.from_images(given_as(IMAGES), pixel_mm=0.05, layer_mm=0.1)
    assert (len(stack), stack.width, stack.height) == (7, 70, 5)
    assert all(np.array_equal(layer.image(), image) for layer, image in zip(stack, IMAGES, strict=True))


def test_from_images_keeps_nothing_of_the_images():
    """A generator may fill one array again and again, and the caller may change it later."""
    canvas = np.zeros((3, 9), bool)

    def drawn():
        for column in range(4):
            canvas[:] = False
            canvas[:, column] = True
            yield canvas

    stack = LayerStack.from_images(drawn(), pixel_mm=1, layer_mm=1)
    canvas[:] = True
    assert [layer.image().nonzero()[1].max() for layer in stack] == [0, 1, 2, 3]
    assert canvas.flags.writeable


@pytest.mark.parametrize("pixel_mm", [0.05, 1, (0.019, 0.024), [0.019, 0.024], np.float64(0.05), np.array([1, 2])])
def test_the_pitch_is_one_number_or_two(pixel_mm):
    """One pitch holds for both axes; the stack has two floats."""
    x, y = np.broadcast_to(pixel_mm, 2).tolist()
    assert stack_of_images(pixel_mm=pixel_mm).pixel_mm == (x, y)
    assert pitch_mm(pixel_mm) == (x, y)


@pytest.mark.parametrize("pixel_mm", [np.float32(0.5), np.int64(1)])
def test_the_pitch_may_be_a_numpy_number(pixel_mm):
    """What comes out of an array counts as a number too."""
    assert stack_of_images(pixel_mm=pixel_mm).pixel_mm == (pixel_mm, pixel_mm)


def test_layers_lie_on_each_other_from_z_0():
    """Bottom and top of each layer; the first may have its own height."""
    assert stack_of_images(layer_mm=0.1).z_mm[:3].tolist() == [[0, 0.1], [0.1, 0.2], [0.2, 0.3]]
    first = stack_of_images(layer_mm=0.1, first_layer_mm=0.35)
    assert first.z_mm[:3].tolist() == [[0, 0.35], [0.35, 0.45], [0.45, 0.55]]
    assert [layer.z_mm for layer in first] == [tuple(z) for z in first.z_mm.tolist()]


def test_heights_do_not_drift_over_many_layers():
    """After 3,000 layers of 0.05 mm the top is at 150 mm exactly."""
    assert layer_bounds_mm(3000, 0.05)[-1].tolist() == [149.95, 150.0]


def test_volume_counts_each_layer_with_its_own_height():
    """Pixels × pitch × pitch × height."""
    stack = LayerStack.from_images(np.ones((3, 4, 70)), pixel_mm=(0.1, 0.2), layer_mm=0.5, first_layer_mm=2)
    assert stack.volume_mm3() == pytest.approx(70 * 0.1 * 4 * 0.2 * 3)


# A sequence


def test_indexing_counts_from_the_bottom_or_from_the_top():
    """Negative indices, and numpy's integers, as in any sequence."""
    stack = stack_of_images()
    for index in (0, 3, 6, -1, -7, np.int64(2), np.int64(-2)):
        assert np.array_equal(stack[index].image(), IMAGES[index])
        assert stack[index].z_mm == tuple(stack.z_mm[index])


@pytest.mark.parametrize("index", [7, -8, 1000])
def test_an_index_outside_names_the_number_of_layers(index):
    """IndexError, so that Python's own loops over sequences end."""
    with pytest.raises(IndexError, match=f"layer {index} of 7"):
        stack_of_images()[index]


@given(st.slices(7).filter(lambda s: s.step is None or s.step > 0))
def test_a_slice_is_a_stack_of_those_layers(part):
    """Layers, z's, frame and pitch are those of the whole; slices of slices too."""
    stack = stack_of_images(pixel_mm=(0.019, 0.024), first_layer_mm=0.3).with_workers(2)
    cut = stack[part]
    assert isinstance(cut, LayerStack)
    assert len(cut) == len(IMAGES[part])
    assert np.array_equal(cut.z_mm, stack.z_mm[part])
    assert (cut.width, cut.height, cut.pixel_mm, cut.workers) == (70, 5, (0.019, 0.024), 2)
    assert all(np.array_equal(layer.image(), image) for layer, image in zip(cut, IMAGES[part], strict=True))
    assert [layer.z_mm for layer in cut] == [tuple(z) for z in cut.z_mm.tolist()]
    again = cut[1:]
    assert all(np.array_equal(layer.image(), image) for layer, image in zip(again, IMAGES[part][1:], strict=True))


def test_a_stack_cannot_be_sliced_from_top_to_bottom():
    """Layers are ordered from the bottom; the message says what to do."""
    with pytest.raises(InputError, match="positive step"):
        stack_of_images()[::-1]


def test_reversed_gives_the_layers_from_the_top():
    """Looking from the top is fine; only a stack has an order."""
    pairs = zip(reversed(stack_of_images()), IMAGES[::-1], strict=True)
    assert all(np.array_equal(layer.image(), image) for layer, image in pairs)


def test_an_empty_slice_has_no_layers():
    """No layers is a stack too: it can be walked, and its volume is 0."""
    nothing = stack_of_images()[4:2]
    assert len(nothing) == 0
    assert list(nothing) == []
    assert nothing.volume_mm3() == 0
    assert nothing.z_mm.shape == (0, 2)


def test_a_stack_can_be_walked_again_and_by_two_at_once():
    """An iterator has no effect on the stack or on another."""
    stack = stack_of_images().with_workers(2)
    assert [a.count_px() for a in stack] == [b.count_px() for b in stack]
    for one, other, image in zip(stack, stack, IMAGES, strict=True):
        assert one.count_px() == other.count_px() == image.sum()


# Verbs give new stacks


def test_map_changes_each_layer_when_asked_and_not_before():
    """The frame and z's stay; the stack that was mapped is as it was."""
    asked: list[float] = []

    def inverted(layer: Layer) -> Layer:
        asked.append(layer.z_mm[0])
        return Layer(pack(~layer.image()), layer.width, layer.z_mm)

    stack = stack_of_images(first_layer_mm=0.3)
    mapped = stack.map(inverted)
    assert asked == []
    assert np.array_equal(mapped[2].image(), ~IMAGES[2])
    assert asked == [stack.z_mm[2, 0]]
    assert np.array_equal(mapped.z_mm, stack.z_mm)
    assert np.array_equal(stack[2].image(), IMAGES[2])
    assert np.array_equal(mapped.map(inverted)[3].image(), IMAGES[3])


def test_what_looks_at_heights_is_asked_for_every_layer():
    """A mapped stack forgets which layers repeat, unless it is said that only pixels count."""

    def only_high(layer: Layer) -> Layer:
        return replace(layer, rows=layer.rows if layer.z_mm[0] > 0.3 else np.zeros_like(layer.rows))

    stack = replace(LayerStack.from_images([IMAGES[0]] * 3, pixel_mm=0.1, layer_mm=0.2), repeats=np.arange(3) > 0)
    assert [*stack.map(only_high).each(Layer.count_px, once=True)] == [0, 0, IMAGES[0].sum()]
    assert [*stack.map(only_high, pixels_only=True).each(Layer.count_px, once=True)] == [0, 0, 0]


def test_with_workers_is_another_stack_with_the_same_layers():
    """The number of threads of the first stays."""
    stack = stack_of_images()
    assert (stack.with_workers(3).workers, stack.workers) == (3, 0)
    assert np.array_equal(stack.with_workers(3)[1].image(), IMAGES[1])


def test_stacks_and_layers_do_not_change():
    """Neither their fields, nor the rows and z's in them."""
    stack = stack_of_images()
    with pytest.raises(FrozenInstanceError):
        stack.width = 3
    with pytest.raises(FrozenInstanceError):
        stack[0].width = 3
    with pytest.raises(ValueError, match="read-only"):
        stack.z_mm[0, 0] = 1
    with pytest.raises(ValueError, match="read-only"):
        stack[0].rows[0, 0] = 1


def test_the_stack_has_z_values_of_its_own():
    """Changing the array that they came from changes nothing."""
    z_mm = np.array([[0, 1.0], [1, 2]])
    stack = LayerStack(16, 1, (1, 1), z_mm, numbered)
    z_mm[:] = 7
    assert stack.z_mm.tolist() == [[0, 1], [1, 2]]


# Threads


@pytest.fixture
def one_at_a_time(monkeypatch):
    """Threads take single layers, as they do of large or slow ones."""
    monkeypatch.setattr("layerfix.stack.MOST_AT_ONCE", 1)


@pytest.mark.parametrize("workers", [2, 3])
def test_quick_small_layers_are_taken_in_a_row(workers):
    """Up to sixteen of them, in order all the same; an error comes in its turn, and what follows it is not made."""
    made: list[tuple[int, int]] = []

    def make(index: int) -> Layer:
        made.append((threading.get_ident(), index))
        if index == 300:
            raise BrokenLayerError("layer 300 cannot be read")
        return numbered(index)

    read, ahead = [], []
    layers = iter(stack_by(make, 1000, workers))
    for layer in islice(layers, 300):
        read.append(layer.z_mm[0])
        ahead.append(len(made) - len(read))
    with pytest.raises(BrokenLayerError, match="layer 300"):
        next(layers)
    assert read == list(range(300))
    by_thread = [[index for thread, index in made if thread == one] for one in {thread for thread, _ in made}]
    in_a_row = sum(b == a + 1 for indices in by_thread for a, b in pairwise(indices))
    assert in_a_row > 150  # one at a time, threads would meet by chance only
    assert max(ahead) <= (2 * workers + 1) * MOST_AT_ONCE
    assert layer_threads() == []


@pytest.mark.parametrize("workers", [1, 2, 3, 8])
def test_layers_come_in_order_however_long_each_takes(workers):
    """Slow layers among quick ones, and more threads than cores."""
    slow = np.random.default_rng(0).random(40) < 0.25

    def make(index: int) -> Layer:
        time.sleep(0.004 if slow[index] else 0)
        return numbered(index)

    assert [layer.z_mm[0] for layer in stack_by(make, 40, workers)] == list(range(40))


@pytest.mark.usefixtures("one_at_a_time")
@pytest.mark.parametrize("workers", [1, 2, 4])
def test_few_layers_are_made_ahead_of_a_slow_reader(workers):
    """At most two a worker, so memory does not depend on the number of layers."""
    made: list[int] = []

    def make(index: int) -> Layer:
        made.append(index)
        return numbered(index)

    ahead = []
    for taken, _ in enumerate(stack_by(make, 60, workers), start=1):
        time.sleep(0.002)
        ahead.append(len(made) - taken)
    assert max(ahead) <= 2 * workers * (workers > 1)
    assert max(ahead) >= workers - 1  # or nobody would work while the reader does
    assert sorted(made) == list(range(60))


@pytest.mark.usefixtures("one_at_a_time")
def test_a_made_layer_is_let_go_once_it_was_read():
    """The stack keeps no layer that the reader has had: what is alive is bounded by the look-ahead."""
    import weakref

    alive: weakref.WeakSet[Layer] = weakref.WeakSet()

    def make(index: int) -> Layer:
        layer = numbered(index)
        alive.add(layer)
        return layer

    most = 0
    for layer in stack_by(make, 60, 2):
        most = max(most, len(alive))
        del layer
    assert most <= 2 * 2 + 2


def test_nothing_is_made_before_the_first_layer_is_asked_for():
    """Making a stack, mapping it and asking for an iterator costs nothing."""
    made: list[int] = []

    def make(index: int) -> Layer:
        made.append(index)
        return numbered(index)

    iterator = iter(stack_by(make, 9, 2).map(lambda layer: layer)[1:])
    assert made == []
    next(iterator)
    assert made
    iterator.close()


@pytest.mark.usefixtures("one_at_a_time")
@pytest.mark.parametrize("workers", [2, 3])
def test_so_many_threads_make_layers_at_the_same_time(workers):
    """`workers` layers are in the making at once, never more."""
    together = threading.Barrier(workers, timeout=20)
    running, most, lock = 0, 0, threading.Lock()

    def make(index: int) -> Layer:
        nonlocal running, most
        with lock:
            running += 1
            most = max(most, running)
        together.wait()  # passes only when so many threads are here
        with lock:
            running -= 1
        return numbered(index)

    assert len(list(stack_by(make, 4 * workers, workers))) == 4 * workers
    assert most == workers


def test_one_worker_works_in_the_readers_thread():
    """No thread is started for nothing."""
    makers = set()

    def make(index: int) -> Layer:
        makers.add(threading.current_thread())
        return numbered(index)

    list(stack_by(make, 5, 1))
    assert makers == {threading.current_thread()}


def test_the_number_of_workers_holds_where_the_system_does_not_tell_its_cores(monkeypatch):
    """macOS and Windows have no sched_getaffinity; what was asked for counts there, too."""
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    makers = set()

    def make(index: int) -> Layer:
        makers.add(threading.current_thread())
        return numbered(index)

    list(stack_by(make, 5, 1))
    assert makers == {threading.current_thread()}
    for cores in (None, 1, 2):
        monkeypatch.setattr(os, "cpu_count", lambda cores=cores: cores)
        assert len(list(stack_by(make, 5, 0))) == 5


@pytest.mark.usefixtures("one_at_a_time")
@pytest.mark.parametrize("workers", [1, 2, 8])
def test_an_error_in_a_worker_reaches_the_reader_at_its_layer(workers):
    """The layers before it come first; then its own exception; then no thread is left, and little was made."""
    made: list[int] = []

    def make(index: int) -> Layer:
        made.append(index)
        if index == 11:
            raise BrokenLayerError("layer 11 cannot be read")
        return numbered(index)

    read = []
    with pytest.raises(BrokenLayerError, match="layer 11 cannot be read"):
        read.extend(layer.z_mm[0] for layer in stack_by(make, 500, workers))
    assert read == list(range(11))
    assert max(made) <= 11 + 2 * workers
    assert layer_threads() == []


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_in_what_is_done_with_a_layer_reaches_the_reader(workers):
    """`each` hands on exceptions of its function and stops the threads."""

    def use(layer: Layer) -> float:
        if layer.z_mm[0] == 5:
            raise BrokenLayerError("disk full")
        return layer.z_mm[0]

    results = stack_by(numbered, 50, workers).each(use)
    assert [next(results) for _ in range(5)] == list(range(5))
    with pytest.raises(BrokenLayerError, match="disk full"):
        next(results)
    assert layer_threads() == []
    assert list(results) == []


@pytest.mark.parametrize("once", [False, True])
@pytest.mark.parametrize("workers", [1, 2, 3, 8])
def test_an_error_waits_for_the_layers_below_it(workers, once):
    """Layer 0 is still being made when layer 3 has failed, and layer 5 after it: 0, 1 and 2 come all the same, then
    the error of layer 3, whatever the number of threads.
    """
    failed = threading.Event()

    def make(index: int) -> Layer:
        if index == 0 and workers > 1:
            assert failed.wait(30)
        if index in (3, 5):
            failed.set()
            raise BrokenLayerError(f"layer {index}")
        return numbered(index)

    stack = replace(stack_by(make, 40, workers), repeats=np.arange(40) == 2)
    read: list[float] = []
    with pytest.raises(BrokenLayerError, match="layer 3"):
        read.extend(stack.each(lambda layer: layer.z_mm[0], once=once))
    assert read == ([0, 1, 1] if once else [0, 1, 2])
    assert layer_threads() == []


@pytest.mark.parametrize(("below", "above"), [(0, 0), (1, 2), (3, 1)])
@pytest.mark.parametrize("workers", [1, 2, 3, 8])
def test_an_error_among_neighbours_arrives_with_the_first_layer_that_needs_it(workers, below, above):
    """As with one worker: what does not see the broken layer comes first, however slow it is."""
    failed = threading.Event()

    def make(index: int) -> Layer:
        if index == 6:
            failed.set()
            raise BrokenLayerError("layer 6")
        return numbered(index)

    def use(index: int, *around: object) -> int:
        if index == 0 and workers > 3:  # or the others do not get as far as layer 6
            assert failed.wait(30)
        return index

    read: list[int] = []
    with pytest.raises(BrokenLayerError, match="layer 6"):
        read.extend(stack_by(make, 40, workers).each_with_neighbours(use, below=below, above=above))
    assert read == list(range(6 - above))
    assert layer_threads() == []


@pytest.mark.parametrize(("below", "above"), [(0, 0), (2, 3), (4, 0), (0, 5)])
@pytest.mark.parametrize("workers", [1, 2, 5])
def test_neighbours_are_made_once_and_let_go(workers, below, above):
    """Every layer is made once; those alive at a time are the neighbours and what the threads are ahead, not all.

    A thread may sleep on its layer while the others go on, so that the oldest layers are still needed.
    """
    import weakref

    alive: weakref.WeakSet[Layer] = weakref.WeakSet()
    made: list[int] = []
    most = 0

    def make(index: int) -> Layer:
        made.append(index)
        layer = numbered(index)
        alive.add(layer)
        return layer

    def use(index: int, lower: Sequence[Layer], here: Layer, upper: Sequence[Layer]) -> list[float]:
        if index % 7 == 0:
            time.sleep(0.005)
        return [layer.z_mm[0] for layer in (*lower, here, *upper)]

    for index, seen in enumerate(stack_by(make, 120, workers).each_with_neighbours(use, below=below, above=above)):
        assert seen == list(range(max(index - below, 0), min(index + above + 1, 120)))
        most = max(most, len(alive))
    assert sorted(made) == list(range(120))
    kept = below + above + 3 * workers + 1
    in_hand = workers * (below + above + 1)  # by threads that are at work
    assert most <= kept + in_hand < 120


@pytest.mark.parametrize("workers", [2, 8])
def test_a_reader_who_stops_early_stops_the_threads(workers):
    """Closing the iterator leaves no thread behind and makes no further layers."""
    made: list[int] = []

    def make(index: int) -> Layer:
        made.append(index)
        time.sleep(0.001)
        return numbered(index)

    iterator = iter(stack_by(make, 1000, workers))
    for _ in range(3):
        next(iterator)
    iterator.close()
    assert layer_threads() == []
    count = len(made)
    assert count <= 3 + 2 * workers
    time.sleep(0.02)
    assert len(made) == count


def test_layers_that_wait_for_a_thread_are_not_made_once_the_reader_stops():
    """Of the look-ahead only what is already in the making is finished."""
    made: list[int] = []
    go_on = threading.Event()

    def make(index: int) -> Layer:
        made.append(index)
        if index >= 3:
            go_on.wait(20)
        return numbered(index)

    iterator = iter(stack_by(make, 50, 2))
    for _ in range(3):
        next(iterator)
    timer = threading.Timer(0.2, go_on.set)  # by then close() has called off what nobody has begun
    timer.start()
    iterator.close()
    timer.join()
    assert max(made) <= 4


def test_a_reader_who_breaks_off_stops_the_threads():
    """`break` in a for loop is enough."""
    for layer in stack_by(numbered, 1000, 2):
        if layer.z_mm[0] == 4:
            break
    assert layer_threads() == []


@pytest.mark.parametrize("workers", [1, 2])
def test_each_gives_the_results_in_order(workers):
    """What is computed from a layer is computed in the threads and comes in order."""
    assert list(stack_by(numbered, 12, workers).each(Layer.count_px)) == list(range(12))


# The door


def test_a_layer_knows_its_size_and_pixels():
    """Height, image, and the number of solid pixels."""
    layer = stack_of_images()[3]
    assert (layer.width, layer.height) == (70, 5)
    assert np.array_equal(layer.image(), IMAGES[3])
    assert layer.count_px() == IMAGES[3].sum()
    assert (layer.change, layer.gaps) == (None, None)


@pytest.mark.parametrize("width", [1, 63, 65, 130])
def test_bits_past_the_width_are_refused(width):
    """One bit too many in any row breaks the contract."""
    rows = pack(np.zeros((4, width), bool))
    rows[2, -1] |= np.uint64(1) << np.uint64(width % 64)
    with pytest.raises(InputError, match=f"a layer {width} px wide has bits set past its width"):
        Layer(rows, width, (0, 1))


@pytest.mark.parametrize("width", [1, 63, 64, 128, 130])
def test_a_full_layer_is_within_its_width(width):
    """All pixels solid is no breach, also where the last word is full."""
    assert Layer(pack(np.ones((4, width), bool)), width, (0, 1)).count_px() == 4 * width


@pytest.mark.parametrize(
    ("rows", "width", "found"),
    [
        (np.zeros((3, 2), np.uint64), 64, r"\(3, 2\) uint64"),
        (np.zeros((3, 1), np.uint64), 65, r"\(3, 1\) uint64"),
        (np.zeros((3, 1), np.int64), 64, r"\(3, 1\) int64"),
        (np.zeros((3, 1), ">u8"), 64, r"\(3, 1\) >u8"),
        (np.zeros((3, 64), bool), 64, r"\(3, 64\) bool"),
        (np.zeros(3, np.uint64), 64, r"\(3,\) uint64"),
    ],
)
def test_rows_of_another_shape_or_type_are_refused(rows, width, found):
    """The message says what a layer of that width has, and what came."""
    with pytest.raises(InputError, match=rf"a layer {width} px wide has \(height, \d\) uint64 rows, not {found}"):
        Layer(rows, width, (0, 1))


@pytest.mark.parametrize(
    "rows",
    [np.asfortranarray(pack(np.ones((6, 130), bool))), pack(np.ones((6, 130), bool))[::2]],
    ids=["column by column", "every second row"],
)
def test_rows_in_another_order_are_refused_or_put_right(rows):
    """Rows are C-ordered (the contract), and the kernels take no others: the door must not let them in."""
    try:
        layer = Layer(rows, 130, (0, 1))
    except InputError:
        return
    assert layer.rows.flags.c_contiguous


# What is wrong: (the values that are, what the message must show)
BAD_STACKS = {
    "no width": ({"width": 0}, "0 × 1 px"),
    "no height": ({"height": 0}, "16 × 0 px"),
    "a negative width": ({"width": -3}, "-3 × 1 px"),
    "a pitch of 0": ({"pixel_mm": (0.1, 0)}, "(0.1, 0)"),
    "a negative pitch": ({"pixel_mm": (-0.1, 0.1)}, "(-0.1, 0.1)"),
    "a pitch that is NaN": ({"pixel_mm": (0.1, float("nan"))}, "(0.1, nan)"),
    "an infinite pitch": ({"pixel_mm": (float("inf"), 0.1)}, "(inf, 0.1)"),
    "a pitch in words": ({"pixel_mm": "fine"}, "fine mm"),
    "one pitch in a tuple": ({"pixel_mm": (0.1,)}, "(0.1,)"),
    "three pitches": ({"pixel_mm": (0.1, 0.1, 0.2)}, "(0.1, 0.1, 0.2)"),
    "three z's a layer": ({"z_mm": np.zeros((2, 3))}, "shape (2, 3)"),
    "one z a layer": ({"z_mm": np.array([0, 1.0])}, "shape (2,)"),
    "a z that is NaN": ({"z_mm": np.array([[0, 1], [1, np.nan]])}, "nan"),
    "an infinite z": ({"z_mm": np.array([[0, 1], [1, np.inf]])}, "inf"),
    "a layer without height": ({"z_mm": np.array([[0, 0.25], [0.25, 0.25]])}, "0.25"),
    "layers that overlap": ({"z_mm": np.array([[0, 1], [0.75, 2]])}, "0.75"),
    "fewer workers than none": ({"workers": -1}, "workers=-1"),
}
BAD_IMAGES = {
    "none": ({"images": []}, "no images"),
    "an empty generator": ({"images": iter(())}, "no images"),
    "an array of none": ({"images": np.zeros((0, 4, 4))}, "no images"),
    "several sizes": ({"images": [np.ones((3, 4)), np.ones((3, 4)), np.ones((3, 5))]}, "image 2 is 5 × 3 px"),
    "one image": ({"images": np.ones((3, 4))}, "(4,)"),
    "colours": ({"images": np.ones((2, 3, 4, 3))}, "(3, 4, 3)"),
    "no pixels": ({"images": np.ones((2, 0, 4))}, "4 × 0 px"),
    "a pitch of 0": ({"pixel_mm": 0}, "pitch 0 mm"),
    "a negative pitch": ({"pixel_mm": -0.1}, "pitch -0.1 mm"),
    "one pitch of two is 0": ({"pixel_mm": (0.1, 0)}, "pitch (0.1, 0) mm"),
    "a pitch that is NaN": ({"pixel_mm": float("nan")}, "pitch nan mm"),
    "three pitches": ({"pixel_mm": (0.1, 0.1, 0.2)}, "pitch (0.1, 0.1, 0.2) mm"),
    "a height of 0": ({"layer_mm": 0}, "layer height 0 mm"),
    "a negative height": ({"layer_mm": -0.1}, "layer height -0.1 mm"),
    "a height that is NaN": ({"layer_mm": float("nan")}, "layer height nan mm"),
    "an infinite height": ({"layer_mm": float("inf")}, "layer height inf mm"),
    "a first height of 0": ({"first_layer_mm": 0}, "layer height 0 mm"),
    "a negative first height": ({"first_layer_mm": -0.2}, "layer height -0.2 mm"),
}


@pytest.mark.parametrize("case", BAD_STACKS)
def test_a_stack_refuses_bad_values_and_names_them(case):
    """Each at the door, before any layer is made; the message shows the value."""
    good = {"width": 16, "height": 1, "pixel_mm": (0.1, 0.1), "z_mm": np.array([[0, 1], [1, 2.0]]), "make": numbered}
    LayerStack(**good)
    values, shown = BAD_STACKS[case]
    with pytest.raises(InputError, match=re.escape(shown)):
        LayerStack(**{**good, **values})


@pytest.mark.parametrize("case", BAD_IMAGES)
def test_from_images_refuses_bad_values_and_names_them(case):
    """No images, images of several sizes, and lengths that are not above 0."""
    values, shown = BAD_IMAGES[case]
    with pytest.raises(InputError, match=re.escape(shown)):
        LayerStack.from_images(**{"images": np.ones((2, 3, 4)), "pixel_mm": 0.1, "layer_mm": 0.1, **values})


def test_a_gap_between_layers_is_allowed():
    """Every second layer of a stack is a stack; its z's rise, with gaps."""
    assert LayerStack(16, 1, (1, 1), np.array([[0, 1], [2, 3.0]]), numbered).z_mm.tolist() == [[0, 1], [2, 3]]


def test_an_error_while_making_a_layer_at_an_index_is_its_own():
    """Indexing needs no thread and changes no exception."""

    def make(index: int) -> Layer:
        raise BrokenLayerError(str(index))

    with pytest.raises(BrokenLayerError, match="3"):
        stack_by(make, 5, 2)[-2]


# What a person and other programs see of a stack


def test_a_stack_and_a_layer_are_one_line_each():
    """Number, size, pitch, heights; of a layer also what is solid."""
    stack = LayerStack.from_images([np.ones((8, 12), bool)] * 5, pixel_mm=0.05, layer_mm=0.2)
    assert repr(stack) == "<LayerStack of 5 layers, 12 × 8 px of 50 µm, z 0 to 1 mm>"
    assert repr(stack[2]) == "<Layer of 12 × 8 px, z 0.4 to 0.6 mm, 96 px solid>"
    uneven = LayerStack.from_images([np.ones((8, 12), bool)], pixel_mm=(0.019, 0.024), layer_mm=0.2)
    assert "19 × 24 µm" in repr(uneven)
    assert "z" not in repr(stack[:0])


def test_a_stack_is_an_array_of_its_pixels():
    """(layers, H, W) bool, or what is asked for; too many pixels, and an array without a copy, are refused."""
    rng = np.random.default_rng(1)
    images = rng.random((4, 9, 70)) < 0.5
    stack = LayerStack.from_images(images, pixel_mm=0.05, layer_mm=0.2)
    assert np.array_equal(np.asarray(stack), images)
    assert np.asarray(stack).dtype == np.bool_
    assert np.array_equal(np.asarray(stack[1:3], np.uint8), images[1:3])
    with pytest.raises(InputError, match="always new"):
        np.array(stack, copy=False)
    many = replace(stack, z_mm=np.stack([np.arange(10_000_000.0), np.arange(1, 10_000_001.0)], axis=1))
    with pytest.raises(InputError, match=r"too many for one array \(6\.3 GB\)"):
        np.asarray(many)


def test_a_notebook_shows_a_layer():
    """A PNG of it, solid black; a large one smaller."""
    image = np.zeros((30, 40), bool)
    image[5:10, 5:30] = True
    layer = LayerStack.from_images([image], pixel_mm=0.05, layer_mm=0.2)[0]
    with Picture.open(io.BytesIO(layer._repr_png_())) as picture:
        assert np.array_equal(np.asarray(picture.convert("L")) < 128, image)
    wide = LayerStack.from_images([np.ones((10, 5000), bool)], pixel_mm=0.05, layer_mm=0.2)[0]
    with Picture.open(io.BytesIO(wide._repr_png_())) as picture:
        assert max(picture.size) <= 1024


def test_a_stack_that_is_pickled_makes_the_same_layers():
    """From images, sliced, corrected: for other processes and other machines."""
    rng = np.random.default_rng(2)
    images = LayerStack.from_images(rng.random((4, 50, 70)) < 0.5, pixel_mm=0.05, layer_mm=0.2)
    stack = correct(images, min_feature_mm=0.3)
    for one in (stack, stack[1:3], stack[::2]):
        again = pickle.loads(pickle.dumps(one))
        assert len(again) == len(one)
        for a, b in zip(again, one, strict=True):
            assert np.array_equal(a.rows, b.rows)
            assert (a.z_mm, a.change) == (b.z_mm, b.change)
