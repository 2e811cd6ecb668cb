"""The recorder: what a run leaves in its record, beside what the same run publishes."""

from __future__ import annotations

import asyncio
import json
import re
import signal
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
from records import PATIENCE
from sentences import refused

import mdm
from mdm.errors import ConfigError, Error
from mdm.messages import ActionLife, Control, SensorUpdate, State
from mdm.models import Factor, Space
from mdm.recording import Record, Recorder
from mdm.recording.table import rows
from mdm.stimuli import Began, Ended, Finished, Lasts, Raised, Said, Ticked
from mdm.testing import probe, run_virtual


def robot(acts=lambda: None, **options):
    predicates = mdm.PredicateManager("predicates")
    near = predicates.sensor("Near", initial=False)
    ensemble = mdm.Ensemble(
        "robot",
        policy=mdm.policies.DeterministicPolicy([0, 1], 2),
        predicates=predicates,
        states=[mdm.StateFactor("near", ["Near"])],
        actions={"go": acts, "stay": lambda: None},
        **options,
    )
    return ensemble, near


def tiger():
    vectors = mdm.policies.AlphaVectors([[0.0, 0.0]], [0], 3)
    actions = dict.fromkeys(range(3), lambda: None)
    return mdm.Ensemble("robot", model=mdm.problems.tiger(), policy=vectors, actions=actions)


def record(path, ensemble, happen, **options):
    """Record an ensemble in virtual time while things happen; return the record, and messages of some channels."""
    heard = {}

    async def main(runtime):
        for name in ("decisions", "modes", "faults", "lives"):
            heard[name] = probe(getattr(runtime, name))
        heard["robot/lives"] = probe(runtime.channel("robot/lives", ActionLife))
        await runtime.start(ensemble)
        await happen()

    run_virtual(main, record=Recorder(path, **options))
    return Record(path), heard


def messages(found, topic):
    return [each.message for each in found.messages([topic])]


def test_decisions_lives_modes_and_actors_are_those_that_are_published(tmp_path):
    ensemble, near = robot()

    async def happen():
        for value in (True, False, True):
            await asyncio.sleep(0.5)
            near.set(value)

    found, heard = record(tmp_path / "run.mcap", ensemble, happen)
    assert messages(found, "decisions") == heard["decisions"]
    assert messages(found, "lives") == heard["robot/lives"]
    assert messages(found, "modes") == heard["modes"]
    assert [each for each in messages(found, "actors") if each.actor] == [each for each in heard["lives"] if each.actor]


def test_each_kind_of_stimulus_is_kept_with_its_time_and_its_source(tmp_path):
    async def go():
        near.set(True)
        await asyncio.sleep(0.3)
        raise ValueError("as it was meant to be")

    ensemble, near = robot(go)

    async def happen():
        await asyncio.sleep(1)
        near.set(False)
        await asyncio.sleep(1)
        ensemble.stop()

    found, _ = record(tmp_path / "run.mcap", ensemble, happen)
    stimuli = messages(found, "stimuli")
    said = [each for each in stimuli if isinstance(each, Said)]
    assert [(each.time, each.type, each.where, each.ensemble, each.life) for each in said] == [
        (0, SensorUpdate.__name__, "task", "robot", 1),
        (1_000_000_000, SensorUpdate.__name__, "outside", "", 0),
        (1_000_000_000, SensorUpdate.__name__, "task", "robot", 3),
        (2_000_000_000, Control.__name__, "outside", "", 0),
    ]
    assert [(each.life, each.time) for each in stimuli if isinstance(each, Lasts)] == [(1, 0), (3, 1_000_000_000)]
    ended = [(each.life, each.cancelled, each.error) for each in stimuli if isinstance(each, Ended)]
    assert [life for life, _, _ in ended] == [1, 3]
    begun = [(each.actor, each.step) for each in stimuli if isinstance(each, Began)]
    own = [step for actor, step in begun if actor == "robot"]
    assert own[:2] == ["start", "run"]
    (finished,) = (each for each in stimuli if isinstance(each, Finished))
    assert finished.time == 2_000_000_000


