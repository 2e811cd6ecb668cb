"""Configurations in records: the files that a TOML file names are kept, and laid out as they were."""

from __future__ import annotations

import re
import shutil

import numpy as np
import pytest
from places import EXAMPLES
from records import Writing
from sentences import refused

import mdm
from mdm.config.rebuilt import check_digests, different_part
from mdm.config.recorded import attach_configuration, load_recorded
from mdm.errors import ConfigError, Error
from mdm.recording import Record, Recorder
from mdm.testing import run_virtual

pytestmark = pytest.mark.usefixtures("recorded_here")

FILE = """
[ensembles.robot]
model = "../models/room.npz"
policy = "robot.policy"

[ensembles.robot.actions]
stay = "robot_code:stay"
go = "robot_code:go"
"""


@pytest.fixture
def file(tmp_path):
    """A file whose model stands beside its folder, and whose functions can be imported by nobody."""
    for folder in ("robot", "models"):
        (tmp_path / folder).mkdir()
    transitions = [np.eye(2), [[0, 1], [1, 0]]]
    model = mdm.models.MDP(transitions, np.zeros((2, 2)), discount=0.9, actions=["stay", "go"])
    mdm.save_model(model, tmp_path / "models" / "room.npz")
    mdm.save_policy(mdm.policies.DeterministicPolicy([1, 0], 2), tmp_path / "robot" / "robot.policy")
    (tmp_path / "robot" / "robot.toml").write_text(FILE)
    return tmp_path / "robot" / "robot.toml"


def recorded(file, path):
    recorder = Recorder(path)
    attach_configuration(recorder, file)
    system = mdm.load_system(file, callbacks=False)
    run_virtual(lambda runtime: runtime.start(system), record=recorder)
    return Record(path), system


def test_the_files_of_a_run_are_kept_and_loaded_from_the_record(file, tmp_path):
    record, system = recorded(file, tmp_path / "run.mcap")
    assert sorted(each.name for each in record.attachments) == [
        "files/../models/room.npz",
        "files/robot.policy",
        "files/robot.toml",
    ]
    assert (record.head["configuration"], record.head["folder"]) == ("robot.toml", str(file.parent))
    shutil.rmtree(file.parent)
    shutil.rmtree(tmp_path / "models")
    (tmp_path / "laid").mkdir()
    again = load_recorded(record, tmp_path / "laid")
    check_digests(record, again.ensembles.values())
    assert again.ensembles["robot"].controller.configuration == system.ensembles["robot"].controller.configuration


def test_the_demo_is_kept_with_its_map(tmp_path):
    recorder = Recorder(tmp_path / "run.mcap")
    attach_configuration(recorder, EXAMPLES / "patrol" / "patrol.toml")
    names = {name.removeprefix("files/") for name, _, _ in recorder._attached}
    assert names == {
        *("patrol.toml", "floor.xml", "floor.yaml", "floor.pgm", "labels.png"),
        *("patrol.npz", "patrol.policy", "top.pomdpx", "top.policy"),
    }


def test_a_configuration_that_needs_code_is_refused_and_the_way_out_told(file, tmp_path):
    file.write_text(FILE.replace('policy = "robot.policy"', 'policy = "robot_code:Policy"'))
    recorder = Recorder(tmp_path / "run.mcap")
    attach_configuration(recorder, file)
    run_virtual(lambda runtime: runtime.start(mdm.Actor("other")), record=recorder)
    with refused(ConfigError):
        load_recorded(Record(tmp_path / "run.mcap"), tmp_path / "laid out")


