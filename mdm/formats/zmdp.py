"""Text policies of ZMDP and of SARSOP's first version: lower bound planes.

A plane is an action and pairs of state and value; it applies to beliefs whose support lies within its states. SARSOP's
planes also have an ``observed state val``, the joint index of the fully observed variables, and entries for all hidden
states. Like ZMDP's own reader, this one works line by line.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

from mdm.formats.sarsop import policy as sarsop_policy
from mdm.formats.source import LARGEST, Source, number as number_of
from mdm.formats.target import write_text
from mdm.policies import AlphaVectors, MaskedAlphaVectors, MixedAlphaVectors

if TYPE_CHECKING:
    from pathlib import Path

    from mdm.models import MDP

_KINDS = {'"MaxPlanesLowerBound"': False, '"MaxPlanesLowerBoundWithObservedState"': True}
_PAIR = re.compile(r"([^\s,]+)\s*,\s*([^\s,]+)")
_ITEM = re.compile(r"([A-Za-z ]*[A-Za-z])\s*=>\s*(.*)")


class _Plane:
    def __init__(self, line: int, action: int) -> None:
        self.line = line
        self.action = action
        self.observed: int | None = None
        self.count: int | None = None
        self.entries: dict[int, float] = {}


def read(path: str | Path, model: MDP | None = None) -> MaskedAlphaVectors | MixedAlphaVectors | AlphaVectors:
    """Read planes: `AlphaVectors` if all are defined on all states, else `MaskedAlphaVectors`.

    SARSOP's planes become `MixedAlphaVectors` if there are several observed values.

    Args:
        path: The file.
        model: The policy's model; without it, the largest state is taken as the last one.

    Raises:
        FormatError: If the file is malformed, with the line and the expected form.
    """
    source = Source(path)
    mixed, planes = _Reader(source, None if model is None else len(model.action_space)).planes()
    actions = [plane.action for plane in planes]
    width = max(max(plane.entries) for plane in planes) + 1
    num_actions = None if model is None else len(model.action_space)
    if not mixed:
        num_states = width if model is None else len(model.state_space)
        if width > num_states:
            source.fail(f"a plane has state {width - 1}, but the model has states 0 to {num_states - 1}")
        if all(len(plane.entries) == num_states for plane in planes):
            return AlphaVectors(_dense(planes, num_states), actions, num_actions)
        return MaskedAlphaVectors([plane.entries for plane in planes], actions, num_states, num_actions)
    for plane in planes:
        if plane.observed is None:
            source.fail("the plane has no observed state val", line=plane.line)
        if len(plane.entries) != width:
            given = f"{len(plane.entries)} are given"
            source.fail(f"an entry for each of {width} hidden states was expected, but {given}", line=plane.line)
    observed = [plane.observed or 0 for plane in planes]
    count = max(observed) + 1 if model is None or len(model.state_space) % width else len(model.state_space) // width
    if count <= max(observed) or count * width > LARGEST:
        source.fail(
            f"there are planes for observed value {max(observed)}, but {width} hidden states leave only {count} values"
        )
    if count == 1:
        return AlphaVectors(_dense(planes, width), actions, num_actions)
    states = sarsop_policy.layout(width, count, model)
    return MixedAlphaVectors(_dense(planes, width), actions, observed, num_actions, states=states)


def write(policy: MaskedAlphaVectors | AlphaVectors, path: str | Path) -> None:
    """Write planes that ZMDP can read; reading them gives the same numbers."""
    if isinstance(policy, AlphaVectors):
        planes = [list(enumerate(row)) for row in policy.vectors.tolist()]
    else:
        planes = [list(vector.items()) for vector in policy.vectors]
    texts = [
        f"    {{\n      action => {action},\n      numEntries => {len(plane)},\n      entries => [\n"
        + ",\n".join(f"        {state}, {float(value)!r}" for state, value in plane)
        + "\n      ]\n    }"
        for action, plane in zip(policy.actions, planes, strict=True)
    ]
    write_text(
        path,
        f'{{\n  policyType => "MaxPlanesLowerBound",\n  numPlanes => {len(texts)},\n  planes => [\n'
        + ",\n".join(texts)
        + "\n  ]\n}\n",
    )


def _dense(planes: list[_Plane], width: int) -> list[list[float]]:
    return [[plane.entries[state] for state in range(width)] for plane in planes]


class _Reader:
    def __init__(self, source: Source, num_actions: int | None) -> None:
        self._source = source
        self._largest = LARGEST if num_actions is None else num_actions - 1
        self._kind: bool | None = None
        self._count: int | None = None
        self._planes: list[_Plane] = []

    def planes(self) -> tuple[bool, list[_Plane]]:
        """Return whether planes have an observed value, and the planes."""
        for line, text in enumerate(self._source.text.split("\n"), 1):
            words = text.partition("#")[0].strip().removesuffix(",").rstrip()
            if words.strip("{}[], ") == "":
                continue
            item = _ITEM.fullmatch(words)
            if item is None:
                self._entry(line, words)
            elif item[1] not in {"planes", "entries"}:
                self._item(line, item[1], item[2])
        if not self._planes or self._kind is None:
            self._source.fail("the file holds no planes")
        for plane in self._planes:
            if not plane.entries or plane.count not in {None, len(plane.entries)}:
                given = f"{len(plane.entries)} are given"
                self._source.fail(f"the plane's numEntries is {plane.count}, but {given}", line=plane.line)
        if self._count not in {None, len(self._planes)}:
            self._source.fail(f"numPlanes is {self._count}, but {len(self._planes)} are given")
        return self._kind, self._planes

    def _item(self, line: int, name: str, value: str) -> None:
        if name == "policyType":
            if value not in _KINDS:
                self._source.fail(f"{value[:60]} is not a known policy type; {' and '.join(_KINDS)} are", line=line)
            self._kind = _KINDS[value]
        elif name == "numPlanes":
            self._count = self._whole(line, name, value, LARGEST)
        elif name == "action":
            self._planes.append(_Plane(line, self._whole(line, name, value, self._largest)))
        elif name == "observed state val":
            self._last(line).observed = self._whole(line, name, value, LARGEST)
        elif name == "numEntries":
            self._last(line).count = self._whole(line, name, value, LARGEST)
        else:
            self._source.fail(f"the key {name[:40]!r} is unknown in a policy of planes", line=line)

    def _entry(self, line: int, words: str) -> None:
        pair = _PAIR.fullmatch(words)
        if pair is None:
            self._source.fail(f"a state, a comma and a value were expected, not {words[:40]!r}", line=line)
        state, value = self._whole(line, "a state", pair[1], LARGEST), number_of(pair[2])
        if value is None or not math.isfinite(value):
            self._source.fail(f"{pair[2][:40]!r} is not a finite number", line=line)
        entries = self._last(line).entries
        if state in entries:
            self._source.fail(f"the plane has two entries for state {state}", line=line)
        entries[state] = value

    def _last(self, line: int) -> _Plane:
        if not self._planes:
            self._source.fail("this line precedes the first plane's action", line=line)
        return self._planes[-1]

    def _whole(self, line: int, name: str, word: str, largest: int) -> int:
        if not word.isdecimal() or len(word) > 20 or int(word) > largest:
            self._source.fail(f"{name} is {word[:40]!r}; a whole number from 0 to {largest} was expected", line=line)
        return int(word)
