"""Teams: one process per agent, which share their input and decide as one, or each on its own knowledge.

A `Transport` carries the messages: a session of Zenoh between processes (`mdm.team.transport.session`, which needs
``pip install eclipse-zenoh``), or a simulated network within one (`mdm.team.transport.network`). A
`Team` says who decides together and how; a `Member` is one agent of it, an actor to run. The names here are loaded when
they are first asked for.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mdm.team.communication import Always, Budget, CommunicationPolicy, Never, OnChange, ValueOfCommunication
    from mdm.team.decisions import Committed
    from mdm.team.knowledge import Experience, Knowledge, Recollection, RecollectionStatistics, SharedHistory
    from mdm.team.member import Member, MemberStatistics, Teammates
    from mdm.team.ownership import Placement
    from mdm.team.sharing.commanding import Confirmation
    from mdm.team.sharing.remote import Exports, Imports
    from mdm.team.team import Agent, Team, TeamOptions
    from mdm.team.transport.allowance import TokenBucket
    from mdm.team.transport.network import Network

__all__ = [
    "Agent",
    "Always",
    "Budget",
    "Committed",
    "CommunicationPolicy",
    "Confirmation",
    "Experience",
    "Exports",
    "Imports",
    "Knowledge",
    "Member",
    "MemberStatistics",
    "Network",
    "Never",
    "OnChange",
    "Placement",
    "Recollection",
    "RecollectionStatistics",
    "SharedHistory",
    "Team",
    "TeamOptions",
    "Teammates",
    "TokenBucket",
    "ValueOfCommunication",
]

_HOMES = {
    "communication": ("Always", "Budget", "CommunicationPolicy", "Never", "OnChange", "ValueOfCommunication"),
    "decisions": ("Committed",),
    "knowledge": ("Experience", "Knowledge", "Recollection", "RecollectionStatistics", "SharedHistory"),
    "member": ("Member", "MemberStatistics", "Teammates"),
    "ownership": ("Placement",),
    "sharing.commanding": ("Confirmation",),
    "sharing.remote": ("Exports", "Imports"),
    "team": ("Agent", "Team", "TeamOptions"),
    "transport.allowance": ("TokenBucket",),
    "transport.network": ("Network",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for, so that a program loads no more than it uses."""
    if name not in _HOME_OF:
        raise AttributeError(f"module 'mdm.team' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"mdm.team.{_HOME_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names."""
    return list(__all__)
