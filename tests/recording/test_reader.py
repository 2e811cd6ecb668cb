from __future__ import annotations

import io
import json
import random
import re
import select
import struct
from contextlib import suppress
from itertools import product

import damage
import msgspec
import pytest
from mcap.records import Chunk, Message as OfficialMessage
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, IndexType
from records import HEAD, PATIENCE, Writing, copied, decision, encoded, official, written
from sentences import refused

from mdm.errors import Error, FormatError
from mdm.messages import ActionLife, Control, Decision, Message, State
from mdm.recording.process import File
from mdm.recording.reader import Record, records_of
from mdm.recording.schemas import schema
from mdm.stimuli import Said, Stimulus

SOUND, MESSAGES = damage.sound()
FLAGS = (
    "repeat_channels",
    "repeat_schemas",
    "use_statistics",
    "use_summary_offsets",
    "enable_crcs",
    "enable_data_crcs",
)
INDICES = [
    IndexType.ALL,
    IndexType.NONE,
    IndexType.CHUNK | IndexType.MESSAGE,
    IndexType.ATTACHMENT | IndexType.METADATA,
]
PACKINGS = [{"use_chunking": False}, *({"compression": each} for each in CompressionType)]


@pytest.fixture
def read(tmp_path):
    """Return a function that reads a record from bytes."""
    path = tmp_path / "run.mcap"

    def call(content):
        path.write_bytes(content)
        return Record(path)

    return call


def of(library="mdm/0.1.0", head=HEAD, times=(1, 2, 3)):
    """Return a record with controls, written by the official library alone."""
    content = io.BytesIO()
    file = File(content, library)
    if head is not None:
        file.metadata("mdm", head)
    topic = file.topic("controls", "mdm.Control", json.dumps(schema(Control)).encode())
    for number, time in enumerate(times):
        file.add_message(topic, time, encoded(Control(time, "stop")), time, number)
    file.finish()
    return content.getvalue()


