"""Messages on consoles that lack some of their signs, and messages that hostile names try to break."""

from __future__ import annotations

import ast
import io
import subprocess
import sys
from pathlib import Path

import pytest

import layerfix
from layerfix.console import LONGEST, PLAIN, one_line, plain, speak_plainly
from tests.making import environment, thin_part, write_stl

ENCODINGS = ["cp1252", "cp437", "ascii", "cp850", "latin-1", "shift_jis", "utf-8"]
every_encoding = pytest.mark.parametrize("encoding", ENCODINGS)


def run(*args: object, encoding: str, cwd: Path) -> tuple[int, str, str]:
    """`layerfix` with both streams in an encoding; every byte that it writes must be of that encoding."""
    done = subprocess.run(
        [sys.executable, "-m", "layerfix", *map(str, args)], cwd=cwd, capture_output=True, timeout=120, check=False,
        env=environment(PYTHONIOENCODING=encoding, PYTHONUTF8="0"),
    )  # fmt: skip
    return done.returncode, done.stdout.decode(encoding), done.stderr.decode(encoding)


def has(sign: str, encoding: str) -> bool:
    try:
        sign.encode(encoding)
    except UnicodeEncodeError:
        return False
    return True


@every_encoding
def test_a_summary_on_any_console(tmp_path, encoding):
    """The same lines, with what the encoding lacks in ASCII: mm³ as mm3, × as x."""
    write_stl(tmp_path / "part.stl", thin_part())
    options = ("--pixel", "50um", "--layer", "0.1mm", "--min-feature", "0.4mm")
    code, out, err = run("fix", "part.stl", "out", *options, encoding=encoding, cwd=tmp_path)
    assert (code, err) == (0, "")
    assert "Traceback" not in out
    lines = {line.split()[0]: line for line in out.splitlines()}
    assert lines["layers"].endswith("136 × 96 px" if has("×", encoding) else "136 x 96 px")
    assert ("mm³" if has("³", encoding) else "mm3 ") in lines["added"]


@every_encoding
def test_errors_and_help_on_any_console(tmp_path, encoding):
    """A name with signs that no console has, help with dashes and dots: one line, exit codes as ever."""
    name = "ü☃–\u202e.stl"
    code, out, err = run("fix", name, "out", encoding=encoding, cwd=tmp_path)
    assert (code, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert err.startswith("layerfix: ")
    assert err.endswith(".stl: no such file or folder\n")
    assert ("☃" if has("☃", encoding) else "\\u2603") in err
    for call in (["--help"], ["fix", "--help"], ["printers", "show", "prusa-mk3s-0.4"]):
        code, out, err = run(*call, encoding=encoding, cwd=tmp_path)
        assert (code, err) == (0, "")
        assert out
    code, _, err = run("fix", "a", "b", "--pixel", "1×☃", encoding=encoding, cwd=tmp_path)
    assert code == 2
    assert "Traceback" not in err


def spoken(path: Path) -> set[str]:
    """Signs beyond ASCII in a module's strings; of docstrings only those that are help texts."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    silent: set[int] = set()
    for node in ast.walk(tree):
        is_doc = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if is_doc and path.parent.name != "cli":
            silent.add(id(node.value))
    strings = [n.value for n in ast.walk(tree) if isinstance(n, ast.Constant) and id(n) not in silent]
    return {sign for text in strings if isinstance(text, str) for sign in text if not sign.isascii()}


def test_every_sign_of_our_messages_has_a_plain_form():
    """Texts in the package hold no sign that would come out as an escape."""
    found = {path.name: spoken(path) for path in Path(layerfix.__file__).parent.rglob("*.py")}
    signs = set().union(*found.values())
    assert {"×", "µ", "…", "³"} <= signs
    missing = {sign: [name for name in found if sign in found[name]] for sign in signs if "\\u" in plain(sign)}
    for borders in ("\ud7ff", "\ue000", "\ufffd"):  # of ranges in a pattern, never shown
        missing.pop(borders, None)
    assert missing == {}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1158 × 1186 px", "1158 x 1186 px"), ("50 µm", "50 um"), ("mm²/s → mm³", "mm2/s -> mm3"), ("S ∘ F", "S o F"),
        ("compiling …", "compiling ..."), ("90°", "90 deg"), ("Größe é", "Große e".replace("ß", "\\xdf")),
        ("☃", "\\u2603"), ("\udcff", "\\udcff"), ("plain", "plain"),
    ],
)  # fmt: skip
def test_signs_in_ascii(text, expected):
    """By their look, letters without accents, the rest as escapes that lose nothing."""
    assert plain(text) == expected
    assert all(value.isascii() for value in PLAIN.values())


def test_a_stream_gets_what_it_has():
    """What the encoding has stays as it is."""
    for encoding, expected in (("cp437", "µ ² x ☃"), ("cp1252", "µ ² × ☃"), ("ascii", "u 2 x ☃")):
        stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
        speak_plainly(stream)
        stream.write("µ ² × ☃")
        stream.flush()
        written = stream.buffer.getvalue().decode(encoding)
        assert written == expected.replace("☃", "\\u2603")


def test_a_message_is_one_line_whatever_names_hold():
    """Line breaks, terminal sequences and text that runs backwards are shown, not obeyed; letters of any script are
    left alone; a name of 60,000 letters does not fill the screen.
    """
    assert one_line("a\nb\r\x1b[2J\u202ec\u2028d") == "a\\nb\\r\\x1b[2J\\u202ec\\u2028d"
    assert one_line("größe 寸法 1 × 2") == "größe 寸法 1 × 2"
    long = one_line("x" * 60_000 + ": no such file")
    assert len(long) <= LONGEST + 3
    assert long.endswith(": no such file")
