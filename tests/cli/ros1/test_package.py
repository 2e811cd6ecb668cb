"""``mdm import-ros1``: packages of the original become systems that decide as those written by hand."""

from __future__ import annotations

import json
import shutil
import tomllib

import pytest
from cli.ros1 import packages
from places import EXAMPLES

from mdm.cli import main
from mdm.maps import load_map


def decisions(file, stimuli, mdm):
    """Return what a system decides on stimuli, without names that are its own affair."""
    status, output, errors = mdm("trace", file, stdin="".join(json.dumps(each) + "\n" for each in stimuli))
    assert (status, errors) == (0, "")
    lines = [json.loads(line) for line in output]
    return [
        {key: line[key] for key in ("time", "epoch", "cause", "action", "state", "belief") if key in line}
        for line in lines
    ]


def found(capsys):
    """Return what the check of an imported file says, but for the robot's own functions."""
    lines = [line for line in capsys.readouterr().err.splitlines() if "no module 'robot'" not in line]
    return [line for line in lines if not line.endswith("problems found")]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_an_mdp_over_a_map(folder, mdm, capsys):
    package = packages.rounds(folder)
    assert main(["import-ros1", str(package), "-o", "made"]) == 0
    assert found(capsys) == []
    text = (folder / "made" / "rounds.toml").read_text()
    hand = packages.write(folder / "hand", {"robot.toml": packages.ROUNDS, "map.xml": packages.GRAPH})
    made, written = tomllib.loads(text), tomllib.loads(packages.ROUNDS)
    assert made["ensembles"]["robot"]["states"] == {"state0": ["InHall", "InOffice"], "state1": ["IsLate"]}
    assert made["ensembles"]["robot"]["actions"] == written["ensembles"]["robot"]["actions"]
    assert made["predicates"]["IsFree"] == written["predicates"]["IsFree"]
    assert made["places"] == written["places"]
    assert made["events"] == {"BecameFree": "(IsNight implies IsFree)"}
    assert "# not taken over: addPredicate (*make_one()), of src/predicates.cpp:" in text
    assert "# not taken over: <node> depends on if='$(arg shown)': the argument 'shown' has no value, of launch" in text
    assert "# was: parameter is_sparse = true, of launch/robot.launch:6: it has no meaning here" in text
    assert "# was: class Clock, of src/predicates.cpp:5" in text
    assert str(folder) not in text
    stimuli = [{"time": time, "state": state} for time, state in enumerate([0, 3, 1, 2, 2, 0])]
    first, second = (decisions(file, stimuli, mdm) for file in ("made/rounds.toml", hand / "robot.toml"))
    assert first == second
    assert [one["action"] for one in first] == [1, 0, 1, 0, 0, 1]


def test_a_pomdp_on_events(folder, mdm, capsys):
    assert main(["import-ros1", str(packages.door(folder))]) == 1  # the folder of its name is its own
    assert "door: this folder is not empty" in capsys.readouterr().err
    assert main(["import-ros1", "door", "-o", "made"]) == 0
    assert found(capsys) == []
    made = tomllib.loads((folder / "made" / "door.toml").read_text())
    assert made["ensembles"]["listener"]["drive"] == 2.0
    assert made["ensembles"]["listener"]["actions"] == {
        "listen": "robot:listen",
        "open-left": "robot:openLeft",
        "open-right": "robot:open_right",
    }
    stimuli = [
        {"time": 0.2 + 0.5 * place, "events": [event]}
        for place, event in enumerate(["HearLeft", "HearLeft", "HearRight", "HearRight", "HearRight", "HearLeft"])
    ]
    hand = decisions(EXAMPLES / "tiger.toml", stimuli, mdm)
    assert decisions("made/door.toml", stimuli, mdm) == hand
    assert len({one["action"] for one in hand}) > 1


def test_a_hierarchy(folder, mdm, capsys):
    assert main(["import-ros1", str(packages.levels(folder)), "-o", "made"]) == 0
    assert found(capsys) == []
    hand = packages.write(folder / "hand", {"robot.toml": packages.LEVELS})
    stimuli = [
        {"time": 0.0, "predicates": {"Called": False, "AtEnd": False}},
        {"time": 1.0, "predicates": {"AtEnd": True}},
        {"time": 2.0, "predicates": {"Called": True}},
        {"time": 3.0, "predicates": {"AtEnd": False}},
        {"time": 4.0, "predicates": {"Called": False}},
    ]
    first, second = (decisions(file, stimuli, mdm) for file in ("made/levels.toml", hand / "robot.toml"))
    assert first == second
    assert len(first) == 6


