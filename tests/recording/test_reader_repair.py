from __future__ import annotations

import importlib.util
import io

import damage
import pytest
from records import HEAD, decision, encoded, official, written
from sentences import refused

from mdm.errors import Error
from mdm.recording.reader import Record, repair

SOUND, MESSAGES = damage.sound()


def repaired(record, path):
    with path.open("wb") as file:
        return repair(record, file)


@pytest.mark.parametrize("cut", [1000, 5000, 9000, len(SOUND) - 1])
def test_what_is_left_of_a_torn_record_is_a_complete_one(tmp_path, cut):
    (tmp_path / "torn.mcap").write_bytes(SOUND[:cut])
    torn = Record(tmp_path / "torn.mcap")
    count = repaired(torn, tmp_path / "whole.mcap")
    whole = Record(tmp_path / "whole.mcap")
    assert whole.torn is None
    assert [*whole.raw()] == [*torn.raw()]
    assert [each[-1] for each in official(tmp_path / "whole.mcap")] == MESSAGES[:count]
    assert count == torn.counts["decisions"]
    assert whole.head == HEAD
    assert whole.attachments == torn.attachments
    assert whole.metadata["mdm.repaired"] == {"torn": torn.torn, "unread": str(torn.unread)}


def test_files_of_a_split_record_become_one(tmp_path):
    decisions = [decision(1000 * number) for number in range(10)]
    path = written(tmp_path / "run.mcap", [("decisions", each) for each in decisions], split_seconds=3)
    assert repaired(Record(path), tmp_path / "all.mcap") == 10
    (tmp_path / "all.mcap").replace(path)
    record = Record(path)  # whose other files are still there
    assert [data for *_, data in record.raw()] == [encoded(each) for each in decisions]
    assert record.closed is True
    assert "mdm.repaired" not in record.metadata


def test_without_mcap_the_way_out_is_told(tmp_path, monkeypatch):
    (tmp_path / "torn.mcap").write_bytes(SOUND)
    record = Record(tmp_path / "torn.mcap")
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with refused(Error):
        repair(record, io.BytesIO())
