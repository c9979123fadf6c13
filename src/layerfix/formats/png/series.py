"""A series of layer images by the names of its files: its order, and what is amiss with it.

Files are ordered by the numbers in their names (``9.png`` before ``10.png``). What would make another stack than the
one that was exported is refused (two images of one number, layers in two folders, a layer that is a JPEG); what may
be meant so is told (numbers that are missing, names unlike the others').
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import PurePosixPath
from typing import Any

from layerfix.errors import InputError
from layerfix.formats.text_values import abridged
from layerfix.units import counted

NUMBER = re.compile(r"([0-9]+)")
LONGEST_NUMBER = 18  # digits that are compared as numbers; longer ones are no layer's
PLACES_TOLD = 3
OTHER_IMAGES = (
    ".avif", ".bmp", ".gif", ".heic", ".j2k", ".jp2", ".jpe", ".jpeg", ".jpg", ".jxl", ".pbm", ".pgm", ".pnm", ".ppm",
    ".svg", ".tga", ".tif", ".tiff", ".webp",
)  # fmt: skip
IMAGES = (".png", *OTHER_IMAGES)


def numeric_order(name: str) -> tuple[Any, ...]:
    """Sort key that compares runs of digits as numbers: ``layer9`` before ``layer10``."""
    parts = NUMBER.split(name)
    # Of two numbers the longer is the larger; int() takes no more than 4,300 digits.
    bare = [part.lstrip("0") if k % 2 else part.lower() for k, part in enumerate(parts)]
    return tuple((0, len(part), part) if k % 2 else (1, 0, part) for k, part in enumerate(bare))


def series_of(where: str, files: Iterable[str]) -> tuple[list[str], tuple[str, ...]]:
    """(the PNG files among `files` in the order of layers, what to tell of them).

    files  names, with folders in front of them in an archive
    Raises InputError for two images of one number, for layers in several folders, and for an image that is no PNG
    though its name is like the layers'.
    """
    # The Finder writes shadows of files: ._1.png, and __MACOSX/._1.png.
    seen = [name for name in files if not PurePosixPath(name).name.startswith("._")]
    names = sorted((name for name in seen if name.lower().endswith(".png")), key=numeric_order)
    _check_folders(where, names)
    shapes = {_shape(name) for name in names}
    strange = sorted((name for name in seen if name.lower().endswith(OTHER_IMAGES)), key=numeric_order)
    for name in strange if names else ():
        if NUMBER.search(PurePosixPath(name).name) and _shape(name) in shapes:
            pair = f"{abridged(name)} is no PNG image, as {abridged(names[0])} is"
            raise InputError(f"{where}: {pair}; save all layers as PNG")
    notes = [*gaps_in(where, names), *unlike_in(names)]
    if names and strange:
        notes.append(f"not read, since no PNG: {listed(strange)}")
    return names, tuple(notes)


def gaps_in(where: str, names: Sequence[str], said: int | None = None, job: str = "") -> tuple[str, ...]:
    """A word about numbers that are missing in a series, in order.

    said  how many layers the job says that there are; None if it does not
    job   what all names begin with; digits in it are no layer's number
    A series that counts in steps (0, 10, 20 …) misses nothing. Raises InputError for two layers of one number.
    """
    for one, other in pairwise(names):
        if numeric_order(one) == numeric_order(other):
            raise InputError(
                f"{where}: {abridged(one)} and {abridged(other)} are of one number; a layer is one image"
            )
    words = []
    counts = _counts([name.removeprefix(job) for name in names])
    steps = [after - before for before, after in pairwise(counts)]
    often = [step for step, count in Counter(steps).items() if count > 1] or steps
    usual = min(often) if len(steps) > 1 else 1
    missing = [k for k, step in enumerate(steps) if step > usual]
    if steps and counts[0] > max(usual, 1):
        words.append(f"the first image is {abridged(names[0])}: it is taken for the lowest layer")
    if missing:
        between = [f"{abridged(names[k])} and {abridged(names[k + 1])}" for k in missing[:PLACES_TOLD]]
        more = f" and in {len(missing) - PLACES_TOLD} more places" if len(missing) > PLACES_TOLD else ""
        places = ", ".join(f"between {place}" for place in between)
        words.append(f"numbers are missing {places}{more}: the layers follow each other as if none were")
    if said is not None and said != len(names):
        words.append(f"the job says that it has {counted(said, 'layer')}; there are images of {len(names)}")
    return tuple(words)


def unlike_in(names: Sequence[str]) -> tuple[str, ...]:
    """A word about names unlike the others': previews, or a second series. Names without numbers are all unlike."""
    shapes = Counter(_shape(name) for name in names)
    usual, count = shapes.most_common(1)[0] if shapes else ("", 0)
    odd = [name for name in names if _shape(name) != usual]
    if count < 2 or not odd:
        return ()
    return (f"read as layers though their names are unlike the others': {listed(odd)}",)


def _counts(names: Sequence[str]) -> list[int]:
    """The number of each layer: the first run of digits that tells them all apart; none if no run does."""
    runs = [NUMBER.findall(name) for name in names]
    if len({len(found) for found in runs}) != 1:
        return []
    for column in zip(*runs, strict=True):
        if max(map(len, column)) > LONGEST_NUMBER:
            continue
        numbers = [int(digits) for digits in column]
        if all(before < after for before, after in pairwise(numbers)):
            return numbers
    return []


def _shape(name: str) -> str:
    """A name without what differs between layers: its numbers, its suffix, capitals."""
    return NUMBER.sub("#", name.rpartition(".")[0].lower())


def _check_folders(where: str, names: Sequence[str]) -> None:
    folders = dict.fromkeys(str(PurePosixPath(name).parent) for name in names)
    if len(folders) > 1:
        shown = listed(["the top" if folder == "." else f"{folder}/" for folder in folders])
        raise InputError(f"{where}: has images in {len(folders)} folders ({shown}); the layers of a part lie in one")


def listed(names: Sequence[str]) -> str:
    """The first few of some names, and how many more there are."""
    more = f" and {counted(len(names) - PLACES_TOLD, 'other')}" if len(names) > PLACES_TOLD else ""
    return ", ".join(abridged(name) for name in names[:PLACES_TOLD]) + more
