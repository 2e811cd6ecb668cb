"""Three-valued propositional logic: formulas, in time as well, their text form, and incrementally updated networks."""

from mdm.logic.formula import Formula, P
from mdm.logic.monitor import Monitor
from mdm.logic.network import Change, Network, similar
from mdm.logic.parser import parse
from mdm.logic.threshold import Threshold, parse_threshold

__all__ = ["Change", "Formula", "Monitor", "Network", "P", "Threshold", "parse", "parse_threshold", "similar"]