def test_messages_come_in_order_as_structs(tmp_path):
    pairs = []
    for number in range(50):
        made = decision(number // 2)  # of one turn, and so of one time
        pairs += [("decisions", made), ("lives", ActionLife(made.time, "patrol", number, "Go", "running"))]
    record = Record(written(tmp_path / "run.mcap", pairs))
    assert [(each.topic, each.message) for each in record.messages()] == pairs
    assert [each.sequence for each in record.messages()] == [*range(100)]
    assert record.counts == {"decisions": 50, "lives": 50}
    assert record.span == (0, 24_000_000)
    assert record.head == HEAD
    assert (record.torn, record.closed, record.lost, record.unread, record.number) == (None, True, 0, 0, 0)
    assert record.size == (tmp_path / "run.mcap").stat().st_size
    assert record.topics["lives"].schema_name == "mdm.ActionLife"


def test_messages_are_chosen_by_topic_and_time(read):
    record = read(SOUND)
    assert [*record.messages(["decisions"])] == [*record.messages()]
    assert [*record.messages([])] == []
    chosen = [each.time for each in record.messages(since=7_000_000, until=300_000_000)]
    assert chosen == [number * 1_000_000 for number in range(7, 300)]
    with refused(Error):
        next(record.messages(["nothing"]))


def test_stimuli_come_with_what_was_said(tmp_path):
    said = Said(5, "patrol/state", "State", State(5, 2, (1, 0)), "task", "patrol", 7)
    record = Writing(tmp_path / "run.mcap")
    record.write("stimuli", said, Stimulus)
    record.write("stimuli", Said(6, "weather", "Weather", {"wet": True}), Stimulus)
    read = Record(record.close())
    assert [each.message for each in read.messages()] == [said, Said(6, "weather", "Weather", {"wet": True})]


class Weather(Message, frozen=True, gc=False):
    wet: bool


def test_messages_of_unknown_types_are_what_json_has_unless_their_type_is_given(tmp_path):
    path = written(tmp_path / "run.mcap", [("weather", Weather(1, wet=True))])
    assert [each.message for each in Record(path).messages()] == [{"time": 1, "wet": True}]
    assert [each.message for each in Record(path, types={"mdm.Weather": Weather}).messages()] == [Weather(1, wet=True)]


def test_files_of_a_split_record_are_one(tmp_path):
    pairs = [("decisions", decision(1000 * number)) for number in range(10)]
    path = written(tmp_path / "run.mcap", pairs, split_seconds=3)
    paths = [path, *(tmp_path / f"run-{number}.mcap" for number in (1, 2, 3))]
    for given in (path, str(path), paths):
        record = Record(given)
        assert [each.message for each in record.messages()] == [message for _, message in pairs]
        assert record.paths == paths
        assert record.counts == {"decisions": 10}
        assert (record.torn, record.closed, record.lost) == (None, True, 0)
    alone = Record(paths[2])
    assert (alone.number, alone.counts["decisions"], alone.closed) == (2, 3, None)
    with refused(FormatError):
        Record([paths[0], paths[2]])
    with refused(FormatError):
        Record(paths[::-1])
    with refused(Error):
        Record([])


@pytest.mark.parametrize("missing", [1, 2, 3])
def test_a_file_of_a_split_record_that_is_missing_is_told(tmp_path, missing):
    pairs = [("decisions", decision(1000 * number)) for number in range(10)]
    path = written(tmp_path / "run.mcap", pairs, split_seconds=3)
    away = tmp_path / f"run-{missing}.mcap"
    away.unlink()
    record = Record(path)
    assert record.torn == f"{away}: this file of the record is missing, or is of another record"
    assert record.counts == {"decisions": 3 * missing}
    assert (record.unread, record.closed) == (0, None)
    away.write_text("a letter")
    assert Record(path).torn == record.torn


def test_a_file_of_a_split_record_alone_is_no_record(tmp_path):
    pairs = [("decisions", decision(1000 * number)) for number in range(10)]
    written(tmp_path / "run.mcap", pairs, split_seconds=3)
    last = tmp_path / "run-3.mcap"
    assert Record(last).torn == f"{last}: this is file 4 of a split record alone: give the first one"
    assert Record([last]).torn is None  # which was asked for


def test_files_that_another_record_has_left_are_not_taken(tmp_path):
    for count in (10, 4):
        pairs = [("decisions", decision(1000 * number)) for number in range(count)]
        path = written(tmp_path / "run.mcap", pairs, split_seconds=3)
    assert len(list(tmp_path.iterdir())) == 4
    assert Record(path).counts == {"decisions": 4}
    with refused(FormatError):
        Record([path, tmp_path / "run-2.mcap"])
    (tmp_path / "run-1.mcap").write_text("a letter")
    assert Record(path).counts == {"decisions": 3}


def test_a_record_that_is_being_written_says_so(tmp_path):
    record = Writing(tmp_path / "run.mcap")
    record.write("decisions", decision(0))
    record.writer.drain(PATIENCE)
    while not record.writer.statistics().written:
        assert select.select([record.writer._ear], [], [], PATIENCE)[0]
        record.writer.flush()
    live = Record(tmp_path / "run.mcap")
    assert "it is still being written" in live.torn
    assert (live.counts["decisions"], live.closed) == (1, None)
    record.close()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("empty", b""),
        ("text", b"discount: 0.9\n"),
        ("short", b"\x89MCAP"),
        ("magic alone", b"\x89MCAP0\r\n"),
        ("cut in its head", SOUND[:60]),
        ("another program's", of("ros2bag", None)),
        ("without a head", of(head=None)),
        ("newer", of(head={"format": "2", "mdm": "0.9.0"})),
        ("unnumbered", of(head={"format": "two"})),
        ("without a format", of(head={})),
    ],
    ids=lambda given: given if isinstance(given, str) else "",
)
def test_what_is_no_record_is_refused_in_a_sentence(read, name, content):
    with refused(FormatError):
        read(content)


def test_a_file_that_is_not_there_or_a_folder_is_refused(tmp_path):
    with refused(FormatError):
        Record(tmp_path / "missing.mcap")
    with refused(FormatError):
        Record(tmp_path)


def test_records_that_other_programs_wrote_anew_are_read(read):
    record = read(of("another/1.0"))
    assert [each.message for each in record.messages()] == [Control(time, "stop") for time in (1, 2, 3)]


def read_of(record):
    """Return all that is read of a record but where it is."""
    facts = ("metadata", "attachments", "topics", "counts", "span", "torn", "closed", "lost", "gap", "damage", "unread")
    return {fact: getattr(record, fact) for fact in facts}, [*record.raw()]


@pytest.fixture(scope="module")
def of_two_topics(tmp_path_factory):
    """A record of few messages, with a file within it."""
    writing = Writing(tmp_path_factory.mktemp("two") / "run.mcap")
    for number in range(4):
        writing.write("decisions", decision(number))
        writing.write("lives", ActionLife(number * 1_000_000, "patrol", number, "Go", "running"))
    writing.writer.attach("robot.toml", "application/toml", b"[ensembles]")
    return writing.close().read_bytes()


