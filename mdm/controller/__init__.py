"""The controller: one decision process as plain data and plain calls, without actors, clock or channels."""

from __future__ import annotations

from mdm.controller.controller import Controller, seeded
from mdm.controller.step import Step

__all__ = ["Controller", "Step", "seeded"]
