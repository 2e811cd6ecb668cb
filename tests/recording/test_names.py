from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from records import Writing
from sentences import refused

from mdm.errors import FormatError
from mdm.recording.names import Factor, Names, attached, names_of
from mdm.recording.reader import Record

ROBOT = Names(
    states=(Factor("person", ("no", "yes")), Factor("place", ("hall", "lab", "yard"))),
    observations=(Factor("ears", ("hear-left", "hear-right")),),
)


@given(sizes=st.lists(st.integers(1, 5), min_size=2, max_size=4), data=st.data())
def test_joint_states_are_named_by_their_factors(sizes, data):
    names = Names(
        tuple(Factor(f"f{place}", tuple(f"s{each}" for each in range(size))) for place, size in enumerate(sizes))
    )
    index = data.draw(st.integers(0, int(np.prod(sizes)) - 1))
    values = np.unravel_index(index, sizes)
    assert names.state(index) == ", ".join(f"f{place}=s{value}" for place, value in enumerate(values))


def test_one_factor_is_named_by_its_symbol_and_what_is_not_known_left_out():
    assert ROBOT.observation(1) == "hear-right"
    assert ROBOT.observation((1,)) == "hear-right"
    assert ROBOT.state(4) == "person=yes, place=lab"
    assert Names(observations=ROBOT.states).observation((None, 2)) == "place=yard"
    assert Names(observations=ROBOT.states).observation((None, None)) == ""


@pytest.mark.parametrize("given", [None, (1, 2, 0), (), 6])
def test_what_has_no_name(given):
    names = Names(observations=ROBOT.states)
    assert names.observation(given) is None
    assert Names().state(0) is None
    assert Names().observation((0, 1)) is None


def record_with(tmp_path, *files):
    record = Writing(tmp_path / "run.mcap")
    for file in files:
        record.writer.attach(*file)
    return Record(record.close())


def test_names_are_kept_in_a_record(tmp_path):
    record = record_with(
        tmp_path, attached("top", ROBOT), attached("top/below", Names()), ("a.toml", "text/plain", b"")
    )
    assert names_of(record) == {"top": ROBOT, "top/below": Names()}


@pytest.mark.parametrize("data", [b"?", b'{"states": 1}', b'{"states": [{"name": "a", "symbols": []}]}'])
def test_what_is_no_names(tmp_path, data):
    record = record_with(tmp_path, ("names/top.json", "application/json", data))
    with refused(FormatError):
        names_of(record)
