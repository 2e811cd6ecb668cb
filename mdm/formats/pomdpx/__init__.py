"""POMDPX, `.pomdpx`: factored models with tables, decision diagrams and mixed observability."""