@pytest.mark.foreign("topology/topological_map.xml")
def test_a_map_with_an_image_of_labels(folder, corpus, capsys):
    package = packages.rounds(folder)
    for name in (
        "topological_map.xml",
        "ISR_rviz_map.yaml",
        "ISR_rviz_map.pgm",
        "ISR_label_map.png",
        "predicate_labels.yaml",
    ):
        shutil.copyfile(corpus / "topology" / name, package / "config" / name)
    text = (package / "config" / "ISR_rviz_map.yaml").read_text()
    (package / "config" / "ISR_rviz_map.yaml").write_text(text.replace("../maps/", "../config/"))
    find = "$(find rounds)/config"
    replace(
        package,
        '<include file="$(find rounds)/launch/move.launch"><arg name="map" value="map.xml"/></include>',
        f"""<include file="$(find rounds)/launch/move.launch"><arg name="map" value="topological_map.xml"/></include>
        <node pkg="map_server" type="map_server" name="map_server" args="{find}/ISR_rviz_map.yaml"/>
        <node pkg="mdm_topological_tools" type="pose_labeler" name="labels" args="{find}/ISR_label_map.png pose"/>
        <rosparam file="{find}/predicate_labels.yaml" command="load" ns="predicate_labels"/>""",
    )
    assert main(["import-ros1", "rounds", "-o", "made"]) == 0
    assert [line for line in found(capsys) if "there is no" not in line] == []
    places = tomllib.loads((folder / "made" / "rounds.toml").read_text())["places"]
    floor = load_map(
        *(f"made/{places['graph']}",), **{key: f"made/{places[key]}" for key in ("grid", "labels", "names")}
    )
    expected = load_map(
        corpus / "topology" / "topological_map.xml",
        grid=package / "config" / "ISR_rviz_map.yaml",
        labels=corpus / "topology" / "ISR_label_map.png",
        names=corpus / "topology" / "predicate_labels.yaml",
    )
    assert floor.graph == expected.graph
    assert (floor.labels.raster == expected.labels.raster).all()


WRONG = {
    "no package": (lambda package: None, ["nowhere"], "nowhere: there is no such folder"),
    "no launch file": (lambda package: (package / "launch/robot.launch").unlink(), None, "launch"),
    "a broken launch file": (
        lambda package: (package / "launch/robot.launch").write_text("<launch>\n<node"),
        None,
        "robot.launch",
    ),
    "another document": (
        lambda package: (package / "launch/robot.launch").write_text("<robot/>"),
        None,
        "robot.launch: a <launch> was expected",
    ),
    "another package": (
        lambda package: replace(package, "$(find rounds)/config/$(arg policy)", "$(find elsewhere)/policy"),
        None,
        "the arguments of 'control' cannot be known: the package 'elsewhere' is another one",
    ),
    "a condition": (
        lambda package: replace(package, '<group ns="robot">', '<group ns="robot" unless="$(arg simulated)">'),
        None,
        "whether this <group> counts cannot be known: unless: the argument 'simulated' has no value",
    ),
    "no truth": (
        lambda package: replace(package, '<group ns="robot">', '<group ns="robot" if="maybe">'),
        None,
        "if was expected to be true or false, not 'maybe'",
    ),
    "no file": (
        lambda package: (package / "config/policy").unlink(),
        None,
        "config/policy, a file of ControllerEventMDP",
    ),
    "no controller": (
        lambda package: (package / "src/control.cpp").write_text("int main () {}"),
        None,
        "makes a controller",
    ),
    "itself": (
        lambda package: replace(package, "launch/move.launch", "launch/robot.launch"),
        None,
        "launch files include each other without end",
    ),
    "another launch file": (lambda package: None, ["rounds", "--launch", "other.launch"], "no such launch file"),
}


def replace(package, old, new):
    path = package / "launch" / "robot.launch"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


@pytest.mark.parametrize("name", WRONG)
def test_wrong_input_is_a_sentence_and_leaves_nothing(name, folder, capsys):
    package = packages.rounds(folder)
    change, arguments, told = WRONG[name]
    change(package)
    assert main(["import-ros1", *(arguments or ["rounds"]), "-o", "made"]) == 1
    error = capsys.readouterr().err
    assert told in error
    assert error.startswith("mdm import-ros1: ")
    assert error.count("\n") == 1
    assert [path.name for path in folder.iterdir()] == ["rounds"]


def test_of_several_launch_files_one_is_named(folder, capsys):
    package = packages.rounds(folder)
    text = (package / "launch/robot.launch").read_text()
    (package / "launch/second.launch").write_text(text)
    assert main(["import-ros1", "rounds", "-o", "made"]) == 1
    assert "launch/robot.launch, launch/second.launch; name one with --launch" in capsys.readouterr().err
    assert main(["import-ros1", "rounds", "-o", "made", "--launch", "second.launch"]) == 0


