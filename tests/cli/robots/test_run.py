"""`mdm run`: its log, its ends, and signals."""

from __future__ import annotations

import json
import signal
import subprocess
import sys

import in_process
import pytest
from patience import PATIENCE
from places import EXAMPLES
from programs import python


def test_run_in_virtual_time(mdm):
    status, _, errors = mdm("run", EXAMPLES / "tiger.toml", "--virtual", "--epochs", "5", "--log", "json")
    assert status == 0
    records = [json.loads(line) for line in errors.splitlines()]
    assert sum(record["event"] == "decision" for record in records) == 5
    assert records[-1]["event"] == "stopped"


def test_virtual_time_ends_in_order_when_nothing_is_left_to_do(tmp_path):
    (tmp_path / "lazy_robot.py").write_text(
        "async def go():\n    print('go')\n    try:\n        import asyncio; await asyncio.Event().wait()\n"
        "    finally:\n        print('ended')\ndef safe():\n    print('safe')\n"
    )
    (tmp_path / "robot.toml").write_text(
        "[predicates]\nA = { initial = true }\n[ensembles.robot]\npolicy = [0, 0]\nsafe_action = 'lazy_robot:safe'\n"
        "[ensembles.robot.states]\na = ['A']\n[ensembles.robot.actions]\nGo = 'lazy_robot:go'\n"
    )
    command = [
        sys.executable,
        "-m",
        "mdm",
        "run",
        str(tmp_path / "robot.toml"),
        "--virtual",
        "--log",
        "json",
        "--debug",
    ]
    first = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    assert first.returncode == 0
    assert first.stdout == "go\nended\nsafe\n"
    *records, said = first.stderr.splitlines()
    assert said == "mdm run: ended, because no timer is pending and no input can come"
    stopped = [record["actor"] for record in map(json.loads, records) if record["event"] == "stopped"]
    assert stopped == ["robot/state", "robot/control", "robot/action", "robot", "predicates"]
    assert in_process.mdm(*command[3:]) == (0, first.stdout, first.stderr)


def test_decisions_of_an_ensemble_that_a_task_starts_are_logged(mdm, tmp_path):
    (tmp_path / "late_robot.py").write_text(
        "import mdm\ndef go(): ...\nasync def add(system):\n"
        "    late = mdm.Ensemble('late', policy=[0, 0], actions={'go': go})\n"
        "    await system.runtime.start(late)\n    late.publish_state(1)\n"
    )
    (tmp_path / "robot.toml").write_text(
        "tasks = ['late_robot:add']\n[predicates]\nA = { initial = true }\n[ensembles.robot]\npolicy = [0, 0]\n"
        "[ensembles.robot.states]\na = ['A']\n[ensembles.robot.actions]\nGo = 'late_robot:go'\n"
    )
    status, _, errors = mdm("run", tmp_path / "robot.toml", "--virtual", "--seconds", "1", "--log", "json")
    assert status == 0, errors
    records = [json.loads(line) for line in errors.splitlines() if line.startswith("{")]
    told = {record["ensemble"]: record["state"] for record in records if record["event"] == "decision"}
    assert told == {"robot": "A", "late": 1}


ROBOT = """
import asyncio, sys
async def drive():
    print("driving", flush=True)
    try:
        await asyncio.sleep(3600)
    finally:
        await asyncio.sleep(0.01)
        print("brakes", flush=True)
def safe():
    print("safe", flush=True)
"""


BACKGROUND = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.SIG_IGN)
os.execv(sys.executable, [sys.executable, *sys.argv[1:]])
"""
"""Start Python as POSIX shells start what is in their background, where they are no terminal's (`sh`, 2.11)."""


@pytest.mark.parametrize(
    ("start", "number", "status"),
    [((), signal.SIGINT, 130), ((), signal.SIGTERM, 143), (("-c", BACKGROUND), signal.SIGINT, 130)],
    ids=["Ctrl-C", "SIGTERM", "Ctrl-C in the background"],
)
def test_signals_end_the_action_and_run_the_safe_one(tmp_path, number, status, start):
    (tmp_path / "signal_robot.py").write_text(ROBOT)
    (tmp_path / "robot.toml").write_text(
        "[predicates]\nA = { initial = true }\n[ensembles.robot]\npolicy = [0, 0]\nsafe_action = 'signal_robot:safe'\n"
        "[ensembles.robot.states]\na = ['A']\n[ensembles.robot.actions]\nDrive = 'signal_robot:drive'\n"
    )
    with python(*start, "-m", "mdm", "run", tmp_path / "robot.toml", "--log", "json") as process:
        assert process.stdout.readline() == "driving\n"
        process.send_signal(number)
        output, errors = process.communicate(timeout=PATIENCE)
    assert output == "brakes\nsafe\n"
    assert process.returncode == status
    records = [json.loads(line) for line in errors.splitlines()]
    assert records[-1]["event"] == "stopped"


