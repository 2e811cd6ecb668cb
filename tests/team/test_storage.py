"""What an agent obeys outlives its process: a team in virtual time whose agents keep it in a folder, and the file."""

from __future__ import annotations

import asyncio
import errno
import os
import threading

import msgspec
import pytest
from sentences import refused
from team.sharing.test_commanding_outcomes import MODES, NAMES, Squad
from team_robots import over_beliefs, started, three

import mdm
from mdm.messages import Cause
from mdm.team import storage
from mdm.team.storage import Stored, StoredStop, forget, path_of, read, write
from mdm.team.team import Team
from mdm.testing import run_virtual

STOP = StoredStop("r1", 3, 1_700_000_000_000_000_000, b"\x01")
KEPT = {"joint": Stored(STOP, (Cause("safe_action", "failed twice", 5),))}


class Keeping(Squad):
    """Robots whose stops outlive their processes."""

    def __init__(self, runtime, mode, folder, **options):
        super().__init__(runtime, mode, **options)
        more = {"controller": self.team.controller} if mode == "centralised" else {}
        self.team = Team("squad", NAMES, mode=mode, period=0.5, lease=0.5, state=folder, **more)

    async def kill(self, *names):
        for name in names:
            self.network.crash(name)
        await asyncio.sleep(1.0)
        for name in names:
            await self.runtime.stop(self.robots[name].member)

    async def up(self, *names, seconds=3.0):
        back = await started(self.runtime, self.team, self.network, self.build, names=names)
        self.robots |= dict(zip(names, back, strict=True))
        await asyncio.sleep(seconds)

    async def asker(self):
        asker = self.network.transport("console")
        await asker.open()
        return asker

    def told(self, kind):
        return {name: [f.detail for f in robot.faults if f.kind == kind] for name, robot in self.robots.items()}


def keeping(mode, folder, befall, **options):
    async def main(runtime):
        squad = await Keeping(runtime, mode, folder, **options).begin()
        return await befall(squad, await squad.asker())

    return run_virtual(main)


@pytest.mark.parametrize("mode", MODES)
def test_a_stop_that_was_confirmed_outlives_all_processes(mode, tmp_path):
    async def befall(squad, asker):
        assert list(tmp_path.iterdir()) == []  # where nobody was stopped there is nothing to keep
        assert all(one.confirmed for one in await squad.team.stop(transport=asker))
        assert sorted(tmp_path.iterdir()) == [path_of(tmp_path, "squad", name) for name in NAMES]
        await squad.kill(*NAMES)
        await squad.up(*NAMES)
        assert squad.modes == ["stopped"] * 3
        assert await squad.begun(3.0) == [0, 0, 0]
        for name, [told] in squad.told("held").items():
            assert told.startswith(f"{name} is stopped since 1970-01-01 ")
            assert told.endswith(": start the team to have it decide")
        assert all(one.confirmed for one in await squad.team.start(transport=asker))
        assert all(await squad.begun(5.0))
        assert list(tmp_path.iterdir()) == []  # a start that is confirmed clears it
        await squad.kill(*NAMES)
        await squad.up(*NAMES)
        assert squad.modes == ["deciding"] * 3

    keeping(mode, tmp_path, befall)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("killed", ["r0", "r1", "r2"])
def test_one_that_is_killed_is_stopped_still_while_nobody_else_is_there(mode, killed, tmp_path):
    async def befall(squad, asker):
        await squad.team.stop(transport=asker)
        await squad.kill(*NAMES)
        await squad.up(killed)
        assert squad.robots[killed].ensemble.mode in {"stopped", "safe"}
        assert not squad.robots[killed].did
        others = [name for name in NAMES if name != killed]
        await squad.up(*others)
        assert squad.modes == ["stopped"] * 3
        assert all(one.confirmed for one in await squad.team.start(transport=asker))

    keeping(mode, tmp_path, befall)


@pytest.mark.parametrize("mode", MODES)
def test_a_later_start_that_the_others_know_of_wins(mode, tmp_path):
    async def befall(squad, asker):
        await squad.team.stop(transport=asker)
        await squad.kill("r0")
        squad.tell("start", "r1")
        await asyncio.sleep(3.0)
        assert squad.modes[1:] == ["deciding"] * 2
        await squad.up("r0")
        assert squad.modes == ["deciding"] * 3
        assert all(await squad.begun(5.0))
        assert not path_of(tmp_path, "squad", "r0").exists()

    keeping(mode, tmp_path, befall)


