"""The matrices of factored models in files that all processes of a user map into memory.

A process that needs the matrices of a model (a search, false negatives, a filter over all states) and that is to take
little memory does not hold them itself. They are made once on a machine, by the first of them, and all have the same
pages. The mapped arrays are equal to the last bit to those of the model's own process.

A file is named by a digest of its sources, so it is never out of date. It is written beside its place and moved there
whole. The process that makes it holds a lock, which the system takes back when the process ends; others wait for it,
but not for ever. Only files that nobody else could have written are mapped, and only if their contents have the digest
that was written with them. The folder has a limit: files that were not used for longest are removed, and stay mapped
where it is in use.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import stat
import sys
import time
import warnings
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast
from weakref import WeakValueDictionary

import msgspec
import numpy as np

from mdm.errors import Error, FormatError, ModelWarning
from mdm.formats.archive import npz
from mdm.models import MDP, POMDP
from mdm.models.digest import digest, of_parts
from mdm.models.dynamics import Rows, distinct, stacked
from mdm.models.events import DenseEvents, TransitionEvents
from mdm.models.matrices import Checked, csr, is_compressed, read_only
from mdm.version import __version__

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    import numpy.typing as npt

    from mdm.models.matrices import Matrix

_FORM = 1
"""The version of a file's content, and of its computation."""
_LEAST = 1_000_000
"""The bytes of matrices from which a file is worth its while."""

_Flat = TypeVar("_Flat", bound=MDP)

_here: WeakValueDictionary[str, MDP] = WeakValueDictionary()
"""The models that this process has mapped already."""


class _Header(msgspec.Struct):
    format: str = "mdm flat 1"


def mapped(model: MDP, make: Callable[[], _Flat]) -> _Flat:
    """Return the matrices of a factored model, mapped from a file; where that cannot be, in this process's own memory.

    Args:
        model: The factored model.
        make: Makes the matrices; called once at most.
    """
    if model.matrix_size.total < _LEAST:
        return make()
    own: list[_Flat] = []

    def written() -> tuple[_Header, dict[str, npt.NDArray[Any]]]:
        own.append(make())
        return _Header(), _packed(own[0])

    try:
        folder = user_folder()
        if folder is None:
            return make()
        # The digest of all that the matrices follow from.
        key = of_parts([__version__, _FORM, np.__version__, type(model).__name__, model.sparse, digest(model)])
        known = _here.get(key)
        if known is None:
            _, arrays = Store(folder).obtain(key, written)
            known = _here[key] = _model(model, arrays)
    except StoreError as error:
        text = f"the model's matrices are not shared with other processes, which takes more memory: {error}"
        warnings.warn(text, ModelWarning, stacklevel=2)
        return own[0] if own else make()
    return cast("_Flat", known)


