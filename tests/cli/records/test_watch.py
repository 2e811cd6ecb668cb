"""``mdm watch``, of a record and of a running system with its page."""

from __future__ import annotations

import asyncio
import os
import select
import subprocess
import sys
from collections import deque
from contextlib import asynccontextmanager

import msgspec
import pytest
from patience import PATIENCE
from served import shown
from shown import a_robot

import mdm
from mdm.cli import main
from mdm.policies import DeterministicPolicy
from mdm.snapshots import Detail, EnsembleFrame, Event, Frame, Scene
from mdm.snapshots.frame import EnsembleScene
from mdm.team.transport.certificates import make_certificates
from mdm.testing import run_virtual

pytest.importorskip("rich")
pytest.importorskip("websockets")


@pytest.fixture
def record(tmp_path):
    async def run(runtime):
        await runtime.start(mdm.load_system(a_robot(tmp_path)))
        await asyncio.sleep(30)

    run_virtual(run, record=tmp_path / "run.mcap")
    return tmp_path / "run.mcap"


def test_a_record_is_shown_at_a_second(record, capsys):
    assert main(["watch", str(record), "--once", "--at", "4.5"]) == 0
    out = capsys.readouterr().out
    assert "00:04.5 of 00:30.0" in out
    assert "▶ deciding" in out
    assert "top/walk" in out


def test_one_picture_says_that_a_record_is_torn(record, capsys):
    record.write_bytes(record.read_bytes()[:-3_000])
    assert main(["watch", str(record), "--once"]) == 0
    assert "Note: the record ends before its run did" in capsys.readouterr().out


def test_a_key_leads_to_where_something_first_looked_odd(tmp_path):
    """In a terminal of its own, whose screen another program than ours keeps."""
    pyte = pytest.importorskip("pyte")
    pty = pytest.importorskip("pty")
    spans = iter([2.0, 3.0, 2.0, 1e9])

    async def go():
        await asyncio.sleep(next(spans))

    robot = mdm.Ensemble(
        "robot", policy=DeterministicPolicy([0]), actions={0: mdm.Binding(go, then="decide", pause=0.2)}
    )

    async def run(runtime):
        await runtime.start(robot)
        robot.publish_state(0)
        await asyncio.sleep(60)

    run_virtual(run, record=tmp_path / "run.mcap")
    ours, theirs = pty.openpty()
    environment = os.environ | {"TERM": "xterm", "COLUMNS": "120", "LINES": "30"}
    command = [sys.executable, "-m", "mdm", "watch", str(tmp_path / "run.mcap")]
    screen = pyte.Screen(120, 30)
    stream = pyte.ByteStream(screen)

    def until(words):
        for _ in range(200):  # pictures, of which there are four a second
            if any(words in line for line in screen.display):
                return
            assert select.select([ours], [], [], 30)[0], screen.display
            stream.feed(os.read(ours, 65_536))
        raise AssertionError((words, screen.display))

    with subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs, env=environment) as process:
        try:
            until("00:00.0 of")
            os.write(ours, b"j")
            until("00:17.6 of")
            until("0 has lasted for more than 10 s")
            os.write(ours, b"j")
            until("no further judgement; space plays")
            os.write(ours, b"\x1b[CJ\x1b[Dq")  # at once, as of somebody who is quick
            while process.poll() is None:
                if select.select([ours], [], [], 0.1)[0]:
                    os.read(ours, 65_536)
        finally:
            process.kill()
    os.close(ours)
    os.close(theirs)
    assert process.returncode == 0


def test_a_running_system_is_shown_in_another_process():
    async def look(_, page):
        command = [sys.executable, "-m", "mdm", "watch", page.address, "--once"]
        return await asyncio.to_thread(
            subprocess.run, command, capture_output=True, text=True, check=False, timeout=PATIENCE
        )

    done = shown(look)
    assert (done.returncode, done.stderr) == (0, "")
    assert "● live" in done.stdout
    assert "listen" in done.stdout


def test_a_page_with_tls_is_watched_with_its_authority(tmp_path, capsys):
    pytest.importorskip("cryptography")
    robot = make_certificates(tmp_path, {"robot": ["127.0.0.1"]})["robot"]

    async def look(_, page):
        def watch(*options):
            return main(["watch", page.address, "--once", *map(str, options)]), *capsys.readouterr()

        return [await asyncio.to_thread(watch, *options) for options in (("--authority", robot.authority), ())]

    (status, output, errors), (refused, nothing, told) = shown(look, host="127.0.0.1", access=robot)
    assert (status, errors) == (0, "")
    assert "● live" in output
    assert (refused, nothing) == (1, "")
    assert "is not trusted" in told
    assert told.endswith("by --authority FILE\n")
    assert told.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "status", "told"),
    [
        (["https://127.0.0.1:1/?token=x", "--authority", "nowhere.pem"], 1, "cannot read nowhere.pem"),
        (["https://127.0.0.1:1/?token=x"], 1, "nothing answers at 127.0.0.1:1"),
        (["http://127.0.0.1:1/?token=x", "--authority", "authority.pem"], 2, "begins with https://"),
        (["run.mcap", "--authority", "authority.pem"], 2, "begins with https://"),
    ],
)
def test_an_authority_that_is_none_or_of_no_use_is_refused(arguments, status, told, capsys):
    assert main(["watch", *arguments]) == status
    assert told in capsys.readouterr().err


@pytest.mark.parametrize(
    ("url", "told"),
    [
        ("http://127.0.0.1:{port}/?token=another-token-of-some-kind", "refuses to be watched"),
        ("http://127.0.0.1:{port}/", "with its token"),
    ],
)
def test_what_a_page_does_not_show_is_a_sentence(url, told, capsys):
    status = []

    async def look(_, page):
        address = url.format(port=page.address.split(":")[2].split("/")[0])
        status.append(await asyncio.to_thread(main, ["watch", address, "--once"]))

    shown(look)
    errors = capsys.readouterr().err
    assert status[0] in {1, 2}
    assert told in errors
    assert "Traceback" not in errors


def test_where_nothing_answers_there_is_nothing_to_watch(capsys):
    assert main(["watch", "http://127.0.0.1:1/?token=x", "--once"]) == 1
    assert "nothing answers at 127.0.0.1:1" in capsys.readouterr().err


def test_one_picture_of_a_team_waits_for_all_agents_and_what_they_have_done(monkeypatch, capsys):
    old = [Event(number + 1, 0.5, "decision", "ada", "old") for number in range(1000)]
    told = deque()
    for agents, missing, events in (
        (("ada",), ("bob",), []),
        (("ada", "bob"), (), old),  # of which there are more
        (("ada", "bob"), (), [Event(1001, 0.9, "decision", "ada", "new")]),
    ):
        ensembles = tuple(EnsembleScene(agent, -1, "", "policy") for agent in agents)
        modes = tuple(EnsembleFrame("deciding", 0.0) for _ in agents)
        told.append({"scene": Scene("", "live", "rooms", 0, 0.0, 0.0, ensembles, ())})
        told.append(
            {
                "frame": Frame(1.0, modes, (), (), details={"ada": Detail()}, missing=missing),
                "events": events,
                "cursor": 0,
            }
        )

    class Page:
        async def receive(self):
            return msgspec.json.encode(told.popleft())

        async def say(self, message):
            pass

    @asynccontextmanager
    async def opened(url, *, authority):
        yield Page()

    monkeypatch.setattr("mdm.cli.records.watch.opened", opened)
    assert main(["watch", "http://robots.test/", "--once"]) == 0
    out = capsys.readouterr().out
    assert "bob" in out
    assert "new" in out
