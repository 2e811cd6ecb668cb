from __future__ import annotations

import importlib

import pytest
from sentences import refused

from mdm.errors import Error
from mdm.recording import compression

zstandard = pytest.importorskip("zstandard")
DATA = bytes(range(256)) * 100
FRAME = zstandard.compress(DATA)


def there_is():
    """Return the modules that are installed."""
    found = []
    for name in compression._MODULES:
        try:
            importlib.import_module(name)
        except ImportError:
            continue
        found.append(name)
    return found


@pytest.fixture(params=there_is())
def decompress(request, monkeypatch):
    monkeypatch.setattr(compression, "_MODULES", ("nothing.at.all", request.param))
    return compression.decompressor()


def test_a_frame_is_decompressed(decompress):
    assert decompress(FRAME, len(DATA)) == DATA


def test_no_more_is_decompressed_than_was_said(decompress):
    assert len(decompress(FRAME, 1000)) == 1001


@pytest.mark.parametrize("damaged", [b"", FRAME[:-20], b"nothing", FRAME[:6] + b"\xff" * 8 + FRAME[14:]])
def test_what_is_no_frame_is_refused_or_short(decompress, damaged):
    try:
        assert decompress(damaged, len(DATA)) != DATA
    except ValueError as error:
        assert str(error)


def test_without_a_module_the_way_out_is_told(monkeypatch):
    monkeypatch.setattr(compression, "_MODULES", ("nothing.at.all",))
    with refused(Error):
        compression.decompressor()
