"""One decision process as plain data and plain calls, without actors, clock or channels."""

from mdm.controller.controller import Controller
from mdm.controller.step import Step

__all__ = ["Controller", "Step"]