def test_a_start_that_was_asked_of_a_later_life_of_the_controller_wins(tmp_path):
    async def befall(squad, asker):
        await squad.team.stop(transport=asker)
        await squad.kill("r0", "r2")
        await squad.up("r2")
        squad.tell("start", "r2")
        await asyncio.sleep(3.0)
        await squad.up("r0")
        assert squad.modes == ["deciding"] * 3

    keeping("centralised", tmp_path, befall)


@pytest.mark.parametrize("mode", MODES)
def test_who_was_stopped_while_it_was_cut_off_is_held_when_it_is_brought_back(mode, tmp_path):
    async def befall(squad, asker):
        del asker
        await squad.cut("r0")
        squad.tell("stop", "r0")
        await squad.kill("r0")
        squad.network.heal()
        await squad.up("r0")
        assert squad.modes[0] == "stopped"
        assert (await squad.begun(5.0))[0] == 0
        squad.tell("start", "r1")
        await asyncio.sleep(3.0)
        assert squad.modes == ["deciding"] * 3

    keeping(mode, tmp_path, befall)


@pytest.mark.parametrize("mode", MODES)
def test_an_end_in_order_keeps_it(mode, tmp_path):
    async def befall(squad, asker):
        await squad.team.stop(transport=asker)
        for name in NAMES:
            await squad.runtime.stop(squad.robots[name].member)
        await squad.up(*NAMES)
        assert squad.modes == ["stopped"] * 3

    keeping(mode, tmp_path, befall)


def damaged(path):
    path.write_bytes(path.read_bytes().replace(b'"term":3', b'"term":4'))


def newer(path):
    path.write_bytes(path.read_bytes().replace(b'"version":1', b'"version":2,"more":[]'))


FILES = {
    "empty": lambda path: path.write_bytes(b""),
    "cut off": lambda path: path.write_bytes(path.read_bytes()[:40]),
    "damaged": damaged,
    "newer": newer,
    "another team's": lambda path: write(path, "other", "r0", KEPT),
    "another agent's": lambda path: write(path, "squad", "r1", KEPT),
    "of another ensemble": lambda path: write(path, "squad", "r0", {"gone": Stored(STOP)}),
    "a folder": lambda path: (path.unlink(), path.mkdir()),
}


@pytest.mark.parametrize("how", FILES)
def test_a_file_that_cannot_be_read_is_refused_with_its_reason(how, tmp_path):
    path = path_of(tmp_path, "squad", "r0")
    write(path, "squad", "r0", KEPT)
    assert read(path, "squad", "r0", ["joint"]) == KEPT
    FILES[how](path)
    with refused(mdm.Error):
        read(path, "squad", "r0", ["joint"])


@pytest.mark.parametrize("mode", MODES)
def test_who_cannot_read_its_file_starts_stopped_and_names_it(mode, tmp_path):
    async def main(runtime):
        squad = Keeping(runtime, mode, tmp_path)
        path_of(tmp_path, "squad", "r0").write_bytes(b"garbage")
        squad.robots = {}
        await squad.up(*NAMES)
        assert squad.modes[0] == "stopped"
        assert squad.robots["r0"].did == []
        [told] = squad.told("storage")["r0"]
        assert told.startswith(f"{path_of(tmp_path, 'squad', 'r0')}: it is damaged: ")
        assert told.endswith(": r0 starts stopped")
        assert squad.told("held")["r0"][0].startswith("r0 is stopped since a time that is not known: start")
        squad.tell("start", "r1")
        await asyncio.sleep(3.0)
        assert squad.modes == ["deciding"] * 3
        assert not path_of(tmp_path, "squad", "r0").exists()

    run_virtual(main)


