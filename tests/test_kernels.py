"""Kernels are never stale, never broken, kept where they can be, and loaded only when called."""

from __future__ import annotations

import gc
import os
import re
import shutil
import subprocess
import sys
import threading
import warnings
from pathlib import Path

import numba
import numpy as np
import pytest
from numba import typeof, types
from numba.np import arrayobj

from layerfix import kernel_cache, kernels
from layerfix.bits import pack, popcount
from layerfix.kernels import njit
from layerfix.layers.columns import bounding_box
from layerfix.layers.feature import feature_of_size
from layerfix.layers.print_paths import tool_of
from tests.making import SOURCE, box, environment, give_up_override, joined, write_stl

# Dilates and erodes a line of 30 pixels. Prints the pixels, and how many kernels were loaded and compiled.
DILATE = """
import numpy as np
from layerfix.bits import pack
from layerfix.kernels import kernels_of
from layerfix.layers.morphology import dilate, opened
image = np.zeros((40, 40), bool)
image[20, 5:35] = True
wide = dilate(pack(image), 40, (3.0, 3.0))
kept = opened(pack(image), 40, (1.0, 1.0))
stats = [k.stats for k in kernels_of("layerfix.layers.columns", "layerfix.layers.morphology")]
hits, misses = (sum(sum(getattr(s, name).values()) for s in stats) for name in ("cache_hits", "cache_misses"))
print(int(np.bitwise_count(wide).sum()), int(np.bitwise_count(kept).sum()), hits, misses)
"""


def install(folder: Path) -> Path:
    """A copy of the package without compiled kernels; what PYTHONPATH needs."""
    shutil.copytree(SOURCE / "layerfix", folder / "site" / "layerfix", ignore=shutil.ignore_patterns("__pycache__"))
    return folder / "site"


def start(site: Path, code: str, **more: object) -> subprocess.Popen[str]:
    env = environment(PYTHONPATH=str(site), **more.pop("env", {}))
    env = {k: v for k, v in env.items() if k not in ("XDG_CACHE_HOME", "NUMBA_CACHE_DIR") or k in more}
    return subprocess.Popen([sys.executable, "-c", code], env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                            text=True, **more)  # fmt: skip


def run(site: Path, code: str = DILATE, **more: object) -> tuple[list[int], str]:
    """The numbers that a new process prints, and what it says besides."""
    process = start(site, code, **more)
    out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    return [int(number) for number in out.split()], err


def kept(site: Path) -> list[Path]:
    return sorted((site / "layerfix" / "__pycache__" / "kernels").glob("*"))


def test_an_edited_helper_in_another_file_is_obeyed(tmp_path):
    """The second run loads all kernels; after an edit of what they call, those that call it are compiled anew, the
    others are not, and nothing old is left behind."""
    site = install(tmp_path)
    (wide, opened, hits, misses), err = run(site)
    assert (opened, hits, err) == (0, 0, "")
    assert wide > 200
    files = kept(site)
    assert len(files) == misses
    assert run(site) == ([wide, 0, misses, 0], "")

    edited = site / "layerfix" / "layers" / "morphology.py"
    text = edited.read_text()
    assert text.count("target[i] |= words[i]") == 1
    edited.write_text(text.replace("target[i] |= words[i]", "target[i] |= U0 & words[i]"))
    (same, opened, hits, misses), err = run(site)
    assert (same, opened, err) == (30, 30, "")  # nothing grows any more, neither the line nor the void
    assert hits > 0
    assert misses > 0
    assert [p.name.rsplit("-", 1)[0] for p in kept(site)] == [p.name.rsplit("-", 1)[0] for p in files]

    edited.write_text(text)
    assert run(site)[0][:2] == [wide, 0]


