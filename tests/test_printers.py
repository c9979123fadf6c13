"""Printers from TOML: those shipped are sound, and a wrong word in one's own is named."""

from __future__ import annotations

from pathlib import Path

import pytest

from layerfix import Printer, load_printer
from layerfix.errors import InputError
from layerfix.printers import printer_folder, printer_names

every_printer = pytest.mark.parametrize("name", printer_names())

GOOD = {
    "maker": '"Me"', "model": '"One"', "process": '"resin"', "build_mm": "[100.0, 50.0, 150]",
    "layer_mm": "0.05", "layer_range_mm": "[0.02, 0.1]", "min_feature_mm": "0.2", "pixel_mm": "[0.05, 0.05]",
}  # fmt: skip


def own(folder: Path, **changes: str | None) -> Path:
    """A printer file like GOOD, with some keys changed, added, or left out (None)."""
    keys = {k: v for k, v in {**GOOD, **changes}.items() if v is not None}
    path = folder / "mine.toml"
    path.write_text("".join(f"{k} = {v}\n" for k, v in keys.items()))
    return path


def problem(path: Path | str) -> str:
    with pytest.raises(InputError) as caught:
        load_printer(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_there_are_printers():
    """They are found beside the source or inside the package, under the names of their files."""
    assert {"prusa-sl1s", "prusa-mk3s-0.4"} <= set(printer_names())
    assert set(printer_names()) == {path.stem for path in printer_folder().glob("*")}


@every_printer
def test_every_shipped_printer_is_sound(name):
    """It loads under its name, its layer height is in its range, and its feature is larger than a pixel."""
    printer = load_printer(name)
    assert printer.name == name
    assert printer.maker
    assert printer.model
    assert printer.layer_range_mm[0] <= printer.layer_mm <= printer.layer_range_mm[1]
    assert 2 * max(printer.pixel_mm) <= printer.min_feature_mm < 2
    assert all(50 < side < 2000 for side in printer.build_mm)
    assert printer.mirror in ("", "x", "y", "xy")
    assert printer.format == "" or printer.format.startswith(".")


@every_printer
def test_the_panel_is_as_large_as_what_it_prints(name):
    """Pixels times pitch is the build area, within 0.5 %; a nozzle has no panel."""
    printer = load_printer(name)
    if printer.pixels is None:
        assert printer.nozzle_mm
        return
    for count, pitch, size in zip(printer.pixels, printer.pixel_mm, printer.build_mm[:2], strict=True):
        assert count * pitch == pytest.approx(size, rel=0.005)


@every_printer
def test_every_shipped_printer_states_its_source(name):
    """Its first line is a comment that says which machine this is."""
    assert (printer_folder() / f"{name}.toml").read_text(encoding="utf-8").startswith("# ")


@pytest.mark.parametrize(
    ("process", "mode"), [("resin", "add_only"), ("fdm", "as_printed"), ("powder", "as_printed")]
)
def test_the_process_decides_the_mode(tmp_path, process, mode):
    """A mask can draw corners, a nozzle and a beam cannot."""
    assert load_printer(own(tmp_path, process=f'"{process}"')).mode == mode


def test_ones_own_printer_by_path(tmp_path):
    """Every key arrives, whole numbers count as numbers, and the name is the file's."""
    path = own(tmp_path, pixels="[2000, 1000]", mirror='"xy"', format='".sl1"', first_layer_mm="0.1", nozzle_mm="1")
    for given in (path, str(path)):
        assert load_printer(given) == Printer(
            name="mine", maker="Me", model="One", process="resin", build_mm=(100, 50, 150), layer_mm=0.05,
            min_feature_mm=0.2, pixel_mm=(0.05, 0.05), layer_range_mm=(0.02, 0.1), pixels=(2000, 1000),
            mirror="xy", format=".sl1", nozzle_mm=1, first_layer_mm=0.1,
        )  # fmt: skip


def test_a_path_is_relative_to_where_one_is(tmp_path, monkeypatch):
    """`mine.toml` is a file here, `mine` is a name."""
    own(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert load_printer("mine.toml").name == "mine"
    assert "no printer 'mine'" in problem("mine")


def test_the_pitch_may_follow_from_panel_or_nozzle(tmp_path):
    """A panel's size over its pixels, an eighth of a nozzle; neither is an error that says what is missing."""
    path = own(tmp_path, pixel_mm=None, pixels="[2000, 500]")
    assert load_printer(path).pixel_mm == pytest.approx((0.05, 0.1))
    assert load_printer(own(tmp_path, pixel_mm=None, nozzle_mm="0.4")).pixel_mm == pytest.approx((0.05, 0.05))
    assert "missing pixel_mm (or pixels, or nozzle_mm" in problem(own(tmp_path, pixel_mm=None))


@pytest.mark.parametrize(
    ("name", "near"),
    [("prusa-sl1", "prusa-sl1s"), ("PRUSA-SL1S", "prusa-sl1s"), ("mk3s", "prusa-mk3s-0.4"),
     ("saturn-3-ultra", "elegoo-saturn-3-ultra")],
)  # fmt: skip
def test_an_unknown_name_proposes_the_nearest(name, near):
    """A typing error is answered with what was probably meant."""
    assert near in problem(name)
    assert f"no printer '{name}'" in problem(name)


def test_a_name_like_none_says_where_the_list_is():
    """Nothing near: the message says how to see them all."""
    assert problem("zzz") == "no printer 'zzz': `layerfix printers` lists them, or give your own .toml file"


def test_a_missing_file_and_a_folder(tmp_path):
    """A path to nothing, and to a folder that is called .toml."""
    assert problem(tmp_path / "none.toml") == f"{tmp_path / 'none.toml'}: no such file"
    (tmp_path / "folder.toml").mkdir()
    assert "folder.toml" in problem(tmp_path / "folder.toml")


@pytest.mark.parametrize("text", ["maker = ", "= 3", "[printer", "maker = 'a'\nmaker = 'b'", "\x00", "just words"])
def test_what_is_no_toml(tmp_path, text):
    """The file is named, with what the TOML reader says."""
    (tmp_path / "mine.toml").write_text(text)
    assert "mine.toml: not a valid TOML file" in problem(tmp_path / "mine.toml")


def test_bytes_that_are_no_text(tmp_path):
    """A file that is not UTF-8."""
    (tmp_path / "mine.toml").write_bytes(b"maker = '\xff\xfe'")
    assert "mine.toml: not a valid TOML file" in problem(tmp_path / "mine.toml")


@pytest.mark.parametrize(
    ("key", "near"),
    [("layer_hight", "layer_mm"), ("pixel", "pixel_mm"), ("min_feature", "min_feature_mm"), ("proces", "process")],
)
def test_a_wrong_key_names_the_near_ones(tmp_path, key, near):
    """A typing error in a key."""
    message = problem(own(tmp_path, **{key: "1"}))
    assert f"mine.toml: unknown key '{key}': did you mean " in message
    assert near in message


def test_a_strange_key_lists_the_known_ones(tmp_path):
    """Nothing near: all of them; a table is a key too."""
    assert "unknown key 'zzz': known are maker, model, process" in problem(own(tmp_path, zzz="1"))
    assert "unknown key 'zzz'" in problem(own(tmp_path, zzz="{a = 1}"))


@pytest.mark.parametrize(
    "key", ["maker", "model", "process", "build_mm", "layer_mm", "layer_range_mm", "min_feature_mm"]
)
def test_a_missing_key_is_named(tmp_path, key):
    """Each of those that nothing else can stand in for."""
    assert problem(own(tmp_path, **{key: None})) == f"{tmp_path / 'mine.toml'}: missing {key}"


@pytest.mark.parametrize(
    ("key", "value"),
    [("maker", "3"), ("layer_mm", '"0.05mm"'), ("layer_mm", "true"), ("layer_mm", "[0.05]"), ("build_mm", "[1, 2]"),
     ("build_mm", "[1, 2, 3, 4]"), ("build_mm", "[1, 2, '3']"), ("pixel_mm", "0.05"), ("pixels", "[100.5, 50]"),
     ("process", "1"), ("process", '"laser"'), ("mirror", "true"), ("layer_mm", "1979-05-27")],
)  # fmt: skip
def test_a_value_of_the_wrong_kind_is_named(tmp_path, key, value):
    """Key and value, and what it should be."""
    message = problem(own(tmp_path, **{key: value}))
    assert message.startswith(f"{tmp_path / 'mine.toml'}: {key} = ")
    assert "it is" in message or "choose from" in message


@pytest.mark.parametrize("value", ["0", "-0.05", "nan", "inf", "-inf"])
@pytest.mark.parametrize("key", ["layer_mm", "min_feature_mm", "first_layer_mm", "nozzle_mm"])
def test_a_length_that_is_not_above_0_is_named(tmp_path, key, value):
    """Zero, negative, infinite, not a number."""
    assert f"{key} = " in problem(own(tmp_path, **{key: value}))
    assert "must be above 0" in problem(own(tmp_path, **{key: value}))


def test_a_side_of_the_build_volume_that_is_not_above_0(tmp_path):
    """One of three."""
    assert "build_mm = [100, 0, 150]; it must be above 0" in problem(own(tmp_path, build_mm="[100, 0, 150]"))


@pytest.mark.parametrize(
    "changes",
    [{"mirror": '"z"'}, {"mirror": '"left"'}, {"layer_range_mm": "[0.1, 0.02]"}, {"format": '"sl1"'},
     {"pixels": "[100, 100]"}],
    ids=lambda c: "-".join(c),
)  # fmt: skip
def test_values_that_contradict_are_named(tmp_path, changes):
    """An axis that does not exist, a range upside down, a suffix without its dot, a panel of another size."""
    (key,) = changes
    assert key in problem(own(tmp_path, **changes))