@pytest.mark.parametrize("mode", MODES)
def test_a_disk_that_is_full_stops_nobody_from_stopping_and_is_answered(mode, tmp_path, monkeypatch):
    def full(path, data):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    async def befall(squad, asker):
        with monkeypatch.context() as patched:
            patched.setattr(storage, "_replace", full)
            told = await squad.team.stop(transport=asker, seconds=2.0)
        assert squad.modes == ["stopped"] * 3
        assert await squad.begun(3.0) == [0, 0, 0]
        for one in told:
            reason = f"{path_of(tmp_path, 'squad', one.agent)}: No space left on device"
            assert (one.confirmed, one.problem) == (False, f"it is stopped, which is not kept: {reason}")
            assert squad.told("storage")[one.agent][0].endswith(reason)
        assert all(one.confirmed for one in await squad.team.stop(transport=asker))  # there is room again
        await squad.kill(*NAMES)
        await squad.up(*NAMES)
        assert squad.modes == ["stopped"] * 3

    keeping(mode, tmp_path, befall)


class Broken(Keeping):
    """Robots whose safe action fails, always."""

    def build(self, robot, agent):
        def fail():
            raise RuntimeError("the brake is stuck")

        return over_beliefs(three(), safe_action=fail)(robot, agent)


def test_who_waits_for_a_release_waits_for_it_still(tmp_path):
    async def main(runtime):
        squad = await Broken(runtime, "replicated", tmp_path).begin()
        robot = squad.robots["r0"].ensemble
        robot.safety.endanger("action", "a wheel is stuck", runtime.now())
        await asyncio.sleep(1.0)
        assert "safe_action" in robot.safety.modes.causes
        await squad.kill("r0")
        await squad.up("r0")
        robot = squad.robots["r0"].ensemble
        assert (robot.mode, [cause.kind for cause in robot.causes]) == ("safe", ["safe_action"])
        assert any("r0 waits for a release: " in told for told in squad.told("held")["r0"])
        assert squad.modes[1:] == ["deciding"] * 2
        robot.release()
        await asyncio.sleep(2.0)
        assert not path_of(tmp_path, "squad", "r0").exists()
        assert squad.modes == ["deciding"] * 3

    run_virtual(main)


def test_what_is_forgotten_is_said(tmp_path):
    path = path_of(tmp_path, "squad", "r0")
    assert forget(tmp_path, "squad", "r0") is None
    write(path, "squad", "r0", KEPT)
    assert forget(tmp_path, "squad", "r0").startswith("joint stopped since 2023-11-1")
    assert not path.exists()
    path.write_bytes(b"?")
    assert forget(tmp_path, "squad", "r0") == f"{path}, which could not be read"


def test_a_file_says_in_plain_words_what_it_keeps(tmp_path):
    path = path_of(tmp_path / "new", "squad", "r0")
    write(path, "squad", "r0", KEPT)
    found = msgspec.json.decode(path.read_bytes())
    assert (found["content"], found["team"], found["agent"]) == ("mdm team state", "squad", "r0")
    assert found["ensembles"]["joint"]["stop"]["by"] == "r1"
    assert [each.name for each in path.parent.iterdir()] == ["r0@squad.state"]


@pytest.mark.parametrize("given", [3, b"folder"])
def test_a_state_that_is_no_folder_s_name_is_refused(given):
    with refused(mdm.ConfigError):
        Team("squad", NAMES, state=given)


def test_in_real_time_a_thread_writes_and_the_end_waits_for_it(tmp_path, monkeypatch):
    """While the disk takes its time the loop goes on, and nothing is confirmed."""
    free, replace = threading.Event(), storage._replace

    def slow(path, data):
        assert free.wait(60)
        replace(path, data)

    monkeypatch.setattr(storage, "_replace", slow)
    kept = storage.Storage(tmp_path, "squad", "r0", ["joint"])

    async def main():
        async with mdm.Runtime(log=None) as runtime:
            await runtime.start(kept)
            kept.keep("joint", KEPT["joint"])
            assert kept.unkept == "not kept yet: it is being written"
            free.set()
            while kept.unkept is not None:
                await asyncio.sleep(0.001)
            free.clear()
            kept.keep("joint", Stored(STOP))
            threading.Timer(0.05, free.set).start()

    mdm.run(main)
    assert read(kept.file, "squad", "r0", ["joint"]) == {"joint": Stored(STOP)}
