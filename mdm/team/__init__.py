"""Teams: one process per agent, which share what they see and decide as one, or each on what it knows.

A `Transport` carries the messages: a session of Zenoh between processes (`mdm.team.session`, which needs
``pip install 'mdm[team]'``), or a simulated network within one (`mdm.team.network`). The names here are those of agents
that decide on what they know, and of what they tell each other.
"""

from mdm.team.budget import TokenBucket
from mdm.team.communication import Always, Budget, CommunicationPolicy, Never, OnChange, ValueOfCommunication
from mdm.team.knowledge import Knowledge, SharedHistory
from mdm.team.recollection import Experience, Recollection, RecollectionStatistics

__all__ = [
    "Always",
    "Budget",
    "CommunicationPolicy",
    "Experience",
    "Knowledge",
    "Never",
    "OnChange",
    "Recollection",
    "RecollectionStatistics",
    "SharedHistory",
    "TokenBucket",
    "ValueOfCommunication",
]