def test_damaged_files_are_compiled_again_in_silence(tmp_path):
    """Empty, cut short, garbled, one bit turned, another kernel's, a folder: none is trusted, all are replaced."""
    site = install(tmp_path)
    expected, _ = run(site)
    files = kept(site)
    whole = [path.read_bytes() for path in files]
    damages = [b"", whole[1][:-1], os.urandom(999), whole[3][:-9] + bytes([whole[3][-9] ^ 1]) + whole[3][-8:],
               whole[4][:10], b"\x80\x04N."]  # fmt: skip
    for path, damage in zip(files, damages, strict=False):
        path.write_bytes(damage)
    again, err = run(site)
    assert again[:2] == expected[:2]
    assert again[3] >= len(damages)
    assert err == ""
    assert run(site) == ([*expected[:2], len(files), 0], "")


def test_several_first_runs_at_once(tmp_path):
    """Processes that compile the same kernels at the same time agree, and leave one sound file for each."""
    site = install(tmp_path)
    processes = [start(site, DILATE) for _ in range(3)]
    done = [(*p.communicate(timeout=300), p.returncode) for p in processes]
    assert [code for _, _, code in done] == [0, 0, 0], done
    assert {tuple(out.split()[:2]) for out, _, _ in done} == {tuple(done[0][0].split()[:2])}
    assert not [p for p in kept(site) if p.suffix != kernel_cache.SUFFIX]
    run(site)  # what was compiled against a callee that lost the race is made again
    (_, _, hits, misses), err = run(site)
    assert (misses, err) == (0, "")
    assert hits == len(kept(site))


