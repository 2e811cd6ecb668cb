"""Files that processes share: made once, mapped by all, and only if nobody else could have written them."""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from patience import PATIENCE
from sentences import refused

from mdm.errors import ModelWarning
from mdm.formats.archive import flat as stores
from mdm.formats.archive.flat import Store, StoreError, user_folder

NUMBERS = np.linspace(0, 1, 5000)


class Maker:
    """Makes arrays, and counts how often."""

    def __init__(self, numbers=NUMBERS):
        self.numbers = numbers
        self.count = 0

    def __call__(self):
        self.count += 1
        return {"format": "numbers"}, {"numbers": self.numbers}


def never():
    raise AssertionError("it is there already")


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "of the user" / "mdm"


def filled(folder, name="one", numbers=NUMBERS):
    Store(folder).obtain(name, Maker(numbers))
    return folder / f"{name}.npz"


def test_a_file_is_made_once_and_mapped(folder):
    make = Maker()
    header, arrays = Store(folder).obtain("one", make)
    again_header, again = Store(folder).obtain("one", never)
    assert make.count == 1
    assert header == again_header == b'{"format":"numbers"}'
    assert np.array_equal(arrays["numbers"], NUMBERS)
    assert np.array_equal(again["numbers"], NUMBERS)
    assert Path("/proc/self/maps").read_text().count(str(folder / "one.npz")) == 2
    assert [path.name for path in folder.iterdir()] == ["one.npz"]
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert stat.S_IMODE((folder / "one.npz").stat().st_mode) == 0o600


def test_what_is_written_to_an_array_is_for_this_process_alone(folder):
    before = filled(folder).read_bytes()
    _, arrays = Store(folder).obtain("one", never)
    arrays["numbers"][:] = 7
    assert (folder / "one.npz").read_bytes() == before
    assert np.array_equal(Store(folder).obtain("one", never)[1]["numbers"], NUMBERS)


