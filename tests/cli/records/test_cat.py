"""`mdm record cat`: the messages of a record as lines of JSON, and as what `mdm trace` reads."""

from __future__ import annotations

import json

import pytest
from places import EXAMPLES
from records import Writing, decision, official, tiger, written

from mdm import load_system, messages
from mdm.recording import Record, schemas
from mdm.runtime import Runtime, VirtualClock, run as run_program
from mdm.stimuli import Ended, Said, Stimulus


def lines(mdm, *arguments):
    status, output, errors = mdm("record", "cat", *arguments)
    assert (status, errors) == (0, "")
    return [json.loads(line) for line in output]


def test_all_messages_are_printed_as_they_were_written(mdm, tmp_path):
    path = tiger(tmp_path / "run.mcap")
    assert [
        (line["topic"], round(line["seconds"] * 1e9), line["sequence"], line["message"]) for line in lines(mdm, path)
    ] == [(topic, time, number, json.loads(data)) for topic, time, number, _, data in official(path)]


def test_states_and_observations_have_their_names_beside(mdm, tmp_path):
    path = tmp_path / "run.mcap"
    assert mdm("simulate", EXAMPLES / "tiger.toml", "--episodes", 2, "--record", path)[0] == 0
    heard = {None: None, 0: "hear-left", 1: "hear-right"}
    for line in lines(mdm, path):
        message = line["message"]
        if line["topic"] == "decisions":
            assert line.get("observation_name") == heard[message["observation"]]
            assert "state_name" not in line
        elif line["topic"].endswith("/true_state"):
            assert line["state_name"] == ("tiger-left", "tiger-right")[message["index"]]
        else:
            assert line.keys() == {"topic", "seconds", "sequence", "message"}


def test_topics_and_times_are_chosen(mdm, tmp_path):
    path = tiger(tmp_path / "run.mcap")
    chosen = lines(mdm, path, "--topic", "decisions", "--topic", "modes", "--since", 2.5, "--until", "4")
    assert [(line["topic"], line["seconds"]) for line in chosen] == [
        ("decisions", 2.5),
        ("decisions", 3.0),
        ("decisions", 3.5),
    ]


def test_times_count_from_the_first_message(mdm, tmp_path):
    path = written(tmp_path / "run.mcap", [("decisions", decision(1000 * number)) for number in (7, 8, 9)])
    assert [line["seconds"] for line in lines(mdm, path, "--since", "1")] == [1.0, 2.0]


def test_ensembles_are_chosen_with_those_below(mdm, tmp_path):
    pairs = [
        ("decisions", decision(1, ensemble="top")),
        ("decisions", decision(2, ensemble="topmost")),
        ("decisions", decision(3, ensemble="top/patrol")),
        ("faults", messages.Fault(4, "top/patrol", "idle", "")),
        ("faults", messages.Fault(5, "predicates", "idle", "")),
        ("top/state", messages.State(6, 1, (1,))),
    ]
    path = written(tmp_path / "run.mcap", pairs)
    assert [line["sequence"] for line in lines(mdm, path, "--ensemble", "top")] == [0, 2, 3, 5]
    assert [line["sequence"] for line in lines(mdm, path, "--ensemble", "top/patrol")] == [2, 3]
    status, output, errors = mdm("record", "cat", path, "--ensemble", "tap")
    assert (status, output) == (1, [])
    assert "there are no messages of 'tap'; there are messages of predicates, top, top/patrol" in errors


def test_a_torn_record_is_printed_to_the_tear(mdm, tmp_path):
    path = written(tmp_path / "run.mcap", [("decisions", decision(number)) for number in range(3000)])
    path.write_bytes(path.read_bytes()[:-100])
    status, output, errors = mdm("record", "cat", path)
    assert (status, len(output)) == (0, 3000)
    assert errors.startswith(f"mdm record cat: {path}: its summary is cut off, at byte ")
    assert errors.endswith(f" of {path.stat().st_size:,}: what follows is not there\n")


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (["--topic", "nothing"], 1, "there is no topic 'nothing'; there are decisions"),
        (["--since", "soon"], 2, "a number of seconds was expected, not 'soon'"),
        (["--until", "nan"], 2, "a number of seconds was expected, not 'nan'"),
        (["--stimuli", "--topic", "decisions"], 2, "--topic is for messages"),
        (["--stimuli"], 1, "there are no stimuli in this record"),
    ],
)
def test_what_cannot_be_chosen(mdm, tmp_path, arguments, status, words):
    path = written(tmp_path / "run.mcap", [("decisions", decision(1))])
    found, output, errors = mdm("record", "cat", path, *arguments)
    assert (found, output) == (status, [])
    assert words in errors


