"""Tables of extensions in a file: whose reader reads them, and the entries that have its keys."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import tomllib
from importlib.metadata import EntryPoint
from typing import ClassVar

import pytest
import team_file
from loading import written
from sentences import refused

import mdm
from mdm import ConfigError, Error, Extension, bind, load_system
from mdm.config import TableReader, look_over
from mdm.config.functions import Lasting
from mdm.testing import replay, run_virtual

FILE = """
[radio]
channel = 7

[predicates]
Warm = { station = "/warm", max_age = 5.0 }

[events]
Rang = { station = "/bell" }

[ensembles.robot]
policy = [0, 1]
safe_action = "Rest"

[ensembles.robot.states]
warm = ["Warm"]

[ensembles.robot.actions]
Rest = { send = "/rest" }
Work = { send = "/work", then = "wait" }
"""


class Radio(Extension):
    """Tells one predicate each second, and notes its life."""

    def __init__(self, notes, predicates, names):
        self.notes, self.predicates, self.names = notes, predicates, names

    async def open(self, runtime):
        self.notes.append("open")
        self.telling = asyncio.create_task(self._tell())

    async def _tell(self):
        warm = False
        while True:
            for name in self.names:
                self.predicates.sense(name, warm)
            warm = not warm
            await asyncio.sleep(1)

    async def close(self):
        self.telling.cancel()
        self.notes.append("close")


class RadioReader(TableReader):
    """Reads a table `radio`, and entries with a station or something to send."""

    entries: ClassVar = {
        **dict.fromkeys(("predicates", "events"), frozenset({"station"})),
        "actions": frozenset({"send"}),
    }
    notes: ClassVar = []

    def __init__(self, value, reading):
        self.reading, self.names = reading, []
        if set(value) - {"channel"}:
            raise ConfigError("a radio has a channel alone", key="radio.channel")

    def predicate(self, name, written, key):
        self.reading.predicates.sensor(name, max_age=written.get("max_age"))
        self.names.append(name)

    def event(self, name, written, key):
        self.reading.predicates.event(name)

    def action(self, written, key):
        if written["send"] == "":
            self.reading.problems.add("something is sent", f"{key}.send")
            return None
        if not self.reading.functions.imported:
            return bind(Lasting())
        return bind(lambda: self.notes.append(written["send"]))

    def extension(self):
        return Radio(self.notes, self.reading.predicates, self.names)


TABLES = {"radio": RadioReader}


@pytest.fixture(autouse=True)
def notes():
    RadioReader.notes = []
    return RadioReader.notes


def told(text, **options):
    """Return the problems of a text, which is read as a document."""
    with pytest.raises(ConfigError) as caught:
        load_system(tomllib.loads(text), **{"tables": TABLES} | options)
    return [(problem.key, problem.message) for problem in caught.value.problems]


def test_predicates_events_and_actions_are_the_extension_s_which_lives_around_them(notes):
    async def main(runtime):
        system = load_system(tomllib.loads(FILE), tables=TABLES)
        assert system.predicates.declared.names == {"Warm": "predicate", "Rang": "event"}
        assert notes == []
        await runtime.start(system)
        await asyncio.sleep(2.5)
        await runtime.stop(system)
        notes.append("stopped")

    run_virtual(main)
    assert notes == ["open", "/rest", "/work", "/rest", "/rest", "stopped", "close"]  # the last one is the safe action


def test_a_system_that_is_started_again_finds_its_extensions_open(notes):
    async def main(runtime):
        system = load_system(tomllib.loads(FILE), tables=TABLES)
        for _ in range(2):
            await runtime.start(system)
            await runtime.stop(system)

    run_virtual(main)
    assert [note for note in notes if "/" not in note] == ["open", "close"]


def test_an_extension_that_does_not_open_keeps_the_system_from_starting(notes):
    class Deaf(Radio):
        async def open(self, runtime):
            raise OSError("no antenna")

    class Reader(RadioReader):
        def extension(self):
            return Deaf(self.notes, self.reading.predicates, self.names)

    async def main(runtime):
        with refused(Error):
            await runtime.start(load_system(tomllib.loads(FILE), tables={"radio": Reader}))
        assert runtime.statistics().actors == ()

    run_virtual(main)
    assert notes == []


def test_whoever_only_looks_or_replays_has_no_extensions(folder, notes, monkeypatch):
    monkeypatch.setattr(mdm, "TABLES", {"radio": f"{__name__}:RadioReader"})
    file = written(folder, FILE, "robot.toml")
    for system in (load_system(file, callbacks=False), look_over(file)):
        assert system.extensions == ()
        assert isinstance(system.ensembles["robot"].action.bindings[0].target, Lasting)

    async def main(runtime):
        await runtime.start(load_system(file))
        await asyncio.sleep(2.5)

    run_virtual(main, record=folder / "run.mcap")
    del notes[:]
    assert replay(folder / "run.mcap", load_system(file)) == 3  # functions are imported, and none is called
    assert replay(folder / "run.mcap", config=file) == 3
    assert notes == []


def test_a_document_names_keys_alone_and_its_paths_are_of_a_folder(folder):
    text = FILE.replace("policy = [0, 1]", 'policy = "below.policy"')
    assert load_system(tomllib.loads(text), folder=folder, tables=TABLES).top[0].policy.num_actions == 2
    ((key, message),) = told(text)
    assert key == "ensembles.robot.policy"
    assert "below.policy" in message
    ((key, _),) = told(text.replace("below.policy", "cut.policy"), folder=folder)
    assert key == "ensembles.robot.policy"
    with refused(ConfigError):
        load_system({"ensembles": {}})
    with refused(Error):
        load_system("robot.toml", folder=folder)


def test_a_document_may_be_of_a_team(folder):
    document = tomllib.loads(team_file.write(folder).read_text())
    assert load_system(document, folder=folder, agent="a", callbacks=False).agent == "a"


@pytest.mark.parametrize(
    ("old", "new", "key", "words"),
    [
        ("[radio]", "[wireless]", "wireless", "and of extensions radio, ros2"),
        ("channel = 7", "frequency = 7", "radio", "a radio has a channel alone"),
        ("[radio]\nchannel = 7", "", "predicates.Warm", "'station' is a key of the extension 'radio': give the file a"),
        ('send = "/rest"', 'send = ""', "ensembles.robot.actions.Rest.send", "something is sent"),
        ('station = "/bell"', 'tone = "/bell"', "events.Rang.tone", "there is no key 'tone' here"),
    ],
)
def test_what_is_wrong_is_told_with_its_key(old, new, key, words):
    problems = told(FILE.replace(old, new))
    assert any(key == at and words in text for at, text in problems), problems
    if "[radio]" not in FILE.replace(old, new):
        assert [at for at, _ in problems if at != "wireless"] == [
            *("predicates.Warm", "events.Rang", "ensembles.robot.actions.Rest", "ensembles.robot.actions.Work")
        ]
    else:
        assert len(problems) == 1


def test_readers_that_are_none_are_told():
    with refused(ConfigError):
        load_system(tomllib.loads(FILE), tables={"radio": Radio})
    with refused(ConfigError):
        load_system(tomllib.loads(FILE), tables={"radio": RadioReader, "events": RadioReader})


def test_other_packages_register_theirs_as_entry_points(monkeypatch):
    good = EntryPoint("radio", f"{__name__}:RadioReader", "mdm.tables")
    bad = EntryPoint("telegraph", "no_such_module:Reader", "mdm.tables")
    monkeypatch.setattr("mdm.config.readers.entry_points", lambda *, group: [good, bad] if group == good.group else [])
    (extension,) = load_system(tomllib.loads(FILE)).extensions
    assert isinstance(extension, Radio)
    with refused(ConfigError):
        load_system(tomllib.loads(f"{FILE}\n[telegraph]"))
    wrong = FILE.replace("station", "stetion", 1)
    assert told(wrong, tables=None) == told(wrong)  # one that cannot be imported hides no error of typing


def test_a_file_without_tables_of_extensions_looks_for_none():
    program = """
import sys, mdm
mdm.load_system({"ensembles": {"robot": {"policy": [0], "actions": {"Rest": "os:getpid"}}}})
print(*sorted(name for name in sys.modules if name.startswith(("mdm.ros2", "rclpy"))))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "\n"