def test_ticks_and_failures_of_calls_are_kept(tmp_path):
    def go():
        raise ValueError("as it was meant to be")

    ensemble, _ = robot(go, drive=2.0)

    async def happen():
        await asyncio.sleep(1.2)

    found, heard = record(tmp_path / "run.mcap", ensemble, happen)
    stimuli = messages(found, "stimuli")
    ticks = [(each.time, each.number, each.missed) for each in stimuli if isinstance(each, Ticked)]
    assert ticks == [(0, 0, 0), (500_000_000, 1, 0), (1_000_000_000, 2, 0)]
    (raised, *_) = (each.error for each in stimuli if isinstance(each, Raised))
    assert raised.startswith("ValueError: as it was meant to be (at ")
    assert messages(found, "faults") == heard["faults"]


def test_channels_that_are_asked_for_are_kept(tmp_path):
    ensemble, near = robot()

    async def happen():
        await asyncio.sleep(1)
        near.set(True)

    found, _ = record(tmp_path / "run.mcap", ensemble, happen, channels=["robot/state"])
    kept = messages(found, "robot/state")
    assert [(each.time, each.index) for each in kept] == [(0, 0), (1_000_000_000, 1)]
    assert all(isinstance(each, State) for each in kept)


@pytest.mark.parametrize(("largest", "kept"), [(1, False), (2, True)])
def test_large_beliefs_are_left_out(tmp_path, largest, kept):
    found, heard = record(tmp_path / "run.mcap", tiger(), lambda: asyncio.sleep(0), largest_belief=largest)
    (decision,) = messages(found, "decisions")
    assert (decision.belief is not None) == kept
    assert heard["decisions"][0].belief is not None


def test_the_head_says_what_ran_and_names(tmp_path):
    ensemble = tiger()
    recorder = Recorder(tmp_path / "run.mcap")
    recorder.head(note="in the hall")
    recorder.attach("map.txt", "text/plain", b"a map")
    run_virtual(lambda runtime: runtime.start(ensemble), record=recorder)
    found = Record(tmp_path / "run.mcap")
    assert found.head["mdm"] == mdm.__version__
    assert (found.head["clock"], found.head["epoch"], found.head["note"]) == ("virtual", "0", "in the hall")
    facts = found.metadata["ensemble robot"]
    assert facts["configuration"] == ensemble.controller.configuration
    assert json.loads(facts["actions"]) == ["listen", "open-left", "open-right"]
    assert json.loads(facts["states"]) == ["tiger-left", "tiger-right"]
    assert [(each.name, each.data) for each in found.attachments if each.name == "map.txt"] == [("map.txt", b"a map")]


def test_names_of_several_factors_are_kept_by_factors(tmp_path):
    states = Space([Factor("lamp", ["off", "on"]), Factor("door", ["shut", "ajar", "open"])])
    model = mdm.models.MDP([np.eye(6)], np.zeros((6, 1)), discount=0.9, states=states, actions=["wait"])
    ensemble = mdm.Ensemble("robot", policy=[0] * 6, model=model, actions={"wait": lambda: None})

    async def main(runtime):
        await runtime.start(ensemble)
        ensemble.publish_state(5)
        await asyncio.sleep(1)

    run_virtual(main, record=tmp_path / "run.mcap")
    found = Record(tmp_path / "run.mcap")
    facts = found.metadata["ensemble robot"]
    assert json.loads(facts["state_factors"]) == {"lamp": ["off", "on"], "door": ["shut", "ajar", "open"]}
    assert "action_factors" not in facts
    assert [row.state for row in rows(found)] == ["lamp=on, door=open"]


