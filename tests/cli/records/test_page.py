"""``mdm page``: a record on a page, by a process of its own."""

from __future__ import annotations

import asyncio
import http.client
import json
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
from contextlib import closing, contextmanager
from types import SimpleNamespace

import blocks
import in_process
import pytest
from records import PATIENCE, Writing, decision
from shown import a_robot

import mdm
from mdm.cli import make_parser
from mdm.cli.records.page import paths_of
from mdm.team.transport.certificates import make_certificates
from mdm.testing import run_virtual
from mdm.views.web.client import opened

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
        assert get(address).status == 303
        served.send_signal(signal.SIGINT)
        assert served.wait(PATIENCE) == 130


def test_a_record_is_served_with_tls_to_other_machines(record, tmp_path):
    pytest.importorskip("cryptography")
    access = make_certificates(tmp_path / "keys", {"robot": ["127.0.0.1", "robot.test"]})["robot"]
    options = f"--host 0.0.0.0 --access {tmp_path}/keys/robot"

    async def scene(address):
        async with opened(address, authority=access.authority) as socket:
            return json.loads(await socket.receive())["scene"]

    with serving(tmp_path, f"mdm page {record.name} {options}") as address:
        assert address.startswith("https://robot.test:")
        assert asyncio.run(scene(address.replace("robot.test", "127.0.0.1")))["source"] == "record"


@pytest.mark.slow
def test_a_record_that_grows_is_shown_as_far_as_it_goes_when_the_page_is_loaded(tmp_path):
    growing = Writing(tmp_path / "run.mcap")

    def grow(*times):
        for time in times:
            growing.write("decisions", decision(1000 * time))
            growing.writer.drain(PATIENCE)
        while growing.writer.statistics().written < times[-1]:
            growing.writer.flush()

    async def scene(address):
        async with opened(address) as socket:
            return json.loads(await socket.receive())["scene"]

    grow(1, 2)
    with serving(tmp_path, "mdm page run.mcap") as address:
        first = asyncio.run(scene(address))
        assert first["last"] == 1.0
        assert "still being written" in first["remarks"][0]
        grow(3, 4, 5)
        second = asyncio.run(scene(address))
        assert second["last"] == 4.0
        growing.close()
        third = asyncio.run(scene(address))
        assert (third["last"], third.get("remarks")) == (4.0, [])


@contextmanager
def serving(folder, command):
    """Run a command that serves a page; yield the page's address."""
    environment = {**os.environ, "MDM_PAGE_TOKEN": "secret" * 8}
    command = [
        sys.executable,
        "-m",
        *shlex.split(command),
        *(["--port", "0"] if command.startswith("mdm page") else ["0"] if command.endswith("--page") else []),
    ]
    with subprocess.Popen(command, cwd=folder, stderr=subprocess.PIPE, text=True, env=environment) as served:
        try:
            lines = iter(served.stderr.readline, "")
            yield next(line for line in lines if "page: " in line).split("page: ")[1].strip()
        finally:
            served.send_signal(signal.SIGINT)
            served.stderr.read()
        assert served.wait(60) == 130


@pytest.mark.slow
def test_the_commands_of_page_md_show_a_run(record, tmp_path):
    """Those that the page names, at ports that are free; what is for a terminal is printed once."""
    pytest.importorskip("rich")
    a_robot(tmp_path).rename(tmp_path / "robot.toml")
    serve, _, watch = commands_of_page_md()
    assert [line.split()[1] for line in (*serve, *watch)] == ["run", "page", "watch", "watch"]
    run, page = serve
    live, recorded = watch
    with serving(tmp_path, run) as address:
        assert get(address).status == 303
        status, told, errors = once(tmp_path, re.sub(r"'http[^']*'", address, live))
        assert (status, errors) == (0, "")
        assert "top/walk" in told
    with serving(tmp_path, page) as address:
        assert get(address).status == 303
        assert once(tmp_path, f"mdm watch {address}") == (
            1,
            "",
            "mdm watch: this page shows a record: watch its file, mdm watch run.mcap\n",
        )
    status, told, errors = once(tmp_path, recorded)
    assert (status, errors) == (0, "")
    assert "top/walk" in told


def commands_of_page_md():
    """Return the commands of each block of docs/page.md that is checked here."""
    return (
        [line for line in block.text.splitlines() if line.startswith("mdm")]
        for block in blocks.blocks("docs/page.md")
        if block.info.get("checked") == "tests/cli/records/test_page.py"
    )