@pytest.mark.parametrize("packing", PACKINGS, ids=lambda packing: next(iter(packing.values())))
def test_a_record_is_read_whole_whatever_the_official_writer_is_asked_for(read, of_two_topics, packing):
    whole = read_of(read(of_two_topics))
    assert (whole[0]["torn"], whole[0]["closed"], len(whole[1])) == (None, True, 8)
    for flags in product([True, False], repeat=len(FLAGS)):
        for index_types in INDICES:
            options = {**packing, **dict(zip(FLAGS, flags, strict=True)), "index_types": index_types, "chunk_size": 300}
            assert read_of(read(copied(of_two_topics, **options))) == whole, options


@pytest.mark.parametrize("packing", PACKINGS, ids=lambda packing: next(iter(packing.values())))
@pytest.mark.parametrize("metadata_last", [True, False], ids=["behind", "before"])
def test_parts_of_a_record_that_was_written_anew_are_read(read, packing, metadata_last):
    whole = read_of(read(SOUND))
    record = read(copied(SOUND, metadata_last=metadata_last, chunk_size=4096, **packing))
    assert read_of(record) == whole
    chosen = [each.sequence for each in record.messages(["decisions"], since=7_000_000, until=300_000_000)]
    assert chosen == [*range(7, 300)]


def test_messages_without_chunks_are_read_many_at_once(read):
    record = read(copied(SOUND, use_chunking=False))
    assert len(record._files[0].chunks) == 1


def test_a_message_without_a_chunk_that_is_damaged_is_told(read):
    content = bytearray(copied(SOUND, use_chunking=False, enable_data_crcs=True))
    place = content.index(MESSAGES[100][:60])
    content[place] ^= 1
    assert "its data has not its checksum" in read(bytes(content)).damage[0]
    content[place] ^= 1
    content[place - 22] = 9  # the number of its topic, of which there is none
    record = read(bytes(content))
    (sentence,) = record.damage
    assert "a message is damaged" in sentence
    assert [each[2] for each in record.raw()] == [*range(100), *range(101, 400)]
    assert (record.lost, record.gap.sequence) == (1, 99)


def test_bytes_that_look_like_a_chunk_without_a_checksum_are_not_read(read):
    content = copied(SOUND, compression=CompressionType.NONE, index_types=IndexType.NONE, enable_crcs=False)
    start = content.index(b"\x06", content.index(b"robot.toml"))
    record = read(content[:start] + b"\xff" * 9 + content[start + 9 :])
    assert record.torn
    assert [*record.raw()] == []


def test_each_cut_is_read_to_the_last_whole_chunk(read):
    """What is read of each cut is all that the official reader of streams gives before it fails, chunk by chunk."""
    ends = {}
    stream = io.BytesIO(SOUND)
    seen = 0
    for record in StreamReader(stream, emit_chunks=True).records:
        if type(record).__name__ == "Chunk":
            body = StreamReader(io.BytesIO(record.data), skip_magic=True)
            assert body is not None
            seen += 1
            ends[stream.tell()] = seen
    chunks = [0, *ends]
    counts = {}
    for cut in sorted({*chunks[1:], *(end - 1 for end in chunks[1:]), *range(200, len(SOUND), 97)}):
        record = read(SOUND[:cut])
        whole = sum(end <= cut for end in ends)
        counts.setdefault(whole, set()).add(record.counts["decisions"])
        assert record.torn is not None
        assert [data for *_, data in record.raw()] == MESSAGES[: record.counts["decisions"]]
    assert all(len(each) == 1 for each in counts.values())  # a chunk more or less is all that a cut can do
    assert sorted(counts) == sorted(counts, key=lambda whole: min(counts[whole]))
    assert counts[len(ends)] == {len(MESSAGES)}


def test_the_place_of_the_tear_is_told(read):
    record = read(SOUND[:5000])
    assert record.torn.endswith(" of 5,000")
    assert "a record is cut off, at byte " in record.torn
    assert record.size - record.unread == int(record.torn.split()[-3].replace(",", ""))


def test_damaged_records_are_read_to_their_damage(tmp_path):
    """As `python tests/damage.py` does with 10,000."""
    path = tmp_path / "run.mcap"
    choice = random.Random(1)
    kept = []
    for _ in range(300):
        path.write_bytes(damage.damaged(SOUND, choice))
        with suppress(FormatError):
            kept.append(damage.read(path, MESSAGES)[0])
    assert len(set(kept)) > 10