def spoilt(path, how):
    data = bytearray(path.read_bytes())
    if how == "a bit":
        data[len(data) // 2] ^= 1
    path.write_bytes({"a bit": data, "half": data[: len(data) // 2], "empty": b"", "text": b"no archive"}[how])


@pytest.mark.parametrize("how", ["a bit", "half", "empty", "text"])
def test_a_damaged_file_is_told_of_and_made_anew(folder, how):
    spoilt(filled(folder), how)
    make = Maker()
    with pytest.warns(ModelWarning, match=r"one\.npz is not used, and made again") as told:
        _, arrays = Store(folder).obtain("one", make)
    assert (len(told), make.count) == (1, 1)
    assert np.array_equal(arrays["numbers"], NUMBERS)
    Store(folder).obtain("one", never)


@pytest.mark.parametrize("mode", [0o620, 0o602, 0o666])
def test_a_file_that_others_may_write_is_not_mapped(folder, mode):
    filled(folder, numbers=-NUMBERS).chmod(mode)
    with pytest.warns(ModelWarning, match=f"can be written by others .mode {mode:04o}"):
        _, arrays = Store(folder).obtain("one", Maker())
    assert np.array_equal(arrays["numbers"], NUMBERS)
    assert stat.S_IMODE((folder / "one.npz").stat().st_mode) == 0o600


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file to another user")
def test_a_file_of_another_user_is_not_mapped(folder):
    os.chown(filled(folder, numbers=-NUMBERS), 65534, 65534)
    with pytest.warns(ModelWarning, match=r"belongs to another user \(65534\)"):
        _, arrays = Store(folder).obtain("one", Maker())
    assert np.array_equal(arrays["numbers"], NUMBERS)
    assert (folder / "one.npz").stat().st_uid == 0


def test_a_link_is_not_followed(folder, tmp_path):
    theirs = filled(tmp_path / "elsewhere", numbers=-NUMBERS)
    before = theirs.read_bytes()
    filled(folder, "other")
    (folder / "one.npz").symlink_to(theirs)
    with pytest.warns(ModelWarning, match=r"one\.npz is not used"):
        _, arrays = Store(folder).obtain("one", Maker())
    assert np.array_equal(arrays["numbers"], NUMBERS)
    assert theirs.read_bytes() == before
    assert not (folder / "one.npz").is_symlink()


def test_a_pipe_is_not_waited_for(folder):
    filled(folder, "other")
    os.mkfifo(folder / "one.npz", 0o600)
    with pytest.warns(ModelWarning, match="it is no file"):
        _, arrays = Store(folder).obtain("one", Maker())
    assert np.array_equal(arrays["numbers"], NUMBERS)


@pytest.mark.parametrize("mode", [0o770, 0o707])
def test_a_folder_where_others_may_write_is_not_used(folder, mode):
    path = filled(folder)
    folder.chmod(mode)
    with refused(StoreError):
        Store(folder).obtain("one", never)
    folder.chmod(0o700)
    assert path.exists()


def test_a_folder_of_another_user_is_not_used(folder, monkeypatch):
    filled(folder)
    own = os.geteuid()
    monkeypatch.setattr(stores.os, "geteuid", lambda: own + 1)
    with refused(StoreError):
        Store(folder).obtain("one", never)


def test_a_folder_that_cannot_be_made_or_written_is_told(tmp_path, folder, monkeypatch):
    (tmp_path / "file").write_text("")
    with refused(StoreError):
        Store(tmp_path / "file" / "mdm").obtain("one", never)
    (tmp_path / "plain").write_text("")
    with refused(StoreError):
        Store(tmp_path / "plain").obtain("one", never)

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tempfile.mkstemp", full)
    make = Maker()
    with refused(StoreError):
        Store(folder).obtain("one", make)
    assert make.count == 1
    assert not list(folder.iterdir())


def test_of_two_that_need_a_file_one_makes_it_and_the_other_waits(folder, monkeypatch):
    waiting, results, make = threading.Event(), [], Maker()
    monkeypatch.setattr(stores.time, "sleep", lambda _: waiting.set())

    def slowly():
        assert waiting.wait(PATIENCE)  # until the other one has been refused the lock
        return make()

    def obtain():
        results.append(Store(folder).obtain("one", slowly))

    both = [threading.Thread(target=obtain) for _ in range(2)]
    for thread in both:
        thread.start()
    for thread in both:
        thread.join(60)
    assert make.count == 1
    assert [arrays["numbers"].tolist() for _, arrays in results] == [NUMBERS.tolist()] * 2
    assert [path.name for path in folder.iterdir()] == ["one.npz"]


HOLD = "import fcntl, sys; file = open(sys.argv[1], 'w'); fcntl.flock(file, fcntl.LOCK_EX); print(flush=True); input()"


@pytest.fixture
def holder(folder):
    """Return a process that holds the lock of a file."""
    filled(folder, "other")
    process = subprocess.Popen(
        [sys.executable, "-S", "-c", HOLD, str(folder / "one.lock")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert process.stdout.readline()
    yield process
    process.kill()
    process.communicate()


def test_the_lock_of_a_process_that_dies_is_no_hindrance(folder, holder, monkeypatch):
    slept = []

    def sleep(_):
        slept.append(holder.poll())
        holder.kill()
        holder.wait()

    monkeypatch.setattr(stores.time, "sleep", sleep)
    make = Maker()
    _, arrays = Store(folder).obtain("one", make)
    assert slept[0] is None  # it was alive, and waited for
    assert make.count == 1
    assert np.array_equal(arrays["numbers"], NUMBERS)


def test_who_waits_too_long_goes_on_without(folder, holder):
    make = Maker()
    with refused(StoreError):
        Store(folder, patience=0).obtain("one", make)
    assert make.count == 0
    assert holder.poll() is None


def test_what_was_not_used_for_longest_makes_room(folder):
    for place, name in enumerate(("first", "second", "third")):
        os.utime(filled(folder, name), (place, place))
    size = (folder / "first.npz").stat().st_size
    store = Store(folder, most=3 * size)
    _, mapped = store.obtain("first", never)  # which is used now
    _, removed = store.obtain("second", never)
    os.utime(folder / "second.npz", (1, 1))
    store.obtain("fourth", Maker())
    assert {path.stem for path in folder.iterdir()} == {"first", "third", "fourth"}
    assert np.array_equal(removed["numbers"], mapped["numbers"])


def test_two_processes_may_make_room_at_once(folder, monkeypatch):
    size = filled(folder, "first").stat().st_size
    remove = Path.unlink

    def twice(path):
        remove(path)  # as another one does
        remove(path)

    monkeypatch.setattr(Path, "unlink", twice)
    Store(folder, most=size).obtain("second", Maker())
    assert [path.stem for path in folder.iterdir()] == ["second"]


def test_what_is_too_large_is_not_kept(folder, monkeypatch):
    make = Maker()
    with refused(StoreError):
        Store(folder, most=1000).obtain("one", make)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=1000))
    with refused(StoreError):
        Store(folder).obtain("one", make)
    assert make.count == 2
    assert not list(folder.iterdir())


def test_what_was_never_finished_is_removed_in_time(folder):
    filled(folder, "other")
    old, new = folder / ".mdm-old", folder / ".mdm-new"
    for path in (old, new):
        path.write_text("half a file")
    os.utime(old, (0, 0))
    filled(folder)
    assert not old.exists()
    assert new.exists()


def test_the_user_says_where(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.delenv("MDM_CACHE", raising=False)
    assert user_folder() == tmp_path / ".cache" / "mdm"
    monkeypatch.setenv("XDG_CACHE_HOME", "/var/somewhere")
    assert user_folder() == Path("/var/somewhere/mdm")
    monkeypatch.setenv("XDG_CACHE_HOME", "not/absolute")
    assert user_folder() == tmp_path / ".cache" / "mdm"
    monkeypatch.setenv("MDM_CACHE", "~/models")
    assert user_folder() == tmp_path / "models"
    monkeypatch.setenv("MDM_CACHE", "")
    assert user_folder() is None


@pytest.mark.parametrize("given", ["~nobody of this name/cache", None])
def test_without_a_home_there_is_no_folder(monkeypatch, given):
    def homeless(*_):
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    if given is None:
        monkeypatch.delenv("MDM_CACHE", raising=False)
        monkeypatch.setattr(Path, "home", homeless)
    else:
        monkeypatch.setenv("MDM_CACHE", given)
    with pytest.raises(StoreError, match="there is no folder for it: Could not determine home directory"):
        user_folder()
