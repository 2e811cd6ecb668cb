"""Replay: a run once more, from its record, as exactly as it was."""

from mdm.replay.difference import Difference
from mdm.replay.replay import Replayed, Together, replay, replay_together, transports_of
from mdm.replay.traffic import Limit

__all__ = ["Difference", "Limit", "Replayed", "Together", "replay", "replay_together", "transports_of"]
