"""`mdm replay`: what differs, where, and what cannot be replayed."""

from __future__ import annotations

import asyncio
import json
import re
import signal

import pytest
import team_file
import team_processes
from mcap.writer import CompressionType, IndexType
from places import EXAMPLES
from records import Writing, copied, with_gap

from mdm import Ensemble, run as run_program
from mdm.messages import Decision
from mdm.policies import DeterministicPolicy
from mdm.recording import Record, Recorder
from mdm.stimuli import Stimulus
from mdm.testing import replay, run_virtual

CODE = """
import asyncio

async def sense(system):
    for number in range(20):
        await asyncio.sleep(0.1)
        system.predicates.sense("Near", number % 3 == 0)

def act():
    pass
"""

FILE = """
tasks = ["walking:sense"]

[predicates]
Near = { initial = false }

[ensembles.robot]
policy = [0, 1]

[ensembles.robot.states]
near = ["Near"]

[ensembles.robot.actions]
go = "walking:act"
turn = "walking:act"
"""


@pytest.fixture
def run(mdm, tmp_path):
    """Record a robot in virtual time; return its file and the record."""
    (tmp_path / "walking.py").write_text(CODE)
    (tmp_path / "robot.toml").write_text(FILE)
    path = tmp_path / "run.mcap"
    assert mdm("run", tmp_path / "robot.toml", "--virtual", "--seconds", "3", "--record", path)[0] == 0
    return tmp_path / "robot.toml", path


def test_a_run_is_repeated_without_its_files(mdm, run):
    file, path = run
    (file.parent / "walking.py").unlink()
    file.unlink()
    status, output, errors = mdm("replay", path)
    assert (status, errors) == (0, "")
    assert output == ["15 decisions recorded, 15 replayed: all the same (bit by bit)"]


@pytest.mark.parametrize(
    "options",
    [
        {"compression": CompressionType.LZ4},
        {"use_chunking": False, "enable_crcs": False, "index_types": IndexType.NONE},
        dict.fromkeys(("repeat_channels", "repeat_schemas", "use_statistics", "use_summary_offsets"), False),
    ],
    ids=["lz4", "no chunks", "no summary"],
)
def test_a_run_is_repeated_from_a_record_that_another_program_wrote_anew(mdm, run, options):
    path = run[1]
    path.write_bytes(copied(path.read_bytes(), **options))
    assert mdm("replay", path)[:2] == (0, ["15 decisions recorded, 15 replayed: all the same (bit by bit)"])
    described = mdm("record", "info", path)[1]
    assert {"complete                yes", "end of the run          in order"} <= set(described)


def test_it_is_one_json_object(mdm, run):
    (line,) = mdm("replay", run[1], "--json")[1]
    assert json.loads(line) == {
        "recorded": 15,
        "replayed": 15,
        "stopped": False,
        "same": True,
        "exact": True,
        "lost": 0,
        "differences": [],
    }


def test_behind_damage_nothing_is_compared_and_a_sentence_says_so(mdm, run, tmp_path):
    gap = with_gap(run[1], tmp_path / "gap.mcap", 40, 3)
    decisions = [each for each in gap.messages(["decisions"]) if each.sequence < 40]
    until = gap.gap.until / 1e9
    status, output, errors = mdm("replay", gap.path)
    assert (status, errors) == (0, "")
    told = f"before {until:.6f} s messages of the record are lost: what was decided from there on"
    assert output == [
        f"{len(decisions)} decisions recorded, {len(decisions)} replayed: all the same (bit by bit)",
        f"{gap.path}: 3 messages are lost",
        f"{told} cannot be replayed, and is not compared",
    ]
    (line,) = mdm("replay", gap.path, "--json")[1]
    assert json.loads(line)["until"] == until


