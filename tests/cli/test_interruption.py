"""Ctrl-C, SIGTERM and SIGHUP: what was known by then is printed or kept, and the exit status tells of it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading

import pytest
from patience import PATIENCE
from places import EXAMPLES, ROOT, TIGER, TIGER_VECTORS

from mdm import load_policy, save_model, save_policy
from mdm.cli.interruption import Interruption
from mdm.cli.progress import ProgressLine
from mdm.problems import hallway

SIGNALS = [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)]


@pytest.fixture(autouse=True)
def hang_ups():
    """Have a hang-up end a program, as it does where nohup has not started the tests."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.fixture
def interrupts(monkeypatch):
    """Have signals come when progress is told for the n-th time."""

    def at(count, number, times=1):
        told = []

        def tell(self, seconds, text_of):
            told.append(text_of())
            if len(told) == count:
                for _ in range(times):
                    signal.raise_signal(number)

        monkeypatch.setattr(ProgressLine, "tell", tell)
        return told

    return at


@pytest.mark.parametrize(("number", "status"), SIGNALS)
def test_a_signal_is_noted_alone(number, status):
    before = [signal.getsignal(each) for each, _ in SIGNALS]
    interruption = Interruption()
    with interruption.deferred():
        assert not interruption.asked()
        signal.raise_signal(number)
        assert interruption.asked()
        assert (interruption.number, interruption.status) == (number, status)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
    assert [signal.getsignal(each) for each, _ in SIGNALS] == before


@pytest.mark.parametrize(("number", "status"), SIGNALS)
def test_while_there_is_nothing_worth_having_a_signal_ends_all(number, status):
    interruption = Interruption()
    with interruption.deferred():
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
        assert (interruption.asked(), interruption.status) == (True, status)  # whoever swallows it is told again


def test_handlers_of_others_stay(monkeypatch):
    heard = []
    for number, _ in SIGNALS:
        before = signal.signal(number, lambda found, _: heard.append(found))
        try:
            with Interruption().deferred():
                signal.raise_signal(number)
        finally:
            signal.signal(number, before)
    assert heard == [number for number, _ in SIGNALS]


def test_other_threads_have_no_signals():
    entered = []

    def enter():
        with Interruption().deferred():
            entered.append(signal.getsignal(signal.SIGTERM))

    thread = threading.Thread(target=enter)
    thread.start()
    thread.join()
    assert entered == [signal.getsignal(signal.SIGTERM)]


@pytest.mark.parametrize(("number", "status"), SIGNALS)
def test_an_evaluation_tells_what_it_knows(mdm, interrupts, number, status):
    told = interrupts(500, number)  # an episode has 270 steps at most: in the second part
    found, output, errors = mdm("evaluate", TIGER, TIGER_VECTORS, "--seed", "1")
    assert (found, errors) == (status, "")
    assert any(line.startswith("simulated value     19.") for line in output)
    assert any("1000 episodes of" in line for line in output)
    assert output[-1].startswith("interrupted ")
    assert len(told) == 500
    assert told[-1].split("  about ")[0].endswith(" of 10000 episodes")


def test_an_evaluation_of_no_episode_says_so(mdm, interrupts):
    interrupts(3, signal.SIGINT)
    status, output, _ = mdm("evaluate", TIGER, TIGER_VECTORS)
    assert status == 130
    assert "simulated value     none: no episode has ended" in output
    interrupts(3, signal.SIGINT)
    status, output, _ = mdm("evaluate", TIGER, TIGER_VECTORS, "--json")
    facts = json.loads(output[0])
    assert (status, facts["interrupted"], facts["episodes"], facts["mean"]) == (130, True, 0, None)


def test_a_second_signal_ends_at_once(mdm, interrupts):
    interrupts(3, signal.SIGINT, times=2)
    assert mdm("evaluate", TIGER, TIGER_VECTORS) == (130, [], "")


def test_a_comparison_tells_what_it_knows(mdm, interrupts):
    arguments = ("compare", TIGER, TIGER_VECTORS, TIGER_VECTORS, TIGER_VECTORS, "--episodes", "2000", "--seed", "1")
    interrupts(1000, signal.SIGINT)
    status, output, _ = mdm(*arguments)
    assert status == 130
    assert [str(TIGER_VECTORS) in line for line in output] == [False, True, True, False, False]
    assert output[-1].startswith("interrupted: the last policy above has 1000 episodes")
    told = interrupts(600, signal.SIGTERM)
    status, output, _ = mdm(*arguments, "--json")
    rows = json.loads(output[0])
    assert (status, [row["interrupted"] for row in rows]) == (143, [True, True])
    assert "policy 2 of 3  " in told[-1]


