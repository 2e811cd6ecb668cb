"""Images: what is read is what Pillow wrote, and what cannot be read right is refused."""

from __future__ import annotations

import struct
import sys
import zlib

import numpy as np
import pytest
from hypothesis import given, strategies as st
from PIL import Image as Pillow
from sentences import refused

from mdm.errors import FormatError, MapError
from mdm.maps.files.image import read_image

PIXELS = np.array([[[1, 2, 3], [4, 5, 6]], [[255, 0, 255], [0, 0, 0]], [[9, 8, 7], [0, 180, 255]]], dtype=np.uint8)
NUMBERS = [[0x030201, 0x060504], [0xFF00FF, 0], [0x070809, 0xFFB400]]


def saved(tmp_path, array, mode, name="image.png", **options):
    Pillow.fromarray(array).convert(mode).save(tmp_path / name, **options)
    return tmp_path / name


def png(path, bits, kind, rows, *, columns, extra=b""):
    """Write a PNG by hand, for what Pillow does not write."""

    def chunk(name, body):
        return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))

    header = struct.pack(">IIBBBBB", columns, len(rows), bits, kind, 0, 0, 0)
    body = b"".join(b"\0" + row for row in rows)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + extra
        + chunk(b"IDAT", zlib.compress(body))
        + chunk(b"IEND", b"")
    )
    return path


@pytest.mark.parametrize("name", ["image.png", "image.bmp", "image.ppm"])
def test_the_first_colour_is_the_least_significant(tmp_path, name):
    image = read_image(saved(tmp_path, PIXELS, "RGB", name))
    assert image.shape == (3, 2)
    assert image.numbers.tolist() == NUMBERS
    assert image.brightness[0, 1] == 5
    assert image.opacity is None


def test_opacity_is_the_most_significant(tmp_path):
    pixels = np.dstack([PIXELS, np.full((3, 2), 255, dtype=np.uint8)])
    pixels[0, 0, 3] = 2
    image = read_image(saved(tmp_path, pixels, "RGBA"))
    assert image.numbers.tolist() == [
        [number | (2 if (row, column) == (0, 0) else 255) << 24 for column, number in enumerate(numbers)]
        for row, numbers in enumerate(NUMBERS)
    ]
    assert image.opacity is not None
    assert image.opacity.tolist() == [[2, 255], [255, 255], [255, 255]]


def test_an_image_with_a_palette_gives_indices_and_shows_colours(tmp_path):
    picture = Pillow.fromarray(np.array([[0, 2], [1, 0]], dtype=np.uint8), mode="P")
    picture.putpalette([10, 20, 30, 0, 0, 0, 255, 255, 255])
    picture.save(tmp_path / "image.png")
    image = read_image(tmp_path / "image.png")
    assert image.numbers.tolist() == [[0, 2], [1, 0]]
    assert image.brightness.tolist() == [[20, 255], [0, 20]]


@pytest.mark.parametrize("bits", [1, 2, 4, 8, 16])
def test_grey_gives_the_number_itself_whatever_its_depth(tmp_path, bits):
    most = 2**bits - 1
    row = (1).to_bytes(2, "big") + most.to_bytes(2, "big") if bits == 16 else bytes([1, most])
    if bits < 8:
        row = bytes([(1 << (8 - bits)) | (most << (8 - 2 * bits))])
    image = read_image(png(tmp_path / "image.png", bits, 0, [row], columns=2))
    assert image.numbers.tolist() == [[1, most]]
    assert (image.brightness / image.most).tolist() == [[1 / most, 1]]


@pytest.mark.parametrize(("kind", "channels"), [(2, 3), (4, 2), (6, 4)])
def test_sixteen_bits_per_colour_are_refused(tmp_path, kind, channels):
    path = png(tmp_path / "image.png", 16, kind, [b"\1\2" * channels * 2], columns=2)
    with refused(FormatError):
        read_image(path)


@given(
    st.sampled_from([b"P2", b"P5"]),
    st.sampled_from([1, 100, 255, 256, 1000, 65535]),
    st.integers(1, 4),
    st.integers(1, 4),
    st.randoms(use_true_random=False),
)
def test_portable_greymaps(tmp_path_factory, kind, most, rows, columns, random):
    numbers = [[random.randint(0, most) for _ in range(columns)] for _ in range(rows)]
    path = tmp_path_factory.mktemp("image") / "image.pgm"
    if kind == b"P2":
        body = b"# more\n" + b"\n".join(b" ".join(str(number).encode() for number in row) for row in numbers)
    else:
        body = np.array(numbers, dtype=">u1" if most < 256 else ">u2").tobytes()
    path.write_bytes(kind + b"# by hand\n" + f"{columns}\n#\n {rows} {most}\n".encode() + body)
    image = read_image(path)
    assert (image.numbers.tolist(), image.most) == (numbers, most)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "no PGM, PPM, PNG or BMP"),
        (b"GIF89a", "no PGM, PPM, PNG or BMP"),
        (b"P5 2 2", "header"),
        (b"P5 2 2 255\n\0\0\0", "3 numbers in place of 4"),
        (b"P5 2 1 255\n\0\0\0", "3 numbers in place of 2"),
        (b"P5 0 2 255\n", "has none"),
        (b"P5 99999 99999 255\n", "more than 100,000,000"),
        (b"P5 2 1 0\n\0\0", "not in 1"),
        (b"P5 2 1 9\n\0\x0a", "at most 9"),
        (b"P2 2 1 9\n3 -1", "at most 9"),
        (b"P2 2 1 9\n3 x", "no whole number|not a whole number"),
        (b"P6 1 1 1000\n\0\0\0\0\0\0", "16 bits per colour"),
        (b"\x89PNG\r\n\x1a\n", "damaged"),
        (b"BM", "damaged"),
    ],
)
def test_damaged_images_are_told(tmp_path, content, message):
    path = tmp_path / "image"
    path.write_bytes(content)
    with pytest.raises(FormatError, match=message) as caught:
        read_image(path)
    assert str(caught.value).startswith(f"{path}: ")


def test_a_cut_png_is_damaged_and_an_enormous_one_refused(tmp_path):
    path = saved(tmp_path, PIXELS, "RGB")
    path.write_bytes(path.read_bytes()[:60])
    with refused(FormatError):
        read_image(path)
    png(path, 8, 0, [b""], columns=2_000_000_000)
    with refused(FormatError):
        read_image(path)


def test_without_pillow_greymaps_are_read_and_pngs_told(tmp_path, monkeypatch):
    path = saved(tmp_path, PIXELS, "RGB")
    saved(tmp_path, PIXELS[:, :, 0], "L", "image.pgm")
    monkeypatch.setitem(sys.modules, "PIL", None)
    assert read_image(tmp_path / "image.pgm").numbers.tolist() == PIXELS[:, :, 0].tolist()
    with refused(MapError):
        read_image(path)
