"""POMDPX, `.pomdpx`: factored models with tables and decision diagrams, and mixed observability."""
