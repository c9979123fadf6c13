"""What every reader of a mesh file gives, and the words they share."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from layerfix.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.mesh.triangles import Mesh

HEAD_BYTES = 16384  # of a file, to recognise it by
LONGEST_NUMBER = 100  # characters; a number needs 25
MOST_TRIANGLES = 2**31 // 3 - 1  # what 32-bit numbers of corners reach


class Read(NamedTuple):
    """A mesh in the file's unit, z up, and that unit ("mm", "m" …), None where the file does not say."""

    mesh: Mesh
    unit: str | None


def unreadable(path: Path, kind: str, reason: str) -> InputError:
    """The error of a file that is not what it seems to be."""
    return InputError(f"{path}: not a readable {kind} mesh: {reason}")


def fans(counts: NDArray[np.int64], corners: NDArray[np.int64]) -> NDArray[np.int64]:
    """(m, 3) triangles of polygons given as corners per face (f,) and all corners one after the other.

    Each polygon of n corners becomes n - 2 triangles; a plane cuts a fan of them to the same outline as the polygon,
    concave or not, since the winding numbers of what overlaps cancel. Faces of fewer than three corners are left out.
    """
    starts = np.cumsum(counts) - counts
    pieces = np.maximum(counts - 2, 0)
    face = np.repeat(np.arange(len(counts)), pieces)
    k = np.arange(len(face)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    first = starts[face]
    return np.stack([corners[first], corners[first + k + 1], corners[first + k + 2]], axis=1)


def several(count: int, one: str, many: str | None = None) -> str:
    """``1 beam``, ``3 beams``."""
    return f"{count} {one}" if count == 1 else f"{count} {many or one + 's'}"


def numbers(text: bytes) -> NDArray[np.float64]:
    """All numbers of a text, separated by white space. Raises ValueError naming the first word that is none."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # numpy's way to say that it stopped early: counted below
        try:
            found = np.fromstring(text, np.float64, sep=" ")
        except ValueError:
            found = np.empty(0)
    words = count_words(text)
    if len(found) != words:
        word = next((w for w in text.split() if not is_number(w)), b"?")
        raise ValueError(f"'{shown(word)}' is no number")
    return found


def count_words(text: bytes) -> int:
    """Words separated by white space, counted without making them."""
    letters = np.frombuffer(text, np.uint8)
    ink = np.concatenate([[False], (letters != 32) & ((letters < 9) | (letters > 13))])
    return int(np.count_nonzero(ink[1:] & ~ink[:-1]))


def is_number(text: bytes) -> bool:
    """Whether a word is a number as people and programs write them."""
    try:
        float(text)
    except ValueError:
        return False
    return len(text) <= LONGEST_NUMBER


def shown(word: bytes) -> str:
    """Enough of a wrong word to find it."""
    return word[:20].decode("latin-1") + ("…" if len(word) > 20 else "")