@pytest.mark.parametrize("stimuli", [(), ("--stimuli",)], ids=str)
@pytest.mark.parametrize(
    ("part", "told"),
    [
        (("--since", "1e9"), "from second 1e+09 on"),
        (("--since", "2", "--until", "1"), "between the seconds 2 and 1"),
        (("--until", "-1"), "between the seconds 0 and -1"),
    ],
    ids=str,
)
def test_a_part_without_anything_is_told(mdm, tmp_path, stimuli, part, told):
    path = tiger(tmp_path / "run.mcap")
    status, output, errors = mdm("record", "cat", path, *stimuli, *part)
    assert (status, output) == (1, [])
    assert f"{path}: there is nothing to print {told}: the record lasts " in errors


@pytest.mark.parametrize("given", ["1e300", "-1e300", "nan", "inf"])
@pytest.mark.parametrize("option", ["--since", "--until"])
def test_seconds_beyond_all_records_are_refused(mdm, tmp_path, option, given):
    status, output, errors = mdm("record", "cat", tmp_path / "run.mcap", f"{option}={given}")
    assert (status, output) == (2, [])
    assert f"a number of seconds was expected, not '{given}'" in errors


def test_stimuli_of_no_such_ensemble_are_refused(mdm, tmp_path):
    path = tiger(tmp_path / "run.mcap")
    for stimuli in ((), ("--stimuli",)):
        status, output, errors = mdm("record", "cat", path, "--ensemble", "nix", *stimuli)
        assert (status, output) == (1, [])
        assert f"{path}: there are no messages of 'nix'; there are messages of " in errors


def test_a_record_without_stimuli_or_decisions_is_refused(mdm, tmp_path):
    record = Writing(tmp_path / "run.mcap")
    for topic, kind in (("stimuli", Stimulus), ("decisions", messages.Decision)):
        record.writer.topic(topic, schemas.name(kind), schemas.schema(kind))
    path = record.close()
    for verb, word in ((("cat", "--stimuli"), "stimuli"), (("export", "-o", tmp_path / "run.csv"), "decisions")):
        status, output, errors = mdm("record", *verb, path)
        assert (status, output) == (1, [])
        assert f"{path}: there are no {word} in this record" in errors


def test_stimuli_decide_again_as_they_did(mdm, tmp_path):
    path = tiger(tmp_path / "run.mcap")
    decisions = [line["message"] for line in lines(mdm, path, "--topic", "decisions")]
    stimuli = mdm("record", "cat", path, "--stimuli")[1]
    traced = [json.loads(line) for line in mdm("trace", EXAMPLES / "tiger.toml", stdin="\n".join(stimuli))[1]]
    assert len(traced) == len(decisions) == 20
    for before, again in zip(decisions, traced, strict=True):
        assert again["time"] == before["time"] / 1e9
        assert again["belief"] == before["belief"]
        for field in ("epoch", "cause", "action", "action_name", "reward"):
            assert again[field] == before[field]


def test_ticks_without_input_decide_again_too(mdm, tmp_path):
    path = tmp_path / "run.mcap"
    assert mdm("run", EXAMPLES / "tiger.toml", "--virtual", "--epochs", 5, "--record", path)[0] == 0
    decisions = [line["message"] for line in lines(mdm, path, "--topic", "decisions")]
    stimuli = mdm("record", "cat", path, "--stimuli")[1]
    traced = [json.loads(line) for line in mdm("trace", EXAMPLES / "tiger.toml", stdin="\n".join(stimuli))[1]]
    assert len(traced) == 5
    assert [(each["time"], each["action_name"]) for each in traced] == [
        (each["time"] / 1e9, each["action_name"]) for each in decisions
    ]
    assert [json.loads(line)["time"] for line in mdm("record", "cat", path, "--stimuli", "--until", 1)[1]] == [0.5]


