from __future__ import annotations

import importlib.util
import os
import resource
import select
import signal
import stat
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest
from mcap.reader import make_reader
from records import HEAD, PATIENCE, Writing, decision, encoded, official, wait_until_written, written
from sentences import refused

from mdm.errors import ConfigError, Error, FormatError
from mdm.messages import Decision
from mdm.recording import schemas
from mdm.recording.reader import Record
from mdm.recording.writer import FileSettings, RecordWriter


def test_the_official_reader_reads_what_was_written(tmp_path):
    decisions = [decision(number) for number in range(5000)]
    path = written(tmp_path / "run.mcap", [("decisions", each) for each in decisions])
    assert official(path) == [
        ("decisions", each.time, number, each.time, encoded(each)) for number, each in enumerate(decisions)
    ]


def test_the_official_reader_has_head_files_and_schemas(tmp_path):
    record = Writing(tmp_path / "run.mcap")
    record.writer.attach("robot.toml", "application/toml", b"[ensembles]\n")
    record.write("decisions", decision(1))
    with record.close().open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert {each.name: each.metadata for each in reader.iter_metadata()}["mdm"] == HEAD
        assert [(each.name, each.media_type, each.data) for each in reader.iter_attachments()] == [
            ("robot.toml", "application/toml", b"[ensembles]\n")
        ]
        summary = reader.get_summary()
        (schema,) = summary.schemas.values()
        assert (schema.name, schema.encoding) == ("mdm.Decision", "jsonschema")
        assert summary.statistics.message_count == 1


def test_messages_are_compressed(tmp_path):
    path = written(tmp_path / "run.mcap", [("decisions", decision(number)) for number in range(5000)])
    assert path.stat().st_size < sum(len(encoded(decision(number))) for number in range(5000)) / 3


def test_what_is_too_much_is_dropped_counted_and_told_in_the_numbers(tmp_path):
    record = Writing(tmp_path / "run.mcap", bound=5000)
    for number in range(100):
        record.write("decisions", decision(number))  # nothing is sent meanwhile
    taken = record.writer.statistics().messages
    assert 0 < taken < 100
    record.writer.drain(PATIENCE)
    record.write("decisions", decision(100))
    path = record.close()
    statistics = record.writer.statistics()
    assert (statistics.messages, statistics.written, statistics.dropped) == (taken + 1, taken + 1, 100 - taken)
    assert [each[2] for each in official(path)] == [*range(taken), 100]
    assert Record(path).lost == 100 - taken


def test_what_was_dropped_last_is_told_too(tmp_path):
    record = Writing(tmp_path / "run.mcap", bound=5000)
    for number in range(100):
        record.write("decisions", decision(number))
    path = record.close()
    assert Record(path).lost == record.writer.statistics().dropped > 0


def test_attached_files_take_no_room_of_messages(tmp_path):
    record = Writing(tmp_path / "run.mcap", bound=5000)
    record.writer.attach("model", "application/octet-stream", bytes(100_000))
    record.write("decisions", decision(0))
    path = record.close()
    assert record.writer.statistics().dropped == 0
    assert Record(path).attachments[0].data == bytes(100_000)


def test_a_file_larger_than_frames_is_not_attached(tmp_path):
    class Large(bytes):
        __slots__ = ()

        def __len__(self):
            return 2**32

    record = Writing(tmp_path / "run.mcap")
    with refused(Error):
        record.writer.attach("model.npz", "application/octet-stream", Large())
    record.close()


def test_flush_never_waits(tmp_path):
    """The process that writes stands still, and nothing that it is sent is read."""
    record = Writing(tmp_path / "run.mcap", bound=4_000_000)
    record.writer._process.send_signal(signal.SIGSTOP)
    number = 0
    while not record.writer.statistics().dropped:
        record.write("decisions", decision(number))
        record.writer.flush()
        number += 1
    begin = time.monotonic()
    record.writer.close(0.01)
    assert time.monotonic() - begin < PATIENCE / 2
    assert "was not complete after 0.01 s" in record.writer.failure
    record.writer._process.send_signal(signal.SIGCONT)
    record.writer._process.wait(PATIENCE)
    read = Record(tmp_path / "run.mcap")
    assert read.torn is None
    assert [each.sequence for each in read.messages()] == [*range(read.counts["decisions"])]
    assert read.closed is False


