"""Policies over states as vectors and matrices: uBLAS text and Q-tables."""