@pytest.mark.parametrize(
    ("number", "status"), [(signal.SIGINT, 130), pytest.param(signal.SIGTERM, 143, marks=pytest.mark.slow)]
)
def test_an_action_that_never_ends_keeps_no_signal_from_ending_the_program(tmp_path, number, status):
    (tmp_path / "stubborn_robot.py").write_text(
        "import asyncio\nasync def drive():\n    print('driving', flush=True)\n    while True:\n        try:\n"
        "            await asyncio.sleep(3600)\n        except asyncio.CancelledError:\n            pass\n"
        "def safe():\n    print('safe', flush=True)\n"
    )
    (tmp_path / "robot.toml").write_text(
        "[predicates]\nA = { initial = true }\n"
        "[ensembles.robot]\npolicy = [0, 0]\nsafe_action = 'stubborn_robot:safe'\n"
        "[ensembles.robot.states]\na = ['A']\n"
        "[ensembles.robot.actions]\nDrive = { call = 'stubborn_robot:drive', grace = 0.1 }\n"
    )
    with python("-m", "mdm", "run", tmp_path / "robot.toml", "--log", "json") as process:
        assert process.stdout.readline() == "driving\n"
        process.send_signal(number)
        output, errors = process.communicate()
    assert (process.returncode, output) == (status, "safe\n")
    records = [json.loads(line) for line in errors.splitlines()]
    assert [record["detail"] for record in records if record["event"] == "fault"] == [
        "action 'Drive' abandoned: did not end within 0.1 s of being cancelled",
        "action 'safe action' begins while 'Drive', abandoned, still runs",
    ]
    assert records[-1]["event"] == "stopped"


def test_a_failing_system_exits_with_1_after_the_safe_action(tmp_path):
    (tmp_path / "failing_robot.py").write_text(
        "async def live(system):\n    raise ValueError('sensor unplugged')\ndef stay():\n    print('safe')\n"
    )
    (tmp_path / "robot.toml").write_text(
        "tasks = ['failing_robot:live']\n[predicates]\nA = { initial = true }\n[ensembles.robot]\npolicy = [0, 0]\n"
        "safe_action = 'Stay'\n[ensembles.robot.states]\na = ['A']\n"
        "[ensembles.robot.actions]\nStay = 'failing_robot:stay'\n"
    )
    done = in_process.mdm("run", tmp_path / "robot.toml")
    assert done.status == 1
    assert done.output == "safe\nsafe\n"
    assert done.errors.splitlines()[-1].startswith("mdm run: task 'live' failed: ValueError: sensor unplugged (at ")
    assert "Traceback" not in done.errors
    (told,) = [line for line in done.errors.splitlines() if " fault " in line and "sensor unplugged" in line]
    assert "source=tasks/live kind=task" in told
    assert told.count("(at ") == 1
    assert "failing_robot.py:2)" in told


@pytest.mark.parametrize(
    ("code", "status", "last"),
    [
        ("raise ValueError('no arm')", 1, "mdm run: every action that was decided and ended has failed: 3"),
        ("calls.append(1)\n    if len(calls) != 2:\n        raise ValueError('no arm')", 0, None),
    ],
)
def test_a_robot_whose_every_action_fails_does_not_end_well(mdm, tmp_path, code, status, last):
    module = f"acting_robot_{status}"
    (tmp_path / f"{module}.py").write_text(f"calls = []\ndef listen():\n    {code}\n")
    for name in ("tiger.pomdp", "tiger.vf"):
        (tmp_path / name).write_text((EXAMPLES / name).read_text())
    actions = "\n".join(f"{name} = '{module}:listen'" for name in ("listen", "open-left", "open-right"))
    path = tmp_path / "robot.toml"
    path.write_text(
        "[ensembles.robot]\nmodel = 'tiger.pomdp'\npolicy = 'tiger.vf'\ndrive = 1.0\n"
        f"[ensembles.robot.actions]\n{actions}"
    )
    found, _, errors = mdm("run", path, "--virtual", "--epochs", "3")
    assert found == status
    assert (errors.splitlines()[-1] == last) == (status == 1)


def test_the_safe_action_of_a_robot_whose_every_action_fails_is_no_success(mdm, tmp_path):
    (tmp_path / "failing_arm.py").write_text("def fail():\n    raise ValueError('no arm')\ndef stop():\n    pass\n")
    path = tmp_path / "robot.toml"
    path.write_text(
        "[predicates]\nA = { initial = true }\n"
        "[ensembles.robot]\npolicy = [0, 1]\nsafe_action = 'failing_arm:stop'\n"
        "[ensembles.robot.states]\na = ['A']\n"
        "[ensembles.robot.actions]\nGo = 'failing_arm:fail'\nStay = 'failing_arm:fail'\n"
    )
    found, _, errors = mdm("run", path, "--virtual", "--seconds", "60")
    assert found == 1
    assert errors.splitlines()[-1] == "mdm run: every action that was decided and ended has failed: 1"