def test_the_end_of_the_process_is_told_and_nothing_raised(tmp_path):
    record = Writing(tmp_path / "run.mcap")
    record.write("decisions", decision(0))
    record.writer._process.kill()
    while record.writer.failure is None:
        record.write("decisions", decision(1))
        record.writer.flush()
        select.select([record.writer._ear], [], [], PATIENCE)
    record.writer._process.wait(PATIENCE)
    assert record.writer.failure.startswith(f"{tmp_path}/run.mcap: the record ends here: the process that writes it")
    before = record.writer.statistics()
    record.write("decisions", decision(2))
    record.writer.flush()
    assert record.writer.statistics().dropped == before.dropped + 1
    record.writer.close(PATIENCE)


def test_a_process_is_silent_three_seconds_after_its_last_word(tmp_path, monkeypatch):
    now = [0.0]
    clock = SimpleNamespace(monotonic=lambda: now[0])
    record = Writing(tmp_path / "run.mcap")
    process = record.writer._process
    select.select([record.writer._ear], [], [], PATIENCE)  # its first word
    process.send_signal(signal.SIGSTOP)
    monkeypatch.setattr("mdm.recording.writer.times", clock)
    record.writer.flush()
    found = []
    for now[0] in (2.9, 3.1):
        record.writer.flush()
        found.append(record.writer.silent)
    assert found == [False, True]
    process.send_signal(signal.SIGCONT)
    select.select([record.writer._ear], [], [], PATIENCE)
    record.writer.flush()
    assert not record.writer.silent
    monkeypatch.undo()
    record.close()


def test_messages_for_which_there_is_no_memory_leave_the_frames_whole(tmp_path):
    record = Writing(tmp_path / "run.mcap")
    record.write("decisions", decision(0))

    class Full(bytearray):
        def __iadd__(self, data):
            raise MemoryError

    buffer, record.writer._buffer = record.writer._buffer, Full()
    with pytest.raises(MemoryError):
        record.write("decisions", decision(1))
    record.writer._buffer = buffer
    record.writer.skip(1)
    record.write("decisions", decision(2))
    record.close()
    assert [each.message.epoch for each in Record(tmp_path / "run.mcap").messages()] == [0, 2]
    assert Record(tmp_path / "run.mcap").lost == 1


@pytest.mark.skipif(not hasattr(resource, "prlimit"), reason="limits of other processes are Linux's")
def test_a_full_disk_is_told_and_the_robot_goes_on(tmp_path):
    record = Writing(tmp_path / "run.mcap")
    resource.prlimit(record.writer._process.pid, resource.RLIMIT_FSIZE, (50_000, 50_000))
    number = 0
    while record.writer.failure is None:
        record.write("decisions", decision(number, name=os.urandom(300).hex()))
        record.writer.drain(PATIENCE)
        number += 1
    assert record.writer.failure == f"{tmp_path}/run.mcap: the record ends here: File too large"
    for more in range(100):
        record.write("decisions", decision(number + more))
    record.writer.close(PATIENCE)
    statistics = record.writer.statistics()
    assert statistics.messages == number + 100
    assert statistics.written + statistics.dropped == number + 100
    read = Record(tmp_path / "run.mcap")
    assert "ends without its summary" in read.torn
    assert read.unread == 0  # what did not fit has left nothing
    assert [each.sequence for each in read.messages()] == [*range(read.counts["decisions"])]
    assert read.counts["decisions"] >= statistics.written