def _packed(model: MDP) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays that a flat model is made of."""
    actions = range(len(model.action_space))
    arrays = {"R": model.rewards}
    _pack("T", [model.transition_matrix(action) for action in actions], arrays)
    if (pomdp := model.pomdp) is None:
        return arrays
    if pomdp.events is None:
        _pack("O", [pomdp.observation_matrix(action) for action in actions], arrays)
    elif isinstance(pomdp.events, DenseEvents):
        arrays["E"] = np.stack(pomdp.events.events)
    elif isinstance(pomdp.events, TransitionEvents):
        events = pomdp.events.events  # of all actions, in CSC: entries of T x O
        arrays |= {
            "E.values": np.concatenate([matrix.data for matrix in events]),
            "E.entries": np.concatenate([matrix.indices for matrix in events]),
            "E.starts": np.stack([matrix.indptr for matrix in events]),
            "E.cuts": np.cumsum([0, *(matrix.nnz for matrix in events)]),
        }
    return arrays


def _pack(name: str, matrices: Sequence[Matrix], arrays: dict[str, npt.NDArray[Any]]) -> None:
    """Add the matrices of all actions, those that several actions share once; sparse ones as `Rows`."""
    kept, places = distinct(matrices)
    arrays[f"{name}.places"] = np.array(places)
    if not is_compressed(kept[0]):
        arrays[name] = np.stack(kept)
        return
    rows = stacked(matrices)
    arrays |= {
        f"{name}.first": rows.first,
        f"{name}.starts": rows.starts.view(np.int64),
        f"{name}.columns": rows.columns.view(np.int32),
        f"{name}.values": rows.values,
        # Where each row begins within its own matrix, and that matrix within all.
        f"{name}.rows": np.stack([matrix.indptr for matrix in kept]),
        f"{name}.cuts": np.cumsum([0, *(matrix.nnz for matrix in kept)]),
    }


def _model(model: MDP, arrays: Mapping[str, npt.NDArray[Any]]) -> MDP:
    """Return the flat model of which these are the arrays."""
    size = len(model.state_space)
    transitions, moved = _matrices("T", arrays, size, size)
    stacks = {"T": moved}
    common: dict[str, Any] = {
        "discount": model.discount,
        "states": model.state_space,
        "actions": model.action_space,
        "initial_belief": model.initial_belief,
        "outcome_rewards": model.outcome_rewards,
    }
    rewards = Checked([read_only(arrays["R"].view())])
    if model.observation_space is None:
        flat = MDP(transitions, rewards, **common)
    else:
        names = {"actions": model.action_space, "states": model.state_space}
        told: Any
        if "E" in arrays:
            told = DenseEvents(transitions, list(arrays["E"]), **names)
        elif "E.values" in arrays:
            told = TransitionEvents(transitions, _events(arrays, transitions, len(model.observation_space)), **names)
        else:
            told, stacks["O"] = _matrices("O", arrays, size, len(model.observation_space))
        flat = POMDP(transitions, told, rewards, observation_names=model.observation_space, **common)
    flat.stacked = {name: rows for name, rows in stacks.items() if rows is not None} | {"R": arrays["R"]}
    return flat.timed_as(model)


def _matrices(
    name: str, arrays: Mapping[str, npt.NDArray[Any]], height: int, width: int
) -> tuple[Checked, Rows | None]:
    """Return a matrix for each action, and where they are sparse all below each other; both have the same memory."""
    places = arrays[f"{name}.places"].tolist()
    if name in arrays:
        whole = [read_only(matrix) for matrix in arrays[name]]
        return Checked(whole[place] for place in places), None
    first, starts, columns, values, rows, cuts = (
        arrays[f"{name}.{part}"] for part in ("first", "starts", "columns", "values", "rows", "cuts")
    )
    kept = [
        read_only(csr((values[start:end], columns[start:end], own), (height, width), copy=False))
        for own, start, end in zip(rows, cuts[:-1].tolist(), cuts[1:].tolist(), strict=True)
    ]
    stack = Rows(first, starts.view(np.uint64), columns.view(np.uint32), values)
    return Checked(kept[place] for place in places), stack


def _events(arrays: Mapping[str, npt.NDArray[Any]], transitions: Sequence[Matrix], width: int) -> list[Matrix]:
    from scipy.sparse import csc_array  # noqa: PLC0415 - slow to import

    values, entries, starts, cuts = (arrays[f"E.{part}"] for part in ("values", "entries", "starts", "cuts"))
    return [
        csc_array((values[start:end], entries[start:end], own), (transition.nnz, width), copy=False)
        for transition, own, start, end in zip(transitions, starts, cuts[:-1].tolist(), cuts[1:].tolist(), strict=True)
    ]


# -- The files of a user -----------------------------------------------------------------------------------------------

MOST = 4_000_000_000
"""The most bytes of files that are kept."""
_PATIENCE = 60.0
"""Seconds for which another process's work is waited for."""
_POLL = 0.02
_FORGOTTEN = 3600.0
"""Seconds after which a file that was never finished is removed."""
_OTHERS = stat.S_IWGRP | stat.S_IWOTH


class StoreError(Error):
    """Why a file is not there to be mapped, and cannot be made."""


def user_folder() -> Path | None:
    """Return the folder for this user's files: ``MDM_CACHE``, else where the platform keeps them; None for no folder.

    Raises:
        StoreError: If there is no place for it.
    """
    given = os.environ.get("MDM_CACHE")
    try:
        if given is not None:
            return Path(given).expanduser().absolute() if given else None
        if sys.platform == "darwin":
            return Path.home() / "Library" / "Caches" / "mdm"
        base = Path(os.environ.get("XDG_CACHE_HOME", ""))
        return (base if base.is_absolute() else Path.home() / ".cache") / "mdm"
    except RuntimeError as error:
        raise StoreError(f"there is no folder for it: {error}") from None


