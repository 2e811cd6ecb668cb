"""Placement: at which agents the layers of an ensemble are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

from mdm.errors import ConfigError
from mdm.logic import similar

__all__ = ["Placement", "placement_of"]


class Placement(msgspec.Struct, frozen=True):
    """Where an ensemble's layers are, where that is not said by the agents' names.

    Args:
        control: The agent that decides; None for the team's own way: every agent where it is replicated, its controller
            where it is centralised.
        actions: The agent that carries out the actions, or one for each agent of the model, by name; by default the
            agent of the same name or, where there are as many, in the same order.
        inputs: The agent whose sensors tell what is decided on; by default the owners of the factors.

    Example::

        off_board = mdm.team.Placement(control="base", actions="robot", inputs="robot")
        off_board.control  # 'base'
    """

    control: str | None = None
    actions: str | dict[str, str] | None = None
    inputs: str | None = None

    def __post_init__(self) -> None:
        """Refuse what is no agent's name.

        Raises:
            ConfigError: If it is none.
        """
        names = [self.control, self.inputs]
        names += self.actions.values() if isinstance(self.actions, Mapping) else [self.actions]
        for name in names:
            if name is not None and not isinstance(name, str):
                raise ConfigError(f"a placement names agents of the team, not {name!r}", key="placement")


def placement_of(given: Placement | Mapping[str, Any]) -> Placement:
    """Return a placement; a mapping has its arguments by name.

    Raises:
        ConfigError: If it is none.
    """
    if isinstance(given, Placement):
        return given
    if not isinstance(given, Mapping):
        raise ConfigError(f"a placement is a mdm.team.Placement(...), or a mapping, not {given!r}", key="placement")
    names = Placement.__struct_fields__
    for name in given:
        if name not in names:
            hint = similar(str(name), names) or f"; it has {', '.join(names)}"
            raise ConfigError(f"a placement has no {name!r}{hint}", key="placement")
    return Placement(**given)
