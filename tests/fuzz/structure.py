"""Mutations of what files are made of: entries, chunks, words, numbers. Pure functions of bytes and a seed."""

from __future__ import annotations

import io
import json
import random
import re
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable

# Values that have hurt: limits of integers, no numbers, more digits than int() takes, signs and points astray.
NUMBERS = [
    b"0", b"-0", b"-1", b"1e999", b"-1e999", b"nan", b"inf", b"1e-320", b"1.2.3", b"4294967295", b"2147483648",
    b"9" * 400, b"9" * 5000, b"1" + b"0" * 200, b"", b".", b"-", b"1e", b"0x10", b"65536", b"1_0",
]  # fmt: skip
WORDS = [
    b"[" * 5000, b'{"a":' * 3000, b"\n" * 9000, b"1" * 9000, b" " * 9000, b"\0", b"\xff\xfe", b"=", b"\r", b"%s", 
    b"{{{",
    b"\xe2\x80\xae", b"../", b"<!--", b"&lol;", b"null", b"true",
]  # fmt: skip
INTEGERS = [0, 1, 2, 3, 7, 127, 128, 255, 256, 32767, 65535, 65536, 1 << 24, (1 << 31) - 1, 1 << 31, (1 << 32) - 1]
_NUMBER = re.compile(rb"[-+]?[0-9]+\.?[0-9]*(?:[eE][-+]?[0-9]+)?")


def text(data: bytes, rng: random.Random) -> bytes:
    """One number replaced, a word put in, a line doubled, moved or taken away."""
    numbers = list(_NUMBER.finditer(data[:100_000]))
    choice = rng.randrange(5)
    if choice < 2 and numbers:
        found = rng.choice(numbers)
        return data[: found.start()] + rng.choice(NUMBERS) + data[found.end() :]
    if choice == 2:
        at = rng.randint(0, len(data))
        return data[:at] + rng.choice(WORDS + NUMBERS) + data[at:]
    lines = data.split(b"\n")
    k = rng.randrange(len(lines))
    if choice == 3:
        lines[k:k] = [lines[rng.randrange(len(lines))]] * rng.choice([1, 2, 500])
    else:
        del lines[k]
    return b"\n".join(lines)


def binary(data: bytes, rng: random.Random) -> bytes:
    """A field of 1, 2, 4 or 8 bytes set to a value that is a limit, or an f32 that is none; or the end cut off."""
    raw = bytearray(data)
    if len(raw) < 9:
        return data
    at = rng.randrange(min(len(raw) - 8, rng.choice([64, 512, len(raw)])))
    choice = rng.randrange(5)
    if choice == 4:
        return bytes(raw[: rng.randint(0, len(raw))])
    if choice == 3:
        value = rng.choice([float("nan"), float("inf"), -1.0, 0.0, 1e38, 1e-40])
        struct.pack_into(rng.choice("<>") + "f", raw, at, value)
    else:
        size = rng.choice("BHIQ")
        limit = (1 << 8 * struct.calcsize(size)) - 1
        struct.pack_into(rng.choice("<>") + size, raw, at, min(rng.choice(INTEGERS), limit))
    return bytes(raw)


def png(data: bytes, rng: random.Random) -> bytes:
    """A chunk changed, doubled, dropped or filled, checksums right; image data inflated and deflated again."""
    chunks, at = [], 8
    while at + 12 <= len(data):
        (size,) = struct.unpack_from(">I", data, at)
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + size]))
        at += 12 + size
    if not chunks:
        return binary(data, rng)
    k = rng.randrange(len(chunks))
    kind, body = chunks[k]
    choice = rng.randrange(6)
    if choice == 0 and kind == b"IDAT":
        try:
            body = zlib.compress(binary(zlib.decompress(body), rng))
        except zlib.error:
            body = binary(body, rng)
        chunks[k] = kind, body
    elif choice == 1:
        chunks.insert(rng.randrange(len(chunks) + 1), chunks[k])
    elif choice == 2:
        del chunks[k]
    elif choice == 3:
        note = json.dumps({"pixel_mm": [0.05, 0.05], "origin_mm": [0, 1], "z_mm": [0, 0.05]}).encode()
        chunks.insert(1, (b"tEXt", b"layerfix\0" + text(note, rng)))
    elif choice == 4:
        chunks.insert(1, (b"pHYs", struct.pack(">IIB", rng.choice(INTEGERS), rng.choice(INTEGERS), 1)))
    else:
        chunks[k] = kind, binary(body, rng)
    parts = (struct.pack(">I", len(b)) + t + b + struct.pack(">I", zlib.crc32(b, zlib.crc32(t))) for t, b in chunks)
    return data[:8] + b"".join(parts)


