from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
import tracemalloc
from functools import partial
from pathlib import Path

import pytest
from mcap.reader import make_reader
from records import HEAD, PATIENCE, official

from mdm.messages import Control
from mdm.recording import process
from mdm.recording.process import Claimed, Kept, claim
from mdm.recording.reader import Record
from mdm.recording.schemas import schema


def frame(kind, data):
    return process.HEADER.pack(kind, len(data)) + data


def message(topic, stamp, data):
    return frame(process.MESSAGE, process.MESSAGE_HEADER.pack(topic, stamp) + data)


BEGIN = frame(process.METADATA, json.dumps(["mdm", HEAD]).encode()) + frame(
    process.TOPIC, json.dumps(["controls", "mdm.Control", json.dumps(schema(Control))]).encode()
)


def ran(path, sent, **settings):
    """Run the process with bytes for input; return what it reported."""
    descriptor = claim(str(path))
    given = {
        "robot": os.getpid(),
        "path": str(path),
        "descriptor": descriptor,
        "library": "mdm/0.1.0",
        "split_bytes": None,
        "split_time": None,
        **settings,
    }
    done = subprocess.run(
        [sys.executable, "-P", process.__file__, json.dumps(given)],
        input=sent,
        stdout=subprocess.PIPE,
        pass_fds=(descriptor,),
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        timeout=PATIENCE,
    )
    os.close(descriptor)
    assert done.returncode == 0
    return [json.loads(line) for line in done.stdout.splitlines()]


@pytest.mark.parametrize("cuts", [(3, 7, -1), pytest.param((*range(7), *range(10, 40, 5)), marks=pytest.mark.slow)])
def test_a_frame_that_was_sent_in_part_is_left_out(tmp_path, cuts):
    path = tmp_path / "run.mcap"
    whole = message(1, 7, b'{"time":7,"command":"stop"}')
    for cut in cuts:
        assert ran(path, BEGIN + whole + whole[:cut])[-1] == {"written": 1, "finished": True}
        assert official(path) == [("controls", 7, 0, 7, b'{"time":7,"command":"stop"}')]


def test_a_robot_that_says_nothing_has_a_whole_file(tmp_path):
    path = tmp_path / "run.mcap"
    assert ran(path, b"") == [{"written": 0, "finished": True}]
    assert official(path) == []


def test_numbers_that_are_left_out_are_kept(tmp_path):
    path = tmp_path / "run.mcap"
    lost = frame(process.LOST, (5).to_bytes(8, "little"))
    told = b'{"time":7,"command":"stop"}'
    ran(path, BEGIN + message(1, 7, told) + lost + message(1, 8, told) + frame(process.END, b""))
    assert [each[2] for each in official(path)] == [0, 6]
    record = Record(path)
    assert (record.lost, record.closed) == (5, True)


def test_a_frame_that_cannot_be_written_is_told(tmp_path):
    path = tmp_path / "run.mcap"
    told = ran(path, BEGIN + frame(process.METADATA, b"?") + message(1, 7, b"{}"))
    assert [*told[0]] == ["failure"]
    assert told[-1] == {"written": 0, "lost": 1, "finished": False}


def opened(path, told):
    """Return what takes frames, with a file that is open."""
    settings = {"path": str(path), "descriptor": claim(str(path)), "library": "mdm/0.1.0"}
    make = partial(process._Output, split_bytes=None, split_time=None, **settings)
    return process._Recorder(make, told.append)


def truncated(path):
    os.truncate(path, 100)


def replaced(path):
    other = path.with_name("other.mcap")
    other.write_bytes(path.read_bytes())
    other.replace(path)


@pytest.mark.parametrize(
    ("harm", "why"),
    [
        (Path.unlink, "the file was removed"),
        (replaced, "the file was removed"),
        (truncated, "another program has cut the file short"),
    ],
)
@pytest.mark.parametrize("more", [b"", message(1, 8, b"{}")], ids=["idle", "busy"])
def test_a_file_that_is_gone_or_cut_is_told_with_all_that_is_lost(tmp_path, harm, why, more):
    told = []
    taker = opened(tmp_path / "run.mcap", told)
    taker.take(bytearray(BEGIN + message(1, 7, b"{}")))
    taker.second()
    harm(tmp_path / "run.mcap")
    taker.take(bytearray(more))
    taker.second()
    taker.take(bytearray(message(1, 9, b"{}")))
    taker.close()
    lost = 2 + bool(more)
    assert told == [
        {"written": 1},
        {"failure": why},
        {"written": 0, "lost": lost - 1},
        {"written": 0, "lost": lost, "finished": False},
    ]


def test_a_file_that_is_cut_just_before_its_end_is_told(tmp_path):
    told = []
    taker = opened(tmp_path / "run.mcap", told)
    taker.take(bytearray(BEGIN + message(1, 7, b"{}") + frame(process.END, b"")))
    taker.second()
    (tmp_path / "run.mcap").unlink()
    taker.close()
    assert told[1:] == [{"failure": "the file was removed"}, {"written": 0, "lost": 1, "finished": False}]