def test_ticks_come_when_they_did_by_another_clock_than_one_from_0(mdm, tmp_path):
    """The clock of a run in wall time shows any time at its start, and ticks are aligned to its whole periods."""
    (tmp_path / "robot.toml").write_text(
        """
        [predicates]
        Near = { initial = false }
        [ensembles.robot]
        policy = [0, 1]
        drive = 4
        [ensembles.robot.states]
        near = ["Near"]
        [ensembles.robot.actions]
        go = "act:act"
        turn = "act:act"
        """
    )
    (tmp_path / "act.py").write_text("def act():\n    pass\n")
    system = load_system(tmp_path / "robot.toml")
    heard = []

    async def main():
        clock = VirtualClock(epoch=7_123_456_789)
        async with Runtime(log=False, clock=clock, record=tmp_path / "run.mcap") as runtime:
            runtime.decisions.subscribe(heard.append)
            await runtime.start(system)
            for number in range(9):
                await runtime.clock.sleep(0.11)
                system.predicates.sense("Near", number in {0, 3, 4})

    run_program(main, virtual=True)
    start = Record(tmp_path / "run.mcap").span[0]
    stimuli = mdm("record", "cat", tmp_path / "run.mcap", "--stimuli")[1]
    output = mdm("trace", tmp_path / "robot.toml", stdin="\n".join(stimuli))[1]
    traced = [(round(line["time"] * 1e9) + start, line["action_name"]) for line in map(json.loads, output)]
    assert traced == [(each.time, each.action_name) for each in heard]
    assert len({name for _, name in traced}) == 2
    assert [time % 250_000_000 for time, _ in traced[1:]] == [0] * len(traced[1:])


@pytest.mark.parametrize("lines", [['{"epoch": -1}'], ['{"time": 1}', '{"epoch": 2}']])
def test_an_epoch_is_in_the_first_line_alone(mdm, lines):
    status, _, errors = mdm("trace", EXAMPLES / "tiger.toml", stdin="\n".join(lines))
    assert status == 1
    assert f"standard input:{len(lines)}: an epoch is " in errors


def said(seconds, channel, message):
    time = int(seconds * 1e9)
    return Said(time, channel, type(message).__name__, message)


def test_each_stimulus_has_its_words(mdm, tmp_path):
    record = Writing(tmp_path / "run.mcap")
    for stimulus in (
        said(1, "predicates/sensed", messages.SensorUpdate(1, (("Warm", True), ("Wet", None)), ("Bump",))),
        said(1.5, "top/state", messages.State(1, 2, (1, 0))),
        said(2, "top/below/observation", messages.Observation(1, 3, (3,), (True,))),
        said(2, "top/observation", messages.Observation(1, None, (3, None), (True, False))),
        said(2.5, "top/external_belief", messages.Belief(1, [0.25, 0.75])),
        said(3, "top/control", messages.Control(1, "reset")),
        said(3, "top/control", messages.Control(1, "resume")),
        said(3, "places/pose", messages.PoseUpdate(1, 1.0, 2.0)),
        said(3, "places/pose", messages.PoseUpdate(1, 1.0, 2.0)),
        said(3, "top/state", messages.State(1, None, (1, None))),
    ):
        record.write("stimuli", stimulus, Stimulus)
    record.write("lives", messages.ActionLife(3 * 10**9, "top", 4, "Go", "running"))
    record.write("lives", messages.ActionLife(3 * 10**9, "top", 5, "Stop", "running"))
    for stimulus in (
        Ended(4 * 10**9, "top", 4, interrupted=False, cancelled=False),
        Ended(5 * 10**9, "top", 5, interrupted=False, cancelled=False, error="ValueError"),
        Ended(5 * 10**9, "top", 6, interrupted=True, cancelled=True),
    ):
        record.write("stimuli", stimulus, Stimulus)
    path = record.close()
    status, output, errors = mdm("record", "cat", path, "--stimuli")
    assert status == 0
    assert [json.loads(line) for line in output] == [
        {"time": 0.0, "predicates": {"Warm": True, "Wet": None}, "events": ["Bump"]},
        {"time": 0.5, "state": 2, "ensemble": "top"},
        {"time": 1.0, "observation": 3, "ensemble": "below"},
        {"time": 1.0, "observation": [3, None], "ensemble": "top"},
        {"time": 1.5, "belief": [0.25, 0.75], "ensemble": "top"},
        {"time": 2.0, "control": "reset", "ensemble": "top"},
        {"time": 3.0, "events": ["Go.succeeded"]},
        {"time": 4.0, "events": ["Stop.failed"]},
    ]
    assert errors == (
        "mdm record cat: left out, since mdm trace has no words for them: 1 on top/control, 2 on places/pose, "
        "1 on top/state\n"
    )
    _, output, _ = mdm("record", "cat", path, "--stimuli", "--ensemble", "top/below", "--until", "2")
    assert [json.loads(line)["time"] for line in output] == [0.0, 1.0]
