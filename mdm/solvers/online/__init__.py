"""Online search: a policy that looks ahead from the present belief at each decision."""

from mdm.solvers.online.tree_search import SearchResult, TreeSearch

__all__ = ["SearchResult", "TreeSearch"]
