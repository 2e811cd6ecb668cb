"""APPL/SARSOP's XML policies, ``.policy`` and ``.policyx``: alpha vectors, also for mixed observability.

``<AlphaVector vectorLength= numObsValue= numVectors=>`` holds ``<Vector action= obsValue=>`` with a number per hidden
state, or ``<SparseVector>`` with pairs of index and number. ``obsValue`` is the joint index of the fully observed
variables, ``vectorLength`` the number of joint values of the others.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.formats.markup import Element, stream
from mdm.formats.source import LARGEST, Source
from mdm.formats.target import write_text
from mdm.policies import AlphaVectors, MixedAlphaVectors

if TYPE_CHECKING:
    from pathlib import Path

    import numpy.typing as npt

    from mdm.models import MDP

_VECTORS = frozenset({"Vector", "SparseVector"})


def read(path: str | Path, model: MDP | None = None) -> AlphaVectors | MixedAlphaVectors:
    """Read alpha vectors; `MixedAlphaVectors` if part of the state is fully observed.

    Args:
        path: The file.
        model: The policy's model, which knows the fully observed state factors; without it they are the first ones.

    Raises:
        FormatError: If the file is malformed, with the place and the expected form.
    """
    source = Source(path)
    num_actions = None if model is None else len(model.action_space)
    elements = stream(source, _VECTORS)
    root = next(elements, None)
    if root is None or root.tag != "Policy":
        source.fail(f"a <Policy> was expected, not a <{'' if root is None else root.tag[:40]}>", line=1)
    reader = _Reader(model)
    for element in elements:
        reader.take(element)
    if reader.head is None or not reader.vectors:
        source.fail("the file holds no alpha vectors")
    count = len(reader.vectors)
    if "numVectors" in reader.head.attributes and _whole(reader.head, "numVectors", LARGEST) != count:
        reader.head.fail(f"numVectors is {reader.head.attributes['numVectors'][:40]}, but {count} are given")
    if reader.count == 1:
        return AlphaVectors(reader.vectors, reader.actions, num_actions)
    states = layout(reader.length, reader.count, model)
    return MixedAlphaVectors(reader.vectors, reader.actions, reader.observed, num_actions, states=states)


def write(policy: AlphaVectors | MixedAlphaVectors, path: str | Path) -> None:
    """Write alpha vectors; reading them with the same model gives the same numbers."""
    sets = policy.sets if isinstance(policy, MixedAlphaVectors) else (policy,)
    width = policy.states.shape[1] if isinstance(policy, MixedAlphaVectors) else policy.num_states
    # SARSOP's reader splits at blanks: without one, the closing tag would be part of the last number.
    lines = [
        f'<Vector action="{action}" obsValue="{x}">{" ".join(map(repr, row))} </Vector>\n'
        for x, vectors in enumerate(sets)
        if vectors is not None
        for action, row in zip(vectors.actions, vectors.vectors.tolist(), strict=True)
    ]
    write_text(
        path,
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        '<Policy version="0.1" type="value" model="mdm">\n'
        f'<AlphaVector vectorLength="{width}" numObsValue="{len(sets)}" numVectors="{len(lines)}">\n'
        f"{''.join(lines)}</AlphaVector>\n</Policy>\n",
    )


class _Reader:
    def __init__(self, model: MDP | None) -> None:
        self._model = model
        self._last_action = LARGEST if model is None else len(model.action_space) - 1
        self.head: Element | None = None
        self.length = self.count = 1
        self.vectors: list[npt.NDArray[np.float64]] = []
        self.actions: list[int] = []
        self.observed: list[int] = []

    def take(self, element: Element) -> None:
        if element.tag == "AlphaVector":
            if self.head is not None:
                element.fail("there is a second <AlphaVector>; only one is allowed")
            self.head = element
            self.length = _whole(element, "vectorLength", LARGEST)
            self.count = _whole(element, "numObsValue", LARGEST, "1")
            _check_sizes(element, self.length, self.count, self._model)
        elif element.tag in _VECTORS:
            if self.head is None:
                element.fail(f"<{element.tag}> is outside of an <AlphaVector>")
            # A dense vector is bounded by its text; sparse ones could claim unbounded memory.
            if element.tag == "SparseVector" and (len(self.vectors) + 1) * self.length > 5 * LARGEST:
                element.fail(
                    f"too many sparse vectors of {self.length} numbers: at most {len(self.vectors)} are allowed"
                )
            self.actions.append(_whole(element, "action", self._last_action, lowest=0))
            self.observed.append(_whole(element, "obsValue", self.count - 1, "0", lowest=0))
            self.vectors.append((_dense if element.tag == "Vector" else _sparse)(element, self.length))


def layout(length: int, count: int, model: MDP | None) -> npt.NDArray[np.intp]:
    """Return the joint index of each state, observed x hidden."""
    states: npt.NDArray[np.intp] = np.arange(length * count)
    marked = _fully_observed(model)
    if model is not None and any(marked):
        order = sorted(range(len(marked)), key=lambda factor: not marked[factor])  # stable sort: observed factors first
        states = states.reshape(model.state_space.shape).transpose(order)
    return states.reshape(count, length)


def _fully_observed(model: MDP | None) -> tuple[bool, ...]:
    network = getattr(model, "network", None)
    return () if network is None else tuple(network.fully_observed)


def _check_sizes(element: Element, length: int, count: int, model: MDP | None) -> None:
    if length * count > LARGEST:
        element.fail(f"{length} x {count} states exceed the limit of {LARGEST}")
    if model is None:
        return
    if length * count != len(model.state_space):
        states = f"{length * count} states ({count} observed x {length} hidden)"
        element.fail(f"the policy is for {states}, but the model has {len(model.state_space)}")
    sizes = [size for size, seen in zip(model.state_space.shape, _fully_observed(model), strict=False) if seen]
    if sizes and count not in {1, int(np.prod(sizes))}:
        element.fail(
            f"numObsValue is {count}, but the model's fully observed factors have {int(np.prod(sizes))} values"
        )


def _dense(element: Element, length: int) -> npt.NDArray[np.float64]:
    words = element.text.split()
    if len(words) != length:
        element.fail(f"vectorLength is {length}, but {len(words)} numbers are given")
    return np.array([element.number(word) for word in words])


def _sparse(element: Element, length: int) -> npt.NDArray[np.float64]:
    values = np.zeros(length)
    words = element.text.split()
    for entry in element.all("Entry"):
        words += [word for part in (entry, *entry.children) for word in part.text.split()]
    if len(words) % 2:
        element.fail("pairs of index and number were expected, but there is an odd number of words")
    for index, value in zip(words[::2], words[1::2], strict=True):
        if not index.isdecimal() or len(index) > 20 or int(index) >= length:
            element.fail(f"{index[:40]!r} is not an index from 0 to {length - 1}")
        values[int(index)] = element.number(value)
    return values


def _whole(element: Element, name: str, largest: int, default: str | None = None, *, lowest: int = 1) -> int:
    """Parse an attribute as a whole number within limits."""
    given = element.attributes.get(name, default)
    word = (element.attribute(name) if given is None else given).strip()
    if not word.isdecimal() or len(word) > 20 or not lowest <= int(word) <= largest:
        element.fail(f"{name} is {word[:40]!r}; a whole number from {lowest} to {largest} was expected")
    return int(word)
