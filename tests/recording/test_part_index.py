"""A file that is taken in by its index, against one that is read from its start."""

from __future__ import annotations

import random
import struct

import pytest
from hypothesis import given, settings, strategies as st

from mdm.recording import Record
from mdm.recording.part import Part
from mdm.recording.process import File


def written(path, seed, lost=0):
    """Write a small record with several chunks; leave out a number where some are lost."""
    chance = random.Random(seed)
    with path.open("wb") as stream:
        file = File(stream, "mdm/test", chunk=200)
        file.metadata("mdm", {"format": "1"})
        file.attach("files/a.toml", "text/plain", b"a" * chance.randrange(50))
        topics = [file.topic(name, f"mdm.{name}", b"{}") for name in ("lives", "modes")]
        sequence = 0
        for time in range(chance.randrange(1, 40)):
            sequence += lost if time == 5 else 0
            file.add_message(chance.choice(topics), time, b'{"time":%d}' % time, time, sequence)
            sequence += 1
        file.metadata("mdm.end", {"closed": "yes"})
        file.finish()


def facts(part):
    """Return all that a part tells."""
    told = {name: value for name, value in vars(part).items() if not name.startswith("_")}
    return told | {"messages": list(part.messages(None, 0, 2**63))}


@pytest.fixture
def scanned(monkeypatch):
    """Return a function that reads a file from its start."""

    def read(path):
        with monkeypatch.context() as patch:
            patch.setattr(Part, "_take_by_index", lambda *_: False)
            return Part(path)

    return read


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("lost", [0, 3])
def test_the_index_tells_all_that_reading_tells(tmp_path, scanned, seed, lost):
    path = tmp_path / "run.mcap"
    written(path, seed, lost)
    assert facts(Part(path)) == facts(scanned(path))


@settings(max_examples=60, deadline=None)
@given(place=st.integers(0, 10**6), bit=st.integers(0, 7), cut=st.booleans())
def test_no_damage_is_taken_for_a_whole_file(tmp_path_factory, place, bit, cut):
    path = tmp_path_factory.getbasetemp() / "damaged.mcap"
    written(path, 1)
    data = bytearray(path.read_bytes())
    place %= len(data)
    if cut:
        del data[place:]
    else:
        data[place] ^= 1 << bit
    path.write_bytes(data)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Part, "_take_by_index", lambda *_: False)
        try:
            expected = facts(Part(path))
        except Exception as error:
            expected = type(error), str(error)
    try:
        found = facts(Part(path))
    except Exception as error:
        found = type(error), str(error)
    assert found == expected


@pytest.mark.parametrize("kind", [8, 13])
@pytest.mark.parametrize("place", [2**64 - 1, 2**62, 5])
def test_an_index_without_a_checksum_that_leads_astray_is_not_followed(tmp_path, scanned, kind, place):
    path = tmp_path / "run.mcap"
    written(path, 2)
    data = bytearray(path.read_bytes())
    data[-12:-8] = bytes(4)  # MCAP's sign of no checksum
    (at,) = struct.unpack_from("<Q", data, len(data) - 28)
    while data[at] != kind:
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]
    struct.pack_into("<Q", data, at + 9 + (16 if kind == 8 else 0), place)
    path.write_bytes(data)
    assert facts(Part(path)) == facts(scanned(path))


def test_messages_of_a_time_are_read_without_the_rest(tmp_path, monkeypatch):
    path = tmp_path / "run.mcap"
    written(path, 2)
    record = Record(path)
    unpacked = []
    unpack = Part.unpack
    monkeypatch.setattr(Part, "unpack", lambda self, content: unpacked.append(content) or unpack(self, content))
    last = record.span[1]
    assert [each.time for each in record.messages(since=last)] == [last]
    assert len(unpacked) == 1
