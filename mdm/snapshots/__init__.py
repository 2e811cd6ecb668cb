"""Snapshots of runs for the eye: one shape for a running system and for a record, made once for all who look."""

from __future__ import annotations

from mdm.snapshots.events import Event, Ring
from mdm.snapshots.frame import Detail, EnsembleFrame, Frame, Scene
from mdm.snapshots.live import LiveRun
from mdm.snapshots.recorded import RecordedRun

__all__ = ["Detail", "EnsembleFrame", "Event", "Frame", "LiveRun", "RecordedRun", "Ring", "Scene"]
