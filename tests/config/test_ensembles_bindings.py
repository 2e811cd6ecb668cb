"""Actions of a file that code binds, and safe actions that are none of the model's."""

from __future__ import annotations

import asyncio
import sys

import pytest
from loading import written
from sentences import refused

from mdm import ConfigError, Ensemble, bind, load_system
from mdm.actors import Binding
from mdm.config import look_over
from mdm.config.functions import Lasting, Unseen
from mdm.testing import replay, run_virtual

CODE = """
import mdm

done = []
def stop():
    done.append("stop")
async def drive():
    done.append("drive")
Dock = mdm.bind(drive, timeout=7.0, may_succeed=True)
def park(model) -> mdm.Binding:
    done.append(model)
    return mdm.bind(drive, grace=1.5, group="wheels")
def plain() -> "Binding":
    return mdm.bind(stop, then="wait")
def broken() -> mdm.Binding:
    return stop
def failing() -> mdm.Binding:
    raise OSError("no wheels")
def asking(model, robot) -> mdm.Binding:
    ...
below = mdm.bind(mdm.Ensemble("below", policy=[0], actions={"X": stop}))
"""

FILE = """
[ensembles.robot]
policy = [0]
safe_action = { call = "binding_code:stop", grace = 0.5 }
[ensembles.robot.actions]
Go = "binding_code:Dock"
"""


@pytest.fixture
def code(folder):
    sys.modules.pop("binding_code", None)
    (folder / "binding_code.py").write_text(CODE)
    return folder


def robot(folder, text=FILE, load=load_system, **options):
    return load(written(folder, text, "robot.toml"), **options).ensembles["robot"]


def test_a_binding_is_used_as_it_is(code):
    (go,) = robot(code).action.bindings
    assert go is sys.modules["binding_code"].Dock
    assert (go.timeout, go.may_succeed) == (7.0, True)


@pytest.mark.parametrize(
    ("name", "facts"), [("park", (1.5, "wheels", None)), ("plain", (5.0, None, "wait")), ("Dock", (5.0, None, None))]
)
@pytest.mark.parametrize("where", ["action", "safe action"])
def test_a_function_that_says_so_makes_the_binding_once(code, name, facts, where):
    old = "binding_code:Dock" if where == "action" else "binding_code:stop"
    made = robot(code, FILE.replace(old, f"binding_code:{name}").replace(", grace = 0.5", ""))
    binding = made.action.bindings[0] if where == "action" else made.action.safe
    assert (binding.grace, binding.group, binding.sequel.then) == facts
    assert sys.modules["binding_code"].done == ([None] if name == "park" else [])


def test_the_maker_is_given_the_model(code):
    model = "discount: 0.9\nvalues: reward\nstates: 1\nactions: Go\nobservations: 1\nT: * identity\nO: * uniform\n"
    (code / "two.pomdp").write_text(model)
    text = FILE.replace("policy = [0]", 'model = "two.pomdp"\npolicy = [0]\ndiscount = 0.5')
    robot(code, text.replace("binding_code:Dock", "binding_code:park"))
    (model,) = sys.modules["binding_code"].done
    assert (model.discount, model.action_space.names) == (0.5, ("Go",))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"binding_code:Dock"', '{ call = "binding_code:Dock", timeout = 3.0, group = "wheels" }'),
        ('"binding_code:Dock"', '"binding_code:broken"'),
        ('"binding_code:Dock"', '"binding_code:failing"'),
        ('"binding_code:Dock"', '"binding_code:asking"'),
        ('"binding_code:Dock"', '"binding_code:below"'),
        ('"binding_code:Dock"', '"binding_code:done"'),
        ("[ensembles.robot]", 'tasks = ["binding_code:Dock"]\n[ensembles.robot]'),
        ("grace = 0.5", "timeout = 5.0"),
        ("grace = 0.5", "grace = -1"),
        ('{ call = "binding_code:stop", grace = 0.5 }', '{ ensemble = "robot" }'),
        ('{ call = "binding_code:stop", grace = 0.5 }', "{ grace = 1.0 }"),
        ('{ call = "binding_code:stop", grace = 0.5 }', "3"),
        ('{ call = "binding_code:stop", grace = 0.5 }', '{ way = "Up" }'),
        ('{ call = "binding_code:stop", grace = 0.5 }', '"binding_code:Dok"'),
    ],
)
def test_what_is_no_binding_or_has_options_beside_it_is_refused(code, old, new):
    assert old in FILE
    with refused(ConfigError):
        robot(code, FILE.replace(old, new))


def test_whoever_looks_imports_nothing_and_knows_no_kind(code):
    for name in ("Dock", "park", "plain"):
        (go,) = robot(code, FILE.replace(":Dock", f":{name}"), look_over).action.bindings
        assert type(go.target) is Unseen
    (go,) = robot(code, callbacks=False).action.bindings
    assert not isinstance(go.target, Lasting)
    assert "binding_code" not in sys.modules
    with refused(ConfigError):
        robot(code, FILE.replace(":Dock", ":Dokc"), look_over)


def test_a_safe_action_by_a_table_is_none_of_the_model_s_and_is_replayed(code):
    text = FILE.replace("binding_code:Dock", "binding_code:drive")

    async def main(runtime):
        made = robot(code, text)
        system = made.parent
        await runtime.start(system)
        made.publish_state(0)
        await asyncio.sleep(0.1)
        made.safety.endanger("mine", "", 0)
        await asyncio.sleep(1)
        return made

    made = run_virtual(main, record=code / "run.mcap")
    assert made.action.safe not in made.action.bindings
    assert made.action.safe.grace == 0.5
    assert sys.modules["binding_code"].done == ["drive", "stop", "stop"]  # in the safe mode, and as the last word
    assert replay(code / "run.mcap", config=code / "robot.toml") == 1


def test_python_takes_a_binding_as_the_safe_action():
    safe = bind(lambda: None, grace=0.25)
    made = Ensemble("robot", policy=[0], actions={"Go": print}, safe_action=safe)
    assert made.action.safe is safe
    below = Ensemble("below", policy=[0], actions={"Go": print})
    with refused(ConfigError):
        Ensemble("robot", policy=[0], actions={"Go": print}, safe_action=Binding(below))
