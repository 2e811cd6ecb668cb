"""Replay: a run once more, from its record, as exactly as it was."""

from mdm.replay.exchange import Limit
from mdm.replay.player import Difference
from mdm.replay.replay import Replayed, Together, replay, replay_together, transports_of

__all__ = ["Difference", "Limit", "Replayed", "Together", "replay", "replay_together", "transports_of"]