def test_nowhere_to_keep_them_is_said_once_and_works(tmp_path):
    """A package and a home that cannot be written to: compiled in memory, and one warning for all kernels."""
    site, home = install(tmp_path), tmp_path / "home"
    home.mkdir()
    locked = [home, *(path for path in [site, *site.rglob("*")] if path.is_dir())]
    for path in locked:
        path.chmod(0o555)
    env = {"HOME": str(home), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        (wide, opened, hits, misses), err = run(site, env=env, cwd=tmp_path, preexec_fn=give_up_override)
    finally:
        for path in locked:
            path.chmod(0o755)
    assert (opened, hits) == (0, 0)
    assert (wide > 200, misses > 4) == (True, True)
    assert err.count("KernelsNotKept: compiled kernels cannot be kept") == 1
    assert not list(tmp_path.rglob("*.kernel"))


def test_the_command_line_says_it_in_one_line(capsys):
    """No file name, no line of source."""
    from layerfix.__main__ import say_warnings

    with warnings.catch_warnings():
        warnings.simplefilter("always")
        say_warnings()
        warnings.warn("compiled kernels cannot be kept", kernel_cache.KernelsNotKept, stacklevel=1)
    assert capsys.readouterr().err == "layerfix: compiled kernels cannot be kept\n"


def test_the_users_folder_is_the_one_given(tmp_path, monkeypatch):
    """NUMBA_CACHE_DIR alone where it is set; two installations never share a folder outside of themselves."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    place = kernel_cache.places()
    assert [p.parent for p in place] == [tmp_path]
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert kernel_cache.places()[-1] == tmp_path / "cache" / place[0].name
    assert kernel_cache.places()[0] == Path(kernel_cache.__file__).parent / "__pycache__" / "kernels"


def test_what_is_saved_comes_back_and_replaces_only_its_like(tmp_path, monkeypatch):
    """Other kernels, and this one for another machine, stay; the value is whatever was pickled."""
    import pickle

    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    for name, machine, digest in (("a.b", "m1", "1"), ("a.b", "m2", "1"), ("a.bb", "m1", "1"), ("a.b", "m1", "2")):
        assert kernel_cache.save(name, machine, digest, pickle.dumps([name, machine, digest])) is not None
    assert kernel_cache.load("a.b", "m1", "1") is None
    for key in (("a.b", "m2", "1"), ("a.bb", "m1", "1"), ("a.b", "m1", "2")):
        assert kernel_cache.load(*key) == list(key)


SOURCES = {
    "plain": "FACTOR = 3\n@njit\ndef helper(x):\n    return x * FACTOR\n"
             "@njit(types.int64(types.int64), cache=True, nogil=True)\ndef kernel(x):\n    return helper(x) + 1\n",
}  # fmt: skip
EDITS = {
    "a constant of the helper": ("FACTOR = 3", "FACTOR = 4"),
    "its type": ("FACTOR = 3", "FACTOR = 3.0"),
    "a literal of the helper": ("x * FACTOR", "x * FACTOR * 2"),
    "an operator": ("+ 1", "- 1"),
    "a name": ("x * FACTOR", "abs(x) * FACTOR"),
    "an array": ("FACTOR = 3", "FACTOR = np.int64(3)"),
}


def made(text: str) -> kernels.Kernel:
    known: dict[str, object] = {"njit": njit, "types": types, "np": np, "__name__": "layerfix.made"}
    exec(compile(text, "made.py", "exec"), known)
    return known["kernel"]


@pytest.mark.parametrize("edit", EDITS.values(), ids=EDITS)
def test_a_stamp_changes_with_all_that_the_code_depends_on(edit):
    """The kernel's own text stays, but for one of them."""
    text = SOURCES["plain"]
    assert edit[0] in text
    assert made(text.replace(*edit)).stamp != made(text).stamp


def test_a_stamp_stays_where_nothing_of_it_changed():
    """Comments, places, other functions and other constants do not count."""
    text = SOURCES["plain"]
    other = "OTHER = 5\n\n# a comment\n" + text + "def third(x):\n    return OTHER\n"
    assert made(other).stamp == made(text).stamp


def test_a_kernel_that_a_digest_cannot_stand_for_is_refused():
    """A dict, and a module of the package, whose names could change unseen."""
    for text in ("TABLE = {1: 2}\n", "from layerfix import bits as TABLE\n"):
        kernel = made(text + "@njit(types.int64(types.int64))\ndef kernel(x):\n    return TABLE.popcount(x)\n")
        with pytest.raises(TypeError, match=r"TABLE|bits"):
            _ = kernel.stamp


def test_arrays_count_by_value():
    text = "T = np.arange(3)\n@njit(types.int64(types.int64))\ndef kernel(x):\n    return T[x]\n"
    assert made(text).stamp == made(text).stamp
    assert made(text).stamp != made(text.replace("arange(3)", "arange(4)")).stamp


def test_no_kernel_bypasses_the_cache():
    """Every module takes `njit` from layerfix.kernels, and every kernel has a stamp."""
    modules = []
    for path in sorted((SOURCE / "layerfix").rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if path.name not in ("kernels.py", "kernel_cache.py"):
            assert not re.search(r"from numba import .*\bn?jit\b|numba\.n?jit", text), path
        if re.search(r"^@njit", text, re.MULTILINE):
            modules.append(".".join(path.relative_to(SOURCE).with_suffix("").parts))
    found = kernels.kernels_of(*modules)
    assert len({kernel.stamp for kernel in found}) == len(found) > 40


def test_a_wrong_argument_is_refused_and_a_helper_can_be_called():
    """The declared signature is the only one, before and after it is ready."""
    for _ in range(2):
        with pytest.raises(TypeError, match="No matching definition"):
            bounding_box(np.zeros((3, 3), np.float64))
        assert bounding_box(pack(np.ones((3, 3), bool))) == (0, 3, 0, 1)
    assert popcount(np.uint64(7)) == 3


@pytest.fixture(scope="module")
def warm(tmp_path_factory):
    """An installation whose kernels are compiled."""
    site = install(tmp_path_factory.mktemp("warm"))
    run(site)
    return site


def test_loading_needs_no_scipy_and_no_compiler(warm):
    """A run that finds its kernels loads none of numba's registries, which pull in scipy's linear algebra."""
    loaded = set(run(warm, DILATE + "\nimport sys; print(*sys.modules, file=sys.stderr)")[1].split())
    assert "numba" in loaded
    assert loaded & {"scipy.linalg", "numba.np.arraymath"} == set()


def assign(target, source):
    """What two kernels are made of."""
    target[:] = source


def test_a_slice_that_does_not_fit_is_said_plainly(tmp_path, monkeypatch):
    """Without the shapes, whose text would take an eighth of compiling; in numba's own functions it is as it was."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    floats = types.float64[::1]
    mine = njit(types.void(floats, floats), cache=True)(assign)
    with pytest.raises(ValueError, match="cannot assign slice from input of different size"):
        mine(np.zeros(3), np.ones(2))
    target = np.zeros(3)
    mine(target, np.ones(3))
    assert target.tolist() == [1, 1, 1]
    theirs = (
        r"of shape \(3,\) from input of shape \(2,\)" if hasattr(arrayobj, "raise_with_shape_context") else "size"
    )
    with pytest.raises(ValueError, match=theirs):
        numba.njit(assign)(np.zeros(3), np.ones(2))


PRODUCT = """
import numba
@numba.njit
def product(a, b):
    return a @ b
a = np.arange(6.0).reshape(2, 3)
assert np.array_equal(product(a, a.T.copy()), a @ a.T)
"""


def test_numba_of_others_is_as_it_was(warm):
    """Somebody else's njit and its products of matrices work beside kernels that were loaded."""
    run(warm, DILATE + PRODUCT)


def test_compiling_is_told(tmp_path, monkeypatch):
    """Whoever listens hears the kernel's name once, before it is compiled, and nothing when it is loaded."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    told: list[str] = []
    with kernels.compiling_told(told.append):
        assert made(SOURCES["plain"])(5) == 16
        assert made(SOURCES["plain"])(6) == 19
    assert told == ["made.kernel"]


def test_a_kernel_has_one_name_in_every_process():
    """Options that are sets have another order in each: the digest must not."""
    code = "from layerfix.fdm.distance import edge_distance as k; print(k._cache._names())"
    said = {
        subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=True,
            timeout=120,
        ).stdout
        for seed in ("1", "2", "3", "4")
    }
    assert len(said) == 1


@pytest.mark.parametrize("to", [["a.zip"], ["a.gcode"], ["a.stl", "--surface", "voxels"]])
def test_a_warm_start_loads_no_linear_algebra(tmp_path, to):
    """A kernel that names numba's array mathematics would load scipy.linalg: 0.1 to 0.3 s, in every run."""
    over_air = box([-15, -5, 6], [15, 5, 8])
    write_stl(tmp_path / "part.stl", joined(box([-5, -5, 0], [5, 5, 6]), over_air))
    code = (
        "import sys; from layerfix.cli import layerfix;"
        f"layerfix.main(['fix', 'part.stl', *{to}, '-p', 'prusa-mk3s-0.4', '--force'], standalone_mode=False);"
        "print('scipy.linalg' in sys.modules)"
    )
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True, timeout=240
        )
    assert done.stdout.splitlines()[-1] == "False"


def test_the_type_of_an_argument_is_made_once():
    """Once it is known, every thread brings the same one, and it outlives the calls."""
    value = (np.arange(3, dtype=np.int8), 1.0, (np.arange(4.0), True))
    kernels.know(value, typeof(value))
    code = typeof(value)._code
    gc.collect()
    found: list[int] = []
    threads = [threading.Thread(target=lambda: found.append(typeof(value)._code)) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [code] * 8


def test_what_corrects_layers_is_known_before_threads_bring_it():
    """F and the plan go to kernels as tuples, whose types numba makes as they come."""
    tool = tool_of(feature_of_size(8.0), "metric")
    assert {typeof(tool.values), typeof(tool.plan)} <= kernels._known
