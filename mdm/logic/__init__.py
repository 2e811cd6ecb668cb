"""Three-valued propositional logic: formulas, their text form, and incrementally updated networks."""

from mdm.logic.declarations import similar
from mdm.logic.formula import Formula, P
from mdm.logic.network import Change, Network
from mdm.logic.parser import parse

__all__ = ["Change", "Formula", "Network", "P", "parse", "similar"]