LEARNER = {
    "package.xml": "<package><name>learner</name><version>0.1.0</version></package>",
    "states.cpp": """StateLayer sl; sl.addStateFactor ( StateDep().add("Near").add("Far") );
sl.addClock ( "x" );
SpeechLayer speech ( 3 );""",
    "acts.cpp": """Wrapper al; al.getActionLayer().addAction ( boost::bind ( &A::go, &a ), "Go" );
al->addAction ( &put );
addAction ( &late );""",
    "learn.cpp": "int main ( int c, char** argv ) {\nstring policy = argv[1]; string q = argv[2];\n{made}\n}",
    "policy": "[2](1,0)",
    "q_values": "[2,2]((0,5),(1,0))",
    "all.launch": """<launch>
        <node pkg="learner" name="state_layer" type="states"/>
        <node pkg="learner" name="control_layer" type="learn"
            args="$(find learner)/policy $(find learner)/q_values $(find learner)/new"/>
        <node pkg="learner" name="action_layer" type="acts"/>
    </launch>""",
}  # fmt: skip


def learner(folder, made="QLearningMDP ql ( ALPHA, EVENT, 2, 2, policy, q, argv[3] );"):
    """Write a package with a learning controller, in a folder of another name."""
    return packages.write(folder / "checkout", {name: text.replace("{made}", made) for name, text in LEARNER.items()})


@pytest.mark.parametrize(
    ("made", "kind"),
    [
        ("QLearningMDP ql ( ALPHA, EVENT, 2, 2, policy, q, argv[3] );", "QLearningMDP"),
        ("auto ql = new mdm::SarsaLearner ( policy, q );", "SarsaLearner"),
        ("ptr = boost::make_shared<DecPOMDPController> ( policy, q );", "DecPOMDPController"),
        ("ControllerEventMDP* c = new ControllerEventMDP ( policy, 2, 2 );", None),
    ],
)
def test_what_is_beside_a_controller_that_is_not_known_is_taken(folder, capsys, made, kind):
    assert main(["import-ros1", str(learner(folder, made))]) == 0
    assert found(capsys) == []
    text = (folder / "learner" / "learner.toml").read_text()
    table = tomllib.loads(text)["ensembles"]["learner"]
    assert table == {
        "policy": "policy",
        "states": {"state0": ["Near", "Far"]},
        "actions": {"Go": "robot:go", "put": "robot:put"},
    }
    notes = [line.removeprefix("# not taken over: ") for line in text.splitlines() if line.startswith("# not")]
    if kind is not None:
        assert f"{kind}, of learn.cpp:3: this controller is not known; what is beside it is taken" in notes
        assert f'# policy = "q_values"  # was: another file of {kind}' in text
        assert (folder / "learner" / "q_values").read_text() == LEARNER["q_values"]
    assert "addClock (…), of states.cpp:2: this call is not known" in notes
    assert "addAction (…), of acts.cpp:3: its layer is not known" in notes
    assert "SpeechLayer, of states.cpp:3: this layer is not known" in notes
    assert any(note.startswith("a file of QLearningMDP, of all.launch:3:") for note in notes) is ("argv[3]" in made)


def test_layers_that_lead_to_no_controller_are_noted(folder, capsys):
    package = learner(folder, "nothing ();")
    assert main(["import-ros1", str(package), "-o", "made", "--launch", "all.launch"]) == 1
    assert "0 ensembles" in capsys.readouterr().out
    text = (folder / "made" / "learner.toml").read_text()
    for call, place in (("addStateFactor (Near, Far)", "states.cpp:1"), ("addAction (Go)", "acts.cpp:1")):
        assert f"# not taken over: {call}, of {place}: no controller is joined to its layer" in text


@pytest.mark.foreign("small inputs after public reports")
def test_a_reported_package_with_a_learner(folder, corpus, capsys):
    assert main(["import-ros1", str(corpus / "reported" / "learner"), "--launch", "all.launch"]) == 0
    assert found(capsys) == []
    text = (folder / "learner" / "learner.toml").read_text()
    table = tomllib.loads(text)["ensembles"]["learner"]
    assert table["policy"] == "policy"
    assert table["states"] == {"state0": ["Near", "Far"], "state1": ["Held"]}
    assert [*table["actions"]] == ["Go", "Grasp", "Put"]
    assert "QLearningMDP, of src/learn.cpp:1: this controller is not known" in text
    assert '# policy = "q_values"' in text