@pytest.mark.parametrize(("number", "status"), SIGNALS)
def test_a_simulation_ends_after_its_episode(mdm, interrupts, number, status):
    interrupts(7, number)
    arguments = ("simulate", EXAMPLES / "tiger.toml", "--seed", "1")
    found, output, _ = mdm(*arguments)
    assert found == status
    assert "7 episodes of" in output[0]
    assert output[1] == "interrupted: this is of 7 episodes, not of 100"
    assert mdm("simulate", EXAMPLES / "tiger.toml", "--seed", "1", "--episodes", "7")[1] == output[:1]


@pytest.mark.parametrize(("number", "status"), SIGNALS)
@pytest.mark.parametrize("count", [1, 5])
def test_a_solver_keeps_the_best_so_far(mdm, interrupts, tmp_path, number, status, count):
    interrupts(count, number)
    policy = tmp_path / "tiger.vf"
    found, output, errors = mdm("solve", TIGER, "-o", policy, "--gap", "0")
    assert (found, errors) == (status, "")
    assert any(line.startswith("stopped             interrupted: this is the best so far") for line in output)
    assert load_policy(policy).value([0.5, 0.5]) > -21


def test_what_ctrl_c_has_become_while_modules_are_loaded_is_no_error(mdm, monkeypatch):
    def load(*_, **__):
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt:
            raise ImportError("numpy failed to load") from None

    monkeypatch.setattr("mdm.cli.policies.evaluate.load", load)
    assert mdm("evaluate", TIGER, TIGER_VECTORS) == (130, [], "")


def test_an_error_in_its_own_context_is_told(mdm, monkeypatch):
    def load(*_, **__):
        try:
            raise OSError("disk")
        except OSError as error:
            try:
                raise ValueError("behind") from error
            except ValueError as behind:
                raise behind.__cause__ from None

    monkeypatch.setattr("mdm.cli.policies.evaluate.load", load)
    status, output, errors = mdm("evaluate", TIGER, TIGER_VECTORS)
    assert (status, output, errors) == (1, [], "mdm evaluate: disk\n")


@pytest.mark.parametrize(("number", "status"), SIGNALS)
def test_a_policy_is_kept_whole_by_whom_the_signal_finds_writing_it(mdm, monkeypatch, tmp_path, number, status):
    def save(*arguments):
        signal.raise_signal(number)
        save_policy(*arguments)

    monkeypatch.setattr("mdm.cli.policies.solve.save_policy", save)
    monkeypatch.setattr(ProgressLine, "tell", lambda *_: None)  # which a busy machine is slow enough for
    policy = tmp_path / "tiger.vf"
    found, output, errors = mdm("solve", TIGER, "-o", policy)
    assert (found, errors) == (status, "")
    assert "kept in" in output[-1]
    assert load_policy(policy).value([0.5, 0.5]) > 19.3


@pytest.mark.slow
def test_a_policy_is_kept_where_the_terminal_has_gone(tmp_path):
    save_model(hallway(), tmp_path / "hallway.pomdp")
    ours, theirs = os.openpty()
    command = [sys.executable, "-m", "mdm", "solve", tmp_path / "hallway.pomdp", "-o", tmp_path / "hallway.vf"]
    environment = {**os.environ, "MDM_COMPILE": "0"}  # which takes long to load
    with subprocess.Popen([*command, "--gap", "0"], stdout=theirs, stderr=theirs, cwd=ROOT, env=environment) as process:
        os.close(theirs)
        told = b""
        while b"iteration" not in told:  # before, it has nothing worth having
            told += os.read(ours, 4096)
        os.close(ours)
        process.send_signal(signal.SIGHUP)
    assert process.returncode != 0
    assert load_policy(tmp_path / "hallway.vf").value(hallway().initial_belief) > 0


def test_ctrl_c_behind_a_robot_s_end_does_not_take_the_place_of_the_signal_that_ended_it(tmp_path):
    (tmp_path / "ending.py").write_text("import os, signal\ndef end(): os.kill(os.getpid(), signal.SIGTERM)\n")
    file = tmp_path / "robot.toml"
    file.write_text(
        "[predicates]\nReady = { initial = true }\n[ensembles.robot]\npolicy = [0, 0]\n"
        'states = { ready = ["Ready"] }\nactions = { End = "ending:end" }\n'
    )
    program = (
        "import atexit, os, sys\natexit.register(os.kill, os.getpid(), 2)\n"  # the first registered is the last called
        f"sys.argv = ['mdm', 'run', {str(file)!r}]\nfrom mdm.__main__ import main\nsys.exit(main())"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=PATIENCE, cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert (ended.returncode, "Traceback" in ended.stderr) == (143, False), ended.stderr
