from __future__ import annotations

import math

import numpy as np
import pytest
from records import encoded

from mdm.messages import Belief, Fault, ParticleUpdate, PoseUpdate, Reward
from mdm.recording.reader import Decoding
from mdm.stimuli import Said

DECODE = Decoding({}).decode


def test_arrays_are_arrays_to_the_bit():
    belief = np.random.default_rng(1).dirichlet(np.ones(20))
    restored = DECODE("mdm.Belief", encoded(Belief(3, belief)))
    assert restored.probabilities.tobytes() == belief.tobytes()
    assert not restored.probabilities.flags.writeable


@pytest.mark.parametrize("message", [Reward(1, 2, math.nan), PoseUpdate(1, math.inf, 2.0)], ids=str)
def test_numbers_that_are_none_come_back_as_none(message):
    restored = DECODE(f"mdm.{type(message).__name__}", encoded(message))
    assert type(restored) is type(message)
    numbers = [value for value in restored.__struct_fields__ if isinstance(getattr(restored, value), float)]
    assert any(math.isnan(getattr(restored, value)) for value in numbers)


def test_arrays_with_numbers_that_are_none():
    restored = DECODE("mdm.ParticleUpdate", encoded(ParticleUpdate(1, np.array([1.0, math.nan]), np.array([2.0, 3.0]))))
    assert restored.x[0] == 1.0
    assert math.isnan(restored.x[1])
    assert restored.weights is None


def test_what_was_said_has_numbers_that_are_none_as_well():
    said = Said(1, "pose", "PoseUpdate", PoseUpdate(1, math.nan, 2.0))
    restored = DECODE("mdm.Stimulus", encoded(said)).message
    assert type(restored) is PoseUpdate
    assert math.isnan(restored.x)


@pytest.mark.parametrize("data", [b'{"time":1}', b'{"time":1,"source":2,"kind":"a","detail":""}', b"[1]"])
def test_messages_of_another_shape_are_what_json_has(data):
    assert not isinstance(DECODE("mdm.Fault", data), Fault)


def test_more_fields_than_are_known_are_no_harm():
    """A later version may add fields with the format unchanged."""
    assert DECODE("mdm.Fault", b'{"time":1,"source":"a","kind":"b","detail":"c","more":1}') == Fault(1, "a", "b", "c")
