"""The recipes of the page on addresses: containers with mapped ports, and a router, in network namespaces."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys

import blocks
import pytest
from patience import PATIENCE
from places import ROOT
from team_file import write

pytest.importorskip("zenoh")

PAGE = "docs/addresses.md"
MAPPED, ROUTED = blocks.texts(PAGE, "toml")
[ROUTER] = blocks.texts(PAGE, "python")
AGENTS = 'agents = ["a", "b"]\nport = 7600\n'
CODE = """
import asyncio

def stay():
    pass

go = stay

async def sense(system):
    for number in range(10**9):
        system.predicates.sense("InLab", number % 2 == 0)
        await asyncio.sleep(0.05)
"""


def within_namespaces(*words):
    """Run a program as root of namespaces of its own; skip the test where the machine does not allow them."""
    for tool in ("unshare", "ip", "mount"):
        if shutil.which(tool) is None:
            pytest.skip(f"there is no `{tool}`: apt-get install util-linux iproute2 mount")
    unshare = ["unshare", "--user", "--map-root-user", "--net", "--mount", "--pid", "--fork", "--kill-child"]
    made = "ip link add one type veth peer name other && mount -t tmpfs none /run"
    tried = subprocess.run([*unshare, "sh", "-c", made], capture_output=True, text=True, timeout=PATIENCE)
    if tried.returncode:
        pytest.skip(f"this machine allows no network namespaces: {tried.stderr.strip()}")
    done = subprocess.run(
        [*unshare, sys.executable, *map(str, words)],
        capture_output=True, text=True, timeout=3 * PATIENCE, check=False,
        env={**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'tests'}"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("way", ["mapped ports", "router", "router with certificates"])
def test_robots_meet_by_the_page_s_recipe(mdm, tmp_path, way):
    agents = MAPPED if way == "mapped ports" else ROUTED
    path = write(tmp_path, (AGENTS, agents))
    (tmp_path / "team_code.py").write_text(CODE)
    if way != "mapped ports":
        (tmp_path / "router.py").write_text(ROUTER)
    if way == "router with certificates":
        pytest.importorskip("cryptography", reason="the extra mdm[certificates]")
        path.write_text(path.read_text().replace('"tcp/10.79.9.1:7447"', '"tls/10.79.9.1:7447"\naccess = "keys"'))
        assert mdm("team", "certificates", path, "-o", tmp_path / "keys")[0] == 0
    status, told, errors = within_namespaces(ROOT / "tests" / "mapped_program.py", tmp_path)
    assert (status, errors) == (0, "")
    modes = {agent: one["joint"]["mode"] for agent, one in told["agents"].items()}
    assert modes == {"a": "deciding", "b": "deciding"}
    assert [one["joint"]["live"] for one in told["agents"].values()] == [["a", "b"]] * 2


@pytest.mark.parametrize("agents", [MAPPED, ROUTED])
def test_a_file_by_the_page_s_recipe_has_no_problems(mdm, tmp_path, agents):
    status, output, errors = mdm("team", "check", write(tmp_path, (AGENTS, agents)))
    assert (status, errors) == (0, "")
    assert any("can speak as any agent of the team" in line for line in output)
