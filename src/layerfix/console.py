"""Messages on any console: one line each, in letters that it has.

Windows writes to pipes and files in cp1252, older consoles use cp437, some have ASCII alone; a sign that is missing
there must not end in a traceback.
"""

from __future__ import annotations

import codecs
import sys
import unicodedata
from encodings import ascii
from typing import TextIO

# What the messages use, and how it is written where it is missing.
PLAIN = {
    "×": "x", "²": "2", "³": "3", "µ": "u", "μ": "u", "→": "->", "←": "<-", "∘": "o", "⊕": "+", "⊖": "-", "…": "...",
    "–": "-", "—": "-", "−": "-", "≤": "<=", "≥": ">=", "±": "+-", "°": " deg", "·": ".", "‘": "'", "’": "'",
    "“": '"', "”": '"', "∪": "|", "⊆": "<=", "█": "#", "θ": "theta", "ψ": "psi", "•": "*", "\N{NO-BREAK SPACE}": " ",
}  # fmt: skip
HANDLER = "layerfix.plain"
LONGEST = 2000  # characters of a message; names in hostile files have up to 65,535


def plain(text: str) -> str:
    """Text in ASCII: the signs of our messages by their look, letters without accents, the rest as ``\\u2603``."""
    return "".join(_plain(letter) for letter in text)


def _plain(letter: str) -> str:
    if letter.isascii():
        return letter
    if letter in PLAIN:
        return PLAIN[letter]
    bare = unicodedata.normalize("NFKD", letter).encode("ascii", "ignore").decode()
    return bare or letter.encode("ascii", "backslashreplace").decode()


def _replaced(problem: UnicodeError) -> tuple[str, int]:
    """An error handler for encoders: what the encoding lacks, in ASCII."""
    if not isinstance(problem, UnicodeEncodeError):
        raise problem
    return plain(problem.object[problem.start : problem.end]), problem.end


def _search(name: str) -> codecs.CodecInfo | None:
    """ASCII by another name: click takes a stream that says "ascii" for misconfigured, and writes UTF-8 to it."""
    if name.replace("-", "_") != "plain_ascii":
        return None
    return codecs.CodecInfo(codecs.ascii_encode, codecs.ascii_decode, incrementalencoder=ascii.IncrementalEncoder,
                            incrementaldecoder=ascii.IncrementalDecoder, name="plain-ascii")  # fmt: skip


def speak_plainly(*streams: TextIO) -> None:
    """From now on the streams (stdout and stderr if none are given) replace what their encoding lacks."""
    codecs.register_error(HANDLER, _replaced)
    codecs.register(_search)
    for stream in streams or (sys.stdout, sys.stderr):
        if not hasattr(stream, "reconfigure"):  # closed, or somebody's own
            continue
        is_ascii = codecs.lookup(stream.encoding).name == "ascii"
        stream.reconfigure(encoding="plain-ascii" if is_ascii else None, errors=HANDLER)


def one_line(text: object) -> str:
    """A message as one line: line breaks and control characters from names and files as ``\\n``, ``\\x1b``; no longer
    than LONGEST.
    """
    letters = str(text)
    if len(letters) > LONGEST:
        letters = f"{letters[: LONGEST // 2]} … {letters[-LONGEST // 2 :]}"
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in letters)