def test_the_emergency_of_a_file_is_called_while_an_action_holds_the_loop(tmp_path):
    (tmp_path / "held_robot.py").write_text(
        "import threading\ncut = threading.Event()\n"
        "def hold():\n    print('held', cut.wait(60), flush=True)\n"
        "def cut_motors():\n    print('cut', flush=True)\n    cut.set()\n"
    )
    (tmp_path / "robot.toml").write_text(
        "emergency = 'held_robot:cut_motors'\n"
        "[predicates]\nA = { initial = true }\n[ensembles.robot]\npolicy = [0, 0]\n"
        "[ensembles.robot.states]\na = ['A']\n[ensembles.robot.actions]\nHold = 'held_robot:hold'\n"
    )
    command = [sys.executable, "-m", "mdm", "run", str(tmp_path / "robot.toml"), "--epochs", "1"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    assert (done.returncode, done.stdout) == (0, "cut\nheld True\n"), done.stderr


def test_a_signal_releases_what_is_safe(tmp_path):
    (tmp_path / "released_robot.py").write_text(
        "tries = []\n"
        "def drive():\n    tries.append(1)\n    if len(tries) == 1:\n        raise ValueError('stuck')\n"
        "    print('drives', flush=True)\n"
        "def stay():\n    print('safe', flush=True)\n"
    )
    (tmp_path / "robot.toml").write_text(
        "[predicates]\nA = { initial = true }\n[ensembles.robot]\npolicy = [0, 0]\n"
        "safe_action = 'released_robot:stay'\n[ensembles.robot.states]\na = ['A']\n"
        "[ensembles.robot.actions]\nDrive = 'released_robot:drive'\n"
    )
    with python("-m", "mdm", "run", tmp_path / "robot.toml", "--epochs", "2") as process:
        assert process.stdout.readline() == "safe\n"
        process.send_signal(signal.SIGUSR1)
        assert process.communicate(timeout=PATIENCE)[0] == "drives\nsafe\n"
    assert process.returncode == 0


def test_a_robot_that_has_nothing_to_do_says_so_in_words(mdm, tmp_path):
    (tmp_path / "resting_robot.py").write_text("import asyncio\nasync def go():\n    await asyncio.sleep(2)\n")
    (tmp_path / "robot.toml").write_text(
        "[predicates]\nA = { initial = true }\n[ensembles.robot]\npolicy = [0, 0]\nstates.a = ['A']\n"
        "[ensembles.robot.actions]\nGo = 'resting_robot:go'\n"
    )
    status, _, errors = mdm("run", tmp_path / "robot.toml", "--virtual", "--seconds", "60", "--log", "json")
    faults = [record for record in map(json.loads, errors.splitlines()) if record["event"] == "fault"]
    assert status == 0
    assert [(fault["time"], fault["source"], fault["kind"], fault["detail"]) for fault in faults] == [
        (12.0, "robot", "idle", "idle for 10 s: action 'Go' succeeded, and nothing has been decided since")
    ]


def test_options_of_a_page_and_of_quiet_that_contradict_others_are_refused(mdm, tmp_path):
    from shown import a_robot

    file = a_robot(tmp_path)
    for options, words in (
        (["--page-control"], "--page-control is for a page"),
        (["--page-host", "0.0.0.0"], "--page-host is for a page"),
        (["--page-access", tmp_path / "robot"], "--page-access is for a page"),
        (["--page", "--page-access", tmp_path], "FOLDER/NAME was expected"),
        (["--page", "--page-access", ""], "FOLDER/NAME was expected"),
        (["--quiet", "--why"], "which --quiet leaves out"),
        (["--page", "70000"], "a port, up to 65535"),
    ):
        status, _, errors = mdm("run", file, *options)
        assert status == 2
        assert words in errors
    status, _, errors = mdm("run", file, "--page", "0", "--virtual")
    assert status == 1
    assert "a page needs real time" in errors
    for options, words in (
        (["--page-host", "0.0.0.0"], "a page for other machines needs TLS"),
        (["--page-host", ""], "a page's host is a name or an address"),
        (["--page-access", tmp_path / "nobody"], "cannot read"),
    ):
        status, _, errors = mdm("run", file, "--page", "0", *options)
        assert status == 1
        assert words in errors
        assert errors.count("\n") == 1
    assert mdm("run", file, "--virtual", "--epochs", "3", "--quiet") == (0, [], "")