def glb(data: bytes, rng: random.Random) -> bytes:
    """Its JSON changed as text (kinds, counts, offsets, indices) or its binary chunk, the lengths right or wrong."""
    if data[:4] != b"glTF" or len(data) < 20:
        return binary(data, rng)
    (size,) = struct.unpack_from("<I", data, 12)
    tree, rest = data[20 : 20 + size], data[20 + size :]
    if rng.random() < 0.25 and len(rest) > 16:
        rest = rest[:8] + binary(rest[8:], rng)
    else:
        try:
            parsed = json.loads(tree)
            _change(parsed, rng)
            tree = json.dumps(parsed).encode()
        except ValueError:
            tree = text(tree, rng)
    tree += b" " * (-len(tree) % 4)
    total = 20 + len(tree) + len(rest)
    if rng.random() < 0.05:
        total = rng.choice(INTEGERS)
    return struct.pack("<4sIIII", b"glTF", 2, total, len(tree), 0x4E4F534A) + tree + rest


def _change(value: object, rng: random.Random) -> None:
    """One leaf of a JSON tree replaced, one member dropped or copied elsewhere."""
    places: list[tuple[dict[str, object] | list[object], object]] = []

    def walk(node: object) -> None:
        items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
        for key, child in list(items):
            places.append((node, key))  # type: ignore[arg-type]  # a node with items is one of the two
            walk(child)

    walk(value)
    if not places:
        return
    holder, key = rng.choice(places)
    values: list[object] = [
        *INTEGERS,
        -1,
        0.5,
        "",
        "x",
        None,
        True,
        [],
        {},
        [0],
        [1e308] * 16,
        10**30,
        "VEC3",
        5125,
        5,
    ]
    if rng.random() < 0.2:
        del holder[key]  # type: ignore[attr-defined]  # of a dict or a list, by its own key
    elif rng.random() < 0.3:
        other, place = rng.choice(places)
        holder[key] = other[place]  # type: ignore[index]
    else:
        holder[key] = rng.choice(values)  # type: ignore[index]


def archive(data: bytes, rng: random.Random) -> bytes:
    """One entry changed by its kind, doubled, dropped, renamed or filled; the archive put together again."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as source:
            entries = [(i.filename, source.read(i)) for i in source.infolist() if i.file_size < 1 << 20]
    except Exception:  # whatever zipfile makes of a file that is broken already
        return binary(data, rng)
    if not entries:
        return binary(data, rng)
    k = rng.randrange(len(entries))
    name, body = entries[k]
    choice = rng.randrange(8)
    if choice == 0:
        entries.insert(k, (name, body))
    elif choice == 1:
        del entries[k]
    elif choice == 2:
        entries[k] = text(name.encode("utf-8", "replace"), rng).decode("utf-8", "replace")[:60_000] or "x", body
    else:
        change = png if body[:4] == b"\x89PNG" else glb if body[:4] == b"glTF" else text
        entries[k] = name, change(body, rng)
    out = io.BytesIO()
    with warnings.catch_warnings(action="ignore"), zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as target:
        for name, body in entries:
            target.writestr(zipfile.ZipInfo(name, (2024, 1, 1, 0, 0, 0)), body, zipfile.ZIP_DEFLATED)
    return binary(out.getvalue(), rng) if rng.random() < 0.1 else out.getvalue()


def changed(data: bytes, rng: random.Random) -> bytes:
    """By what the file looks like."""
    for head, change in ((b"PK", archive), (b"glTF", glb), (b"\x89PNG", png)):
        if data.startswith(head):
            return change(data, rng)
    is_text = data[:200].isascii() and b"\0" not in data[:200]
    return (text if is_text else binary)(data, rng)


def mutator(kind: str) -> Callable[[bytes, int, int], bytes]:
    """For atheris: ours three times of four, else libFuzzer's own."""
    import atheris

    def mutate(data: bytes, max_size: int, seed: int) -> bytes:
        rng = random.Random(seed)
        if rng.random() < 0.25:
            return bytes(atheris.Mutate(data, max_size))
        for _ in range(rng.choice([1, 1, 1, 2, 4])):
            data = changed(data, rng)
        return data[:max_size]

    return mutate
