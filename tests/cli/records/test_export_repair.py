"""`mdm record repair`: a torn record as a complete one, which others open."""

from __future__ import annotations

import pytest
from mcap.reader import make_reader
from records import decision, encoded, official, written


def test_a_torn_record_is_written_anew(mdm, tmp_path):
    decisions = [decision(number) for number in range(3000)]
    path = written(tmp_path / "run.mcap", [("decisions", each) for each in decisions])
    path.write_bytes(path.read_bytes()[:-100])
    with path.open("rb") as file, pytest.raises(Exception, match=r".*"):
        list(make_reader(file).iter_messages())
    before = path.read_bytes()
    status, output, errors = mdm("record", "repair", path, "-o", tmp_path / "whole.mcap")
    assert (status, errors) == (0, "")
    assert output[0] == f"{tmp_path}/whole.mcap: 3,000 messages written"
    assert "its summary is cut off" in output[1]
    assert [each[-1] for each in official(tmp_path / "whole.mcap")] == [encoded(each) for each in decisions]
    assert path.read_bytes() == before


def test_a_complete_record_says_that_it_was(mdm, tmp_path):
    path = written(tmp_path / "run.mcap", [("decisions", decision(1))])
    assert mdm("record", "repair", path, "-o", tmp_path / "whole.mcap")[1][1] == f"{path}: it was complete"


@pytest.mark.parametrize("number", [0, 1])
def test_a_record_does_not_replace_itself(mdm, tmp_path, number):
    pairs = [("decisions", decision(1000 * each)) for each in range(10)]
    path = written(tmp_path / "run.mcap", pairs, split_seconds=3)
    given = [path, tmp_path / "run-1.mcap"][number]
    before = given.read_bytes()
    status, _, errors = mdm("record", "repair", path, "-o", given)
    assert status == 1
    assert "would be overwritten" in errors
    assert given.read_bytes() == before