ROBOT = """
import sys
sys.path[:0] = {path!r}
from records import Writing, decision
record = Writing({file!r})
for number in range(3000):
    record.write("decisions", decision(number))
record.writer.drain(60)
assert not record.writer.statistics().pending
{fork}
print("handed over", flush=True)
sys.stdin.read()
"""
FORK = """
import os
if not os.fork():
    import signal
    signal.pause()
"""


@pytest.mark.parametrize("fork", ["", FORK], ids=["alone", "with a child that holds the pipe"])
def test_what_was_handed_over_survives_the_robot(tmp_path, fork):
    file = tmp_path / "run.mcap"
    program = ROBOT.format(path=sys.path, file=str(file), fork=fork)
    with subprocess.Popen(
        [sys.executable, "-c", program],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,
        pass_fds=(),
    ) as robot:
        assert robot.stdout.readline() == b"handed over\n"
        os.kill(robot.pid, signal.SIGKILL)
        robot.wait(PATIENCE)
        wait_until_written(file)
        os.killpg(robot.pid, signal.SIGKILL) if fork else None
    assert [each[2] for each in official(file)] == [*range(3000)]
    assert Record(file).closed is False


def test_signals_of_the_terminal_end_no_record(tmp_path):
    record = Writing(tmp_path / "run.mcap")
    record.write("decisions", decision(0))
    record.writer.drain(PATIENCE)
    while not record.writer.statistics().written:  # it is past its start
        select.select([record.writer._ear], [], [], PATIENCE)
        record.writer.flush()
    process = record.writer._process
    assert os.getsid(process.pid) != os.getsid(0)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        process.send_signal(number)
    record.write("decisions", decision(1))
    assert len(official(record.close())) == 2


def test_what_is_told_to_be_written_survives_the_process(tmp_path):
    record = Writing(tmp_path / "run.mcap")
    for number in range(100):
        record.write("decisions", decision(number))
    record.writer.drain(PATIENCE)
    while not record.writer.statistics().written:
        select.select([record.writer._ear], [], [], PATIENCE)
        record.writer.flush()
    record.writer._process.kill()
    record.writer._process.wait(PATIENCE)
    written_by_then = record.writer.statistics().written
    read = Record(tmp_path / "run.mcap")
    assert read.torn is not None
    assert read.counts["decisions"] >= written_by_then > 0
    record.writer.close(PATIENCE)


def test_files_are_split_by_size_and_each_is_whole(tmp_path):
    record = Writing(tmp_path / "run.mcap", split_bytes=20_000)
    record.writer.attach("robot.toml", "application/toml", b"content")
    decisions = [decision(number, name=os.urandom(100).hex()) for number in range(1000)]
    for each in decisions:
        record.write("decisions", each)
        record.writer.drain(PATIENCE)
    record.close()
    paths = [tmp_path / "run.mcap", *(tmp_path / f"run-{number}.mcap" for number in range(1, 100))]
    paths = [path for path in paths if path.exists()]
    assert len(paths) > 3
    assert len(list(tmp_path.iterdir())) == len(paths)
    assert [each for path in paths for each in official(path)] == [
        ("decisions", each.time, number, each.time, encoded(each)) for number, each in enumerate(decisions)
    ]
    for path in paths:
        alone = Record([path])
        assert alone.head == HEAD
        assert [each.data for each in alone.attachments] == [b"content"]
        assert all(isinstance(each.message, Decision) for each in alone.messages())
        assert path.stat().st_size < 30_000


