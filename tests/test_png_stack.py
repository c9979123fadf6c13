"""Folders and zips of PNG images: round trips, other programs' images, and stacks with something wrong."""

from __future__ import annotations

import io
import json
import shutil
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, PngImagePlugin

from layerfix import correct, load_printer, read, write
from layerfix.errors import InputError, OutputError
from layerfix.formats.png.series import numeric_order
from layerfix.mesh.slicing import slice_mesh
from layerfix.stack import LayerStack
from tests.making import contents, thin_part

either_container = pytest.mark.parametrize("name", ["layers", "layers.zip"])
GIVEN = {"pixel_mm": 0.05, "layer_mm": 0.1}


def sliced() -> LayerStack:
    """A small part on oblong pixels, its first layer higher, not at the origin."""
    return slice_mesh(thin_part().moved([10, 20, 0]), pixel_mm=(0.05, 0.07), layer_mm=0.1, first_layer_mm=0.3)


def png(image: np.ndarray, mode: str = "L") -> bytes:
    """A PNG as Pillow writes it, black and white, without a word about its pitch."""
    buffer = io.BytesIO()
    Image.fromarray(np.where(image, 255, 0).astype(np.uint8)).convert(mode).save(buffer, "PNG")
    return buffer.getvalue()


def made(place: Path, files: dict[str, bytes]) -> Path:
    """Files in a folder, or in a zip if the place ends so."""
    if place.suffix == ".zip":
        with zipfile.ZipFile(place, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in files.items():
                archive.writestr(name, data)
    else:
        place.mkdir()
        for name, data in files.items():
            (place / name).write_bytes(data)
    return place


def images(stack: LayerStack) -> np.ndarray:
    return np.array([layer.image() for layer in stack])


@pytest.fixture
def pictures() -> np.ndarray:
    """Twelve different 9 × 70 images."""
    return np.random.default_rng(4).random((12, 9, 70)) < 0.5


@either_container
@pytest.mark.parametrize("bits", [1, 8])
def test_what_is_written_comes_back(tmp_path, name, bits):
    """Rows, pitch, origin and each layer's z survive exactly, decimals too, without any option."""
    stack = sliced()
    write(tmp_path / name, stack, bits=bits)
    again = read(tmp_path / name)
    assert (again.width, again.height) == (stack.width, stack.height)
    assert again.pixel_mm == stack.pixel_mm
    assert again.origin_mm == stack.origin_mm
    assert np.array_equal(again.z_mm, stack.z_mm)
    for a, b in zip(again, stack, strict=True):
        assert np.array_equal(a.rows, b.rows)
        assert a.z_mm == b.z_mm


@either_container
@pytest.mark.parametrize("workers", [1, 2, 8])
def test_the_same_layers_give_the_same_bytes(tmp_path, name, workers):
    """Twice the same stack, by any number of threads: not one byte differs."""
    write(tmp_path / ("first_" + name), sliced())
    write(tmp_path / ("again_" + name), sliced().with_workers(workers))
    both = [tmp_path / (prefix + name) for prefix in ("first_", "again_")]
    one, two = (contents(p) if p.is_dir() else p.read_bytes() for p in both)
    assert one == two


def test_the_zip_is_plain(tmp_path):
    """Stored entries in printing order, none of them hidden, and zipfile's own check finds nothing."""
    write(tmp_path / "layers.zip", sliced())
    with zipfile.ZipFile(tmp_path / "layers.zip") as archive:
        assert archive.testzip() is None
        assert archive.namelist() == sorted(archive.namelist())
        assert {entry.compress_type for entry in archive.infolist()} == {zipfile.ZIP_STORED}
        assert archive.namelist()[0] == "00000.png"


@pytest.mark.parametrize("bits", [1, 8])
def test_other_programs_can_read_the_images(tmp_path, bits):
    """Pillow sees white where the layer is solid, and the pitch as dots per inch."""
    write(tmp_path / "layers", sliced(), bits=bits)
    with Image.open(tmp_path / "layers" / "00003.png") as image:
        assert image.mode == ("1" if bits == 1 else "L")
        assert np.array_equal(np.array(image.convert("L")) > 0, sliced()[3].image())
        assert image.info["dpi"] == pytest.approx((25.4 / 0.05, 25.4 / 0.07), rel=1e-4)


@either_container
def test_names_are_ordered_by_their_numbers(tmp_path, pictures, name):
    """1, 2, 10 and not 1, 10, 2; capitals and leading zeros do not matter."""
    names = ["layer1.png", "Layer2.PNG", "layer003.png", *(f"layer{k}.png" for k in range(4, 13))]
    files = dict(zip(names, map(png, pictures), strict=True))
    shuffled = {n: files[n] for n in sorted(files)}
    stack = read(made(tmp_path / name, shuffled), **GIVEN)
    assert np.array_equal(images(stack), pictures)


@pytest.mark.parametrize(
    "names",
    [["1", "2", "10"], ["a9b1", "a9b2", "a10b1"], ["x", "x1", "x1y"], ["A1", "a2", "B0"], ["01", "1a", "2"]],
)
def test_numeric_order(names):
    """Runs of digits compare as numbers, everything between them as lower-case text."""
    assert sorted({*names}, key=numeric_order) == names


@pytest.mark.parametrize("name", ["²1.png", "a².png", "½.png", "٣.png", "①7.png"])
def test_digits_of_every_kind_are_no_obstacle(name):
    """A superscript two is a digit to Unicode and not a number to int()."""
    assert numeric_order(name)


@either_container
@pytest.mark.parametrize("mode", ["L", "1", "RGB", "RGBA", "P", "LA"])
def test_images_of_other_programs(tmp_path, pictures, mode, name):
    """Grey, 1-bit, colour, palette, with alpha: black is empty and white is solid."""
    files = {f"{k}.png": png(picture, mode) for k, picture in enumerate(pictures)}
    stack = read(made(tmp_path / name, files), **GIVEN)
    assert np.array_equal(images(stack), pictures)
    assert stack.pixel_mm == (0.05, 0.05)
    assert stack.z_mm[1].tolist() == [0.1, 0.2]


def test_pitch_and_heights_from_a_printer(tmp_path, pictures):
    """A printer says what plain images do not; what is given explicitly wins over it."""
    folder = made(tmp_path / "layers", {f"{k}.png": png(p) for k, p in enumerate(pictures)})
    printer = load_printer("elegoo-saturn-3-ultra")
    stack = read(folder, printer=printer)
    assert stack.pixel_mm == printer.pixel_mm
    assert stack.z_mm[-1, 1] == pytest.approx(12 * printer.layer_mm)
    stack = read(folder, printer=printer, layer_mm=0.2, first_layer_mm=0.5)
    assert stack.z_mm[:2].tolist() == [[0, 0.5], [0.5, 0.7]]


def test_the_files_own_pitch_wins_over_the_printers(tmp_path):
    """The order is: what is given, what the file says, what the printer says."""
    write(tmp_path / "layers", sliced())
    stack = read(tmp_path / "layers", printer=load_printer("prusa-sl1s"))
    assert stack.pixel_mm == (0.05, 0.07)
    assert np.array_equal(stack.z_mm, sliced().z_mm)
    assert read(tmp_path / "layers", pixel_mm=0.2).pixel_mm == (0.2, 0.2)


def test_what_is_given_over_the_files_own_word_is_told(tmp_path):
    """Pitch and heights; what is nearly the same is the same."""
    write(tmp_path / "layers", sliced())
    assert read(tmp_path / "layers", pixel_mm=(0.0501, 0.07), layer_mm=0.1, first_layer_mm=0.3).notes == ()
    stack = read(tmp_path / "layers", pixel_mm=0.2, layer_mm=0.2)
    top = sliced().z_mm[-1, 1]
    assert stack.notes == (
        "the file says pixels of 50 µm × 70 µm; counted as 0.2 mm, as asked",
        f"the file says a part of {top:.4g} mm; counted as {0.2 * len(stack):.4g} mm, as asked",
    )
    assert np.array_equal(read(tmp_path / "layers", first_layer_mm=0.3).z_mm, sliced().z_mm)
    with pytest.raises(InputError, match=r"layers: a first layer of 1 mm: .* the first 0\.3 mm high; give the layer"):
        read(tmp_path / "layers", first_layer_mm=1.0)


@either_container
@pytest.mark.parametrize(
    ("given", "missing"),
    [({}, "pixel pitch and layer height"), ({"layer_mm": 0.1}, "pixel pitch"), ({"pixel_mm": 0.1}, "layer height")],
)
def test_a_missing_pitch_or_height_names_the_options(tmp_path, pictures, given, missing, name):
    """Plain images without a printer: the error says what is missing and which options give it."""
    place = made(tmp_path / name, {"1.png": png(pictures[0])})
    with pytest.raises(InputError) as caught:
        read(place, **given)
    assert f"the images do not say their {missing};" in str(caught.value)
    assert str(place) in str(caught.value)
    assert "--printer" in str(caught.value)
    assert "--pixel" in str(caught.value)


def test_the_resolution_other_programs_store_is_the_pitch(tmp_path, pictures):
    """A pHYs chunk in pixels a metre is a pitch; dots without a unit are not."""
    buffer = io.BytesIO()
    Image.fromarray(pictures[0]).save(buffer, "PNG", dpi=(508, 254))
    folder = made(tmp_path / "layers", {"1.png": buffer.getvalue()})
    assert read(folder, layer_mm=0.1).pixel_mm == pytest.approx((0.05, 0.1), rel=1e-4)


def test_a_note_of_ours_that_makes_no_sense_is_passed_over(tmp_path, pictures):
    """Text under our key that is not ours is ignored."""
    for number, text in enumerate(["", "[]", "{", '{"z_mm": 3}', '{"pixel_mm": ["a", "b"]}']):
        info = PngImagePlugin.PngInfo()
        info.add_text("layerfix", text)
        buffer = io.BytesIO()
        Image.fromarray(pictures[0]).save(buffer, "PNG", pnginfo=info)
        stack = read(made(tmp_path / f"{number}", {"1.png": buffer.getvalue()}), **GIVEN)
        assert np.array_equal(stack[0].image(), pictures[0])


@pytest.mark.parametrize("notes", [{"pixel_mm": [-1, 1]}, {"pixel_mm": [0, 0]}, {"z_mm": [1, 0]}])
def test_notes_that_lie_are_an_error_that_names_the_file(tmp_path, pictures, notes):
    """A pitch below 0 or a layer upside down: whose it is must be in the message."""
    info = PngImagePlugin.PngInfo()
    info.add_text("layerfix", json.dumps({"pixel_mm": [1, 1], "z_mm": [0, 1], **notes}))
    buffer = io.BytesIO()
    Image.fromarray(pictures[0]).save(buffer, "PNG", pnginfo=info)
    folder = made(tmp_path / "layers", {"1.png": buffer.getvalue()})
    with pytest.raises(InputError, match="layers"):
        read(folder)


def test_layers_of_two_jobs_in_one_folder_are_an_error_that_names_it(tmp_path):
    """Their z's do not rise; the message says in which folder."""
    write(tmp_path / "layers", sliced())
    for path in list((tmp_path / "layers").iterdir()):
        shutil.copy(path, path.with_name(f"again_{path.name}"))
    with pytest.raises(InputError, match="layers"):
        read(tmp_path / "layers")


@either_container
def test_a_layer_can_be_left_out(tmp_path, name):
    """Removing an image removes its layer; the others keep their z's."""
    write(tmp_path / "whole", sliced())
    files = {p.name: p.read_bytes() for p in (tmp_path / "whole").iterdir() if p.name != "00005.png"}
    stack = read(made(tmp_path / name, files))
    assert len(stack) == len(sliced()) - 1
    assert np.array_equal(stack.z_mm, np.delete(sliced().z_mm, 5, axis=0))


@either_container
def test_images_of_several_sizes_name_two_of_them(tmp_path, pictures, name):
    """All layers have one size; the first that differs is named with both sizes."""
    place = made(tmp_path / name, {"1.png": png(pictures[0]), "2.png": png(pictures[1][:, :-1])})
    with pytest.raises(InputError, match=r"layers.*: 2\.png is 69 × 9 px, 1\.png 70 × 9 px"):
        read(place, **GIVEN)


@either_container
@pytest.mark.parametrize("files", [{}, {"readme.txt": b"hello"}])
def test_nothing_to_read(tmp_path, files, name):
    """No image in it: the message says what is looked for."""
    with pytest.raises(InputError, match=r"no PNG images in it; layers are files such as 0001\.png"):
        read(made(tmp_path / name, files), **GIVEN)


@either_container
@pytest.mark.parametrize("data", [b"", b"GIF89a", b"\xff\xd8\xff\xe0 a jpeg that is called png" * 9])
def test_something_else_that_is_called_png(tmp_path, pictures, data, name):
    """The file is named, wherever it stands in the order."""
    place = made(tmp_path / name, {"1.png": png(pictures[0]), "2.png": data})
    with pytest.raises(InputError, match=r"2\.png: not a (readable )?PNG image"):
        read(place, **GIVEN)


@either_container
def test_an_image_that_is_cut_short_is_found_when_its_layer_is_made(tmp_path, pictures, name):
    """The head of the file is sound: the error comes with the layer and names the image."""
    place = made(tmp_path / name, {"1.png": png(pictures[0]), "2.png": png(pictures[1])[:-60]})
    stack = read(place, **GIVEN)
    assert np.array_equal(stack[0].image(), pictures[0])
    with pytest.raises(InputError, match=r"2\.png: not a (readable )?PNG image"):
        stack[1].image()


def test_an_image_that_is_gone_when_its_layer_is_made(tmp_path, pictures):
    """Removed in the meantime: it is the input that is named, also while an output is being written."""
    folder = made(tmp_path / "layers", {"1.png": png(pictures[0]), "2.png": png(pictures[1])})
    stack = read(folder, **GIVEN)
    (folder / "2.png").unlink()
    with pytest.raises(InputError, match=r"2\.png"):
        stack[1].image()
    with pytest.raises(InputError, match=r"2\.png"):
        write(tmp_path / "out.zip", stack)


def test_a_folder_inside_that_is_called_png_is_no_layer(tmp_path, pictures):
    """Only files are images."""
    folder = made(tmp_path / "layers", {"1.png": png(pictures[0])})
    (folder / "2.png").mkdir()
    assert len(read(folder, **GIVEN)) == 1


@either_container
def test_the_shadow_files_of_macos_are_no_layers(tmp_path, pictures, name):
    """Zips made by the Finder, and folders it has copied to a stick, hold ._1.png files that are no images."""
    shadow = b"\0\5\x16\7\0\2\0\0Mac OS X        " + bytes(100)
    names = {"__MACOSX/._1.png": shadow} if name.endswith(".zip") else {"._1.png": shadow}
    stack = read(made(tmp_path / name, {"1.png": png(pictures[0]), **names}), **GIVEN)
    assert len(stack) == 1


@pytest.mark.parametrize("share", [0.02, 0.5, 0.9, 0.99])
def test_a_zip_that_is_cut_short(tmp_path, share):
    """Without its directory at the end it is no zip; the file is named."""
    write(tmp_path / "layers.zip", sliced())
    data = (tmp_path / "layers.zip").read_bytes()
    (tmp_path / "short.zip").write_bytes(data[: int(share * len(data))])
    with pytest.raises(InputError, match=r"short\.zip"):
        read(tmp_path / "short.zip")


@pytest.mark.parametrize(
    "compression", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA]
)
def test_a_damaged_zip_entry_is_named(tmp_path, pictures, compression):
    """Bytes overwritten in the middle of an entry: an error that names zip and entry, however it is packed."""
    with zipfile.ZipFile(tmp_path / "layers.zip", "w", compression) as archive:
        archive.writestr("1.png", png(np.ones((300, 300))) + bytes(3000))
    data = bytearray((tmp_path / "layers.zip").read_bytes())
    with zipfile.ZipFile(tmp_path / "layers.zip") as archive:
        size = archive.getinfo("1.png").compress_size
    data[35 + size // 4 : 35 + size // 2] = b"\xff" * (size // 2 - size // 4)
    (tmp_path / "layers.zip").write_bytes(data)
    with pytest.raises(InputError, match=r"layers\.zip.*1\.png"):
        read(tmp_path / "layers.zip", **GIVEN)[0].image()


def test_a_zip_with_a_password(tmp_path, pictures):
    """An encrypted entry cannot be read; it is named."""
    data = bytearray(made(tmp_path / "layers.zip", {"1.png": png(pictures[0])}).read_bytes())
    data[6] |= 1
    data[data.index(b"PK\1\2") + 8] |= 1
    (tmp_path / "layers.zip").write_bytes(data)
    with pytest.raises(InputError, match=r"1\.png.*password"):
        read(tmp_path / "layers.zip", **GIVEN)


def test_a_header_that_claims_an_absurd_size(tmp_path):
    """65,000 × 65,000 px in 90 bytes: an error that names the image."""
    body = struct.pack(">IIBBBBB", 65_000, 65_000, 8, 0, 0, 0, 0)
    data = (
        b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + b"IHDR" + body + struct.pack(">I", zlib.crc32(b"IHDR" + body))
    )
    folder = made(tmp_path / "layers", {"1.png": data + bytes(40)})
    with pytest.raises(InputError, match=r"1\.png"):
        read(folder, **GIVEN)[0].image()


def test_a_zip_without_the_suffix_and_what_is_no_zip(tmp_path, pictures):
    """A zip is known by its content; other files are refused with what can be read."""
    made(tmp_path / "layers.zip", {"1.png": png(pictures[0])}).rename(tmp_path / "layers.cbz")
    assert len(read(tmp_path / "layers.cbz", **GIVEN)) == 1
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(InputError, match=r"notes\.txt: not a file that layerfix knows.*\.stl.*a folder, .*\.zip"):
        read(tmp_path / "notes.txt")
    with pytest.raises(InputError, match="nothing: no such file or folder"):
        read(tmp_path / "nothing")


def test_an_unknown_suffix_names_the_known_ones(tmp_path):
    """Writing needs a suffix that says what to write."""
    with pytest.raises(OutputError, match=r"layers\.jpg: no writer for '\.jpg'; layerfix writes a folder, .*\.zip"):
        write(tmp_path / "layers.jpg", sliced())
    assert not contents(tmp_path)


def test_an_error_in_a_layer_leaves_no_output(tmp_path, pictures):
    """The second image is broken: neither a half folder nor a half zip, nor a temporary, is left."""
    place = made(tmp_path / "layers", {"1.png": png(pictures[0]), "2.png": png(pictures[1])[:-60]})
    before = contents(tmp_path)
    for target in ("out", "out.zip"):
        with pytest.raises(InputError, match=r"2\.png"):
            write(tmp_path / target, read(place, **GIVEN))
    assert contents(tmp_path) == before


@either_container
def test_greys_are_kept(tmp_path, name):
    """A soft block stays as it is, a thin grey stroke is drawn with greys; with 1 bit they are gone."""
    grey = np.zeros((60, 90), np.uint8)
    grey[10:40, 10:40] = 255
    grey[9, 10:40] = grey[10:40, 9] = 90
    grey[45, 60:80] = 160
    buffer = io.BytesIO()
    Image.fromarray(grey).save(buffer, "PNG")
    source = made(tmp_path / name, {f"{k}.png": buffer.getvalue() for k in range(3)})
    target = tmp_path / f"fixed-{name}"
    write(target, correct(read(source, **GIVEN), min_feature_mm=0.25, mode="add_only"))
    pictures = [np.asarray(Image.open(io.BytesIO(data))) for file, data in contents_of(target).items()]
    assert len(pictures) == 3
    for found in pictures:
        assert (found >= grey).all()
        assert np.array_equal(found[:42], grey[:42])
        assert (found[45, 62:78] == 255).all()
        assert len(set(np.unique(found)) - {0, 90, 255}) > 2
    again = read(target)
    assert again.pixel_mm == (0.05, 0.05)
    write(tmp_path / f"bits-{name}", again, bits=1)
    for data in contents_of(tmp_path / f"bits-{name}").values():
        assert Image.open(io.BytesIO(data)).mode == "1"


def test_the_threshold_is_that_of_images_too(tmp_path):
    """A value that is solid from 64 on, and not from 128 on."""
    grey = np.zeros((20, 30), np.uint8)
    grey[5:15, 5:25] = 255
    grey[5:15, 5:15] = 100
    buffer = io.BytesIO()
    Image.fromarray(grey).save(buffer, "PNG")
    source = made(tmp_path / "layers", {"0.png": buffer.getvalue()})
    counts = [read(source, **GIVEN, threshold=t, grey_floor=0)[0].count_px() for t in (64, 128)]
    assert counts == [200, 100]


def contents_of(place: Path) -> dict[str, bytes]:
    """The files of a folder or a zip."""
    if place.suffix == ".zip":
        with zipfile.ZipFile(place) as archive:
            return {name: archive.read(name) for name in archive.namelist()}
    return {file.name: file.read_bytes() for file in sorted(place.iterdir())}


def named(place: Path, *names: str) -> Path:
    """A stack of as many 4 × 4 images, each as its suffix says; a name with a folder in front goes into it."""
    files = {}
    for name in names:
        buffer = io.BytesIO()
        kind = {".jpg": "JPEG", ".tif": "TIFF", ".bmp": "BMP", ".png": "PNG"}[Path(name).suffix]
        Image.fromarray(np.full((4, 4), 255, np.uint8)).save(buffer, kind)
        files[name] = buffer.getvalue()
    return made(place, files)


@either_container
@pytest.mark.parametrize("suffix", [".jpg", ".bmp", ".tif"])
@pytest.mark.parametrize("third", ["3", "7"])
def test_a_layer_that_is_no_png_is_not_left_out(tmp_path, name, suffix, third):
    """Between the others or after them: a part without it would be another part."""
    place = named(tmp_path / name, "1.png", "2.png", f"{third}{suffix}", "4.png")
    with pytest.raises(InputError, match=rf"{name}: {third}{suffix} is no PNG image, as 1.png is; save all"):
        read(place, **GIVEN)


@either_container
def test_images_beside_the_layers_are_named(tmp_path, name):
    """A preview is no layer; a PNG with another kind of name is one, and told."""
    place = named(tmp_path / name, "layer1.png", "layer2.png", "cover.jpg")
    assert read(place, **GIVEN).notes == ("not read, since no PNG: cover.jpg",)
    place = named(tmp_path / f"b{name}", "layer1.png", "layer2.png", "preview.png")
    stack = read(place, **GIVEN)
    assert len(stack) == 3
    assert stack.notes == ("read as layers though their names are unlike the others': preview.png",)


@either_container
@pytest.mark.parametrize(
    ("numbers", "note"),
    [
        ((1, 2, 3), None),
        ((0, 10, 20, 30), None),
        ((50, 100, 150), None),
        ((1, 2, 4, 10, 11), "numbers are missing between 2.png and 4.png, between 4.png and 10.png: the layers"),
        ((0, 10, 30, 40), "numbers are missing between 10.png and 30.png: the layers"),
        ((1, 3), "numbers are missing between 1.png and 3.png: the layers"),
        ((5, 6, 7), "the first image is 5.png: it is taken for the lowest layer"),
        (
            (1, 3, 4, 6, 7, 9, 10, 12),
            "between 1.png and 3.png, between 4.png and 6.png, between 7.png and 9.png and in 1",
        ),
    ],
)
def test_numbers_that_are_missing_are_told(tmp_path, name, numbers, note):
    """Layers close up over a gap: the part would be lower there, without a word. Steps of ten are no gaps."""
    stack = read(named(tmp_path / name, *(f"{n}.png" for n in numbers)), **GIVEN)
    assert len(stack) == len(numbers)
    assert [*stack.notes] == [] if note is None else note in stack.notes[0]


@either_container
def test_two_images_of_one_number_are_refused(tmp_path, name):
    """`1.png` and `01.png`: one of them is left from another export."""
    with pytest.raises(InputError, match=r"1.png and 0?1.png are of one number; a layer is one image"):
        read(named(tmp_path / name, "1.png", "01.png", "2.png"), **GIVEN)


def test_images_in_several_folders_are_refused(tmp_path):
    """Two parts in one zip are no stack of both."""
    place = named(tmp_path / "a.zip", "a/1.png", "a/2.png", "b/1.png")
    with pytest.raises(
        InputError, match=r"a.zip: has images in 2 folders \(a/, b/\); the layers of a part lie in one"
    ):
        read(place, **GIVEN)
    assert len(read(named(tmp_path / "b.zip", "a/1.png", "a/2.png"), **GIVEN)) == 2


@pytest.mark.parametrize("mode", ["RGBA", "LA", "P", "L", "I;16"])
def test_what_is_transparent_is_empty(tmp_path, mode):
    """White without opacity is nothing to expose; half opaque white is half light."""
    grey, alpha = np.array([[255, 255, 255, 0]], np.uint8), np.array([[255, 0, 128, 255]], np.uint8)
    if mode in ("RGBA", "LA"):
        layers = [grey] * (len(mode) - 1) + [alpha]
        image, how, expected = Image.fromarray(np.stack(layers, -1), mode), {}, [1, 0, 1, 0]
    elif mode == "P":
        image, how, expected = (
            Image.fromarray(np.array([[1, 2, 1, 0]], np.uint8), "P"),
            {"transparency": 2},
            [1, 0, 1, 0],
        )
        image.putpalette([0, 0, 0, 255, 255, 255, 255, 255, 255])
    elif mode == "L":
        image, how, expected = (
            Image.fromarray(np.array([[255, 200, 255, 0]], np.uint8)),
            {"transparency": 200},
            [1, 0, 1, 0],
        )
    else:
        wide = np.array([[65535, 51400, 65535, 0]], np.uint16)
        image, how, expected = Image.fromarray(wide), {"transparency": 51400}, [1, 0, 1, 0]
    image.save(tmp_path / "1.png", **how)
    layer = read(tmp_path / "1.png", **GIVEN)[0]
    assert layer.image().astype(int).tolist() == [expected]
    if mode in ("RGBA", "LA"):
        assert layer.source.grey is not None  # half light stays half light


def test_an_animation_is_told(tmp_path):
    """Of an animated PNG every program shows the first image, and so it is a layer; the others are named."""
    frames = [Image.fromarray(np.full((4, 4), value, np.uint8)) for value in (255, 0, 128)]
    frames[0].save(tmp_path / "1.png", save_all=True, append_images=frames[1:])
    stack = read(tmp_path / "1.png", **GIVEN)
    assert stack[0].image().all()
    assert stack.notes == ("1.png is an animation of 3 images; only the first is read",)