@pytest.mark.parametrize("pace", [167, pytest.param(41, marks=pytest.mark.slow)])
def test_a_flipped_bit_anywhere_gives_no_wrong_message(tmp_path, pace):
    path = tmp_path / "run.mcap"
    for place in range(0, len(SOUND), pace):
        content = bytearray(SOUND)
        content[place] ^= 1 << place % 8
        path.write_bytes(content)
        try:
            _, torn = damage.read(path, MESSAGES)
        except FormatError:
            assert place < 400  # the head
        else:
            assert torn is not None


def chunks(content):
    """Return the place of each chunk, its length, and the numbers of its messages, by the official reader."""
    stream = io.BytesIO(content)
    reader = StreamReader(stream, emit_chunks=True)
    place, number, found = 8, 0, []
    for record in reader.records:
        if isinstance(record, Chunk):
            count = sum(isinstance(each, OfficialMessage) for each in breakup_chunk(record))
            found.append((place, stream.tell() - place, range(number, number + count)))
            number += count
        place = stream.tell()
    return found


CHUNKS = chunks(SOUND)


@pytest.mark.parametrize("complete", [True, False], ids=["complete", "without a summary"])
@pytest.mark.parametrize("place", [1, 9 + 30, 100], ids=["length", "header", "messages"])
@pytest.mark.parametrize("which", [0, 1, -2])
def test_a_damaged_chunk_costs_its_messages_alone(read, which, place, complete):
    start, length, numbers = CHUNKS[which]
    content = bytearray(SOUND if complete else SOUND[: sum(CHUNKS[-1][:2])])
    content[start + place] ^= 0x10
    record = read(bytes(content))
    if which == 0 and not complete:  # the topics were in it
        assert [*record.raw()] == []
        return
    assert [each[2] for each in record.raw()] == [each for each in range(400) if each not in numbers]
    assert ("run-1.mcap" in record.torn, record.lost) == (complete, len(numbers))  # it has no end
    before, after = numbers[0] - 1, numbers[-1] + 1
    assert record.gap == (before, before * 1_000_000 if which else None, after * 1_000_000)
    (sentence,) = record.damage
    begin = record.span[0] / 1e9
    where = (
        f"between {before / 1e3:.6f} s and {after / 1e3:.6f} s" if which else "before the first one that can be read"
    )
    assert sentence.endswith(f" at byte {start:,}: {len(numbers)} messages are lost, {where}")
    assert begin == (0 if which else after / 1e3)
    assert record.unread >= length if complete else record.unread > 0


@pytest.mark.parametrize("place", [2, -20], ids=["length", "content"])
def test_a_damaged_attachment_costs_itself_alone(read, place):
    start = SOUND.index(b"robot.toml") - 29
    assert SOUND[start] == 9
    content = bytearray(SOUND)
    content[start + place if place > 0 else SOUND.index(b"[ensembles]")] ^= 0x04
    record = read(bytes(content))
    assert [data for *_, data in record.raw()] == MESSAGES
    assert record.attachments == []
    assert "run-1.mcap" in record.torn  # it has no end
    assert (record.lost, record.gap) == (0, None)
    assert record.damage[0].endswith(": no message is lost")


def test_damage_of_the_last_chunk_is_told_by_the_end(tmp_path):
    path = written(tmp_path / "run.mcap", [("decisions", decision(number)) for number in range(9)])
    content = bytearray(path.read_bytes())
    content[chunks(bytes(content))[-1][0] + 80] ^= 1
    path.write_bytes(content)
    record = Record(path)
    assert (record.torn, record.closed, record.lost, record.counts.total()) == (None, True, 9, 0)
    assert "messages may be lost" in record.damage[0]


def test_a_damaged_head_is_no_file_that_ends_early(read):
    content = bytearray(SOUND)
    place = SOUND.index(b"\x03\x00\x00\x00mdm") - 9
    assert SOUND[place] == 12
    content[place] = 200
    with refused(FormatError):
        read(bytes(content))


def test_a_chunk_that_claims_to_be_huge_takes_no_memory(read):
    place = SOUND.index(b"zstd") - 4
    content = bytearray(SOUND)
    for claimed in (2**40, 2**29):
        struct.pack_into("<Q", content, place - 12, claimed)
        assert "a chunk is damaged" in read(bytes(content)).damage[0]


@pytest.mark.parametrize("changed", [SOUND[:700], SOUND[60:]], ids=["cut off", "moved"])
@pytest.mark.parametrize("chunking", [True, False], ids=["chunks", "no chunks"])
def test_a_file_that_changes_while_it_is_read_is_told(tmp_path, read, changed, chunking):
    record = read(SOUND if chunking else copied(SOUND, use_chunking=False))
    (tmp_path / "run.mcap").write_bytes(changed)
    with refused(FormatError):
        list(record.messages())