def test_another_configuration_is_compared(mdm, run):
    file, path = run
    file.write_text(FILE.replace("[0, 1]", "[0, 0]"))
    status, output, errors = mdm("replay", path, "--config", file)
    assert (status, errors) == (1, "")
    assert output[0] == "15 decisions recorded, 15 replayed: not the same (bit by bit)"
    assert output[1] == "decision 1, of 'robot' at 0.100000 s: action 'turn', now 'go'"
    assert output[2].startswith("  before it: ")
    assert any("said channel predicates/sensed" in line and "('Near', True)" in line for line in output[2:7])
    (line,) = mdm("replay", path, "--config", file, "--json", "--most", "2")[1]
    assert [each["decision"] for each in json.loads(line)["differences"]] == [1, 3]
    (difference, _) = json.loads(line)["differences"]
    assert (difference["recorded"], difference["replayed"], difference["fields"]) == ("turn", "go", ["action"])
    turns = sum(each.message.action_name == "turn" for each in Record(path).messages(["decisions"]))
    row = {
        "ensemble": "robot",
        "state": "near=Near",
        "decisions": turns,
        "recorded": "turn",
        "now": "go",
        "count": turns,
    }
    assert json.loads(line)["redecided"] == [row]
    assert output[-3:-1] == [
        "decided otherwise in the same state or on the same belief, each by itself:",
        f"  robot, near=Near: 'turn', now 'go', in {turns} of {turns} decisions",
    ]


def test_decisions_of_another_configuration_are_compared_with_those_of_their_time(mdm, run):
    """One more decision after each `go` shifts all that follow by one, which makes them no others."""
    file, path = run
    again = 'go = { call = "walking:act", then = "decide", pause = 0.07 }'
    file.write_text(FILE.replace('go = "walking:act"', again))
    (line,) = mdm("replay", path, "--config", file, "--json", "--most", "1000")[1]
    told = json.loads(line)
    assert told["differences"]
    assert {each["recorded"] for each in told["differences"]} == {None}
    assert told["replayed"] == 15 + len(told["differences"])
    assert told["redecided"] == []


def rewritten(path, new, *, head=None, metadata=None, stimuli=True, files=True):
    """Write a record once more, with changes; return the new one."""
    record = Record(path)
    writing = Writing(new, record.head | (head or {}))
    for name, facts in (record.metadata | (metadata or {})).items():
        if name.startswith("ensemble "):
            writing.writer.metadata(name, facts)
    for each in record.attachments if files else []:
        writing.writer.attach(each.name, each.media_type, each.data)
    kinds = {"stimuli": Stimulus, "decisions": Decision}
    for each in record.messages(["stimuli", "decisions"] if stimuli else ["decisions"]):
        writing.write(each.topic, each.message, kinds[each.topic])
        writing.writer.flush()
    return writing.close()


def test_the_environment_decides_whether_numbers_are_compared_exactly(mdm, run, tmp_path):
    other = rewritten(run[1], tmp_path / "other.mcap", head={"numpy": "1.0"})
    assert mdm("replay", other)[:2] == (
        0,
        ["15 decisions recorded, 15 replayed: all the same (numbers to 1e-9, for the environment differs)"],
    )


def test_a_model_whose_digest_differs_is_refused(mdm, run, tmp_path):
    metadata = {"ensemble robot": {"configuration": "0123456789abcdef"}}
    other = rewritten(run[1], tmp_path / "other.mcap", metadata=metadata)
    status, output, errors = mdm("replay", other)
    assert (status, output) == (1, [])
    assert "ensemble 'robot' is not that of the run (digest " in errors
    assert ", then 0123456789ab)" in errors
    assert errors.rstrip().endswith("with --config a configuration of yours is compared")
    assert mdm("replay", other, "--config", run[0])[0] == 0


def test_a_record_without_a_start_is_refused(mdm, run, tmp_path):
    other = rewritten(run[1], tmp_path / "other.mcap", stimuli=False)
    status, output, errors = mdm("replay", other)
    assert (status, output) == (1, [])
    assert errors == f"mdm replay: {other}: the record has no beginning: nothing in it says when an actor started\n"