@pytest.mark.parametrize("has_model", [False, True])
def test_names_that_no_model_has_are_those_of_the_factors(tmp_path, has_model):
    predicates = mdm.PredicateManager("predicates")
    sensors = {name: predicates.sensor(name, initial=False) for name in ("Shut", "Ajar", "Open", "Lit")}
    factors = [mdm.StateFactor("door", ["Shut", "Ajar", "Open"]), mdm.StateFactor("lamp", {"on": "Lit"})]
    model = None
    if has_model:  # whose states have numbers
        factors, model = factors[:1], mdm.models.MDP([np.eye(3)] * 2, np.zeros((3, 2)), discount=0.9)
    ensemble = mdm.Ensemble(
        "robot",
        policy=mdm.policies.DeterministicPolicy([0, 1, 0] if has_model else [0, 1] * 3, 2),
        model=model,
        predicates=predicates,
        states=factors,
        actions={"0": lambda: None, "1": lambda: None} if has_model else {"go": lambda: None, "wait": lambda: None},
    )

    async def main(runtime):
        await runtime.start(ensemble)
        for name in ("Ajar", "Open"):
            sensors["Lit"].set(name == "Open")
            sensors[name].set(True)
            await asyncio.sleep(0.1)
            sensors[name].set(False)

    run_virtual(main, record=tmp_path / "run.mcap")
    told = [row.state for row in rows(Record(tmp_path / "run.mcap"))]
    expected = ["door=Ajar", "door=Open"] if has_model else ["door=Ajar, lamp=not on", "door=Open, lamp=on"]
    assert [each for each in told if each in expected] == expected


@pytest.mark.parametrize(
    ("options", "files"),
    [
        ({}, 1),
        ({"split_seconds": 3}, 4),
        ({"split_seconds": 6}, 2),
        ({"split_bytes": 100_000}, 1),
        ({"split_bytes": 2_000}, None),
    ],
    ids=str,
)
def test_a_record_is_split_as_its_options_say(tmp_path, options, files):
    ensemble, near = robot()

    async def happen():
        for number in range(11):
            near.set(number % 2 == 0)
            await asyncio.sleep(1)

    found, heard = record(tmp_path / "run.mcap", ensemble, happen, **options)
    assert messages(found, "decisions") == heard["decisions"]
    made = len([*tmp_path.iterdir()])
    assert made > 10 if files is None else made == files


@pytest.mark.parametrize(("bound", "least"), [(100, 100), (150, 50)])
def test_beyond_the_bound_items_are_lost_counted_and_told(tmp_path, bound, least):
    ensemble, near = robot()

    async def happen():
        for number in range(200):
            near.set(number % 2 == 0)  # in one go: nothing is encoded meanwhile
        await asyncio.sleep(1)

    recorder = Recorder(tmp_path / "run.mcap", bound=bound)
    faults = []

    async def main(runtime):
        runtime.faults.subscribe(faults.append)
        await runtime.start(ensemble)
        await happen()

    run_virtual(main, record=recorder)
    assert recorder.lost > least
    assert recorder.statistics().dropped == recorder.lost == Record(recorder.path).lost
    (fault,) = (each for each in faults if each.kind == "record")
    assert fault.detail.endswith("messages of the record are lost: more was recorded than could be written")


@pytest.mark.parametrize(
    "options",
    [{"channels": "robot/state"}, {"channels": [3]}, {"channels": 3}, {"bound": 0}, {"bound": -1}, {"bound": 1e9}],
    ids=str,
)
def test_options_out_of_their_range(tmp_path, options):
    with refused(ConfigError):
        Recorder(tmp_path / "run.mcap", **options)


def test_a_channel_that_was_never_there_is_told(tmp_path):
    ensemble, _ = robot()
    options = {"channels": ["robot/state", "nobody", "decisions"]}
    _, heard = record(tmp_path / "run.mcap", ensemble, lambda: asyncio.sleep(1), **options)
    (fault,) = heard["faults"]
    assert fault.kind == "record"
    assert fault.detail.startswith(f"{tmp_path}/run.mcap: nothing was recorded of channel 'nobody', which ")
    assert "robot/action" in fault.detail


def test_the_record_of_a_run_before_is_kept(tmp_path):
    path = tmp_path / "run.mcap"
    run_virtual(lambda runtime: runtime.start(robot()[0]), record=path)
    before = path.read_bytes()
    recorder = Recorder(path)
    run_virtual(lambda runtime: runtime.start(robot()[0]), record=recorder)
    assert (recorder.path, recorder.kept_files) == (tmp_path / "run.2.mcap", (path,))
    assert path.read_bytes() == before
    run_virtual(lambda runtime: runtime.start(robot()[0]), record=Recorder(path, keep=False))
    assert path.read_bytes() != before
    assert sorted(each.name for each in tmp_path.iterdir()) == ["run.2.mcap", "run.mcap"]