def test_a_file_may_be_moved_while_it_is_written(tmp_path):
    told = []
    taker = opened(tmp_path / "run.mcap", told)
    taker.take(bytearray(BEGIN + message(1, 7, b"{}")))
    taker.second()
    (tmp_path / "run.mcap").rename(tmp_path / "kept.mcap")
    taker.take(bytearray(message(1, 8, b"{}") + frame(process.END, b"")))
    taker.close()
    assert told == [{"written": 1}, {"written": 2, "finished": True}]
    assert Record(tmp_path / "kept.mcap").closed


def test_a_long_record_takes_no_more_memory_and_its_summary_has_all_chunks(tmp_path):
    path, chunks = tmp_path / "run.mcap", 400
    taker = opened(path, [])
    taker.take(bytearray(BEGIN))

    def grow(since):
        for stamp in range(since, since + chunks):
            taker.take(bytearray(message(1, stamp, b"{}")))
            taker._output._file.flush()  # a chunk of its own
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        before = grow(0)
        after = grow(chunks)
    finally:
        tracemalloc.stop()
    assert (after - before) / chunks < 50
    taker.take(bytearray(frame(process.END, b"")))
    taker.close()
    assert [each.name for each in tmp_path.iterdir()] == ["run.mcap"]
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert [each.message_start_time for each in summary.chunk_indexes] == [*range(2 * chunks)]
    assert [each[1] for each in official(path)] == [*range(2 * chunks)]


def test_a_folder_that_takes_no_other_file_takes_a_record(tmp_path, monkeypatch):
    def refuse(**_):
        raise PermissionError

    monkeypatch.setattr(process.tempfile, "TemporaryFile", refuse)
    taker = opened(tmp_path / "run.mcap", [])
    taker.take(bytearray(BEGIN + message(1, 7, b"{}") + frame(process.END, b"")))
    taker.close()
    assert Record(tmp_path / "run.mcap").closed


def test_it_loads_no_more_than_it_needs():
    program = (
        "import json, runpy, sys\nrunpy.run_path(sys.argv[1])\nimport mcap.writer\nprint(json.dumps([*sys.modules]))"
    )
    command = [sys.executable, "-P", "-c", program, process.__file__]
    loaded = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    assert not {name.split(".")[0] for name in loaded} & {"mdm", "msgspec", "numpy"}


def test_a_claim_holds_until_its_file_is_closed(tmp_path):
    path = str(tmp_path / "run.mcap")
    held = claim(path)
    with pytest.raises(Claimed):
        claim(path)
    os.close(held)
    os.close(claim(path))


@pytest.mark.parametrize("content", [b"x", b"\x89MCAQ0\r\n", b"[ensembles]"])
def test_only_records_are_replaced(tmp_path, content):
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    with pytest.raises(Claimed):
        claim(str(path))
    assert path.read_bytes() == content


def test_a_record_is_kept_where_it_is_to_be(tmp_path):
    path = tmp_path / "run.mcap"
    held = claim(str(path), keep=True)
    with pytest.raises(Claimed, match="another program"):
        claim(str(path), keep=True)
    os.write(held, process.MAGIC)
    os.close(held)
    with pytest.raises(Kept):
        claim(str(path), keep=True)
    assert path.read_bytes() == process.MAGIC


@pytest.mark.parametrize("content", [b"", b"\x89MC", process.MAGIC + b"\1\2"])
def test_a_record_that_was_cut_off_is_replaced(tmp_path, content):
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    os.close(claim(str(path)))
    assert path.read_bytes() == b""


def test_a_file_that_was_removed_is_let_go_of(tmp_path):
    """A day's record is removed since the disk is full: its room comes back."""
    told = []
    taker = opened(tmp_path / "run.mcap", told)
    stream = taker._output._stream
    descriptor = stream.descriptor
    (tmp_path / "run.mcap").unlink()
    taker.second()
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(descriptor)
    taker.close()
    assert [*told[0]] == ["failure"]


@pytest.mark.parametrize(
    ("count", "summary", "attached"),
    [
        (20_000, "os:fsencode", 1),
        (20_000, "os:there_is_no_such_function", 0),
        (19_999, "os:fsencode", 0),
        (20_000, "", 0),
    ],
)
def test_a_long_record_gets_a_summary_as_it_is_closed(tmp_path, count, summary, attached):
    path = tmp_path / "run.mcap"
    sent = b"".join(message(1, time, b"{}") for time in range(count))
    reports = ran(path, BEGIN + sent + frame(process.END, b""), summary=summary)
    record = Record(path)
    assert record.counts.total() == count
    assert record.flaws == ()
    assert [each.data for each in record.attachments] == [os.fsencode(path)] * attached
    assert ({"summarises": True} in reports) == (bool(summary) and count == 20_000)
