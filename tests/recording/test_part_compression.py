from __future__ import annotations

import importlib

import pytest
from sentences import refused

from mdm.errors import Error
from mdm.recording import part

zstandard = pytest.importorskip("zstandard")
lz4 = pytest.importorskip("lz4.frame")
DATA = bytes(range(256)) * 100
FRAMES = {"zstd": zstandard.compress(DATA), "lz4": lz4.compress(DATA)}


def there_is():
    """Return the modules that are installed, each with what it is for."""
    found = []
    for kind, names in part._MODULES.items():
        for name in names:
            try:
                importlib.import_module(name)
            except ImportError:
                continue
            found.append((kind, name))
    return found


@pytest.fixture(params=there_is(), ids=lambda given: given[1])
def codec(request, monkeypatch):
    """Return a frame, and what decompresses it, for each module."""
    kind, name = request.param
    monkeypatch.setitem(part._MODULES, kind, ("nothing.at.all", name))
    return FRAMES[kind], part.decompressor(kind)


def test_a_frame_is_decompressed(codec):
    frame, decompress = codec
    assert decompress(frame, len(DATA)) == DATA


def test_no_more_is_decompressed_than_was_said(codec):
    frame, decompress = codec
    assert len(decompress(frame, 1000)) == 1001


@pytest.mark.parametrize(
    "damage",
    [
        lambda _: b"",
        lambda frame: frame[:-20],
        lambda _: b"nothing",
        lambda frame: frame[:6] + b"\xff" * 8 + frame[14:],
    ],
    ids=["empty", "cut off", "text", "changed"],
)
def test_what_is_no_frame_is_refused_or_short(codec, damage):
    frame, decompress = codec
    try:
        assert decompress(damage(frame), len(DATA)) != DATA
    except ValueError as error:
        assert str(error)


@pytest.mark.parametrize("kind", sorted(part.COMPRESSIONS))
def test_without_a_module_the_way_out_is_told(monkeypatch, kind):
    monkeypatch.setitem(part._MODULES, kind, ("nothing.at.all",))
    with refused(Error):
        part.decompressor(kind)