def test_another_configuration_may_stand_in_its_place(file, tmp_path):
    record, _ = recorded(file, tmp_path / "run.mcap")
    mdm.save_policy(mdm.policies.DeterministicPolicy([0, 0], 2), file.parent / "robot.policy")
    other = load_recorded(record, tmp_path, file)
    with pytest.raises(Error) as caught:
        check_digests(record, other.ensembles.values())
    assert "the policy of ensemble 'robot' is not that of the run (it differs in the policy's actions)" in str(
        caught.value
    )


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            lambda transitions, _: transitions[1].reverse(),
            "it differs in the model's transition function of action 'go'",
        ),
        (lambda _, facts: facts.update(discount=0.8), "the model's discount was 0.9, and is 0.8"),
        (lambda _, facts: facts.update(horizon="horizon = 7"), "the option horizon was None, and is 7"),
    ],
)
def test_the_first_part_that_differs_is_named(file, tmp_path, change, told):
    record, _ = recorded(file, tmp_path / "run.mcap")
    transitions, facts = [np.eye(2), [[0, 1], [1, 0]]], {"discount": 0.9, "horizon": ""}
    change(transitions, facts)
    model = mdm.models.MDP(transitions, np.zeros((2, 2)), discount=facts["discount"], actions=["stay", "go"])
    mdm.save_model(model, file.parents[1] / "models" / "room.npz")
    file.write_text(FILE.replace('policy = "robot.policy"', f'policy = "robot.policy"\n{facts["horizon"]}'))
    other = load_recorded(record, tmp_path, file)
    with pytest.raises(Error, match=re.escape(f"is not that of the run ({told})")):
        check_digests(record, other.ensembles.values())


def test_a_record_whose_head_has_no_parts_has_the_digests_told(file, tmp_path):
    record, system = recorded(file, tmp_path / "run.mcap")
    controller = system.ensembles["robot"].controller
    facts = record.metadata["ensemble robot"]
    assert different_part(facts, controller) is None
    for parts in ("", "[1]", '{"a": 1}'):
        assert different_part(facts | {"parts": parts}, controller) is None
    del facts["parts"]
    assert different_part(facts, controller) is None


def test_a_record_without_a_configuration_is_refused(tmp_path):
    robot = mdm.Ensemble("robot", policy=mdm.policies.DeterministicPolicy([0], 1), actions={"go": lambda: None})
    run_virtual(lambda runtime: runtime.start(robot), extensions=[Recorder(tmp_path / "run.mcap")])
    with refused(ConfigError):
        load_recorded(Record(tmp_path / "run.mcap"), tmp_path)


def test_a_formula_that_begins_like_a_home_names_no_file(file, tmp_path):
    file.write_text(f'predicates.Idle = "~Busy"\npredicates.Busy = {{}}\n{FILE}')
    record, _ = recorded(file, tmp_path / "run.mcap")
    assert len(record.attachments) == 3


@pytest.mark.parametrize("name", ["../" * 6 + "elsewhere", "/elsewhere", "robot.py", "robot.pyc", "robot.so"])
def test_a_file_that_would_leave_the_folder_or_be_imported_is_refused(tmp_path, name):
    writing = Writing(tmp_path / "run.mcap", {"format": "1", "mdm": "0.1.0", "configuration": "robot.toml"})
    writing.writer.attach(f"files/{name}", "application/octet-stream", b"")
    record = Record(writing.close())
    (tmp_path / "laid").mkdir()
    with refused(Error):
        load_recorded(record, tmp_path / "laid")
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [tmp_path / "run.mcap"]


def test_a_configuration_that_would_be_elsewhere_is_refused(tmp_path):
    writing = Writing(tmp_path / "run.mcap", {"format": "1", "mdm": "0.1.0", "configuration": "../../robot.toml"})
    with refused(Error):
        load_recorded(Record(writing.close()), tmp_path)


def test_code_is_kept_with_no_record(file, tmp_path):
    (file.parent / "robot_code.py").write_text("")
    file.write_text(f'tasks = ["robot_code.py"]\n{FILE}')
    recorder = Recorder(tmp_path / "run.mcap")
    attach_configuration(recorder, file)
    assert [name for name, _, _ in recorder._attached if name.endswith(".py")] == []
