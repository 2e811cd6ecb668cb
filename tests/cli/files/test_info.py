"""`mdm info`: what a file holds, in words and as JSON."""

from __future__ import annotations

import json

from places import DATA, EXAMPLES, TIGER

from mdm import load_model, save_model
from mdm.formats import save_durations
from mdm.models import Durations
from mdm.problems import grid_world


def test_info(mdm):
    status, output, _ = mdm("info", EXAMPLES / "tiger.pomdp", "--json")
    facts = json.loads(output[0])
    assert status == 0
    assert {key: facts[key] for key in ("kind", "agents", "states", "actions", "observations", "discount")} == {
        "kind": "POMDP",
        "agents": 1,
        "states": 2,
        "actions": 3,
        "observations": 2,
        "discount": 0.95,
    }
    assert facts["actions_per_agent"] == [3]
    assert facts["observations_per_agent"] == [2]
    assert facts["state_factors"] == [{"name": "state", "size": 2}]
    assert facts["event_observations"] is False
    assert json.loads(mdm("info", EXAMPLES / "tiger.vf", "--json")[1][0])["form"] == "alpha vectors"
    assert mdm("info", DATA / "patrol" / "patrol.toml")[1][1].strip().startswith("Patrol: patrol (POMDP, 12 states")
    system = json.loads(mdm("info", DATA / "patrol" / "patrol.toml", "--json")[1][0])
    assert system["ensembles"][0]["actions"]["Patrol"]["model"]["states"] == 12
    assert any("discount" in line for line in mdm("info", EXAMPLES / "tiger.pomdp")[1])


def test_info_prints_names(mdm, tmp_path):
    told = [line.split(maxsplit=2) for line in mdm("info", TIGER)[1]]
    assert ["state", "names", "tiger-left, tiger-right"] in told
    assert ["observation", "names", "hear-left, hear-right"] in told
    lines = mdm("info", DATA / "patrol" / "rooms.pomdpx")[1]
    place = next(index for index, line in enumerate(lines) if line.startswith("state names"))
    assert lines[place].split(maxsplit=2)[2] == "robot: Lobby, Office, Lab"
    assert lines[place + 1].strip() == "fire: nowhere, Lobby, Office, Lab"
    save_model(grid_world("\n".join(["." * 30] * 30 + ["." * 29 + "+"])), tmp_path / "g.npz")
    status, lines, errors = mdm("info", tmp_path / "g.npz")
    assert (status, errors) == (0, "")
    (names,) = [line for line in lines if line.startswith("state names")]
    assert len(names) < 130
    assert names.endswith(f", …, end ({30 * 31 + 1})")
    assert len(json.loads(mdm("info", tmp_path / "g.npz", "--json")[1][0])["state_names"][0]) == 30 * 31 + 1


def test_names_are_shown_as_text_however_odd_and_long(mdm, tmp_path):
    path = tmp_path / "odd.pomdp"
    long = "x" * 1000
    path.write_text(
        f"discount: 0.9\nvalues: reward\nstates: a\x1b[31m {long}\nactions: 1\nobservations: 1\n"
        "T: *\nuniform\nO: *\nuniform\nR: * : * : * : * 1\n"
    )
    for command in (("info", path), ("show", path, "T", "0", "0")):
        status, output, _ = mdm(*command)
        text = "\n".join(output)
        assert status == 0
        assert text.count(r"a\x1b[31m") >= 1
        assert "\x1b" not in text
        assert "x" * 79 + "…" in text
        assert long not in text


def test_info_tells_the_false_negative(mdm, tmp_path):
    save_model(load_model(TIGER).with_false_negatives("hear-right"), tmp_path / "tiger.npz")
    told = [json.loads(mdm("info", file, "--json")[1][0])["false_negative"] for file in (TIGER, tmp_path / "tiger.npz")]
    assert told == [None, "hear-right"]
    status, _, errors = mdm("convert", tmp_path / "tiger.npz", tmp_path / "tiger.pomdp")
    assert (status, len(errors.splitlines())) == (1, 1)
    assert ".pomdp files cannot mark an observation as a false negative" in errors


def test_a_team_is_told_agent_by_agent(mdm, facts):
    path = EXAMPLES / "team" / "offboard.toml"
    status, output, errors = mdm("info", path)
    assert (status, errors) == (0, "")
    assert ["name", "offboard"] in [line.split() for line in output]
    at = output.index("base at tcp/127.0.0.1:7471")
    assert any("doors:robot.listen" in line for line in output[:at])
    assert not any("doors:robot.listen" in line for line in output[at:])
    imported = mdm("info", "--import", path)[1]
    assert any("doors:Robot.listen" in line for line in imported[:at])
    assert not any("doors:Robot.listen" in line for line in imported[at:])
    told = facts("info", path)
    assert (told["kind"], told["steps"], list(told["agents"])) == ("team", "every 0.5 s", ["robot", "base"])


def test_durations(mdm, facts, tmp_path):
    path = tmp_path / "drive.npz"
    for durations, words in [
        (Durations([[12.0, 3.0], [8.0, 3.0]], stages=[4, 1]), "2 actions and 2 states"),
        (Durations([12.0, 3.0], 4), "2 actions"),
        (Durations(3.0), "all states and actions"),
    ]:
        save_durations(durations, path)
        told = facts("info", path)
        assert (told["kind"], told["of"], told["least_seconds"]) == ("durations", words, 3.0)
        assert ["of", words] in [line.split(maxsplit=1) for line in mdm("info", path)[1]]
    for command in (("check", path), ("convert", path, tmp_path / "other.npz"), ("show", path), ("solve", path)):
        status, output, errors = mdm(*command)
        assert (status, output) == (1, [])
        assert "it holds durations" in errors


def test_of_a_record_it_says_what_reads_it(mdm, tmp_path):
    record = tmp_path / "run.mcap"
    record.write_bytes(b"\x89MCAP0\r\n\x01\0\0")
    status, _, errors = mdm("info", record)
    assert status == 2
    assert f"{record} is the record of a run: mdm record info {record} describes it" in errors
