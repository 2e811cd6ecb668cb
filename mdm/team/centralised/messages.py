"""The messages of centralised teams: proposals of the agents, and decisions of the one that decides.

The agents send their proposals, numbered, again and again until the controller acknowledges them. The controller
decides, and sends its decision to all; the last one once more every now and then, so that none is lost for long.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import msgspec
from msgspec import Meta

from mdm.runtime import ActorStatistics
from mdm.team.transport.bounds import Life, Name, Number, Order, Text

if TYPE_CHECKING:
    from mdm.actors import Ensemble
    from mdm.team.ownership import Placement
    from mdm.team.team import Team


class Proposal(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """An agent's proposal to the controller.

    Args:
        number: Counted from 1 in the life of the agent, where the controller is to say that it has it; else 0.
        tick: The number of the tick that it belongs to; 0 where events make steps.
        part: The agent's part of the step, None where it saw nothing.
        command: In place of a part, a command that was asked for at the agent; or ``hold``: it took a stop that the
            controller knows nothing of, and stays stopped.
        token: The identifier of the command.
        life: In which life of the controller it was asked for.
        step: The last decision of that life which the agent had by then.
    """

    number: Number
    tick: Number
    part: bytes | None
    command: Order | None
    token: Name = ""
    life: Life = 0
    step: Number = 0


class Decision(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """The last decision of the controller.

    Args:
        step: Counted from 1, in the life of the controller.
        running: Whether the team decides, or is stopped.
        epoch: Of the decision in its episode.
        action: The joint action; None where there is none.
        impossible: Why the observation makes every agent safe; None where it does not.
        inputs: The input of the decision, by agent.
        missing: Agents whose part is not known.
        command: In place of these, the command.
        digest: Of the controller after it.
        taken: The last number taken from each agent, by its name.
        token: The identifier of the command.
        started: The step that started the team last, 0 where none did.
        bars: Of each agent that has said a stop or a hold its life, the number of the last one, and the step that this
            became.
        void: Of each agent, the token of its last command that came too late to be done.
        called: Whether somebody has asked this life of the controller for a start.
    """

    step: Number
    running: bool
    epoch: Annotated[int, Meta(ge=-1, le=(1 << 62) - 1)]
    action: Number | None
    impossible: Text | None
    inputs: dict[Name, bytes]
    missing: tuple[Name, ...]
    command: Order | None
    digest: Text
    taken: dict[Name, Number]
    token: Name = ""
    started: Number = 0
    bars: dict[Name, tuple[Life, Number, Number]] = {}
    void: dict[Name, Name] = {}
    called: bool = False


encode = msgspec.msgpack.Encoder().encode
decode_proposal = msgspec.msgpack.Decoder(Proposal).decode
decode_decision = msgspec.msgpack.Decoder(Decision).decode


class CentralisedStatistics(ActorStatistics, frozen=True):
    """Where an agent of a centralised team stands.

    Attributes:
        role: ``leading`` at the controller; else ``following``, ``joining`` before the first decision, ``waiting``
            where the controller is not there. ``refused`` at any agent that cannot take part.
        leader: The controller.
        step: The last decision, counted from 1.
        digest: Of the controller after it.
        late: Parts that came after their step, or could not be said while the controller was not there.
        malformed: Messages that were none.
    """

    role: str
    leader: str
    step: int
    digest: str
    late: int
    malformed: int


def controlling(team: Team, ensemble: Ensemble, placement: Placement) -> str:
    """Return the agent that decides.

    Raises:
        ConfigError: If the placement names none of the team's.
    """
    if placement.control is None:
        return team.controller
    return team.check_agent(placement.control, key=f"ensembles.{ensemble.name}.placement.control")
