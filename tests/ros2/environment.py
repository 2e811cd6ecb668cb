"""An environment with rclpy, and programs that run in it, each test in a domain of its own.

rclpy's wheels are installed once in a run of the tests, by pip as it is configured; MDM_ROS_INDEX names another index,
and MDM_ROS_PYTHON an interpreter that has rclpy.
"""

from __future__ import annotations

import asyncio
import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys
import sysconfig
from contextlib import asynccontextmanager, contextmanager, suppress
from pathlib import Path

import pytest
from patience import PATIENCE
from peers import Peer
from places import ROOT
from ros2.nav2 import DEFINITIONS

WHEELS = [f"ros-kilted-{name}" for name in ("rclpy", "rmw-fastrtps-cpp", "common-interfaces", "test-msgs")]
HERE = Path(__file__).parent
DOMAINS = range(30, 60)
UDP = """<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns="http://www.eprosima.com">
  <transport_descriptors>
    <transport_descriptor>
      <transport_id>udp</transport_id>
      <type>UDPv4</type>
      <interfaceWhiteList><address>127.0.0.1</address></interfaceWhiteList>
    </transport_descriptor>
  </transport_descriptors>
  <participant profile_name="udp" is_default_profile="true">
    <rtps>
      <userTransports><transport_id>udp</transport_id></userTransports>
      <useBuiltinTransports>false</useBuiltinTransports>
    </rtps>
  </participant>
</profiles>
"""


@contextmanager
def alone(path):
    """Keep other processes out of what this lock guards."""
    with path.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def once(folder, name, make):
    """Make something in a folder, in one of the processes that share it; skip where it cannot be had.

    ``make`` is called with a path, and returns why it could not, or nothing.
    """
    made, said = folder / name, folder / f"{name}.said"
    with alone(folder / f"{name}.lock"):
        if not said.exists():
            said.write_text(make(made) or "")
    if why := said.read_text():
        pytest.skip(why)
    return made


def where_possible(main):
    """Run a program, or print why it cannot be run here."""
    try:
        main()
    except pytest.skip.Exception as why:
        sys.stdout.write(f"left out: {why}\n")


def installed(folder):
    """Install rclpy into an environment, or say why it cannot be had."""
    subprocess.run([sys.executable, "-m", "venv", folder], check=True)
    index = os.environ.get("MDM_ROS_INDEX")
    options = ["--quiet", "--disable-pip-version-check", *([] if index is None else ["--index-url", index])]
    done = subprocess.run([folder / "bin" / "python", "-m", "pip", "install", *options, *WHEELS], **TEXT)
    return done.returncode and f"rclpy's wheels cannot be had: {done.stderr.strip().rpartition(chr(10))[2]}"


def interpreter(folder):
    """Return an interpreter that has rclpy: the one that is given, or of an environment that is made in a folder."""
    if (given := os.environ.get("MDM_ROS_PYTHON")) is not None:
        return Path(given)
    return once(folder, "ros", installed) / "bin" / "python"


def generated(python):
    """Return how Nav2's actions are generated into a folder, or why they cannot be."""

    def make(folder):
        if None in (shutil.which("gcc"), shutil.which("g++")):
            return "messages of Nav2 are compiled by gcc and g++, which are not here"
        folder.mkdir()
        command = [python, HERE / "generate_program.py", "nav2_msgs", folder, json.dumps(DEFINITIONS)]
        done = subprocess.run(command, **TEXT)
        return done.returncode and f"messages of Nav2 cannot be generated here: {done.stderr}"

    return make


TEXT = {"capture_output": True, "text": True}


@contextmanager
def domain():
    """Give the number of a ROS domain that no other test of this machine has."""
    for number in DOMAINS:
        with Path("/tmp", f"mdm-ros-domain-{number}").open("w") as lock:  # of all, wherever their files are
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            yield number
            return
    pytest.fail("there is no free ROS domain")


class Program(Peer):
    """A process that takes and prints lines of JSON; what it says besides goes to a file, so that it never waits."""

    def __init__(self, process, said):
        super().__init__(process)
        self.said = said
        self.reading = None

    async def hear(self, *wanted, where=lambda event: True):
        """Return the next event that has one of these names; those before it are skipped."""
        async with asyncio.timeout(PATIENCE):
            async for event in self.lines():
                if any(name in event for name in wanted) and where(event):
                    return event
        status = await self.process.wait()
        raise AssertionError(f"the process ended with {status}; it said {self.heard[-20:]} and {self.said.read_text()}")

    async def lines(self):
        """Yield what it prints until its end."""
        while line := await self.process.stdout.readline():
            self.heard.append(json.loads(line))
            yield self.heard[-1]

    async def rest(self):
        """Return all that it has printed, at its end."""
        async with asyncio.timeout(PATIENCE):
            async for _ in self.lines():
                pass
        return self.heard


