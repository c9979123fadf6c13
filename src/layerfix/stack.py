"""LayerStack: the one value that flows through layerfix, and with `layerfix.threads` all that knows of workers."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeVar, overload

import numpy as np

from layerfix.bits import pack, unpack, words_for
from layerfix.errors import InputError
from layerfix.processors import processors
from layerfix.threads import Remembered, in_threads
from layerfix.units import one_or_two

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, DTypeLike, NDArray

    from layerfix.bits import Image, Rows

Result = TypeVar("Result")
NOTEBOOK_PX = 1024
LARGEST_ARRAY = 4 << 30  # bytes of one array of all layers
MOST_AT_ONCE, AT_ONCE_BYTES = 16, 1 << 20  # of layers that a thread takes in a row


@dataclass(frozen=True)
class Change:
    """What correction did to one layer. thinnest_mm is the narrowest feature that needed help, if any."""

    solid_px: int  # before
    added_px: int
    removed_px: int
    thinnest_mm: float | None
    radius_px: tuple[float, float] = (0.0, 0.0)  # (rx, ry) of F
    offset_px: tuple[float, float] = (0.0, 0.0)  # of F's middle from the centre of its pixel, east and down
    topology: tuple[Any, ...] = ()  # what merged and closed: `layerfix.layers.topology.TopologyChange`
    conflicts: tuple[Any, ...] = ()  # what stays under F: `layerfix.layers.gaps.Conflict`
    ignored_px: int = 0  # of parts too small to be corrected
    paths: Rows | None = field(default=None, repr=False, compare=False)  # packed: where F was drawn, if from a file


@dataclass(frozen=True)
class Gaps:
    """What slicing had to close in one layer because the mesh is open: how many gaps, the longest in mm."""

    count: int
    longest_mm: float


@dataclass(frozen=True, eq=False)
class Layer:
    """One printed layer.

    rows    (height, words) uint64, packed as `layerfix.bits` says; read-only
    width   pixels in a row
    z_mm    (bottom, top)
    change  what `correct` did, if it was this layer's last step
    gaps    what `slice_mesh` closed, if anything
    hairline_px  pixels that stand for what is thinner than one
    sheet_px  pixels of what is thinner than a layer and was met by no mid-plane
    sheets_lost  parts of such, too thin to be kept
    small    (n, 2) row and column of the middles of pieces that are small and separate, though pixels may join them
    joined   pieces of a mesh's section at mid-height that pixels make one part: they are within two pixels of one
             another; each a `layerfix.layers.topology.TopologyChange`. Of what is sliced with hairlines, not clipped
    specks   packed rows of the parts with nothing below and above, where they are to be left as they are
    raised_px  pixels that were added for what is of too few layers
    dimmed_px  pixels of dimmed interiors, which count as solid and are left as they are
    source  what the layer was decoded from, for a writer that keeps what it can of it
    """

    rows: Rows
    width: int
    z_mm: tuple[float, float]
    change: Change | None = None
    gaps: Gaps | None = None
    source: Any = None
    hairline_px: int = 0
    sheet_px: int = 0
    sheets_lost: int = 0
    dimmed_px: int = 0
    raised_px: int = 0
    small: NDArray[np.int64] | None = None
    specks: Rows | None = None
    joined: tuple[Any, ...] = ()

    def __post_init__(self) -> None:
        """Raises InputError unless `rows` keeps the contract; marks it read-only."""
        rows = self.rows
        if rows.ndim != 2 or rows.dtype != np.uint64 or rows.shape[1] != words_for(self.width):
            raise InputError(
                f"a layer {self.width} px wide has (height, {words_for(self.width)}) uint64 rows,"
                f" not {rows.shape} {rows.dtype}"
            )
        if self.width % 64 and len(rows) and (rows[:, -1] >> np.uint64(self.width % 64)).any():
            raise InputError(f"a layer {self.width} px wide has bits set past its width")
        rows = np.ascontiguousarray(rows)  # as the kernels need it; a copy only if it was not
        rows.flags.writeable = False
        object.__setattr__(self, "rows", rows)

    @property
    def height(self) -> int:
        return len(self.rows)

    def __repr__(self) -> str:
        """Size, height and what is solid, in one line."""
        bottom, top = self.z_mm
        return f"<Layer of {self.width} × {self.height} px, z {bottom:g} to {top:g} mm, {self.count_px()} px solid>"

    def _repr_png_(self) -> bytes:
        """The picture that a notebook shows: solid is black, at most NOTEBOOK_PX wide or high."""
        import io

        from PIL import Image as Pictures

        step = max(1, -(-max(self.width, self.height) // NOTEBOOK_PX))
        file = io.BytesIO()
        Pictures.fromarray(~self.image()[::step, ::step]).save(file, "PNG")
        return file.getvalue()

    def without_pixels(self) -> Layer:
        """What is known of the layer, to be kept for every layer of a stack."""
        change = self.change if self.change is None else replace(self.change, paths=None)
        return replace(self, rows=self.rows[:0].copy(), source=None, small=None, specks=None, change=change)

    def at(self, z_mm: tuple[float, float]) -> Layer:
        """The same layer at another height."""
        change = self.change
        if change is not None and (change.topology or change.conflicts):
            topology, conflicts = (
                tuple(replace(one, z_mm=z_mm) for one in found) for found in (change.topology, change.conflicts)
            )
            change = replace(change, topology=topology, conflicts=conflicts)
        joined = tuple(replace(one, z_mm=z_mm) for one in self.joined)
        return replace(self, z_mm=z_mm, change=change, joined=joined)

    def image(self) -> Image:
        """(H, W) bool, row 0 at the back of the build plate (largest y)."""
        return unpack(self.rows, self.width)

    def count_px(self) -> int:
        """Solid pixels."""
        return int(np.bitwise_count(self.rows).sum())


@dataclass(frozen=True, eq=False)
class LayerStack(Sequence[Layer]):
    """An immutable, ordered sequence of layers on one pixel frame, bottom first, made when asked for.

    width, height  of every layer in px
    pixel_mm       (x, y) pixel pitch
    origin_mm      (x, y) of the outer corner of pixel (row 0, column 0); x grows with the column, y falls
                   with the row, so that a layer seen as an image is the part seen from above
    z_mm           (layers, 2) float64: bottom and top of each layer, rising; exposures of one layer, one after the
                   other, share them
    make           layer index → Layer; pure, called from several threads at once
    workers        threads that make layers; the bits do not depend on it
    repeats        (layers,) bool, True where a layer is the same as the one below, pixel by pixel (common in
                   jobs); None where nobody knows
    container      the job file the layers come from, for a writer of the same format
    notes          what a user should know of how the layers were read
    """

    width: int
    height: int
    pixel_mm: tuple[float, float]
    z_mm: NDArray[np.float64]
    make: Callable[[int], Layer]
    origin_mm: tuple[float, float] = (0.0, 0.0)
    workers: int = 0
    repeats: NDArray[np.bool_] | None = None
    container: Any = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Raises InputError for an empty frame, a pitch that is not above 0, z's that do not rise."""
        z = np.array(self.z_mm, np.float64).reshape(-1, 2) if np.size(self.z_mm) == 0 else np.array(self.z_mm, float)
        if self.width < 1 or self.height < 1:
            raise InputError(f"a frame of {self.width} × {self.height} px holds nothing")
        if z.ndim != 2 or z.shape[1] != 2:
            raise InputError(f"z_mm has shape {z.shape}; it is (layers, 2): bottom and top")
        wrong = ~np.isfinite(z).all(axis=1) | ~(z[:, 1] > z[:, 0])
        wrong[1:] |= ~(z[1:, 0] >= z[:-1, 1] - 1e-6) & (z[1:] != z[:-1]).any(axis=1)
        if wrong.any():
            k = int(np.flatnonzero(wrong)[0])
            below = f" on one that ends at {z[k - 1, 1]:g}" if k else ""
            raise InputError(
                f"z_mm of layer {k} is {z[k, 0]:g} to {z[k, 1]:g}{below}: a layer's top is above its bottom,"
                " and layers do not overlap"
            )
        if self.workers < 0:
            raise InputError(f"workers={self.workers}: at least 1, or 0 for one per core")
        z.flags.writeable = False
        object.__setattr__(self, "z_mm", z)
        object.__setattr__(self, "pixel_mm", pitch_mm(self.pixel_mm))

    @classmethod
    def from_images(
        cls,
        images: ArrayLike | Iterable[ArrayLike],
        *,
        pixel_mm: float | tuple[float, float],
        layer_mm: float,
        first_layer_mm: float | None = None,
    ) -> LayerStack:
        """(layers, H, W) bool, or any iterable of (H, W) images, non-zero = solid, as a stack held packed.

        pixel_mm is one pitch or (x, y). Raises InputError for no images and for images of several sizes.
        """
        packed: list[Rows] = []
        shape: tuple[int, ...] = ()
        for index, image in enumerate(images):  # type: ignore[arg-type]  # an array iterates over its layers
            array = np.asarray(image)
            if packed and array.shape != shape:
                raise InputError(f"image {index} is {_size(array.shape)} px, the first is {_size(shape)} px")
            shape = array.shape
            packed.append(pack(array))
        if not packed:
            raise InputError("no images: a stack has at least one layer")
        height, width = shape
        z_mm = layer_bounds_mm(len(packed), layer_mm, first_layer_mm)
        return cls(width, height, pitch_mm(pixel_mm), z_mm, layer_maker(packed.__getitem__, width, z_mm))

    def __len__(self) -> int:
        return len(self.z_mm)

    def __repr__(self) -> str:
        """Number and size of the layers, pitch and heights, in one line."""
        x, y = self.pixel_mm
        pitch = f"{1000 * x:g} µm" if abs(x - y) < 1e-9 else f"{1000 * x:g} × {1000 * y:g} µm"
        z = f", z {self.z_mm[0, 0]:g} to {self.z_mm[-1, 1]:g} mm" if len(self) else ""
        return f"<LayerStack of {len(self)} layers, {self.width} × {self.height} px of {pitch}{z}>"

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        """(layers, H, W) bool: all pixels. Raises InputError for over LARGEST_ARRAY of them, and for copy=False."""
        shape = len(self), self.height, self.width
        if math.prod(shape) > LARGEST_ARRAY:
            raise InputError(
                f"{len(self)} layers of {self.width} × {self.height} px are too many for one array"
                f" ({math.prod(shape) / 1e9:.1f} GB); take some, stack[10:20], or one at a time, stack[10].image()"
            )
        if copy is False:
            raise InputError("layers are packed bits, made when asked for: an array of them is always new")
        out = np.empty(shape, np.bool_)
        for k, image in enumerate(self.each(Layer.image, once=True)):
            out[k] = image
        return out if dtype is None else out.astype(dtype)

    @overload
    def __getitem__(self, index: int) -> Layer: ...
    @overload
    def __getitem__(self, index: slice) -> LayerStack: ...
    def __getitem__(self, index: int | slice) -> Layer | LayerStack:
        if isinstance(index, slice):
            chosen = range(len(self))[index]
            if chosen.step < 0:
                raise InputError("a stack is ordered from the bottom: slice it with a positive step")
            make = self.make
            repeats = self.repeats[index].copy() if self.repeats is not None and chosen.step == 1 else None
            if repeats is not None and len(repeats):
                repeats[0] = False
            return replace(self, z_mm=self.z_mm[index], make=_Chosen(make, chosen), repeats=repeats, container=None)
        if not -len(self) <= index < len(self):
            raise IndexError(f"layer {index} of {len(self)}")
        return self.make(index % len(self))

    def __iter__(self) -> Iterator[Layer]:
        return self.each(lambda layer: layer)

    def map(self, change: Callable[[Layer], Layer], *, pixels_only: bool = False) -> LayerStack:
        """The stack whose layers are `change` of these, computed when asked for. The frame and z's stay.

        pixels_only  `change` makes equal pixels of equal pixels, at any height: what repeats still does
        """
        return replace(self, make=_Changed(self.make, change), repeats=self.repeats if pixels_only else None)

    def with_workers(self, workers: int) -> LayerStack:
        """The same layers, made by so many threads (0: one per core)."""
        return replace(self, workers=workers)

    def each(self, use: Callable[[Layer], Result], *, once: bool = False) -> Generator[Result]:
        """Yield `use` of every layer in order. Layers are made and used in threads, and at most two per
        worker are ahead of the reader (of small ones two megabytes each), so memory depends on the layer's size,
        not on their number.

        once  for a `use` that looks at pixels only: layers that repeat the one below yield its result again
        """
        workers = min(self.workers or processors(), len(self))
        repeats = self.repeats if once and self.repeats is not None else np.zeros(len(self), np.bool_)
        first_alike = np.maximum.accumulate(np.where(repeats, 0, np.arange(len(self)))).tolist()
        make = self.make
        if workers < 2:
            for i in range(len(self)):
                if not repeats[i]:
                    result = use(make(i))
                yield result
            return
        yield from in_threads(lambda i: use(make(i)), first_alike, workers, self._at_once())

    def each_with_neighbours(
        self, use: Callable[[int, Sequence[Layer], Layer, Sequence[Layer]], Result], *, below: int, above: int
    ) -> Generator[Result]:
        """Yield use(index, layers below, layer, layers above) of every layer in order, all from the bottom up.

        At the ends there are fewer. Every layer is made once; threads, order and memory are as in `each`.
        """
        workers = min(self.workers or processors(), len(self))
        made = Remembered(self.make, below + above + 3 * workers + 1)

        def work(i: int) -> Result:
            first, stop = max(i - below, 0), min(i + above + 1, len(self))
            around = [made(k) for k in range(first, stop)]
            return use(i, around[: i - first], around[i - first], around[i - first + 1 :])

        yield from in_threads(work, list(range(len(self))), workers, 1)

    def _at_once(self) -> int:
        """How many layers in a row a thread may take: of small ones some."""
        return max(1, min(MOST_AT_ONCE, AT_ONCE_BYTES // (8 * self.height * words_for(self.width))))

    def volume_mm3(self) -> float:
        """Volume of all layers, each as high as it is; of several exposures at one height the first counts."""
        counts = np.fromiter(self.each(Layer.count_px), np.float64, len(self))
        return float(counts @ self.heights_mm()) * self.pixel_mm[0] * self.pixel_mm[1]

    def heights_mm(self) -> NDArray[np.float64]:
        """(layers,) height of each layer, 0 of what is exposed once more at the same height."""
        heights = self.z_mm[:, 1] - self.z_mm[:, 0]
        heights[1:][(self.z_mm[1:] == self.z_mm[:-1]).all(axis=1)] = 0.0
        return heights


def pitch_mm(pixel_mm: float | tuple[float, float]) -> tuple[float, float]:
    """(x, y) pitch of a pitch given as one number or two. Raises InputError unless both are above 0."""
    return one_or_two(pixel_mm, "pixel pitch", "mm")


def layer_bounds_mm(count: int, layer_mm: float, first_layer_mm: float | None = None) -> NDArray[np.float64]:
    """(count, 2): bottom and top of `count` layers from z = 0, the first of its own height if given."""
    first = layer_mm if first_layer_mm is None else first_layer_mm
    for value in (layer_mm, first):
        if not 0 < value < np.inf:
            raise InputError(f"layer height {value} mm: it must be above 0")
    tops = np.round(first + layer_mm * np.arange(count), 9)
    return np.stack([np.concatenate([[0.0], tops[:-1]]), tops], axis=1)


def _bounds(z_mm: NDArray[np.float64], index: int) -> tuple[float, float]:
    bottom, top = z_mm[index].tolist()
    return bottom, top


def _size(shape: tuple[int, ...]) -> str:
    return " × ".join(str(n) for n in reversed(shape)) or "a single value"


def layer_maker(rows_of: Callable[[int], Any], width: int, z_mm: NDArray[np.float64]) -> Callable[[int], Layer]:
    """`make` for a source that gives packed rows by index."""
    return _Made(rows_of, width, z_mm)


# How layers are made is a value, not a closure, so that stacks can be pickled: what is pickled is how to make the
# layers, not the layers (of a stack that was made from images they are all there is).


@dataclass(frozen=True, eq=False)
class _Made:
    rows_of: Callable[[int], Any]
    width: int
    z_mm: NDArray[np.float64]

    def __call__(self, index: int) -> Layer:
        return Layer(self.rows_of(index), self.width, _bounds(self.z_mm, index))


@dataclass(frozen=True, eq=False)
class _Chosen:
    make: Callable[[int], Layer]
    chosen: range

    def __call__(self, index: int) -> Layer:
        return self.make(self.chosen[index])


@dataclass(frozen=True, eq=False)
class _Changed:
    make: Callable[[int], Layer]
    change: Callable[[Layer], Layer]

    def __call__(self, index: int) -> Layer:
        return self.change(self.make(index))