def numbered(*numbers):
    """Return a record without an end, whose messages have these numbers, a chunk each."""
    content = io.BytesIO()
    file = File(content, "mdm/0.1.0", chunk=100)
    file.metadata("mdm", HEAD)
    topic = file.topic("decisions", "mdm.Decision", json.dumps(schema(Decision)).encode())
    for number in numbers:
        file.add_message(topic, number, encoded(decision(number)), number, number)
    file.flush()
    return content.getvalue()


def test_lost_messages_show_in_the_numbers_of_a_torn_record(read):
    assert read(numbered(0, 1, 2)).lost == 0
    assert read(numbered(3, 4, 9, 10)).lost == 7
    assert read(numbered(0, 2**31 - 1, 2**32 - 2, 1)).counts["decisions"] == 4


@pytest.mark.parametrize("numbers", [(0, 1, 1, 2), (0, 1, 0, 1), (5, 4)])
def test_a_chunk_that_is_not_in_its_place_is_a_tear(read, numbers):
    record = read(numbered(*numbers))
    assert "a chunk is not in its place" in record.torn
    assert [each.sequence for each in record.messages()] == list(numbers[: len(numbers) // 2])


def test_what_json_cannot_say_of_numbers(tmp_path):
    path = written(tmp_path / "run.mcap", [("decisions", decision(1, reward=float("nan")))])
    (only,) = Record(path).messages()
    assert only.message.reward is None
    assert msgspec.json.decode(official(path)[0][-1])["reward"] is None


def test_the_records_of_a_folder_are_those_of_its_runs(tmp_path):
    with pytest.raises(Error, match=re.escape(f"{tmp_path}: there are no records in this folder")):
        records_of(tmp_path)
    split = Writing(tmp_path / "b.mcap", split_bytes=1000)
    for number in range(100):
        split.write("decisions", decision(number))
        split.writer.drain(PATIENCE)
    split.close()
    written(tmp_path / "a.mcap", [("decisions", decision(0))])
    assert len([*tmp_path.glob("b-*.mcap")]) > 1
    found = records_of(tmp_path)
    assert {name: record.counts["decisions"] for name, record in found.items()} == {"a.mcap": 1, "b.mcap": 100}
    (tmp_path / "c.mcap").write_text("a letter")
    with pytest.raises(Error, match="is not an MCAP file, so it cannot be a record"):
        records_of(tmp_path)


def test_a_damaged_attached_file_is_named_however_it_is_damaged(read):
    complete = bytes(copied(SOUND, chunk_size=4096))
    start = complete.index(b"robot.toml") - 29
    for place in (start + 2, start + 32, complete.index(b"[ensembles]")):  # its length, name, content
        content = bytearray(complete)
        content[place] ^= 0x04
        record = read(bytes(content))
        assert record.damaged_files == ["robot.toml"]
        assert "the attached file 'robot.toml' is damaged, " in record.damage[0]
        assert record.damage[0].endswith(f" bytes at byte {start:,}: no message is lost")


def test_a_damaged_index_of_messages_is_told_with_its_place(read):
    complete = bytes(copied(SOUND, chunk_size=4096, enable_data_crcs=True))
    start = complete.index(b"\x07", sum(chunks(complete)[2][:2]))
    for place in (start + 9, start + 11, start + 20):  # its topic, its length, a time
        content = bytearray(complete)
        content[place] ^= 1
        record = read(bytes(content))
        assert [data for *_, data in record.raw()] == MESSAGES
        (sentence,) = [each for each in record.flaws if "run-1.mcap" not in each]
        assert "an index of messages is damaged, " in sentence
        assert sentence.endswith(f"bytes at byte {start:,}: no message is lost")


def test_a_damaged_byte_that_only_the_data_s_checksum_tells_has_no_place(read):
    complete = bytes(copied(SOUND, chunk_size=4096, enable_data_crcs=True))
    content = bytearray(complete)
    content[complete.index(b"0.1.0", complete.index(b"epoch") - 60)] ^= 1
    record = read(bytes(content))
    assert "where no chunk's checksum tells" in record.damage[0]
    assert "at byte" not in record.damage[0]
    assert record.unread == 0


def test_a_damaged_attached_file_of_a_torn_record_is_named_as_it_names_itself(read):
    content = bytearray(SOUND[:5000])
    content[SOUND.index(b"[ensembles]")] ^= 0x04
    assert read(bytes(content)).damaged_files == ["robot.toml"]
