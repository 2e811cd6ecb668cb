"""Agreement on joint steps: every copy of an ensemble applies the same steps in the same order, or stops and says so.

A pure state machine: messages, proposals and time go in, messages and commits come out. It knows no socket, no clock
and no model. A step takes one round trip between the leader and the others, and a few tens of microseconds of each.

The rules and their promises are in ``docs/design/agreement.md``. The order of steps within terms that one agent leads
goes back to viewstamped replication (Oki and Liskov, 1988) and Raft (Ongaro and Ousterhout, 2014). Other than there,
nobody is elected, since the first live agent in the order of the team leads; only the last stop that an agent obeys is
kept on disk, and no step; and a leader applies the step that it commits at once, so that this one step may be known to
it alone when it is lost.
"""

from mdm.team.agreement.agreement import Agreement, Replica, Standing
from mdm.team.agreement.messages import Commit, Message, Position, Send, Term, decode, encode

__all__ = ["Agreement", "Commit", "Message", "Position", "Replica", "Send", "Standing", "Term", "decode", "encode"]