class Store:
    """A folder of archives (`mdm.formats.archive.npz`) that the processes of one user share.

    Args:
        folder: The folder; it is made when it is first needed.
        most: The most bytes of files that are kept.
        patience: Seconds for which another process's work is waited for.
    """

    def __init__(self, folder: Path, *, most: int = MOST, patience: float = _PATIENCE) -> None:
        self._folder = folder
        self._most = most
        self._patience = patience

    def obtain(
        self, name: str, make: Callable[[], tuple[Any, Mapping[str, npt.NDArray[Any]]]]
    ) -> tuple[bytes, dict[str, npt.NDArray[Any]]]:
        """Return the header and the arrays of a file, mapped into memory; writing to them changes this process's alone.

        A file that is damaged, or that somebody else could have written, is told of in a warning and made again.

        Args:
            name: The file's name, without its suffix: a digest of its sources.
            make: Returns header and arrays where there is no file; called once at most.

        Raises:
            StoreError: If there is no file, and none can be made.
        """
        try:
            # Nobody else may write in the folder.
            self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            folder = os.open(self._folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
            wrong = _unsafe(os.fstat(folder))
            if wrong is not None:
                os.close(folder)
                raise StoreError(f"{self._folder}: {wrong}")
            try:
                found = self._read(folder, name)
                if found is None:
                    with self._locked(folder, name):
                        found = self._read(folder, name, tells=True) or self._made(folder, name, make)
            finally:
                os.close(folder)
        except (OSError, FormatError) as error:
            raise StoreError(f"{self._folder}: {getattr(error, 'strerror', None) or error}") from None
        return found

    def _read(self, folder: int, name: str, *, tells: bool = False) -> tuple[bytes, dict[str, npt.NDArray[Any]]] | None:
        """Return the contents of a file; None where there is none that may be mapped, which can be told."""
        try:
            return self._content(folder, name)
        except FileNotFoundError:
            return None
        except (OSError, StoreError, FormatError) as error:
            if tells:
                wrong = getattr(error, "strerror", None) or getattr(error, "message", None) or error
                text = f"{self._folder / name}.npz is not used, and made again: {wrong}"
                warnings.warn(text, ModelWarning, stacklevel=2)
            return None

    def _content(self, folder: int, name: str) -> tuple[bytes, dict[str, npt.NDArray[Any]]]:
        """Return the contents of a file.

        Raises:
            FileNotFoundError: If there is none.
            OSError: If it cannot be opened.
            StoreError: If it is no file, or somebody else could have written it.
            FormatError: If it is damaged.
        """
        # Not through a link, and not waiting for the other end of a pipe.
        flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        descriptor = os.open(f"{name}.npz", flags, dir_fd=folder)
        with os.fdopen(descriptor, "rb") as file:
            state = os.fstat(descriptor)
            wrong = "it is no file" if not stat.S_ISREG(state.st_mode) else _unsafe(state)
            if wrong is not None:
                raise StoreError(wrong)
            found = npz.read(self._folder / f"{name}.npz", file)
            with suppress(OSError):
                os.utime(descriptor)  # it is in use
        return found

    def _made(
        self, folder: int, name: str, make: Callable[[], tuple[Any, Mapping[str, npt.NDArray[Any]]]]
    ) -> tuple[bytes, dict[str, npt.NDArray[Any]]]:
        """Make a file, and return its contents as mapped from it."""
        with suppress(FileNotFoundError):
            os.unlink(f"{name}.npz", dir_fd=folder)  # what may not be mapped
        header, arrays = make()
        size = sum(array.nbytes for array in arrays.values())
        self._make_room(size)
        npz.write(self._folder / f"{name}.npz", header, arrays, mode=0o600)
        del arrays
        found = self._read(folder, name)
        if found is None:
            raise StoreError(f"{self._folder}: the file {name}.npz has gone")
        return found

    @contextmanager
    def _locked(self, folder: int, name: str) -> Iterator[None]:
        """Be the only process that makes a file.

        The lock decides who works, not who is right: two that make one file at a time make the same.

        Raises:
            StoreError: If another one takes too long.
        """
        flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
        lock = os.open(f"{name}.lock", flags, 0o600, dir_fd=folder)
        try:
            until = time.monotonic() + self._patience
            while True:
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                except BlockingIOError:
                    if time.monotonic() >= until:
                        text = f"another process has been making {name}.npz for more than {self._patience:g} s"
                        raise StoreError(f"{self._folder}: {text}") from None
                    time.sleep(_POLL)
            try:
                yield
            finally:
                with suppress(FileNotFoundError):
                    os.unlink(f"{name}.lock", dir_fd=folder)
        finally:
            os.close(lock)

    def _make_room(self, size: int) -> None:
        """Remove the files that were not used for longest, so that so many bytes more are within the limit.

        Raises:
            StoreError: If there is not enough room even so.
        """
        if size > self._most:
            text = f"the file would have {size / 1e6:.0f} MB, and the folder may hold {self._most / 1e6:.0f}"
            raise StoreError(f"{self._folder}: {text}")
        for unfinished in self._folder.glob(".mdm-*"):
            with suppress(OSError):
                if time.time() - unfinished.stat().st_mtime > _FORGOTTEN:
                    unfinished.unlink()
        kept = []
        for path in self._folder.glob("*.npz"):
            with suppress(OSError):
                kept.append((path.stat().st_mtime, path.stat().st_size, path))
        total = sum(held for _, held, _ in kept)
        for _, held, path in sorted(kept):
            if total + size <= self._most:
                break
            with suppress(FileNotFoundError):  # another process makes room, too
                path.unlink()
            total -= held
        free = shutil.disk_usage(self._folder).free
        if size > free:
            text = f"the file would have {size / 1e6:.0f} MB, and the disk has {free / 1e6:.0f} MB free"
            raise StoreError(f"{self._folder}: {text}")


def _unsafe(state: os.stat_result) -> str | None:
    """Return why somebody else could have written a file, or something in a folder; None if nobody could."""
    if state.st_uid != os.geteuid():
        return f"it belongs to another user ({state.st_uid})"
    if state.st_mode & _OTHERS:
        return f"it can be written by others (mode {stat.S_IMODE(state.st_mode):04o})"
    return None
