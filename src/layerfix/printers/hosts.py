"""A shipped printer by what a slicer or a job says of its own: names of machines, nozzle, pixels, sizes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from layerfix.printers.index import Entry, entries, squeezed

# Two panels are the same if their sides differ by less: makers round to 0.1 mm, and panels of one pixel count differ
# by 1 % at least (68.04 and 67.68 mm of 1440 px would be taken for one at more).
SAME_SIZE = 0.004
SHORTEST = 3  # letters and digits of a model that is recognised inside a longer name without its maker's


def find_by_host(
    names: str | Iterable[str] = (),
    *,
    nozzle_mm: float | None = None,
    pixels: tuple[int, int] | None = None,
    size_mm: Sequence[float] | None = None,
) -> list[Entry]:
    """The shipped printers that a host's own settings mean, the likeliest first; none if nothing tells.

    names      PrusaSlicer's or OrcaSlicer's `printer_settings_id` and `printer_model`, Cura's machine name, the
               machine of a job file
    nozzle_mm  of the nozzle; found in the names ("… 0.4 nozzle") if it is not given
    pixels     (columns, rows) of a job's images, either way round
    size_mm    of that panel, as `pixels`
    Pixels and size decide between several that are called so, and alone if no name tells; where they contradict the
    name, there is none.
    """
    given = [names] if isinstance(names, str) else [name for name in names if name]
    nozzle_mm = nozzle_mm or next(filter(None, map(nozzle_in, given)), None)
    known = [e for e in entries() if nozzle_mm is None or e.nozzle_mm is None or abs(e.nozzle_mm - nozzle_mm) < 1e-6]
    if pixels is not None:
        known = [entry for entry in known if entry.pixels is not None]
    named = next(filter(None, (_named(known, name) for name in given)), [])
    alike = [entry for entry in known if pixels is not None and _has_panel(entry, pixels, size_mm)]
    both = [entry for entry in named if entry in alike]
    return both or ([] if named and alike else named or alike)


def nozzle_in(name: str) -> float | None:
    """0.4 of "Bambu Lab P1S 0.4 nozzle", "… HF0.4 nozzle" and "… (0.4 mm)"; None of names without."""
    found = re.search(r"(?<![\d.])(0\.\d{1,2}|1\.\d)(?:\s*mm)?\s*(?:nozzle|\)|$)", name, re.I)
    return float(found[1]) if found else None


def _named(known: Iterable[Entry], name: str) -> list[Entry]:
    """Those that are called so; else those with the longest model that the name holds."""
    known = list(known)
    asked = squeezed(name)
    if not asked:
        return []
    exact = [
        e for e in known if asked in {squeezed(own) for own in (*e.slicer_names, e.title, e.name, _bare(e.model))}
    ]
    if exact:
        return exact
    asked = squeezed(_bare(name)).replace("+", "").replace("nozzle", "")
    held: dict[int, list[Entry]] = {}
    for entry in known:
        model = squeezed(_bare(entry.model)).replace("+", "").replace("hfnozzle", "hf")
        maker = squeezed(entry.maker.partition(" ")[0])
        enough = len(model) >= SHORTEST or maker in squeezed(name)
        if model and enough and model in asked:
            held.setdefault(len(model), []).append(entry)
    return held[max(held)] if held else []


def _bare(model: str) -> str:
    """ "Original Prusa MK4S" as slicers' settings call it: MK4S."""
    return re.sub(r"^(original )?prusa |&", "", model, flags=re.I)


def _has_panel(entry: Entry, pixels: tuple[int, int], size_mm: Sequence[float] | None) -> bool:
    """Whether its panel has these pixels and this size, upright or lying."""
    if entry.pixels is None or sorted(entry.pixels) != sorted(pixels):
        return False
    if size_mm is None or entry.build_mm is None:
        return True
    pairs = zip(sorted(entry.build_mm[:2]), sorted(size_mm[:2]), strict=True)
    return all(abs(one / other - 1) < SAME_SIZE for one, other in pairs if other > 0)