def test_files_are_split_by_time(tmp_path):
    path = written(
        tmp_path / "run.mcap", [("decisions", decision(1000 * number)) for number in range(10)], split_seconds=3
    )
    spans = [[each[1] for each in official(each)] for each in (path, *sorted(tmp_path.glob("run-*.mcap")))]
    assert [[stamp // 10**9 for stamp in span] for span in spans] == [[0, 1, 2], [3, 4, 5], [6, 7, 8], [9]]


def test_a_file_that_is_in_the_way_of_a_split_ends_the_record(tmp_path):
    (tmp_path / "run-1.mcap").write_text("a letter")
    record = Writing(tmp_path / "run.mcap", split_seconds=1)
    while record.writer.failure is None:
        record.write("decisions", decision(5000 * record.writer.statistics().messages))
        record.writer.drain(PATIENCE)
    assert "would be overwritten" in record.writer.failure
    record.writer.close(PATIENCE)
    assert (tmp_path / "run-1.mcap").read_text() == "a letter"
    assert len(official(tmp_path / "run.mcap")) == 1


def test_a_record_replaces_a_record(tmp_path):
    for count in (100, 3):
        path = written(tmp_path / "run.mcap", [("decisions", decision(number)) for number in range(count)])
    assert len(official(path)) == 3


def test_a_record_is_kept_and_the_next_name_taken(tmp_path):
    for count in (100, 3, 7):
        written(tmp_path / "run.mcap", [("decisions", decision(number)) for number in range(count)], keep=True)
    assert [len(official(tmp_path / name)) for name in ("run.mcap", "run.2.mcap", "run.3.mcap")] == [100, 3, 7]


def test_files_of_a_split_record_are_kept_without_the_first(tmp_path):
    pairs = [("decisions", decision(1000 * number)) for number in range(6)]
    written(tmp_path / "run.mcap", pairs, split_seconds=3)
    (tmp_path / "run.mcap").unlink()
    before = (tmp_path / "run-1.mcap").read_bytes()
    assert written(tmp_path / "run.mcap", pairs, split_seconds=3, keep=True) == tmp_path / "run.2.mcap"
    assert (tmp_path / "run-1.mcap").read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run-1.mcap", "run.2-1.mcap", "run.2.mcap"]


def test_what_cannot_be_opened_is_told_at_once(tmp_path, monkeypatch):
    (tmp_path / "robot.toml").write_text("[ensembles]")
    (tmp_path / "folder").mkdir()
    for name in ("folder", "robot.toml", "nowhere/run.mcap", "robot.toml/run.mcap"):
        with refused(FormatError):
            RecordWriter(tmp_path / name).open()
    assert (tmp_path / "robot.toml").read_text() == "[ensembles]"
    with refused(FormatError):
        RecordWriter("/proc/run.mcap").open()
    with refused(FormatError):
        RecordWriter(tmp_path / f"{'x' * 300}.mcap").open()
    with refused(Error):
        RecordWriter("a\0b").open()
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with refused(Error):
        RecordWriter(tmp_path / "run.mcap").open()
    assert not (tmp_path / "run.mcap").exists()


def test_two_do_not_record_to_one_file(tmp_path):
    record = Writing(tmp_path / "run.mcap")
    record.write("decisions", decision(0))
    with refused(FormatError):
        RecordWriter(tmp_path / "run.mcap").open()
    assert len(official(record.close())) == 1


@pytest.mark.parametrize(
    "options",
    [{"split_bytes": 0}, {"split_bytes": 1.5}, {"split_seconds": 0}, {"split_seconds": float("inf")}],
    ids=str,
)
def test_options_out_of_their_range(tmp_path, options):
    with refused(ConfigError):
        RecordWriter(tmp_path / "run.mcap", FileSettings(**options))


def test_a_process_that_cannot_be_started_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    with refused(FormatError):
        RecordWriter(tmp_path / "run.mcap").open()


def test_a_writer_that_was_never_opened_takes_nothing(tmp_path):
    writer = RecordWriter(tmp_path / "run.mcap")
    topic = writer.topic("decisions", "mdm.Decision", schemas.schema(Decision))
    writer.write(topic, 0, b"{}")
    writer.flush()
    writer.close()
    assert writer.statistics().dropped == 1
    assert not list(tmp_path.iterdir())


def test_files_are_readable_as_others_are(tmp_path):
    other = tmp_path / "other"
    other.touch()
    path = written(tmp_path / "run.mcap", [])
    assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE(other.stat().st_mode)
