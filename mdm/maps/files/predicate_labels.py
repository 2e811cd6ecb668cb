"""The colours of places: a YAML file of names and numbers, as the original's pose labeller reads it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.formats.source import Source
from mdm.maps.files.yaml_tree import read_yaml

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["load_colours"]


def load_colours(path: str | Path) -> dict[str, int]:
    """Load the number of each place's colour, by the place's name.

    A number is decimal or begins with 0x. A negative one is that of an image with opacity, as 32 bits with a sign.

    Raises:
        FormatError: If the file is missing or malformed, or two places have the same colour.
        MapError: If PyYAML is not installed.
    """
    colours: dict[str, int] = {}
    root = read_yaml(Source(path))
    for name, entry in root.mapping("the colours").items():
        text = entry.string(name)
        try:
            number = int(text, 0)
        except ValueError:
            entry.fail(f"{name}: the number of a colour was expected, not {text!r}")
        if not -(1 << 31) <= number < 1 << 32:
            entry.fail(f"{name}: the number {number} is that of no colour: it has more than 32 bits")
        colours[name] = number % (1 << 32)
    if not colours:
        root.fail("no place has a colour")
    return colours
