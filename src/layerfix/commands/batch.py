"""Many files corrected as one call, here or on the workers of a Dask scheduler: one task a file.

What a worker gets is the file itself, and what comes back is the output: workers need no disk in common with us, and
what is written here is what a run here would have written, to the byte. A file that cannot be corrected does not stop
the others.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from layerfix.commands.project import fix_file as fix
from layerfix.commands.summary import Summary
from layerfix.errors import InputError, LayerfixError, OutputError
from layerfix.files import check_input, check_target, whole_file, whole_folder
from layerfix.formats import check_before, find_format

if TYPE_CHECKING:
    from layerfix.commands.options import Options

Content = dict[str, bytes]  # of a file, under its name; of a folder, under the paths in it


@dataclass(frozen=True)
class Batch:
    """What came of it, in the order of the sources: summaries of those corrected, and why others were not."""

    done: tuple[Summary, ...]
    failed: tuple[tuple[str, str], ...]


def fix_all(
    sources: Sequence[Path],
    folder: Path,
    options: Options,
    suffix: str | None = None,
    scheduler: object = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Batch:
    """Correct every source into `folder`, under its own name; the folder is made if it is not there.

    suffix     of what is written (".3mf", ".zip", "" for folders); None: as the source's, if that is a job or images,
               else as the printer's, else .3mf for nozzles and .zip for panels
    scheduler  an address, or a distributed.Client; None: one after the other, here
    progress   is called with (files done, files in all)
    Raises InputError and OutputError before any work for what can be known: unreadable or equally named sources, and
    existing targets without --force.
    """
    pairs = _pairs(sources, folder, options, suffix)
    done: dict[int, Summary] = {}
    failed: dict[int, str] = {}
    with _made(folder):
        for k, found in (_here if scheduler is None else _on(scheduler))(pairs, options):
            if isinstance(found, Summary):
                done[k] = found
            else:
                failed[k] = found
            progress(len(done) + len(failed), len(pairs))
    return Batch(tuple(done[k] for k in sorted(done)), tuple((str(pairs[k][0]), failed[k]) for k in sorted(failed)))


def _pairs(sources: Sequence[Path], folder: Path, options: Options, suffix: str | None) -> list[tuple[Path, Path]]:
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder}: is a file; the results go to a folder")
    if options.run.picture is not None:
        raise InputError("--picture: is of one part; leave it out, or correct one file at a time")
    if options.run.report is not None:
        raise InputError("--report: is of one part; leave it out, or correct one file at a time")
    pairs: list[tuple[Path, Path]] = []
    names: dict[str, Path] = {}
    for source in sources:
        check_input(source)
        target = folder / (source.stem + _suffix(source, options, suffix))
        if target.name in names:
            raise OutputError(f"{source} and {names[target.name]}: both would become {target}; rename one")
        names[target.name] = source
        check_before(target, options.printer, options.output)
        if folder.is_dir():
            check_target(target, force=options.run.force)
        pairs.append((source, target))
    return pairs


def _suffix(source: Path, options: Options, suffix: str | None) -> str:
    if suffix is not None:
        return suffix if not suffix or suffix.startswith(".") else f".{suffix}"
    found, _ = find_format(source)
    if found.mesh is None:
        return source.suffix
    printer = options.printer
    if printer is not None and printer.format and printer.format != ".gcode":
        from layerfix.formats.table import FORMATS

        if any(printer.format in row.suffixes and "layers" in row.writers for row in FORMATS):
            return printer.format
    return ".3mf" if printer is not None and printer.nozzle_mm is not None else ".zip"


@contextmanager
def _made(folder: Path) -> Iterator[None]:
    """The folder for results: one that was made for them goes again if there are none."""
    new = not folder.is_dir()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        reason = (problem.strerror or str(problem)).lower()
        raise OutputError(f"{folder}: the folder could not be made: {reason}") from problem
    try:
        yield
    finally:
        if new and not any(folder.iterdir()):
            folder.rmdir()


def _here(pairs: Sequence[tuple[Path, Path]], options: Options) -> Iterator[tuple[int, Summary | str]]:
    for k, (source, target) in enumerate(pairs):
        try:
            yield k, fix(source, target, options)
        except LayerfixError as problem:
            yield k, str(problem)


def _on(scheduler: object) -> Callable[[Sequence[tuple[Path, Path]], Options], Iterator[tuple[int, Summary | str]]]:
    """`_here` on a cluster."""
    from layerfix import __version__
    from layerfix.orientation.cluster import RETRIES, as_ready, checked, connected, send

    def run(pairs: Sequence[tuple[Path, Path]], options: Options) -> Iterator[tuple[int, Summary | str]]:
        client: Any = connected(scheduler) if isinstance(scheduler, str) else scheduler
        try:
            checked(client)
            free = options.correction.keep_out
            kept = content(free) if free is not None else None
            waiting = {}
            for k, (source, target) in enumerate(pairs):
                future = send(client, corrected, __version__, source.name, content(source), target.name, options,
                              free.name if free is not None else "", kept, pure=False, retries=RETRIES)  # fmt: skip
                waiting[future] = k
            for future in as_ready(client, waiting):
                k = waiting.pop(future)
                source, target = pairs[k]
                yield k, _written(future, source, target, options)
        finally:
            if isinstance(scheduler, str):
                client.close(timeout=2)

    return run


def _written(future: Any, source: Path, target: Path, options: Options) -> Summary | str:
    try:
        summary, output = future.result()
    except LayerfixError as problem:
        return str(problem)
    except Exception as problem:  # whatever a worker dies of
        return f"{source}: a worker could not correct it: {' '.join(str(problem).split())[:200]}"
    if isinstance(summary, str):
        return summary.replace("{source}", str(source)).replace("{target}", str(target))
    try:
        put(target, output, force=options.run.force)
    except LayerfixError as problem:
        return str(problem)
    done: Summary = replace(summary, source=str(source), target=str(target))
    return done


def content(path: Path) -> Content:
    """A file's or a folder's."""
    if path.is_dir():
        return {str(p.relative_to(path)): p.read_bytes() for p in sorted(path.rglob("*")) if p.is_file()}
    return {"": path.read_bytes()}


def put(path: Path, what: Content, *, force: bool) -> None:
    """Write what `content` read, whole or not at all."""
    if set(what) == {""}:
        with whole_file(path, force=force) as file:
            file.write(what[""])
        return
    with whole_folder(path, force=force) as folder:
        _fill(folder, what)


def _fill(folder: Path, what: Content) -> None:
    for name, data in what.items():
        place = folder / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(data)


def corrected(
    version: str, name: str, what: Content, target: str, options: Options, free_name: str, free: Content | None
) -> tuple[Summary | str, Content]:
    """What a worker does: `fix` in a folder of its own. An error is its message, {source} being the file's place."""
    from layerfix.orientation.engines import check_version

    check_version(version)
    with tempfile.TemporaryDirectory(prefix="layerfix-") as place:
        base = Path(place)
        (base / "in").mkdir()
        (base / "free").mkdir()
        (base / "out").mkdir()
        source, goal = base / "in" / name, base / "out" / target
        _place(source, what)
        if free is not None:
            _place(base / "free" / free_name, free)
            options = replace(options, correction=replace(options.correction, keep_out=base / "free" / free_name))
        try:
            summary = fix(source, goal, options)
        except LayerfixError as problem:
            return str(problem).replace(str(source), "{source}").replace(str(goal), "{target}"), {}
        return summary, content(goal)


def _place(path: Path, what: Content) -> None:
    if set(what) == {""}:
        path.write_bytes(what[""])
    else:
        path.mkdir()
        _fill(path, what)
