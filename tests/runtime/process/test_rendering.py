"""Lines of the log as people read them."""

from __future__ import annotations

from datetime import datetime

import pytest

from mdm.runtime.process.rendering import Rendering

RECORD = {"event": "decision", "level": "info", "time": 1_700_000_000.25, "epoch": 3, "reward": 1.23456789}


@pytest.fixture
def rendering():
    return Rendering(colours=False)


def test_a_time_is_that_of_the_day_where_it_is_read(rendering):
    clock = datetime.fromtimestamp(RECORD["time"]).astimezone()
    assert rendering(None, "info", RECORD).startswith(f"{clock:%H:%M:%S}.250 [info")


def test_a_virtual_time_is_seconds(rendering):
    rendering.virtual = True
    assert rendering(None, "info", {**RECORD, "time": 1.5}).startswith("1.500 [info")


def test_since_is_a_time_too(rendering):
    rendering.virtual = True
    assert "since=0.500 causes=end" in rendering(None, "info", {**RECORD, "since": 0.5, "causes": "end"})


def test_fields_keep_their_order_and_numbers_have_six_digits(rendering):
    assert rendering(None, "info", RECORD).endswith("epoch=3 reward=1.23457")


def test_a_record_stays_as_it_is(rendering):
    before = dict(RECORD)
    rendering(None, "info", RECORD)
    assert before == RECORD


def test_a_record_without_a_time_is_rendered(rendering):
    assert "stall" in rendering(None, "error", {"event": "stall", "level": "error", "time": None})
