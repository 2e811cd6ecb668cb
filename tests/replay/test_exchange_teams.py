"""A team that ran on a simulated network, replayed together: it decides the same, and each agent sends the same."""

from __future__ import annotations

import pytest
from records import Writing
from team_records import recorded, repeated
from team_robots import three

from mdm.recording import Record
from mdm.stimuli import Began, Received, Said, Stimulus
from mdm.team import Team

pytestmark = pytest.mark.usefixtures("recorded_here")

TEAMS = [
    {},
    {"period": 0.1},
    {"mode": "centralised"},
    {"mode": "centralised", "period": 0.1},
    {"mode": "communicating", "period": 0.1},
]


@pytest.mark.parametrize("seed", [1, pytest.param(3, marks=pytest.mark.slow)])
@pytest.mark.parametrize("options", TEAMS)
@pytest.mark.parametrize("ways", [{"delay": 0.001}, {"delay": (0.001, 0.03), "loss": 0.1}])
def test_each_agent_sends_what_it_sent(tmp_path, seed, options, ways):
    """Of some messages several come at once, and what is said of the first may be said with what the second brings."""
    model, team = three(), Team("fire", ["one", "two", "three"], **options)
    live = recorded(team, model, tmp_path, seed, **ways)
    together, again = repeated(team, model, tmp_path)
    assert together.same, (together.unlike[:1], [each.differences[:1] for each in together.agents.values()])
    assert all(each.recorded == each.replayed > 5 for each in together.agents.values())
    assert together.received > 50
    for name, messages in live.items():
        assert again[name][: len(messages)] == messages


@pytest.mark.parametrize(
    ("options", "key", "layers"),
    [
        ({}, "agreement/all", {"replica"}),
        ({"mode": "centralised"}, "decision", {"centre", "outpost"}),
        ({"mode": "communicating", "period": 0.1}, "word", {"talker"}),
    ],
)
def test_records_of_the_first_protocol_are_repeated_by_its_names(tmp_path, monkeypatch, options, key, layers):
    model, team = three(), Team("fire", ["one", "two", "three"], **options)
    with monkeypatch.context() as before:
        before.setattr("mdm.team.transport.router.PROTOCOL", 1)
        recorded(team, model, tmp_path, 1)
    stimuli = [each.message for each in Record(tmp_path / "two.mcap").messages(["stimuli"])]
    assert f"mdm/fire/one/joint/{key}" in {each.key for each in stimuli if isinstance(each, Received)}
    assert {each.actor.split("/")[-1] for each in stimuli if isinstance(each, Began)} & layers
    together, _ = repeated(team, model, tmp_path)
    assert together.same, (together.unlike[:1], [each.differences[:1] for each in together.agents.values()])


@pytest.mark.parametrize("options", TEAMS)
def test_observations_that_a_record_lacks_are_messages_that_its_agent_has_not_sent(tmp_path, options):
    """They are found where others received them, who go on with what their records say."""
    model, team = three(), Team("fire", ["one", "two", "three"], **options)
    recorded(team, model, tmp_path, 1)
    kept = Record(tmp_path / "two.mcap")
    shorter = Writing(tmp_path / "shorter.mcap", kept.head)
    for name, facts in kept.metadata.items():
        if name.startswith("ensemble "):
            shorter.writer.metadata(name, facts)
    for each in kept.messages(["stimuli", "decisions"]):
        if not isinstance(each.message, Said):
            shorter.write(each.topic, each.message, Stimulus if each.topic == "stimuli" else None)
    shorter.close().replace(tmp_path / "two.mcap")
    together, _ = repeated(team, model, tmp_path)
    assert not together.same
    assert together.unlike
    assert {each.owner for each in together.unlike} >= {"two"}