class Watched:
    """A program that is read all the time: what it has said may be looked back at."""

    def __init__(self, program):
        self.program, self.said = program, program.heard
        self._news = asyncio.Event()
        self._reading = program.reading = asyncio.create_task(self._read())

    async def _read(self):
        async for _ in self.program.lines():
            self._news.set()
        self._news.set()

    def tell(self, **command):
        self.program.tell(**command)

    def last(self, name):
        """Return the newest event that has this name, or None."""
        return next((event for event in reversed(self.said) if name in event), None)

    async def until(self, holds):
        """Wait until something holds of what was said."""
        try:
            async with asyncio.timeout(PATIENCE):
                while not holds():
                    if self._reading.done():
                        await self.program.process.wait()
                        raise AssertionError(f"the program has ended; {self}")
                    self._news.clear()
                    await self._news.wait()
        except TimeoutError:
            raise AssertionError(f"it was not said; {self}") from None

    def __str__(self):
        status = self.program.process.returncode
        return f"its status is {status}, it said {self.said[-20:]} and {self.program.said.read_text()}"

    async def says(self, *names, since=0, where=lambda event: True):
        """Wait until an event has one of these names, since so many were said; return it."""
        found = []

        def said():
            found[:] = [each for each in self.said[since:] if any(name in each for name in names) and where(each)]
            return found

        await self.until(said)
        return found[0]

    async def ended(self):
        """Wait for its end; return its exit status."""
        async with asyncio.timeout(PATIENCE):
            await self._reading
            return await self.program.process.wait()


class Domain:
    """Programs in a ROS domain of their own."""

    def __init__(self, python, number, folder, *paths):
        self.python, self.number, self.folder = python, number, folder
        ours = [folder, *paths, ROOT, ROOT / "tests", *{sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}]
        self.environment = {
            **os.environ,
            "PYTHONFAULTHANDLER": "1",
            "PYTHONPATH": os.pathsep.join(map(str, ours)),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_DOMAIN_ID": str(number),
            "ROS_LOG_DIR": str(folder / "logs"),
        }
        self._started = []

    def leave_shared_memory(self):
        """Have programs speak over UDP: killed amid Fast DDS's shared memory, one may hold up or silence the others.

        ROS' range LOCALHOST would add shared memory, whatever FASTDDS_BUILTIN_TRANSPORTS says: Fast DDS' own profile is
        this machine's alone, too.
        """
        profile = self.folder / "udp.xml"
        profile.write_text(UDP)
        options = {"FASTDDS_DEFAULT_PROFILES_FILE": str(profile), "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT"}
        self.environment.update(options)

    async def start(self, *arguments, **environment):
        """Start a program by the arguments of its interpreter."""
        pipe, said = asyncio.subprocess.PIPE, self.folder / f"said-{len(self._started)}.txt"
        with said.open("w") as file:
            process = await asyncio.create_subprocess_exec(
                *(self.python, *map(str, arguments)),
                stdin=pipe,
                stdout=pipe,
                stderr=file,
                limit=2**26,  # bytes of a line
                cwd=self.folder,
                env={**self.environment, **environment},
            )
        self._started.append(Program(process, said))
        return self._started[-1]

    async def peer(self, name="robot", **options):
        """Start a node that does what it is told: `peer_program.py`."""
        peer = await self.start(HERE / "peer_program.py", json.dumps({"name": name, **options}))
        await peer.hear("spins")
        return peer

    async def system(self, text, **environment):
        """Start a system of a TOML file with this text: `system_program.py`."""
        file = self.folder / "system.toml"
        file.write_text(text)
        system = await self.start(HERE / "system_program.py", file, **environment)
        await system.hear("runs")
        return system

    async def end(self):
        for program in self._started:
            if program.process.returncode is None:
                with suppress(ProcessLookupError):  # it has ended, and the loop has not heard of it
                    program.signal(signal.SIGCONT)
                    program.signal(signal.SIGKILL)
            if program.reading is None:
                await program.process.communicate()
            else:
                await program.reading
                await program.process.wait()


@asynccontextmanager
async def programs(python, folder, *paths):
    """Give a domain; programs that still run at the end are killed. ``paths`` have modules for them."""
    with domain() as number:
        here = Domain(python, number, folder, *paths)
        try:
            yield here
        finally:
            await here.end()