def test_the_end_of_the_process_that_writes_is_told_with_what_is_lost(tmp_path):
    recorder = Recorder(tmp_path / "run.mcap")
    ensemble, near = robot()

    async def main(runtime):
        faults = probe(runtime.faults)
        await runtime.start(ensemble)
        recorder._writer._process.kill()
        recorder._writer._process.wait(PATIENCE)
        for second in range(100):
            near.set(second % 2 == 0)
            await asyncio.sleep(1)
        return [*faults]

    (fault,) = run_virtual(main, record=recorder)
    found = re.search(r"the process that writes it has ended \(signal 9\); ([\d,]+) messages are lost", fault.detail)
    assert 0 < int(found.group(1).replace(",", "")) <= recorder.statistics().dropped


@pytest.mark.parametrize("virtual", [True, False])
def test_a_process_that_is_silent_is_told_though_nothing_is_recorded(tmp_path, monkeypatch, virtual):
    now = [0.0]
    monkeypatch.setattr("mdm.recording.writer.times", SimpleNamespace(monotonic=lambda: now[0]))
    monkeypatch.setattr("mdm.recording.recorder._LOOK", 0.01)
    recorder = Recorder(tmp_path / "run.mcap")

    async def main():
        ensemble, near = robot()
        told = asyncio.Event()
        async with mdm.Runtime(log=False, record=recorder) as runtime:
            faults = probe(runtime.faults)
            runtime.faults.subscribe(lambda _: told.set())
            await runtime.start(ensemble)
            process = recorder._writer._process
            process.send_signal(signal.SIGSTOP)
            now[0] += 31.0  # as many seconds as it has for its first word, and one more
            if virtual:
                near.set(True)
            await asyncio.wait_for(told.wait(), PATIENCE)
            process.send_signal(signal.SIGCONT)
        return faults

    (fault,) = mdm.run(main, virtual=virtual)
    assert fault.kind == "record"
    assert fault.detail.startswith(f"{tmp_path}/run.mcap: the process that writes the record has said nothing for 3 s")
    assert Record(tmp_path / "run.mcap").closed


@pytest.mark.parametrize("time", ["now", -1, 1 << 64, None, 0.5])
def test_a_message_whose_time_is_no_time_is_kept(tmp_path, time):
    class Told(msgspec.Struct):
        time: Any

    class Talker(mdm.Actor):
        def on_start(self):
            self.channel = self.runtime.channel("talker/told", Told)

        def on_running(self):
            self.channel.publish(Told(time))

    run_virtual(
        lambda runtime: runtime.start(Talker("talker")),
        record=Recorder(tmp_path / "run.mcap", channels=["talker/told"]),
    )
    (found,) = Record(tmp_path / "run.mcap").messages(["talker/told"])
    assert (found.time, found.message) == (0, {"time": time})


def test_a_recorder_is_for_one_run(tmp_path):
    recorder = Recorder(tmp_path / "run.mcap")
    run_virtual(lambda runtime: runtime.start(robot()[0]), record=recorder)
    before = recorder.path.read_bytes()
    with refused(Error):
        run_virtual(lambda runtime: runtime.start(robot()[0]), record=recorder)
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [before]


def test_a_path_that_cannot_be_written_is_refused_at_the_start(tmp_path):
    ensemble, _ = robot()
    with refused(Error):
        run_virtual(lambda runtime: runtime.start(ensemble), record=tmp_path / "none" / "run.mcap")


@pytest.mark.parametrize("given", [-1, 2.5, "many", True])
def test_a_largest_belief_is_a_number_of_states(tmp_path, given):
    with refused(ConfigError):
        Recorder(tmp_path / "run.mcap", largest_belief=given)


@pytest.mark.parametrize("seed", [None, 7])
def test_the_seed_that_a_policy_was_given_is_in_the_record(tmp_path, seed):
    rows = mdm.policies.StochasticPolicy([[0.5], [0.5]])
    ensemble = mdm.Ensemble("robot", policy=rows, actions=dict.fromkeys("ab", lambda: None), seed=seed)

    async def happen():
        ensemble.publish_state(0)

    found, _ = record(tmp_path / "run.mcap", ensemble, happen)
    assert found.metadata["ensemble robot"].get("seed") == (None if seed is None else str(seed))
