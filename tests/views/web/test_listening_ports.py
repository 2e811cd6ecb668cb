"""Who listens at a port, with a real process that does."""

from __future__ import annotations

import socket
import subprocess
import sys
from pathlib import Path

import pytest

from mdm.views.web.listening import holder, in_use, next_free

LISTENS = """
import socket
listening = socket.socket()
listening.bind(("127.0.0.1", 0))
listening.listen()
print(listening.getsockname()[1], flush=True)
input()
"""


@pytest.fixture
def listening():
    with subprocess.Popen(
        [sys.executable, "-c", LISTENS], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        yield other, int(other.stdout.readline())
        other.stdin.close()


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="the system does not tell who listens")
def test_the_process_that_listens_is_named(listening):
    other, port = listening
    assert holder(port).endswith(f"(process {other.pid})")
    assert f"(process {other.pid})" in in_use(port)


def test_the_next_free_port_is_free(listening):
    _, port = listening
    free = next_free(port)
    assert free > port
    with socket.socket() as tried:
        tried.bind(("127.0.0.1", free))
    assert f"port {port} is in use" in in_use(port)


def test_nobody_listens_at_a_free_port():
    with socket.socket() as tried:
        tried.bind(("127.0.0.1", 0))
        port = tried.getsockname()[1]
        assert holder(port) is None  # bound, and not listening
    assert next_free(65_535) is None
