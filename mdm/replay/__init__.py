"""Replay: a run once more, from its record, as exactly as it was."""

from mdm.replay.difference import Difference
from mdm.replay.exchange import Exchange
from mdm.replay.replay import Replayed, replay, transports_of

__all__ = ["Difference", "Exchange", "Replayed", "replay", "transports_of"]