@pytest.mark.slow
def test_the_commands_of_page_md_open_a_page_to_other_machines(record, tmp_path):
    """Those for a robot and its record; what a team does is in tests/cli/team/test_up.py."""
    pytest.importorskip("rich")
    pytest.importorskip("cryptography")
    a_robot(tmp_path).rename(tmp_path / "robot.toml")
    make_certificates(tmp_path / "certificates", {"robot": ["127.0.0.1"]})
    _, others, _ = commands_of_page_md()
    assert [line.split()[1] for line in others] == ["run", "team", "team", "page", "watch"]
    for words in map(shlex.split, others):
        make_parser(words[1:2]).parse_args(words[1:])
    run, _, _, page, watch = (line.replace("robot.local", "127.0.0.1") for line in others)
    with serving(tmp_path, run.replace("--page ", "--page 0 ")) as address:
        assert address.startswith("https://127.0.0.1:")
        status, told, errors = once(tmp_path, re.sub(r"'http[^']*'", address, watch))
        assert (status, errors) == (0, "")
        assert "top/walk" in told
    with serving(tmp_path, page) as address:
        assert address.startswith("https://127.0.0.1:")


def once(folder, command):
    """Print what a terminal shows; return the exit status, what is printed, and the errors."""
    return in_process.mdm(*shlex.split(command)[1:], "--once", folder=folder)


def get(address):
    """Return the answer of a page's server."""
    connection = http.client.HTTPConnection("127.0.0.1", int(address.split(":")[2].split("/")[0]), timeout=PATIENCE)
    with closing(connection):
        connection.request("GET", "/" + address.split("/", 3)[3])
        return connection.getresponse()


def test_bad_input_is_a_sentence(record, tmp_path):
    def told(*arguments):
        status, _, errors = in_process.mdm("page", *arguments)
        assert "Traceback" not in errors
        return status, errors

    assert told(tmp_path / "nothing.mcap")[0] == 1
    (tmp_path / "text.mcap").write_text("no record")
    assert told(tmp_path / "text.mcap")[0] == 1
    assert told(record, "--port", "70000")[0] == 2
    assert told(record, "--access", tmp_path)[0] == 2
    for options, words in (
        (["--host", "0.0.0.0"], "a page for other machines needs TLS"),
        (["--access", tmp_path / "nobody"], "cannot read"),
    ):
        status, text = told(record, *options)
        assert (status, text.count("\n")) == (1, 1)
        assert words in text
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        status, text = told(record, "--port", port, "--no-replay")
        assert status == 1
        assert f"port {port} is in use" in text


def test_a_folder_of_records_is_watched_and_shown_together(tmp_path, record):
    folder = tmp_path / "team"
    folder.mkdir()
    for name in ("one", "two"):
        (folder / f"{name}.mcap").write_bytes(record.read_bytes())
    done = in_process.mdm("watch", folder, "--once")
    assert (done.status, done.errors.count("both have an ensemble 'top'")) == (1, 1)
    (folder / "two.mcap").unlink()
    done = in_process.mdm("watch", folder, "--once")
    assert done.status == 0
    assert "top/walk" in done.output


def test_of_two_runs_of_an_agent_in_a_folder_none_is_left_out(tmp_path, monkeypatch):
    named = [SimpleNamespace(head={"agent": "ada"}, path=tmp_path / name) for name in ("ada.mcap", "ada.2.mcap")]
    monkeypatch.setattr("mdm.cli.records.page.records_of", lambda _: {each.path.name: each for each in named})
    assert list(paths_of(tmp_path).values()) == [each.path for each in named]


def test_a_later_start_of_an_agent_is_named_beside_its_first(tmp_path, record):
    folder = tmp_path / "team"
    folder.mkdir()
    for name in ("ada", "ada.2"):
        (folder / f"{name}.mcap").write_bytes(record.read_bytes())
    assert [*paths_of(folder)] == ["ada", "ada.2"]  # though the other file comes first in the folder
    done = in_process.mdm("watch", folder, "--once")
    assert (done.status, "ada: a later start is in ada.2.mcap, which is shown alone" in done.output) == (0, True)


@pytest.mark.parametrize(
    ("options", "status", "told"),
    [
        (("--port", 8800), 2, "--output writes a file"),
        (("--access", "certificates/robot"), 2, "--output writes a file"),
        (("--from", 5, "--to", 2), 2, "--from 5 is after --to 2"),
        (("--from", 5000, "--no-replay"), 1, "before --from 5000"),
    ],
)
def test_what_a_file_of_a_page_cannot_be_is_refused(tmp_path, record, options, status, told):
    done = in_process.mdm("page", record, "-o", tmp_path / "out.html", *options)
    assert (done.status, told in done.errors, (tmp_path / "out.html").exists()) == (status, True, False)


def test_the_page_is_written_to_one_file(tmp_path, record):
    out = tmp_path / "out.html"
    done = in_process.mdm("page", record, "-o", out, "--from", 2, "--to", 5, "--no-replay")
    assert (done.status, done.errors) == (0, "")
    assert out.read_bytes().startswith(b"<!doctype html>")
    assert in_process.mdm("page", record, "-o", record).status == 1
    assert in_process.mdm("page", record.parent, "-o", record).status == 1
    done = in_process.mdm("page", record, "--from", 2)
    assert (done.status, "--output" in done.errors) == (2, True)
