"""``mdm page``: a record on a page, by a process of its own."""

from __future__ import annotations

import asyncio
import http.client
import signal
import socket
import subprocess
import sys

import pytest
from shown import a_robot

import mdm
from mdm.testing import run_virtual

pytest.importorskip("websockets")


@pytest.fixture
def record(tmp_path):
    async def run(runtime):
        await runtime.start(mdm.load_system(a_robot(tmp_path)))
        await asyncio.sleep(10)

    run_virtual(run, record=tmp_path / "run.mcap")
    return tmp_path / "run.mcap"


def test_a_record_is_served_until_it_is_interrupted(record):
    command = [sys.executable, "-m", "mdm", "page", str(record), "--port", "0"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as served:
        address = served.stderr.readline().removeprefix("page: ").strip()
        port = int(address.split(":")[2].split("/")[0])
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
        connection.request("GET", "/" + address.split("/", 3)[3])
        answer = connection.getresponse()
        assert answer.status == 303
        connection.close()
        served.send_signal(signal.SIGINT)
        assert served.wait(20) == 130


def test_bad_input_is_a_sentence(record, tmp_path):
    def told(*arguments):
        command = [sys.executable, "-m", "mdm", "page", *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
        assert "Traceback" not in done.stderr
        return done.returncode, done.stderr

    assert told(tmp_path / "nothing.mcap")[0] == 1
    (tmp_path / "text.mcap").write_text("no record")
    assert told(tmp_path / "text.mcap")[0] == 1
    assert told(record, "--port", "70000")[0] == 2
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        status, text = told(record, "--port", port, "--no-replay")
        assert status == 1
        assert f"port {port} is in use" in text
