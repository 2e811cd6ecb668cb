"""Teams: one process per agent, which share what they see and decide as one, or each on what it knows.

A `Transport` carries the messages: a session of Zenoh between processes (`mdm.team.transport.session`, which needs
``pip install 'markov-decision-making[team]'``), or a simulated network within one (`mdm.team.transport.network`). A
`Team` says who decides together and how; a `Member` is one agent of it, an actor to run.
"""

from mdm.team.commits import Committed
from mdm.team.communicating.communication import (
    Always,
    Budget,
    CommunicationPolicy,
    Never,
    OnChange,
    ValueOfCommunication,
)
from mdm.team.communicating.knowledge import Knowledge, SharedHistory
from mdm.team.communicating.recollection import Experience, Recollection, RecollectionStatistics
from mdm.team.member import Member, MemberStatistics, Teammates
from mdm.team.placement import Placement
from mdm.team.team import Agent, Team
from mdm.team.transport.budget import TokenBucket
from mdm.team.transport.network import Network

__all__ = [
    "Agent",
    "Always",
    "Budget",
    "Committed",
    "CommunicationPolicy",
    "Experience",
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
    "Teammates",
    "TokenBucket",
    "ValueOfCommunication",
]