def test_a_record_without_a_configuration_names_the_way_out(mdm, tmp_path):
    path = tmp_path / "run.mcap"
    robot = Ensemble("robot", policy=DeterministicPolicy([0], 1), actions={"go": lambda: None})
    run_virtual(lambda runtime: runtime.start(robot), extensions=[Recorder(path)])
    status, output, errors = mdm("replay", path)
    assert (status, output) == (1, [])
    assert "the record has no configuration" in errors
    assert "--config" in errors


def test_a_team_s_configuration_for_a_robot_alone_is_refused(mdm, tmp_path):
    path = tmp_path / "run.mcap"
    assert mdm("run", EXAMPLES / "tiger.toml", "--virtual", "--epochs", 2, "--record", path)[0] == 0
    simulated = tmp_path / "simulated.mcap"
    assert mdm("simulate", EXAMPLES / "tiger.toml", "--episodes", 1, "--record", simulated)[0] == 0
    file = team_file.write(tmp_path)
    for record, way in ((path, "without a table [team]"), (simulated, "give the team's --model and --policy")):
        status, output, errors = mdm("replay", record, "--config", file)
        assert (status, output) == (1, [])
        assert f"{file}: this file describes the team " in errors
        assert way in errors


def test_what_is_no_record_is_refused(mdm, tmp_path):
    (tmp_path / "other.mcap").write_text("no record")
    (tmp_path / "empty").mkdir()
    for path in ("other.mcap", "none.mcap", "empty"):
        status, output, errors = mdm("replay", tmp_path / path)
        assert (status in {1, 2}, output) == (True, [])
        assert errors.startswith("mdm replay: ")
        assert str(tmp_path / path) in errors
        assert errors.count("\n") == 1


def test_a_simulation_is_repeated(mdm, tmp_path):
    path = tmp_path / "run.mcap"
    options = ["--episodes", "3", "--steps", "10", "--seed", "7"]
    model, policy = EXAMPLES / "tiger.pomdp", EXAMPLES / "tiger.vf"
    assert mdm("simulate", "--model", model, "--policy", policy, *options, "--record", path)[0] == 0
    status, output, _ = mdm("replay", path)
    assert status == 0
    assert output[0].startswith("30 decisions recorded, 30 replayed: all the same")


def _refuse_another_team(mdm, file, other, records):
    """See that a team of another name, or with its agents in another order, is refused by what differs."""
    text = file.read_text()
    (agents,) = [line for line in text.splitlines() if line.startswith("agents = ")]
    first, second = re.findall(r"\{.*?\}", agents)
    for old, new, told in (
        ('name = "rooms"', 'name = "halls"', "the team's name was rooms in the run, and halls in this configuration"),
        (
            agents,
            agents.replace(first, "first").replace(second, first).replace("first", second),
            "the team's agents were a, b in the run, and b, a in",
        ),
    ):
        assert new != old
        assert old in text
        other.write_text(text.replace(old, new))
        for given in (records, records / "a.mcap"):
            status, output, errors = mdm("replay", given, "--config", other)
            assert (status, output) == (1, [])
            assert told in errors


async def on_a_simulated_network(file, records):
    async with team_file.running(file, records=records, delay=0.001):
        await asyncio.sleep(2)


def in_processes(file, records):
    with team_processes.up(file, "--record", records) as running:
        for agent in "ab":
            running.hear(agent=agent, event="output", text="go", times=10)
        running.process.send_signal(signal.SIGINT)
        assert running.end()[0] == 130


