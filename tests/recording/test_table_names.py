from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, strategies as st
from records import Writing
from sentences import refused

from mdm.errors import FormatError
from mdm.recording.reader import Record
from mdm.recording.table import Names, names_of

ROBOT = Names(states=("hall", "lab", "yard"), observations=("hear-left", "hear-right"))


def test_symbols_have_the_names_at_their_indices():
    assert [ROBOT.state(index) for index in range(3)] == ["hall", "lab", "yard"]
    assert ROBOT.observation(1) == "hear-right"


@given(sizes=st.lists(st.integers(1, 5), min_size=2, max_size=4), data=st.data())
def test_joint_states_of_several_factors_have_a_value_of_each(sizes, data):
    factors = {f"f{place}": tuple(f"s{each}" for each in range(size)) for place, size in enumerate(sizes)}
    names = Names(state_factors=factors, observation_factors=factors)
    index = data.draw(st.integers(0, int(np.prod(sizes)) - 1))
    values = np.unravel_index(index, sizes)
    assert names.state(index) == ", ".join(f"f{place}=s{value}" for place, value in enumerate(values))
    assert names.observation(tuple(map(int, values))) == names.state(index)
    assert names.state(int(np.prod(sizes))) is None


def test_components_that_are_not_known_are_left_out():
    names = Names(observation_factors={"ears": ("left", "right"), "nose": ("dry", "wet")})
    assert names.observation((None, 1)) == "nose=wet"
    for unnamed in ((None, None), (1, 2), (-1, 0), (1,), (), None, -1):
        assert names.observation(unnamed) is None


@pytest.mark.parametrize("given", [None, 2, -1, (1, None), ()])
def test_what_has_no_name(given):
    assert ROBOT.observation(given) is None
    assert Names().state(0) is None
    assert Names().observation(0) is None


def record_with(tmp_path, **metadata):
    record = Writing(tmp_path / "run.mcap")
    for path, facts in metadata.items():
        record.writer.metadata(f"ensemble {path}", facts)
    return Record(record.close())


def test_names_are_kept_by_the_paths_of_ensembles(tmp_path):
    facts = {"configuration": "1f", "states": json.dumps(ROBOT.states), "observations": json.dumps(ROBOT.observations)}
    record = record_with(tmp_path, **{"top": facts, "top/below": {}})
    assert names_of(record) == {"top": ROBOT, "top/below": Names()}


@pytest.mark.parametrize("text", ["?", '{"states": 1}', "[1, 2]"])
def test_what_is_no_names(tmp_path, text):
    record = record_with(tmp_path, top={"states": text})
    with refused(FormatError):
        names_of(record)