@pytest.mark.parametrize("separate", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_team_of_two_is_repeated_together(mdm, tmp_path, separate):
    code = team_file.CODE.replace(
        "    import asyncio\n    await asyncio.Event().wait()",
        "    import asyncio\n    for number in range(10**9):\n"
        '        system.predicates.sense("InLab", number % 2 == (system.agent == "a"))\n'
        "        await asyncio.sleep(0.05)",
    )
    file = team_file.write(tmp_path)
    (tmp_path / "team_code.py").write_text(code)
    file.write_text(team_processes.on_free_ports(file.read_text().replace("port = 7600\n", "")))
    if separate:
        (tmp_path / "team_code.py").write_text(code.replace('done.append("go")', 'print("go", flush=True)'))
        in_processes(file, tmp_path / "records")
    else:
        run_program(lambda: on_a_simulated_network(file, tmp_path / "records"), virtual=True)
    status, output, errors = mdm("replay", tmp_path / "records", "--json")
    assert (status, errors) == (0, "")
    facts = json.loads(output[0])
    assert [agent["same"] for agent in facts["agents"].values()] == [True, True]
    assert all(agent["recorded"] >= 10 for agent in facts["agents"].values())
    assert facts["messages"] > 20
    recorded = sum(agent["recorded"] for agent in facts["agents"].values())
    assert replay(tmp_path / "records") == recorded
    assert facts["messages_not_sent"] == 0
    assert mdm("replay", tmp_path / "records", "--config", file)[0] == 0
    other = file.with_name("other.toml")
    other.write_text(file.read_text().replace("[team]", "[team]\nlease = 2.5", 1))
    status, output, errors = mdm("replay", tmp_path / "records", "--config", other)
    assert (status, errors) == (1, "")
    for name, first, second in (("a", *output[:2]), ("b", *output[2:4])):
        told = re.fullmatch(rf"{name}.mcap: up to (\S+) s, (\d+) decisions? recorded, \2 replayed: .*", first)
        assert re.match(rf"from {told[1]} s on nothing can be told of it, for [ab] sen(ds|t) a message under ", second)
    with pytest.raises(AssertionError, match="nothing can be told"):
        replay(tmp_path / "records", config=other)
    status, output, errors = mdm("replay", tmp_path / "records" / "a.mcap", "--config", other)
    assert (status, output) == (1, [])
    assert "configuration of ensemble " in errors
    assert "mdm replay FOLDER --config, with the records of all of them" in errors
    _refuse_another_team(mdm, file, other, tmp_path / "records")
    other.write_text(file.read_text().replace("[0, 1, 2, 3]", "[0, 0, 2, 3]"))
    status, output, errors = mdm("replay", tmp_path / "records", "--config", other, "--json")
    assert (status, errors) == (1, "")
    for name, agent in json.loads(output[0])["agents"].items():
        decisions = [each.message for each in Record(tmp_path / "records" / name).messages(["decisions"])]
        different = [number for number, each in enumerate(decisions[: agent["recorded"]]) if each.state == 1]
        assert agent["differences"][0]["decision"] == different[0]
        assert (agent["different"], agent["recorded"]) == (len(different), agent["replayed"])
        assert agent["recorded"] >= 10
    with pytest.raises(AssertionError, match="action 'stay go', now 'stay stay'"):
        replay(tmp_path / "records", config=other)
    old = 'predicates = { lab = "InLab" }, owner = "b"'
    assert old in file.read_text()
    other.write_text(file.read_text().replace(old, old.replace("lab =", "hall =")))
    options = ["--config", other, "--json", "--most", 1000]
    for name, agent in json.loads(mdm("replay", tmp_path / "records", *options)[1][0])["agents"].items():
        decisions = [each.message for each in Record(tmp_path / "records" / name).messages(["decisions"])]
        states = [each.state for each in decisions[: agent["recorded"]]]
        told = [each["text"].partition(": ")[2].partition(";")[0] for each in agent["differences"]]
        assert told == [f"state {state}, now {state ^ 1}" for state in states]  # which no fact of the team says
    other.write_text(file.read_text().replace("[0, 1, 2, 3]", "[0, 0, 2, 3]"))
    (tmp_path / "records" / "b.mcap").rename(tmp_path / "b.mcap")
    status, output, errors = mdm("replay", tmp_path / "records")
    assert (status, errors) == (0, "")
    assert re.fullmatch(r"\d+ more are of b in a life of which there is no record here", output[-1])
    status, output, errors = mdm("replay", tmp_path / "records", "--config", other)
    assert (status, errors) == (1, "")
    assert re.fullmatch(r"a.mcap: up to \S+ s, 0 decisions recorded, 0 replayed: nothing to compare \(.*\)", output[0])
    assert "for a received of b, of whose life then no record is here" in output[1]
    (tmp_path / "records" / "c.mcap").write_bytes((tmp_path / "records" / "a.mcap").read_bytes())
    status, output, errors = mdm("replay", tmp_path / "records")
    assert (status, output) == (1, [])
    assert "c.mcap and a.mcap are both of agent 'a' in the same life" in errors
    model = ["--model", EXAMPLES / "tiger.pomdp", "--policy", EXAMPLES / "tiger.vf", "--episodes", "1"]
    assert mdm("simulate", *model, "--record", tmp_path / "records" / "c.mcap")[0] == 0
    for options in ([], ["--config", other]):
        status, output, errors = mdm("replay", tmp_path / "records", *options)
        assert (status, output) == (1, [])
        assert "is of an agent of a team, and" in errors


MODEL = "discount: 0.9\nvalues: reward\nstates: away near\nactions: go turn\n"
MODEL += "T: go\nidentity\nT: turn\n0.5 0.5\n{}\nR: go : away : * : * 1\nR: turn : near : * : * {}\n"


@pytest.fixture
def modelled(mdm, run):
    """Record a robot with a model; return its file, that of its model, and the record."""
    file, path = run
    text = FILE.replace("policy = [0, 1]", 'model = "walk.MDP"\npolicy = [0, 1]')
    file.write_text(text.replace('near = ["Near"]', 'x = { near = "Near" }'))
    (file.parent / "walk.MDP").write_text(MODEL.format("0 1", 2))
    other = path.with_name("model.mcap")
    assert mdm("run", file, "--virtual", "--seconds", "3", "--record", other)[0] == 0
    return file, file.parent / "walk.MDP", other


def test_an_entry_that_differs_is_named_though_decisions_do_not(mdm, modelled):
    file, model, record = modelled
    model.write_text(MODEL.format("0.25 0.75", 2))
    status, output, errors = mdm("replay", record, "--config", file)
    assert (status, errors) == (0, "")
    entry = "of the model of 'robot' the probability of 'away' after 'turn' in 'near' was 0, and is 0.25"
    assert output == ["15 decisions recorded, 15 replayed: all the same (bit by bit)", entry]
    (line,) = mdm("replay", record, "--config", file, "--json")[1]
    assert (json.loads(line)["same"], json.loads(line)["entry"]) == (True, entry)
    model.write_text(MODEL.format("0 1", 2))
    assert mdm("replay", record, "--config", file)[1] == output[:1]


def test_a_part_that_differs_is_named_where_it_is_no_entry_of_a_model(mdm, run):
    file, path = run
    file.write_text(FILE.replace("[ensembles.robot]", "[ensembles.robot]\nhorizon = 500"))
    status, output, errors = mdm("replay", path, "--config", file)
    assert (status, errors) == (0, "")
    assert output[1:] == ["ensemble 'robot': the option horizon was None, and is 500"]


def test_the_entry_of_the_model_that_differs_is_named(mdm, modelled):
    file, model, other = modelled
    model.write_text(MODEL.format("0 1", 4))
    status, output, errors = mdm("replay", other, "--config", file)
    assert (status, errors) == (1, "")
    assert output[-1] == "of the model of 'robot' the reward of 'turn' in 'near' was 2, and is 4"
    status, output, errors = mdm("explain", other, "--config", file, "--at", "2")
    assert (status, errors) == (0, "")
    told = "as it would decide now (of the model of 'robot' the reward of 'turn' in 'near' was 2, and is 4)"
    assert output[1].startswith(f"By another configuration, {told}; decided was '")
